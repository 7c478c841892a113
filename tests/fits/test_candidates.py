"""Tests optional terms, which stay only if the data need them: thresholds against SciPy, likelihood
ratios against NumPy's regression, and how often an absent term stays."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fitting import (
    Candidate,
    Clustered,
    Emcee,
    Gaussian,
    Parameter,
    Problem,
    check,
    fit,
    fit_map,
)
from fitting.inference.candidates import price
from fitting.inference.search import search
from jaxvision.errors import InputError

X = np.linspace(-1.0, 1.0, 80)
NOISE = np.random.default_rng(0).standard_normal(80)
LINEAR = Parameter(linear=True)


def polynomial(offset, slope, bend, cubic, inputs):
    return offset + slope * inputs + bend * inputs**2 + cubic * inputs**3


def problem(data, *, sd=0.1, **others):
    free = {
        "offset": LINEAR,
        "slope": LINEAR,
        "bend": Candidate(LINEAR),
        "cubic": Candidate(LINEAR),
    }
    return Problem(free | others, polynomial, Gaussian(sd=sd), data, inputs=X)


@pytest.mark.slow
def test_a_term_stays_by_its_ratio_in_numpys_regression():
    data = 1 + X + 0.4 * X**2 + 0.1 * NOISE
    found = fit(problem(data))
    kept = {one.name: one.kept for one in found.choices}
    assert kept == {"bend": True, "cubic": False}
    assert found.values["cubic"] == 0
    ratios = {}
    for powers in (4, 3):  # the cubic is dropped first, and the bend is judged without it
        design = X[:, None] ** np.arange(powers) / 0.1
        covariance = np.linalg.inv(design.T @ design)
        best = covariance @ design.T @ data / 0.1
        ratios[powers] = abs(best[-1]) / np.sqrt(covariance[-1, -1])
    got = {one.name: one.ratio for one in found.choices}
    np.testing.assert_allclose([got["cubic"], got["bend"]], [ratios[4], ratios[3]], rtol=1e-5)
    np.testing.assert_allclose(found.choices[0].needed ** 2, stats.chi2.isf(0.01, 1), rtol=1e-9)
    plain = fit(problem(data, bend=LINEAR, cubic=0.0))  # the same problem without optional terms
    for one, other in zip(found.estimates, plain.estimates, strict=True):
        np.testing.assert_allclose(one.value, other.value, rtol=1e-9)
        np.testing.assert_allclose(one.standard_error, other.standard_error, rtol=1e-9)
    said = [one for one in found.findings if one.startswith("cubic is left out")]
    assert len(said) == 1
    assert said[0].endswith("are needed.")


@pytest.mark.slow
def test_a_term_stays_if_one_that_requires_it_stays():
    """The data have a bend and no line. The line has no evidence, and stays because the bend
    requires it."""
    data = 1 + 0.5 * X**2 + 0.1 * NOISE
    named = {"slope": Candidate(LINEAR), "bend": Candidate(LINEAR, requires="slope")}
    found = fit(problem(data, cubic=0.0, **named))
    assert {one.name: one.kept for one in found.choices} == {"slope": True, "bend": True}
    straight = fit(problem(1 + 0.1 * NOISE, cubic=0.0, **named))
    assert [(one.name, one.kept) for one in straight.choices] == [("bend", False), ("slope", False)]


@pytest.mark.slow
@pytest.mark.parametrize("side", ["above", "below"])
def test_evidence_on_the_wrong_side_is_none(side):
    data = 1 + X - 0.4 * X**2 + 0.1 * NOISE
    found = fit(problem(data, cubic=0.0, bend=Candidate(LINEAR, side=side)))
    assert found.choices[0].kept == (side == "below")


def test_prices_are_those_of_the_distributions():
    assert price(10_000) == np.log(10_000)
    np.testing.assert_allclose(price(10), stats.chi2.isf(0.01, 1))
    np.testing.assert_allclose(price(10, chance=1.0), np.log(10))
    np.testing.assert_allclose(price(10, numbers=3), stats.chi2.isf(0.01, 3))
    np.testing.assert_allclose(price(10, freedom=5), stats.t.isf(0.005, 5) ** 2)
    np.testing.assert_allclose(price(10, numbers=3, freedom=5), 3 * stats.f.isf(0.01, 3, 5))
    # F-test for 10 lights whose scatter is fitted with 3 terms, times 10 / 7.
    np.testing.assert_allclose(
        price(10, scatter=(10, 3)), stats.f.isf(0.01, 1, 7) * 10 / 7, rtol=1e-9
    )


@pytest.mark.slow
def test_a_scale_without_evidence_is_left_out():
    """The width is positive and absent at 0; the exponent is absent at a limit, where its lobe
    vanishes."""

    def peak(height, width, inputs):
        return height * jnp.exp(-(inputs**2) / (2 * (0.3**2 + width**2)))

    width = Candidate(Parameter(transform="log", lower=1e-3, upper=1))
    for true, kept in ((0.0, False), (0.3, True)):
        data = peak(1.0, true, X) + 0.05 * NOISE
        found = fit(
            Problem({"height": LINEAR, "width": width}, peak, Gaussian(0.05), data, inputs=X)
        )
        assert found.choices[0].kept == kept


@pytest.mark.slow
def test_a_term_of_groups_is_judged_by_their_errors():
    """The covariate is constant within 8 groups that share errors."""
    groups = np.repeat(np.arange(8), 10)
    rng = np.random.default_rng(8)
    covariate = rng.standard_normal(8)[groups]
    data = 1 + 0.1 * NOISE + (0.3 * rng.standard_normal(8))[groups]
    free = {"mean": LINEAR, "effect": Candidate(LINEAR)}
    kept = []
    for likelihood in (Gaussian(sd=0.1), Clustered(Gaussian(sd=0.1), groups)):
        stated = Problem(free, lambda mean, effect: mean + effect * covariate, likelihood, data)
        kept.append(fit(stated).choices[0].kept)
    assert kept == [True, False]


@pytest.mark.slow
def test_a_term_that_is_absent_stays_once_in_a_hundred_fits():
    rng = np.random.default_rng(4)
    whole, stays = problem(X), 0
    for _ in range(300):
        found = fit(whole.with_data(1 + X + 0.1 * rng.standard_normal(80)), starts=1)
        stays += any(one.kept for one in found.choices)
    assert stats.binom.cdf(stays - 1, 300, 0.02) < 0.999  # for two terms


@pytest.mark.slow
def test_an_array_is_kept_or_dropped_as_a_whole():
    patterns = np.random.default_rng(1).standard_normal((3, 80))
    free = {"offset": LINEAR, "c": Candidate(Parameter(shape=(3,), linear=True))}
    for size in (0.0, 0.1):
        data = 1 + size * patterns.sum(axis=0) + 0.1 * NOISE
        stated = Problem(free, lambda offset, c: offset + c @ patterns, Gaussian(0.1), data)
        found = fit(stated)
        assert found.choices[0].kept == (size > 0)
        assert found.values["c"].shape == (3,)
        np.testing.assert_allclose(found.choices[0].needed ** 2, 3 * np.log(80))


@pytest.mark.slow
def test_a_chain_continues_with_the_chosen_terms():
    data = 1 + X + 0.4 * X**2 + 0.1 * NOISE
    begun = fit(problem(data), starts=2, posterior=Emcee(8, steps=100))
    further = fit(problem(data), starts=2, posterior=Emcee(8, steps=200), after=begun)
    assert further.choices == begun.choices
    assert further.posterior.steps == 200


@pytest.mark.slow
def test_a_check_counts_the_fits_in_which_a_term_stays():
    truth = {"offset": 1.0, "slope": 1.0, "bend": 0.0, "cubic": 0.0}
    found = check(problem(X), simulations=5, truth=truth)
    assert np.isfinite(found.places[:, :2]).all()
    assert np.isnan(found.places[:, 3]).all()


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: Candidate(3.0), "3.0 is no Parameter"),
        (lambda: Candidate(LINEAR, chance=0.0), "chance = 0.0: use a number above 0"),
        (lambda: Candidate(LINEAR, absent=np.nan), "absent is NaN"),
        (lambda: Candidate(LINEAR, side="left"), "side = 'left': use"),
        (lambda: problem(X, bend=Candidate(LINEAR, requires="slope")), "'slope', which stays any"),
        (lambda: problem(X, bend=Candidate(LINEAR, requires="slop")), "'slop', which is no cand"),
        (lambda: problem(X).without("slope"), "no candidate 'slope'"),
        (lambda: fit_map(problem(X), X[:, None]), "fit_map has no candidates"),
        (
            lambda: Problem({"a": Candidate(LINEAR)}, lambda a: a * X, Gaussian(1.0), X),
            "Nothing but candidates",
        ),
    ],
)
def test_invalid_candidates_are_refused(make, expected):
    with pytest.raises(InputError, match=expected):
        make()


class Spread(eqx.Module):
    """The prediction of a straight line for data with a known variance."""

    mean: jax.Array
    variance: jax.Array


class OfItsOwnVariance(eqx.Module):
    least_squares = False
    surrogate = None

    def log_density(self, prediction, data):
        away = (data - prediction.mean) ** 2 / prediction.variance
        return -(away + jnp.log(prediction.variance)) / 2

    def residuals(self, prediction, data, chance):
        return (data - prediction.mean) / jnp.sqrt(prediction.variance)

    def draw(self, key, prediction):
        noise = jax.random.normal(key, prediction.mean.shape)
        return prediction.mean + jnp.sqrt(prediction.variance) * noise


def spread_of_a_line(slope, bend, scatter, inputs):
    return Spread(slope * inputs + bend * inputs**2, 0.04 + scatter**2 * inputs**2)


@pytest.mark.slow
def test_a_prediction_is_a_record_and_absent_terms_need_no_program_of_their_own():
    rng, x = np.random.default_rng(3), np.linspace(0.5, 4.0, 300)
    data = 2 * x + np.sqrt(0.04 + 0.09 * x**2) * rng.standard_normal(300)
    own = {"slope": Parameter(start=1.0), "bend": Candidate(Parameter(start=0.1))}
    own["scatter"] = Candidate(Parameter(transform="log", start=0.1), chance=1)
    problem = Problem(own, spread_of_a_line, OfItsOwnVariance(), data, inputs=x)
    start = np.array([[1.0, 0.0, np.log(0.1)]])
    for without in (["bend"], ["scatter"], ["scatter", "bend"]):
        apart, kept = problem, [i for i, p in enumerate(problem.space) if p.name not in without]
        for name in without:
            apart = apart.without(name)
        one, other = search(problem, start, without=without), search(apart, start[:, kept])
        error = 1 / np.sqrt(np.diagonal(other.information))
        assert np.all(np.abs(one.vector - other.vector) < 1e-2 * error)
        np.testing.assert_allclose(one.information, other.information, rtol=1e-2)
    found = fit(problem, start={"slope": 1.0, "bend": 0.1, "scatter": 0.1}, misfit="inflate")
    assert {one.name: one.kept for one in found.choices} == {"bend": False, "scatter": True}
    assert abs(float(found.values["scatter"]) - 0.3) < 0.06
