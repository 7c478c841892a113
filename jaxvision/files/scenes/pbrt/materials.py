"""Convert pbrt's materials to the tables `[material.NAME]` of a scene file."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ....brdf.fresnel import Dielectric, mean_reflectance
from ....core._warnings import warn
from ..nodes import Colour, Named, Node, Table, plain
from .spectra import mixed, numbers_of, pairs_of

_LEAST_UNDER_COAT = 0.04  # alpha of metal, for a small error of `Coated`
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

# Wavelengths, nm, with eta and k of evaporated films. Copper, silver and gold: Johnson and Christy,
# Physical Review B 6 (1972), 4370; aluminium: Rakic, Applied Optics 34 (1995), 4755.
_NOBLE = [397.4, 413.3, 430.5, 450.9, 471.4, 495.9, 520.9, 548.6, 582.1, 616.8, 659.5, 704.5, 756.0]
_METALS = {
    "Cu": (
        _NOBLE,
        [1.32, 1.28, 1.25, 1.24, 1.25, 1.22, 1.18, 1.02, 0.70, 0.30, 0.22, 0.21, 0.24],
        [2.116, 2.207, 2.305, 2.397, 2.483, 2.564, 2.608, 2.577, 2.704, 3.205, 3.747, 4.205, 4.665],
    ),
    "Ag": (
        _NOBLE,
        [0.05, 0.05, 0.04, 0.04, 0.05, 0.05, 0.05, 0.06, 0.05, 0.06, 0.05, 0.04, 0.03],
        [2.070, 2.275, 2.462, 2.657, 2.869, 3.093, 3.324, 3.586, 3.858, 4.152, 4.483, 4.838, 5.242],
    ),
    "Au": (
        _NOBLE,
        [1.47, 1.46, 1.45, 1.38, 1.31, 1.04, 0.62, 0.43, 0.29, 0.21, 0.14, 0.13, 0.14],
        [1.952, 1.958, 1.948, 1.914, 1.849, 1.833, 2.081, 2.455, 2.863, 3.272, 3.697, 4.103, 4.542],
    ),
    "Al": (
        [364.66, 413.28, 442.80, 476.87, 516.60, 563.57, 619.93, 652.25, 688.81, 729.32, 774.91],
        [0.3988, 0.5214, 0.6079, 0.7278, 0.8734, 1.0728, 1.3660, 1.5724, 1.8301, 2.1606, 2.6154],
        [4.3957, 5.0008, 5.3676, 5.7781, 6.2418, 6.7839, 7.4052, 7.7354, 8.0601, 8.3565, 8.4914],
    ),
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
    made = _coat(node, "") | {"albedo": numbers_of(node, "reflectance", 0.5)}
    depth = node.take("maxdepth", int, 10)
    if isinstance(made["roughness"], dict) or made["roughness"] >= _SMOOTHEST:
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


def _coat(node: Node, prefix: str) -> dict[str, Any]:
    """Return the keys of a coat. In pbrt a coat without scattering dims light by its thickness, as
    an optical depth."""
    if numbers_of(node, "albedo", 0.0) not in (0.0, [0.0, 0.0, 0.0]):
        raise node.wrong("a coat that scatters (albedo above 0) is not read; set albedo to 0.")
    node.take("g", float, 0.0)
    node.take("nsamples", int, 1)
    if not node.take("twosided", bool, True):
        raise node.wrong("twosided false is not read; remove it.")
    return {
        "family": "coated",
        "eta": _index(node, f"{prefix}eta"),
        "roughness": _roughness(node, prefix),
        "optical_depth": numbers_of(node, "thickness", 0.01),
    }


def _coated_conductor(node: Node) -> dict[str, Any]:
    """Convert a metal under a coat; the metal's indices are relative to the index of the coat."""
    made = _coat(node, "interface.")
    roughness = _roughness(node, "conductor.")
    if isinstance(roughness, dict) or roughness < _LEAST_UNDER_COAT:
        raise node.wrong(
            f"metal under a coat is read with an alpha, the root of conductor.roughness, of at "
            f"least {_LEAST_UNDER_COAT}; make it rougher."
        )
    node.take("maxdepth", int, 10)
    warn(
        f"{node.label}: light that facets of coat or metal stop is lost in pbrt, and walks in the "
        "coat end after maxdepth events; here the coat loses no light."
    )
    metal = _metal(node, "conductor.", made["eta"])
    body = {"family": "torrance_sparrow", "albedo": 0.0, "roughness": roughness, **metal}
    return made | {"body": body}


