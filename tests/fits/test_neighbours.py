"""Tests intervals if neighbouring lights have similar errors, against simulated means with errors
that are smooth over directions."""

import numpy as np
import pytest
from scipy import stats

from fitting.inference.clustering import cluster_robust
from fitting.inference.neighbours import regions

LIGHTS, PIXELS = 32, 20


def mean_of_images(rng, reach):
    """Return (error of the mean, scores, information, light, positions)."""
    places = rng.uniform(-1, 1, (LIGHTS, 2))
    apart = ((places[:, None] - places) ** 2).sum(-1)
    shared = np.exp(-apart / (2 * reach**2)) if reach else np.eye(LIGHTS)
    own = np.linalg.cholesky(shared + 1e-9 * np.eye(LIGHTS)) @ rng.standard_normal(LIGHTS)
    light = np.repeat(np.arange(LIGHTS), PIXELS)
    errors = own[light] + 0.3 * rng.standard_normal(light.size)
    scores = (errors - errors.mean())[None]
    return errors.mean(), scores, np.array([[float(light.size)]]), light, places


def places_of_zero(reach, *, merged):
    found = []
    for seed in range(150):
        miss, scores, information, light, places = mean_of_images(
            np.random.default_rng(seed), reach
        )
        label = regions(scores, light, places)[light] if merged else light
        slopes = np.ones_like(scores)
        robust = cluster_robust(scores, information, label, None, slopes=slopes)
        found.append(stats.t.cdf(miss / np.sqrt(robust.covariance[0, 0]), robust.freedom[0]))
    return np.array(found)


def held(place):
    return np.mean(np.abs(place - 0.5) < 0.475)


@pytest.mark.slow
def test_intervals_cover_more_often_with_merged_neighbours():
    """The errors are smooth over a tenth of the positions."""
    assert held(places_of_zero(0.2, merged=False)) < 0.8
    assert held(places_of_zero(0.2, merged=True)) > 0.82


def test_independent_lights_are_not_merged():
    """At 1 %, 1 of 100 is merged on average, and 5 or more in one of 270 runs."""
    merged = 0
    for seed in range(100):
        _, scores, _, light, places = mean_of_images(np.random.default_rng(seed), 0.0)
        merged += len(np.unique(regions(scores, light, places))) < LIGHTS
    assert merged < 5


@pytest.mark.parametrize("count", [15, 16, 37])
def test_regions_are_eight_compact_groups_of_similar_size(count):
    rng = np.random.default_rng(1)
    places = rng.uniform(-1, 1, (count, 2))
    scores = np.stack([places[:, 0] + places[:, 1], places[:, 0] - places[:, 1]])
    labels = regions(scores, np.arange(count), places)
    if count < 16:
        assert len(np.unique(labels)) == count
        return
    sizes = np.bincount(labels)
    assert len(sizes) == 8
    assert sizes.max() - sizes.min() <= 1
    centres = np.stack([places[labels == k].mean(axis=0) for k in range(8)])
    within = np.mean(np.sum((places - centres[labels]) ** 2, axis=1))
    assert within < 0.3 * np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))
