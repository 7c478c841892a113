"""Expectation and variance of raw data in closed form, without a random draw. In DN and DN^2.

    mean     mu_y  = K (eta mu_p + mu_d) + offset
    variance var_y = K^2 (eta mu_p + mu_d + sigma_read^2) + 1/12      (temporal)
    pattern  s_y^2 = K^2 ((PRNU eta mu_p)^2 + DSNU^2)                 (from pixel to pixel)

and every further source of the sensor beside these. Differences between the pixels of a die (dead,
hot and trapping pixels, columns) enter the mean and the temporal variance as averages over dies.
Blooming has no closed form and is left out.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.special import ndtr
from jax.scipy.stats import norm

from .._types import Scalar, Scalars
from ..scene import Sensor
from .adc import amplified, largest_number
from .ccd import counted_variance, transferred, transferred_variance
from .exposure import Counts, Light, expected_charge, mean_dark, over_exposure
from .read_out import read_out_variance

_FAR = 50.0  # standard deviations: the tail beyond is 0 even in float64
QUANTISATION_VARIANCE = 1 / 12  # DN^2, the variance of rounding to whole numbers


class Moments(NamedTuple):
    """Mean and variance of one quantity.

    Attributes:
        mean: (...) in the unit of the quantity.
        variance: (...) in the square of that unit.
    """

    mean: Scalars
    variance: Scalars


def expected_signal(sensor: Sensor, irradiance: Light) -> Counts:
    """Mean raw signal of the EMVA 1288 model, before clipping: mu_y = K (eta mu_p + mu_d) + offset.

    Args:
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        (..., bands) DN.

    Example:
        >>> sensor = jv.Sensor(quantum_efficiency=0.5, exposure_time=0.01, gain=0.4, offset=64.0)
        >>> float(jv.expected_signal(sensor, jnp.array([1e5]))[0])
        264.0
    """
    return amplified(sensor, _read(sensor, _charge(sensor, irradiance)).mean)


def signal_variance(sensor: Sensor, irradiance: Light) -> Counts:
    """Temporal variance of one pixel, before clipping.

        var_y = K^2 (eta mu_p + mu_d + sigma_read^2) + 1/12

    Rounding adds 1/12 DN^2 once, which holds where the other noise exceeds about half a DN.

    Args:
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        (..., bands) DN^2.

    Example:
        >>> noise = dict(shot_noise=jv.PoissonShotNoise(), read_noise=4.0)
        >>> sensor = jv.Sensor(gain=0.5, bits=12, **noise)
        >>> round(float(jv.signal_variance(sensor, jnp.array([500.0]))[0]), 4)
        129.0833
    """
    return _signal(sensor, _read(sensor, _charge(sensor, irradiance))).variance


def pattern_variance(sensor: Sensor, irradiance: Light) -> Counts:
    """Variance of the pixels' mean signals over the die under uniform irradiance, before clipping.

        s_y^2 = K^2 ((PRNU eta mu_p)^2 + DSNU^2)

    Columns and rows count like pixels.

    Args:
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        (..., bands) DN^2.
    """
    light = expected_charge(sensor, irradiance)
    variance = jnp.zeros_like(light)
    if sensor.prnu is not None or sensor.dead_pixels is not None:
        square = 0.0 if sensor.prnu is None else sensor.prnu**2
        alive = 1.0 if sensor.dead_pixels is None else 1 - sensor.dead_pixels
        variance = alive * (square + 1 - alive) * light**2
    if sensor.hot_pixels is not None:
        hot = sensor.hot_pixels
        excess = over_exposure(sensor, hot.rate)
        variance = variance + hot.fraction * (2 - hot.fraction) * excess**2
    if sensor.charge_transfer is not None:
        variance = transferred_variance(variance, sensor.charge_transfer)
    mean = _read(sensor, _charge(sensor, irradiance)).mean
    if sensor.conversion_prnu is not None:
        variance = variance + sensor.conversion_prnu**2 * (variance + mean**2)
    for rms in (sensor.dsnu, sensor.column_dsnu, sensor.row_dsnu):
        if rms is not None:
            variance = variance + rms**2
    if sensor.column_prnu is not None:
        variance = variance + sensor.column_prnu**2 * (variance + mean**2)
    return variance if sensor.gain is None else variance * sensor.gain**2


def clipped_moments(sensor: Sensor, irradiance: Light) -> Moments:
    """Mean and temporal variance of raw data that a full well and the range of the ADC clip.

    The clipped variable is taken as Gaussian: exact for Gaussian noise; for Poisson noise the mean
    is off by less than 0.07 of the noise's rms over sqrt(electrons at the clipping level). Smooth
    in every parameter, with gradients that fall to 0 beyond saturation.

    Args:
        sensor: the sensor; `full_well` and `bits` clip.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        Mean (..., bands) in DN and variance (..., bands) in DN^2.
    """
    charge = _charge(sensor, irradiance)
    if sensor.full_well is not None:
        charge = censored(charge, high=sensor.full_well)
    signal = _signal(sensor, _read(sensor, charge))
    if sensor.bits is None:
        return signal
    return censored(signal, low=jnp.zeros_like(sensor.bits), high=largest_number(sensor.bits))


def censored(moments: Moments, *, low: Scalar | None = None, high: Scalar | None = None) -> Moments:
    """Moments of a Gaussian variable clipped to [low, high].

    Args:
        moments: mean and variance (...) before clipping, in any unit and its square.
        low: () lower end in the unit of the mean; None or -inf does not clip.
        high: () upper end in the unit of the mean; None or inf does not clip.

    Returns:
        Mean and variance (...) after clipping, in the same units. Where the variance is 0, the
        clipped mean and variance 0.

    Example:
        >>> gaussian = jv.Moments(jnp.array(0.0), jnp.array(1.0))
        >>> half = jv.sensor.censored(gaussian, low=jnp.array(0.0))
        >>> round(float(half.mean), 6)  # 1 / sqrt(2 pi)
        0.398942
    """
    mean, variance = moments
    noisy = variance > 0
    sigma = jnp.sqrt(jnp.where(noisy, variance, 1))
    clipped = mean
    if low is not None:
        clipped = jnp.maximum(clipped, low)
    if high is not None:
        clipped = jnp.minimum(clipped, high)
    moved, spread, losses = clipped, jnp.ones_like(mean), []
    for end, sign in ((low, 1), (high, -1)):
        if end is None:
            continue
        clips = jnp.isfinite(end)
        inside = jnp.where(clips, sign * (mean - jnp.where(clips, end, 0)) / sigma, _FAR)
        moved = moved + sign * sigma * _tail_mean(-jnp.abs(inside))
        spread = spread - 2 * ndtr(-inside) + _tail_variance(-inside)
        losses.append(_tail_mean(-inside))
    if len(losses) == 2:
        spread = spread + 2 * losses[0] * losses[1]
    return Moments(
        jnp.where(noisy, moved, clipped), jnp.where(noisy, sigma**2 * jnp.maximum(spread, 0), 0)
    )


def _charge(sensor: Sensor, irradiance: Light) -> Moments:
    """Moments of the electrons in a pixel, before any well is full."""
    mean = expected_charge(sensor, irradiance)
    if sensor.dead_pixels is not None:
        mean = mean * (1 - sensor.dead_pixels)
    mean = mean + mean_dark(sensor, mean)
    if sensor.hot_pixels is not None:
        hot = sensor.hot_pixels
        mean = mean + over_exposure(sensor, hot.fraction * hot.rate)
    counted = sensor.shot_noise is not None
    return Moments(mean, jnp.maximum(mean, 0) if counted else jnp.zeros_like(mean))


def _read(sensor: Sensor, charge: Moments) -> Moments:
    """Moments of the electrons that are read out."""
    mean, variance = charge
    if sensor.charge_transfer is not None:
        if sensor.shot_noise is not None:
            variance = counted_variance(jnp.maximum(mean, 0), variance, sensor.charge_transfer)
        mean = transferred(mean, sensor.charge_transfer)
    if sensor.conversion_prnu is not None:
        variance = variance * (1 + sensor.conversion_prnu**2)
    return Moments(mean, variance + read_out_variance(sensor, dtype=mean.dtype))


def _signal(sensor: Sensor, read: Moments) -> Moments:
    """Moments of the signal in DN, before clipping."""
    variance = read.variance
    if sensor.column_prnu is not None:
        variance = variance * (1 + sensor.column_prnu**2)
    if sensor.gain is not None:
        variance = variance * sensor.gain**2
    if sensor.bits is not None:
        variance = variance + QUANTISATION_VARIANCE
    return Moments(amplified(sensor, read.mean), variance)


def _tail_mean(t: Scalars) -> Scalars:
    """E[max(Z + t, 0)] of a standard Gaussian Z."""
    return t * ndtr(t) + norm.pdf(t)


def _tail_variance(t: Scalars) -> Scalars:
    """Var[max(Z + t, 0)] of a standard Gaussian Z, keeping its digits at large |t|."""
    below = -jnp.abs(t)
    rare = (below**2 + 1) * ndtr(below) + below * norm.pdf(below) - _tail_mean(below) ** 2
    return jnp.where(t > 0, 1 - 2 * ndtr(below) + rare, rare)
