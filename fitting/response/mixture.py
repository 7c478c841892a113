"""A parameter that is Gaussian given the size tau of a shared error, marginalised over tau on a
grid."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from ..inference.estimates import QUANTILES, Estimate, quantile_estimate
from ..inference.parameters import Parameter

REACH, HALVINGS = 40.0, 50  # standard deviations in which a quantile is sought, by bisection


@dataclass(frozen=True)
class Mixture:
    """The posterior of the parameter and of tau.

    Attributes:
        log_tau: (grid,) ln tau, evenly spaced.
        weights: (grid,) of each tau; their sum is 1.
        mean: (grid,) of the quantity, given tau.
        variance: (grid,) of the quantity, given tau.
    """

    log_tau: Float[np.ndarray, " grid"]
    weights: Float[np.ndarray, " grid"]
    mean: Float[np.ndarray, " grid"]
    variance: Float[np.ndarray, " grid"]

    def of_mean(self, what: Parameter, group: str) -> Estimate:
        """The estimate of the parameter, with the quantiles of the mixture."""
        centre = float(self.weights @ self.mean)
        spread = float(np.sqrt(self.weights @ (self.variance + (self.mean - centre) ** 2)))
        low, high = (centre + side * spread * np.full(len(QUANTILES), REACH) for side in (-1, 1))
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            chances = ndtr((middle[:, None] - self.mean) / np.sqrt(self.variance))
            below = chances @ self.weights < QUANTILES
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        ends = (low + high) / 2
        return quantile_estimate(what, centre, spread, ends, method="marginal", group=group)

    def of_tau(self, what: Parameter, group: str, *, stated: float = 0.0) -> Estimate:
        """The estimate of tau, with its median as the value."""
        tau = np.hypot(np.exp(self.log_tau), stated)
        ends = np.interp(QUANTILES, np.cumsum(self.weights), tau)
        spread = float(np.sqrt(self.weights @ (tau - self.weights @ tau) ** 2))
        return quantile_estimate(what, ends[2], spread, ends, method="marginal", group=group)

    def draws(self, count: int, seed: int) -> Float[np.ndarray, "count 2"]:
        """Draws of the parameter and tau: tau by its weights, uniform between the grid's points,
        then the parameter given tau."""
        rng = np.random.default_rng(seed)
        which = rng.choice(len(self.log_tau), size=count, p=self.weights)
        step = (self.log_tau[1] - self.log_tau[0]) * rng.uniform(-0.5, 0.5, count)
        deviation = np.sqrt(self.variance[which]) * rng.standard_normal(count)
        return np.stack([self.mean[which] + deviation, np.exp(self.log_tau[which] + step)], axis=1)
