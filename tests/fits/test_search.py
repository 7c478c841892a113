"""Tests searches for the best fit under Student's t against SciPy started at the true values."""

import io
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize
from scipy import stats

from fitting import Gaussian, Parameter, Problem, StudentT, fit
from jaxvision.errors import InputError

PLACE = np.linspace(-5, 5, 150)
SD = 0.3
TRUTH = (8.0, 1.3, 0.6, 1.0)
DATA = (
    1
    + 8 * np.exp(-(((PLACE - 1.3) / 0.6) ** 2) / 2)
    + SD * np.random.default_rng(11).standard_t(4, 150)
)
FREE = {
    "height": Parameter(lower=0, upper=50),
    "centre": Parameter(lower=-5, upper=5),
    "width": Parameter(transform="log", lower=0.05, upper=5),
    "base": Parameter(lower=-5, upper=5),
}
SCALE = {"scale": Parameter(transform="log", lower=0.001, upper=20)}


def peak(height, centre, width, base, inputs):
    return base + height * jnp.exp(-(((inputs - centre) / width) ** 2) / 2)


def scipy_best(scale=None):
    """Return the maximum-likelihood estimate by Nelder and Mead's method from the true values."""

    def cost(p):
        height, centre, width, base = p[:4]
        expected = base + height * np.exp(-(((PLACE - centre) / width) ** 2) / 2)
        return -stats.t.logpdf(DATA, 4, expected, scale or np.exp(p[4])).sum()

    start = TRUTH if scale else (*TRUTH, np.log(SD))
    options = {"xatol": 1e-7, "fatol": 1e-9, "maxiter": 20_000}
    return scipy.optimize.minimize(cost, start, method="Nelder-Mead", options=options).x


@pytest.mark.slow
@pytest.mark.parametrize(
    "scale",
    [pytest.param(SD, id="known", marks=pytest.mark.slow), pytest.param(None, id="unknown")],
)
def test_a_peak_under_students_t_is_found_whatever_the_starts(scale):
    template = Problem(
        FREE if scale else FREE | SCALE, peak, StudentT(scale or "scale"), DATA, inputs=PLACE
    )
    best = scipy_best(scale)
    for seed in range(10):
        result = fit(template, seed=seed)
        assert result.converged
        found = np.array([float(result.values[name]) for name in FREE])
        # The mode of the unconstrained values differs by a small part of an error.
        errors = np.array([e.standard_error for e in result.estimates[:4]])
        assert (np.abs(found - best[:4]) < 0.05 * errors).all()


@pytest.mark.sweep
@pytest.mark.filterwarnings("ignore:JAXopt is no longer maintained")
@pytest.mark.parametrize("solver", ["Dogleg", "BFGS", "LBFGSB", "partial"])
def test_a_solver_of_optimistix_or_jaxopt_ends_where_the_default_does(solver):
    """The mode of a decay of 2 exp(-1.3 t) equals SciPy's."""
    time = np.linspace(0, 3, 40)
    data = 2 * np.exp(-1.3 * time) + 0.01 * np.random.default_rng(3).standard_normal(40)
    free = {"height": Parameter(start=1.0), "rate": Parameter(start=0.5)}
    problem = Problem(
        free, lambda height, rate: height * jnp.exp(-rate * time), Gaussian(0.01), data
    )
    import jaxopt

    if solver == "partial":
        how = partial(jaxopt.LBFGS, tol=1e-8)
    elif solver == "LBFGSB":
        how = jaxopt.LBFGSB
    else:
        how = getattr(optx, solver)(rtol=1e-8, atol=1e-8)
    found = fit(problem, starts=4, solver=how)
    expected = scipy.optimize.least_squares(
        lambda p: p[0] * np.exp(-p[1] * time) - data, [1.0, 0.5]
    ).x
    np.testing.assert_allclose([*found.values.values()], expected, rtol=1e-6)
    assert found.converged


def test_an_invalid_solver_is_refused():
    free = {"a": Parameter(start=0.0)}
    counted = Problem(free, lambda a: a * jnp.ones(4), StudentT(scale=1.0), np.zeros(4))
    with pytest.raises(InputError, match=r"Dogleg.* solves least squares, and StudentT is none"):
        fit(counted, solver=optx.Dogleg(rtol=1e-8, atol=1e-8))
    with pytest.raises(InputError, match=r"solver = 'lm': give a least-squares solver"):
        fit(counted, solver="lm")


def test_a_first_fit_compiles_few_programs():
    """There is one program for search, mode and the test of Laplace's approximation, and a few
    small ones."""
    compiled = []

    def listen(name, seconds, **_):
        if "backend_compile" in name:
            compiled.append(seconds)

    def decay(height, rate, inputs):
        return height * jnp.exp(-rate * inputs)

    free = {"height": Parameter(lower=0, upper=9), "rate": Parameter(lower=0, upper=9)}
    data = 2 * np.exp(-0.7 * (PLACE + 5)) + 0.01 * np.random.default_rng(0).standard_normal(150)
    problem = Problem(free, decay, Gaussian(0.01), data, inputs=PLACE + 5)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        found = fit(problem)
    finally:
        jax.monitoring.clear_event_listeners()
    assert found.converged
    assert len(compiled) <= 4


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_a_terminal_shows_the_progress_of_the_search(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream())
    monkeypatch.setenv("TERM", "xterm")
    free = {"a": Parameter(lower=0, upper=9)}
    fit(Problem(free, lambda a: a * jnp.ones(4), Gaussian(0.1), np.full(4, 2.0)), starts=2)
    assert ("searching from several starts" in sys.stderr.getvalue()) == (stream is Terminal)
