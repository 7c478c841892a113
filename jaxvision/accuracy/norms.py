"""Compute norms of errors. A norm is the distance of a result from the reference as one number.
Relative norms are divided by a level: the root mean square of the reference, or `Problem.level` if
it is given."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..errors import InputError, nearest


def relative_rms(result: Any, reference: Any) -> float:
    """Compute the root mean square error divided by the root mean square of the reference, in
    float64.

    Args:
        result: any shape and unit.
        reference: the same unit, and the same shape or one that broadcasts to it.

    Returns:
        sqrt(mean (result - reference)^2 / mean reference^2), no unit.

    Raises:
        InputError: for a reference of zeros, because an error cannot be divided by 0, and for
            another shape.

    Example:
        >>> print(f"{jv.accuracy.relative_rms([1.0, 1.1], [1.0, 1.0]):.4f}")
        0.0707
    """
    exact, found = np.asarray(reference, np.float64), np.asarray(result, np.float64)
    if not (found.size and spreads_over(exact.shape, found.shape)):
        raise InputError(
            f"the result has shape {found.shape} and the reference {exact.shape}; give both one "
            "shape, or one number as the reference."
        )
    size = rms(exact)
    if size == 0:
        raise InputError(
            "the reference is 0 everywhere, so that no error is relative to it; add light."
        )
    return rms(found - exact) / size


def rms(values: np.ndarray) -> float:
    """Return the root mean square of an array, in its unit."""
    return float(np.sqrt(np.mean(values**2)))


NORMS: dict[str, Callable[[np.ndarray], float]] = {
    "rms": rms,
    "p99": lambda values: float(np.quantile(np.abs(values), 0.99)),
    "max": lambda values: float(np.max(np.abs(values))),
}


def level_of(reference: np.ndarray, level: float | None) -> float:
    """Return the level that makes errors relative, in the unit of the result; 1 for zeros."""
    found = rms(reference) if level is None else level
    return found if found > 0 else 1.0


def norms_of(
    result: np.ndarray,
    reference: np.ndarray,
    level: float,
    *,
    names: tuple[str, ...],
    developed: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Mapping[str, float]:
    """Compute the named norms of the error of one result. All norms are relative errors except
    "delta_e", the mean CIEDE2000 difference of the developed pictures, in units of L*."""
    apart = result - reference
    found = {name: NORMS[name](apart) / level for name in names if name in NORMS}
    if "delta_e" in names and developed is not None:
        from ..colour_spaces import delta_e_2000

        labs = (jnp.asarray(developed(one, reference)) for one in (result, reference))
        differences = delta_e_2000(*labs)
        found["delta_e"] = float(np.mean(np.asarray(differences, np.float64)))
    return found


def check_norms(names: tuple[str, ...]) -> None:
    """Raise `InputError` for an unknown norm, for no norm, or if the first norm is "delta_e"."""
    for name in names:
        if name not in (*NORMS, "delta_e"):
            raise InputError(f"norm {name!r} is unknown; {nearest(name, (*NORMS, 'delta_e'))}.")
    if not names or names[0] not in NORMS:
        raise InputError(f"the first norm must be one of {', '.join(NORMS)}, got {names[:1]}.")


def spreads_over(reference: tuple[int, ...], result: tuple[int, ...]) -> bool:
    """Return whether a reference of one shape broadcasts to a result of another shape."""
    try:
        return np.broadcast_shapes(reference, result) == result
    except ValueError:
        return False


# The logarithm of a run's error is assumed normal, so that Student's t predicts the next one from
# a few (Hahn and Meeker, "Statistical Intervals", Wiley (1991), ch. 4). The scatter is at most that
# of a single random number, whose square over the mean of the others follows Fisher's F with 1 and
# k degrees of freedom. The bounds include all observed errors. Of 3,000 further errors (chi with 1
# to 3,000 degrees of freedom, or log-normal), 1.2 to 3.8 of 100 exceeded the upper bound.
_CHANCE = 0.025  # probability of a run above the upper bound, and of one below the lower


def next_error(errors: np.ndarray) -> tuple[float, float, float]:
    """Return the root mean square of the errors of k runs, (k,), and a lower and an upper bound
    between which the error of the next run lies with 95 % probability."""
    from scipy.special import fdtri, stdtrit

    seen = np.abs(np.asarray(errors, np.float64))
    count, typical = len(seen), rms(seen)
    if count < 2 or not np.isfinite(typical) or np.ptp(seen) == 0:
        return typical, typical, typical
    far = typical * np.sqrt(fdtri(1, count, [_CHANCE, 1 - _CHANCE]))
    with np.errstate(divide="ignore"):
        logarithms = np.log(seen)
    scatter = float(np.std(logarithms, ddof=1)) if seen.min() > 0 else np.inf
    half = float(stdtrit(count - 1, 1 - _CHANCE)) * scatter * (1 + 1 / count) ** 0.5
    middle = float(np.mean(logarithms)) if np.isfinite(scatter) else 0.0
    low = max(float(np.exp(middle - half)), float(far[0]))
    high = float(far[1])
    if middle + half < np.log(high):
        high = float(np.exp(middle + half))
    return typical, min(low, float(seen.min())), max(high, float(seen.max()))
