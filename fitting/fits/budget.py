"""Divide the variance of an estimated quantity among the sources of its uncertainty.

The best fit is, to first order, linear in the data and in the means of the priors. Let C be the
posterior covariance. Datum i has Fisher information F_i and variance v_i = sum_k v_ik, where v_ik
is due to noise source k. Nuisance parameter m has prior information P_m. A quantity of gradient g
has the variance

    g^T C g = sum_k g^T C (sum_i v_ik / v_i F_i) C g + sum_m g^T C P_m C g,

Each term is the part of the variance that would vanish if its source had been absent when the data
were taken and the weights of the fit were unchanged (law of propagation: JCGM 100:2008, "Guide to
the expression of uncertainty in measurement", 5.1). If the model misfits and the covariance was
therefore widened, the increase is the model's share.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.core.in_notebooks import record_html
from jaxvision.errors import InputError, nearest

from ..inference.candidates import whole_name
from ..inference.diagnostics import listed
from ..inference.formatting import format_with_error
from ..inference.joint_prior import places_of
from ..inference.likelihoods import Clustered
from ..inference.on_host import to_host
from ..inference.posterior import Posterior
from ..inference.problem import Problem
from ..inference.search import Optimum
from .information import Target, expected_information, slope_of, target_name
from .widening import predicted_at

REST = "other noise"
MODEL = "model"
SURPLUS = 1e-6  # relative excess of the sources over the variance that rounding explains
Noise = Mapping[str, float | Array | np.ndarray | Callable[[Array], Any]]


@dataclass(frozen=True)
class Share:
    """One source of uncertainty.

    Attributes:
        source: name of the source.
        share: fraction of the variance that is due to the source; all shares sum to 1.
        sd: standard deviation of the target if this source were the only one, in the unit of the
            target.
    """

    source: str
    share: float
    sd: float


@dataclass(frozen=True)
class Budget:
    """The sources of a quantity's uncertainty, largest first. Print the record to see them.

    Attributes:
        target: name of the quantity.
        value: the quantity at the best fit, in its unit.
        sd: standard deviation of the quantity.
        shares: the sources, with their shares of the quantity's variance.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import Gaussian, Parameter, Problem, fit
        >>> free = {"gain": Parameter(start=1.0), "bias": Parameter(start=0.0)}
        >>> line = {"x": np.array([-1.0, 0.0, 1.0]), **free}
        >>> found = fit(Problem(line, jv.gain_bias, Gaussian(sd=0.1), np.array([1.0, 3.0, 5.0])))
        >>> budget = found.budget("gain", noise={"read noise": 0.0064})  # of a variance of 0.01
        >>> round(budget.share_of("read noise"), 4), round(budget.share_of("other noise"), 4)
        (0.64, 0.36)
    """

    target: str
    value: float
    sd: float
    shares: tuple[Share, ...]

    def share_of(self, source: str) -> float:
        """Return the share of one source.

        Args:
            source: name of the source.

        Returns:
            The share of the variance that this source contributes.

        Raises:
            InputError: for an unknown source.
        """
        known = {share.source: share.share for share in self.shares}
        if source not in known:
            raise InputError(f"No source {source!r}; {nearest(source, known)}.")
        return known[source]

    def of(self, source: str) -> float:
        """Former name of `share_of`."""
        warnings.warn("of is now share_of.", DeprecationWarning, stacklevel=2)
        return self.share_of(source)

    def __str__(self) -> str:
        width = max(len(share.source) for share in self.shares)
        rows = [f"  {source.ljust(width)}  {share:>8}  {sd}" for source, share, sd in self._rows()]
        return "\n".join([self._heading(), *rows])

    def _heading(self) -> str:
        return f"{self.target} = {format_with_error(self.value, self.sd)}, from"

    def _rows(self) -> list[tuple[str, str, str]]:
        return [(s.source, f"{100 * s.share:.1f} %", f"± {s.sd:.3g}") for s in self.shares]

    def _repr_html_(self) -> str:
        heads = ("source", "of the variance", "s.d. it alone leaves")
        return record_html(heads, self._rows(), title=self._heading())


def budget(
    problem: Problem,
    optimum: Optimum,
    posterior: Posterior,
    target: Target,
    *,
    count: int,
    widened: float,
    noise: Noise | None = None,
    nuisances: Mapping[str, Sequence[str]] | None = None,
) -> Budget:
    """Divide the variance of an estimated quantity among its sources (see `Fit.budget`)."""
    vector = optimum.vector
    value, slope = slope_of(problem, target, vector)
    named = _shares_of_data(problem, vector, noise)
    parts = expected_information(
        problem, vector, np.stack(list(named.values())), seed=posterior.seed
    )
    parts = parts * (count / _present(problem).sum())  # data in chunks are represented by a sample
    prior = optimum.prior_information
    stated = np.linalg.inv(parts.sum(axis=0) / widened**2 + prior)
    along = stated @ slope
    terms = {
        name: float(along @ part @ along) / widened**4
        for name, part in zip(named, parts, strict=True)
    }
    model = sum(terms.values()) * (widened**2 - 1)
    terms |= _prior_contributions(problem, prior, along, nuisances or {})
    if isinstance(problem.likelihood, Clustered):  # the increase by errors that groups share
        model += float(slope @ (posterior.covariance - stated) @ slope)
    if model:
        terms[MODEL] = model
    total = sum(terms.values())
    found = [Share(name, x / total, float(np.sqrt(max(x, 0)))) for name, x in terms.items()]
    ranked = tuple(sorted(found, key=lambda share: -share.share))
    return Budget(target_name(target), value, float(np.sqrt(total)), ranked)


def _shares_of_data(
    problem: Problem, vector: np.ndarray, noise: Noise | None
) -> dict[str, Float[np.ndarray, " data"]]:
    """Return the share of each source in each datum's noise variance."""
    shape, present = problem.data.shape, _present(problem)
    predicted, likelihood = predicted_at(jnp.asarray(vector, problem.data.dtype), problem)
    sources = getattr(likelihood, "noise_sources", None)
    if noise is None:
        if sources is None:
            return {"noise": present.ravel()}
        parts = {name: to_host(x) for name, x in sources(predicted).items()}
        variance = sum(parts.values())
    else:
        variance = _variance(likelihood)
        parts = {
            name: to_host(part(predicted) if callable(part) else part, dtype=np.float64)
            for name, part in noise.items()
        }
    shares = {
        name: present * np.broadcast_to(part / variance, shape) for name, part in parts.items()
    }
    rest = present - sum(shares.values())
    if (rest < -SURPLUS).any():
        raise InputError(
            f"The sources of noise, {', '.join(parts)}, together have more variance than the "
            "likelihood: check their unit, which is the square of the data's unit."
        )
    if (rest > SURPLUS).any():
        shares[REST] = rest
    return {name: share.ravel() for name, share in shares.items()}


