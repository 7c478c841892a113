"""Merge clusters whose errors are correlated between neighbours, such as images with nearby lights.

The residual of a wrong surface model changes slowly with the position of the light, so images of
neighbouring lights are not independent. The test uses the clusters' scores y_g, transformed so that
they are uncorrelated between parameters and have unit variance. It compares the mean of y_g . y_h
over pairs of neighbours g and h with its value for permuted positions. If the mean is significantly
larger, the clusters are merged into regions, which are treated as independent (Conley, J.
Econometrics 92, 1999; regions of many clusters: Bester, Conley & Hansen, J. Econometrics 165,
2011).
"""

import numpy as np
from jaxtyping import Float, Int

FEWEST = 16  # clusters: fewer would give too few regions for a variance
REGIONS = 8
NEIGHBOURS = 2  # neighbours of each cluster
PERMUTATIONS, CHANCE = 499, 0.01


def regions(
    scores: Float[np.ndarray, "parameters samples"],
    cluster: Int[np.ndarray, " samples"],
    places: Float[np.ndarray, "clusters axes"],
) -> Int[np.ndarray, " clusters"]:
    """Return the region of each cluster, from positions in comparable units."""
    count = len(places)
    sums = np.stack([np.bincount(cluster, row, count) for row in scores], axis=1)
    present = np.flatnonzero(np.bincount(cluster, minlength=count))
    alone = np.arange(count)
    if len(present) < FEWEST or not _are_correlated(sums[present], places[present]):
        return alone
    labels = np.zeros(count, int)
    labels[present] = _halve_regions(places[present], REGIONS)
    return labels


def _are_correlated(sums: np.ndarray, places: np.ndarray) -> bool:
    """Return whether scores of neighbours are more similar than those of permuted positions."""
    centred = sums - sums.mean(axis=0)
    left, size, _ = np.linalg.svd(centred, full_matrices=False)
    scores = left[:, size > 1e-9 * size.max(initial=0.0)]
    apart = ((places[:, None] - places) ** 2).sum(axis=-1)
    np.fill_diagonal(apart, np.inf)
    near = np.argsort(apart, axis=1)[:, :NEIGHBOURS].ravel()
    own, products = np.repeat(np.arange(len(scores)), NEIGHBOURS), scores @ scores.T
    rng = np.random.default_rng(0)
    orders = rng.permuted(np.tile(np.arange(len(scores)), (PERMUTATIONS, 1)), axis=1)
    chance = products[orders[:, own], orders[:, near]].sum(axis=1)
    beyond = np.count_nonzero(chance >= products[own, near].sum())
    return bool((1 + beyond) / (1 + PERMUTATIONS) <= CHANCE)


def _halve_regions(places: np.ndarray, parts: int) -> np.ndarray:
    """Return the region of each position, after repeated halving along the longest axis."""
    if parts == 1:
        return np.zeros(len(places), int)
    centred = places - places.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    second = np.argsort(np.argsort(along, kind="stable"), kind="stable") >= len(places) / 2
    labels = np.empty(len(places), int)
    for half, offset in ((~second, 0), (second, parts // 2)):
        labels[half] = offset + _halve_regions(places[half], parts // 2)
    return labels
