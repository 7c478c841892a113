"""Tests parameters found in closed form because the prediction is linear in them, against the full
search, NumPy's and SciPy's linear fits, and for optima that a search would need a start for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from fitting import Clustered, Gaussian, Normal, Parameter, Problem, StudentT, fit, fit_map
from fitting.inference.separable import amplitudes
from jaxvision.errors import InputError

TIME = np.linspace(0.0, 3.0, 60)
NOISE = np.random.default_rng(2).standard_normal(60)


def decays(first, second, base, rate, faster, inputs):
    return base + first * jnp.exp(-rate * inputs) + second * jnp.exp(-faster * inputs)


def lobe(diffuse, specular, exponent, inputs):
    return diffuse * jnp.cos(inputs) + specular * jnp.cos(inputs) ** exponent


RATES = {"rate": Parameter(lower=0.1, upper=1.5), "faster": Parameter(lower=2, upper=20)}
EXPONENT = {"exponent": Parameter(lower=1, upper=300, transform="log")}
GLOSSY = (0.6, 0.4, 30.0)
CASES = {
    "free": (decays, ("first", "second", "base"), RATES, {}, (1.0, 2.0, 0.3, 0.7, 6.0)),
    "at least 0": (lobe, ("diffuse", "specular"), EXPONENT, {"lower": 0}, GLOSSY),
    "prior": (
        lobe,
        ("diffuse", "specular"),
        EXPONENT,
        {"prior": Normal(0.5, 0.02)},
        (0.6, 0.4, 30.0),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", [Gaussian(sd=0.01), StudentT(scale=0.01, dof=5.0)])
@pytest.mark.parametrize("case", CASES)
def test_a_fit_equals_the_full_search(case, likelihood):
    """The full search starts from the true values."""
    predict, linear, others, how, truth = CASES[case]
    inputs = TIME / 2
    data = np.asarray(predict(*truth, inputs)) + 0.01 * NOISE
    free = {name: Parameter(linear=True, **how) for name in linear} | others
    found = fit(Problem(free, predict, likelihood, data, inputs=inputs), starts=4)
    plain = {name: Parameter(**how) for name in linear} | others
    names = [*linear, *others]
    full = fit(
        Problem(plain, predict, likelihood, data, inputs=inputs),
        start=dict(zip(names, truth, strict=True)),
    )
    assert found.converged
    sd = np.sqrt(np.diagonal(full.posterior.covariance))
    shift = found.optimum.vector - full.optimum.vector
    assert np.max(np.abs(shift) / sd) < 1e-3
    scaled = (found.posterior.covariance - full.posterior.covariance) / np.outer(sd, sd)
    assert np.max(np.abs(scaled)) < 1e-3
    assert abs(found.misfit.chi_square - full.misfit.chi_square) < 1e-3


def test_a_fit_of_only_linear_parameters_equals_numpys():
    design = np.stack([np.ones(60), TIME, TIME**2])
    data = [1.0, -2.0, 0.5] @ design + 0.1 * NOISE
    free = {"c": Parameter(shape=(3,), linear=True)}
    found = fit(Problem(free, lambda c: c @ design, Gaussian(sd=0.1), data))
    covariance = 0.01 * np.linalg.inv(design @ design.T)
    np.testing.assert_allclose(found.values["c"], np.linalg.lstsq(design.T, data)[0], rtol=1e-9)
    np.testing.assert_allclose(found.posterior.covariance, covariance, rtol=1e-7)


@pytest.mark.slow
def test_a_frequency_needs_neither_start_nor_amplitudes():
    """Between 0.2 and 40 Hz the cost has some hundred minima."""

    def wave(sine, cosine, base, frequency):
        phase = 2 * jnp.pi * frequency * TIME
        return base + sine * jnp.sin(phase) + cosine * jnp.cos(phase)

    data = np.asarray(wave(0.3, -0.4, 5.0, 7.3)) + 0.2 * NOISE
    amplitude = Parameter(linear=True)
    free = {"sine": amplitude, "cosine": amplitude, "base": amplitude}
    free["frequency"] = Parameter(unit="Hz", lower=0.2, upper=9.5)
    found = fit(Problem(free, wave, Gaussian(sd=0.2), data))
    assert found.converged
    assert abs(found.values["frequency"] - 7.3) < 4 * found.estimates[3].standard_error
    local = scipy.optimize.least_squares(lambda p: wave(*p) - data, [0.3, -0.4, 5.0, 8.3])
    assert 2 * local.cost / 0.04 > found.misfit.chi_square + 20


@pytest.mark.parametrize("signed", [(True,) * 3, (True, False, True), (False,) * 3, (True,) * 12])
@pytest.mark.sweep
def test_amplitudes_equal_scipys(signed):
    rng = np.random.default_rng(len(signed) + sum(signed))
    lower = np.where(signed, 0, -np.inf)
    for _ in range(20):
        design, y = rng.standard_normal((30, len(signed))), rng.standard_normal(30)
        expected = scipy.optimize.lsq_linear(design, y, (lower, np.inf), tol=1e-14).x
        got = amplitudes(jnp.asarray(design.T @ design), jnp.asarray(design.T @ y), signed)
        np.testing.assert_allclose(got, expected, atol=1e-6)


@pytest.mark.slow
def test_shared_errors_of_groups_widen_it_equally():
    """The sandwich covariance of a line through groups with a common offset equals the full
    search's."""
    groups = np.repeat(np.arange(12), 5)
    data = 1 + 2 * TIME + 0.1 * NOISE + 0.2 * np.random.default_rng(3).standard_normal(12)[groups]

    def line(a, b):
        return a + b * TIME

    errors = []
    for one in (Parameter(linear=True), Parameter(start=0.0)):
        likelihood = Clustered(Gaussian(sd=0.1), groups)
        found = fit(Problem({"a": one, "b": one}, line, likelihood, data))
        errors.append([estimate.standard_error for estimate in found.estimates])
    np.testing.assert_allclose(*errors, rtol=1e-3)


