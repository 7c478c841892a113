"""Point operators that are linear in the light: gain, exposure, blending. Relative values."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._powers import times_exp2
from ..core._types import Scalars, as_relative, map_beside


@takes_numbers
def gain_bias(x: Scalars, gain: Scalars | float, bias: Scalars | float) -> Scalars:
    """Return gain x + bias.

    Args:
        x: (...) relative.
        gain: no unit; a map (h, w) or (h, w, 1) makes it vary over the picture.
        bias: in the unit of the result; or a map (h, w) or (h, w, 1).

    Returns:
        (...) relative.

    Source: Szeliski, Computer Vision, section 3.1.1.

    Example:
        >>> print(jv.gain_bias(jnp.array([0.25, 0.5]), 2.0, -0.5))
        [0.  0.5]
    """
    x = as_relative(x)
    return map_beside(gain, x) * x + map_beside(bias, x)


@takes_numbers
def contrast_brightness(
    x: Scalars,
    contrast: Scalars | float,
    brightness: Scalars | float,
    *,
    pivot: Scalars | float = 0.5,
) -> Scalars:
    """Return contrast (x - pivot) + pivot + brightness, which changes the contrast about the grey
    value `pivot`.

    Args:
        x: (...) relative.
        contrast: no unit; 1 changes nothing. Contrast, brightness and pivot may be maps (h, w).
        brightness: relative, added.
        pivot: relative, the grey that a change of contrast leaves unchanged.

    Returns:
        (...) relative.
    """
    x = as_relative(x)
    contrast, brightness, pivot = (map_beside(v, x) for v in (contrast, brightness, pivot))
    return contrast * (x - pivot) + (pivot + brightness)


@takes_numbers
def exposure(x: Scalars, stops: Scalars | float) -> Scalars:
    """Return 2^stops x, the linear values that an exposure longer by `stops` stops would have
    recorded.

    Args:
        x: (...) relative, linear.
        stops: no unit; may be negative, or a map (h, w).

    Returns:
        (...) relative.
    """
    x = as_relative(x)
    stops = map_beside(stops, x)
    return times_exp2(x, stops if isinstance(stops, jax.Array) else jnp.asarray(stops, x.dtype))


@takes_numbers
def blend(first: Scalars, second: Scalars, fraction: Scalars | float) -> Scalars:
    """Return the linear blend (1 - fraction) first + fraction second.

    Args:
        first: (...) relative.
        second: (...) relative; axes of length 1 broadcast as in NumPy.
        fraction: no unit, a number or a map (h, w) or (h, w, 1); outside [0, 1] it extrapolates.

    Returns:
        (...) relative.

    Source: Szeliski, Computer Vision, section 3.1.
    """
    first, second = as_relative(first), as_relative(second)
    fraction = map_beside(fraction, max(first, second, key=jnp.ndim))
    return (1 - fraction) * first + fraction * second


@takes_numbers
def cross_dissolve(
    first: Float[Array, "frames ..."], second: Float[Array, "frames ..."]
) -> Float[Array, "frames h w bands"]:
    """Blend two sequences frame by frame, from `first` alone in the first frame to `second` alone
    in the last.

    Args:
        first: (frames, h, w, bands) relative, at least two frames.
        second: the same shape, relative.

    Returns:
        (frames, h, w, bands) relative.

    Raises:
        ValueError: for still pictures, unequal shapes or fewer than two frames.

    Example:
        Between two still pictures the fractions are the caller's.

        >>> fractions = jnp.linspace(0.0, 1.0, 3)[:, None, None, None]
        >>> jv.point_ops.blend(jnp.ones((1, 2, 2, 3)), jnp.zeros((1, 2, 2, 3)), fractions).shape
        (3, 2, 2, 3)
    """
    first, second = as_relative(first), as_relative(second)
    if first.ndim != 4 or first.shape != second.shape or first.shape[0] < 2:
        raise ValueError(
            "cross_dissolve needs two sequences (frames, h, w, bands) of one shape and at least "
            f"two frames, got {first.shape} and {second.shape}; blend mixes two still pictures."
        )
    fraction = jnp.linspace(0, 1, first.shape[0], dtype=first.dtype)
    return blend(first, second, fraction[:, None, None, None])
