"""Tests natural and unconstrained vectors: they are inverse to each other, bounds hold, and priors
are those stated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fitting.inference.parameters import (
    Parameter,
    ends,
    log_flat_slopes,
    log_prior,
    names,
    natural_slopes,
    prior_values,
    scalars,
    to_natural,
    to_unconstrained,
)
from fitting.inference.priors import Gamma, HalfNormal, LogNormal, Normal, Uniform
from jaxvision.errors import InputError

SPACE = (
    Parameter("offset", symbol="o", unit="DN"),
    Parameter("gain", symbol="K", unit="DN/e-", transform="log"),
    Parameter("albedo", symbol="a", unit="1", lower=0.0, upper=2.0),
    Parameter("height", unit="m", lower=-1.0),
    Parameter("depth", unit="m", upper=3.0),
    Parameter("exponent", transform="log", lower=1.0, upper=1e3),
    Parameter("at_least", transform="log", lower=2.0),
    Parameter("ratio", transform="log", upper=5.0),
)
NATURAL = [
    [-3.0, 1e-6, 1e-9, -0.9, -1e3, 1.01, 2.01, 1e-4],
    [0.0, 1.0, 1.0, 0.0, 0.0, 30.0, 10.0, 1.0],
    [1e4, 1e6, 1.999, 1e4, 2.999, 999.0, 1e3, 4.99],
]


def test_round_trip_over_the_whole_range():
    natural = jnp.array(NATURAL)
    back = to_natural(SPACE, to_unconstrained(SPACE, natural))
    np.testing.assert_allclose(back, natural, rtol=1e-9)


def test_no_vector_leaves_the_bounds():
    for size in (3.0, 40.0, 600.0):
        natural = np.asarray(to_natural(SPACE, jnp.array([[-size], [size]]) * jnp.ones((2, 8))))
        lower, upper = (np.array(end) for end in zip(*map(ends, SPACE), strict=True))
        assert (natural >= lower).all()
        assert (natural <= upper).all()


@pytest.mark.slow
def test_derivatives_in_numpy_equal_jaxs():
    """Checked are natural values, and the density that is flat in the natural value."""
    places = np.linspace(-3, 3, 16).reshape(2, 8)
    for u, slope, bend, first, second in zip(
        places, *natural_slopes(SPACE, places), *log_flat_slopes(SPACE, places), strict=True
    ):
        ones = jnp.ones(8)
        expected, curved = jax.jvp(
            lambda u, ones=ones: jax.jvp(lambda u: to_natural(SPACE, u), (u,), (ones,))[1],
            (jnp.asarray(u),),
            (ones,),
        )
        np.testing.assert_allclose(slope, expected, rtol=1e-12)
        np.testing.assert_allclose(bend, curved / expected, rtol=1e-9, atol=1e-12)
        density = lambda u: log_prior(SPACE, u)  # noqa: E731
        np.testing.assert_allclose(first, jax.grad(density)(jnp.asarray(u)), atol=1e-12)
        np.testing.assert_allclose(np.diag(second), jax.hessian(density)(u), atol=1e-12)


@pytest.mark.slow
def test_gradient_is_finite_far_out():
    jacobian = jax.jacobian(lambda v: to_natural(SPACE[:3], v))(jnp.array([1e3, 300.0, 300.0]))
    assert np.isfinite(jacobian).all()


PRIORS = [
    (Normal(1.0, 2.0), stats.norm(1.0, 2.0)),
    (LogNormal(3.0, 0.4), stats.lognorm(0.4, scale=3.0)),
    (Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
    (HalfNormal(1.5), stats.halfnorm(scale=1.5)),
    (Gamma(2.5, 0.7), stats.gamma(2.5, scale=0.7)),
]


@pytest.mark.parametrize(("prior", "reference"), PRIORS, ids=lambda p: type(p).__name__)
def test_priors_against_scipy(prior, reference):
    p = np.array([0.001, 0.2, 0.5, 0.97])
    x = reference.ppf(p)
    np.testing.assert_allclose(prior.quantile(p), x, rtol=1e-10)
    np.testing.assert_allclose(prior.log_density(jnp.asarray(x)), reference.logpdf(x), rtol=1e-10)
    outside = np.array([-1e3])
    np.testing.assert_array_equal(
        prior.log_density(jnp.asarray(outside)), reference.logpdf(outside)
    )


@pytest.mark.parametrize(
    ("parameter", "truth"),
    [
        (Parameter("x", prior=Normal(1.0, 2.0)), stats.norm(1.0, 2.0)),
        (Parameter("x", prior=Gamma(2.5, 0.7)), stats.gamma(2.5, scale=0.7)),
        (Parameter("x", transform="log", prior=HalfNormal(1.5)), stats.halfnorm(scale=1.5)),
        (
            Parameter("x", lower=0.5, upper=4.0, prior=Normal(1.0, 2.0)),
            stats.truncnorm(-0.25, 1.5, 1.0, 2.0),
        ),
        (Parameter("x", lower=-1.0, upper=3.0), stats.uniform(-1.0, 4.0)),
        (Parameter("x", transform="log", lower=0.1, upper=9.0), stats.loguniform(0.1, 9.0)),
    ],
)
def test_the_density_of_the_vector_is_the_prior_with_its_jacobian(parameter, truth):
    """By quadrature in u, probabilities of the natural value are right for every transform."""
    u = np.linspace(-60, 60, 400_001)[:, None]
    logs = np.asarray(jax.jit(lambda u: log_prior((parameter,), u))(u))
    weight = np.exp(logs - logs.max())
    x = np.asarray(to_natural((parameter,), jnp.asarray(u)))[:, 0]
    for p in (0.1, 0.5, 0.9):
        below = weight[x < truth.ppf(p)].sum() / weight.sum()
        np.testing.assert_allclose(below, p, atol=2e-3)
    known = prior_values(parameter)
    np.testing.assert_allclose(known, truth.ppf((np.arange(400) + 0.5) / 400), rtol=0.01, atol=2e-3)


def test_a_parameter_that_is_flat_is_not_traced():
    text = str(jax.make_jaxpr(lambda v: log_prior(SPACE[:2], v))(jnp.zeros(2)))
    assert "mul" not in text
    assert "sub" not in text


def test_an_array_parameter_equals_its_numbers():
    position = Parameter("lamp.position", unit="m", lower=(-1.0, -2.0, 0.0), upper=5.0)
    numbers = scalars(position, (3,))
    assert names(numbers) == ("lamp.position[0]", "lamp.position[1]", "lamp.position[2]")
    assert [p.symbol for p in numbers] == ["position[0]", "position[1]", "position[2]"]
    assert [ends(p) for p in numbers] == [(-1.0, 5.0), (-2.0, 5.0), (0.0, 5.0)]


def test_names_keep_their_order():
    assert names(SPACE[:3]) == ("offset", "gain", "albedo")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"lower": 2.0, "upper": 1.0}, "not below upper"),
        ({"lower": (0.0, 2.0), "upper": 1.0}, "not below upper"),
        ({"transform": "log", "upper": -1.0}, "a log parameter is positive"),
        ({"transform": "log", "lower": -1.0}, "a log parameter is positive, lower is -1.0"),
        ({"transform": "log", "start": 0.0}, "start 0.0 lies outside its range"),
        ({"upper": -1.0, "prior": HalfNormal(1.0)}, "leaves nothing within the bounds"),
        ({"lower": 5.0, "prior": Normal(2.0, 0.1)}, "leaves nothing within the bounds"),
        ({"lower": 0.0, "upper": 1.0, "start": 2.0}, "start 2.0 lies outside its range, 0.0 to 1"),
        ({"start": np.nan}, "start is nan"),
        ({"lower": (0.0, 1.0), "upper": (1.0, 2.0, 3.0)}, "different shapes"),
    ],
)
def test_contradictory_parameters_are_refused(options, expected):
    with pytest.raises(InputError, match=f"^x: .*{expected}"):
        Parameter("x", symbol="x", unit="1", **options)


@pytest.mark.parametrize(
    ("bounds", "prior", "law"),
    [
        ((0.0, 1.0), Normal(0.0, 1e6), stats.truncnorm(0, 1e-6, 0, 1e6)),
        ((1.0, np.inf), Normal(0.0, 0.25), stats.truncnorm(4, np.inf, 0, 0.25)),
        ((-np.inf, np.inf), Gamma(2.0, 3.0), stats.gamma(2.0, scale=3.0)),
    ],
)
def test_a_prior_within_bounds_is_truncated(bounds, prior, law):
    found = prior_values(Parameter("x", lower=bounds[0], upper=bounds[1], prior=prior))
    assert found is not None
    np.testing.assert_allclose(found, law.ppf((np.arange(400) + 0.5) / 400), rtol=1e-5)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Normal(0.0, -1.0),
        lambda: LogNormal(-1.0, 1.0),
        lambda: Uniform(2.0, 1.0),
        lambda: HalfNormal(np.inf),
        lambda: Gamma(0.0, 1.0),
    ],
)
def test_impossible_priors_are_refused(wrong):
    with pytest.raises(InputError, match=r"positive and finite|two finite ends"):
        wrong()
