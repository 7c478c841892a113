"""Likelihoods: the distribution of the data about a prediction.

A likelihood is a record with

    log_density(prediction, data)       ln p of every datum, (data)
    residuals(prediction, data, chance) standard normal for every datum if the model holds, (data)
    draw(key, prediction)               simulated data, (data)

`least_squares` says whether ln p is -residual^2 / 2 plus constants, so that a fit may use the
Levenberg-Marquardt method. `surrogate` is None, except for a likelihood that is hard to optimise:
there it is a least-squares likelihood with a similar best fit. A record of your own with these
parts works as well. It may also have `check_data(data)`, which refuses invalid data, and
`for_data(data)`, which returns the likelihood adapted to the data. A field that is a string names a
parameter or a path into a record, and is replaced by its value.

Residuals are quantile residuals (Dunn & Smyth, J. Comput. Graph. Stat. 5, 1996): the standard
normal quantile of the cumulative probability of a datum. A clipped datum or a count corresponds to
an interval of cumulative probability. `chance`, uniform on 0 .. 1, selects a point in this
interval.
"""

from collections.abc import Callable
from operator import attrgetter
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float

from jaxvision.errors import InputError

from .given import (
    end_or_name,
    is_concrete,
    number_or_name,
    require_ascending,
    require_positive,
    whole_labels,
)
from .priors import HALF_LOG_2PI
from .tails import log_ndtr, log_student, ndtri_exp, student_log_density

Numbers = Float[Array, "..."] | Float[np.ndarray, "..."]
Scale = Any  # a number, an array, or the name of a parameter whose value takes its place


@runtime_checkable
class Likelihood(Protocol):
    """The distribution of data about a prediction, an array or a record of the likelihood's own."""

    @property
    def least_squares(self) -> bool: ...
    @property
    def surrogate(self) -> "Likelihood | None": ...
    def log_density(self, prediction: Any, data: Array) -> Array: ...
    def residuals(self, prediction: Any, data: Array, chance: Numbers) -> Numbers: ...
    def draw(self, key: Array, prediction: Any) -> Array: ...


def numerics(*known: Any) -> tuple[Any, Any]:
    """Return NumPy and SciPy, which compile nothing, or JAX for traced values."""
    return (np, scipy.special) if is_concrete(known) else (jnp, jax.scipy.special)


class Gaussian(eqx.Module):
    """Gaussian noise: data = prediction + sd * Normal(0, 1).

    Do not use the square root of each datum as the standard deviation of counts: low data would get
    too much weight, and the fit would be too low. For counts use `SensorCounts`.

    Attributes:
        sd: standard deviation in the unit of the data: a number, an array of the data's shape, or
            the name of a parameter.

    Example:
        >>> from fitting import Gaussian
        >>> round(float(Gaussian(sd=0.5).log_density(jnp.array(1.0), jnp.array(1.5))), 4)
        -0.7258
    """

    sd: Scale = eqx.field(converter=number_or_name("Gaussian: sd"))
    surrogate = None  # not needed: the log density is as curved far from the best fit as near it

    def __check_init__(self) -> None:
        require_positive("Gaussian: sd", self.sd)

    @property
    def least_squares(self) -> bool:
        """Return whether the standard deviation is known, so that the log density is a sum of
        squares.
        """
        return not isinstance(self.sd, str)

    def log_density(self, prediction: Array, data: Array) -> Array:
        """Return -((data - prediction) / sd)^2 / 2 - ln(sqrt(2 pi) sd) for each datum."""
        z = (data - prediction) / self.sd
        return -(z**2) / 2 - jnp.log(self.sd) - HALF_LOG_2PI

    def residuals(self, prediction: Numbers, data: Numbers, chance: Numbers) -> Numbers:
        """Return (data - prediction) / sd for each datum."""
        del chance
        xp, _ = numerics(prediction, data, self)
        return (xp.asarray(data) - xp.asarray(prediction)) / xp.asarray(self.sd)

    def draw(self, key: Array, prediction: Array) -> Array:
        """Return simulated data."""
        noise = jax.random.normal(key, prediction.shape, prediction.dtype)
        return prediction + self.sd * noise


