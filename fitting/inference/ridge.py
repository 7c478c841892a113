"""A posterior along one number, with the others integrated by Laplace's method.

The joint mode may be far from the probable values of a single number. A common case is the standard
deviation among groups whose effects are fitted at the same time. Let u be one number and v the
others. At fixed u, let v(u) be the best values of v, and I(u) the information about v. Then

    ln p(u | data) = ln p(u, v(u) | data) - ln det I(u) / 2

up to a constant. A draw takes u from a table of this density, and v from a distribution centred at
v(u). The draws are weighted by the exact posterior density, so the result is exact.

Source:
    Tierney & Kadane, "Accurate Approximations for Posterior Moments and Marginal Densities",
    J. Am. Stat. Assoc. 81, 1986; Rue, Martino & Chopin, J. R. Stat. Soc. B 71, 2009.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, gammaln, ndtri

from .newton import minimise_many

# cost (n,), gradient (n, P) and curvature (n, P, P) at (n, P) vectors
Local = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]

POINTS = 48  # of the table
FIRST_END = 4.0  # standard deviations from the mode at which the first table ends
END_FALL = 12.0  # fall of the log density at the ends of the table
ROUNDS = 8  # of tables
FREEDOM = 5.0  # degrees of freedom of half of the proposals; the others are Gaussian


@dataclass(frozen=True)
class Ridge:
    """The density of one number u, and the best values of the others at each u."""

    index: int  # of u among the P numbers
    places: Float[np.ndarray, " places"]  # u
    log_density: Float[np.ndarray, " places"]  # of u, up to a constant
    # all numbers, with the others at their best values
    centres: Float[np.ndarray, "places parameters"]
    roots: Float[np.ndarray, "places others others"]  # of the covariances of the others at each u

    @property
    def mode(self) -> Float[np.ndarray, " parameters"]:
        """Return the vector of the most probable u and the best values of the others."""
        return self.centres[np.argmax(self.log_density)]


def volume_change(
    curvatures: Float[np.ndarray, "points parameters parameters"],
) -> Float[np.ndarray, " parameters"]:
    """Return, for each number, the largest change of ln det I / 2, where I is the information about
    the other numbers. The curvatures are at a mode, then at a step up and then at a step down of
    each number. The result is infinite where a curvature is not positive definite.
    """
    count = curvatures.shape[-1]
    middle = np.array([_volume(curvatures[0], i) for i in range(count)])
    moved = np.array([_volume(curvatures[1 + k], k % count) for k in range(2 * count)])
    return np.max(np.abs(moved.reshape(2, count) - middle), axis=0)


def widest_first(
    curvatures: Float[np.ndarray, "points parameters parameters"],
    scales: Float[np.ndarray, " parameters"],
) -> np.ndarray:
    """Order the numbers by how strongly the information about the other numbers changes along them.

    Args:
        curvatures: at a mode and at steps of each number alone, up and then down.
        scales: factor on the changes of each number's row.
    """
    count = curvatures.shape[-1]
    with np.errstate(all="ignore"):
        logs = np.log(np.diagonal(curvatures, axis1=1, axis2=2))
    change = np.abs(logs[1:] - logs[0]).reshape(2, count, count).mean(axis=0) / 2
    change = np.nan_to_num(change * scales[:, None], nan=1.0, posinf=1.0)
    np.fill_diagonal(change, 0)
    return np.argsort(-np.minimum(change, 1).sum(axis=1), kind="stable")


def _volume(curvature: Float[np.ndarray, "parameters parameters"], index: int) -> float:
    """Return ln det / 2 without one row and column; infinite unless the determinant is positive."""
    others = np.delete(np.arange(len(curvature)), index)
    with np.errstate(all="ignore"):
        sign, log = np.linalg.slogdet(curvature[np.ix_(others, others)])
    return float(log) / 2 if sign > 0 and np.isfinite(log) else np.inf


def ridge(
    local: Local,
    mode: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    index: int,
    *,
    digit: float,
) -> Ridge | None:
    """Tabulate the density of one number. `digit` is the relative rounding error of the costs.
    Return None if the density does not decrease on both sides, or if the other numbers have no best
    values."""
    others = np.delete(np.arange(len(mode)), index)
    step = covariance[index] / np.sqrt(covariance[index, index])
    low, high = -FIRST_END, FIRST_END

    def evaluate(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cost, gradient, curvature = local(vectors)
        gradient, curvature = gradient.copy(), curvature.copy()
        gradient[:, index] = curvature[:, index] = curvature[:, :, index] = 0
        curvature[:, index, index] = 1
        return cost, gradient, curvature

    for _ in range(ROUNDS):
        steps = np.linspace(low, high, POINTS)
        found = minimise_many(evaluate, mode + steps[:, None] * step, digit=digit, careful=True)
        information = found.information[:, others[:, None], others]
        with np.errstate(all="ignore"):
            signs, logs = np.linalg.slogdet(information)
            density = -found.cost - logs / 2
        known = found.converged & (signs > 0) & np.isfinite(density)
        density = np.where(known, density, -np.inf)
        if not known.any():
            return None
        inside = np.flatnonzero(density > density.max() - END_FALL)
        first, last = inside[0], inside[-1]
        wide = high - low
        if first == 0 or last == POINTS - 1:
            low, high = low - wide * bool(first == 0), high + wide * bool(last == POINTS - 1)
            continue
        if last - first < POINTS // 3:
            low, high = steps[first - 1], steps[last + 1]
            continue
        # The density may fall by far more than DEEP within one step, as where another number meets
        # a bound: the table includes the first places beyond.
        chosen = slice(first - 1, last + 2)
        if not known[chosen].all():
            return None
        try:
            roots = np.linalg.cholesky(np.linalg.inv(information[chosen]))
        except np.linalg.LinAlgError:
            return None
        centres = found.vector[chosen]
        return Ridge(index, centres[:, index], density[chosen], centres, roots)
    return None


def proposed(
    along: Ridge, units: Float[np.ndarray, "draws coordinates"]
) -> tuple[Float[np.ndarray, "draws parameters"], Float[np.ndarray, " draws"]]:
    """Return vectors and their log density up to a constant. Each vector is made from P + 2 uniform
    numbers: one for u, P - 1 for the other numbers, one for the width of Student's t, and one that
    selects Student's t or a Gaussian."""
    place, cell, share, log_density = _draw_log_linear(along, units[:, 0])
    size = along.centres.shape[1] - 1
    stretch = np.sqrt(FREEDOM / chdtri(FREEDOM, units[:, -2]))
    normal = ndtri(np.clip(units[:, 1:-2], 1e-12, 1 - 1e-12))
    normal = normal * np.where(units[:, -1] < 0.5, stretch, 1)[:, None]
    root = _interpolate(along.roots, cell, share)
    others = np.delete(np.arange(size + 1), along.index)
    vectors = _interpolate(along.centres, cell, share)
    vectors[:, along.index] = place
    vectors[:, others] += np.einsum("nij,nj->ni", root, normal)
    squares = np.sum(normal**2, axis=1)
    # less ln of the normalisation of Student's t over that of a Gaussian
    ratio = gammaln((FREEDOM + size) / 2) - gammaln(FREEDOM / 2) - size / 2 * np.log(FREEDOM / 2)
    gaussian = -squares / 2 - ratio
    student = -(FREEDOM + size) / 2 * np.log1p(squares / FREEDOM)
    volume = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return vectors, log_density + np.logaddexp(gaussian, student) - volume


