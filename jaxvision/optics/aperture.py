"""The aperture of a lens: points in it, its area, and the image it makes of a point out of focus.

Points are (right, down) in the camera's axes, relative to the radius of the lens. Everything is in
closed form and differentiable in the shape.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arguments import takes_numbers
from .._numerics import arctan2, divide, or_one, safe_sqrt, smallest_divisor
from .._types import Scalar, Scalars, check_count
from ..scene import (
    AnnularAperture,
    Aperture,
    CircularAperture,
    PolygonalAperture,
    RectangularAperture,
)


@takes_numbers
def aperture_point(aperture: Aperture, u: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Maps the unit square to the aperture; equal areas map to equal areas.

    A disc uses the concentric map, which keeps neighbours together; a ring squared radius and
    angle; a polygon one triangle per blade.

    Args:
        aperture: the shape.
        u: (2,) in the unit square, no unit.

    Returns:
        (right, down), each (), relative to the radius of the lens.

    Source:
        Shirley and Chiu, "A Low Distortion Map between Disk and Square", Journal of Graphics Tools
        2 (1997).
    """
    match aperture:
        case CircularAperture():
            return _concentric(u)
        case AnnularAperture():
            inner = aperture.obstruction * aperture.obstruction
            radius = safe_sqrt(inner + (1 - inner) * u[0])
            return radius * jnp.cos(2 * jnp.pi * u[1]), radius * jnp.sin(2 * jnp.pi * u[1])
        case RectangularAperture():
            return (2 * u[0] - 1) * aperture.width, (2 * u[1] - 1) * aperture.height
        case PolygonalAperture():
            return _in_polygon(aperture, u)


@takes_numbers
def aperture_area(aperture: Aperture, diameter: Scalar) -> Scalar:
    """Area of the aperture of a lens.

    Args:
        aperture: the shape.
        diameter: () m, of the lens.

    Returns:
        () m^2.

    Example:
        >>> round(float(jv.optics.aperture_area(jv.PolygonalAperture(6), jnp.array(2.0))), 4)
        2.5981
    """
    square = diameter * diameter / 4
    match aperture:
        case CircularAperture():
            return jnp.pi * square
        case AnnularAperture():
            return jnp.pi * (1 - aperture.obstruction * aperture.obstruction) * square
        case RectangularAperture():
            return 4 * aperture.width * aperture.height * square
        case PolygonalAperture():
            n = aperture.blades
            return float(n / 2 * np.sin(2 * np.pi / n)) * square


def aperture_corners(
    aperture: PolygonalAperture | RectangularAperture, dtype: np.dtype
) -> tuple[Float[Array, " corners"], Float[Array, " corners"]]:
    """Corners of the aperture in turn, from right towards down.

    Args:
        aperture: the shape.
        dtype: floating dtype of the result.

    Returns:
        (right, down), each (corners,), relative to the radius of the lens.
    """
    if isinstance(aperture, RectangularAperture):
        signs = jnp.asarray([[1, -1, -1, 1], [1, 1, -1, -1]], dtype)
        return signs[0] * aperture.width, signs[1] * aperture.height
    angles = jnp.asarray(2 * np.pi / aperture.blades * np.arange(aperture.blades), dtype)
    angles = angles if aperture.angle is None else angles + aperture.angle
    return jnp.cos(angles), jnp.sin(angles)


@takes_numbers
def aperture_kernel(aperture: Aperture, radius: Scalar, *, size: int) -> Float[Array, "size size"]:
    """Kernel by which a pixel gathers a point out of focus: the shape of the aperture.

    Each weight is the share of the aperture that falls on that pixel.

    Args:
        aperture: the shape.
        radius: () pixels, of the image of the lens's edge. A negative radius inverts the kernel, as
            for light from behind the plane in focus (`defocus_radius`); 0 gives the identity.
        size: side of the kernel in pixels, odd, static. The part outside is cut off and the rest
            rescaled.

    Returns:
        (size, size) weights of sum 1, no unit.

    Raises:
        ValueError: `size` is even.
    """
    check_count("size", size, 1, odd=True)
    radius = jnp.asarray(radius)
    # a kernel of a hundredth of a pixel is a point and does not lose digits
    radius = jnp.where(jnp.abs(radius) <= _SMALLEST, _SMALLEST, radius)
    edges = jnp.asarray(np.arange(size + 1) - size / 2, radius.dtype)
    match aperture:
        case CircularAperture():
            covered = _disc_in_pixels(edges, jnp.abs(radius))
        case AnnularAperture():
            outer = _disc_in_pixels(edges, jnp.abs(radius))
            covered = outer - _disc_in_pixels(edges, jnp.abs(radius) * aperture.obstruction)
        case PolygonalAperture() | RectangularAperture():
            x, y = aperture_corners(aperture, radius.dtype)
            covered = _polygon_in_pixels(edges, radius * x, radius * y)
    total = covered.sum()
    return covered / or_one(total, ~(total <= smallest_divisor(total.dtype)))


