"""What to measure next: candidates ranked by how far they would narrow a chosen quantity.

Data at inputs x add Fisher's information F(x) to that of the posterior. About its mode the variance
of a quantity t with the gradient g falls from g^T C g to

    g^T (C^-1 + F(x))^-1 g,

all other parameters marginalised (c-optimality; Chaloner & Verdinelli, Statistical Science 10,
1995; Atkinson, Donev & Tobias, "Optimum Experimental Designs", 2007). D-optimality, which serves
all parameters alike, ranks by ln det(1 + C F) / 2, the information gained in nats.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxvision.errors import InputError

from .information import Target, expected_information, slope_of, with_inputs

if TYPE_CHECKING:
    from .result import Fit


@dataclass(frozen=True)
class Candidate:
    """What one more measurement would do.

    Attributes:
        name: of the candidate.
        sd: expected standard deviation of the target after it, in its unit.
        fall: share of the target's variance that it takes away, 0 to 1.
        gain: expected information about all parameters, nats.
    """

    name: str
    sd: float
    fall: float
    gain: float


@dataclass(frozen=True)
class Plan:
    """Candidates, the one that narrows the target most first. Print it.

    Attributes:
        target: in words.
        value: of the target at the best fit, in its unit.
        sd: its standard deviation now.
        candidates: ranked.
    """

    target: str
    value: float
    sd: float
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> str:
        """Name of the first candidate."""
        return self.candidates[0].name

    def __str__(self) -> str:
        width = max(len(candidate.name) for candidate in self.candidates)
        rows = [
            f"  {c.name.ljust(width)}  {c.sd:10.4g}  {100 * c.fall:6.1f} %  {c.gain:8.3g}"
            for c in self.candidates
        ]
        head = f"  {'measure'.ljust(width)}        s.d.  variance  gain/nat"
        return "\n".join([f"{self.target} = {self.value:.5g} ± {self.sd:.2g}; next:", head, *rows])


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
    problem, vector = fit.problem, fit.optimum.vector
    covariance = fit.posterior.covariance
    value, slope = slope_of(problem, target, vector)
    root = np.linalg.cholesky(covariance)
    along = root.T @ slope
    now = float(along @ along)
    found = []
    for name, inputs in candidates.items():
        new = with_inputs(problem, inputs)
        every = np.ones((1, int(np.prod(new.data.shape))))
        added = expected_information(new, vector, every, seed=fit.posterior.seed)[0]
        added = added * repeats / fit.noise**2
        more = np.eye(len(root)) + root.T @ added @ root
        after = float(along @ np.linalg.solve(more, along))
        gain = float(np.linalg.slogdet(more)[1]) / 2
        found.append(Candidate(name, float(np.sqrt(after)), 1 - after / now, gain))
    ranked = tuple(sorted(found, key=lambda candidate: candidate.sd))
    return Plan(in_words(target), value, float(np.sqrt(now)), ranked)


def in_words(target: Target) -> str:
    """The name of a target.

    Args:
        target: a name or a function.

    Returns:
        The name.
    """
    return target if isinstance(target, str) else getattr(target, "__name__", "target")
