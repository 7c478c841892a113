"""Distortion by a lens: from the slopes of chief rays to their positions on the sensor, and the
inverse.

Positions are in units of the image distance. Slopes are m to the side per m forward, without unit.
The map from slopes to positions is the closed form of `Distortion`. The inverse uses Newton's
method. The iteration starts at the distorted position and converges for barrel and pincushion
distortion. The derivative of the inverse is that of the implicit function, not of the iteration's
steps.

Source:
    Brown, "Close-Range Camera Calibration", Photogrammetric Engineering 37 (1971).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..core._arguments import takes_numbers
from ..core._loops.fusion import one_program
from ..core._numerics import divide, smallest_divisor
from ..core._types import Scalar
from ..core.parallel_loops import while_loop
from ..scene import Distortion

_MOST_STEPS = 60


@takes_numbers
def distort(distortion: Distortion, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Return the point at which a chief ray meets the sensor of a lens with distortion.

    Args:
        distortion: coefficients.
        x: () slope to the right, m per m.
        y: () slope downwards, m per m.

    Returns:
        (right, down), each () in units of the image distance (relative).

    Example:
        >>> barrel = jv.Distortion(radial=jnp.array([-0.1]))
        >>> x, y = jv.optics.distort(barrel, jnp.array(0.5), jnp.array(0.0))
        >>> round(float(x), 4)  # 0.5 (1 - 0.1 0.5^2)
        0.4875
    """
    x, y = _bent(distortion, x, y)
    if distortion.stretch is not None:
        y = y * distortion.stretch
    if distortion.shift is None:
        return x, y
    return x + distortion.shift[0], y + distortion.shift[1]


def _bent(distortion: Distortion, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Apply only the radial and tangential polynomial of `distort`."""
    s, _ = _scale(distortion, x, y)
    if distortion.tangential is None:
        return x * s, y * s
    p1, p2 = distortion.tangential
    r2 = x * x + y * y
    return (
        x * s + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * s + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


@takes_numbers
def distortion_area(distortion: Distortion, x: Scalar, y: Scalar) -> Scalar:
    """Return the ratio of a small area in the distorted image to its area in an ideal image.

    The ratio is the determinant of the derivative of `distort`.

    Args:
        distortion: coefficients.
        x: () slope of the chief ray to the right, m per m.
        y: () slope of the chief ray downwards, m per m.

    Returns:
        () relative; 0 at a fold of the image and negative beyond it.

    Example:
        >>> barrel = jv.Distortion([-0.1])
        >>> print(f"{jv.optics.distortion_area(barrel, 0.5, 0.0):.4f}")
        0.9019
    """
    a, b, c = _jacobian(distortion, x, y)
    area = a * c - b * b
    return area if distortion.stretch is None else area * distortion.stretch


@takes_numbers
def undistort(distortion: Distortion, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Return the slopes of the chief ray that meets the sensor at a position: invert `distort`.

    A strong barrel distortion folds the plane, and no ray is imaged beyond the fold. For a position
    beyond the fold, the result is a slope near the fold, with gradient 0. NaN stays NaN.

    Args:
        distortion: coefficients.
        x: () position to the right, relative to the image distance.
        y: () position downwards, relative to the image distance.

    Returns:
        (right, down), each () m per m.

    Example:
        >>> barrel = jv.Distortion(radial=jnp.array([-0.1]))
        >>> x, y = jv.optics.undistort(barrel, jnp.array(0.4875), jnp.array(0.0))
        >>> round(float(x), 12)
        0.5
    """
    if distortion.shift is not None:
        x, y = x - distortion.shift[0], y - distortion.shift[1]
    if distortion.stretch is not None:
        y = y / distortion.stretch
    bent = Distortion(distortion.radial, distortion.tangential)
    dtype = jnp.result_type(x, y, *jax.tree.leaves(bent))
    return _undistort(bent, x.astype(dtype), y.astype(dtype))


@jax.custom_jvp
@one_program
def _undistort(distortion: Distortion, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Invert `_bent` by Newton's method. The derivative is that of the implicit function."""
    accuracy = 4 * jnp.finfo(x.dtype).eps * jnp.maximum(jnp.abs(x), jnp.abs(y))

    def residual(u: Scalar, v: Scalar) -> tuple[Scalar, Scalar]:
        at_x, at_y = _bent(distortion, u, v)
        return at_x - x, at_y - y

    def step(state):
        # The condition is stored in the state. If it were evaluated again with different rounding,
        # a loop over many points could wait for a point that no longer moves.
        number, u, v, share, _ = state
        off_x, off_y = residual(u, v)
        by_u, by_v = _solve(distortion, u, v, off_x, off_y)
        next_u, next_v = u - share * by_u, v - share * by_v
        before_fold = _is_before_fold(distortion, next_u, next_v)
        off = jnp.maximum(jnp.abs(off_x), jnp.abs(off_y)) > accuracy
        moved = off & before_fold
        return (
            number + 1,
            jnp.where(moved, next_u, u),
            jnp.where(moved, next_v, v),
            jnp.where(before_fold, jnp.minimum(2 * share, 1), share / 2),
            off & (number + 1 < _MOST_STEPS),
        )

    starts_well = _is_before_fold(distortion, x, y)
    start = jnp.where(starts_well, x, 0), jnp.where(starts_well, y, 0)
    # far outside the image, a full step would overshoot too far for halving to correct
    share = 1 / jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), 1)
    begin = (0, *start, share, jnp.ones((), bool))
    _, u, v, *_ = while_loop(lambda state: state[-1], step, begin)
    numbers = (x, y, *jax.tree.leaves(distortion))
    lost = jnp.stack([jnp.isnan(number).any() for number in numbers]).any()
    return jnp.where(lost, jnp.nan, u), jnp.where(lost, jnp.nan, v)


