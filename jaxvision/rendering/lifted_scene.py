"""Conversion of an RGB scene to the bands of a spectral camera. No other function converts
scenes."""

from dataclasses import fields, replace
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..colour_spaces.colour_data import illuminant, rgb_basis
from ..core._types import is_known
from ..errors import InputError
from ..scene import Map, Scene
from ..spectra import rgb_to_reflectance

# fields of materials and of their interfaces that are reflectances, or k_d in sr^-1
_REFLECTANCES = {
    *("diffuse", "specular", "ambient", "reflectance", "f0"),
    *("body_spectrum", "interface_spectrum"),
}
Record = TypeVar("Record", bound=eqx.Module)


def lift_scene(scene: Scene, wavelengths: Float[Array, " bands"], *, lamp: str = "D65") -> Scene:
    """Convert an RGB scene to the bands of a spectral camera, by the method of Mallett and Yuksel.

    A reflectance becomes the spectrum of `spectra.rgb_to_reflectance`, which has the given linear
    sRGB colour under D65. The spectrum of a light becomes the spectrum of `lamp` times the spectrum
    of the light's colour. The new spectrum is scaled so that the power of white light, the sum over
    its bands, is unchanged. Values with one band, which apply to all bands, are not changed. Other
    quantities that are equal in all three bands, such as an index of refraction, become values with
    one band.

    Many spectra have the same colour, and this method chooses a smooth one. Measured spectra are
    more accurate.

    Args:
        scene: a scene of three bands, the red, green and blue of linear sRGB. JAX must not trace
            its numbers.
        wavelengths: (bands,) m, as `camera.sensor.photon_conversion.wavelength`.
        lamp: name of the spectrum of white light, one of the names of `colour_data.illuminant`.

    Returns:
        The same scene in those bands.

    Raises:
        InputError: for a scene of other than three bands, and for quantities that RGB does not
            determine: an index of refraction, an absorption or a measured table that differs from
            band to band, or that is traced.

    Example:
        >>> red = jv.Surface(jv.Sphere([0, 0, 1], 0.3), jv.Lambert([0.2, 0.02, 0.02]))
        >>> scene = jv.Scene(red, jv.PointLight([0, 0, 0], [1.0, 1.0, 1.0]))
        >>> grid = jv.colour_spaces.wavelength_grid(first=400e-9, last=700e-9, step=100e-9)
        >>> lifted = jv.lift_scene(scene, grid)
        >>> print(*(f"{k_d:.3f}" for k_d in lifted.surfaces[0].material.diffuse))
        0.063 0.022 0.191 0.093
        >>> print(f"{lifted.lights[0].intensity.sum():.3f} W / sr, as in RGB")
        3.000 W / sr, as in RGB
    """
    wanted = jnp.asarray(wavelengths)
    basis, white = rgb_basis(wanted), illuminant(lamp, wanted)
    white = white * (3 / white.sum())

    def reflectance(place: str, rgb: Array) -> Array:
        if rgb.shape[-1] not in (1, 3):
            raise InputError(f"{place} has {rgb.shape[-1]} bands; only RGB, of three, is lifted.")
        return rgb if rgb.shape[-1] == 1 else rgb_to_reflectance(rgb, basis.astype(rgb.dtype))

    def light(place: str, rgb: Array) -> Array:
        if rgb.shape[-1] != 3:
            raise InputError(f"{place} has {rgb.shape[-1]} bands; only RGB, of three, is lifted.")
        return reflectance(place, rgb) * white.astype(rgb.dtype)

    def material(place: str, record: Record) -> Record:
        """Return a material, or one of its parts, with its RGB spectra converted to the new
        bands."""
        changed: dict[str, Any] = {}
        for field in fields(record):
            name, value = field.name, getattr(record, field.name)
            inside = f"{place}.{name}"
            if isinstance(value, Map):
                lift = reflectance if name in _REFLECTANCES else _neutral
                spectral = value.shape == (3,)
                texels = lift(inside, value.values) if spectral else value.values
                changed[name] = replace(value, values=texels)
            elif isinstance(value, eqx.Module):
                changed[name] = material(inside, value)
            elif isinstance(value, Array) and name in _REFLECTANCES:
                changed[name] = reflectance(inside, value)
            elif isinstance(value, Array) and value.shape[-1:] == (3,):
                changed[name] = _neutral(inside, value)
        return replace(record, **changed)

    surfaces = [
        replace(
            own,
            material=material(f"Scene.surfaces[{i}].material", own.material),
            emission=None
            if own.emission is None
            else light(f"Scene.surfaces[{i}].emission", own.emission),
        )
        for i, own in enumerate(scene.surfaces)
    ]
    lights = [
        replace(own, **{n: light(f"Scene.lights[{i}].{n}", getattr(own, n)) for n in own.spectra})
        for i, own in enumerate(scene.lights)
    ]
    ambient = scene.ambient
    if ambient is not None:
        ambient = replace(ambient, radiance=light("Scene.ambient.radiance", ambient.radiance))
    return replace(scene, surfaces=surfaces, lights=lights, ambient=ambient)


def _neutral(place: str, value: Array) -> Array:
    """Return the value that all three bands have in common, (..., 1)."""
    if not is_known(value) or bool((value != value[..., :1]).any()):
        raise InputError(
            f"{place} differs from band to band, and RGB does not tell its spectrum; give it at "
            "the camera's wavelengths."
        )
    return value[..., :1]
