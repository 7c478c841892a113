"""Tests cluster-robust errors against simulations and closed forms."""

from itertools import combinations

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from fitting import Clustered, Gaussian, Parameter, Problem, fit
from fitting.inference.clustering import cluster_robust
from jaxvision.errors import InputError


def mean_with_clusters(rng, *, lights, pixels, shared_by_light, shared_by_pixel):
    """Return scores of a mean whose unit-variance errors share terms, and the variance of this
    mean."""
    light, pixel = (x.ravel() for x in np.indices((lights, pixels)))
    own = np.sqrt(1 - shared_by_light**2 - shared_by_pixel**2)
    error = (
        own * rng.standard_normal(light.size)
        + shared_by_light * rng.standard_normal(lights)[light]
        + shared_by_pixel * rng.standard_normal(pixels)[pixel]
    )
    true = own**2 / light.size + shared_by_light**2 / lights + shared_by_pixel**2 / pixels
    scores = (error - error.mean())[None]
    return scores, np.array([[float(light.size)]]), light, pixel, true


def test_independent_errors_are_seldom_called_clustered():
    """There are two tests at 1 % each, so 98 of 100 pass on average. 92 or fewer happen once in
    2000."""
    kept, ratios, freedom = 0, [], []
    for seed in range(100):
        data = mean_with_clusters(
            np.random.default_rng(seed), lights=20, pixels=200, shared_by_light=0, shared_by_pixel=0
        )
        found = cluster_robust(*data[:4])
        kept += found.design_effect == 1
        ratios.append(found.covariance[0, 0] * data[1][0, 0])
        freedom.append(found.freedom[0])
    assert kept > 92
    assert abs(np.median(freedom) / 19 - 1) < 0.02
    assert abs(np.mean(ratios) - 1) < 3 * np.sqrt(2 / 19 / 100)


def test_a_mean_of_few_clusters_is_the_t_test_of_their_means():
    """For balanced clusters and one parameter, CR2 is the variance of the clusters' means with
    clusters - 1 degrees of freedom (SciPy's one-sample t-test)."""
    rng = np.random.default_rng(3)
    scores, information, light, *_ = mean_with_clusters(
        rng, lights=6, pixels=100, shared_by_light=0.3, shared_by_pixel=0.0
    )
    # Shares are outer products of scores, which are equal in all clusters of equal size.
    scores = scores / np.sqrt(np.bincount(light, scores[0] ** 2) / 100)[light]
    scores = scores - scores.mean()
    found = cluster_robust(scores, information, light, None)
    means = np.bincount(light, scores[0]) / 100
    low, high = scipy.stats.ttest_1samp(means, 0).confidence_interval(0.95)
    half = scipy.stats.t.ppf(0.975, found.freedom[0]) * np.sqrt(found.covariance[0, 0])
    np.testing.assert_allclose(half, (high - low) / 2, rtol=0.01)
    np.testing.assert_allclose(found.freedom, 5, rtol=0.01)


def test_clusters_do_not_widen_a_prior():
    """The prior is a thousand times as strong as the data, and its width is unchanged."""
    data = mean_with_clusters(
        np.random.default_rng(1), lights=12, pixels=50, shared_by_light=0.3, shared_by_pixel=0.0
    )
    scores, information, light, _, _ = data
    found = cluster_robust(scores, 1001 * information, light, None, prior=1000 * information)
    np.testing.assert_allclose(found.covariance, 1 / (1001 * information), rtol=0.02)


@pytest.mark.sweep
@pytest.mark.parametrize(("by_light", "by_pixel"), [(0.3, 0.0), (0.0, 0.3), (0.2, 0.2)])
def test_shared_errors_widen_the_covariance_to_the_true_one(by_light, by_pixel):
    ratios = []
    for seed in range(60):
        *data, true = mean_with_clusters(
            np.random.default_rng(seed),
            lights=40,
            pixels=200,
            shared_by_light=by_light,
            shared_by_pixel=by_pixel,
        )
        ratios.append(cluster_robust(*data).covariance[0, 0] / true)
    # The variance from 40 clusters scatters by sqrt(2/39) = 0.23.
    assert abs(np.mean(ratios) - 1) < 4 * 0.23 / np.sqrt(60)


def test_one_cluster_is_not_judged():
    data = mean_with_clusters(
        np.random.default_rng(0), lights=1, pixels=100, shared_by_light=0.5, shared_by_pixel=0.0
    )
    found = cluster_robust(*data[:4])
    assert np.isnan(found.light_design_effect)
    assert not np.isnan(found.pixel_design_effect)


