"""Tests samplers of a problem against its posterior on a grid, and that invalid options are refused
at once."""

import re
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fitting import Emcee, Gaussian, Nuts, NutsOptions, Parameter, Problem, SamplingOptions, fit
from fitting.fits.solve import method_of
from jaxvision.errors import InputError

TIME = np.array([0.2, 0.6, 1.2, 2.0, 3.0])
DATA = np.array([2.7, 1.6, 1.1, 0.6, 0.1])
SD = 0.4


def decay(height, rate, inputs):
    return height * jnp.exp(-rate * inputs)


def problem():
    """Return a problem of few data, whose posterior is cut by a bound in one direction and skewed
    in the other."""
    free = {
        "height": Parameter(unit="V", lower=0, upper=4),
        "rate": Parameter(unit="s^-1", transform="log", lower=0.1, upper=10),
    }
    return Problem(free, decay, Gaussian(sd=SD), DATA, inputs=TIME)


def on_a_grid():
    """Return values and weights by name: the likelihood for flat height and ln rate, by NumPy."""
    middles = (np.arange(500) + 0.5) / 500
    height, rate = 4 * middles, 0.1 * 100**middles
    expected = height[:, None, None] * np.exp(-rate[:, None] * TIME)
    likelihood = np.exp(stats.norm.logpdf(DATA, expected, SD).sum(-1))
    weight = likelihood / likelihood.sum()
    return {"height": (height, weight.sum(1)), "rate": (rate, weight.sum(0))}


@pytest.mark.slow
@pytest.mark.parametrize(
    "posterior", [Emcee(walkers=64, block=300), Nuts(draws=1000)], ids=["emcee", "nuts"]
)
def test_draws_follow_the_posterior_on_a_grid(posterior):
    result = fit(problem(), starts=4, posterior=posterior, seed=1)
    assert result.converged
    assert result.posterior.missing_steps == 0
    assert result.posterior.method.lower() == type(posterior).__name__.lower()
    for name, (values, weight) in on_a_grid().items():
        mean = weight @ values
        sd = np.sqrt(weight @ (values - mean) ** 2)
        low, high = np.interp([0.16, 0.84], np.cumsum(weight), values)
        drawn = result.draws[name].ravel()
        assert abs(drawn.mean() - mean) < 0.1 * sd
        np.testing.assert_allclose(drawn.std(), sd, rtol=0.1)
        np.testing.assert_allclose(np.diff(np.quantile(drawn, [0.16, 0.84])), high - low, rtol=0.1)
    assert 0 < result.draws["height"].min() < result.draws["height"].max() < 4


@pytest.mark.slow
def test_a_short_chain_is_kept_and_reported_as_not_converged():
    options = Emcee(walkers=8, steps=40, block=40)
    result = fit(problem(), starts=4, posterior=options)
    assert not result.converged
    assert "NOT CONVERGED" in str(result)
    assert any("more steps are missing" in sentence for sentence in result.failures)
    assert result.draws["height"].size >= 8
    assert fit(problem(), starts=4).converged  # the optimum itself has converged


def test_progress_that_cannot_be_called_is_refused():
    for options in (Emcee, Nuts):
        with pytest.raises(InputError, match="progress = 3: give a function of"):
            options(progress=3)


@pytest.mark.parametrize(
    ("posterior", "sampling", "expected"),
    [
        ("hmc", None, r"posterior = 'hmc': use Laplace\(\), Emcee\(\) or Nuts\(\)"),
        (Emcee, None, r"posterior = <class .*Emcee'>: use Laplace"),
        ("nuts", Emcee(), "'nuts' does not go with Emcee"),
        ("laplace", Nuts(), "'laplace' does not go with Nuts"),
        (Emcee(), Emcee(), r"sampling: write posterior=Emcee\(...\)"),
    ],
)
def test_an_invalid_sampler_is_refused(posterior, sampling, expected):
    with pytest.raises(InputError, match=expected):
        fit(problem(), posterior=posterior, sampling=sampling)


@pytest.mark.parametrize(
    ("posterior", "sampling", "new"),
    [
        ("laplace", None, "Laplace()"),
        ("emcee", None, "Emcee()"),
        ("emcee", Emcee(walkers=8), "Emcee(...)"),
        ("nuts", Nuts(draws=20), "Nuts(...)"),
    ],
)
def test_names_of_posteriors_still_work_and_say_the_new_form(posterior, sampling, new):
    with pytest.warns(DeprecationWarning, match=re.escape(f"write posterior={new}.")):
        method = method_of(posterior, sampling=sampling)
    assert type(method).__name__ == new.partition("(")[0]
    assert sampling is None or method is sampling


def test_a_fit_takes_the_old_form_and_its_numbers():
    with pytest.warns(DeprecationWarning, match=r"write posterior=Laplace\(\)") as told:
        old = fit(problem(), starts=4, posterior="laplace")
    assert told[0].filename == __file__
    np.testing.assert_array_equal(old.posterior.draws, fit(problem(), starts=4).posterior.draws)


@pytest.mark.parametrize(
    ("old", "new", "given"),
    [(SamplingOptions, Emcee, {"walkers": 8}), (NutsOptions, Nuts, {"draws": 20})],
)
def test_options_of_samplers_are_deprecated_names_of_them(old, new, given):
    with pytest.warns(DeprecationWarning, match=rf"write {new.__name__}\(\.\.\.\)") as told:
        options = old(**given)
    assert told[0].filename == __file__
    assert isinstance(options, new)
    assert vars(options) == vars(new(**given))


def test_nuts_without_blackjax_is_refused_before_the_search(monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(InputError, match=r"pip install 'jaxvision-imaging\[nuts\]'"):
        fit(problem(), posterior=Nuts())
