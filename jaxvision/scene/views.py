"""The records of a camera's projection, which gives the ray of each pixel."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from ..core._shown import Shown
from ..core._types import (
    FINITE,
    POSITIVE,
    Range,
    Scalar,
    as_float,
    as_optional_float,
    check_count,
    check_fields,
    check_range,
    check_rotation,
    is_known,
    print_by_name,
)
from ..core._warnings import warn_caller
from .folds import folded_share
from .lenses import (
    Aperture,
    CircularAperture,
    Diffraction,
    Distortion,
    Rim,
    Wavefront,
)


class Orthographic(Shown):
    """Parallel (telecentric) projection.

    Attributes:
        position: (3,) m, the centre of the picture.
        rotation: (3, 3) no unit, rows are the unit axes right, down and forward of the camera in
            the world.
        pixel_pitch: () m between pixels, in the scene, > 0.
        resolution: (rows, columns) pixels; static.
        f_number: () image-side, no unit, > 0; None returns radiance unchanged.

    Example:
        >>> view = jv.Orthographic([0, 0, 9], np.eye(3), 0.5, resolution=(3, 3))
        >>> ray = jv.camera_ray(view, jnp.array(1.0), jnp.array(2.0))
        >>> jv.as_array(ray.origin).tolist()
        [0.5, 0.0, 9.0]
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    pixel_pitch: Scalar = eqx.field(converter=as_float)
    resolution: tuple[int, int] = eqx.field(static=True, kw_only=True)
    f_number: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        _check_view(self)


class Pinhole(Shown):
    """Central projection through a pinhole, with everything in focus.

    Attributes:
        position: (3,) m, the hole.
        rotation: (3, 3) no unit, rows are the unit axes right, down and forward of the camera in
            the world.
        focal_length: () m from the hole to the sensor, > 0, at most the larger of 1 m and 1e6
            pitches.
        pixel_pitch: () m between pixels, on the sensor, > 0, at most 4 focal lengths.
        resolution: (rows, columns) pixels; static.
        f_number: () focal length over hole diameter, no unit, > 0; None returns radiance unchanged.
        distortion: of the image, or None.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(480, 640))
        >>> print(jv.camera_ray(view, jnp.array(239.5), jnp.array(319.5)).direction.z)
        1.0
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    focal_length: Scalar = eqx.field(converter=as_float)
    pixel_pitch: Scalar = eqx.field(converter=as_float)
    resolution: tuple[int, int] = eqx.field(static=True, kw_only=True)
    f_number: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    distortion: Distortion | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self) -> None:
        _check_view(self, focal_length=POSITIVE)


class ThinLens(Shown):
    """Central projection through a lens that is in focus at one distance.

    The sensor is at the image distance of the plane in focus.

    Attributes:
        position: (3,) m, the centre of the lens.
        rotation: (3, 3) no unit, rows are the unit axes right, down and forward of the camera in
            the world.
        focal_length: () m, > 0, at most the larger of 1 m and 1e6 pitches.
        pixel_pitch: () m between pixels, on the sensor, > 0, at most 4 focal lengths.
        resolution: (rows, columns) pixels; static.
        f_number: () focal length over the lens's diameter, no unit, > 0; inf closes the aperture.
        focus_distance: () m along the axis from the lens to the plane in focus, beyond the focal
            length; None or inf for infinity.
        aperture: its shape.
        rim: a second aperture that blocks oblique light, or None.
        distortion: of the image, or None.
        diffraction: `Diffraction` at a round aperture, or `Wavefront` for an aperture of any shape
            and for aberrations, or None.

    Example:
        >>> lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(1, 1), f_number=2.0)
        >>> zero = jnp.array(0.0)  # row and column of the only pixel, on the axis
        >>> ray = jv.lens_ray(lens, zero, zero, jnp.array([1.0, 0.5]))
        >>> round(float(jv.norm(ray.origin)), 4)  # on the rim: 0.05 / 2 / 2
        0.0125
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    focal_length: Scalar = eqx.field(converter=as_float)
    pixel_pitch: Scalar = eqx.field(converter=as_float)
    resolution: tuple[int, int] = eqx.field(static=True, kw_only=True)
    f_number: Scalar = eqx.field(converter=as_float, kw_only=True)
    focus_distance: Scalar | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    aperture: Aperture = eqx.field(default_factory=CircularAperture, kw_only=True)
    rim: Rim | None = eqx.field(default=None, kw_only=True)
    distortion: Distortion | None = eqx.field(default=None, kw_only=True)
    diffraction: Diffraction | Wavefront | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self) -> None:
        _check_view(self, focal_length=POSITIVE)
        if is_known(self.focal_length):
            nearest = float(self.focal_length)
            check_range(
                "ThinLens.focus_distance", self.focus_distance, nearest, above=True, finite=False
            )
        round_one = isinstance(self.aperture, CircularAperture)
        if isinstance(self.diffraction, Diffraction) and not round_one:
            kind = type(self.aperture).__name__
            raise ValueError(
                f"Diffraction needs a CircularAperture, got {kind}; give ThinLens.diffraction = "
                "Wavefront([0.0], wavelength), which has the pattern of any aperture."
            )


