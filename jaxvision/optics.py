"""What a camera sees: the ray of each pixel, and radiance to irradiance on the sensor.

Camera axes are right, down and forward; pixel (0, 0) is the upper left one and (row, column) its
centre, so the optical axis leaves between the middle pixels of an even grid. Lengths are metres.
cos^4 is applied once, here in the irradiance, never in a ray's weight.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._numerics import norm, normalize
from ._types import Colour, Image, Scalar
from ._vector import Vec, as_array, as_vec
from .geometry import Ray
from .scene import Orthographic, Pinhole, View


def look_at(
    position: Float[Array, "3"], target: Float[Array, "3"], up: Float[Array, "3"]
) -> Float[Array, "3 3"]:
    """Rotation of a camera at `position` that looks at `target`: rows right, down, forward.

    All (3,), metres; `up` is any vector not along the line of sight (there right and down are 0).
    """
    forward = as_array(normalize(target - position))
    right = as_array(normalize(jnp.cross(forward, up)))
    return jnp.stack([right, jnp.cross(forward, right), forward])


def pixel_offset(view: View, row: Scalar, column: Scalar) -> tuple[Scalar, Scalar]:
    """(right, down) of a pixel's centre from the optical axis, in units of `pixel_pitch`."""
    rows, columns = view.resolution
    x = (column + (1 - columns) / 2) * view.pixel_pitch
    y = (row + (1 - rows) / 2) * view.pixel_pitch
    return x, y


def camera_ray(view: View, row: Scalar, column: Scalar) -> Ray:
    """The ray that a pixel's centre sees. `row`, `column`: () pixels, may be fractional."""
    right, down, forward = (as_vec(axis) for axis in view.rotation)
    x, y = pixel_offset(view, row, column)
    match view:
        case Orthographic():
            return Ray(view.position + x * right + y * down, forward)
        case Pinhole():
            return Ray(view.position, normalize(x * right + y * down + view.focal_length * forward))


def cos_to_axis(view: View, row: Scalar, column: Scalar) -> Scalar:
    """Cosine between a pixel's ray and the optical axis, in (0, 1]."""
    match view:
        case Orthographic():
            return jnp.ones_like(view.pixel_pitch)
        case Pinhole():
            x, y = pixel_offset(view, row, column)
            return view.focal_length / norm(Vec(x, y, view.focal_length))


def pixel_irradiance(view: View, radiance: Colour, row: Scalar, column: Scalar) -> Colour:
    """E = pi L cos^4 / (4 N^2): irradiance (bands,) in W m^-2 at a pixel that sees `radiance`
    (bands,) in W m^-2 sr^-1 through a hole of f-number N.

    The hole, of area pi f^2 / (4 N^2), is small, at distance f / cos, and inclined to both the ray
    and the sensor (Szeliski, Computer Vision, section 2.2.3). Without an f-number the radiance is
    handed on as it is, and nothing falls off.
    """
    if view.f_number is None:
        return radiance
    return radiance * (jnp.pi * cos_to_axis(view, row, column) ** 4 / (4 * view.f_number**2))


def pixel_grid(view: View) -> tuple[Float[Array, " h"], Float[Array, " w"]]:
    """(rows, columns): the pixel coordinates of the whole picture, in the view's dtype."""
    height, width = view.resolution
    dtype = view.pixel_pitch.dtype
    return jnp.arange(height, dtype=dtype), jnp.arange(width, dtype=dtype)


def sensor_irradiance(view: View, radiance: Image) -> Image:
    """`pixel_irradiance` of a whole picture: (h, w, bands) to (h, w, bands) in W m^-2."""
    over_columns = jax.vmap(pixel_irradiance, in_axes=(None, 0, None, 0))
    over_rows = jax.vmap(over_columns, in_axes=(None, 0, 0, None))
    return over_rows(view, radiance, *pixel_grid(view))
