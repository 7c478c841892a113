"""Tests NUTS against a Gaussian in closed form and against emcee on a banana-shaped density, the
continuation of chains, and the optional dependency."""

import sys
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fitting.inference.convergence import effective_draws
from fitting.inference.nuts import Nuts, nuts
from fitting.inference.parameters import Parameter
from fitting.inference.posterior import estimates
from fitting.inference.trust import convergence_in_words, is_trusted
from jaxvision.errors import InputError

COVARIANCE = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.3], [0.0, 0.3, 2.0]])
PRECISION = jnp.asarray(np.linalg.inv(COVARIANCE))
SPACE = (
    Parameter("offset", symbol="o", unit="DN"),
    Parameter("gain", symbol="K", unit="DN/e-", transform="log"),
    Parameter("dark", symbol="d", unit="e-"),
)


def twisted(vector, args):
    """Return the log density of a Gaussian whose second coordinate is bent by twist (x0^2 - 1): a
    banana."""
    precision, twist = args
    bent = vector.at[1].add(-twist * (vector[0] ** 2 - 1))
    return -bent @ precision @ bent / 2


def run(twist, *, seed=0, after=None, **options):
    return nuts(
        *(twisted, SPACE, jnp.zeros(3), COVARIANCE, (PRECISION, jnp.asarray(twist))),
        options=Nuts(**options),
        seed=seed,
        after=after,
    )


@pytest.fixture(scope="module")
def drawn():
    return run(0.0, draws=1000, seed=1)


def unconstrained(posterior):
    vectors = posterior.samples.copy()
    vectors[:, 1] = np.log(vectors[:, 1])
    return vectors


def test_nuts_samples_the_gaussian(drawn):
    """Means, variances and the lognormal's interval are within five of their standard errors."""
    assert (drawn.method, drawn.draws.shape) == ("NUTS", (4, 1000, 3))
    worth = drawn.samples.shape[0] / drawn.tau.max()
    vectors = unconstrained(drawn)
    np.testing.assert_allclose(vectors.mean(0), 0, atol=5 * np.sqrt(2 / worth))
    squares = (vectors**2).reshape(4, 1000, 3)
    worth = min(effective_draws(squares[:, :, i]) for i in range(3))
    np.testing.assert_allclose(np.cov(vectors.T), COVARIANCE, atol=5 * 2 * np.sqrt(2 / worth))
    gain = estimates(drawn)[1]
    assert gain.method == "NUTS"
    np.testing.assert_allclose(gain.interval_68, stats.lognorm(1.0).interval(0.68), rtol=0.15)
    assert drawn.missing_steps == 0
    assert drawn.divergences == 0
    assert drawn.r_hat.max() < 1.01
    assert 0.6 < drawn.acceptance < 0.95
    assert "4 chains of 1000 draws" in convergence_in_words(drawn)


@pytest.mark.parametrize(("divergences", "trusted"), [(4, True), (5, False)])
def test_trajectories_that_diverge_are_not_trusted(drawn, divergences, trusted):
    """More than one divergence in a thousand, of 4000 draws, is too many."""
    told = replace(drawn, divergences=divergences)
    assert is_trusted(told) == trusted
    assert ("a higher acceptance=" in convergence_in_words(told)) != trusted


def assert_same_quantiles(a, b, worth):
    """Check that the columns of two samples have equal quantiles within five standard errors, given
    their numbers of independent draws."""
    error = 5 * np.sqrt(sum(1 / n for n in worth))
    for share in (0.16, 0.5, 0.84):
        within = np.mean(a < np.quantile(b, share, axis=0), axis=0)
        np.testing.assert_allclose(within, share, atol=error * np.sqrt(share * (1 - share)))


TWIST = 0.7


@pytest.fixture(scope="module")
def banana():
    return run(TWIST, draws=1000, seed=3)


def test_nuts_samples_a_banana(banana):
    """The reference is a Gaussian sample, bent."""
    exact = np.random.default_rng(0).multivariate_normal(np.zeros(3), COVARIANCE, 100_000)
    exact[:, 1] += TWIST * (exact[:, 0] ** 2 - 1)
    worth = banana.samples.shape[0] / banana.tau.max()
    assert_same_quantiles(unconstrained(banana), exact, (worth, len(exact)))


@pytest.mark.slow
def test_the_step_adapts_to_the_requested_acceptance():
    assert 0.9 < run(TWIST, draws=300, seed=3, acceptance=0.95).acceptance < 0.99


def test_continued_chains_equal_uninterrupted_ones(drawn, tmp_path):
    """This holds in memory and from a checkpoint, for any size of blocks."""
    short = run(0.0, draws=30, seed=1)
    assert "more draws of each chain are missing" in convergence_in_words(short)
    assert short.missing_steps > 0
    run(0.0, draws=30, seed=1, checkpoint=tmp_path)
    done = []
    for whole in (
        run(0.0, draws=1000, seed=1, after=short, progress=lambda *at: done.append(at)),
        run(0.0, draws=1000, seed=1, checkpoint=tmp_path),
    ):
        np.testing.assert_array_equal(whole.draws, drawn.draws)
        np.testing.assert_array_equal(whole.log_density, drawn.log_density)
    assert (done[0], done[-1]) == ((400, 1300), (1300, 1300))
    with pytest.raises(InputError, match="another run"):
        run(0.5, draws=1000, seed=1, after=short)


def half_line(vector, rate):
    return jnp.where(vector[0] > 0, -rate * vector[0], jnp.nan)


@pytest.mark.slow
def test_nan_counts_as_impossible_and_starts_avoid_it():
    space = SPACE[:1]
    options = Nuts(draws=500)
    posterior = nuts(half_line, space, jnp.ones(1), np.eye(1), jnp.asarray(1.0), options=options)
    assert posterior.samples.min() > 0
    np.testing.assert_allclose(posterior.samples.mean(), 1.0, atol=0.3)
    with pytest.raises(InputError, match="0 or NaN at the mode"):
        nuts(half_line, space, -jnp.ones(1), 1e-6 * np.eye(1), jnp.asarray(1.0))


def test_invalid_options_of_nuts_are_refused(monkeypatch):
    with pytest.raises(InputError, match="draws = 3: give a whole number of at least 10"):
        run(0.0, draws=3)
    with pytest.raises(InputError, match=r"acceptance = 1\.0: use a number between 0 and 1"):
        Nuts(acceptance=1.0)
    with pytest.raises(InputError, match="acceptance = None: use a number"):
        Nuts(acceptance=None)
    with pytest.raises(InputError, match=r"chains = 2\.5: give a whole number"):
        Nuts(chains=2.5)
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(InputError, match=r"pip install 'jaxvision-imaging\[nuts\]'"):
        run(0.0)
