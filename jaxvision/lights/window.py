"""A parallelogram in space: its intersection with a ray, and a map from the unit square to
directions from a point toward it. The density of these directions is nearly uniform even for a near
point.

Lengths are in metres. All functions are for one point or ray; use `jax.vmap` for many.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Source, box_corners, numbers, peak, unit
from ..core._numerics import (
    divide,
    dot,
    log1p,
    norm,
    normalize,
    or_one,
    safe_sqrt,
    smallest_divisor,
)
from ..core._shown import Shown
from ..core._types import Scalar, as_float, check_fields
from ..core._vector import Direction, Vec, Vector, as_vec
from ..geometry import Ray
from ..geometry.flat import flat_quad, line_crossing
from ..geometry.hemisphere import cross
from ..scene import Quad


class Window(Shown):
    """A parallelogram in space; its front is the side of edge_u x edge_v.

    Attributes:
        corner: (3,) m.
        edge_u: (3,) m, from the corner along one side.
        edge_v: (3,) m, along the other side.

    Example:
        >>> near, far = (jv.Window([0, 0, z], [1, 0, 0], [0, 1, 0]) for z in (0, -1))
        >>> light_field = jv.LightFieldLight(jnp.full((1, 1, 2, 2, 1), 3.0), near, far)
        >>> ray = jv.Ray([0.5, 0.5, 2], [0, 0, -1])
        >>> float(jv.lights.radiance_along(light_field, ray).distance)  # to the aperture
        2.0
    """

    corner: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_u: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_v: Float[Array, "3"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self)


class Crossing(eqx.Module):
    """The intersection of a ray's line with the plane of a window."""

    distance: Scalar  # () m along the ray, of either sign
    u: Scalar  # () position along edge_u, 0 to 1 inside, no unit
    v: Scalar  # () position along edge_v, 0 to 1 inside, no unit
    facing: Scalar  # () cosine between the reversed ray and the normal of the window's front
    meets: Array  # () whether the ray is not parallel to the plane


def crossing(ray: Ray, window: Window) -> Crossing:
    """Return the intersection of a ray's line with the plane of a window: the distance in m, and
    the position in units of the edges."""
    flat = flat_quad(Quad(window.corner, window.edge_u, window.edge_v))
    height, slope, u, v = line_crossing(ray, flat)
    meets = slope > smallest_divisor(slope.dtype)
    inverse = divide(1, slope, where=meets)
    facing = -dot(flat.normal, ray.direction)
    return Crossing(height * inverse, u * inverse, v * inverse, facing, meets)


def hit_window(ray: Ray, window: Window) -> tuple[Crossing, Array]:
    """Return the intersection of a ray's line with a window's plane, and whether the ray hits the
    front of the window at a positive distance, m."""
    at = crossing(ray, window)
    inside = (at.u >= 0) & (at.u <= 1) & (at.v >= 0) & (at.v <= 1)
    return at, at.meets & inside & (at.distance > 0) & (at.facing > 0)


class Spread(eqx.Module):
    """A map from u in [0, 1] to an interval of a line that begins at `start` and has the length
    `length`: x = scale sinh(p + u span), relative to the foot of a perpendicular. `start`, `length`
    and `scale` are () in m; `base` is exp(p)."""

    start: Scalar
    length: Scalar
    scale: Scalar
    base: Scalar
    span: Scalar


def _map_interval(start: Scalar, length: Scalar, scale: Scalar) -> Spread:
    """Return the map to an interval whose ends, in units of `scale`, are a and b. With A =
    exp(asinh(a)) = a + sqrt(1 + a^2) and B = exp(asinh(b)), the span is log(B / A). All sums are of
    numbers of equal sign, so nothing cancels even for a short distant interval."""
    a, step = start / scale, length / scale
    b = a + step
    across_a, across_b = jnp.sqrt(1 + a * a), jnp.sqrt(1 + b * b)
    base, last = _exp_asinh(a, across_a), _exp_asinh(b, across_b)
    lean = (a + b) / (across_a + across_b)
    growth = jnp.where(lean < 0, step * (1 - lean) * last, step * (1 + lean) / base)  # B / A - 1
    return Spread(start, length, scale, base, log1p(growth))


def _exp_asinh(x: Scalar, across: Scalar) -> Scalar:
    """Return exp(asinh(x)), where `across` is sqrt(1 + x^2); no unit."""
    return jnp.where(x < 0, divide(1, across - x, where=x < 1), across + x)


def _place(spread: Spread, u: Scalar) -> tuple[Scalar, Scalar]:
    """Return the fraction of the interval at `u`, and its derivative with respect to u."""
    grown = jnp.expm1(u * spread.span)
    there = spread.base * (1 + grown)  # exp(p + u span)
    factor = spread.scale / (2 * spread.length)
    fraction = factor * grown * (spread.base + 1 / there)
    return fraction, factor * spread.span * (there + 1 / there)


def _density(spread: Spread, fraction: Scalar) -> Scalar:
    """Return the derivative of u with respect to the fraction of the interval, at a given
    `fraction`. The result is the inverse of the derivative that `_place` returns."""
    position = spread.start + fraction * spread.length
    return spread.length / (spread.span * safe_sqrt(spread.scale**2 + position**2))


