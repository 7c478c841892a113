"""Convert Mitsuba's BSDFs to the tables `[material.NAME]` of a scene file."""

from collections.abc import Callable
from typing import Any

from ....brdf.fresnel import Dielectric, mean_reflectance
from ....core._warnings import warn
from ..nodes import Node
from .spectra import SPECTRUM, index_of, map_of, reflectance_of

# Refractive indices by Mitsuba's names: published measurements near 589 nm.
_INDICES = {
    "vacuum": 1.0,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water": 1.3330,
    "acetone": 1.36,
    "ethanol": 1.361,
    "carbon tetrachloride": 1.461,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "silicone oil": 1.52045,
    "bromine": 1.661,
    "water ice": 1.31,
    "fused quartz": 1.458,
    "pyrex": 1.470,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.5750,
    "diamond": 2.419,
}


def material_of(node: Node | None) -> tuple[dict[str, Any], bool]:
    """Return `family` and the other keys of a `<bsdf>`, and whether it reflects on both sides. The
    keys include `normals` for a normal map. If no BSDF is given (None), the result is a diffuse
    BSDF of albedo 0.5. Raise `InputError` for a BSDF without a counterpart."""
    if node is None:
        return {"family": "lambert", "albedo": 0.5}, False
    if (kind := node.must_be(*_FAMILIES, "twosided", "normalmap")) in ("twosided", "normalmap"):
        inner = node.only_child("bsdf")
        if inner is None:
            raise node.wrong("holds no BSDF; put one within.")
        made, two_sided = material_of(inner)
        if kind == "normalmap":
            normals = map_of(node, "normalmap")
            if normals is None or normals["encoding"] == "srgb" or "normals" in made:
                raise node.wrong("needs one <texture name='normalmap'> that is raw.")
            made["normals"] = normals
        node.must_be_read(tags=("bsdf",))
        return made, two_sided or kind == "twosided"
    made = _FAMILIES[node.kind](node)
    node.must_be_read(without=("sample_visible",))
    return made, False


def _diffuse(node: Node) -> dict[str, Any]:
    return {"family": "lambert", "albedo": reflectance_of(node, "reflectance", 0.5)}


def _dielectric(node: Node) -> dict[str, Any]:
    inside, outside = _index(node, "int_ior", "bk7"), _index(node, "ext_ior", "air")
    return {"family": "glass", "index": inside / outside}


def _conductor(node: Node) -> dict[str, Any]:
    if not _reflects_all(node):
        raise node.wrong(
            "a smooth metal's reflectance by eta and k is not read; set material to "
            "'none' and give its specular_reflectance, or take a roughconductor of small alpha."
        )
    return {"family": "mirror", "reflectance": reflectance_of(node, "specular_reflectance", 1.0)}


def _rough_conductor(node: Node) -> dict[str, Any]:
    if {"alpha_u", "alpha_v"} & set(node.values):
        raise node.wrong("alpha_u and alpha_v are not read; give one alpha.")
    distribution = node.distribution()
    warn(
        f"{node.label}: facets hide each other by Smith's formula correlated by height, where "
        "Mitsuba multiplies the two directions' shares: rough metal is a little brighter here."
    )
    made = {
        "family": "torrance_sparrow",
        "albedo": 0.0,
        "specular": reflectance_of(node, "specular_reflectance", 1.0),
        "roughness": map_of(node, "alpha") or node.take("alpha", float, 0.1),
        "distribution": distribution,
    }
    if not _reflects_all(node):
        made |= {"eta": index_of(node, "eta", 0.0), "k": index_of(node, "k", 1.0)}
    return made


def _plastic(node: Node) -> dict[str, Any]:
    """Convert a plastic to a Lambertian body of albedo r under a clear coat. The coat returns a
    share R of the light to the body. Mitsuba divides r by 1 - R or, with `nonlinear`, by 1 - r R,
    because returned light loses a part at each reflection. Without `nonlinear`, a body with the
    albedo r / (1 - R (1 - r)) reflects the same light."""
    if node.take("specular_reflectance", SPECTRUM, 1.0) != 1.0:
        raise node.wrong("a specular_reflectance below 1 is not read; remove it.")
    eta = _index(node, "int_ior", "polypropylene") / _index(node, "ext_ior", "air")
    made = {
        "family": "coated",
        "eta": eta,
        "albedo": reflectance_of(node, "diffuse_reflectance", 0.5),
    }
    if not node.take("nonlinear", bool, False):
        if "map" in (made["albedo"] if isinstance(made["albedo"], dict) else {}):
            raise node.wrong(
                "a diffuse_reflectance by a texture is read with nonlinear alone; set it to true."
            )
        outside = float(mean_reflectance(Dielectric([eta]))[0])
        returned = 1 - (1 - outside) / eta**2
        made["albedo"] = _map_numbers(made["albedo"], lambda r: r / (1 - returned * (1 - r)))
    return made


def _map_numbers(spectrum: Any, change: Callable[[float], float]) -> Any:
    """Apply a function to every number of a spectrum that `reflectance_of` returned."""
    match spectrum:
        case {"pairs": pairs}:
            return {"pairs": [[wavelength, change(value)] for wavelength, value in pairs]}
        case list():
            return [change(value) for value in spectrum]
    return change(spectrum)


def _rough_plastic(node: Node) -> dict[str, Any]:
    distribution = node.distribution()
    warn(
        f"{node.label}: a rough coat without absorption loses no light here, where Mitsuba loses "
        "what facets send on to each other: its body is darker there, by 3 % (beckmann) and 10 % "
        "(ggx) at alpha 0.1, and by 30 % (ggx) at 0.3."
    )
    alpha = node.take("alpha", float, 0.1)
    return _plastic(node) | {"roughness": alpha, "distribution": distribution}


_FAMILIES = {
    "plastic": _plastic,
    "roughplastic": _rough_plastic,
    "diffuse": _diffuse,
    "dielectric": _dielectric,
    "conductor": _conductor,
    "roughconductor": _rough_conductor,
}


def _reflects_all(node: Node) -> bool:
    """Return whether a metal has neither an index nor a name. Such a metal reflects all light."""
    given = {"eta", "k"} <= set(node.values)
    name = node.take("material", str, "Cu" if node.old and not given else "none")
    if name != "none":
        raise node.wrong(f"metals by name are not read; give eta and k of {name!r}.")
    return not {"eta", "k"} & set(node.values)


def _index(node: Node, name: str, otherwise: str) -> float:
    given = node.take(name, (float, str), otherwise)
    if isinstance(given, float):
        return given
    if given not in _INDICES:
        raise node.wrong(f"{name} = {given!r} is not known; give the index itself.")
    return _INDICES[given]
