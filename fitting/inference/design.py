"""Rank possible measurements by how much they would reduce the variance of a chosen quantity
(optimal design).

A measurement adds its Fisher information F to the inverse of the posterior covariance C. Near the
mode, the variance of a quantity with gradient g decreases from g^T C g to

    g^T (C^-1 + F)^-1 g,

with all other parameters marginalised (c-optimality; Chaloner & Verdinelli, Statistical Science 10,
1995; Atkinson, Donev & Tobias, "Optimum Experimental Designs", 2007). D-optimality, which treats
all parameters equally, ranks by ln det(1 + C F) / 2, the information gained in nats.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxvision.core.in_notebooks import record_html

from .formatting import format_with_error


@dataclass(frozen=True)
class Candidate:
    """The effect that one further measurement would have.

    Attributes:
        name: name of the candidate.
        sd: expected standard deviation of the target after the measurement, in the target's unit.
        fall: relative decrease of the target's variance, 0 to 1.
        gain: expected gain of information about all parameters, nats.
    """

    name: str
    sd: float
    fall: float
    gain: float


@dataclass(frozen=True)
class Plan:
    """Candidate measurements, the most informative about the target first. Print the record to see
    them.

    Attributes:
        target: name of the quantity.
        value: the quantity at the best fit, in its unit.
        sd: present standard deviation of the quantity.
        candidates: the candidates, the best first.

    Example:
        >>> from fitting import Gaussian, Parameter, Problem, fit
        >>> problem = Problem(
        ...     {"slope": Parameter(start=1.0)},
        ...     predict=lambda slope, inputs: slope * inputs,
        ...     likelihood=Gaussian(sd=0.1),
        ...     data=[2.0],
        ...     inputs=np.array([1.0]),
        ... )
        >>> plan = fit(problem).plan({"at 1": np.ones(1), "at 3": np.full(1, 3.0)}, target="slope")
        >>> [(one.name, round(one.fall, 2)) for one in plan.candidates]  # 9 / 10 and 1 / 2
        [('at 3', 0.9), ('at 1', 0.5)]
    """

    target: str
    value: float
    sd: float
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> str:
        """Return the name of the best candidate."""
        return self.candidates[0].name

    def __str__(self) -> str:
        width = max(len(candidate.name) for candidate in self.candidates)
        rows = [
            f"  {name.ljust(width)}  {sd:>10}  {fall:>8}  {gain:>8}"
            for name, sd, fall, gain in self._rows()
        ]
        head = f"  {'measure'.ljust(width)}        s.d.  variance  gain/nat"
        return "\n".join([self._heading(), head, *rows])

    def _heading(self) -> str:
        return f"{self.target} = {format_with_error(self.value, self.sd)}; next:"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        return [
            (c.name, f"{c.sd:.4g}", f"{100 * c.fall:.1f} %", f"{c.gain:.3g}")
            for c in self.candidates
        ]

    def _repr_html_(self) -> str:
        heads = ("measure", "s.d. then", "variance less by", "gain / nat")
        return record_html(heads, self._rows(), title=self._heading())


def rank(
    target: str,
    value: float,
    slope: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    added: Mapping[str, Float[np.ndarray, "parameters parameters"]],
) -> Plan:
    """Rank measurements by how much their information would reduce a target's variance."""
    root = np.linalg.cholesky(covariance)
    along = root.T @ slope
    now = float(along @ along)
    found = []
    for name, information in added.items():
        more = np.eye(len(root)) + root.T @ information @ root
        after = float(along @ np.linalg.solve(more, along))
        gain = float(np.linalg.slogdet(more)[1]) / 2
        found.append(Candidate(name, float(np.sqrt(after)), 1 - after / now, gain))
    best_first = tuple(sorted(found, key=lambda candidate: candidate.sd))
    return Plan(target, value, float(np.sqrt(now)), best_first)
