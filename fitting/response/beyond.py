"""The curve below the darkest code that pixels were seen at.

A smooth prior alone would go on with the exponent of the darkest codes, and be too sure of it. What
cameras do lies between two ends: a pure gamma keeps its exponent e; most others (sRGB, film, tone
curves) become linear toward black, where their exponent is 1. With u the code above black over full
scale, u_0 the darkest that was seen, and c = .12, as sRGB has it,

    e(u) = e(u_0) - b (c / (u + c) - c / (u_0 + c)),    b = 0 of a gamma,
                                                        b = b_1 where e(0) = 1.

The seen codes tell b as far as they bend likewise; before that it is N(b_1 / 2, (b_1 / 2)^2). The
error adds that of e(u_0), of b, and of a family that no camera obeys exactly.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .code_bins import CodeBins

TOE = 0.12  # c, share of full scale
LOWEST = 1.6  # times the darkest seen code, up to which its exponent is measured
FEWEST = 4  # seen codes to go on from
UNLIKE = 0.02, 0.2  # rms of the exponent beyond the family: of a linear camera; for each unit of e


@dataclass(frozen=True)
class Beyond:
    """The curve at codes below those seen.

    Attributes:
        log_exposure: (below,).
        variance: (below,) relative to the darkest seen code.
    """

    log_exposure: Float[np.ndarray, " below"]
    variance: Float[np.ndarray, " below"]


def below_seen(
    bins: CodeBins,
    log_exposure: Float[np.ndarray, " bins"],
    covariance: Float[np.ndarray, "bins bins"],
    seen: Bool[np.ndarray, " bins"],
) -> Beyond | None:
    """The curve below the darkest seen code.

    Args:
        bins: of codes.
        log_exposure: (bins,) measured.
        covariance: (bins, bins) of it.
        seen: (bins,).

    Returns:
        The codes below; None where there are none, or too few seen ones to go on from.
    """
    places = np.flatnonzero(seen)
    if len(places) < FEWEST or places[0] == 0:
        return None
    first = places[0]
    u = (bins.centres - bins.black) / (bins.full_scale - bins.black)
    log_u, toe = np.log(u), np.log1p(TOE / u)
    near = places[u[places] <= LOWEST * u[first]]
    near = near if len(near) >= FEWEST else places[:FEWEST]
    way = log_u - log_u[first]
    shape = toe - toe[first] + TOE / (u[first] + TOE) * way  # of b, at an exponent of e(u_0)
    columns = np.stack([np.ones(len(u)), way, shape], axis=1)
    own = covariance[np.ix_(near, near)]
    own = own + np.diag(np.diagonal(own) + 1e-8)  # neighbours that go together tell no more
    weighted = np.linalg.solve(own, columns[near])
    plain, right = columns[near].T @ weighted, weighted.T @ log_exposure[near]
    to_linear, told, information = 0.0, np.zeros(3), plain
    for _ in range(2):  # b_1 follows from e
        prior = np.array([0, 0, max(abs(to_linear) / 2, UNLIKE[0]) ** -2])
        information = plain + np.diag(prior)
        told = np.linalg.solve(information, right + prior * to_linear / 2)
        to_linear = (told[1] - 1) * (u[first] + TOE) / u[first]
    bend = float(np.clip(told[2], min(0, to_linear), max(0, to_linear)))
    left = log_exposure[near] - columns[near] @ told
    misfit = float(left @ np.linalg.solve(own, left)) / max(len(near) - 3, 1)
    e, spread = told[1], np.linalg.inv(information) * max(1.0, misfit)
    low = np.arange(first)
    unlike = UNLIKE[0] + UNLIKE[1] * abs(e - 1)
    beyond = columns[low, 1:]
    variance = np.sum((beyond @ spread[1:, 1:]) * beyond, axis=1) + (unlike * way[low]) ** 2
    return Beyond(log_exposure[first] + beyond @ np.array([e, bend]), variance)
