"""The mean and variance of raw data in closed form, without random draws, in DN and DN^2.

    mean     mu_y  = K (eta mu_p + mu_d) + offset
    variance var_y = K^2 (eta mu_p + mu_d + sigma_read^2) + 1/12      (temporal)
    pattern  s_y^2 = K^2 ((PRNU eta mu_p)^2 + DSNU^2)                 (from pixel to pixel)

K is the gain, eta mu_p the number of photoelectrons, mu_d the number of dark electrons, and
sigma_read the read noise. Every further noise source of the sensor adds a term. Differences between
the pixels of a die (dead, hot and trapping pixels, columns) enter mean and temporal variance as
averages over dies. With the brighter-fatter effect, a pixel has the variance that it would have in
uniform light with the same mean. Blooming has no closed form and is neglected.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.signal import correlate2d
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool, Float

from ..core._arguments import takes_numbers
from ..core._types import Scalar, Scalars, check_count, is_known
from ..core.parallel_loops import scan
from ..scene import BrighterFatter, FastPoissonShotNoise, PoissonShotNoise, Sensor
from ._clipped_gaussian import (
    is_narrow,
    narrow_window_moments,
    tail_mean,
    tail_square,
    tail_variance,
)
from ._registry import charge_effects, moments_after, stage_of
from ._taps import factored, total_gain
from .adc import amplified, largest_number
from .brighter_fatter import (
    area_changes,
    flat_covariances,
    flat_variance,
    gathered,
    smoothed_pattern,
)
from .ccd import counted_variance, transferred, transferred_variance
from .exposure import Counts, Light, accumulate, expected_charge, mean_dark
from .mixing import mixed
from .read_out import read_out_variance

Covariances = Float[Array, "... lags lags"]  # at offsets of 0, 1, ... rows and columns

_FAR = 50.0  # standard deviations; the tail beyond is 0 even in float64
FAINT = 20.0  # electrons; below this mean, Poisson counts are summed one by one
COUNTS = 64  # number of summed counts; a Poisson variable of mean FAINT exceeds it once in 1e13
ROUNDED = 8  # codes on either side of the mean, which are at least as many standard deviations
QUANTISATION_VARIANCE = 1 / 12  # DN^2, the variance of rounding to whole numbers


class Moments(NamedTuple):
    """The mean and variance of one random quantity.

    Attributes:
        mean: (...) in the unit of the quantity.
        variance: (...) in the square of that unit.

    Example:
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), full_well=1000.0)
        >>> mean, variance = jv.clipped_moments(sensor, jnp.array([100.0]))
        >>> round(float(mean[0]), 3), round(float(variance[0]), 3)  # of a Poisson variable
        (100.0, 100.0)
    """

    mean: Scalars
    variance: Scalars


@takes_numbers
def expected_signal(sensor: Sensor, irradiance: Light) -> Counts:
    """Return the mean raw signal of the EMVA 1288 model, before clipping: mu_y = K (eta mu_p +
    mu_d) + offset.

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