def _present(problem: Problem) -> np.ndarray:
    """Return an array that is 1 for each present datum and 0 for each missing one."""
    if problem.present is None:
        return np.ones(problem.data.shape)
    return to_host(problem.present, dtype=np.float64)


def _variance(likelihood: Any) -> np.ndarray:
    for inside in (likelihood, getattr(likelihood, "likelihood", None)):
        if inside is not None and hasattr(inside, "sd"):
            return to_host(inside.sd, dtype=np.float64) ** 2
    raise InputError(
        f"noise: {type(likelihood).__name__} states no standard deviation to divide; leave noise "
        "out."
    )


def _prior_contributions(
    problem: Problem, prior: np.ndarray, along: np.ndarray, nuisances: Mapping[str, Sequence[str]]
) -> dict[str, float]:
    """Return g^T C P_m C g, the variance that each source contributes by its prior. Priors are
    independent and their information is diagonal, except for a joint prior, which counts as one
    source.
    """
    each = np.diagonal(prior) * along**2
    joint = problem.prior
    together = np.array([], int) if joint is None else places_of(joint, problem.space)
    each[together] = 0.0
    owner = {name: group for group, members in nuisances.items() for name in members}
    known = {name for number in problem.space for name in (number.name, whole_name(number.name))}
    for unknown in owner.keys() - known:
        raise InputError(f"nuisances: no free number {unknown!r}; {nearest(unknown, known)}.")
    terms: dict[str, float] = dict.fromkeys(nuisances, 0.0)
    for number, term in zip(problem.space, each, strict=True):
        own = owner.get(number.name, owner.get(whole_name(number.name)))
        if own is None and term == 0:
            continue
        name = own or f"prior of {number.name}"
        terms[name] = terms.get(name, 0.0) + float(term)
    if joint is not None:
        own = owner.get(joint.names[0]) or f"prior of {listed(list(joint.names))}"
        term = along[together] @ prior[np.ix_(together, together)] @ along[together]
        terms[own] = terms.get(own, 0.0) + float(term)
    return terms
