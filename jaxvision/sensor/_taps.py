"""Maps of parameters that differ between read-out amplifiers (taps) or sites of a mosaic."""

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..core._types import Scalars
from ..scene import Sensor, Taps
from ._draws import Shape, check_image


def tap_map(
    values: Float[Array, " taps"], taps: Taps, *, shape: Shape, dtype: DTypeLike
) -> Scalars:
    """Return a map that contains, for each pixel, the value of its tap."""
    check_image("Sensor.taps", shape)
    height, width = shape[-3:-1]
    tile = np.asarray(taps.pattern)
    rows, columns = np.arange(height), np.arange(width)
    if taps.stretched:
        (down, across), (of_rows, of_columns) = taps.cell, np.floor_divide(tile.shape, taps.cell)
        rows = rows * of_rows // height * down + rows % down
        columns = columns * of_columns // width * across + columns % across
    else:
        rows, columns = rows % tile.shape[0], columns % tile.shape[1]
    found = values.astype(dtype)[tile][jnp.asarray(rows)][:, jnp.asarray(columns)]
    return found.reshape(*(1,) * (len(shape) - 3), height, width, 1)


def factored(
    number: Scalars, taps: Taps | None, name: str, *, shape: Shape, dtype: DTypeLike
) -> Scalars:
    """Multiply a parameter of the sensor, (), by the factor of each pixel's tap. The result is (h,
    w, 1), or the parameter itself without such factors."""
    factors = None if taps is None else getattr(taps, name)
    if taps is None or factors is None:
        return number
    return number * tap_map(factors, taps, shape=shape, dtype=dtype)


def total_gain(sensor: Sensor, *, shape: Shape, dtype: DTypeLike) -> Scalars | None:
    """Return the gain in DN per electron, () or (h, w, 1) with the gains of the taps; None for a
    gain of 1."""
    if sensor.taps is None or sensor.taps.gain is None:
        return sensor.gain
    gain = jnp.ones((), dtype) if sensor.gain is None else sensor.gain
    return factored(gain, sensor.taps, "gain", shape=shape, dtype=dtype)