@takes_numbers
def signal_variance(sensor: Sensor, irradiance: Light) -> Counts:
    """Return the temporal variance of one pixel, before clipping, in the notation of EMVA 1288:

        var_y = K^2 (eta mu_p + mu_d + sigma_read^2) + 1/12

    Rounding is assumed to add 1/12 DN^2, which is accurate if the other noise exceeds about half a
    DN.

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


@takes_numbers
def pattern_variance(sensor: Sensor, irradiance: Light) -> Counts:
    """Return the variance of the mean signals of a die's pixels under uniform irradiance, before
    clipping (fixed-pattern noise), in the notation of EMVA 1288:

        s_y^2 = K^2 ((PRNU eta mu_p)^2 + DSNU^2)

    Offsets of columns and rows are added in the same way as those of pixels.

    Args:
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        (..., bands) DN^2.

    Example:
        >>> sensor = jv.Sensor(prnu=0.01, dsnu=5.0)
        >>> round(float(jv.pattern_variance(sensor, jnp.array([1000.0]))[0]), 1)  # 10^2 + 5^2
        125.0
    """
    light = expected_charge(sensor, irradiance)
    variance = jnp.zeros_like(light)
    if sensor.prnu is not None or sensor.dead_pixels is not None:
        square = 0.0
        if sensor.prnu is not None:
            shape, dtype = light.shape, light.dtype
            square = factored(sensor.prnu, sensor.taps, "prnu", shape=shape, dtype=dtype) ** 2
        dead = 0.0 if sensor.dead_pixels is None else sensor.dead_pixels
        variance = (1 - dead) * (square + dead) * light**2
    if sensor.brighter_fatter is not None:
        variance = variance * smoothed_pattern(sensor.brighter_fatter, light)
    if sensor.hot_pixels is not None:
        hot = sensor.hot_pixels
        excess = accumulate(sensor, hot.rate)
        variance = variance + hot.fraction * (2 - hot.fraction) * excess**2
    if sensor.charge_transfer is not None:
        variance = transferred_variance(variance, sensor.charge_transfer)
    if sensor.own is not None:
        names = ", ".join(type(effect).__name__ for effect in sensor.own)
        raise ValueError(f"pattern_variance knows no {names}; draw frames by raw_image.")
    charge = _charge(sensor, irradiance)
    mean = _read(sensor, charge).mean
    if charge_effects(sensor):  # they act on a pattern as on noise
        pattern = Moments(_passed_on(sensor, charge).mean, variance)
        variance = _act(sensor, pattern).variance
    if sensor.conversion_prnu is not None:
        variance = variance + sensor.conversion_prnu**2 * (variance + mean**2)
    for rms in (sensor.dsnu, sensor.column_dsnu, sensor.row_dsnu):
        if rms is not None:
            variance = variance + rms**2
    if sensor.column_prnu is not None:
        variance = variance + sensor.column_prnu**2 * (variance + mean**2)
    gain = total_gain(sensor, shape=variance.shape, dtype=variance.dtype)
    return variance if gain is None else variance * gain**2


@takes_numbers
def neighbour_covariances(
    sensor: Sensor, irradiance: Light, *, reach: int = 1
) -> Float[Array, "... lags lags"]:
    """Return the temporal covariances of a pixel with its neighbours in uniform light, before
    clipping.

    Pixels are correlated by the brighter-fatter effect, by mixing, and by noise of rows, columns
    and frames. At an offset of i rows and j columns, such noise adds row_noise^2 if i = 0,
    column_noise^2 if j = 0, and frame_noise^2. Banding of amplitude a adds (a^2 / 2) cos(2 pi i /
    period).

    Charge packets are assumed to be independent after charge transfer, which is exact for Poisson
    packets. Differences between pixels enter as averages over dies. Neighbours are assumed to have
    the same tap.

    Args:
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel. The
            neighbourhood of each pixel is assumed to be uniform.
        reach: largest offset in pixels, at least 0; static.

    Returns:
        (..., bands, reach + 1, reach + 1) DN^2 at offsets of 0, 1, ... rows and columns. Values at
        (i, j) and (i, -j) are averaged. At (0, 0) it is the variance.

    Raises:
        ValueError: if the sensor has user-defined effects, which may correlate pixels.

    Example:
        >>> mixing = jv.sensor.even_mixing(0.1)
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), mixing=mixing)
        >>> found = jv.sensor.neighbour_covariances(sensor, jnp.full((1, 1, 1), 1000.0))
        >>> [round(float(x), 1) for x in found.ravel()]  # with all farther ones 1000
        [900.0, 24.5, 24.5, 0.3]
    """
    check_count("neighbour_covariances: reach", reach, 0)
    if sensor.own is not None:
        names = ", ".join(type(effect).__name__ for effect in sensor.own)
        raise ValueError(f"neighbour_covariances knows no {names}; draw frames by raw_image.")
    mean, found = _charge_moments(sensor, irradiance, reach)
    if sensor.nonlinearity is not None:
        one = Moments(mean, jnp.ones_like(mean))
        slope = stage_of(sensor.nonlinearity).moments
        assert slope is not None
        found = found * slope(sensor.nonlinearity, one).variance[..., None, None]
    own, rows, columns = _offsets(reach, mean)
    if sensor.conversion_prnu is not None:
        found = found * jnp.where(own, 1 + sensor.conversion_prnu**2, 1)
    common = jnp.zeros(rows.shape, mean.dtype)
    if sensor.row_noise is not None:
        common = common + jnp.where(rows == 0, sensor.row_noise**2, 0)
    if sensor.column_noise is not None:
        common = common + jnp.where(columns == 0, sensor.column_noise**2, 0)
    if sensor.frame_noise is not None:
        common = common + sensor.frame_noise**2
    if sensor.banding is not None:
        turns = rows / sensor.banding.period
        common = common + sensor.banding.amplitude**2 / 2 * jnp.cos(2 * np.pi * turns)
    added = read_out_variance(sensor, dtype=mean.dtype, shape=mean.shape)
    found = found + jnp.where(own, jnp.broadcast_to(added, mean.shape)[..., None, None], common)
    if sensor.column_prnu is not None:
        found = found * jnp.where(columns == 0, 1 + sensor.column_prnu**2, 1)
    gain = total_gain(sensor, shape=mean.shape, dtype=mean.dtype)
    if gain is not None:
        found = found * jnp.broadcast_to(gain, mean.shape)[..., None, None] ** 2
    return found if sensor.bits is None else found + jnp.where(own, QUANTISATION_VARIANCE, 0)


@takes_numbers
def signal_to_noise(sensor: Sensor, irradiance: Light) -> Counts:
    """Return the signal-to-noise ratio of one pixel: the signal without its dark part, divided by
    the temporal noise, before clipping.

        SNR = eta mu_p / sqrt(eta mu_p + mu_d + sigma_read^2 + 1 / (12 K^2))

    Differences between pixels, which flat-field correction removes, are not included; see
    `pattern_variance`.

    Args:
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        (..., bands) no unit; 20 log10 of it is in dB. Infinite for light without noise, NaN without
        light and noise.

    Source:
        EMVA Standard 1288, Release 3.1, equation 21.

    Example:
        >>> sensor = jv.Sensor(quantum_efficiency=0.5, shot_noise=jv.PoissonShotNoise())
        >>> float(jv.sensor.signal_to_noise(sensor, jnp.array([20_000.0]))[0])  # of 1e4 electrons
        100.0
    """
    dark = jnp.zeros_like(irradiance)
    lit, unlit = (_read(sensor, _charge(sensor, light)) for light in (irradiance, dark))
    gain = total_gain(sensor, shape=lit.mean.shape, dtype=lit.mean.dtype)
    signal = lit.mean - unlit.mean
    signal = signal if gain is None else signal * gain
    return signal / jnp.sqrt(_signal(sensor, lit).variance)


@takes_numbers
def clipped_moments(sensor: Sensor, irradiance: Light) -> Moments:
    """Return the mean and temporal variance of raw data clipped by a full well and the ADC's range.

    Below 20 electrons, moments are summed over all Poisson counts, except with the brighter-fatter
    effect, charge transfer inefficiency, mixing, or unequal gains. In all other cases the signal
    before clipping is assumed to be Gaussian, which is exact for Gaussian noise. For Poisson noise,
    the error of the mean is less than 0.07 times the noise's RMS divided by sqrt(electrons at the
    clipping level). Rounding is exact for noise below 1 DN, and is assumed to add 1/12 DN^2 for
    larger noise. The result is smooth in every parameter of a noisy sensor, and its gradients fall
    to 0 beyond saturation.

    Args:
        sensor: its `full_well` and `bits` clip.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        Mean (..., bands) in DN and variance (..., bands) in DN^2.

    Example:
        The readings scatter about 0, and the negative half of them is clipped to 0.

        >>> sensor = jv.Sensor(read_noise=100.0, bits=12)
        >>> moments = jv.clipped_moments(sensor, jnp.zeros(1))
        >>> round(float(moments.mean[0]), 1)  # 100 / sqrt(2 pi)
        39.9
    """
    charge = _charge(sensor, irradiance)
    mean = charge.mean
    if sensor.full_well is not None:
        charge = censored(charge, high=sensor.full_well)
    gaussian = _convert(sensor, _read(sensor, charge))
    counted = isinstance(sensor.shot_noise, PoissonShotNoise | FastPoissonShotNoise)
    clips = sensor.full_well is not None or sensor.bits is not None
    spread = (sensor.charge_transfer, sensor.mixing, sensor.conversion_prnu, sensor.column_prnu)
    if not (counted and clips) or any(x is not None for x in (*spread, sensor.brighter_fatter)):
        return gaussian
    faint = (mean >= 0) & (mean < FAINT)
    return jax.lax.cond(
        jnp.any(faint),
        lambda: jax.tree.map(
            partial(jnp.where, faint),
            _count_sum_moments(sensor, jnp.where(faint, mean, 1)),
            gaussian,
        ),
        lambda: gaussian,
    )


@takes_numbers
def censored(moments: Moments, *, low: Scalar | None = None, high: Scalar | None = None) -> Moments:
    """Return the moments of a Gaussian variable clipped to [low, high].

    Args:
        moments: mean and variance (...) before clipping, in any unit and its square.
        low: () lower end in the unit of the mean; None or -inf does not clip.
        high: () upper end in the unit of the mean; None or inf does not clip.

    Returns:
        Mean and variance (...) after clipping, in the same units. Where the variance is 0, the mean
        is clipped and the variance stays 0.

    Raises:
        ValueError: for a low end above the high end, unless traced.

    Example:
        >>> gaussian = jv.Moments(jnp.array(0.0), jnp.array(1.0))
        >>> half = jv.sensor.censored(gaussian, low=jnp.array(0.0))
        >>> round(float(half.mean), 6)  # 1 / sqrt(2 pi)
        0.398942
    """
    known = low is not None and high is not None and is_known(low) and is_known(high)
    if known and np.any(np.asarray(low) > np.asarray(high)):
        raise ValueError(f"censored: low must not be above high, got {low} and {high}.")
    mean, variance = moments
    noisy = ~(variance <= 0)
    sigma = jnp.sqrt(jnp.where(noisy, variance, 1))
    # at an end, take the slopes on the mean's side here and in `_outside`; their sum is right
    clipped = mean
    if low is not None:
        clipped = jnp.where(clipped < low, low, clipped)
    if high is not None:
        clipped = jnp.where(clipped > high, high, clipped)
    if low is None or high is None:
        moved, spread = _one_end_moments(mean, sigma, clipped, low=low, high=high)
    else:
        moved, spread = _both_ends_moments(mean, sigma, clipped, low, high)
    return Moments(jnp.where(noisy, moved, clipped), jnp.where(noisy, spread, 0))


def _one_end_moments(
    mean: Scalars, sigma: Scalars, clipped: Scalars, *, low: Scalar | None, high: Scalar | None
) -> tuple[Scalars, Scalars]:
    """Return mean and variance of a Gaussian variable that is clipped at one end or at neither."""
    if low is not None:
        sign, end = 1, low
    elif high is not None:
        sign, end = -1, high
    else:
        return mean, sigma * sigma
    inside = _inside(mean, sigma, end, sign)
    moved = clipped + sign * sigma * tail_mean(_outside(inside))
    return moved, sigma * sigma * tail_variance(inside)


def _both_ends_moments(
    mean: Scalars, sigma: Scalars, clipped: Scalars, low: Scalar, high: Scalar
) -> tuple[Scalars, Scalars]:
    """Return mean and variance of a Gaussian clipped to [low, high]. The clipped variable is low +
    sigma (A - B), with A = max(Z + p, 0) and B = max(Z - q, 0). Z is a standard Gaussian variable,
    and p and q are the distances of the mean from the two ends, divided by sigma. If sigma is much
    larger than the window, a series is used instead."""
    p, q = _inside(mean, sigma, low, 1), _inside(mean, sigma, high, -1)
    moved = clipped + sigma * (tail_mean(_outside(p)) - tail_mean(_outside(q)))
    near, far = jnp.minimum(p, q), jnp.maximum(p, q)
    lost = tail_mean(-far)
    both = tail_square(-far) + (near + far) * lost - tail_mean(near) * lost
    spread = jnp.maximum(tail_variance(near) + tail_variance(-far) - 2 * both, 0)

    bounded = jnp.isfinite(low) & jnp.isfinite(high)
    first, last = jnp.where(bounded, low, 0), jnp.where(bounded, high, 0)
    middle = (first + last) / 2 - mean
    width, offset = (last - first) / sigma, jnp.abs(middle) / sigma
    narrow = bounded & is_narrow(width, offset)
    taken = bounded & is_narrow(width / 2, offset)
    part, square = narrow_window_moments(jnp.where(taken, width, 0), jnp.where(taken, offset, 0))
    within = (last - first) * part
    within = jnp.where(middle < 0, last - within, first + within)
    return (
        jnp.where(narrow, within, moved),
        jnp.where(narrow, (last - first) ** 2 * square, sigma * sigma * spread),
    )


def _inside(mean: Scalars, sigma: Scalars, end: Scalar, sign: int) -> Scalars:
    """Return the distance of the mean from an end of the range, in standard deviations, positive
    inside the range. `sign` is 1 for the low end, -1 for the high end."""
    clips = ~jnp.isinf(end)
    return jnp.where(clips, sign * (mean - jnp.where(clips, end, 0)) / sigma, _FAR)


def _outside(inside: Scalars) -> Scalars:
    """Return the negative absolute value of a distance in standard deviations, -|inside|."""
    return jnp.where(inside < 0, inside, -inside)


def _charge(sensor: Sensor, irradiance: Light) -> Moments:
    """Return the moments of the electrons in a pixel, before clipping by the full well."""
    mean = expected_charge(sensor, irradiance)
    if sensor.dead_pixels is not None:
        mean = mean * (1 - sensor.dead_pixels)
    mean = mean + mean_dark(sensor, mean)
    if sensor.hot_pixels is not None:
        hot = sensor.hot_pixels
        mean = mean + accumulate(sensor, hot.fraction * hot.rate)
    effect = sensor.brighter_fatter
    if effect is not None:
        mean = gathered(None, mean, effect, full_well=sensor.full_well)
    if sensor.shot_noise is None:
        return Moments(mean, jnp.zeros_like(mean))
    counted = jnp.maximum(mean, 0)
    return Moments(mean, counted if effect is None else flat_variance(effect, counted))


def _read(sensor: Sensor, charge: Moments) -> Moments:
    """Return the moments of the electrons after read-out noise is added."""
    mean, variance = _act(sensor, _passed_on(sensor, charge))
    if None not in (sensor.mixing, sensor.brighter_fatter, sensor.shot_noise):
        variance = variance * _repelled_share(sensor, charge.mean)
    if sensor.conversion_prnu is not None:
        variance = variance * (1 + sensor.conversion_prnu**2)
    added = read_out_variance(sensor, dtype=mean.dtype, shape=mean.shape)
    return Moments(mean, variance + added)


def _repelled_share(sensor: Sensor, mean: Scalars) -> Scalars:
    """Return the ratio of two variances after mixing: with charges that the brighter-fatter effect
    correlates, and with independent charges of the same variance."""
    assert sensor.mixing is not None
    assert sensor.brighter_fatter is not None
    lit, kernel = mean > 0, sensor.mixing.kernel.astype(mean.dtype)
    found = _repel(sensor.brighter_fatter, jnp.where(lit, mean, 1), _farthest(sensor))
    alone = found[..., 0, 0] * jnp.sum(kernel**2)
    return jnp.where(lit, _mix(kernel, found, 0)[..., 0, 0] / alone, 1)


def _charge_moments(sensor: Sensor, irradiance: Light, reach: int) -> tuple[Scalars, Covariances]:
    """Return the mean of the charges after charge transfer and mixing, and their covariances,
    electrons^2."""
    charge = _charge(sensor, irradiance)
    mean, variance = _passed_on(sensor, charge)
    size = reach + _farthest(sensor)
    if sensor.brighter_fatter is not None and sensor.shot_noise is not None:
        found = _repel(sensor.brighter_fatter, jnp.maximum(charge.mean, 0), size)
    else:
        found = jnp.where(_offsets(size, mean)[0], variance[..., None, None], 0)
    if sensor.mixing is None:
        return mean, found
    kernel = sensor.mixing.kernel.astype(mean.dtype)
    return mixed(mean, sensor.mixing), _mix(kernel, found, reach)


def _offsets(reach: int, like: Scalars) -> tuple[Array, Array, Array]:
    """Return the offsets of up to `reach` rows and columns, with axes for broadcasting: whether
    each is (0, 0), its rows, and its columns."""
    along = np.indices((reach + 1, reach + 1)).reshape(2, *(1,) * like.ndim, reach + 1, reach + 1)
    rows, columns = (jnp.asarray(x, like.dtype) for x in along)
    return (rows == 0) & (columns == 0), rows, columns


def _farthest(sensor: Sensor) -> int:
    """Return the largest distance, in pixels, at which mixing correlates two pixels."""
    return 0 if sensor.mixing is None else max(sensor.mixing.kernel.shape) - 1


def _repel(effect: BrighterFatter, electrons: Scalars, reach: int) -> Covariances:
    """Return `flat_covariances` at offsets of up to `reach` rows and columns, electrons^2."""
    area = area_changes(effect.kernel)
    size = max(reach + 1, *area.shape)
    area = jnp.pad(area, [(0, size - n) for n in area.shape])
    return flat_covariances(area, electrons)[..., : reach + 1, : reach + 1]


def _mix(
    kernel: Float[Array, "rows columns"], found: Covariances, reach: int
) -> Float[Array, "... kept kept"]:
    """Return the covariances after mixing up to an offset of `reach`, given the covariances before
    mixing, which must extend farther."""
    shared = correlate2d(kernel, kernel, mode="full")  # sum w(k) w(k + lag)
    shared = (shared + shared[:, ::-1]) / 2
    lags = np.arange(reach + 1)
    above, beside = (np.abs(lags[:, None] - (np.arange(n) - n // 2)) for n in shared.shape)
    around = found[..., above, :][..., beside]  # (..., lag of rows, shift, lag of columns, shift)
    return jnp.einsum("...iajb,ab->...ij", around, shared)


def _passed_on(sensor: Sensor, charge: Moments) -> Moments:
    """Return the moments of the electrons after charge transfer."""
    if sensor.charge_transfer is None:
        return charge
    mean, variance = charge
    if sensor.shot_noise is not None:
        variance = counted_variance(jnp.maximum(mean, 0), variance, sensor.charge_transfer)
    return Moments(transferred(mean, sensor.charge_transfer), variance)


def _act(sensor: Sensor, charge: Moments) -> Moments:
    """Return the moments of the electrons after all effects on charge."""
    return moments_after(charge_effects(sensor), charge)


def _count_sum_moments(sensor: Sensor, mean: Scalars) -> Moments:
    """Return the moments of the raw numbers for Poisson counts with a small mean (below FAINT), by
    a sum over all counts below COUNTS."""
    about = _convert(sensor, _read(sensor, Moments(mean, jnp.zeros_like(mean)))).mean
    about = jax.lax.stop_gradient(about)

    def count(
        sums: tuple[Scalars, Scalars, Scalars], electrons: Scalar
    ) -> tuple[tuple[Scalars, Scalars, Scalars], None]:
        chance, first, second = sums
        held = electrons if sensor.full_well is None else jnp.minimum(electrons, sensor.full_well)
        charge = Moments(jnp.full_like(mean, held), jnp.zeros_like(mean))
        found = _convert(sensor, _read(sensor, charge), of_one_count=True)
        off = found.mean - about
        first = first + chance * off
        second = second + chance * (found.variance + off**2)
        return (chance * mean / (electrons + 1), first, second), None

    nothing = jnp.zeros_like(mean)
    counts = jnp.arange(COUNTS, dtype=mean.dtype)
    (_, first, second), _ = scan(count, (jnp.exp(-mean), nothing, nothing), counts)
    return Moments(about + first, jnp.maximum(second - first**2, 0))


def _convert(sensor: Sensor, read: Moments, *, of_one_count: bool = False) -> Moments:
    """Return the moments of the numbers of the ADC, in DN. Without noise, rounding is assumed to
    add 1/12 DN^2, except for a single count of electrons (`of_one_count`) and with shot noise, as
    in a full well. For these, rounding is exact."""
    if sensor.bits is None:
        return _signal(sensor, read)
    analogue = _signal(replace(sensor, bits=None), read)
    low, high = jnp.zeros_like(sensor.bits), largest_number(sensor.bits)
    wide = censored(
        Moments(analogue.mean, analogue.variance + QUANTISATION_VARIANCE), low=low, high=high
    )
    fine = analogue.variance < 1  # DN^2
    if not of_one_count and sensor.shot_noise is None:
        fine = fine & (analogue.variance > 0)
    return jax.tree.map(partial(jnp.where, fine), _round(analogue, fine, high), wide)


def _round(analogue: Moments, fine: Bool[Array, "..."], high: Scalar) -> Moments:
    """Return the moments of a signal x with Gaussian noise below 1 DN RMS, rounded to whole numbers
    from 0 to `high`. With P_c = P(x > c + 1/2), the mean is the sum of P_c over the numbers c, and
    the mean square is the sum of (2 c + 1) P_c."""
    noisy = fine & (analogue.variance > 0)
    sigma = jnp.sqrt(jnp.where(noisy, analogue.variance, 1))
    base = jax.lax.stop_gradient(jnp.floor(analogue.mean)) - ROUNDED
    first = second = jnp.zeros_like(analogue.mean)
    start = jnp.clip(base, 0, high)
    for step in range(2 * ROUNDED + 1):
        code = base + step
        beyond = analogue.mean - code - 0.5
        above = jnp.round(analogue.mean) > code  # of a half, the even neighbour, as in `digitise`
        chance = jnp.where(noisy, ndtr(beyond / sigma), above.astype(beyond.dtype))
        chance = jnp.where((code >= 0) & (code < high), chance, 0)
        first = first + chance
        second = second + (2 * (code - start) + 1) * chance
    return Moments(start + first, jnp.maximum(second - first**2, 0))


def _signal(sensor: Sensor, read: Moments) -> Moments:
    """Return the moments of the signal in DN, before clipping."""
    variance = read.variance
    if sensor.column_prnu is not None:
        variance = variance * (1 + sensor.column_prnu**2)
    gain = total_gain(sensor, shape=variance.shape, dtype=variance.dtype)
    if gain is not None:
        variance = variance * gain**2
    if sensor.bits is not None:
        variance = variance + QUANTISATION_VARIANCE
    return Moments(amplified(sensor, read.mean), variance)
