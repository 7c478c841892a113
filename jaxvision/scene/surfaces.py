"""The records of materials, of surfaces, which have a shape and a material, and of a scene, which
has surfaces and lights."""

from collections.abc import Iterable
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from ..core._maps import maps_of
from ..core._shown import Shown
from ..core._types import (
    AMOUNT,
    Colour,
    as_optional_float,
    check_count,
    check_fields,
    check_kind,
    is_known,
)
from .light import AmbientLight, Light
from .maps import Map
from .shapes import Quad, Shape, Sphere, TriangleMesh


class Material(Shown):
    """Base class of all materials. Each file in `brdf/` contains the records and the equations of
    one family of BRDFs.

    Attributes:
        spectra: names of the fields that are spectra, one number for each band. A class sets it; a
            `Scene` then checks that all have the same number of bands.
        neutral_spectra: names of spectra that may also have a single value for all bands.
        takes_maps: whether a `Map` may replace the numbers of a field.

    Example:
        >>> jv.Lambert.spectra, jv.Mirror.neutral_spectra
        (('diffuse',), ('reflectance',))
    """

    spectra: ClassVar[tuple[str, ...]] = ()
    neutral_spectra: ClassVar[tuple[str, ...]] = ()
    takes_maps: ClassVar[bool] = True


class Surface(Shown):
    """A surface of a scene: its shape, its material and its emission.

    Attributes:
        shape: geometry of the surface.
        material: reflectance model of the surface; any of its parameters may be a `Map`.
        emission: (bands,) radiance of its front, equal in all directions, W m^-2 sr^-1, or None.
        two_sided: whether both sides are fronts, with the normal flipped towards the viewer;
            otherwise the back is black. Static.
        normals: a `Map` of (3,) shading normals of any length, or None. The x axis points along
            growing u, the z axis along the shape's normal n, and the y axis along n x x. On a mesh
            the y axis points to decreasing v, up in the picture, even if its texture coordinates
            are mirrored. If the mirror direction of the viewer would lie below the surface, the
            normal is bent until this direction grazes the surface.

    Raises:
        ValueError: for a map on a shape without texture coordinates, unless `Map.uv` places it, and
            for a shading normal of length 0.

    Example:
        A lamp shines only to its front.

        >>> lamp = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), jv.Lambert([0.5 / np.pi]), [2.0])
        >>> seen = (jv.Ray([0, 0, z], [0, 0, -z]) for z in (1, -1))
        >>> [float(jv.radiance_along(jv.Scene(lamp, []), ray)[0]) for ray in seen]
        [2.0, 0.0]
    """

    shape: Shape
    material: Material
    emission: Colour | None = eqx.field(converter=as_optional_float, default=None)
    two_sided: bool = eqx.field(static=True, default=False, kw_only=True)
    normals: Map | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, emission=AMOUNT)
        if self.normals is not None and self.normals.shape != (3,):
            raise ValueError(
                f"Surface.normals must be a Map of (3,) numbers, got {self.normals.shape}."
            )
        if self.normals is not None and is_known(self.normals.values):
            black = ~np.any(np.asarray(self.normals.values), axis=-1)
            if black.any():
                raise ValueError(
                    f"Surface.normals has {black.sum()} of {black.size} normals of length 0; a "
                    "flat surface has [0, 0, 1]."
                )
        own = isinstance(self.shape, Quad | Sphere) or (
            isinstance(self.shape, TriangleMesh) and self.shape.uv is not None
        )
        for name, found in maps_of(self):
            if not own and (found.uv is None or found.uv.shape[-1] != 4):
                kind = "TriangleMesh without uv" if isinstance(self.shape, TriangleMesh) else ""
                raise ValueError(
                    f"Surface.{name}: a {kind or type(self.shape).__name__} has no texture "
                    "coordinates; give Map.uv of (2, 4), from points of the world."
                )


def _as_tuple(records: eqx.Module | Iterable[Any]) -> tuple[Any, ...]:
    return (records,) if isinstance(records, eqx.Module) else tuple(records)


