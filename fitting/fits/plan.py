"""What to measure next, for any problem: candidate inputs of `predict`, ranked."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxvision.errors import InputError

from ..inference.design import Plan, ranked
from ..inference.given import require_whole
from .information import Target, expected_information, slope_of, with_inputs

if TYPE_CHECKING:
    from .result import Fit


def plan(fit: "Fit", candidates: Mapping[str, Any], target: Target, *, repeats: int = 1) -> Plan:
    """Ranks candidate measurements.

    Args:
        fit: of what has been measured.
        candidates: inputs of each by name, as `predict` takes them.
        target: what is to be known better: a free number by its name, or a JAX function to one.
        repeats: how often each would be measured.

    Returns:
        The plan.

    Raises:
        InputError: for no candidates, inputs that predict cannot use, and a target that is none.
    """
    if not candidates:
        raise InputError("plan: give at least one candidate.")
    require_whole("repeats", repeats)
    problem, vector = fit.problem, fit.optimum.vector
    value, slope = slope_of(problem, target, vector)
    added = {}
    for name, inputs in candidates.items():
        new = with_inputs(problem, inputs)
        every = np.ones((1, int(np.prod(new.data.shape))))
        found = expected_information(new, vector, every, seed=fit.posterior.seed)[0]
        if not np.isfinite(found).all():
            raise InputError(
                f"plan: predict or its slope is not finite for candidate {name!r}; check its "
                "inputs for NaN."
            )
        added[name] = found * repeats / fit.noise**2
    return ranked(in_words(target), value, slope, fit.posterior.covariance, added)


def in_words(target: Target) -> str:
    """The name of a target.

    Args:
        target: a name or a function.

    Returns:
        The name.
    """
    return target if isinstance(target, str) else getattr(target, "__name__", "target")