def _spreads(window: Window, point: Vector) -> tuple[Spread, Spread]:
    """Return the map to each of the two edges of a window. The scale of a map is the distance from
    the point to the nearest line of the window parallel to the edge, where 1 / d^2 is largest."""
    toward = as_vec(window.corner - as_vec(point))
    normal = normalize(cross(window.edge_u, window.edge_v))
    height = dot(normal, toward)
    lengths, starts, gaps = [], [], []
    for edge in (window.edge_u, window.edge_v):
        length = or_one(norm(edge))
        start = dot(edge, toward) / length
        starts.append(start)
        lengths.append(length)
        gaps.append(jnp.maximum(jnp.maximum(start, -start - length), 0))
    # at least 1 / 64 of the edge, so that the map is defined for points of the window itself
    scales = [
        jnp.maximum(norm(Vec(height, gap, 0 * gap)), length / 64)
        for gap, length in zip(gaps[::-1], lengths, strict=True)
    ]
    u, v = (_map_interval(*of) for of in zip(starts, lengths, scales, strict=True))
    return u, v


def window_sample(
    window: Window, point: Vector, u: Float[Array, "2"]
) -> tuple[Vec, Scalar, Scalar, Float[Array, "2"]]:
    """Map `u`, (2,) in [0, 1], to a position in a window, more densely where the window is near: x
    = D sinh(p + u q) along each edge, with the `Spread` D, p, q of that edge (Johnston & Elliott,
    Int. J. Numer. Meth. Engng 62 (2005)). Return the unit direction, the distance, m, the solid
    angle per unit of the square, sr (0 for a point behind the window), and the position, (2,) in
    [0, 1]."""
    spread_u, spread_v = _spreads(window, point)
    s, jacobian_u = _place(spread_u, u[0])
    t, jacobian_v = _place(spread_v, u[1])
    toward = window.corner - as_vec(point) + s * as_vec(window.edge_u) + t * as_vec(window.edge_v)
    distance = norm(toward)
    apart = distance > smallest_divisor(distance.dtype)
    nearness = divide(1, distance, where=apart)
    direction = toward * nearness
    projected = -dot(cross(window.edge_u, window.edge_v), direction)
    solid_angle = jnp.maximum(projected, 0) * nearness * nearness * jacobian_u * jacobian_v
    return direction, distance, solid_angle, jnp.stack([s, t])


def window_pdf(window: Window, point: Vector, wi: Direction) -> Scalar:
    """Return the density of the directions that `window_sample` returns for uniform `u`, () in
    sr^-1; 0 if `wi` misses the front of the window."""
    at, hit = hit_window(Ray(point, wi), window)
    spread_u, spread_v = _spreads(window, point)
    per_place = _density(spread_u, at.u) * _density(spread_v, at.v)
    projected = norm(cross(window.edge_u, window.edge_v)) * jnp.where(hit, at.facing, 1)
    distance = jnp.where(hit, at.distance, 0)
    return divide(per_place * distance * distance, projected, where=hit)


_PIECES = 5  # pieces along each side of a window


def _window_bound(light: Ends[Any], windows: Ends[Any]) -> Source:
    """Return upper bounds on the light of a lamp that emits at most its largest radiance through a
    window. A fixed window is divided into pieces."""
    low, high = windows
    corner, u, v = (numbers(getattr(low, name)) for name in ("corner", "edge_u", "edge_v"))
    fixed = all(
        np.array_equal(getattr(low, name), getattr(high, name))
        for name in ("corner", "edge_u", "edge_v")
    )
    spectrum = peak(light, "radiance")
    if fixed:
        across = np.cross(u, v)
        area = np.linalg.norm(across)
        t = (np.arange(_PIECES) + 0.5) / _PIECES
        s, t = (x.ravel()[:, None] for x in np.meshgrid(t, t))
        places, count = corner + s * u + t * v, _PIECES**2
        size = max(np.linalg.norm(u + v), np.linalg.norm(u - v)) / (2 * _PIECES)
        points = corner + np.stack([0 * u, u, v, u + v])
        body = points, np.zeros(4)
        each = np.full(count, 1.0)
        return Source(
            spectrum, places, each * size, each * area / count, unit(across), body, "area"
        )
    ends = [
        numbers(end.corner)
        + np.stack(
            [
                0 * u,
                *(numbers(e) for e in (end.edge_u, end.edge_v)),
                numbers(end.edge_u) + numbers(end.edge_v),
            ]
        )
        for end in windows
    ]
    points = box_corners(np.minimum(*ends), np.maximum(*ends))
    middle = points.mean(0)
    size = np.linalg.norm(points - middle, axis=1).max()
    area = max(
        np.linalg.norm(a) * np.linalg.norm(b)
        for a in box_corners(numbers(low.edge_u), numbers(high.edge_u))
        for b in box_corners(numbers(low.edge_v), numbers(high.edge_v))
    )
    own, body = np.array([1.0]), (points, np.zeros(len(points)))
    return Source(spectrum, middle[None], own * size, own * area, None, body, "area")