def _as_optional_tuple(values: Iterable[Any] | None) -> tuple[Any, ...] | None:
    return None if values is None else tuple(values)


class Scene(Shown):
    """A scene, which consists of surfaces and lights.

    All spectra of a scene must have the same number of bands. `Scene` checks the k_d of materials,
    emissions, lights and mirrors. The reflectance of a mirror may have a single band.

    Attributes:
        surfaces: at least one; a single record is accepted too.
        lights: any number; a single record is accepted too.
        ambient: uniform light from all directions, or None.
        occluders: indices of the surfaces that may block direct light; None for all; () for none,
            in which case no shadow rays are traced. In `transport`, which follows light from
            surface to surface, every surface blocks. Static.
        rules: sampling rule of each light: a `lights.Rule`, or None for the rule that is passed to
            the integrator. If `rules` is None, that rule is used for all lights.

    Example:
        >>> ball = jv.Surface(jv.Sphere([0, 0, 0], 1), jv.Lambert([0.5 / np.pi]))
        >>> scene = jv.Scene(ball, jv.PointLight([0, 0, 5], [64.0]))
        >>> down = jv.Ray([0, 0, 9], [0, 0, -1])
        >>> round(float(jv.radiance_along(scene, down)[0]), 4)  # 64 / 4^2 x 0.5 / pi
        0.6366
    """

    surfaces: tuple[Surface, ...] = eqx.field(converter=_as_tuple)
    lights: tuple[Light, ...] = eqx.field(converter=_as_tuple)
    ambient: AmbientLight | None = None
    occluders: tuple[int, ...] | None = eqx.field(
        converter=_as_optional_tuple, static=True, default=None, kw_only=True
    )
    rules: tuple[Any, ...] | None = eqx.field(
        converter=_as_optional_tuple, default=None, kw_only=True
    )

    def __check_init__(self) -> None:
        if not self.surfaces:
            raise ValueError("Scene.surfaces must hold at least one surface, got none.")
        for i, surface in enumerate(self.surfaces):
            check_kind(f"Scene.surfaces[{i}]", surface, Surface)
        for i, light in enumerate(self.lights):
            check_kind(f"Scene.lights[{i}]", light, Light)
        check_kind("Scene.ambient", self.ambient, AmbientLight)
        count = len(self.surfaces)
        for i in self.occluders or ():
            check_count("Scene.occluders", i, 0)
            if i >= count:
                raise ValueError(f"Scene.occluders must be numbers of {count} surfaces, got {i}.")
        if self.rules is not None and len(self.rules) != len(self.lights):
            raise ValueError(
                f"Scene.rules must hold a rule or None for each of {len(self.lights)} lights, got "
                f"{len(self.rules)}."
            )
        _check_bands(self)


def _check_bands(scene: Scene) -> None:
    """Raise `ValueError` unless all spectra of a scene have the same number of bands."""
    spectra, neutral = [], []
    for i, surface in enumerate(scene.surfaces):
        place = f"Scene.surfaces[{i}]"
        for found, names in (
            (spectra, surface.material.spectra),
            (neutral, surface.material.neutral_spectra),
        ):
            found += [(f"{place}.material.{n}", getattr(surface.material, n)) for n in names]
        if surface.emission is not None:
            spectra.append((f"{place}.emission", surface.emission))
    for i, light in enumerate(scene.lights):
        spectra += [
            (f"Scene.lights[{i}].{name}: its spectrum", getattr(light, name))
            for name in light.spectra
        ]
    if scene.ambient is not None:
        spectra.append(("Scene.ambient.radiance", scene.ambient.radiance))
    if not spectra:
        return
    bands = spectra[0][1].shape[-1]
    for name, spectrum in spectra:
        if spectrum.shape[-1] != bands:
            raise ValueError(f"{name} must have {bands} bands, got {spectrum.shape[-1]}.")
    for name, spectrum in neutral:
        if spectrum.shape[-1] not in (1, bands):
            raise ValueError(f"{name} must have 1 or {bands} bands, got {spectrum.shape[-1]}.")