View = Orthographic | Pinhole | ThinLens
print_by_name(globals(), "View")
NARROWEST = (
    # Rad, smallest angle of a pixel for a focal length above 1 m; float32 rays resolve no smaller
    # one
    1e-6
)


WIDEST = 4.0  # largest side of a pixel in focal lengths


def _check_view(view: View, **ranges: Range) -> None:
    name = type(view).__name__
    f_number = Range(0, above=True, finite=False)
    check_fields(view, position=FINITE, pixel_pitch=POSITIVE, f_number=f_number, **ranges)
    if isinstance(view, Pinhole | ThinLens) and is_known(view.focal_length):
        length, pitch = view.focal_length, view.pixel_pitch
        if is_known(pitch) and float(length) > max(1, float(pitch) / NARROWEST):
            raise ValueError(
                f"{name}.focal_length must be in m (50 mm are 0.05), got {float(length):g} with a "
                f"pixel_pitch of {float(pitch):g} m: a pixel would see less than {NARROWEST:g} rad."
            )
        if is_known(pitch) and float(pitch) > WIDEST * float(length):
            raise ValueError(
                f"{name}.pixel_pitch must be in m (5 um are 5e-6), got {float(pitch):g} with a "
                f"focal_length of {float(length):g} m: one pixel would see more than 125 degrees."
            )
    check_rotation(f"{name}.rotation", view.rotation, "right, down and forward")
    if not isinstance(view.resolution, tuple) or len(view.resolution) != 2:
        raise ValueError(f"{name}.resolution must be (rows, columns), got {view.resolution!r}.")
    for size in view.resolution:
        check_count(f"{name}.resolution", size, 1)
    if isinstance(view, Pinhole | ThinLens) and view.distortion is not None:
        _name_folds(name, view, view.distortion)


def _name_folds(name: str, view: Pinhole | ThinLens, distortion: Distortion) -> None:
    """Warn if pixels of a single view lie beyond the fold of its distortion. Traced views are not
    checked."""
    focus = view.focus_distance if isinstance(view, ThinLens) else None
    sizes = view.focal_length, view.pixel_pitch, focus
    if not all(map(is_known, jax.tree.leaves((sizes, distortion)))):
        return
    if any(map(np.ndim, jax.tree.leaves(sizes))) or distortion.radial.ndim > 1:
        return  # a batch
    vergence = 1 / float(view.focal_length) - (0.0 if focus is None else 1 / float(focus))
    share = folded_share(distortion, float(view.pixel_pitch) * vergence, view.resolution)
    if share:
        warn_caller(
            f"{name}.distortion: {100 * share:.2g} % of the pixels lie beyond the fold of the "
            "distortion, where no light falls; correct the coefficients."
        )
