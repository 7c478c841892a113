"""Read-out noise, in electrons: noise of pixels, rows, columns and frames, and banding."""

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from ..core._arguments import takes_numbers
from ..core._numerics import safe_sqrt
from ..core._types import Key, Scalar, Scalars
from ..scene import Banding, HeavyTailedReadNoise, ResetNoise, Sensor, TelegraphNoise
from ._draws import (
    Die,
    Frame,
    Shape,
    check_image,
    draw_per_column,
    draw_per_row,
    gaussian,
    uniform,
    words,
)
from ._taps import factored, tap_map
from .dark import BOLTZMANN, ELEMENTARY_CHARGE


def reset_noise_rms(reset: ResetNoise) -> Scalar:
    """Return the reset (kTC) noise of a sense node, sqrt(k T C) / q, where k is the Boltzmann
    constant, T the temperature, C the capacitance and q the elementary charge.

    Args:
        reset: capacitance and temperature of the sense node.

    Returns:
        () electrons rms.

    Example:
        >>> round(float(jv.sensor.reset_noise_rms(jv.ResetNoise(1.6e-15, 300.0))), 1)
        16.1
    """
    # each factor is within the range of float32, but k T C is not
    electrons = BOLTZMANN / ELEMENTARY_CHARGE * reset.temperature
    return safe_sqrt(electrons * (reset.capacitance / ELEMENTARY_CHARGE))


@takes_numbers
def read_out_noise(
    key: Key | None,
    die_key: Key | None,
    sensor: Sensor,
    *,
    shape: Shape,
    dtype: DTypeLike,
) -> Scalars | None:
    """Draw the sum of all noise that the read-out of one frame adds.

    Whether a reading belongs to the tail, and whether a pixel has a trap, are discrete draws.
    Gradients with respect to `tail_fraction` and the fraction of telegraph noise are therefore 0.
    `read_out_variance` has correct gradients with respect to both.

    Args:
        key: random key of the frame.
        die_key: random key of the individual sensor; selects the pixels with traps.
        sensor: of which the fields from `reset_noise` to `banding`, and `taps`, are used.
        shape: shape of the electrons; (..., h, w, bands) for noise of rows, columns and taps.
        dtype: floating dtype of the result.

    Returns:
        Electrons, broadcasting against `shape`; None for a sensor without read-out noise.

    Raises:
        ValueError: if a needed key is None, or if noise of rows, columns or taps is requested for
            data without image axes.

    Example:
        >>> frame = {"shape": (100, 100, 1), "dtype": float}
        >>> sensor = jv.Sensor(read_noise=5.0)  # electrons
        >>> noise = jv.sensor.read_out_noise(jax.random.key(0), None, sensor, **frame)
        >>> print(round(float(noise.std()), 1))
        5.0
    """
    parts = []
    rms = _rms_of_each(key, sensor, shape, dtype)
    if rms is not None:
        parts.append(rms * gaussian(key, Frame.READ, shape, dtype))
    if sensor.telegraph_noise is not None:
        parts.append(_telegraph(key, die_key, sensor.telegraph_noise, shape, dtype))
    if sensor.row_noise is not None:
        parts.append(sensor.row_noise * draw_per_row(key, Frame.ROW, shape, dtype))
    if sensor.column_noise is not None:
        parts.append(sensor.column_noise * draw_per_column(key, Frame.COLUMN, shape, dtype))
    if sensor.frame_noise is not None:
        offset = gaussian(key, Frame.OFFSET, shape[-1:], dtype)
        parts.append(sensor.frame_noise * offset.reshape(*(1,) * (len(shape) - 1), -1))
    if sensor.banding is not None:
        parts.append(_banding(key, sensor.banding, shape, dtype))
    return sum(parts[1:], parts[0]) if parts else None


def read_out_variance(
    sensor: Sensor, *, dtype: DTypeLike, shape: Shape | None = None
) -> Scalar | Scalars:
    """Return the variance of `read_out_noise` in one pixel of a frame, averaged over all pixels.

    Args:
        sensor: the sensor.
        dtype: floating dtype of the result.
        shape: (..., h, w, bands) of the electrons, for the factors of taps; None ignores these.

    Returns:
        () electrons^2; (h, w, 1) for an image whose taps have different read noise.

    Example:
        >>> sensor = jv.Sensor(read_noise=3.0, row_noise=4.0)  # electrons
        >>> print(jv.sensor.read_out_variance(sensor, dtype=float))
        25.0
    """
    variance = jnp.zeros((), dtype)
    match sensor.read_noise:
        case None:
            pass
        case HeavyTailedReadNoise(rms=rms, tail_rms=tail, tail_fraction=fraction):
            variance = variance + (1 - fraction) * rms**2 + fraction * tail**2
        case rms:
            variance = variance + rms**2
    if sensor.taps is not None and sensor.taps.read_noise is not None and shape is not None:
        factors = tap_map(sensor.taps.read_noise, sensor.taps, shape=shape, dtype=dtype)
        variance = variance * factors**2
    if sensor.reset_noise is not None:
        variance = variance + reset_noise_rms(sensor.reset_noise) ** 2
    if sensor.telegraph_noise is not None:
        telegraph = sensor.telegraph_noise
        variance = variance + telegraph.fraction * telegraph.amplitude**2 / 2
    if sensor.row_noise is not None:
        variance = variance + sensor.row_noise**2
    if sensor.column_noise is not None:
        variance = variance + sensor.column_noise**2
    if sensor.frame_noise is not None:
        variance = variance + sensor.frame_noise**2
    if sensor.banding is not None:
        variance = variance + sensor.banding.amplitude**2 / 2
    return variance


def _rms_of_each(key: Key | None, sensor: Sensor, shape: Shape, dtype: DTypeLike) -> Scalars | None:
    """Return the RMS of the sum of reset and read noise in each pixel, which one Gaussian draw
    replaces."""
    match sensor.read_noise:
        case HeavyTailedReadNoise(rms=rms, tail_rms=tail, tail_fraction=fraction):
            in_tail = uniform(key, Frame.READ_TAIL, shape, dtype) <= fraction
            read = jnp.where(in_tail, tail, rms)
        case read:
            pass
    if read is not None:
        read = factored(read, sensor.taps, "read_noise", shape=shape, dtype=dtype)
    if sensor.reset_noise is None:
        return read
    reset = reset_noise_rms(sensor.reset_noise)
    return reset if read is None else safe_sqrt(read**2 + reset**2)


def _telegraph(
    key: Key | None,
    die_key: Key | None,
    telegraph: TelegraphNoise,
    shape: Shape,
    dtype: DTypeLike,
) -> Scalars:
    """Draw the telegraph noise of each pixel: the state of its trap after the read-out minus the
    state before, from two random bits."""
    trapped = uniform(die_key, Die.TRAP, shape, dtype) <= telegraph.fraction
    states = (words(key, Frame.TELEGRAPH, shape) >> 30).astype(jnp.int32)
    jump = (states >> 1) - (states & 1)
    return jnp.where(trapped, telegraph.amplitude * jump.astype(dtype), 0)


def _banding(key: Key | None, banding: Banding, shape: Shape, dtype: DTypeLike) -> Scalars:
    """Draw the banding of a frame: an offset that is a sinusoid of the row, with a random phase."""
    check_image("Sensor.banding", shape)
    rows = jnp.arange(shape[-3], dtype=dtype).reshape(*(1,) * (len(shape) - 3), -1, 1, 1)
    phase = uniform(key, Frame.BANDING, (), dtype).astype(dtype)
    return banding.amplitude * jnp.sin(2 * np.pi * (rows / banding.period + phase))
