"""Convert glTF's materials to the tables `[material.NAME]` of a scene file.

A glTF material of base colour c and metallic factor m mixes a coated matte body and a metal: f = (1
- m) ((1 - F) c / pi + F D V) + m F_m D V. Here F is Schlick's reflectance of the coat with F0 =
((ior - 1) / (ior + 1))^2, F_m Schlick's reflectance of the metal with F0 = c, D the GGX density of
alpha = roughness^2, and V Smith's visibility. The specular parts become a `TorranceSparrow` with
Schlick's F, whose F0 is the mean of the two values of F0, weighted by 1 - m and m. This conversion
of the specular parts is exact because Schlick's formula is linear in F0. The matte part has the
factor (1 - F0) at all angles, instead of (1 - F). For an index of 1.5 the matte light is therefore
0.5 % too bright at a viewing angle of 60 degrees, and 2.2 % at 85 degrees. Textures are multiplied
texel by texel, and the product is interpolated bilinearly. glTF interpolates each texture first and
multiplies the results. Source: Khronos, glTF 2.0 Specification, appendix B.
"""

from typing import Any

import numpy as np

from ....core._warnings import warn
from ....errors import InputError
from ...gltf import Gltf
from .contents import Content, Material
from .textures import match_sizes, texels_of

LEAST_ALPHA = 1e-6  # alpha of a polished metal, the smallest that `TorranceSparrow` accepts


def material_of(file: Gltf, content: Content, material: Material, label: str) -> dict[str, Any]:
    """Return `family` and the other keys of a material's table. `label` is the name of the material
    in messages. Raise `InputError` for a transparent material without an exact counterpart."""
    surface, more = material.pbrMetallicRoughness, material.extensions
    colour, metal = np.array(surface.baseColorFactor[:3]), np.array(surface.metallicFactor)
    rough = np.array(surface.roughnessFactor)
    of_colour = texels_of(file, content, surface.baseColorTexture, label, srgb=True)
    of_rest = texels_of(file, content, surface.metallicRoughnessTexture, label)
    if material.occlusionTexture is not None:
        warn(f"{label}: occlusionTexture is not used, since shadows are computed.")
    if of_colour is not None and of_rest is not None:
        first, second = match_sizes(of_colour, of_rest, label)
        of_colour, of_rest = (first, of_colour[1]), (second, of_rest[1])
    keys = (of_colour or of_rest or (None, {}))[1]
    if of_colour is not None:
        colour = colour * of_colour[0]
    if of_rest is not None:
        rough, metal = rough * of_rest[0][..., 1], metal * of_rest[0][..., 2:]

    def numbers(values: np.ndarray, axes: int) -> Any:
        """Return numbers of the material as a list, or as the table of a map if a texture varies
        them."""
        return values.tolist() if values.ndim == axes else {"texels": values, **keys}

    factors = {
        "transmissionFactor": more.KHR_materials_transmission.transmissionFactor,
        "specularFactor": more.KHR_materials_specular.specularFactor,
    }
    for name, factor in factors.items():
        if factor not in (0, 1):
            raise InputError(f"{label}: {name} = {factor} is not read, only 0 and 1.")
    if factors["transmissionFactor"]:
        if keys:
            raise InputError(f"{label}: textures of what transmits light are not read.")
        return _glass(material, label)
    if not factors["specularFactor"]:
        if metal.any():
            raise InputError(f"{label}: specularFactor 0 is not read with a metallicFactor.")
        return {"family": "lambert", "albedo": numbers(colour, 1)}
    index = more.KHR_materials_ior.ior
    coat = ((index - 1) / (index + 1)) ** 2
    matt = (1 - metal) * (1 - coat) * colour
    if matt.any():
        warn(
            f"{label}: its coat lets (1 - F0) through at all angles, where glTF takes (1 - F): "
            "matte light is too bright at grazing angles."
        )
    return {
        "family": "torrance_sparrow",
        "albedo": numbers(matt, 1),
        "f0": numbers((1 - metal) * coat + metal * colour, 1),
        "roughness": numbers(np.maximum(rough**2, LEAST_ALPHA), 0),
    }


def normals_of(
    file: Gltf, content: Content, material: Material, label: str
) -> dict[str, Any] | None:
    """Return the table of a material's normal map, or None if it has none."""
    used = material.normalTexture
    found = texels_of(file, content, used, label)
    if found is None or used is None:
        return None
    return {"texels": (2 * found[0] - 1) * [used.scale, used.scale, 1], **found[1]}


def _glass(material: Material, label: str) -> dict[str, Any]:
    """Convert a transmissive material to smooth glass that encloses a volume."""
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
    """Return the radiance that a material emits, (3,), as luminance in cd m^-2."""
    strength = material.extensions.KHR_materials_emissive_strength.emissiveStrength
    return strength * np.array(material.emissiveFactor)
