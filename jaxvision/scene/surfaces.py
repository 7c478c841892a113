"""Shapes with materials, and the scene they make with lights."""

from collections.abc import Iterable
from typing import Any

import equinox as eqx

from .._types import Colour, as_optional_float, check_kind, check_shape
from .light import AmbientLight, Light
from .shapes import Shape


class Material(eqx.Module):
    """What a surface is made of: the base of every family of BRDFs, whose record and equations
    share a file in `brdf/`."""


class Surface(eqx.Module):
    """A shape, what it is made of, and what it emits.

    `emission`: (bands,) W m^-2 sr^-1 that it shines, equally in all directions from its front, or
    None. `two_sided`: static; both sides are fronts, the normal turning to who looks. Without it
    a surface seen from behind is black.
    """

    shape: Shape
    material: Material
    emission: Colour | None = eqx.field(converter=as_optional_float, default=None)
    two_sided: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self) -> None:
        check_kind("Surface.shape", self.shape, Shape)
        check_kind("Surface.material", self.material, Material)
        check_shape("Surface.emission", self.emission, ("bands",))


def _as_tuple(records: eqx.Module | Iterable[Any]) -> tuple[Any, ...]:
    return (records,) if isinstance(records, eqx.Module) else tuple(records)


class Scene(eqx.Module):
    """Surfaces and the lights on them, or one alone. All spectra share one number of bands, which
    is checked here for the k_d of materials, for emissions and for lights, and for mirrors, which
    may be neutral."""

    surfaces: tuple[Surface, ...] = eqx.field(converter=_as_tuple)
    lights: tuple[Light, ...] = eqx.field(converter=_as_tuple)
    ambient: AmbientLight | None = None

    def __check_init__(self) -> None:
        if not self.surfaces:
            raise ValueError("Scene.surfaces must hold at least one surface, got none.")
        for i, surface in enumerate(self.surfaces):
            check_kind(f"Scene.surfaces[{i}]", surface, Surface)
        for i, light in enumerate(self.lights):
            check_kind(f"Scene.lights[{i}]", light, Light)
        check_kind("Scene.ambient", self.ambient, AmbientLight)
        spectra = {
            f"Scene.surfaces[{i}].material.diffuse": getattr(surface.material, "diffuse", None)
            for i, surface in enumerate(self.surfaces)
        }
        for i, surface in enumerate(self.surfaces):
            spectra[f"Scene.surfaces[{i}].emission"] = surface.emission
        for i, light in enumerate(self.lights):
            for field in ("intensity", "irradiance", "radiance"):
                spectra[f"Scene.lights[{i}].{field}: its spectrum"] = getattr(light, field, None)
        spectra["Scene.ambient.radiance"] = getattr(self.ambient, "radiance", None)
        bands = {name: x.shape[-1:] for name, x in spectra.items() if x is not None}
        first = next(iter(bands.values()), (1,))
        for name, got in bands.items():
            if got != first:
                raise ValueError(f"{name} must have {first[0]} bands, got {got[0]}.")
        for i, surface in enumerate(self.surfaces):
            reflectance = getattr(surface.material, "reflectance", None)
            if bands and reflectance is not None and reflectance.shape[-1] not in (1, first[0]):
                raise ValueError(
                    f"Scene.surfaces[{i}].material.reflectance must have 1 or {first[0]} bands, "
                    f"got {reflectance.shape[-1]}."
                )
