"""Where each pixel looks: the projections of a camera."""

import equinox as eqx
from jaxtyping import Array, Float

from .._types import Scalar, as_float, as_optional_float, check_shape


class Orthographic(eqx.Module):
    """Parallel (telecentric) projection.

    `position`: (3,) m, the centre of the picture. `rotation`: (3, 3), rows the unit axes right,
    down and forward of the camera in the world. `pixel_pitch`: () m between pixels, in the scene.
    `resolution`: (rows, columns), static. `f_number`: () image-side, or None: radiance is handed
    on as it is.
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    pixel_pitch: Scalar = eqx.field(converter=as_float)
    resolution: tuple[int, int] = eqx.field(static=True, kw_only=True)
    f_number: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        _check_view(self)


class Pinhole(eqx.Module):
    """Central projection through a small hole.

    `position`: (3,) m, the hole. `rotation`: (3, 3), rows the unit axes right, down and forward of
    the camera in the world. `focal_length`: () m from the hole to the sensor. `pixel_pitch`: () m
    between pixels, on the sensor. `resolution`: (rows, columns), static. `f_number`: () focal
    length over hole diameter, or None: radiance is handed on as it is.
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    focal_length: Scalar = eqx.field(converter=as_float)
    pixel_pitch: Scalar = eqx.field(converter=as_float)
    resolution: tuple[int, int] = eqx.field(static=True, kw_only=True)
    f_number: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        _check_view(self)
        check_shape("Pinhole.focal_length", self.focal_length, ())


View = Orthographic | Pinhole


def _check_view(view: View) -> None:
    name = type(view).__name__
    check_shape(f"{name}.position", view.position, (3,))
    check_shape(f"{name}.rotation", view.rotation, (3, 3))
    check_shape(f"{name}.pixel_pitch", view.pixel_pitch, ())
    check_shape(f"{name}.f_number", view.f_number, ())
    if len(view.resolution) != 2 or min(view.resolution) < 1:
        raise ValueError(f"{name}.resolution must be (rows, columns) >= 1, got {view.resolution}.")