@pytest.mark.slow
def test_every_pixel_of_a_map_is_fitted_without_a_start():
    def pixel(a, b, rate):
        return a + b * jnp.exp(-rate * TIME)

    amplitude = Parameter(linear=True)
    free = {"a": amplitude, "b": amplitude, "rate": Parameter(lower=0.2, upper=8)}
    one = Problem(free, pixel, Gaussian(sd=0.01), np.zeros(60))
    truth = np.array([[0.5, -3.0, 900.0], [2.0, 70.0, -4.0], [0.7, 3.0, 1.5]])
    images = np.asarray(jax.vmap(pixel, 0, 1)(*truth)) + 0.01 * NOISE[:, None]
    maps = fit_map(one, images, starts=2)
    assert maps.converged.all()
    found = np.stack([maps.estimate[name] for name in free])
    sd = np.stack([maps.sd[name] for name in free])
    assert np.max(np.abs(found - truth) / sd) < 4


def test_nonlinear_parameters_are_refused():
    linear = Parameter(linear=True)
    squared = Problem({"a": linear}, lambda a: a**2 * TIME, Gaussian(sd=0.1), np.ones(60))
    with pytest.raises(InputError, match="predict is not linear in a"):
        fit(squared)
    product = Problem(
        {"a": linear, "b": linear}, lambda a, b: a * TIME + a * b, Gaussian(sd=0.1), TIME
    )
    with pytest.raises(InputError, match="predict is not linear in a, b"):
        fit(product)


@pytest.mark.parametrize("how", [{"lower": 1.0}, {"upper": 3.0}, {"transform": "log"}])
def test_other_bounds_of_a_linear_parameter_are_refused(how):
    with pytest.raises(InputError, match="a linear parameter is free or at least 0"):
        Parameter(linear=True, **how)


def test_with_an_unknown_noise_it_is_searched_like_others():
    free = {"a": Parameter(linear=True), "sd": Parameter(lower=0.01, upper=1)}
    problem = Problem(free, lambda a: a * TIME, Gaussian(sd="sd"), 2 * TIME + 0.1 * NOISE)
    with pytest.raises(InputError, match="Nothing says where to search for a"):
        fit(problem)
