"""Electrons to digital numbers: gain, offset, rounding and clipping. In DN."""

import jax.numpy as jnp

from .._numerics import with_gradient_of
from .._types import Key, Scalar, Scalars, Spectrum, check_range
from ..scene import Sensor
from .fixed_pattern import column_gains


def digitise(sensor: Sensor, electrons: Spectrum, *, die_key: Key | None = None) -> Spectrum:
    """DN of (..., bands) electrons: gain, offset, then rounding and clipping by the ADC.

    `die_key` draws the columns' amplifiers; `ValueError` if it is None and they differ. Gradients
    pass through rounding as if there were none, and are 0 where clipped.
    """
    signal = electrons
    if sensor.column_prnu is not None:
        signal = signal * column_gains(
            die_key, sensor.column_prnu, shape=signal.shape, dtype=signal.dtype
        )
    signal = amplified(sensor, signal)
    if sensor.bits is not None:
        # a sensor may have become another dtype's since it was made
        check_range("Sensor.bits", sensor.bits, 1, jnp.finfo(sensor.bits.dtype).nmant + 1)
        signal = with_gradient_of(jnp.round(signal), signal)
        signal = jnp.clip(signal, 0, largest_number(sensor.bits))
    return signal


def amplified(sensor: Sensor, electrons: Scalars) -> Scalars:
    """gain electrons + offset, in DN."""
    signal = electrons if sensor.gain is None else electrons * sensor.gain
    return signal if sensor.offset is None else signal + sensor.offset


def largest_number(bits: Scalar) -> Scalar:
    """2^bits - 1, the largest DN () of an ADC."""
    return jnp.round(jnp.exp2(bits)) - 1
