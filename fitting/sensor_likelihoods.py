"""Likelihoods by a sensor model: the prediction is light, and the data are the sensor's digital
numbers.

`SensorNoise` is Gaussian, with the sensor's mean and variance for each datum. `SensorCounts` uses
the exact probability of every code, for codes that are coarse relative to the noise and for few
electrons. The data of `SensorCounts` are codes, or tables of how often each code occurs. Both
classes have the interface of `inference.likelihoods`. Instead of a sensor, both accept its path in
the problem's records, such as "camera.sensor". Then fields of the sensor, such as
"camera.sensor.gain", can be fitted, too.
"""

from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float

from jaxvision import PoissonShotNoise, Sensor
from jaxvision.core.parallel_loops import fori_loop
from jaxvision.errors import InputError
from jaxvision.sensor import (
    charge_of_signal,
    count,
    expected_signal,
    read_out_variance,
    signal_of_charge,
    signal_variance,
)
from jaxvision.sensor.adc import amplified, largest_number
from jaxvision.sensor.moments import QUANTISATION_VARIANCE

from .inference.given import is_concrete, plain_numbers
from .inference.likelihoods import Censored, Numbers, numerics
from .inference.tails import log1mexp, log_ndtr, ndtri_exp
from .poisson import log_poisson, log_poisson_tails

OPEN_END = 1e9  # standard deviations to an open end: farther than any two codes
ROUNDING = 0.5  # DN between a code and the ends of its interval


class SensorNoise(eqx.Module):
    """The Gaussian likelihood of a sensor: each datum is normal with the sensor's mean signal and
    temporal variance.

    Codes at either end of the ADC's range are treated as censored. Fixed pattern (differences
    between pixels) and full well are not included.

    Attributes:
        sensor: record, or the path of one in the problem's records.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import SensorNoise
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), gain=0.5, offset=10.0, bits=12)
        >>> density = SensorNoise(sensor).log_density(jnp.array([400.0]), jnp.array([210.0]))
        >>> round(float(density[0]), 4)  # -ln sqrt(2 pi (0.25 * 400 + 1/12))
        -3.2219
    """

    sensor: Sensor | str
    least_squares = False  # the variance depends on the light

    @property
    def surrogate(self) -> "_VarianceOfData | None":
        """The least-squares cost with the variance at each datum; None if the sensor is a path."""
        return None if isinstance(self.sensor, str) else _VarianceOfData(self.sensor)

    def log_density(self, prediction: Array, data: Array) -> Array:
        """Return the Gaussian log density; at an end of the range, ln of the probability beyond it.

        Args:
            prediction: (..., bands) light, as in `mean_photoelectrons`.
            data: (..., bands) DN.

        Returns:
            (..., bands).
        """
        return self._signal(prediction).log_density(self._mean(prediction), data)

    def residuals(self, prediction: Array, data: Array, chance: Numbers) -> Numbers:
        """Return normal deviates of the data under the model."""
        return self._signal(prediction).residuals(self._mean(prediction), data, chance)

    def draw(self, key: Array, prediction: Array) -> Array:
        """Simulate data, rounded and clipped if the sensor has an ADC."""
        sensor, prediction = _record(self.sensor), jnp.asarray(prediction)
        analogue = _drop_fields(sensor, "bits")
        deviation = jnp.sqrt(signal_variance(analogue, prediction))  # without rounding
        signal = Censored(deviation).draw(key, self._mean(prediction))
        bits = sensor.bits
        return signal if bits is None else jnp.clip(jnp.round(signal), 0, largest_number(bits))

    def noise_sources(self, prediction: Array) -> dict[str, Array]:
        """Return the variance of a datum, divided by noise source.

        Args:
            prediction: (..., bands) light.

        Returns:
            (..., bands) DN^2 for each source: photons (with the electrons of the dark current),
            read-out and rounding.
        """
        sensor, prediction = _record(self.sensor), jnp.asarray(prediction)
        whole = signal_variance(sensor, prediction)
        gain = jnp.ones(()) if sensor.gain is None else sensor.gain
        read = jnp.broadcast_to(gain**2 * read_out_variance(sensor, dtype=whole.dtype), whole.shape)
        rounding = jnp.full_like(whole, 0 if sensor.bits is None else QUANTISATION_VARIANCE)
        return {"photons": whole - read - rounding, "read noise": read, "rounding": rounding}

    def _mean(self, prediction: Array) -> Array:
        """Return the expected signal before clipping, DN."""
        return expected_signal(_record(self.sensor), _light("SensorNoise", prediction))

    def _signal(self, prediction: Array) -> Censored:
        light = _light("SensorNoise", prediction)
        deviation = jnp.sqrt(signal_variance(_record(self.sensor), light))
        bits = _record(self.sensor).bits
        if bits is None:
            return Censored(deviation)
        return Censored(deviation, ROUNDING, largest_number(bits) - ROUNDING)