def test_clusters_with_equal_means_have_few_degrees_of_freedom():
    """Two clusters with equal means have a variance of zero."""
    light = np.repeat([0, 1], 4)
    scores = np.tile([-1.0, 1.0, 1.0, -1.0], 2)[None]
    found = cluster_robust(scores, np.array([[8.0]]), light, None, slopes=np.ones((1, 8)))
    assert 0 < found.covariance[0, 0] < 0.01 / 8
    np.testing.assert_allclose(found.freedom, 1)


def test_one_cluster_is_not_judged_by_a_prior():
    """A weak prior leaves a small residual in the only cluster."""
    scores = np.array([[-1.0, 1.0, 1.0, -1.0 + 1e-3]])
    information = np.array([[4.0]])
    found = cluster_robust(
        *(scores, 1.001 * information, np.zeros(4, int), None),
        slopes=np.ones((1, 4)),
        prior=0.001 * information,
    )
    assert np.isnan(found.light_design_effect)
    np.testing.assert_allclose(found.covariance, 1 / (1.001 * information))


def power(matrix, exponent):
    values, directions = np.linalg.eigh(matrix)
    return directions * np.where(values > 1e-12, values, np.inf) ** exponent @ directions.T


def test_several_parameters_as_by_the_dense_matrices():
    """V = sum X_g' (I - H_gg)^-1/2 e e' (I - H_gg)^-1/2 X_g and the trace formula of its degrees of
    freedom are computed with matrices over all samples (Bell & McCaffrey 2002)."""
    rng = np.random.default_rng(4)
    light = np.repeat(np.arange(6), 10)
    x = rng.standard_normal((6, 3))[light] + 0.3 * rng.standard_normal((60, 3))
    bread = np.linalg.inv(x.T @ x)
    left = np.eye(60) - x @ bread @ x.T
    e = left @ (rng.standard_normal(60) + 2 * rng.standard_normal(6)[light])
    members = [np.flatnonzero(light == g) for g in range(6)]
    roots = [power(left[np.ix_(i, i)], -0.5) for i in members]
    sums = np.stack([x[i].T @ root @ e[i] for i, root in zip(members, roots, strict=True)])
    maps = [left[:, i] @ root @ x[i] @ bread for i, root in zip(members, roots, strict=True)]
    squares = [np.stack(maps)[..., c] @ np.stack(maps)[..., c].T for c in range(3)]
    freedom = [np.trace(q) ** 2 / np.sum(q**2) for q in squares]

    found = cluster_robust((x * e[:, None]).T, x.T @ x, light, None, slopes=x.T)
    np.testing.assert_allclose(found.covariance, bread @ sums.T @ sums @ bread, rtol=1e-9)
    np.testing.assert_allclose(found.freedom, freedom, rtol=1e-9)


def test_two_way_clusters_subtract_what_both_count():
    """The covariance is V of the lights plus V of the pixels minus V of single samples (Cameron,
    Gelbach & Miller 2011), by dense matrices. The residuals are twice as large as the information
    assumes."""
    rng = np.random.default_rng(5)
    light, pixel = (x.ravel() for x in np.indices((8, 20)))
    x = 0.5 * rng.standard_normal((160, 2)) + rng.standard_normal((20, 2))[pixel]
    bread = np.linalg.inv(x.T @ x)
    left = np.eye(160) - x @ bread @ x.T
    shared = 2 * rng.standard_normal(8)[light] + 6 * rng.standard_normal(20)[pixel]
    e = left @ (2 * rng.standard_normal(160) + shared)

    def clustered(labels):
        members = [np.flatnonzero(labels == g) for g in np.unique(labels)]
        sums = [x[i].T @ power(left[np.ix_(i, i)], -0.5) @ e[i] for i in members]
        return np.stack(sums).T @ np.stack(sums)

    each = (x * e[:, None]).T @ (x * e[:, None])
    found = cluster_robust((x * e[:, None]).T, x.T @ x, light, pixel, slopes=x.T)
    assert found.pixel_design_effect > 2
    expected = bread @ (clustered(light) + clustered(pixel) - each) @ bread
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lights", "parameters"), [(6, 1), (6, 3), (8, 1), (8, 3), (12, 4), (40, 4)]
)
def test_intervals_cover_with_few_lights_and_several_parameters(lights, parameters):
    """The hardest case is a linear regression whose columns and errors belong to the light, with
    errors sixty times those of the pixels. The residuals of the lights with most leverage shrink
    most."""
    rng = np.random.default_rng(lights * 10 + parameters)
    pixels, inside = 30, []
    light = np.repeat(np.arange(lights), pixels)
    pixel = np.arange(light.size)
    for _ in range(400):
        by_light = rng.standard_normal((parameters, lights))[:, light]
        columns = by_light + 0.3 * rng.standard_normal((parameters, light.size))
        noise = rng.standard_normal(light.size) + 2 * rng.standard_normal(lights)[light]
        information = columns @ columns.T
        found = np.linalg.solve(information, columns @ noise)
        left = noise - found @ columns
        robust = cluster_robust(columns * left, information, light, pixel, slopes=columns)
        reach = scipy.stats.t.ppf(0.975, robust.freedom)
        inside.append(np.abs(found) < reach * np.sqrt(np.diagonal(robust.covariance)))
    assert 0.925 < np.mean(inside) < 0.975


