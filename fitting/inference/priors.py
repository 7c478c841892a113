"""Prior densities for one number, in the number's own unit.

A prior is a record of plain numbers with two functions: `log_density(x)`, normalised over all x,
and `quantile(p)`, its inverse distribution function in NumPy. Searches start at quantiles. A record
of your own with the same two functions works as well.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Float
from scipy.special import gammaincinv, ndtri

from jaxvision.errors import InputError

Probabilities = Float[np.ndarray, "..."]
HALF_LOG_2PI = math.log(2 * math.pi) / 2


@runtime_checkable
class Prior(Protocol):
    """A density of one number. Any record with these two functions is a prior."""

    def log_density(self, x: Array) -> Array:
        """Return ln p(x), (...), for x (...) in the unit of the number."""
        ...

    def quantile(self, p: np.ndarray) -> np.ndarray:
        """Return the x (...) with cumulative probabilities p (...)."""
        ...


def _check(what: str, **positive: float) -> None:
    for name, value in positive.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{what}: {name} must be positive and finite, got {value}.")


@dataclass(frozen=True)
class Normal:
    """A normal density: exp(-((x - mean) / sd)^2 / 2) / (sqrt(2 pi) sd).

    Attributes:
        mean: in the unit of the parameter.
        sd: standard deviation, in the same unit.

    Example:
        >>> from fitting import Normal
        >>> round(float(Normal(mean=2.0, sd=0.5).log_density(jnp.array(2.0))), 4)
        -0.2258
    """

    mean: float
    sd: float

    def __post_init__(self) -> None:
        _check("Normal", sd=self.sd)

    def log_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return ln p(x)."""
        return -(((x - self.mean) / self.sd) ** 2) / 2 - HALF_LOG_2PI - math.log(self.sd)

    def quantile(self, p: Probabilities) -> Probabilities:
        """Return the x with cumulative probability p."""
        return self.mean + self.sd * ndtri(p)


@dataclass(frozen=True)
class LogNormal:
    """A log-normal density for x > 0: ln x is normal with mean ln median and standard deviation
    log_sd.

    Attributes:
        median: in the unit of the parameter, positive.
        log_sd: standard deviation of ln x; 0.1 is about 10 %.

    Example:
        >>> from fitting import LogNormal
        >>> gain = LogNormal(median=2.0, log_sd=0.1)
        >>> [round(float(gain.quantile(p)), 3) for p in (0.5, 0.975)]  # 2 and 2 exp(0.196)
        [2.0, 2.433]
    """

    median: float
    log_sd: float

    def __post_init__(self) -> None:
        _check("LogNormal", median=self.median, log_sd=self.log_sd)

    def log_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return ln p(x), -inf for x <= 0."""
        log_x = jnp.log(jnp.where(x > 0, x, 1))
        z = (log_x - math.log(self.median)) / self.log_sd
        inside = -(z**2) / 2 - log_x - HALF_LOG_2PI - math.log(self.log_sd)
        return jnp.where(x > 0, inside, -jnp.inf)

    def quantile(self, p: Probabilities) -> Probabilities:
        """Return the x with cumulative probability p."""
        return self.median * np.exp(self.log_sd * ndtri(p))


@dataclass(frozen=True)
class Uniform:
    """A constant density between two ends.

    The ends act as bounds of the parameter.

    Attributes:
        lower: lower end, in the unit of the parameter.
        upper: upper end.

    Example:
        >>> from fitting import Uniform
        >>> round(float(Uniform(1.0, 3.0).log_density(jnp.array(2.0))), 4)  # ln(1 / 2)
        -0.6931
    """

    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not (np.isfinite([self.lower, self.upper]).all() and self.lower < self.upper):
            raise InputError(
                f"Uniform: needs two finite ends in ascending order, got {self.lower} "
                f"and {self.upper}."
            )

    def log_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return ln p(x), -inf outside the ends."""
        inside = (x >= self.lower) & (x <= self.upper)
        return jnp.where(inside, -math.log(self.upper - self.lower), -jnp.inf)

    def quantile(self, p: Probabilities) -> Probabilities:
        """Return the x with cumulative probability p."""
        return self.lower + (self.upper - self.lower) * p


@dataclass(frozen=True)
class HalfNormal:
    """The positive half of a normal density about 0, for scales that may vanish.

    The parameter is bounded below by 0.

    Attributes:
        sd: of the Normal before folding, in the unit of the parameter.

    Example:
        >>> from fitting import HalfNormal
        >>> round(float(HalfNormal(sd=1.0).log_density(jnp.array(0.0))), 4)  # ln(2 / sqrt(2 pi))
        -0.2258
    """

    sd: float

    def __post_init__(self) -> None:
        _check("HalfNormal", sd=self.sd)

    def log_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return ln p(x), -inf for x < 0."""
        inside = math.log(2) - ((x / self.sd) ** 2) / 2 - HALF_LOG_2PI - math.log(self.sd)
        return jnp.where(x >= 0, inside, -jnp.inf)

    def quantile(self, p: Probabilities) -> Probabilities:
        """Return the x with cumulative probability p."""
        return self.sd * ndtri((1 + p) / 2)


@dataclass(frozen=True)
class Gamma:
    """A gamma density for x > 0: x^(shape - 1) exp(-x / scale), normalised.

    The parameter is bounded below by 0. Its mean is shape * scale.

    Attributes:
        shape: no unit, positive.
        scale: in the unit of the parameter, positive.

    Example:
        >>> from fitting import Gamma
        >>> prior = Gamma(shape=1.0, scale=2.0)
        >>> round(float(prior.log_density(jnp.array(2.0))), 4)  # ln(exp(-1) / 2)
        -1.6931
    """

    shape: float
    scale: float

    def __post_init__(self) -> None:
        _check("Gamma", shape=self.shape, scale=self.scale)

    def log_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return ln p(x), -inf for x <= 0."""
        log_z = jnp.log(jnp.where(x > 0, x / self.scale, 1))
        norm = gammaln(jnp.asarray(self.shape, x.dtype)) + math.log(self.scale)
        inside = (self.shape - 1) * log_z - x / self.scale - norm
        return jnp.where(x > 0, inside, -jnp.inf)

    def quantile(self, p: Probabilities) -> Probabilities:
        """Return the x with cumulative probability p."""
        return self.scale * gammaincinv(self.shape, p)


def support(prior: Prior) -> tuple[float, float]:
    """Return the lower and upper end of a prior's support, in the unit of the number."""
    lower, upper = (float(prior.quantile(np.array(p))) for p in (0.0, 1.0))
    return lower, upper
