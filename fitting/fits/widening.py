"""Widen intervals for a misfit of the model: either groups of data share errors, or the noise is
larger than stated.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.errors import InputError

from ..inference.clustering import Robustness, cluster_robust, gaussian_equivalent
from ..inference.likelihoods import Clustered, scale_noise
from ..inference.misfit import Misfit, judge, sums
from ..inference.on_host import to_host
from ..inference.problem import (
    Problem,
    Vector,
    likelihood_at,
    log_likelihood_terms,
    prediction,
    values_at,
)
from ..inference.search import Optimum
from ..inference.streams import Advance, chunks

SMALL = 1e-4  # step, as a share of the predictions' spread, for the slope of a residual
LEAST_WIDENING = 1.02  # factor on the errors from which it is said
LEAST = 0.01  # least spread of predictions, relative to their size or to the data's spread


@dataclass(frozen=True)
class Widening:
    """A covariance, and the reason why it is wider than that of the likelihood alone.

    Attributes:
        covariance: (P, P) covariance on the unconstrained scale.
        freedom: (P,) degrees of freedom of its variances; None where they are known.
        noise: equivalent factor on the width of the noise; 1 for no widening.
        words: the reason, in sentences.
        explained: whether the widening accounts for a misfit.
    """

    covariance: Float[np.ndarray, "parameters parameters"]
    freedom: Float[np.ndarray, " parameters"] | None = None
    noise: float = 1.0
    words: tuple[str, ...] = ()
    explained: bool = False

    @property
    def gaussian_covariance(self) -> Float[np.ndarray, "parameters parameters"]:
        """Return the covariance of the Gaussian whose 95 % intervals equal those of Student's t."""
        return (
            self.covariance
            if self.freedom is None
            else gaussian_equivalent(self.covariance, self.freedom)
        )


def widening(
    problem: Problem,
    optimum: Optimum,
    covariance: Float[np.ndarray, "parameters parameters"],
    residuals: Float[np.ndarray, "..."],
    checks: Misfit,
    *,
    inflate: bool,
    seed: int,
) -> Widening:
    """Return the covariance that includes the misfit of the model.

    Errors that groups of data share explain a misfit if the residuals agree with the stated noise
    after subtracting an offset and a gain error from each group. With `inflate` they explain it
    even if these remaining residuals are larger than the stated noise."""
    if isinstance(problem.likelihood, Clustered):
        labels = problem.likelihood.labels
        every = labels if isinstance(labels, dict) else {"": labels}
        every = {name: to_host(one) for name, one in every.items()}
        return _widen_by_groups(problem, optimum, every, residuals, inflate=inflate, seed=seed)
    if not inflate or checks.dof <= 0 or checks.chi_square <= max(checks.dof, 1):
        return Widening(covariance)
    factor = checks.chi_square / max(checks.dof, 1)
    prior = optimum.curvature - optimum.data_information
    words = []
    if factor > LEAST_WIDENING**2:
        words.append(
            f"Chi-square per degree of freedom is {factor:.4g}; the errors from the data are "
            f"multiplied by {np.sqrt(factor):.3g}, as if their noise were that much larger."
        )
    if scale_noise(problem.likelihood, 1.0) is None:
        words.append("Bands of new data use the stated noise.")
    widened = np.linalg.inv(optimum.data_information / factor + prior)
    return Widening(widened, None, float(np.sqrt(factor)), tuple(words), True)


def _widen_by_groups(
    problem: Problem,
    optimum: Optimum,
    every: dict[str, np.ndarray],
    residuals: np.ndarray,
    *,
    inflate: bool,
    seed: int,
) -> Widening:
    for one in every.values():
        if one.shape != residuals.shape:
            raise InputError(
                f"Clustered: labels of shape {one.shape} do not fit data of shape "
                f"{residuals.shape}."
            )
    levels = [np.unique(one.ravel(), return_inverse=True)[1] for one in every.values()]
    vector = jnp.asarray(optimum.vector, problem.data.dtype)
    scores = to_host(_scores(vector, problem), dtype=np.float64)
    prior = optimum.curvature - optimum.data_information
    slope, predicted = _slopes(problem, vector, seed)
    moved = to_host(_predictions(vector, problem), dtype=np.float64) * np.nan_to_num(slope.ravel())
    robust = cluster_robust(scores, optimum.curvature, *levels, slopes=moved, prior=prior)
    shared = robust.design_effect > 1
    sentences = [_widening_in_words(robust, optimum, levels[0].max() + 1)]
    if len(levels) > 1:
        sizes = zip(every, robust.effects, strict=True)
        effects = ", ".join(f"{name} {effect:.3g}" for name, effect in sizes)
        sentences.append(
            f"Design effects of the residuals by level: {effects} (independent data: 1)."
        )
    determined = float(np.trace(optimum.data_information @ robust.covariance))
    left, lost = residuals, min(determined, len(optimum.vector))
    for labels in levels:
        left = remove_shapes(left, labels, (slope, slope * predicted))
        lost += 2 * (labels.max() + 1)
    beyond = judge(left, lost)
    if shared:
        sentences.append("Bands of new data do not include the error that a group shares.")
        if beyond.faults:
            sentences.append(
                "An offset and a gain of each group explain only part of the misfit: chi-square "
                f"per degree of freedom is {beyond.chi_square / max(beyond.dof, 1):.4g} without "
                "them."
            )
    explained = shared and (inflate or not beyond.faults)
    return Widening(robust.covariance, robust.freedom, 1.0, tuple(sentences), explained)


