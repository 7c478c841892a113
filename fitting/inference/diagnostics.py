"""Find the parameters that the data do not identify, from the Fisher information.

The information matrix F is scaled to unit diagonal. Eigenvectors of its smallest eigenvalues are
combinations of parameters that the data do not identify. sqrt(VIF_i) = sqrt(F_ii (F^-1)_ii) is the
factor by which the uncertainty of the other parameters increases the error of parameter i (variance
inflation; Belsley, Kuh & Welsch 1980). An unidentifiable combination is reported, never hidden by a
pseudo-inverse.
"""

from dataclasses import dataclass

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from .parameters import ParameterSpace, names, natural_numbers, natural_slopes, scaled_ends

UNDETERMINED = 1e-10  # scaled eigenvalue that may be rounding alone: a direction without data
REPORTED_VIF = 5.0  # sqrt(VIF) from which it is reported
KNOWN_WELL = 0.05  # relative error of a parameter up to which its VIF is not reported
PARTNER = 0.3  # component of a direction from which a parameter is named in it
OPEN_LOG_SD = 1.0  # standard deviation of a log parameter from which it counts as not determined


@dataclass(frozen=True)
class Identifiability:
    """The result of testing an information matrix for parameters that it does not determine.

    Attributes:
        inflation: (parameters,) sqrt(VIF), infinite where undetermined.
        determined: whether the data determine every direction of the parameters.
        sentences: the result in words for a report; empty where all parameters are well determined.
    """

    inflation: Float[np.ndarray, " parameters"]
    determined: bool
    sentences: tuple[str, ...]


def identifiability(
    space: ParameterSpace,
    information: Float[np.ndarray, "parameters parameters"],
    *,
    rounding: float = UNDETERMINED,
    vector: Float[ArrayLike, " parameters"] | None = None,
) -> Identifiability:
    """Test whether an information matrix determines all parameters.

    `vector` is the unconstrained best fit (P,). If it is None, relative errors are known only for
    parameters on a logarithmic scale.

    Source:
        Belsley, Kuh & Welsch, "Regression Diagnostics", 1980.
    """
    information = np.asarray(information, np.float64)
    labels = names(space)
    diagonal = np.diagonal(information)
    blind = ~(np.isfinite(diagonal) & (diagonal > 0))
    if blind.any() or not np.isfinite(information).all():
        lost = [label for label, unseen in zip(labels, blind, strict=True) if unseen]
        what = listed(lost) if lost else "any parameter"
        sentence = f"The data say nothing about {what}."
        return Identifiability(np.where(blind, np.inf, 1.0), False, (sentence,))
    size = np.sqrt(diagonal)
    eigenvalues, directions = np.linalg.eigh(information / np.outer(size, size))
    open_ = eigenvalues <= rounding
    if open_.any():
        touched = (np.abs(directions[:, open_]) > 1e-3).any(axis=1)
        inflation = np.where(touched, np.inf, 1.0)
        words = tuple(
            f"The data cannot distinguish {listed(_partners(labels, direction))}: the others can "
            "compensate a change in one, to within rounding. Fix one of them, or add measurements "
            "that separate them. If the inputs are far from 0, such as dates in seconds, subtract "
            "a constant from them."
            for direction in directions[:, open_].T
        )
        return Identifiability(inflation, False, words)
    inflation = np.sqrt(np.sum(directions**2 / eigenvalues, axis=1))
    errors = inflation / size
    relative = errors * _relative_slopes(space, vector)
    inflated = np.where(relative > KNOWN_WELL, inflation, 0.0)
    return Identifiability(
        inflation, True, _confused_parameters(labels, directions[:, 0], inflated, relative)
    )


def _relative_slopes(space: ParameterSpace, vector: ArrayLike | None) -> np.ndarray:
    """Return d ln(value) / d(unconstrained value) of each parameter; infinite if unknown."""
    if vector is None:
        free = [p.transform == "log" and scaled_ends(p) == (-np.inf, np.inf) for p in space]
        return np.where(free, 1.0, np.inf)
    at = np.asarray(vector, np.float64)
    size = np.maximum(np.abs(natural_numbers(space, at)), np.finfo(float).tiny)
    return np.abs(natural_slopes(space, at)[0]) / size


def _partners(labels: tuple[str, ...], direction: np.ndarray) -> list[str]:
    return [name for name, share in zip(labels, direction, strict=True) if abs(share) > PARTNER]


def _confused_parameters(
    labels: tuple[str, ...], worst: np.ndarray, inflation: np.ndarray, relative: np.ndarray
) -> tuple[str, ...]:
    if inflation.max() < REPORTED_VIF:
        return ()
    most = int(np.argmax(inflation))
    others = [name for name in _partners(labels, worst) if name != labels[most]]
    known = f" to {100 * relative[most]:.2g} %," if np.isfinite(relative[most]) else ""
    return (
        f"{labels[most]} is known{known} {inflation[most]:.0f} times less well than it would be if "
        f"{listed(others or ['the others'])} were known: the data can hardly distinguish them.",
    )


def listed(words: list[str]) -> str:
    """Join words to "a, b and c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
