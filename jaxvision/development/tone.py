"""Tone curves through points, and the choice among the named ones.

Elementwise on relative values of any shape; the named curves are in `point_ops`.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import smallest_divisor
from ..core._types import Scalars, as_relative, is_known, print_by_name, refuse_codes
from ..point_ops import filmic, gamma_encode, reinhard, srgb_encode
from ..scene import SRGB, Filmic, Gamma, Reinhard, ToneCurve, ToneEncoding, ToneMap

Points = Float[Array, " points"]
print_by_name(globals(), "Points")


@takes_numbers
def tone_curve(x: Scalars, inputs: Points, outputs: Points) -> Scalars:
    """The smooth curve through given points, monotone wherever the points are; constant outside.

    It is the cubic Hermite spline that scipy calls PCHIP. NaN stays NaN.

    Args:
        x: (...) relative.
        inputs: (points,) relative, strictly ascending, at least two.
        outputs: (points,) relative.

    Returns:
        (...) relative.

    Raises:
        ValueError: for fewer than two points or unequal shapes, for known inputs that do not
            ascend, and for codes beyond the inputs.

    Source: Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984), for the slopes.

    Example:
        >>> inputs, outputs = jnp.array([0.0, 0.5, 1.0]), jnp.array([0.0, 0.75, 1.0])
        >>> jv.tone_curve(jnp.array([-1.0, 0.5, 1.0]), inputs, outputs).tolist()
        [0.0, 0.75, 1.0]
    """
    x = as_relative(x)
    if inputs.shape != outputs.shape or inputs.shape[0] < 2:
        raise ValueError(
            "inputs and outputs must be (points,) with at least two points, got shapes "
            f"{inputs.shape} and {outputs.shape}."
        )
    if is_known(inputs):
        if not (np.diff(inputs) > 0).all():
            raise ValueError(f"tone_curve: inputs must ascend, got {np.asarray(inputs)}.")
        if np.asarray(inputs)[-1] <= 100:  # a curve through codes takes codes
            refuse_codes(x)
    slopes = _monotone_slopes(inputs, outputs)
    within = jnp.where(x < inputs[0], inputs[0], jnp.where(x > inputs[-1], inputs[-1], x))
    k = jnp.clip(jnp.searchsorted(inputs, within, side="right") - 1, 0, inputs.shape[0] - 2)
    width = (inputs[1:] - inputs[:-1])[k]
    t = (within - inputs[k]) / width
    from_end = 1 - t
    return (
        outputs[k] * (1 + 2 * t) * from_end**2
        + outputs[k + 1] * (1 + 2 * from_end) * t**2
        + width * t * from_end * (slopes[k] * from_end - slopes[k + 1] * t)
    )


@takes_numbers
def map_tone(picture: Scalars, tone_map: ToneMap) -> Scalars:
    """Linear light to the range of a display: each band by the curve of the record.

    Args:
        picture: (...) linear, relative.
        tone_map: the curve.

    Returns:
        (...) relative.

    Example:
        >>> print(jv.development.map_tone(jnp.array([1.0, 3.0]), jv.Reinhard()))
        [0.5  0.75]
    """
    match tone_map:
        case Reinhard(white=white):
            return reinhard(picture, white=white)
        case Filmic():
            return filmic(picture)
        case ToneCurve(inputs=inputs, outputs=outputs):
            return tone_curve(picture, inputs, outputs)


@takes_numbers
def encode_tone(picture: Scalars, tone: ToneEncoding) -> Scalars:
    """Linear values to encoded ones, by the curve of the record.

    Args:
        picture: (...) linear, relative.
        tone: the curve.

    Returns:
        (...) encoded, relative.

    Example:
        >>> print(f"{jv.development.encode_tone(jnp.array(0.18), jv.Gamma(2.2)):.3f}")
        0.459
    """
    match tone:
        case Gamma(gamma=gamma):
            return gamma_encode(picture, gamma)
        case SRGB():
            return srgb_encode(picture)


def _monotone_slopes(inputs: Points, outputs: Points) -> Points:
    """The weighted harmonic mean of the chords on both sides, 0 at an extremum."""
    width = jnp.diff(inputs)
    chord = jnp.diff(outputs) / width
    if inputs.shape[0] == 2:
        return jnp.concatenate([chord, chord])
    before, behind = chord[:-1], chord[1:]
    near_before, near_behind = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    onward = ~(before * behind <= 0)
    steep_before, steep_behind = (
        jnp.maximum(jnp.abs(c), smallest_divisor(c.dtype)) for c in (before, behind)
    )
    mean = (near_before + near_behind) / (near_before / steep_before + near_behind / steep_behind)
    mean = jnp.where(before < 0, -mean, mean)
    first = _end_slope(width[0], width[1], chord[0], chord[1])
    last = _end_slope(width[-1], width[-2], chord[-1], chord[-2])
    return jnp.concatenate([first[None], jnp.where(onward, mean, 0), last[None]])


def _end_slope(near: Array, far: Array, chord: Array, next_chord: Array) -> Array:
    """The parabola through three points, kept from overshooting."""
    slope = ((2 * near + far) * chord - near * next_chord) / (near + far)
    slope = jnp.where(slope * chord <= 0, 0, slope)
    steep = (chord * next_chord < 0) & (jnp.abs(slope) > 3 * jnp.abs(chord))
    return jnp.where(steep, 3 * chord, slope)
