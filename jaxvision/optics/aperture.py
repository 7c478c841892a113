"""The aperture of a lens: its points, its area, and the image of a point out of focus.

Points are (right, down) in the camera's axes, relative to the radius of the lens. All functions are
closed forms and differentiable with respect to the shape.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide, or_one, safe_sqrt, smallest_divisor
from ..core._types import Scalar, check_count
from ..scene import (
    AnnularAperture,
    Aperture,
    CircularAperture,
    PolygonalAperture,
    RectangularAperture,
)
from .overlap import _segment


@takes_numbers
def aperture_point(aperture: Aperture, u: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Map the unit square to the aperture; equal areas map to equal areas.

    A disc uses the concentric map, which preserves neighbourhoods; a ring uses squared radius and
    angle; a polygon uses one triangle per blade.

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
            return _sample_polygon(aperture, u)


@takes_numbers
def aperture_area(aperture: Aperture, diameter: Scalar) -> Scalar:
    """Return the area of the aperture of a lens.

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
    """Return the corners of the aperture in order, from right towards down.

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
    """Return the kernel by which a pixel gathers light from points out of focus. The kernel has the
    shape of the aperture.

    Each weight is the share of the aperture's area that falls on that pixel.

    Args:
        aperture: the shape.
        radius: () pixels, radius of the image of the whole lens. A negative radius inverts the
            kernel, for light from behind the plane in focus (`defocus_radius`); 0 gives the
            identity.
        size: side of the kernel in pixels, odd, static. Light outside the kernel is cut off, and
            the weights are rescaled to sum 1.

    Returns:
        (size, size) weights of sum 1, no unit.

    Raises:
        ValueError: `size` is even.
    """
    check_count("size", size, 1, odd=True)
    radius = jnp.asarray(radius)
    # a radius of a hundredth of a pixel acts as a point and does not lose digits
    radius = jnp.where(jnp.abs(radius) <= _SMALLEST, _SMALLEST, radius)
    match aperture:
        case CircularAperture():
            covered = _disc_in_pixels(jnp.abs(radius), size)
        case AnnularAperture():
            outer = _disc_in_pixels(jnp.abs(radius), size)
            covered = outer - _disc_in_pixels(jnp.abs(radius) * aperture.obstruction, size)
        case PolygonalAperture() | RectangularAperture():
            x, y = aperture_corners(aperture, radius.dtype)
            starts = jnp.asarray(np.arange(size) - size / 2, radius.dtype)
            covered = _polygon_in_pixels(starts, radius * x, radius * y)
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


def _sample_polygon(aperture: PolygonalAperture, u: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Map the unit square to the polygon. u[0] selects the triangle between the centre and one
    side, and the position between the centre and this side; u[1] selects the position along the
    side."""
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