class StudentT(eqx.Module):
    """Noise with heavy tails, so that outliers have little weight: data = prediction + scale * t,
    with t from Student's t distribution.

    Far from the best fit all data are outliers, and the gradient nearly vanishes. The search
    therefore begins with least squares, unless the scale is fitted. A fitted scale grows until the
    data have weight again.

    Attributes:
        scale: scale in the unit of the data: a number, an array of the data's shape, or the name of
            a parameter. The standard deviation is sqrt(dof / (dof - 2)) times the scale.
        dof: degrees of freedom: 1 has the heaviest tails, 4 is common, 30 is nearly Gaussian. For
            clipped data it must be a number.
        low: lower end: data at or below it are clipped, as in `Censored`; None for no lower end.
        high: upper end: data at or above it are clipped; None for no upper end.

    Source:
        Lange, Little & Taylor, J. Am. Stat. Assoc. 84, 1989; with ends Arellano-Valle, Castro,
        Gonzalez-Farias & Munoz-Gajardo, Stat. Methods Appl. 21, 2012.

    Example:
        >>> from fitting import StudentT
        >>> cauchy = StudentT(scale=1.0, dof=1.0)
        >>> round(float(cauchy.log_density(jnp.array(0.0), jnp.array(0.0))), 4)  # ln(1 / pi)
        -1.1447
    """

    scale: Scale = eqx.field(converter=number_or_name("StudentT: scale"))
    dof: Scale = eqx.field(converter=number_or_name("StudentT: dof"), default=4.0)
    low: Scale = eqx.field(converter=end_or_name("StudentT: low"), default=None)
    high: Scale = eqx.field(converter=end_or_name("StudentT: high"), default=None)
    least_squares = False

    def __check_init__(self) -> None:
        require_positive("StudentT: scale", self.scale)
        require_positive("StudentT: dof", self.dof)
        require_ascending("StudentT", self.low, self.high)
        if isinstance(self.dof, str) and self._ends:
            raise InputError(
                f"StudentT: dof must be a number where data have ends, got the name {self.dof!r}."
            )

    @property
    def _ends(self) -> bool:
        return self.low is not None or self.high is not None

    @property
    def surrogate(self) -> "Gaussian | Censored | None":
        """Return the Gaussian likelihood with the same scale and ends, if the scale is known."""
        if isinstance(self.scale, str):
            return None
        return Censored(self.scale, self.low, self.high) if self._ends else Gaussian(self.scale)

    def log_density(self, prediction: Array, data: Array) -> Array:
        """Return the normalised log density -(dof + 1) / 2 ln(1 + z^2 / dof) with z = (data -
        prediction) / scale. For a clipped datum, return ln of the probability beyond the end.
        """
        dof = jnp.asarray(self.dof)
        z = (data - prediction) / self.scale
        density = student_log_density(z, dof) - jnp.log(self.scale)
        if self.low is not None:
            below = log_student((self.low - prediction) / self.scale, dof)
            density = jnp.where(data <= self.low, below, density)
        if self.high is not None:
            above = log_student((prediction - self.high) / self.scale, dof)
            density = jnp.where(data >= self.high, above, density)
        return density

    def residuals(self, prediction: Numbers, data: Numbers, chance: Numbers) -> Numbers:
        """Return the standard normal quantiles of the data's cumulative probabilities under
        Student's t; for a clipped datum, of a random point beyond the end.
        """
        xp, special = numerics(prediction, data, self)
        data, prediction = xp.asarray(data), xp.asarray(prediction)
        dof, scale = xp.asarray(self.dof), xp.asarray(self.scale)

        def deviate(z: Numbers, chance: Numbers | float = 1.0) -> Numbers:
            """Return the normal quantile of `chance` times the probability below z. If this
            probability underflows, its logarithm is used.
            """
            half = special.betainc(dof / 2, 0.5, dof / (dof + z**2)) / 2  # F(-|z|)
            share = chance * xp.where(z > 0, 1 - half, half)
            rare = share <= xp.finfo(share.dtype).tiny
            plain = special.ndtri(xp.where(rare, 0.5, share))
            if xp is np and not np.any(rare):
                return plain
            log_share = log_student(jnp.asarray(z), jnp.asarray(dof)) + jnp.log(chance)
            return xp.where(rare, ndtri_exp(log_share), plain)

        z = (data - prediction) / scale
        found = xp.copysign(deviate(-abs(z)), z)
        if self.low is not None:
            end = deviate((xp.asarray(self.low) - prediction) / scale, chance)
            found = xp.where(data <= self.low, end, found)
        if self.high is not None:
            end = deviate((prediction - xp.asarray(self.high)) / scale, chance)
            found = xp.where(data >= self.high, -end, found)
        return found

    def draw(self, key: Array, prediction: Array) -> Array:
        """Return simulated data, clipped at the ends."""
        noise = jax.random.t(key, self.dof, prediction.shape, prediction.dtype)
        return jnp.clip(prediction + self.scale * noise, self.low, self.high)


