"""Likelihoods of a sensor: the prediction is light, the data are digital numbers.

`SensorNoise` takes mean and variance of a datum from the sensor's moments. `SensorCounts` computes
the probability of every code, for codes that are coarse relative to the noise, and for few
electrons. Both have the interface of `inference.likelihoods`. In place of a sensor they take its
path in the problem's records ("camera.sensor"), and its numbers can then be fitted, too
("camera.sensor.gain").
"""

from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float

from jaxvision import PoissonShotNoise, Sensor
from jaxvision.errors import InputError
from jaxvision.sensor import count, expected_signal, read_out_variance, signal_variance
from jaxvision.sensor.adc import largest_number
from jaxvision.sensor.moments import QUANTISATION_VARIANCE

from .inference.given import is_concrete
from .inference.likelihoods import Censored, Numbers
from .inference.tails import log1mexp, log_ndtr, ndtri_exp
from .poisson import log_poisson, log_poisson_tails

FAR = 1e9  # standard deviations, for an end without limit: more than any code lies from any other
ROUNDING = 0.5  # DN between a code and the ends of its interval


class SensorNoise(eqx.Module):
    """A datum is normal about the sensor's mean signal with the sensor's temporal variance.

    Codes at an end of the ADC's range are censored. Differences between pixels (fixed pattern) are
    no part of it, nor is a full well.

    Attributes:
        sensor: record, or the path of one among the problem's records.

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
        """Least squares by the variance at each datum, where the sensor is known."""
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
        """Normal deviates of the data."""
        return self._signal(prediction).residuals(self._mean(prediction), data, chance)

    def draw(self, key: Array, prediction: Array) -> Array:
        """Data as they might have been, rounded and clipped where there is an ADC."""
        sensor, prediction = _record(self.sensor), jnp.asarray(prediction)
        analogue = eqx.tree_at(lambda s: s.bits, sensor, None, is_leaf=lambda x: x is None)
        deviation = jnp.sqrt(signal_variance(analogue, prediction))  # rounding brings its own
        signal = Censored(deviation).draw(key, self._mean(prediction))
        bits = sensor.bits
        return signal if bits is None else jnp.clip(jnp.round(signal), 0, largest_number(bits))

    def noise_sources(self, prediction: Array) -> dict[str, Array]:
        """Variance of a datum by source.

        Args:
            prediction: (..., bands) light.

        Returns:
            (..., bands) DN^2 of the photons, and the dark current's electrons with them, of the
            read-out and of rounding.
        """
        sensor, prediction = _record(self.sensor), jnp.asarray(prediction)
        whole = signal_variance(sensor, prediction)
        gain = jnp.ones(()) if sensor.gain is None else sensor.gain
        read = jnp.broadcast_to(gain**2 * read_out_variance(sensor, dtype=whole.dtype), whole.shape)
        rounding = jnp.full_like(whole, 0 if sensor.bits is None else QUANTISATION_VARIANCE)
        return {"photons": whole - read - rounding, "read noise": read, "rounding": rounding}

    def _mean(self, prediction: Array) -> Array:
        """Signal before it is clipped, DN."""
        return expected_signal(_record(self.sensor), _light("SensorNoise", prediction))

    def _signal(self, prediction: Array) -> Censored:
        light = _light("SensorNoise", prediction)
        deviation = jnp.sqrt(signal_variance(_record(self.sensor), light))
        bits = _record(self.sensor).bits
        if bits is None:
            return Censored(deviation)
        return Censored(deviation, ROUNDING, largest_number(bits) - ROUNDING)


class _VarianceOfData(eqx.Module):
    """Least squares with the variance at the light that would give each datum, as far as the signal
    is proportional to light. A search from afar needs few steps: the variance at the prediction
    grows with it, and makes any bright prediction likely."""

    sensor: Sensor
    least_squares = True
    surrogate = None

    def residuals(self, prediction: Array, data: Array, chance: Numbers) -> Array:
        """Return (data - prediction) / sd. For clipped data it is the distance of the prediction
        from the end, if the prediction is inside."""
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


class SensorCounts(eqx.Module):
    """The probability of every code: electrons counted, read out with noise, rounded and clipped.

        P(c) = sum_n Poisson(n; mu) [Phi(z_n + 1 / (2 K sigma)) - Phi(z_n - 1 / (2 K sigma))],
        z_n  = (c - offset - K n) / (K sigma)

    Exact also below a read noise of half a DN, where the moments are not. The sensor needs shot
    noise, read noise and gain. Electrons within `reach` of those that contribute most are summed,
    which lie between the mean and the code: the cost grows with the read noise in electrons.

    Attributes:
        sensor: record, or the path of one among the problem's records.
        reach: electrons to either side that are summed: at least eight times the read noise in
            electrons, and half a DN.

    Example:
        The probabilities of all codes sum to 1.

        >>> import jaxvision as jv
        >>> from fitting import SensorCounts
        >>> noise = dict(shot_noise=jv.PoissonShotNoise(), read_noise=0.3)
        >>> counts = SensorCounts(jv.Sensor(**noise, gain=1.0, bits=4), reach=16)
        >>> density = jax.jit(lambda light: counts.log_density(light, jnp.arange(16.0)))
        >>> round(float(jnp.exp(density(jnp.full(16, 2.0))).sum()), 4)
        1.0
    """

    sensor: Sensor | str
    reach: int = eqx.field(static=True)
    least_squares = False
    surrogate = None

    def __check_init__(self) -> None:
        if not isinstance(self.sensor, str):
            _check_counts(self.sensor, self.reach)

    def check_data(self, data: Numbers) -> None:
        """Refuses data that are no codes."""
        known = np.asarray(data)
        wrong = known[np.isfinite(known) & (known != np.round(known))]
        if wrong.size:
            raise InputError(
                f"SensorCounts: the data are codes, whole numbers, and hold {wrong.flat[0]:g}; use "
                "SensorNoise for means of frames or corrected data."
            )

    def log_density(self, prediction: Array, data: Array) -> Array:
        """ln P of each code.

        Args:
            prediction: (..., bands) light, as in `mean_photoelectrons`.
            data: (..., bands) DN, whole numbers.

        Returns:
            (..., bands).
        """
        _check_counts(_record(self.sensor), self.reach)
        mean, counts, log_count = self._counted(prediction, data)
        low, high = self._ends(data, counts)
        masses = logsumexp(log_count + _log_interval(low, high), axis=-1)
        dark, bright = _beyond(counts, mean)
        black, white = self._ends_beyond(data, counts)
        beyond = jnp.where(black, dark, jnp.where(white, bright, -jnp.inf))
        some = beyond > -jnp.inf
        return jnp.where(some, jnp.logaddexp(masses, jnp.where(some, beyond, 0)), masses)

    def residuals(self, prediction: Array, data: Array, chance: Numbers) -> Numbers:
        """Normal deviates of a place, picked by chance, in each code's share of probability; from
        the logarithm of the smaller tail, so that they are finite however far a code lies."""
        data, prediction = jnp.asarray(data), jnp.asarray(prediction)
        share = self.log_density(prediction, data)
        mean, counts, log_count = self._counted(prediction, data)
        low, high = self._ends(data, counts)
        code, dark, bright = self._of_code(data), *_beyond(counts, mean)
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
        """Codes as they might have been."""
        counted, read = jax.random.split(key)
        mean = self._electrons(prediction)
        electrons = count(counted, mean, PoissonShotNoise())
        noise = self._read_noise() * jax.random.normal(read, mean.shape, mean.dtype)
        codes = jnp.round(self._gain() * (electrons + noise) + self._offset())
        return jnp.clip(codes, *self._range())

    def _gain(self) -> Array:
        return cast(Array, _record(self.sensor).gain)

    def _offset(self) -> Array:
        offset = _record(self.sensor).offset
        return jnp.zeros_like(self._gain()) if offset is None else offset

    def _electrons(self, prediction: Array) -> Array:
        light = _light("SensorCounts", prediction)
        return (expected_signal(_record(self.sensor), light) - self._offset()) / self._gain()

    def _read_noise(self) -> Array:
        return jnp.sqrt(read_out_variance(_record(self.sensor), dtype=self._gain().dtype))

    def _range(self) -> tuple[float, float | Array]:
        """The codes of black and white, DN; without an ADC there is no end."""
        bits = _record(self.sensor).bits
        return (-np.inf, np.inf) if bits is None else (0.0, largest_number(bits))

    def _is_black(self, data: Array) -> Array:
        return data <= self._range()[0]

    def _is_white(self, data: Array) -> Array:
        return data >= self._range()[1]

    def _counted(self, prediction: Array, data: Array) -> tuple[Array, Array, Array]:
        """Mean electrons (...), the counts about each code (..., n) and ln of their probability."""
        mean = self._electrons(prediction)
        centre = jax.lax.stop_gradient(self._likeliest(mean, data))
        about = jnp.arange(-self.reach, self.reach + 1.0, dtype=mean.dtype)
        counts = centre[..., None] + about.reshape(*[1] * centre.ndim, -1)
        return mean, counts, log_poisson(counts, jnp.maximum(mean, 1e-30)[..., None])

    def _of_code(self, data: Array) -> Array:
        return jnp.round((data - self._offset()) / self._gain())

    def _likeliest(self, mean: Array, data: Array) -> Array:
        """The count that contributes most to each code, where the slope of

            n ln(mu) - ln(n!) - (n - c)^2 / (2 sigma^2)

        in n changes its sign; for the code of black at least that code's own count, for white at
        most. Its neighbours fall off at least as fast as the read noise does.
        """
        code, variance = self._of_code(data), jnp.square(self._read_noise())
        log_mean = jnp.log(jnp.maximum(mean, 1e-30))

        def halved(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = ends
            middle = (low + high) / 2
            rises = log_mean - jnp.log(middle + 0.5) + (code - middle) / variance > 0
            return jnp.where(rises, middle, low), jnp.where(rises, high, middle)

        ends = jnp.zeros_like(code + mean), jnp.maximum(jnp.maximum(code, mean), 1.0)
        low, high = jax.lax.fori_loop(0, _HALVINGS, halved, ends)
        peak = jnp.round((low + high) / 2)
        peak = jnp.where(self._is_black(data), jnp.maximum(peak, code), peak)
        return jnp.maximum(jnp.where(self._is_white(data), jnp.minimum(peak, code), peak), 0)

    def _ends_beyond(self, data: Array, counts: Array) -> tuple[Array, Array]:
        """Whether all counts below those summed are black, and all above white."""
        code = self._of_code(data)
        fewest, most = counts[..., 0], counts[..., -1]
        return self._is_black(data) & (fewest <= code), self._is_white(data) & (most >= code)

    def _ends(self, data: Array, counts: Array) -> tuple[Array, Array]:
        """The ends of each code's interval in standard deviations from the noiseless signal."""
        noise = self._gain() * self._read_noise()
        centre = data[..., None] - self._offset() - self._gain() * counts
        low = jnp.where(self._is_black(data)[..., None], -FAR, (centre - ROUNDING) / noise)
        high = jnp.where(self._is_white(data)[..., None], FAR, (centre + ROUNDING) / noise)
        return low, high


