"""Coverage of the intervals of a user's own fit."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxvision.core.in_notebooks import record_html
from jaxvision.errors import InputError

from ..fits.solve import Method, fit, method_of
from ..inference.given import require_seed, require_whole
from ..inference.parameters import Parameter, names, prior_values
from ..inference.problem import Problem, likelihood_at, prediction, values_from
from .coverage import LEVELS, Coverage, coverage
from .simulations import simulated


@dataclass(frozen=True)
class Check:
    """Coverage of the intervals of a fit, parameter by parameter. `print` shows it as text.

    Attributes:
        coverage: of the intervals of every free number.
        places: (simulations, P) cumulative probability of the true value in each posterior, for the
            P free numbers; NaN where a fit did not converge.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import Gaussian, Normal, Parameter, Problem, check
        >>> free = {name: Parameter(prior=Normal(1.0, 1.0)) for name in ("gain", "bias")}
        >>> line = {"x": np.array([-1.0, 0.0, 1.0]), **free}
        >>> found = check(Problem(line, jv.gain_bias, Gaussian(0.1), np.zeros(3)), simulations=20)
        >>> [one.name for one in found.coverage], found.faults
        (['gain', 'bias'], ())
    """

    coverage: tuple[Coverage, ...]
    places: Float[np.ndarray, "simulations parameters"]

    @property
    def faults(self) -> tuple[str, ...]:
        """One sentence for each parameter whose coverage differs from the nominal one by more than
        chance explains; empty if there is none."""
        return tuple(f"{one.name}: {'; '.join(one.faults)}." for one in self.coverage if one.faults)

    def __str__(self) -> str:
        from .section import line

        return "\n".join([*(line(one) for one in self.coverage), *self.faults, *self._withheld])

    @property
    def _withheld(self) -> tuple[str, ...]:
        total = len(self.places)
        none = int(np.isnan(self.places).all(axis=1).sum())
        return (f"{none} of {total} fits gave no interval and are not counted.",) if none else ()

    def _repr_html_(self) -> str:
        levels = [f"{100 * level:.0f} %" for level in LEVELS]
        rows = [
            (
                *(one.name, str(one.simulations)),
                *(f"{share:.3f}" for share in one.covered),
                " to ".join(f"{end:.3f}" for end in one.band[-1]),
                f"{one.z_mean:+.2f} ± {one.z_sd:.2f}",
            )
            for one in self.coverage
        ]
        heads = ("parameter", "fits", *levels, f"{levels[-1]}, by chance", "z")
        title = "Share of fits whose interval contains the true value"
        return record_html(heads, rows, title=title, notes=(*self.faults, *self._withheld))


def check(
    problem: Problem,
    *,
    simulations: int = 200,
    truth: dict[str, Any] | None = None,
    posterior: Method | str | None = None,
    kept: Path | str | None = None,
    seed: int = 0,
) -> Check:
    """Simulate data of a problem, fit them, and count how often the intervals contain the true
    values.

    Every simulation draws the parameters from their priors and the data from the likelihood, so
    that correct posteriors have the nominal coverage (Talts et al. 2018). Each fit starts at the
    true values, because the search for the optimum is not tested.

    Args:
        problem: the problem whose intervals are checked. Its data are replaced by simulated data.
        simulations: number of simulated data sets; 200 determine a coverage of 95 % to within 1.5
            %.
        truth: true values of parameters in natural units, by name, the same in every simulation.
            Needed for parameters with neither prior nor bounds.
        posterior: how each posterior is computed, as in `fit`.
        kept: path of a file that stores the fits. A later call with this file continues from the
            stored fits, also with more simulations. None stores nothing.
        seed: seed of the true values, the data and the fits.

    Returns:
        Coverage of 50, 68 and 95 % intervals, mean and standard deviation of z, and ranks of the
        true values.

    Raises:
        InputError: for parameters without priors or given true values, for unusable numbers, for
            stored fits of another problem or seed, and if no fit gives an interval.

    Example:
        >>> import fitting
        >>> from fitting import Gaussian, Normal, Parameter, Problem
        >>> problem = Problem(
        ...     {"a": Parameter(prior=Normal(0.0, 1.0))},
        ...     predict=lambda a: a * jnp.ones(10),
        ...     likelihood=Gaussian(sd=0.5),
        ...     data=np.zeros(10),
        ... )
        >>> fitting.check(problem, simulations=20).faults
        ()
    """
    require_seed(seed)
    require_whole("simulations", simulations)
    method = method_of(posterior)
    space = problem.space
    labels = names(space)
    truths = _prior_quantiles(space) if truth is None else _stated_truth(problem, truth)

    def simulate(number: int) -> np.ndarray:
        rng = np.random.default_rng([seed, number])
        natural = np.array([rng.choice(row) for row in truths])
        values = values_from(problem, jnp.asarray(natural))
        drawn = likelihood_at(problem, values).draw(
            jax.random.key(int(rng.integers(2**31))), prediction(problem, values)
        )
        again = problem.with_data(drawn)
        begin = {p.name: np.asarray(values[p.name]) for p in problem.free}
        found = fit(again, start=begin, posterior=method, seed=number)
        if not found.optimum.stationary:
            raise InputError("the search did not converge.")
        draws, own = found.posterior.samples, names(found.problem.space)
        at = [labels.index(name) for name in own]  # dropped candidates have no interval
        places = np.full(len(labels), np.nan)
        below = np.sum(draws < natural[at], axis=0)
        places[at] = (below + rng.uniform(size=len(at))) / (len(draws) + 1)
        return places

    places = simulated(
        simulate, simulations, parameters=len(labels), kept=None if kept is None else Path(kept)
    )
    return Check(coverage(places, labels), places)


def _prior_quantiles(space: tuple[Parameter, ...]) -> list[np.ndarray]:
    """Return values of each parameter that are equally likely under its prior."""
    known = [prior_values(parameter) for parameter in space]
    labels = zip(names(space), known, strict=True)
    if unknown := [label for label, values in labels if values is None]:
        raise InputError(
            f"check: {', '.join(unknown)} has neither prior nor bounds to draw a true value from; "
            "give one of these, or a truth."
        )
    return [values for values in known if values is not None]


def _stated_truth(problem: Problem, truth: dict[str, Any]) -> list[np.ndarray]:
    """Return the true values that the caller gives, one array of length 1 for each number."""
    if absent := [p.name for p in problem.free if p.name not in truth]:
        raise InputError(f"check: truth names no {', '.join(absent)}; give a value of each.")
    if unknown := set(truth) - {p.name for p in problem.free}:
        raise InputError(
            f"check: truth names {', '.join(sorted(unknown))}, which the problem does not fit; "
            f"it fits {', '.join(p.name for p in problem.free)}."
        )
    shaped = [
        np.broadcast_to(np.asarray(truth[p.name], float), p.shape or ()) for p in problem.free
    ]
    if not all(np.isfinite(values).all() for values in shaped):
        raise InputError("check: truth has values that are NaN or infinite; give finite ones.")
    return [np.array([value]) for values in shaped for value in values.ravel()]
