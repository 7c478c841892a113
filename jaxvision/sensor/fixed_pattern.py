"""What differs from pixel to pixel and stays with a camera, drawn from the key of its die.

Every function returns an array that combines with (..., h, w, bands) electrons; those of rows and
columns need such an image. Sensitivities are relative, offsets in electrons, dark rates in e- s^-1.
"""

import jax.numpy as jnp
from jax.typing import DTypeLike

from .._types import Key, Scalars
from ..scene import HotPixels, Sensor
from ._draws import (
    Die,
    Shape,
    along_columns,
    along_rows,
    gaussian,
    tail_probability,
    uniform,
    words,
)


def sensitivity(
    die_key: Key | None, sensor: Sensor, *, shape: Shape, dtype: DTypeLike
) -> Scalars | None:
    """Each pixel's response relative to the mean pixel's: 1 + PRNU, at least 0, and 0 where it is
    dead. None for a die without either."""
    response = None
    if sensor.prnu is not None:
        pattern = gaussian(die_key, Die.PRNU, shape, dtype)
        response = jnp.maximum(1 + sensor.prnu * pattern, 0)
    if sensor.dead_pixels is not None:
        dead = uniform(die_key, Die.DEFECT, shape, dtype) <= sensor.dead_pixels
        alive = jnp.ones(shape, dtype) if response is None else response
        response = jnp.where(dead, 0, alive)
    return response


def hot_rates(
    die_key: Key | None, hot_pixels: HotPixels, *, shape: Shape, dtype: DTypeLike
) -> Scalars:
    """The excess dark current of each pixel in e- s^-1, 0 in most: exponential of mean `rate` in
    the hot ones.

    Dead and hot pixels are drawn from the two ends of one uniform number, so that while they are
    fewer than all, none is both; how hot is drawn by where in its end the number lies.
    """
    from_end = tail_probability(~words(die_key, Die.DEFECT, shape), dtype)
    hot = from_end <= hot_pixels.fraction
    place = from_end / jnp.where(hot_pixels.fraction > 0, hot_pixels.fraction, 1)
    return jnp.where(hot, -hot_pixels.rate * jnp.log(jnp.where(hot, place, 1)), 0)


def offsets(
    die_key: Key | None, sensor: Sensor, *, shape: Shape, dtype: DTypeLike
) -> Scalars | None:
    """Each pixel's offset in electrons: DSNU of pixels, columns and rows; None without any."""
    parts = []
    if sensor.dsnu is not None:
        parts.append(sensor.dsnu * gaussian(die_key, Die.DSNU, shape, dtype))
    if sensor.column_dsnu is not None:
        columns = along_columns(die_key, Die.COLUMN_OFFSET, shape, dtype)
        parts.append(sensor.column_dsnu * columns)
    if sensor.row_dsnu is not None:
        parts.append(sensor.row_dsnu * along_rows(die_key, Die.ROW_OFFSET, shape, dtype))
    return sum(parts[1:], parts[0]) if parts else None


def conversion_gains(
    die_key: Key | None, rms: Scalars, *, shape: Shape, dtype: DTypeLike
) -> Scalars:
    """The conversion gain of each pixel relative to their mean: 1 + `rms` times a Gaussian."""
    return 1 + rms * gaussian(die_key, Die.CONVERSION, shape, dtype)


def column_gains(die_key: Key | None, rms: Scalars, *, shape: Shape, dtype: DTypeLike) -> Scalars:
    """The gain of each column's amplifier relative to their mean: 1 + `rms` times a Gaussian."""
    return 1 + rms * along_columns(die_key, Die.COLUMN_GAIN, shape, dtype)