@_undistort.defjvp
def _undistort_jvp(primals, tangents):
    """Differentiate D(k, u) = x with coefficients k and slopes u: D_u du = dx - D_k dk."""
    distortion, x, y = primals
    by_distortion, dx, dy = tangents
    u, v = _undistort(distortion, x, y)
    at, moved = jax.jvp(lambda k: _bent(k, u, v), (distortion,), (by_distortion,))
    du, dv = _solve(distortion, u, v, dx - moved[0], dy - moved[1])
    off = jnp.maximum(jnp.abs(at[0] - x), jnp.abs(at[1] - y))
    size = jnp.maximum(jnp.abs(x), jnp.abs(y))
    met = off <= float(jnp.finfo(x.dtype).eps) ** 0.5 * size
    return (u, v), (jnp.where(met, du, 0), jnp.where(met, dv, 0))


def _scale(distortion: Distortion, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Return s = 1 + k_1 r^2 + ..., and its derivative with respect to r^2."""
    r2 = x * x + y * y
    s, slope = jnp.zeros_like(r2), jnp.zeros_like(r2)
    for k in distortion.radial[::-1]:
        s, slope = r2 * (k + s), (k + s) + r2 * slope
    return 1 + s, slope


def _jacobian(distortion: Distortion, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Return the derivative of `_bent`, a symmetric matrix (xx, xy, yy)."""
    s, slope = _scale(distortion, x, y)
    xx, xy, yy = s + 2 * slope * x * x, 2 * slope * x * y, s + 2 * slope * y * y
    if distortion.tangential is None:
        return xx, xy, yy
    p1, p2 = distortion.tangential
    return (
        xx + 2 * p1 * y + 6 * p2 * x,
        xy + 2 * p1 * x + 2 * p2 * y,
        yy + 6 * p1 * y + 2 * p2 * x,
    )


def _is_before_fold(distortion: Distortion, x: Scalar, y: Scalar) -> Bool[Array, ""]:
    """Return whether the derivative of `distort` is positive definite, as on the axis. The slope is
    then not beyond a fold.
    """
    a, b, c = _jacobian(distortion, x, y)
    return (a > 0) & (a * c - b * b > 0)


def _solve(
    distortion: Distortion, x: Scalar, y: Scalar, right: Scalar, down: Scalar
) -> tuple[Scalar, Scalar]:
    """Solve for the step that the derivative of `_bent` maps to (right, down); 0 at a fold."""
    a, b, c = _jacobian(distortion, x, y)
    area = a * c - b * b
    inverse = divide(1, area, ~(jnp.abs(area) <= smallest_divisor(area.dtype)))
    return (c * right - b * down) * inverse, (a * down - b * right) * inverse
