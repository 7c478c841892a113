"""Irradiance -> photons -> electrons -> noise -> gain -> ADC: the linear model of EMVA 1288.

Read `collect` and `digitise` downward; a step whose parameter is None is not traced. Elementwise
on arrays (..., bands) of any shape, so a whole image is one call and one draw. Photons and
electrons are counted per pixel and exposure.

    mean     mu_y  = K (eta mu_p + mu_d) + offset
    variance var_y = K^2 (eta mu_p + mu_d + sigma_read^2) + 1/12      (temporal)
    pattern  s_y^2 = K^2 ((PRNU eta mu_p)^2 + DSNU^2)                 (from pixel to pixel)

Gradients pass through Poisson draws and rounding as through their expectations, through Gaussian
draws along the draw itself (so that near 0 electrons they are noisy), and are 0 where clipped.
"""

import jax
import jax.numpy as jnp

from ._numerics import safe_sqrt
from ._types import Key, Scalars, Spectrum
from .scene import GaussianShotNoise, PoissonShotNoise, Sensor, ShotNoise

PLANCK = 6.62607015e-34  # J s, exact in the SI since 2019
SPEED_OF_LIGHT = 299792458.0  # m s^-1, exact in the SI
MOST_ELECTRONS = 2.0**30  # larger Poisson means are drawn as this one: counts are 32-bit integers


def photon_rate(irradiance: Spectrum, wavelength: Scalars, pixel_area: Scalars) -> Spectrum:
    """lambda E A / (h c) in photons per second and pixel (EMVA 1288; times t it is mu_p).

    `irradiance`: (..., bands) W m^-2. `wavelength`: () or (bands,) m. `pixel_area`: () m^2.
    """
    per_joule = wavelength / (PLANCK * SPEED_OF_LIGHT)
    return irradiance * _over_bands(pixel_area * per_joule, irradiance)


def mean_photoelectrons(sensor: Sensor, irradiance: Spectrum) -> Spectrum:
    """eta mu_p: expected electrons (..., bands) that light frees in a pixel of mean sensitivity.

    `irradiance`: W m^-2, or photons per second and pixel without a `photon_conversion`.
    """
    electrons = irradiance
    if sensor.photon_conversion is not None:
        conversion = sensor.photon_conversion
        electrons = photon_rate(electrons, conversion.wavelength, conversion.pixel_area)
    if sensor.quantum_efficiency is not None:
        electrons = electrons * _over_bands(sensor.quantum_efficiency, electrons)
    return _over_exposure(sensor, electrons)


def collect(
    key: Key | None, sensor: Sensor, irradiance: Spectrum, *, die_key: Key | None = None
) -> Spectrum:
    """Electrons read from each pixel in one exposure, (..., bands).

    `key` draws shot and read noise, `die_key` the fixed pattern; `ValueError` if one is None and
    needed. `irradiance` as in `mean_photoelectrons`, >= 0 (below counts as 0 where counted).
    """
    shape, dtype = irradiance.shape, irradiance.dtype
    electrons = mean_photoelectrons(sensor, irradiance)
    if sensor.prnu is not None:
        pattern = jax.random.normal(_subkey("die_key", die_key, 0), shape, dtype)
        electrons = electrons * jnp.maximum(1 + sensor.prnu * pattern, 0)
    if sensor.dark_current is not None:
        electrons = electrons + _over_exposure(sensor, sensor.dark_current)
    if sensor.shot_noise is not None:
        electrons = count(_subkey("key", key, 0), electrons, sensor.shot_noise)
    if sensor.full_well is not None:
        electrons = jnp.minimum(electrons, sensor.full_well)
    if sensor.dsnu is not None:
        pattern = jax.random.normal(_subkey("die_key", die_key, 1), shape, dtype)
        electrons = electrons + sensor.dsnu * pattern
    if sensor.read_noise is not None:
        noise = jax.random.normal(_subkey("key", key, 1), shape, dtype)
        electrons = electrons + sensor.read_noise * noise
    return electrons