def _interpolate(values: np.ndarray, cell: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Interpolate the values of a table linearly between its places."""
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return (1 - share) * values[cell] + share * values[cell + 1]


def _draw_log_linear(
    along: Ridge, uniform: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Draw u from a log-linear density in each cell; return u, cell, position in it, log
    density."""
    logs = along.log_density - along.log_density.max()
    width, rise = np.diff(along.places), np.diff(logs)
    steep = np.abs(rise) > 1e-9
    fall = -np.abs(rise)  # the mean is taken relative to the higher end, which cannot overflow
    mean = np.where(steep, np.expm1(fall) / np.where(steep, fall, 1), 1)
    mass = np.abs(width) * np.exp(np.maximum(logs[:-1], logs[1:])) * mean
    total = np.concatenate([[0.0], np.cumsum(mass)])
    reached = uniform * total[-1]
    cell = np.clip(np.searchsorted(total, reached, side="right") - 1, 0, len(mass) - 1)
    part = np.clip((reached - total[cell]) / mass[cell], 0, 1)
    own, down = rise[cell], fall[cell]
    from_top = np.clip(np.where(own > 0, 1 - part, part), 0, 1 - 1e-16)
    share = np.log1p(from_top * np.expm1(down)) / np.where(steep[cell], down, 1)
    share = np.where(steep[cell], np.where(own > 0, 1 - share, share), part)
    share = np.clip(share, 0, 1)
    place = along.places[cell] + share * width[cell]
    return place, cell, share, logs[cell] + share * own