def _conductor(node: Node) -> dict[str, Any]:
    roughness = _roughness(node, "")
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
        **_metal(node, "", 1.0),
    }


def _metal(node: Node, prefix: str, outside: float) -> dict[str, Any]:
    """Return the keys of the reflectance of a metal in a medium of the index `outside`. pbrt
    describes a given reflectance by the index 1 and an extinction coefficient."""
    kinds = (Table, Named, Colour, float)
    given = {name: node.take(prefix + name, kinds) for name in ("eta", "k")}
    if "reflectance" in node.values or any(name == "reflectance" for name, _ in node.parts):
        r = numbers_of(node, "reflectance", 1.0)
        if isinstance(r, dict) or any(x is not None for x in given.values()):
            raise node.wrong("takes eta and k, or a reflectance that is a number or rgb.")
        r = np.minimum(r, 0.9999)
        k = 2 * np.sqrt(r / (1 - r))
        return {"eta": 1 / outside, "k": (k / outside).tolist()}
    for i, (name, x) in enumerate(given.items(), 1):
        if x is None or isinstance(x, Named):
            word = f"metal-Cu-{name}" if x is None else x.name
            metal = _METALS.get(word.removeprefix("metal-").removesuffix(f"-{name}"))
            if metal is None:
                raise node.wrong(f"{prefix}{name}: {word[:40]!r} is not known; give its pairs.")
            given[name] = Table(tuple(zip(metal[0], metal[i], strict=True)))
    if not any(isinstance(x, Table) for x in given.values()):
        return {name: (np.array(plain(x)) / outside).tolist() for name, x in given.items()}
    if any(isinstance(x, Colour) for x in given.values()):
        raise node.wrong("eta and k are rgb and a table, which are not read; give two tables.")
    tables = [
        pairs_of(node, prefix + name, x) if isinstance(x, Table) else np.array([[560.0], [x]])
        for name, x in given.items()
    ]
    nm = np.unique(np.concatenate([table[0] for table in tables]))
    eta, k = (np.interp(nm, *table) / outside for table in tables)
    f0 = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
    warn(
        f"{node.label}: a metal of tabulated eta and k has the colour of its reflectance at normal "
        "incidence, and Schlick's at other angles."
    )
    return {"f0": {"pairs": np.stack([nm, f0], axis=1).tolist()}}


def _dielectric(node: Node) -> dict[str, Any]:
    roughness = _roughness(node, "")
    if isinstance(roughness, dict) or roughness >= _SMOOTHEST:
        raise node.wrong("rough glass is not read; set roughness to 0.")
    return {"family": "glass", "index": _index(node, "eta")}


def _mix(node: Node, named: Callable[[Node, str], Node]) -> dict[str, Any]:
    """Convert a mixture of two matte materials, or of a matte one and a metal with facets."""
    names = node.take("materials", tuple)
    if names is None or len(names) != 2:
        raise node.wrong("needs two materials; name them.")
    share = node.take("amount", float, 0.5)
    tables = [material_of(named(node, name), named) for name in names]
    rough = [i for i in (0, 1) if tables[i]["family"] == "torrance_sparrow"]
    matt = [i for i in (0, 1) if tables[i]["family"] == "lambert"]
    if len(rough) > 1 or len(rough) + len(matt) < 2 or any("normals" in x for x in tables):
        raise node.wrong("is read of diffuse materials and at most one conductor; split the shape.")
    first, second = (table["albedo"] for table in tables)
    made: dict[str, Any] = {"albedo": mixed(node, first, second, share)}
    if not rough:
        return {"family": "lambert", **made}
    return tables[rough[0]] | made | {"specular": share if rough == [1] else 1 - share}


def _roughness(node: Node, prefix: str) -> Any:
    """Return alpha of the facets, which is the root of pbrt's roughness unless the file says
    otherwise."""
    u, v = (numbers_of(node, f"{prefix}{axis}roughness", np.nan) for axis in "uv")
    both = numbers_of(node, f"{prefix}roughness", 0.0)
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
    "coatedconductor": _coated_conductor,
    "conductor": _conductor,
    "dielectric": _dielectric,
    "measured": lambda node: {"family": "measured", "file": node.filename()},
}
