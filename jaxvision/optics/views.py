"""What a camera sees: the rays of each pixel.

Camera axes are right, down and forward; pixel (0, 0) is the upper left one and (row, column) its
centre, so the optical axis leaves between the middle pixels of an even grid. Lengths are metres.

A lens at distance z_i from the sensor shows at (x, y) on it what lies in the direction of the chief
ray, (x / z_i, y / z_i, 1). Through its point (a, b) goes

    origin (a, b, 0),   direction (x / z_i - a / z_f, y / z_i - b / z_f, 1)

with z_f the distance in focus: with reciprocals for distances infinity is no special case.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._numerics import norm, normalize
from .._types import Scalar
from .._vector import Vec, as_array, as_vec
from ..geometry import Ray
from ..scene import Orthographic, Pinhole, ThinLens, View
from .aperture import aperture_point
from .distortion import undistort
from .thin_lens import image_vergence


def look_at(
    position: Float[Array, "3"], target: Float[Array, "3"], up: Float[Array, "3"]
) -> Float[Array, "3 3"]:
    """Rotation of a camera at `position` that looks at `target`: rows right, down, forward.

    All (3,), metres; `up` is any vector not along the line of sight (there right and down are 0).
    """
    forward = as_array(normalize(target - position))
    right = as_array(normalize(jnp.cross(forward, up)))
    return jnp.stack([right, jnp.cross(forward, right), forward])


def pixel_grid(view: View) -> tuple[Float[Array, " h"], Float[Array, " w"]]:
    """(rows, columns): the pixel coordinates of the whole picture, in the view's dtype."""
    height, width = view.resolution
    dtype = view.pixel_pitch.dtype
    return jnp.arange(height, dtype=dtype), jnp.arange(width, dtype=dtype)


def pixel_offset(view: View, row: Scalar, column: Scalar) -> tuple[Scalar, Scalar]:
    """(right, down) of a pixel's centre from the optical axis, in m."""
    rows, columns = view.resolution
    x = (column + (1 - columns) / 2) * view.pixel_pitch
    y = (row + (1 - rows) / 2) * view.pixel_pitch
    return x, y


def sensor_vergence(view: Pinhole | ThinLens) -> Scalar:
    """1 / z_i in m^-1, the reciprocal of the distance from the hole or lens to the sensor."""
    if isinstance(view, Pinhole) or view.focus_distance is None:
        return 1 / view.focal_length
    return image_vergence(view.focus_distance, view.focal_length)


def focus_vergence(view: ThinLens) -> Scalar:
    """1 / z_f in m^-1, the reciprocal of the distance in focus: 0 at infinity."""
    if view.focus_distance is None:
        return jnp.zeros_like(view.focal_length)
    return 1 / view.focus_distance


def chief_slope(view: Pinhole | ThinLens, row: Scalar, column: Scalar) -> tuple[Scalar, Scalar]:
    """(right, down) in m per m forward of the ray from a pixel's centre through the middle of the
    hole or lens."""
    x, y = pixel_offset(view, row, column)
    vergence = sensor_vergence(view)
    if view.distortion is None:
        return x * vergence, y * vergence
    return undistort(view.distortion, x * vergence, y * vergence)


def camera_ray(view: View, row: Scalar, column: Scalar) -> Ray:
    """The ray that a pixel's centre sees, through the middle of a lens. `row`, `column`: ()
    pixels, may be fractional."""
    right, down, forward = (as_vec(axis) for axis in view.rotation)
    if isinstance(view, Orthographic):
        x, y = pixel_offset(view, row, column)
        return Ray(view.position + x * right + y * down, forward)
    x, y = chief_slope(view, row, column)
    return Ray(view.position, normalize(x * right + y * down + forward))


def lens_ray(view: ThinLens, row: Scalar, column: Scalar, u: Float[Array, "2"]) -> Ray:
    """The ray that a pixel's centre sees through one point of the aperture, chosen by `u`, (2,) in
    the unit square. `row`, `column`: () pixels, may be fractional.

    Rays of uniform u have equal shares of the opening: the mean of the radiance along them is what
    `pixel_irradiance` takes. What a rim cuts off is in the irradiance, not in these: a blurred
    point far off the axis is as dark as it should be, but has the shape of the aperture, not that
    of the cat's eye which the rim leaves of it.
    """
    right, down, forward = (as_vec(axis) for axis in view.rotation)
    radius = view.focal_length / view.f_number / 2
    a, b = (radius * part for part in aperture_point(view.aperture, u))
    x, y = chief_slope(view, row, column)
    focus = focus_vergence(view)
    origin = view.position + a * right + b * down
    return Ray(origin, normalize((x - a * focus) * right + (y - b * focus) * down + forward))


def view_ray(view: View, row: Scalar, column: Scalar, *, u: Float[Array, "2"] | None = None) -> Ray:
    """The ray of any view: `lens_ray` for a thin lens and a `u`, else `camera_ray`. `row`,
    `column`: () pixels, may be fractional."""
    if u is not None and isinstance(view, ThinLens):
        return lens_ray(view, row, column, u)
    return camera_ray(view, row, column)


def cos_to_axis(view: View, row: Scalar, column: Scalar) -> Scalar:
    """Cosine between a pixel's chief ray and the optical axis, in (0, 1], a unit vector's part."""
    if isinstance(view, Orthographic):
        return jnp.ones_like(view.pixel_pitch)
    x, y = chief_slope(view, row, column)
    return 1 / norm(Vec(x, y, jnp.ones_like(x)))
