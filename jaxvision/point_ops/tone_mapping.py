"""Tone mapping of relative light of any range to [0, 1]."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, takes_range
from ..core._numerics import (
    divide,
    log1p,
    magnitude,
    or_one,
    polynomial,
    safe_log,
    smallest_divisor,
)
from ..core._types import AMOUNT, DIVISOR, Scalars, as_relative, is_known, refuse_codes
from ..core._warnings import warn_caller

MANY = 0.05  # share of black pixels at which the log-average of the other pixels is wrong by a half


@takes_numbers
def reinhard(x: Scalars, *, white: Scalars | float | None = None) -> Scalars:
    """Apply Reinhard's tone curve: x / (1 + x), or with a `white`, x (1 + x / white^2) / (1 + x).

    Below 0 the curve is x, so value and slope are continuous at 0.

    Args:
        x: (...) relative scaled luminance, from `scaled_to_key`.
        white: relative, the smallest x that maps to 1; None for a curve that approaches 1.

    Returns:
        (...) relative.

    Raises:
        ValueError: for codes such as 0 to 255 in place of relative values.

    Source: Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002,
    equations 3 and 4.
    """
    refuse_codes(x := as_relative(x))
    positive = jnp.maximum(x, 0)
    mapped = _saturating(positive)
    if white is not None:
        inverse = 1 / jnp.asarray(white, x.dtype)
        mapped = mapped * (1 + positive * inverse * inverse)
    return jnp.where(x > 0, mapped, x)


@jax.custom_jvp
def _saturating(x: Scalars) -> Scalars:
    """Return x / (1 + x), and 1 at infinity. The slope is computed as 1 / (1 + x)^2, without
    cancellation.
    """
    return jnp.where(x == jnp.inf, 1, x / (1 + x))


@_saturating.defjvp
def _saturating_jvp(primals, tangents):
    (x,), (change,) = primals, tangents
    inverse = 1 / (1 + x)
    return _saturating(x), inverse * inverse * change


@takes_numbers
@takes_range(key_value=DIVISOR)
def scaled_to_key(luminance: Float[Array, "h w"], *, key_value: float = 0.18) -> Scalars:
    """Multiply the luminance by the key divided by its log-average (geometric mean), which moves
    the picture's middle grey to the key.

    In the log-average, values below 1e-6 of the mean are replaced by 1e-6 of the mean, and values
    that are not finite are ignored.

    Args:
        luminance: (h, w) relative.
        key_value: relative, above 0, the wanted middle grey.

    Returns:
        (h, w) relative.

    Raises:
        ValueError: for a key of 0 or less, and a picture without pixels.

    Source: Reinhard et al. 2002, equations 1 and 2.
    """
    luminance = as_relative(luminance)
    if luminance.size == 0:
        raise ValueError(f"luminance must have at least one pixel, got shape {luminance.shape}.")
    if luminance.dtype.itemsize < 4:  # half precision is too small for the sums
        wide = scaled_to_key(luminance.astype(jnp.float32), key_value=key_value)
        return wide.astype(luminance.dtype)
    _warn_of_black(luminance)
    known = jnp.isfinite(luminance)
    relative = luminance / magnitude(jnp.where(known, luminance, 0), axis=None)
    of_black = smallest_divisor(relative.dtype) ** 2
    floor = jnp.maximum(1e-6 * jnp.mean(relative, where=known), of_black)
    average = jnp.exp(jnp.mean(safe_log(jnp.maximum(relative, floor)), where=known))
    return relative * (key_value / average)


def _warn_of_black(luminance: Array) -> None:
    """Warn if many values are black, which moves the log-average far below the other values."""
    if not is_known(luminance):
        return
    black = float(np.mean(np.asarray(luminance) <= 0))
    if MANY < black < 1:
        warn_caller(
            f"{black:.0%} of the luminance is at or below 0, as in borders or noise about 0, and "
            "counts as 1e-6 of the mean in the log-average, so that the rest becomes much brighter "
            "than the key; set such values to NaN to leave them out, or crop the picture."
        )


@takes_numbers
def filmic(x: Scalars) -> Scalars:
    """Apply the ACES film curve x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14), clipped to 1.

    Without clipping the curve would reach 1.033.

    Args:
        x: (...) relative; negative values are set to 0.

    Returns:
        (...) relative, in [0, 1].

    Raises:
        ValueError: for codes such as 0 to 255 in place of relative values.

    Source: the fit of Narkowicz, "ACES Filmic Tone Mapping Curve" (2016).
    """
    refuse_codes(x := as_relative(x))
    positive = jnp.maximum(x, 0)
    # both sides over x^2 where x is large, so that nothing overflows
    dark = positive < 1
    small = jnp.where(dark, positive, 1)
    large = 1 / jnp.where(dark, 1, positive)
    low = small * (2.51 * small + 0.03) / (small * (2.43 * small + 0.59) + 0.14)
    high = (2.51 + 0.03 * large) / (2.43 + large * (0.59 + 0.14 * large))
    return jnp.minimum(jnp.where(dark, low, high), 1)


@takes_numbers
@takes_range(strength=AMOUNT)
def log_curve(x: Scalars, strength: Scalars | float) -> Scalars:
    """Apply the logarithmic curve log(1 + strength x) / log(1 + strength), which is 0 at 0 and 1 at
    1.

    Args:
        x: (...) relative; negative values are set to 0.
        strength: no unit; the larger, the steeper at the dark end; 0 is a straight line.

    Returns:
        (...) relative.

    Raises:
        ValueError: for a strength below 0, and codes such as 0 to 255 in place of relative values.

    Source: the mu-law of ITU-T G.711.
    """
    refuse_codes(x := as_relative(x))
    positive = jnp.maximum(x, 0)
    return _log_ratio(*jnp.broadcast_arrays(positive, jnp.asarray(strength, positive.dtype)))


@jax.custom_jvp
def _log_ratio(x: Scalars, strength: Scalars) -> Scalars:
    """Return log(1 + strength x) / log(1 + strength), accurate for any strength x."""
    product = strength * x
    overflows = jnp.isinf(product) & jnp.isfinite(x) & jnp.isfinite(strength)
    bright, steep = jnp.where(overflows, x, 1), jnp.where(overflows, strength, 1)
    apart = (jnp.log(bright) + jnp.log(steep)) / log1p(steep)
    large = log1p(product) / log1p(or_one(strength))
    small = x * (_mean_slope(product) / _mean_slope(strength))
    return jnp.where(overflows, apart, jnp.where(product < 1, small, large))


@_log_ratio.defjvp
def _log_ratio_jvp(primals, tangents):
    """Differentiate `_log_ratio`. The derivative with respect to `strength` is a difference. If
    both logarithms are of numbers near 1, a series is used, because the difference would cancel.
    """
    (x, strength), (dx, ds) = primals, tangents
    mapped, product = _log_ratio(x, strength), strength * x
    gentle = strength < 1
    slow, fast = jnp.where(gentle, strength, 1), jnp.where(gentle, 1, strength)
    by_x = jnp.where(
        gentle,
        1 / ((1 + slow * x) * _mean_slope(slow)),
        1 / ((1 / fast + x) * log1p(fast)),
    )
    near = (product < _NEAR) & (strength < _NEAR)
    of_x, of_one = (
        (_mean_slope(z), polynomial(_SERIES, jnp.minimum(z, 2 * _NEAR)))
        for z in (product, strength)
    )
    series = x * (x * of_x[1] * of_one[0] - of_x[0] * of_one[1]) / jnp.square(of_one[0])
    steep = jnp.where((product < _NEAR / 2) & (strength < _NEAR / 2), 1, strength)
    difference = (1 / (divide(1, x) + steep) - mapped / (1 + steep)) / log1p(steep)
    by_strength = jnp.where(near, series, jnp.where(x > 0, difference, 0 * mapped))
    return mapped, by_x * dx + by_strength * ds


def _mean_slope(z: Scalars) -> Scalars:
    """Return log(1 + z) / z for z >= 0, which is 1 at 0."""
    return jnp.where(z < jnp.finfo(z.dtype).eps / 2, 1, log1p(z) / or_one(z))


_NEAR = 0.1
# coefficients of the series of d/dz log(1 + z) / z
_SERIES = [(-1) ** n * n / (n + 1) for n in range(17, 0, -1)]


@takes_numbers
def set_luminance(
    image: Float[Array, "... channels"], luminance: Scalars, wanted: Scalars
) -> Float[Array, "... channels"]:
    """Scale each pixel from its luminance to a wanted luminance, so that a curve changes the
    luminance but not the chromaticity.

    Args:
        image: (..., channels) relative.
        luminance: (...) of the image, relative or in any unit. Values up to 1e-19 in float32 count
            as black, and black stays black.
        wanted: (...) in the unit of `luminance`.

    Returns:
        (..., channels) relative.
    """
    image, luminance = as_relative(image), as_relative(luminance)
    gain = divide(wanted, luminance, ~(luminance <= smallest_divisor(luminance.dtype) ** 2))
    return image * gain[..., None]