def _disc_in_pixels(radius: Scalar, size: int) -> Float[Array, "size size"]:
    """Return the area of a disc, centred at 0, inside each pixel of a square. Only one quadrant is
    computed.
    """
    away = np.abs(np.arange(size) - size // 2)
    outer = jnp.asarray(np.arange(size // 2 + 1) + 0.5, radius.dtype)
    inner = jnp.maximum(outer - 1, 0)
    in_row = jax.vmap(_disc_in_rectangle, in_axes=(None, 0, 0, None, None))
    quadrant = jax.vmap(in_row, in_axes=(None, None, None, 0, 0))(
        radius, inner, outer, inner, outer
    )
    halves = np.where(away == 0, 2, 1)  # a pixel on an axis has two equal halves
    return quadrant[away][:, away] * jnp.asarray(np.outer(halves, halves), radius.dtype)


@jax.custom_jvp
def _disc_in_rectangle(
    radius: Scalar, left: Scalar, right: Scalar, low: Scalar, high: Scalar
) -> Scalar:
    """Return the area of the disc where left < x < right and low < y < high, all bounds >= 0. The
    result is the sum of three parts that are never negative: the area left of the arc, the area
    below the arc's chord, and the segment beyond the chord.
    """
    (start_x, start_y), (end_x, end_y), angle = _arc(radius, left, right, low, high)
    full = (start_x - left) * (high - low)
    below = (end_x - start_x) * ((start_y - low) + (end_y - low)) / 2
    return full + below + radius * radius * _segment(angle / 2)


@_disc_in_rectangle.defjvp
def _disc_in_rectangle_jvp(primals, tangents):
    """Differentiate with respect to the radius: the derivative is the length of the arc inside the
    rectangle."""
    radius, *sides = primals
    _, _, angle = _arc(radius, *sides)
    return _disc_in_rectangle(*primals), radius * angle * tangents[0]


def _arc(
    radius: Scalar, left: Scalar, right: Scalar, low: Scalar, high: Scalar
) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar], Scalar]:
    """Return the upper and the lower end of the arc that a circle about 0 has inside a rectangle,
    and the angle of the arc at the centre, rad."""

    def reach(place: Scalar) -> Scalar:
        return safe_sqrt((radius - place) * (radius + place))

    above, under = reach(high), reach(low)
    beside, beyond = (jnp.clip(reach(x), low, high) for x in (left, right))
    start_x, start_y = jnp.clip(above, left, right), jnp.where(above > left, high, beside)
    end_x, end_y = jnp.clip(under, left, right), jnp.where(under < right, low, beyond)
    end_y = jnp.minimum(end_y, start_y)
    across, down = end_x - start_x, start_y - end_y
    chord = safe_sqrt(across * across + down * down)
    angle = 2 * jnp.arcsin(jnp.minimum(divide(chord, 2 * radius), 1))
    return (start_x, start_y), (end_x, end_y), angle


def _polygon_in_pixels(
    starts: Float[Array, " n"], x: Float[Array, " corners"], y: Float[Array, " corners"]
) -> Float[Array, "n n"]:
    """Return the area of a polygon inside each unit pixel whose upper left corner is at the given x
    and y. By Green's theorem the area is the integral of x dy around the polygon. Each side
    contributes its extent in y within the row times its mean x, clipped to the pixel.
    """

    def share(x0: Scalar, y0: Scalar, x1: Scalar, y1: Scalar, top: Scalar, left: Scalar) -> Scalar:
        run = y1 - y0
        level = jnp.abs(run) <= smallest_divisor(run.dtype)
        slope = divide(x1 - x0, run, ~level)
        enters, leaves = jnp.clip(y0, top, top + 1), jnp.clip(y1, top, top + 1)
        inside = _mean_within(x0 + (enters - y0) * slope, x0 + (leaves - y0) * slope, left)
        return jnp.where(level, 0, (leaves - enters) * inside)

    sides = jax.vmap(share, in_axes=(0, 0, 0, 0, None, None))
    pixels = jax.vmap(jax.vmap(sides, in_axes=(None,) * 5 + (0,)), in_axes=(None,) * 4 + (0, None))
    return pixels(x, y, jnp.roll(x, -1), jnp.roll(y, -1), starts, starts).sum(-1)


def _mean_within(a: Scalar, b: Scalar, left: Scalar) -> Scalar:
    """Return the mean of x from a to b, with each x clipped to [left, left + 1]. The mean is
    relative to the point of [left, left + 1] nearest to 0, so that small polygons have accurate
    areas.
    """
    right = left + 1
    origin = jnp.clip(0, left, right)
    low, high = jnp.minimum(a, b), jnp.maximum(a, b)
    enters, leaves = (low < left) & (high > left), (low < right) & (high > right)
    width = high - low
    run = jnp.maximum(width, smallest_divisor(width.dtype))
    of_right, of_left = ((x * x) / (2 * run) for x in (right - low, high - left))
    one_end = (right - origin) - of_right, (left - origin) + of_left
    both_ends = (left - origin) + ((high - left) - 0.5) / jnp.maximum(width, 0.5)
    inside = jnp.clip((low + high) / 2, left, right) - origin
    inside = jnp.where(leaves, one_end[0], jnp.where(enters, one_end[1], inside))
    return jnp.where(enters & leaves, both_ends, inside)