class _VarianceOfData(eqx.Module):
    """A least-squares cost for distant starts of a search. The variance of each datum is computed
    for the light that would give this datum in a linear sensor. A search from a distant start then
    needs few steps. With the variance at the prediction, any very bright prediction would seem
    likely."""

    sensor: Sensor
    least_squares = True
    surrogate = None

    def residuals(self, prediction: Array, data: Array, chance: Numbers) -> Array:
        """Return (data - prediction) / sd. For a datum at an end of the range it is 0 if the
        prediction lies beyond that end."""
        del chance
        light = _light("SensorNoise", prediction)
        dark, slope = jax.jvp(
            lambda light: expected_signal(self.sensor, light),
            (jnp.zeros_like(light),),
            (jnp.ones_like(light),),
        )
        of_data = jnp.maximum(data - dark, 0) / jnp.where(slope > 0, slope, jnp.inf)
        variance = signal_variance(self.sensor, jnp.broadcast_to(of_data, light.shape))
        missed = data - expected_signal(self.sensor, light)
        if self.sensor.bits is not None:
            top = largest_number(self.sensor.bits)
            missed = jnp.where(data >= top, jnp.maximum(missed, 0), missed)
            missed = jnp.where(data <= 0, jnp.minimum(missed, 0), missed)
        return missed / jnp.sqrt(variance)


_HALVINGS = 40  # of the range of counts, to less than one of 1e12
_NEIGHBOUR_EFFECTS = ("brighter_fatter", "charge_transfer", "own", "mixing")  # effects of a sensor


class _Reading(NamedTuple):
    """The read-out of pixels: gain, DN per electron, offset, DN, noise, electrons rms."""

    gain: Array
    offset: Array
    noise: Array


