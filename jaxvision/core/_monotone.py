"""Monotone interpolation through given points, by the cubic Hermite spline that SciPy calls PCHIP.

Source: Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984), for the slopes.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._numerics import binary_unit, smallest_divisor
from ._types import Scalars, print_by_name

Points = Float[Array, " points"]
print_by_name(globals(), "Points")


def evaluate_monotone(x: Scalars, inputs: Points, outputs: Points, slopes: Points) -> Scalars:
    """Evaluate the monotone curve at `x`, between the first and the last point."""
    k = jnp.clip(jnp.searchsorted(inputs, x, side="right") - 1, 0, inputs.shape[0] - 2)
    width = (inputs[1:] - inputs[:-1])[k]
    t = (x - inputs[k]) / width
    from_end = 1 - t
    return (
        outputs[k] * (1 + 2 * t) * from_end**2
        + outputs[k + 1] * (1 + 2 * from_end) * t**2
        + width * t * from_end * (slopes[k] * from_end - slopes[k + 1] * t)
    )


def monotone_slopes(inputs: Points, outputs: Points) -> Points:
    """Return the slope of the monotone curve at each point. At an interior point, the slope is the
    weighted harmonic mean of the slopes of the two neighbouring chords, or 0 if the point is an
    extremum."""
    width = jnp.diff(inputs)
    chord = jnp.diff(outputs) / width
    if inputs.shape[0] == 2:
        return jnp.concatenate([chord, chord])
    unit = binary_unit(chord)
    before, behind = chord[:-1] / unit, chord[1:] / unit
    near_before, near_behind = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    onward = ~(before * behind <= 0)
    steep_before, steep_behind = (
        jnp.maximum(jnp.abs(c), smallest_divisor(c.dtype)) for c in (before, behind)
    )
    mean = (near_before + near_behind) / (near_before / steep_before + near_behind / steep_behind)
    mean = unit * jnp.where(before < 0, -mean, mean)
    first = _end_slope(width[0], width[1], chord[0], chord[1])
    last = _end_slope(width[-1], width[-2], chord[-1], chord[-2])
    return jnp.concatenate([first[None], jnp.where(onward, mean, 0), last[None]])


def _end_slope(near: Array, far: Array, chord: Array, next_chord: Array) -> Array:
    """Return a parabola's slope at the end of three points, without overshoot."""
    slope = ((2 * near + far) * chord - near * next_chord) / (near + far)
    slope = jnp.where(slope * chord <= 0, 0, slope)
    steep = (chord * next_chord < 0) & (jnp.abs(slope) > 3 * jnp.abs(chord))
    return jnp.where(steep, 3 * chord, slope)
