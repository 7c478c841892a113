"""Test optional terms of a model, which are kept only if the data support them.

A term with k numbers x must pass two tests. Let x_0 be the value that means absence of the term and
C the covariance of the estimates. First, the squared Wald ratio (x - x_0)^T C^-1 (x - x_0) must
exceed k ln n, which is Schwarz' criterion (BIC) for n data. Second, a ratio this large must occur
by chance in at most one of a hundred fits to data without the term. The second test limits false
positives, because the errors of the other parameters do not allow for the selection of terms.

Source:
    Schwarz, Ann. Statist. 6, 1978; the squared Wald ratio approximates twice the difference in log
    likelihood (Kass & Raftery, J. Am. Stat. Assoc. 90, 1995).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri, fdtri, stdtrit

from jaxvision.errors import InputError

from .parameters import Parameter, ParameterSpace, to_natural

CHANCE = 0.01  # probability of keeping a term that is absent


@dataclass(frozen=True)
class Candidate:
    """A term of a model that a fit keeps only if the data support it.

    Attributes:
        parameter: the free parameter of the term: one number, or an array that is kept or left out
            as a whole.
        absent: value of the parameter without the term, in its unit; may be a limit such as
            infinity.
        chance: probability that a term is kept although it is absent; 1 leaves the choice to BIC
            alone.
        requires: names of candidates without which the term makes no sense, as a second order
            requires the first. They are kept as long as this term is.
        side: `above` or `below`: on which side of the absent value a present term lies. A value on
            the other side is no evidence for the term.

    Raises:
        InputError: if `parameter` is not a `Parameter`, and for an invalid probability or side.

    Example:
        The data follow a straight line, so the quadratic term is left out.

        >>> from fitting import Candidate, Gaussian, Parameter, Problem, fit
        >>> x = np.linspace(-1.0, 1.0, 50)
        >>> line = Problem(
        ...     {"slope": Parameter(linear=True), "bend": Candidate(Parameter(linear=True))},
        ...     predict=lambda slope, bend, inputs: slope * inputs + bend * inputs**2,
        ...     likelihood=Gaussian(sd=0.1),
        ...     data=2 * x + 0.1 * np.random.default_rng(0).standard_normal(50),
        ...     inputs=x,
        ... )
        >>> found = fit(line)
        >>> [(one.name, one.kept) for one in found.choices], float(found.values["bend"])
        ([('bend', False)], 0.0)
    """

    parameter: Parameter
    absent: float = 0.0
    chance: float = CHANCE
    requires: tuple[str, ...] | str = ()
    side: Literal["both", "above", "below"] = "both"

    def __post_init__(self) -> None:
        if not isinstance(self.parameter, Parameter):
            raise InputError(f"Candidate: {self.parameter!r:.60} is no Parameter; give one.")
        if not 0 < self.chance <= 1:
            raise InputError(f"Candidate: chance = {self.chance!r}: use a number above 0, up to 1.")
        if self.side not in ("both", "above", "below"):
            raise InputError(f"Candidate: side = {self.side!r}: use 'both', 'above' or 'below'.")
        if np.isnan(self.absent):
            raise InputError("Candidate: absent is NaN; give the value of an absent term.")
        if isinstance(self.requires, str):
            object.__setattr__(self, "requires", (self.requires,))

    @property
    def name(self) -> str:
        """Return the name of its parameter."""
        return self.parameter.name


@dataclass(frozen=True)
class Choice:
    """The decision whether a candidate was kept, with the evidence for it.

    Attributes:
        name: name of the candidate.
        kept: whether the term is in the fitted model.
        ratio: distance of the estimate from the absent value, in standard errors.
        needed: smallest ratio with which the term is kept.
        absent: value of the parameter without the term, in its unit.

    Example:
        >>> from fitting import Choice
        >>> print(Choice("bend", kept=False, ratio=0.7, needed=2.58, absent=0.0))
        bend is left out: its estimate lies 0.7 standard errors from 0, and 2.58 are needed.
    """

    name: str
    kept: bool
    ratio: float
    needed: float
    absent: float

    def __str__(self) -> str:
        size = f"its estimate lies {self.ratio:.3g} standard errors from {self.absent:g}"
        if self.kept:
            return f"{self.name} stays: {size}, and {self.needed:.3g} were needed."
        return f"{self.name} is left out: {size}, and {self.needed:.3g} are needed."


def squared_ratios(
    space: ParameterSpace,
    vector: Float[np.ndarray, " parameters"],
    information: Float[np.ndarray, "parameters parameters"],
    candidates: Sequence[Candidate],
) -> Float[np.ndarray, " candidates"]:
    """Return the squared Wald ratio of each candidate, 0 if the data do not determine it.

    A candidate may have its absent value at the lower end of its range: 0 for a positive scale, or
    the lower bound. Its ratio is then 1 / sd(u), with u the unconstrained value."""
    at = jnp.asarray(vector)
    natural, slope = jax.jvp(lambda u: to_natural(space, u), (at,), (jnp.ones_like(at),))
    natural, slope = np.asarray(natural, np.float64), np.asarray(slope, np.float64)
    found = []
    for candidate in candidates:
        own = numbers_of(candidate, space)
        away = natural[own] - candidate.absent
        if not np.isfinite(candidate.absent):  # a term absent at infinity: its ratio to 0
            away = natural[own]
        if candidate.side != "both":
            away = np.maximum(away, 0) if candidate.side == "above" else np.minimum(away, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.nan_to_num(away / slope[own], posinf=0, neginf=0)
        rest, across = information[~own][:, ~own], information[~own][:, own]
        taken = across.T @ np.linalg.lstsq(rest, across, rcond=None)[0]
        found.append(max(float(step @ (information[own][:, own] - taken) @ step), 0.0))
    return np.array(found)


def price(
    count: float,
    *,
    chance: float = CHANCE,
    numbers: int = 1,
    freedom: float = np.inf,
    scatter: tuple[int, int] | None = None,
) -> float:
    """Return the squared Wald ratio above which a term is kept."""
    larger = 1.0
    if scatter is not None:
        freedom = max(scatter[0] - scatter[1], 1)
        larger = scatter[0] / freedom
    if numbers == 1:
        by_chance = float(stdtrit(freedom, chance / 2)) ** 2 if chance < 1 else 0.0
    elif np.isinf(freedom):
        by_chance = float(chdtri(numbers, chance))
    else:  # with an estimated variance, the ratio over k follows Fisher's F
        by_chance = numbers * float(fdtri(numbers, freedom, 1 - chance))
    return max(numbers * float(np.log(count)), by_chance * larger)


def weakest(
    ratios: Mapping[str, float], prices: Mapping[str, float], candidates: Sequence[Candidate]
) -> str | None:
    """Return the candidate whose squared Wald ratio is smallest relative to its threshold, among
    those that no other candidate requires; None if all ratios exceed their thresholds."""
    required = {name for candidate in candidates for name in candidate.requires}
    shares = {c.name: ratios[c.name] / prices[c.name] for c in candidates if c.name not in required}
    least = min(shares, key=shares.__getitem__, default=None)
    return least if least is not None and shares[least] < 1 else None


def numbers_of(candidate: Candidate, space: ParameterSpace) -> Bool[np.ndarray, " parameters"]:
    """Return a mask over the scalar parameters of a space: True for those that belong to the
    candidate."""
    return np.array([candidate.name in (one.name, whole_name(one.name)) for one in space])


def whole_name(name: str) -> str:
    """Return the name of the parameter to which a number belongs: "a" for "a[0,1]"."""
    return name.rpartition("[")[0] if name.endswith("]") else name
