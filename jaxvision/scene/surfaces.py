"""Surfaces made of a shape and a material, and the scene they form with lights."""

from collections.abc import Iterable
from typing import Any

import equinox as eqx

from .._types import Colour, as_optional_float, check_kind, check_shape
from .light import AmbientLight, Light
from .shapes import Shape


class Material(eqx.Module):
    """Base of every family of BRDFs; the record and the equations of a family share a file in
    `brdf/`.
    """


class Surface(eqx.Module):
    """A shape, its material and its emission.

    Attributes:
        shape: where it is.
        material: how it reflects.
        emission: (bands,) W m^-2 sr^-1 emitted from its front, equally in all directions, or None.
        two_sided: both sides are fronts, with the normal turned towards the viewer; otherwise a
            surface seen from behind is black. Static.
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
    """Surfaces and the lights on them.

    All spectra share one number of bands. This is checked here for the k_d of materials, emissions,
    lights and mirrors; a mirror may have one band for all.

    Attributes:
        surfaces: at least one; a single record is accepted too.
        lights: any number; a single record is accepted too.
        ambient: uniform light from all directions, or None.
    """

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
