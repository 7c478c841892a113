"""glTF's materials as the tables `[material.NAME]`.

glTF mixes a metal and a coated matt body, f = (1 - m) ((1 - F) c / pi + F D V) + m F_m D V, with
Schlick's F from F0 = ((ior - 1) / (ior + 1))^2 and F_m from F0 = c, the GGX density D of alpha =
roughness^2 and Smith's V. The specular parts are those of `TorranceSparrow` with Schlick's F from
the mean of both F0, which is exact because Schlick's formula is linear in F0. The matt part keeps
(1 - F0) at all angles here. With an index of 1.5 its albedo is 0.5 % too high at a viewing angle of
60 degrees, and 2.2 % at 85. Source: Khronos, glTF 2.0 Specification, appendix B.
"""

import warnings
from typing import Any

import numpy as np

from ....errors import InputError
from .contents import Material

LEAST_ALPHA = 1e-6  # of a polished metal, as `TorranceSparrow` takes it


def material_of(material: Material, label: str) -> dict[str, Any]:
    """`family` and the other keys of a material; `label` is its name in messages. `InputError` for
    a transparent one without an exact counterpart."""
    surface, more = material.pbrMetallicRoughness, material.extensions
    colour, metal = np.array(surface.baseColorFactor[:3]), surface.metallicFactor
    factors = {
        "transmissionFactor": more.KHR_materials_transmission.transmissionFactor,
        "specularFactor": more.KHR_materials_specular.specularFactor,
    }
    for name, factor in factors.items():
        if factor not in (0, 1):
            raise InputError(f"{label}: {name} = {factor} is not read, only 0 and 1.")
    if factors["transmissionFactor"]:
        return _glass(material, label)
    if not factors["specularFactor"]:
        if metal:
            raise InputError(f"{label}: specularFactor 0 is not read with a metallicFactor.")
        return {"family": "lambert", "albedo": colour.tolist()}
    index = more.KHR_materials_ior.ior
    coat = ((index - 1) / (index + 1)) ** 2
    matt = (1 - metal) * (1 - coat) * colour
    if matt.any():
        warnings.warn(
            f"{label}: its coat lets (1 - F0) through at all angles, where glTF takes (1 - F): "
            "matt light is too bright at grazing angles.",
            stacklevel=2,
        )
    return {
        "family": "torrance_sparrow",
        "albedo": matt.tolist(),
        "f0": ((1 - metal) * coat + metal * colour).tolist(),
        "roughness": max(surface.roughnessFactor**2, LEAST_ALPHA),
    }


def _glass(material: Material, label: str) -> dict[str, Any]:
    """Smooth glass, clear or absorbing, around a volume."""
    surface, more = material.pbrMetallicRoughness, material.extensions
    volume = more.KHR_materials_volume
    smooth = surface.roughnessFactor == 0 and surface.metallicFactor == 0
    if not smooth or surface.baseColorFactor[:3] != (1, 1, 1) or not volume.thicknessFactor:
        raise InputError(
            f"{label}: of what transmits light, glass is read: roughnessFactor and metallicFactor "
            "0, a white baseColorFactor and a KHR_materials_volume with a thickness; make it so."
        )
    made = {"family": "glass", "index": more.KHR_materials_ior.ior}
    if volume.attenuationDistance is not None:
        left = np.array(volume.attenuationColor)
        if not left.all():
            raise InputError(f"{label}: an attenuationColor of 0 absorbs without end; raise it.")
        made["absorption"] = (-np.log(left) / volume.attenuationDistance + 0.0).tolist()
    return made


def emission_of(material: Material) -> np.ndarray:
    """Return the emission of a material, (3,) cd m^-2."""
    strength = material.extensions.KHR_materials_emissive_strength.emissiveStrength
    return strength * np.array(material.emissiveFactor)