def count(key: Key, mean: Scalars, shot_noise: ShotNoise) -> Scalars:
    """Electrons counted where `mean` (...) are expected; a mean below 0 counts as 0."""
    match shot_noise:
        case PoissonShotNoise():
            expected = jnp.clip(jax.lax.stop_gradient(mean), 0, MOST_ELECTRONS)
            drawn = jax.random.poisson(key, expected).astype(mean.dtype)
            return _with_gradient_of(drawn, mean)
        case GaussianShotNoise():
            expected = jnp.maximum(mean, 0)
            return expected + safe_sqrt(expected) * jax.random.normal(key, mean.shape, mean.dtype)


def digitise(sensor: Sensor, electrons: Spectrum) -> Spectrum:
    """DN of (..., bands) electrons: gain, offset, then rounding and clipping by the ADC."""
    signal = electrons
    if sensor.gain is not None:
        signal = signal * sensor.gain
    if sensor.offset is not None:
        signal = signal + sensor.offset
    if sensor.bits is not None:
        largest = jnp.round(jnp.exp2(sensor.bits)) - 1
        signal = jnp.clip(_with_gradient_of(jnp.round(signal), signal), 0, largest)
    return signal


def raw_image(
    key: Key | None, sensor: Sensor, irradiance: Spectrum, *, die_key: Key | None = None
) -> Spectrum:
    """The raw data of one exposure in DN, (..., bands), still floating point: `digitise` of
    `collect`, with the same arguments."""
    return digitise(sensor, collect(key, sensor, irradiance, die_key=die_key))


def expected_signal(sensor: Sensor, irradiance: Spectrum) -> Spectrum:
    """mu_y = K (eta mu_p + mu_d) + offset in DN, (..., bands), short of clipping."""
    electrons = mean_photoelectrons(sensor, irradiance) + _mean_dark(sensor, irradiance)
    signal = electrons if sensor.gain is None else electrons * sensor.gain
    return signal if sensor.offset is None else signal + sensor.offset


def signal_variance(sensor: Sensor, irradiance: Spectrum) -> Spectrum:
    """var_y = K^2 (eta mu_p + mu_d + sigma_read^2) + 1/12 in DN^2, (..., bands): of one pixel over
    frames, short of clipping. Rounding counts once, with 1/12, good where the other noise exceeds
    about half a DN."""
    electrons = jnp.zeros_like(irradiance)
    if sensor.shot_noise is not None:
        electrons = mean_photoelectrons(sensor, irradiance) + _mean_dark(sensor, irradiance)
    if sensor.read_noise is not None:
        electrons = electrons + sensor.read_noise**2
    signal = electrons if sensor.gain is None else electrons * sensor.gain**2
    return signal if sensor.bits is None else signal + 1 / 12


def pattern_variance(sensor: Sensor, irradiance: Spectrum) -> Spectrum:
    """s_y^2 = K^2 ((PRNU eta mu_p)^2 + DSNU^2) in DN^2, (..., bands): of the pixels' means over
    the die at uniform irradiance, short of clipping."""
    electrons = jnp.zeros_like(irradiance)
    if sensor.prnu is not None:
        electrons = (sensor.prnu * mean_photoelectrons(sensor, irradiance)) ** 2
    if sensor.dsnu is not None:
        electrons = electrons + sensor.dsnu**2
    return electrons if sensor.gain is None else electrons * sensor.gain**2


def _mean_dark(sensor: Sensor, like: Spectrum) -> Scalars:
    if sensor.dark_current is None:
        return jnp.zeros((), like.dtype)
    return _over_exposure(sensor, sensor.dark_current)


def _over_exposure(sensor: Sensor, rate: Scalars) -> Scalars:
    return rate if sensor.exposure_time is None else rate * sensor.exposure_time


def _over_bands(x: Scalars, like: Spectrum) -> Scalars:
    """A scalar as it is, one value per band broadcast over the pixels."""
    return x if x.ndim == 0 else jnp.broadcast_to(x, like.shape)


def _subkey(name: str, key: Key | None, use: int) -> Key:
    if key is None:
        raise ValueError(f"{name} must be a random key, got None: this sensor draws from it.")
    return jax.random.fold_in(key, use)


@jax.custom_jvp
def _with_gradient_of(value: Scalars, smooth: Scalars) -> Scalars:
    """`value`, differentiated as if it were `smooth`."""
    del smooth
    return value


_with_gradient_of.defjvps(None, lambda tangent, result, value, smooth: tangent)