_SMALLEST = 0.01


def _concentric(u: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    a, b = 2 * u[0] - 1, 2 * u[1] - 1
    wide = jnp.abs(a) > jnp.abs(b)
    radius, other = jnp.where(wide, a, b), jnp.where(wide, b, a)
    usable = jnp.abs(radius) > smallest_divisor(u.dtype)
    angle = divide(jnp.pi / 4 * other, radius, usable)
    along, across = radius * jnp.cos(angle), radius * jnp.sin(angle)
    return jnp.where(wide, along, across), jnp.where(wide, across, along)


def _in_polygon(aperture: PolygonalAperture, u: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """u[0] chooses the triangle between the centre and one side, and the place from its centre to
    that side; u[1] the place along the side.
    """
    n = aperture.blades
    blade = jnp.minimum(jnp.floor(u[0] * n), n - 1)
    outwards = safe_sqrt(u[0] * n - blade)
    start = 2 * jnp.pi / n * blade
    start = start if aperture.angle is None else start + aperture.angle
    end = start + 2 * jnp.pi / n
    first, second = outwards * (1 - u[1]), outwards * u[1]
    return (
        first * jnp.cos(start) + second * jnp.cos(end),
        first * jnp.sin(start) + second * jnp.sin(end),
    )


def _disc_in_pixels(edges: Float[Array, " n"], radius: Scalar) -> Float[Array, "m m"]:
    """Area of a disc about 0 in each pixel between the edges: the second differences of its area in
    the rectangles between 0 and the corners.
    """
    size = jnp.abs(edges)
    area = _disc_in_rectangle(radius, size[:, None], size[None, :])
    signed = jnp.sign(edges)[:, None] * jnp.sign(edges)[None, :] * area
    return jnp.diff(jnp.diff(signed, axis=0), axis=1)


def _disc_in_rectangle(radius: Scalar, width: Scalars, height: Scalars) -> Scalars:
    """Area of the disc where 0 < x < width and 0 < y < height: two triangles and a sector, or the
    whole rectangle.
    """
    a, b = jnp.minimum(width, radius), jnp.minimum(height, radius)
    square = radius * radius
    whole = a * a + b * b <= square
    beside_a, beside_b = safe_sqrt(square - a * a), safe_sqrt(square - b * b)
    sector = arctan2(b + 0 * a, beside_b + 0 * a) - arctan2(beside_a + 0 * b, a + 0 * b)
    return jnp.where(whole, a * b, (a * beside_a + b * beside_b + square * sector) / 2)


def _polygon_in_pixels(
    edges: Float[Array, " n"], x: Float[Array, " corners"], y: Float[Array, " corners"]
) -> Float[Array, "m m"]:
    """Area of a polygon in each pixel between the edges.

    Green's theorem: a pixel's share is the integral of x dy around it. Each side of the polygon
    contributes its run in y within the pixel's row times the mean of x in the pixel along that run.
    """
    start = edges[:-1]

    def share(x0: Scalar, y0: Scalar, x1: Scalar, y1: Scalar, top: Scalar, left: Scalar) -> Scalar:
        run = y1 - y0
        level = jnp.abs(run) <= smallest_divisor(run.dtype)
        slope = divide(x1 - x0, run, ~level)
        enters, leaves = jnp.clip(y0, top, top + 1), jnp.clip(y1, top, top + 1)
        a, b = x0 + (enters - y0) * slope - left, x0 + (leaves - y0) * slope - left
        inside = _mean_above(a, b) - _mean_above(a - 1, b - 1)
        return jnp.where(level, 0, (leaves - enters) * inside)

    sides = jax.vmap(share, in_axes=(0, 0, 0, 0, None, None))
    pixels = jax.vmap(jax.vmap(sides, in_axes=(None,) * 5 + (0,)), in_axes=(None,) * 4 + (0, None))
    return pixels(x, y, jnp.roll(x, -1), jnp.roll(y, -1), start, start).sum(-1)


def _mean_above(a: Scalar, b: Scalar) -> Scalar:
    """The mean of max(t, 0) for t from a to b."""
    low, high = jnp.minimum(a, b), jnp.maximum(a, b)
    crosses = (low < 0) & (high > 0)
    return divide(high * high, 2 * (high - low), crosses, jnp.maximum(low + high, 0) / 2)