class SensorCounts(eqx.Module):
    """The exact likelihood of a sensor's codes: Poisson electrons, read out with Gaussian noise,
    rounded and clipped. For mu expected electrons, gain K and read noise sigma (electrons), code c
    has the probability

        P(c) = sum_n Poisson(n; mu) [Phi(z_n + 1 / (2 K sigma)) - Phi(z_n - 1 / (2 K sigma))],
        z_n  = (c - offset - K s(n)) / (K sigma)

    This is exact at any read noise. A likelihood by mean and variance is inexact below a read noise
    of half a DN. Below a read noise of one electron, the histogram has a peak for each number of
    electrons, which mean and variance do not show. s(n) is the sensor's nonlinearity, or n without
    one. The sensor's light offset and taps are included. The sensor needs shot noise, read noise
    and gain. Fixed pattern (differences between pixels) and full well are not included. The sum
    covers the electron counts within `reach` of its largest term, which lies between the mean and
    the count that corresponds to the code. The computing time grows with the read noise in
    electrons.

    Attributes:
        sensor: record, or the path of one in the problem's records.
        reach: range of the sum on either side, electrons. It must be at least eight times the read
            noise plus half a DN, both in electrons.
        codes: (codes,) or of the data's shape, DN. If `codes` are given, the data are tables, (...,
            codes): how many pixels and frames have each code. The prediction (..., codes) is then
            the light of each table, repeated along its codes. Counts outside a table are unknown,
            so the probabilities within it are normalised to 1. None if each datum is a code.
        totals: () or (..., 1) total count of each table, for `draw`; None takes the totals of the
            problem's data.

    Raises:
        InputError: for a sensor that does not count single electrons or whose pixels share charge,
            for a reach that is too short, and for codes that are not whole numbers.

    Example:
        The probabilities of all codes sum to 1. In a table, each number is the count of its code.

        >>> import jaxvision as jv
        >>> from fitting import SensorCounts
        >>> noise = dict(shot_noise=jv.PoissonShotNoise(), read_noise=0.3)
        >>> sensor = jv.Sensor(**noise, gain=1.0, bits=4)
        >>> light, codes = jnp.full(16, 2.0), jnp.arange(16.0)
        >>> density = SensorCounts(sensor, reach=16).log_density(light, codes)
        >>> round(float(jnp.exp(density).sum()), 4)
        1.0
        >>> table = jnp.zeros(16).at[2].set(100.0)  # 100 times the code 2
        >>> found = SensorCounts(sensor, reach=16, codes=codes).log_density(light, table)
        >>> round(float(found.sum() / density[2]))
        100
    """

    sensor: Sensor | str
    reach: int = eqx.field(static=True)
    codes: Any = eqx.field(default=None, kw_only=True)
    totals: Any = eqx.field(default=None, kw_only=True)
    least_squares = False
    surrogate = None

    def __check_init__(self) -> None:
        if not isinstance(self.sensor, str):
            _check_counts(self.sensor, self.reach)
        if self.codes is not None and is_concrete(self.codes):
            _check_codes(np.asarray(plain_numbers("SensorCounts: codes", self.codes)))

    def check_data(self, data: Numbers) -> None:
        """Raise InputError if the data are neither codes nor counts of codes."""
        known = np.asarray(data)
        if self.codes is None:
            _check_whole("the data", known)
            return
        listed, counted = (np.atleast_1d(x).shape[-1] for x in (self.codes, known))
        if listed != counted:
            raise InputError(
                f"SensorCounts: each table has {listed} codes and {counted} counts; give the code "
                "of each count."
            )
        wrong = known[np.isfinite(known) & ((known < 0) | (known != np.round(known)))]
        if wrong.size:
            raise InputError(
                "SensorCounts: a table holds numbers of codes, whole and at least 0, and one is "
                f"{wrong[0]:g}; give counts, not shares, and mark a missing count by NaN."
            )

    def for_data(self, data: Numbers) -> "SensorCounts":
        """Return a copy whose `totals`, which `draw` needs, are the total counts of the tables in
        `data`. If the data are not tables, or `totals` are given, return the likelihood itself."""
        if self.codes is None or self.totals is not None:
            return self
        return replace(self, totals=jnp.sum(jnp.asarray(data), axis=-1, keepdims=True))

    def log_density(self, prediction: Array, data: Array) -> Array:
        """Return ln P of each code. For a table, return each count times ln P of its code. The
        multinomial coefficient is omitted, because it does not depend on parameters.

        Args:
            prediction: (..., bands) light, as in `mean_photoelectrons`; for tables (..., codes).
            data: (..., bands) DN, whole numbers; for tables (..., codes).

        Returns:
            (..., bands), or (..., codes).
        """
        _check_counts(_record(self.sensor), self.reach)
        if self.codes is None:
            return self._log_chances(prediction, data)
        return jnp.where(data > 0, data * self._log_shares(prediction), 0)

    def residuals(self, prediction: Array, data: Array, chance: Numbers) -> Numbers:
        """Return randomised quantile residuals: the normal deviate of a random point (`chance`) in
        each code's interval of cumulative probability. They are computed from the logarithm of the
        smaller tail, so that they are finite for any code. For a table, return such deviates of
        each count, which is binomial given the counts of smaller codes."""
        data, prediction = jnp.asarray(data), jnp.asarray(prediction)
        if self.codes is not None:
            return _binomial_deviates(self._log_shares(prediction), data, chance)
        share = self.log_density(prediction, data)
        read, mean, counts, log_count = self._count_tables(prediction, data)
        low, high = self._ends(read, data, counts)
        code, dark, bright = self._nearest_count(read, data), *_log_tails(counts, mean)
        dark = jnp.where(counts[..., 0] <= code, dark, -jnp.inf)
        bright = jnp.where(counts[..., -1] >= code, bright, -jnp.inf)
        below = jnp.logaddexp(logsumexp(log_count + log_ndtr(low), axis=-1), dark)
        above = jnp.logaddexp(logsumexp(log_count + log_ndtr(-high), axis=-1), bright)
        below = jnp.where(self._is_black(data), -jnp.inf, below)
        above = jnp.where(self._is_white(data), -jnp.inf, above)
        chance = jnp.asarray(chance, share.dtype)
        lower = jnp.logaddexp(below, share + jnp.log(chance))
        upper = jnp.logaddexp(above, share + jnp.log(1 - chance))
        deviate = ndtri_exp(jnp.minimum(lower, upper))
        return jnp.where(lower < upper, deviate, -deviate)

    def draw(self, key: Array, prediction: Array) -> Array:
        """Simulate codes or tables. Raises InputError for tables without `totals`."""
        if self.codes is not None:
            if self.totals is None:
                raise InputError(
                    "SensorCounts: a table needs `totals`, its number of counts, for draws; give "
                    "it, such as totals=tables.sum(axis=-1, keepdims=True)."
                )
            shares = jnp.exp(self._log_shares(prediction))
            totals = jnp.broadcast_to(self.totals, (*shares.shape[:-1], 1))[..., 0]
            return jax.random.multinomial(key, totals.astype(shares.dtype), shares)
        counted, read = jax.random.split(key)
        mean = self._electrons(prediction)
        electrons = count(counted, mean, PoissonShotNoise())
        how = self._read(mean)
        noise = how.noise * jax.random.normal(read, mean.shape, mean.dtype)
        codes = jnp.round(how.gain * (self._signal(electrons) + noise) + how.offset)
        return jnp.clip(codes, *self._range())

    def _log_chances(self, prediction: Array, data: Array) -> Array:
        read, mean, counts, log_count = self._count_tables(prediction, data)
        low, high = self._ends(read, data, counts)
        masses = logsumexp(log_count + _log_interval(low, high), axis=-1)
        if _record(self.sensor).bits is None:
            return masses
        dark, bright = _log_tails(counts, mean)
        black, white = self._ends_beyond(read, data, counts)
        beyond = jnp.where(black, dark, jnp.where(white, bright, -jnp.inf))
        some = beyond > -jnp.inf
        return jnp.where(some, jnp.logaddexp(masses, jnp.where(some, beyond, 0)), masses)

    def _log_shares(self, prediction: Array) -> Array:
        """Return ln of the share that each code has in its table."""
        prediction = jnp.asarray(prediction)
        codes = jnp.broadcast_to(jnp.asarray(self.codes, prediction.dtype), prediction.shape)
        chances = self._log_chances(prediction, codes)
        return chances - logsumexp(chances, axis=-1, keepdims=True)

    def _electrons(self, prediction: Array) -> Array:
        light = _light("SensorCounts", prediction)
        read = ("gain", "offset", "nonlinearity", "taps")
        return expected_signal(_drop_fields(_record(self.sensor), *read), light)

    def _read(self, mean: Array) -> _Reading:
        sensor, shape, dtype = _record(self.sensor), mean.shape, mean.dtype
        zero, one = jnp.zeros_like(mean), jnp.ones_like(mean)
        plain = _drop_fields(sensor, "offset", *(() if sensor.taps is None else ("taps.offset",)))
        gain = amplified(plain, one)
        noise = jnp.sqrt(read_out_variance(sensor, dtype=dtype, shape=shape))
        return _Reading(gain, amplified(sensor, zero), jnp.broadcast_to(noise, shape))

    def _signal(self, electrons: Array) -> Array:
        curve = _record(self.sensor).nonlinearity
        return electrons if curve is None else signal_of_charge(curve, electrons)

    def _range(self) -> tuple[float, float | Array]:
        """Return the smallest and the largest code, DN; infinite without an ADC."""
        bits = _record(self.sensor).bits
        return (-np.inf, np.inf) if bits is None else (0.0, largest_number(bits))

    def _is_black(self, data: Array) -> Array:
        return data <= self._range()[0]

    def _is_white(self, data: Array) -> Array:
        return data >= self._range()[1]

    def _count_tables(self, prediction: Array, data: Array) -> tuple[_Reading, Array, Array, Array]:
        """Return the read-out of pixels, the mean electrons (...), the electron counts (..., n) to
        sum over for each code, and ln of their probabilities."""
        mean = self._electrons(prediction)
        read = self._read(mean)
        centre = self._likeliest(*jax.lax.stop_gradient((read, mean, data)))
        about = jnp.arange(-self.reach, self.reach + 1.0, dtype=mean.dtype)
        counts = centre[..., None] + about.reshape(*[1] * centre.ndim, -1)
        return read, mean, counts, log_poisson(counts, jnp.maximum(mean, 1e-30)[..., None])

    def _nearest_count(self, read: _Reading, data: Array) -> Array:
        """Return the electron count whose signal is nearest to a code."""
        signal = (data - read.offset) / read.gain
        curve = _record(self.sensor).nonlinearity
        return jnp.round(signal if curve is None else charge_of_signal(curve, signal))

    def _likeliest(self, read: _Reading, mean: Array, data: Array) -> Array:
        """Return the electron count n that contributes most to the probability of each code. There
        the derivative of

            n ln(mu) - ln(n!) - (s(n) - s_c)^2 / (2 sigma^2)

        with respect to n changes sign, with s_c the signal of the code. For the smallest code, the
        result is at least the count nearest to the code, and for the largest code at most that
        count. The terms on either side decrease at least as fast as the distribution of read noise.
        """
        code, variance = self._nearest_count(read, data), jnp.square(read.noise)
        log_mean = jnp.log(jnp.maximum(mean, 1e-30))
        curve = _record(self.sensor).nonlinearity

        def pull(middle: Array) -> Array:
            if curve is None:
                return code - middle
            signal, slope = jax.jvp(self._signal, (middle,), (jnp.ones_like(middle),))
            return slope * (self._signal(code) - signal)

        def halve(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = ends
            middle = (low + high) / 2
            rises = log_mean - jnp.log(middle + 0.5) + pull(middle) / variance > 0
            return jnp.where(rises, middle, low), jnp.where(rises, high, middle)

        ends = jnp.zeros_like(code + mean), jnp.maximum(jnp.maximum(code, mean), 1.0)
        low, high = fori_loop(0, _HALVINGS, halve, ends)
        peak = jnp.round((low + high) / 2)
        peak = jnp.where(self._is_black(data), jnp.maximum(peak, code), peak)
        return jnp.maximum(jnp.where(self._is_white(data), jnp.minimum(peak, code), peak), 0)

    def _ends_beyond(self, read: _Reading, data: Array, counts: Array) -> tuple[Array, Array]:
        """Return two masks: whether all counts below the summed range give the smallest code, and
        whether all above it give the largest."""
        code = self._nearest_count(*jax.lax.stop_gradient((read, data)))
        fewest, most = counts[..., 0], counts[..., -1]
        return self._is_black(data) & (fewest <= code), self._is_white(data) & (most >= code)

    def _ends(self, read: _Reading, data: Array, counts: Array) -> tuple[Array, Array]:
        """Return the ends of each code's rounding interval, in standard deviations from the
        noiseless signal."""
        gain, offset, rms = (part[..., None] for part in read)
        noise = gain * rms
        centre = data[..., None] - offset - gain * self._signal(counts)
        low = jnp.where(self._is_black(data)[..., None], -OPEN_END, (centre - ROUNDING) / noise)
        high = jnp.where(self._is_white(data)[..., None], OPEN_END, (centre + ROUNDING) / noise)
        return low, high


def _binomial_deviates(log_shares: Array, counts: Array, chance: Numbers) -> Numbers:
    """Return normal deviates of the counts in a table. Given the counts of all smaller codes, a
    count is binomial, so the deviates are independent under the model."""
    xp, special = numerics(log_shares, counts, chance)
    shares, counts = xp.exp(xp.asarray(log_shares)), xp.asarray(counts)

    def tail_sum(x: Numbers) -> Numbers:
        return xp.flip(xp.cumsum(xp.flip(x, -1), -1), -1)

    left, tiny = tail_sum(counts), xp.finfo(shares.dtype).tiny
    p = xp.clip(shares / xp.maximum(tail_sum(shares), tiny), 0, 1)
    some, not_all = counts > 0, counts < left
    others = left - counts
    fewer = special.betainc(others + 1, xp.where(some, counts, 1.0), 1 - p)
    more = special.betainc(counts + 1, xp.where(not_all, others, 1.0), p)
    below, above = xp.where(some, fewer, 0.0), xp.where(not_all, more, 0.0)
    ways = special.gammaln(left + 1) - special.gammaln(counts + 1) - special.gammaln(others + 1)
    mass = xp.exp(ways + special.xlogy(counts, p) + special.xlog1py(others, -p))
    lower, upper = below + chance * mass, above + (1 - chance) * mass
    deviate = special.ndtri(xp.clip(xp.minimum(lower, upper), tiny, 0.5))
    return xp.where(lower < upper, deviate, -deviate)


def _log_tails(counts: Array, mean: Array) -> tuple[Array, Array]:
    """Return ln of the probabilities of electrons below, and above, the summed counts."""
    mean = jnp.maximum(mean, 1e-30)
    fewer, _ = log_poisson_tails(jnp.maximum(counts[..., 0], 1), mean)
    _, more = log_poisson_tails(counts[..., -1] + 1, mean)
    return jnp.where(counts[..., 0] > 0, fewer, -jnp.inf), more


def _light(likelihood: str, prediction: Array) -> Array:
    """Return the prediction as an array, or refuse known values that are no light."""
    if is_concrete(prediction):
        wrong = np.asarray(prediction)
        wrong = wrong[~((wrong >= 0) & (wrong < np.inf))]
        if wrong.size:
            raise InputError(
                f"{likelihood}: the prediction is light, finite and at least 0, and reaches "
                f"{wrong.flat[0]:g} at the values tried; bound the parameters so that it cannot."
            )
    return jnp.asarray(prediction)


def _check_whole(what: str, known: np.ndarray) -> None:
    wrong = known[np.isfinite(known) & (known != np.round(known))]
    if wrong.size:
        raise InputError(
            f"SensorCounts: {what} are codes, whole numbers, and hold {wrong.flat[0]:g}; use "
            "SensorNoise for means of frames or corrected data."
        )


def _check_codes(codes: np.ndarray) -> None:
    """Raise InputError if the codes of a table are not whole and finite, or if one occurs twice."""
    _check_whole("codes", codes)
    ordered = np.sort(np.atleast_1d(codes), axis=-1)
    twice = ordered[..., 1:][ordered[..., 1:] == ordered[..., :-1]]
    if twice.size or not np.isfinite(codes).all():
        what = f"hold {twice[0]:g} twice" if twice.size else "hold one that is not finite"
        raise InputError(
            f"SensorCounts: codes {what}; give each code of a table once, with all its counts."
        )


def _check_counts(sensor: Sensor, reach: int) -> None:
    """Raise InputError for a sensor without shot noise, read noise or gain, for one whose pixels
    share charge, and for a `reach` that is too small."""
    for name in ("shot_noise", "read_noise", "gain"):
        if getattr(sensor, name) is None:
            raise InputError(f"SensorCounts needs a sensor with {name}: or use SensorNoise.")
    for name in _NEIGHBOUR_EFFECTS:
        if getattr(sensor, name) is not None:
            raise InputError(
                f"SensorCounts: Sensor.{name} changes counted electrons, which are then no longer "
                "independent Poisson counts of each pixel; leave it out, or use SensorNoise."
            )
    if not is_concrete(sensor):
        return
    with jax.ensure_compile_time_eval():  # the sensor's numbers are known, inside `jit` too
        gain = jnp.asarray(sensor.gain)
        noise = np.sqrt(np.asarray(read_out_variance(sensor, dtype=gain.dtype)))
        taps = sensor.taps
        if taps is not None and taps.read_noise is not None:
            noise = noise * max(float(np.max(taps.read_noise)), 1.0)
        if taps is not None and taps.gain is not None:
            gain = gain * float(np.min(taps.gain))
        noise = noise / _least_slope(sensor)
    needed = np.max(8 * noise + ROUNDING / np.asarray(gain))
    if reach < needed:
        raise InputError(
            f"SensorCounts: reach = {reach} electrons cuts off probability: at least "
            f"{int(np.ceil(needed))} are needed for this read noise and gain."
        )


def _least_slope(sensor: Sensor) -> float:
    """Return the smallest slope from charge to signal within the converter's range."""
    curve, bits = sensor.nonlinearity, sensor.bits
    if curve is None or bits is None:
        return 1.0
    top = charge_of_signal(curve, largest_number(bits) / jnp.asarray(sensor.gain))
    charge = jnp.linspace(jnp.zeros_like(top), top, 65)
    slopes = jax.jvp(lambda x: signal_of_charge(curve, x), (charge,), (jnp.ones_like(charge),))[1]
    return float(jnp.min(slopes))


def _drop_fields(sensor: Sensor, *fields: str) -> Sensor:
    """Return the sensor with some of its fields set to None."""
    parts = attrgetter(*fields)
    none = None if len(fields) == 1 else (None,) * len(fields)
    return eqx.tree_at(parts, sensor, none, is_leaf=lambda part: part is None)


def _record(sensor: Sensor | str) -> Sensor:
    """Narrow the type to a sensor, because a problem has already replaced a path by the record."""
    return cast(Sensor, sensor)


def _log_interval(low: Float[Array, "..."], high: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return ln(Phi(high) - Phi(low)), computed without cancellation in either tail."""
    above = low > 0
    low, high = jnp.where(above, -high, low), jnp.where(above, -low, high)
    return log_ndtr(high) + log1mexp(log_ndtr(low) - log_ndtr(high))
