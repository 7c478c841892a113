"""Fixed-pattern noise: differences between the pixels of a camera, drawn from the random key of its
sensor chip (die).

Every function returns an array that broadcasts against electrons of the shape (..., h, w, bands).
Functions for rows and columns need this shape. Sensitivities are relative, offsets are in
electrons, and dark rates in e- s^-1. If `die_key` is None, a function that needs random numbers
raises `ValueError`.
"""

import jax.numpy as jnp
from jax.typing import DTypeLike

from ..core._arguments import takes_numbers
from ..core._numerics import divide
from ..core._types import Key, Scalars
from ..scene import HotPixels, Sensor
from ._draws import (
    Die,
    Shape,
    counting_dtype,
    draw_per_column,
    draw_per_row,
    gaussian,
    tail_probability,
    uniform,
    words,
)
from ._taps import factored


@takes_numbers
def sensitivity(
    die_key: Key | None, sensor: Sensor, *, shape: Shape, dtype: DTypeLike
) -> Scalars | None:
    """Draw the response of each pixel relative to the mean pixel: max(1 + PRNU, 0), and 0 for dead
    pixels.

    Whether a pixel is dead is a discrete draw, so the gradient with respect to `dead_pixels` is 0.
    `expected_signal` and `pattern_variance` have the gradient of the average over dies.

    Args:
        die_key: random key of the individual sensor.
        sensor: of which `prnu`, `dead_pixels` and `taps` are used.
        shape: shape of the electrons.
        dtype: floating dtype of the result.

    Returns:
        Relative sensitivities of that shape, no unit; None if the sensor has neither effect.

    Example:
        >>> sensor = jv.Sensor(prnu=0.02)
        >>> of = {"shape": (50, 50, 1), "dtype": float}
        >>> die = jv.sensor.sensitivity(jax.random.key(0), sensor, **of)
        >>> print(round(float(die.mean()), 2), round(float(die.std()), 2))
        1.0 0.02
    """
    response = None
    if sensor.prnu is not None:
        pattern = gaussian(die_key, Die.PRNU, shape, dtype)
        rms = factored(sensor.prnu, sensor.taps, "prnu", shape=shape, dtype=dtype)
        response = jnp.maximum(1 + rms * pattern, 0)
    if sensor.dead_pixels is not None:
        dead = uniform(die_key, Die.DEFECT, shape, dtype) <= sensor.dead_pixels
        alive = jnp.ones(shape, dtype) if response is None else response
        response = jnp.where(dead, 0, alive)
    return response


@takes_numbers
def hot_rates(
    die_key: Key | None, hot_pixels: HotPixels, *, shape: Shape, dtype: DTypeLike
) -> Scalars:
    """Draw the additional dark current of each pixel, which is 0 in most pixels and exponentially
    distributed in hot pixels.

    A uniform random number selects dead pixels at one end of its range and hot pixels at the other.
    No pixel is therefore both, if the two fractions add up to at most 1. The additional dark
    current of a hot pixel is a continuous function of this number, which begins at 0. Gradients
    with respect to fraction and rate are therefore unbiased.

    Args:
        die_key: random key of the individual sensor.
        hot_pixels: fraction of hot pixels and their mean excess.
        shape: shape of the electrons.
        dtype: floating dtype of the result.

    Returns:
        e- s^-1 of that shape.

    Example:
        >>> of = {"shape": (100, 100, 1), "dtype": float}
        >>> hot = jv.HotPixels(0.1, 300.0)  # a tenth of the pixels, 300 e- s^-1 on average
        >>> rates = jv.sensor.hot_rates(jax.random.key(0), hot, **of)
        >>> print(round(float((rates > 0).mean()), 2))
        0.1
    """
    from_end = tail_probability(~words(die_key, Die.DEFECT, shape), counting_dtype(dtype))
    hot = from_end <= hot_pixels.fraction
    place = divide(from_end, hot_pixels.fraction, hot, 1)
    return jnp.where(hot, -hot_pixels.rate * jnp.log(place), 0).astype(dtype)


@takes_numbers
def offsets(
    die_key: Key | None, sensor: Sensor, *, shape: Shape, dtype: DTypeLike
) -> Scalars | None:
    """Draw the offset of each pixel, the sum of the DSNU of pixels, columns and rows.

    Args:
        die_key: random key of the individual sensor.
        sensor: of which `dsnu`, `column_dsnu` and `row_dsnu` are used.
        shape: shape of the electrons.
        dtype: floating dtype of the result.

    Returns:
        Electrons, broadcasting against that shape; None if the sensor has none of these effects.
    """
    parts = []
    if sensor.dsnu is not None:
        parts.append(sensor.dsnu * gaussian(die_key, Die.DSNU, shape, dtype))
    if sensor.column_dsnu is not None:
        columns = draw_per_column(die_key, Die.COLUMN_OFFSET, shape, dtype)
        parts.append(sensor.column_dsnu * columns)
    if sensor.row_dsnu is not None:
        parts.append(sensor.row_dsnu * draw_per_row(die_key, Die.ROW_OFFSET, shape, dtype))
    return sum(parts[1:], parts[0]) if parts else None


@takes_numbers
def conversion_gains(
    die_key: Key | None, rms: Scalars, *, shape: Shape, dtype: DTypeLike
) -> Scalars:
    """Draw each pixel's conversion gain relative to the mean: 1 + rms times a standard Gaussian.

    Args:
        die_key: random key of the individual sensor.
        rms: () relative standard deviation, no unit.
        shape: shape of the electrons.
        dtype: floating dtype of the result.

    Returns:
        Relative gains of that shape, no unit.
    """
    return 1 + rms * gaussian(die_key, Die.CONVERSION, shape, dtype)


@takes_numbers
def column_gains(die_key: Key | None, rms: Scalars, *, shape: Shape, dtype: DTypeLike) -> Scalars:
    """Draw each column amplifier's gain relative to the mean: 1 + rms times a standard Gaussian.

    Args:
        die_key: random key of the individual sensor.
        rms: () relative standard deviation, no unit.
        shape: shape (..., h, w, bands) of the electrons.
        dtype: floating dtype of the result.

    Returns:
        (1, w, bands) relative gains with as many axes as the image, no unit.

    Example:
        >>> of = {"shape": (4, 1000, 1), "dtype": float}
        >>> gains = jv.sensor.column_gains(jax.random.key(0), 0.01, **of)
        >>> print(gains.shape, round(float(gains.std()), 3))
        (1, 1000, 1) 0.01
    """
    return 1 + rms * draw_per_column(die_key, Die.COLUMN_GAIN, shape, dtype)
