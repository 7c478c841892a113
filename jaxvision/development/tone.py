"""Tone curves through given points, and the choice of a named tone curve.

The curves act elementwise on relative values of any shape. The named curves are in `point_ops`.
"""

import jax.numpy as jnp
import numpy as np

from ..core._arguments import takes_numbers
from ..core._monotone import Points, evaluate_monotone, monotone_slopes
from ..core._types import Scalars, as_relative, is_known, refuse_codes
from ..point_ops import filmic, gamma_encode, reinhard, srgb_encode
from ..scene import SRGB, Filmic, Gamma, Reinhard, ToneCurve, ToneEncoding, ToneMap


@takes_numbers
def tone_curve(x: Scalars, inputs: Points, outputs: Points) -> Scalars:
    """Evaluate the smooth curve through given points, which is monotone where the points are
    monotone, and constant beyond the first and last point.

    The curve is the cubic Hermite spline that scipy calls PCHIP. NaN stays NaN.

    Args:
        x: (...) relative.
        inputs: (points,) relative, strictly ascending, at least two.
        outputs: (points,) relative.

    Returns:
        (...) relative.

    Raises:
        ValueError: for fewer than two points or unequal shapes, for inputs that do not ascend
            (unless traced), and for codes beyond the inputs.

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
        # If the inputs of the curve are codes, x may contain codes
        if np.asarray(inputs)[-1] <= 100:
            refuse_codes(x)
    slopes = monotone_slopes(inputs, outputs)
    within = jnp.where(x < inputs[0], inputs[0], jnp.where(x > inputs[-1], inputs[-1], x))
    return evaluate_monotone(within, inputs, outputs, slopes)


@takes_numbers
def map_tone(picture: Scalars, tone_map: ToneMap) -> Scalars:
    """Map linear light to the range of a display, each band by the curve `tone_map`.

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
    """Encode linear values by the curve `tone`.

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