def _beyond(counts: Array, mean: Array) -> tuple[Array, Array]:
    """ln of the probabilities of fewer and of more electrons than those (..., n) summed."""
    mean = jnp.maximum(mean, 1e-30)
    fewer, _ = log_poisson_tails(jnp.maximum(counts[..., 0], 1), mean)
    _, more = log_poisson_tails(counts[..., -1] + 1, mean)
    return jnp.where(counts[..., 0] > 0, fewer, -jnp.inf), more


def _light(likelihood: str, prediction: Array) -> Array:
    """The prediction, refused where it is known and cannot be light."""
    if is_concrete(prediction):
        wrong = np.asarray(prediction)
        wrong = wrong[~((wrong >= 0) & (wrong < np.inf))]
        if wrong.size:
            raise InputError(
                f"{likelihood}: the prediction is light, finite and at least 0, and reaches "
                f"{wrong.flat[0]:g} at the values tried; bound the parameters so that it cannot."
            )
    return jnp.asarray(prediction)


def _check_counts(sensor: Sensor, reach: int) -> None:
    """Refuses a sensor that does not count, and a sum that ends too near to each code."""
    for name in ("shot_noise", "read_noise", "gain"):
        if getattr(sensor, name) is None:
            raise InputError(f"SensorCounts needs a sensor with {name}: or use SensorNoise.")
    if not is_concrete(sensor):
        return
    with jax.ensure_compile_time_eval():  # the sensor's numbers are known, inside `jit` too
        gain = jnp.asarray(sensor.gain)
        noise = np.sqrt(np.asarray(read_out_variance(sensor, dtype=gain.dtype)))
    needed = np.max(8 * noise + ROUNDING / np.asarray(gain))
    if reach < needed:
        raise InputError(
            f"SensorCounts: reach = {reach} electrons cuts off probability: at least "
            f"{int(np.ceil(needed))} are needed for this read noise and gain."
        )


def _record(sensor: Sensor | str) -> Sensor:
    """The sensor: a problem has put the record in place of its path."""
    return cast(Sensor, sensor)


def _log_interval(low: Float[Array, "..."], high: Float[Array, "..."]) -> Float[Array, "..."]:
    """ln(Phi(high) - Phi(low)), from the tail in which the interval lies: no digit cancels."""
    above = low > 0
    low, high = jnp.where(above, -high, low), jnp.where(above, -low, high)
    return log_ndtr(high) + log1mexp(log_ndtr(low) - log_ndtr(high))