def _widening_in_words(robust: Robustness, optimum: Optimum, groups: int) -> str:
    """Return a sentence on the errors that groups share and on the factor by which they widen the
    intervals.
    """
    if np.isnan(robust.light_design_effect):
        return (
            "There are too few groups to estimate errors that they share: intervals are those of "
            "independent data."
        )
    shown = (
        f"Residuals share errors within the {groups} groups; intervals include them"
        if robust.design_effect > 1
        else f"The residuals of the {groups} groups do not differ significantly; intervals include "
        "shared errors nevertheless"
    )
    ratios = np.diagonal(robust.covariance) / np.diagonal(np.linalg.inv(optimum.curvature))
    times = " to ".join(dict.fromkeys(f"{ratio:.3g}" for ratio in (ratios.min(), ratios.max())))
    freedom = f"{np.min(robust.freedom):.3g}"
    least = "at least " if len(ratios) > 1 else ""
    return (
        f"{shown}, with a variance {times} times that of independent data, and at 95 % are those "
        f"of Student's t with {least}{freedom} degree{'s' * (freedom != '1')} of freedom."
    )


def remove_shapes(
    residuals: Float[np.ndarray, "..."],
    labels: np.ndarray,
    shapes: tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]],
) -> Float[np.ndarray, "..."]:
    """Return the residuals after subtracting, in each group, the least-squares multiples of two
    shapes."""
    there = np.isfinite(residuals).ravel()
    r = np.where(there, residuals.ravel(), 0)
    first, second = (np.where(there, shape.ravel(), 0) for shape in shapes)
    across = second - first * _multiple(second, first, labels)[labels]
    for shape in (first, across):
        r = r - shape * _multiple(r, shape, labels)[labels]
    return np.where(there, r, np.nan).reshape(residuals.shape)


def _multiple(values: np.ndarray, shape: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return, for each group, the multiple of a shape that best fits the values in the
    least-squares sense.
    """
    size = np.bincount(labels, shape**2)
    return np.bincount(labels, values * shape) / np.where(size > 0, size, 1)


@eqx.filter_jit
def _scores(vector: Vector, problem: Problem) -> Array:
    """Return the gradients (P, data) of every datum's log density."""
    terms = jax.jacfwd(lambda v: log_likelihood_terms(v, problem).ravel())(vector)
    return terms.T


@eqx.filter_jit
def _predictions(vector: Vector, problem: Problem) -> Array:
    """Return the gradients (P, data) of every prediction."""
    slopes = jax.jacfwd(lambda v: prediction(problem, values_at(problem, v)).ravel())(vector)
    return slopes.T


@eqx.filter_jit
def predicted_at(vector: Vector, problem: Problem) -> tuple[Array, Any]:
    """Return the prediction and the likelihood at a vector of unconstrained values."""
    values = values_at(problem, vector)
    return prediction(problem, values), likelihood_at(problem, values)


def residuals_at(
    problem: Problem, vector: Array, *, seed: int, shift: float = 0.0
) -> Float[np.ndarray, "..."]:
    """Return the standardised residuals about the prediction plus a shift; NaN where a datum is
    missing.
    """
    chance = np.random.default_rng(seed).uniform(size=problem.data.shape)
    return _residuals(problem, vector, chance, shift)


def residual_sums(
    problem: Problem, vector: Array, advance: Advance, *, seed: int
) -> Float[np.ndarray, " sums"]:
    """Return the sums over residuals that test the fit, from data that are read in chunks."""
    rng = np.random.default_rng(seed)
    before, totals = None, np.zeros(2 + 4 * problem.data.ndim)
    for part in chunks(problem, advance=advance):
        residuals = _residuals(part, vector, rng.uniform(size=part.data.shape), 0.0)
        totals = totals + sums(residuals, before=before)
        before = residuals[-1] if residuals.ndim else None
    return totals


def _residuals(
    problem: Problem, vector: Array, chance: np.ndarray, shift: float
) -> Float[np.ndarray, "..."]:
    predicted, likelihood = predicted_at(vector, problem)
    place = jax.tree.map(lambda x: to_host(x, dtype=np.float64) + shift, predicted)
    found = likelihood.residuals(place, to_host(problem.data), chance)
    found = to_host(found, dtype=np.float64)
    return found if problem.present is None else np.where(to_host(problem.present), found, np.nan)


def _slopes(problem: Problem, vector: Array, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivative of each residual with respect to its prediction, by finite differences,
    and the predictions. The step scales with the data, because rounding would dominate a
    much smaller step.
    """
    predicted = to_host(predicted_at(vector, problem)[0], dtype=np.float64)
    data = to_host(problem.data, dtype=np.float64)
    there = data[np.isfinite(data)]
    largest = max(float(np.abs(predicted).max()), float(np.std(there)) if there.size else 0.0)
    size = max(float(np.std(predicted)), LEAST * largest) or 1.0
    step = SMALL * size
    least = float(predicted.min())
    below = min(step, least) if least >= 0 else step  # light is not negative
    ends = (residuals_at(problem, vector, seed=seed, shift=s) for s in (step, -below))
    return np.subtract(*ends) / (step + below), predicted