def test_crossed_levels_equal_naive_sums():
    """The data are 6 x 7 x 8, with shared errors of frames, rows and columns, and slopes of 1."""
    rng = np.random.default_rng(4)
    shape = (6, 7, 8)
    frame, row, column = (index.ravel() for index in np.indices(shape))
    e = rng.standard_normal(shape)
    e += 2 * sum(rng.standard_normal(part) for part in ((6, 1, 1), (1, 7, 1), (1, 1, 8)))
    e = (e - e.mean()).ravel()
    count = e.size
    found = cluster_robust(
        e[None], np.array([[float(count)]]), frame, row, column, slopes=np.ones((1, count))
    )
    levels = {"f": frame, "r": row, "c": column}
    variance = 0.0
    for size in (1, 2, 3):
        for some in combinations(levels, size):
            keys = list(zip(*(levels[name] for name in some), strict=True))
            for key in set(keys):
                own = np.array([k == key for k in keys])
                larger = 1 if size == 3 else 1 / (1 - own.mean())
                variance += (-1) ** (size + 1) * e[own].sum() ** 2 * larger
    np.testing.assert_allclose(found.covariance[0, 0], variance / count**2, rtol=1e-9)
    assert min(found.effects) > 5


def test_a_level_within_another_adds_nothing():
    rng = np.random.default_rng(5)
    frame = np.repeat(np.arange(10), 24)
    row = np.repeat(np.arange(60), 4)
    e = rng.standard_normal(240) + rng.standard_normal(60)[row] + rng.standard_normal(10)[frame]
    x = np.ones((1, 240))
    alone = cluster_robust(e[None], np.array([[240.0]]), frame, slopes=x)
    both = cluster_robust(e[None], np.array([[240.0]]), frame, row, slopes=x)
    np.testing.assert_allclose(both.covariance, alone.covariance, rtol=1e-9)


@pytest.mark.slow
def test_a_fit_with_named_levels_covers():
    """Intervals of the mean over 200 fits cover the true value if frames, rows and columns share
    errors."""
    shape = (8, 9, 10)
    labels = dict(zip(("frame", "row", "column"), np.indices(shape), strict=True))
    likelihood = Clustered(Gaussian(sd=1.0), labels)
    free = {"mean": Parameter(linear=True)}
    mean = Problem(free, lambda mean: mean * jnp.ones(shape), likelihood, np.zeros(shape))
    rng, held = np.random.default_rng(6), 0
    for _ in range(200):
        e = rng.standard_normal(shape) + rng.standard_normal((8, 1, 1))
        e = e + rng.standard_normal((1, 9, 1)) + rng.standard_normal((1, 1, 10))
        found = fit(mean.with_data(3 + e), starts=1)
        low, high = found.estimates[0].interval_95
        held += low < 3 < high
    assert scipy.stats.binom.cdf(held, 200, 0.95) > 1e-3
    assert "Design effects of the residuals by level: frame" in found.findings[1]
    with pytest.raises(InputError, match="at least one level"):
        Clustered(Gaussian(sd=1.0), {})
    with pytest.raises(InputError, match=r"labels of shape \(3,\) do not fit"):
        fit(
            Problem(
                free,
                lambda mean: mean * jnp.ones(4),
                Clustered(Gaussian(sd=1.0), {"a": np.arange(3)}),
                np.zeros(4),
            )
        )