_TAIL = -12.0  # deviations; beyond, float32 and then float64 lose the normal distribution's tail


class Censored(eqx.Module):
    """Gaussian noise on a signal that saturates: a datum at an end of the range states only that
    the signal is beyond that end.

    Attributes:
        sd: standard deviation of the signal, in the unit of the data: a number, an array of the
            data's shape, or the name of a parameter.
        low: lower end: data at or below it are clipped; None for no lower end.
        high: upper end: data at or above it are clipped; None for no upper end.

    Source:
        Tobin, Econometrica 26, 1958.

    Example:
        >>> from fitting import Censored
        >>> likelihood = Censored(sd=0.1, high=1.0)
        >>> round(float(likelihood.log_density(jnp.array(1.0), jnp.array(1.0))), 4)  # ln(1 / 2)
        -0.6931
    """

    sd: Scale = eqx.field(converter=number_or_name("Censored: sd"))
    low: Scale = eqx.field(converter=end_or_name("Censored: low"), default=None)
    high: Scale = eqx.field(converter=end_or_name("Censored: high"), default=None)
    least_squares = False
    surrogate = None  # not needed: the pull of a clipped datum grows with its distance

    def __check_init__(self) -> None:
        require_positive("Censored: sd", self.sd)
        require_ascending("Censored", self.low, self.high)

    def log_density(self, prediction: Array, data: Array) -> Array:
        """Return the Gaussian log density between the ends; for a clipped datum, ln of the
        probability beyond the end.
        """
        density = Gaussian(self.sd).log_density(prediction, data)
        if self.low is not None:
            below = log_ndtr((self.low - prediction) / self.sd)
            density = jnp.where(data <= self.low, below, density)
        if self.high is not None:
            above = log_ndtr((prediction - self.high) / self.sd)
            density = jnp.where(data >= self.high, above, density)
        return density

    def residuals(self, prediction: Numbers, data: Numbers, chance: Numbers) -> Numbers:
        """Return the residuals in standard deviations. The residual of a clipped datum is the
        residual of a random point beyond the end.
        """
        xp, _ = numerics(prediction, data, self)
        data, prediction, sd = (xp.asarray(part) for part in (data, prediction, self.sd))
        z = (data - prediction) / sd
        if self.low is not None:
            beyond = _deviate_below((xp.asarray(self.low) - prediction) / sd, chance)
            z = xp.where(data <= self.low, beyond, z)
        if self.high is not None:
            beyond = _deviate_below((prediction - xp.asarray(self.high)) / sd, chance)
            z = xp.where(data >= self.high, -beyond, z)
        return z

    def draw(self, key: Array, prediction: Array) -> Array:
        """Return simulated data, clipped at the ends."""
        return jnp.clip(Gaussian(self.sd).draw(key, prediction), self.low, self.high)


def _deviate_below(end: Numbers, chance: Numbers) -> Numbers:
    """Return the deviate below which lies the fraction `chance` of the probability below `end`."""
    xp, special = numerics(end, chance)
    far = end < _TAIL
    above = xp.where(far, -end, 2)
    square = above * above - 2 * xp.log(chance)
    beyond = xp.sqrt(square)
    for _ in range(2):  # the tail beyond z is exp(-z^2 / 2) / z (1 - 1 / z^2) times a constant
        ratio = beyond / above * (1 - above**-2.0) / (1 - beyond**-2.0)
        beyond = xp.sqrt(square - 2 * xp.log(ratio))
    return xp.where(far, -beyond, special.ndtri(chance * special.ndtr(end)))


