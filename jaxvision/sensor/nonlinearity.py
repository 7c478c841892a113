"""The nonlinearity of a sensor: curves from the charge of a pixel to its signal, with their
inverses and slopes. All quantities are in electrons. The signal is defined as the charge that gives
the same reading in a linear sensor with the same gain at 0.

Beyond the range of charges for which a curve is given, it continues as a straight line.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ..core._arguments import takes_numbers
from ..core._bounds import Ends
from ..core._loops.fusion import one_program
from ..core._monotone import evaluate_monotone, monotone_slopes
from ..core._numerics import divide
from ..core._types import Scalars
from ..core.parallel_loops import fori_loop
from ..scene import Compression, Nonlinearity, ResponseSpline, ResponseTable
from ._registry import register_curve, stage_of

_STEPS = 30  # steps of a search; bisection alone leaves 1e-9 of an interval, Newton's far less


@takes_numbers
def signal_of_charge(nonlinearity: Nonlinearity, electrons: Scalars) -> Scalars:
    """Return the signal of a nonlinear sensor for a charge.

    Args:
        nonlinearity: the curve.
        electrons: (...) e-.

    Returns:
        (...) e-.

    Raises:
        ValueError: for a record without a registered curve.

    Example:
        >>> curve = jv.Compression(0.04, electrons=1e4)
        >>> float(jv.sensor.signal_of_charge(curve, 1e4))
        9600.0
    """
    curve = stage_of(nonlinearity).curve
    if curve is None:
        raise ValueError(f"{type(nonlinearity).__name__} has no curve; call register_curve for it.")
    return curve(nonlinearity, electrons)


@takes_numbers
def charge_of_signal(nonlinearity: Nonlinearity, signal: Scalars) -> Scalars:
    """Return the charge that gives a signal, the inverse of `signal_of_charge`.

    Args:
        nonlinearity: the curve.
        signal: (...) e-.

    Returns:
        (...) e-. Its derivatives are those of the inverse; only first derivatives for
        `ResponseSpline` and a `Compression` of two terms.

    Raises:
        ValueError: for a record without a registered inverse.

    Example:
        >>> curve = jv.Compression(0.04, electrons=1e4)
        >>> round(float(jv.sensor.charge_of_signal(curve, 9600.0)))
        10000
    """
    inverse = stage_of(nonlinearity).inverse
    if inverse is None:
        name = type(nonlinearity).__name__
        raise ValueError(f"{name} has no inverse; give one to register_curve.")
    return inverse(nonlinearity, signal)


# ------------------------------------------------ compression


def _compress(effect: Compression, electrons: Scalars) -> Scalars:
    second = 0.0 if effect.second is None else effect.second
    within = jnp.clip(electrons, 0, effect.electrons)
    u = within / effect.electrons
    slope = 1 - u * (2 * effect.first + 3 * second * u)
    return within * (1 - u * (effect.first + second * u)) + (electrons - within) * slope


def _expand(effect: Compression, signal: Scalars) -> Scalars:
    end = jnp.broadcast_to(effect.electrons, signal.shape).astype(signal.dtype)
    top = _compress(effect, end)
    if effect.second is not None:
        return _invert(_compress, effect, signal, 0 * end, end)
    within = jnp.clip(signal, 0, top)
    root = jnp.sqrt(1 - 4 * effect.first * within / effect.electrons)
    last = 1 - 2 * effect.first
    beyond = jnp.maximum(signal - top, 0) / last
    return 2 * within / (1 + root) + beyond + jnp.minimum(signal, 0)


def _slopes_of_compression(ends: Ends[Compression]) -> tuple[float, float]:
    """Return the smallest and the largest slope 1 - 2 c u - 3 d u^2 of a `Compression` with u in
    [0, 1], over the ranges of its coefficients c and d. The extremes are at u = 0, at u = 1 or at
    the vertex of the parabola, and at the ends of the ranges of c and d, because the slope is
    linear in both."""
    found = []
    for c in (float(end.first) for end in ends):
        for d in (0.0 if end.second is None else float(end.second) for end in ends):
            turn = [-c / (3 * d)] if d and 0 < -c / (3 * d) < 1 else []
            found += [1 - 2 * c * u - 3 * d * u * u for u in (0.0, 1.0, *turn)]
    return min(found), max(found)


register_curve(Compression, curve=_compress, slopes=_slopes_of_compression, inverse=_expand)


# ------------------------------------------------ a table


def _interpolate(x: Scalars, inputs: Scalars, outputs: Scalars) -> Scalars:
    """Interpolate linearly between the entries of a table, and extrapolate linearly beyond them."""
    k = jnp.clip(jnp.searchsorted(inputs, x, side="right") - 1, 0, inputs.shape[0] - 2)
    slopes = jnp.diff(outputs) / jnp.diff(inputs)
    return outputs[k] + slopes[k] * (x - inputs[k])


def _chords(ends: Ends[Any]) -> tuple[float, float]:
    """Return the smallest and the largest slope between adjacent entries of a table, with each
    entry at either end of its range."""
    low, high = (np.asarray(end.signal, float) for end in ends)
    first, last = (np.asarray(end.electrons, float) for end in ends)
    shortest, longest = first[1:] - last[:-1], last[1:] - first[:-1]
    if not (shortest > 0).all():
        return 0.0, np.inf
    least = np.maximum(low[1:] - high[:-1], 0) / longest
    return float(least.min()), float(((high[1:] - low[:-1]) / shortest).max())


register_curve(
    ResponseTable,
    curve=lambda table, x: _interpolate(x, table.electrons, table.signal),
    slopes=_chords,
    inverse=lambda table, s: _interpolate(s, table.signal, table.electrons),
)


# ------------------------------------------------ a spline


def _smooth(curve: ResponseSpline, electrons: Scalars) -> Scalars:
    slopes = monotone_slopes(curve.electrons, curve.signal)
    first, last = curve.electrons[0], curve.electrons[-1]
    within = jnp.where(electrons < first, first, jnp.where(electrons > last, last, electrons))
    inside = evaluate_monotone(within, curve.electrons, curve.signal, slopes)
    slope = jnp.where(electrons < first, slopes[0], slopes[-1])
    return inside + slope * (electrons - within)


def _smooth_inverse(curve: ResponseSpline, signal: Scalars) -> Scalars:
    last = curve.signal.shape[0] - 2
    k = jnp.clip(jnp.searchsorted(curve.signal, signal, side="right") - 1, 0, last)
    low, high = curve.electrons[k], curve.electrons[k + 1]
    return _invert(_smooth, curve, signal, low, high)


def _slopes_of_spline(ends: Ends[ResponseSpline]) -> tuple[float, float]:
    """Return the smallest and the largest slope of a spline. In each cubic segment the slope is a
    parabola, with extrema at an end or at the vertex. If a parameter may vary, the result is 0 and
    three times the largest slope between adjacent entries."""
    low = ends.low
    free = any(not np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, ends), strict=True))
    if free:
        return 0.0, 3 * _chords(ends)[1]
    with jax.ensure_compile_time_eval():
        at = np.asarray(monotone_slopes(low.electrons, low.signal), float)
    chord = np.diff(np.asarray(low.signal, float)) / np.diff(np.asarray(low.electrons, float))
    first, last = at[:-1], at[1:]
    bend = 3 * (first + last - 2 * chord)  # slope = first + 2 turn t + bend t^2
    turn = 3 * chord - 2 * first - last
    where = np.clip(np.divide(-turn, bend, out=np.zeros_like(bend), where=bend != 0), 0, 1)
    middle = first + 2 * turn * where + bend * where**2
    return float(min(at.min(), middle.min())), float(max(at.max(), middle.max()))


register_curve(ResponseSpline, curve=_smooth, slopes=_slopes_of_spline, inverse=_smooth_inverse)


@one_program
def _invert(
    curve: Callable[[Any, Scalars], Scalars],
    effect: Nonlinearity,
    signal: Scalars,
    low: Scalars,
    high: Scalars,
) -> Scalars:
    """Find the charge at which an increasing curve has the value `signal`, between `low` and
    `high`. Beyond these the curve is a straight line. The search takes Newton steps, or bisects if
    a step would leave the bracket."""
    held, seen, low, high = jax.lax.stop_gradient((effect, signal, low, high))
    low, high = jnp.broadcast_to(low, seen.shape), jnp.broadcast_to(high, seen.shape)

    def value_and_slope(x: Scalars) -> tuple[Scalars, Scalars]:
        return jax.jvp(lambda y: curve(held, y), (x,), (jnp.ones_like(x),))

    within = jnp.clip(seen, curve(held, low), curve(held, high))

    def step(
        _: Int[Array, ""], state: tuple[Scalars, Scalars, Scalars]
    ) -> tuple[Scalars, Scalars, Scalars]:
        x, below, above = state
        value, slope = value_and_slope(x)
        over = value > within
        below, above = jnp.where(over, below, x), jnp.where(over, x, above)
        newton = x + divide(within - value, slope, slope > 0)
        inside = (newton >= below) & (newton <= above)
        return jnp.where(inside, newton, (below + above) / 2), below, above

    found = fori_loop(0, _STEPS, step, ((low + high) / 2, low, high))[0]
    slope = value_and_slope(found)[1]
    # one more step, from a constant start, has the derivatives of the inverse
    return found + divide(signal - curve(effect, found), slope, slope > 0)
