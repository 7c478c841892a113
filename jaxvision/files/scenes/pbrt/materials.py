"""Convert pbrt's materials to the tables `[material.NAME]` of a scene file."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ....brdf.fresnel import Dielectric, mean_reflectance
from ....core._warnings import warn
from ..nodes import Colour, Named, Node, Table, plain
from .spectra import mixed, numbers_of, pairs_of

_SMOOTHEST = 1e-3  # alpha below which pbrt's facets are a mirror
# Refractive indices of optical glasses at 587.6 nm, as their makers publish them
_GLASSES = {
    "BK7": 1.5168,
    "BAF10": 1.6700,
    "F11": 1.6206,
    "K7": 1.5111,
    "LASF9": 1.8503,
    "SF5": 1.6727,
    "SF10": 1.7283,
    "SF11": 1.7847,
}


def material_of(node: Node, named: Callable[[Node, str], Node]) -> dict[str, Any]:
    """Return `family` and the other keys of a material, with `normals` for a normal map. `named`
    finds a named material. Raise `InputError` for a material without a counterpart."""
    kind = node.must_be(*_FAMILIES, "mix")
    made = _mix(node, named) if kind == "mix" else _FAMILIES[kind](node)
    if (normals := node.take("normalmap", str)) is not None:
        made["normals"] = {"map": normals, "encoding": "linear"}
    node.must_be_read()
    return made


def _diffuse(node: Node) -> dict[str, Any]:
    return {"family": "lambert", "albedo": numbers_of(node, "reflectance", 0.5)}


def _coated_diffuse(node: Node) -> dict[str, Any]:
    """Convert a Lambertian body under a coat. In pbrt a coat without scattering dims light by its
    thickness, as an optical depth."""
    roughness = _roughness(node)
    if numbers_of(node, "albedo", 0.0) not in (0.0, [0.0, 0.0, 0.0]):
        raise node.wrong("a coat that scatters (albedo above 0) is not read; set albedo to 0.")
    node.take("g", float, 0.0)
    if not node.take("twosided", bool, True):
        raise node.wrong("twosided false is not read; remove it.")
    made = {
        "family": "coated",
        "albedo": numbers_of(node, "reflectance", 0.5),
        "eta": _index(node, "eta"),
        "roughness": roughness,
        "optical_depth": numbers_of(node, "thickness", 0.01),
    }
    depth = node.take("maxdepth", int, 10)
    node.take("nsamples", int, 1)
    if isinstance(roughness, dict) or roughness >= _SMOOTHEST:
        warn(
            f"{node.label}: a rough coat keeps the light that facets stop, where pbrt loses it: it "
            "is darker there, over a body of albedo 0.5 by 3 % at alpha 0.1, 9 % at 0.2 and 15 % "
            "at 0.3."
        )
    elif not isinstance(made["albedo"], dict):
        outside = float(mean_reflectance(Dielectric([made["eta"]]))[0])
        returned = (1 - (1 - outside) / made["eta"] ** 2) * np.max(made["albedo"])
        if (lost := returned ** ((depth + 1) // 2)) > 0.005:
            warn(
                f"{node.label}: pbrt ends walks in the coat after {depth} events (maxdepth), which "
                f"loses up to {lost:.1%} of the light of the body; here all events count."
            )
    return made


def _conductor(node: Node) -> dict[str, Any]:
    roughness = _roughness(node)
    if roughness == 0 or (isinstance(roughness, float) and roughness < _SMOOTHEST):
        warn(
            f"{node.label}: smooth metal has facets of roughness {_SMOOTHEST:g} here, so that a "
            "point light has a highlight on it."
        )
        roughness = _SMOOTHEST
    return {
        "family": "torrance_sparrow",
        "albedo": 0.0,
        "roughness": roughness,
        **_metal(node),
    }


def _metal(node: Node) -> dict[str, Any]:
    """Return the keys of a metal's reflectance. pbrt describes a given reflectance by the index 1
    and an extinction coefficient."""
    kinds = (Table, Named, Colour, float)
    given = {name: node.take(name, kinds) for name in ("eta", "k")}
    if "reflectance" in node.values or any(name == "reflectance" for name, _ in node.parts):
        r = numbers_of(node, "reflectance", 1.0)
        if isinstance(r, dict) or any(x is not None for x in given.values()):
            raise node.wrong("takes eta and k, or a reflectance that is a number or rgb.")
        r = np.minimum(r, 0.9999)
        return {"eta": 1.0, "k": (2 * np.sqrt(r / (1 - r))).tolist()}
    for x in given.values():
        if x is None or isinstance(x, Named):
            metal = "copper (the default)" if x is None else x.name[:40]
            raise node.wrong(f"eta and k of {metal} are not known; give their pairs.")
    if not any(isinstance(x, Table) for x in given.values()):
        return {name: plain(x) for name, x in given.items()}
    if any(isinstance(x, Colour) for x in given.values()):
        raise node.wrong("eta and k are rgb and a table, which are not read; give two tables.")
    tables = [
        pairs_of(node, name, x) if isinstance(x, Table) else np.array([[560.0], [x]])
        for name, x in given.items()
    ]
    nm = np.unique(np.concatenate([table[0] for table in tables]))
    eta, k = (np.interp(nm, *table) for table in tables)
    f0 = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
    warn(
        f"{node.label}: a metal of tabulated eta and k has the colour of its reflectance at normal "
        "incidence, and Schlick's at other angles."
    )
    return {"f0": {"pairs": np.stack([nm, f0], axis=1).tolist()}}


def _dielectric(node: Node) -> dict[str, Any]:
    roughness = _roughness(node)
    if isinstance(roughness, dict) or roughness >= _SMOOTHEST:
        raise node.wrong("rough glass is not read; set roughness to 0.")
    return {"family": "glass", "index": _index(node, "eta")}


def _mix(node: Node, named: Callable[[Node, str], Node]) -> dict[str, Any]:
    """Convert a mixture of matt materials and at most one that has facets."""
    names = node.take("materials", tuple)
    if names is None or len(names) != 2:
        raise node.wrong("needs two materials; name them.")
    share = node.take("amount", float, 0.5)
    tables = [material_of(named(node, name), named) for name in names]
    weights = [1 - share, share]
    rough = [i for i in (0, 1) if tables[i]["family"] == "torrance_sparrow"]
    matt = [i for i in (0, 1) if tables[i]["family"] == "lambert"]
    if len(rough) > 1 or len(rough) + len(matt) < 2 or any("normals" in x for x in tables):
        raise node.wrong("is read of diffuse materials and at most one conductor; split the shape.")
    made: dict[str, Any] = {"albedo": mixed(node, *(x["albedo"] for x in tables), share)}
    if not rough:
        return {"family": "lambert", **made}
    return tables[rough[0]] | made | {"specular": weights[rough[0]]}


def _roughness(node: Node) -> Any:
    """Return alpha of the facets, which is the root of pbrt's roughness unless the file says
    otherwise."""
    u, v = (numbers_of(node, f"{axis}roughness", np.nan) for axis in "uv")
    both = numbers_of(node, "roughness", 0.0)
    u, v = (both if x != x else x for x in (u, v))
    if u != v:
        raise node.wrong("uroughness and vroughness differ, which is not read; give one roughness.")
    if not node.take("remaproughness", bool, True):
        return u
    if isinstance(u, dict):
        raise node.wrong("a texture of roughness is read with remaproughness false alone.")
    if u < 0:
        raise node.wrong("roughness must be at least 0; correct it.")
    return float(np.sqrt(u))


def _index(node: Node, name: str) -> float:
    given = node.take(name, (float, Named), 1.5)
    if not isinstance(given, Named):
        return given
    index = _GLASSES.get(given.name.removeprefix("glass-"))
    if index is None:
        raise node.wrong(f"{name}: the index of {given.name[:40]!r} is not known; give a number.")
    warn(f"{node.label}: glass has its index at 588 nm, {index:g}, at all wavelengths.")
    return index


_FAMILIES = {
    "diffuse": _diffuse,
    "coateddiffuse": _coated_diffuse,
    "conductor": _conductor,
    "dielectric": _dielectric,
}