class Clustered(eqx.Module):
    """A likelihood for groups of data that share an unknown error.

    The best fit is the same as with `likelihood` alone. The standard errors are widened for the
    correlation of the residuals within groups (a sandwich covariance, `clustering`). `draw` does
    not simulate the shared error, whose form is unknown.

    Attributes:
        likelihood: likelihood of each datum, without groups.
        labels: (data) whole numbers, the group of each datum (its image, say). Or several levels of
            groups by name, such as {"frame": ..., "row": ..., "column": ...}, crossed or nested.
            The first level always widens the intervals, however few groups it has. Another level
            does so only if its residuals show shared errors.

    Source:
        Liang & Zeger, Biometrika 73, 1986; several levels: Cameron, Gelbach & Miller, J. Bus. Econ.
        Stat. 29, 2011; few groups: Bell & McCaffrey, Survey Methodology 28, 2002.

    Example:
        The two equal data of an image count once: the standard error of the mean of 1, 2, 3, 6 is
        sqrt(14 / 3 / 4).

        >>> from fitting import Clustered, Gaussian, Parameter, Problem, fit
        >>> images = np.repeat(np.arange(4), 2)
        >>> mean = Problem(
        ...     {"mean": Parameter(start=1.0)},
        ...     predict=lambda mean: mean * jnp.ones(8),
        ...     likelihood=Clustered(Gaussian(sd=1.0), labels=images),
        ...     data=np.array([1.0, 2.0, 3.0, 6.0])[images],
        ... )
        >>> round(fit(mean).estimates[0].standard_error, 2)
        1.08
    """

    likelihood: Any
    labels: Any = eqx.field(converter=whole_labels, static=False)

    def __check_init__(self) -> None:
        if not isinstance(self.likelihood, Likelihood):
            raise InputError(
                f"Clustered: {self.likelihood!r} is no likelihood; give one, such as "
                "Gaussian(sd=...), then the labels."
            )

    def check_data(self, data: Numbers) -> None:
        """Refuse data that the inner likelihood refuses."""
        check_data(self.likelihood, data)

    def for_data(self, data: Numbers) -> "Clustered":
        """Return the same groups with the inner likelihood adapted to these data."""
        return eqx.tree_at(lambda own: own.likelihood, self, for_data(self.likelihood, data))

    @property
    def least_squares(self) -> bool:
        """Return whether the inner likelihood is a sum of squares."""
        return self.likelihood.least_squares

    @property
    def surrogate(self) -> Likelihood | None:
        """Return the `surrogate` of the inner likelihood."""
        return self.likelihood.surrogate

    def log_density(self, prediction: Array, data: Array) -> Array:
        """Return the log density of each datum, as if data were independent."""
        return self.likelihood.log_density(prediction, data)

    def residuals(self, prediction: Array, data: Array, chance: Numbers) -> Numbers:
        """Return the residual of each datum, as if data were independent."""
        return self.likelihood.residuals(prediction, data, chance)

    def draw(self, key: Array, prediction: Array) -> Array:
        """Return simulated data without the shared error."""
        return self.likelihood.draw(key, prediction)


def check_data(likelihood: Any, data: Numbers) -> None:
    """Refuse data (0 or NaN where missing) that are impossible under a likelihood."""
    if hasattr(likelihood, "check_data"):
        likelihood.check_data(data)


def for_data(likelihood: Any, data: Numbers) -> Any:
    """Return the likelihood with the number of draws set from the data, if they are counts."""
    return likelihood.for_data(data) if hasattr(likelihood, "for_data") else likelihood


def scale_noise(likelihood: Any, factor: Any) -> Any:
    """Return the likelihood with its noise multiplied by a factor; None for a likelihood without a
    field `sd` or `scale`, such as a sensor's, whose noise depends on the signal."""
    if isinstance(likelihood, Clustered):
        inside = scale_noise(likelihood.likelihood, factor)
        return None if inside is None else Clustered(inside, likelihood.labels)
    for name in ("sd", "scale"):
        if hasattr(likelihood, name):
            return eqx.tree_at(attrgetter(name), likelihood, factor * getattr(likelihood, name))
    return None


def named_width(likelihood: Any) -> str | None:
    """Return the name of the parameter that is the width of the noise, or None."""
    if isinstance(likelihood, Clustered):
        return named_width(likelihood.likelihood)
    width = getattr(likelihood, "sd", getattr(likelihood, "scale", None))
    return width if isinstance(width, str) else None


def substitute_values(likelihood: Any, value_of: Callable[[str], Any]) -> Any:
    """Return a likelihood with values in place of the names of parameters and records."""
    return jax.tree.map(lambda leaf: value_of(leaf) if isinstance(leaf, str) else leaf, likelihood)


def names_within(likelihood: Any) -> set[str]:
    """Return the names of parameters and records that a likelihood contains."""
    return {leaf for leaf in jax.tree.leaves(likelihood) if isinstance(leaf, str)}
