"""Natural and unconstrained vectors: inverse of each other, bounds kept, priors as written."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fitting.inference.parameters import (
    Parameter,
    log_prior,
    names,
    to_natural,
    to_unconstrained,
)

SPACE = (
    Parameter("offset", symbol="o", unit="DN"),
    Parameter("gain", symbol="K", unit="DN/e-", transform="log", lower=0.0),
    Parameter("albedo", symbol="a", unit="1", transform="logit", lower=0.0, upper=2.0),
)


def test_round_trip_over_the_whole_range():
    natural = jnp.array([[-3.0, 1e-6, 1e-9], [0.0, 1.0, 1.0], [1e4, 1e6, 2 - 1e-9]])
    back = to_natural(SPACE, to_unconstrained(SPACE, natural))
    np.testing.assert_allclose(back, natural, rtol=1e-9)


def test_any_vector_lands_inside_the_bounds():
    natural = to_natural(SPACE, jnp.array([[-40.0, -40.0, -40.0], [40.0, 40.0, 30.0]]))
    lower, upper = ([getattr(p, end) for p in SPACE] for end in ("lower", "upper"))
    assert (np.asarray(natural) >= lower).all()
    assert (np.asarray(natural) <= upper).all()


def test_gradient_is_finite_far_out():
    jacobian = jax.jacobian(lambda v: to_natural(SPACE, v))(jnp.array([1e3, 300.0, 300.0]))
    assert np.isfinite(jacobian).all()


def test_log_prior_is_the_gaussian_on_the_unconstrained_scale():
    space = (
        Parameter("a", symbol="a", unit="1"),
        Parameter("b", symbol="b", unit="1", transform="log", prior_mean=0.5, prior_sd=2.0),
    )
    at = [jnp.array([9.0, 3.0]), jnp.array([-7.0, 1.0])]
    difference = log_prior(space, at[0]) - log_prior(space, at[1])
    expected = stats.norm.logpdf(3.0, 0.5, 2.0) - stats.norm.logpdf(1.0, 0.5, 2.0)
    np.testing.assert_allclose(difference, expected, rtol=1e-12)


def test_a_parameter_without_prior_is_not_traced():
    text = str(jax.make_jaxpr(lambda v: log_prior(SPACE, v))(jnp.zeros(3)))
    assert "mul" not in text
    assert "sub" not in text


def test_names_keep_their_order():
    assert names(SPACE) == ("offset", "gain", "albedo")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"lower": 2.0, "upper": 1.0}, "not below upper"),
        ({"transform": "logit", "lower": 0.0}, "two finite bounds"),
        ({"prior_sd": 0.0}, "prior_sd must be positive"),
    ],
)
def test_contradictory_parameters_are_refused(options, expected):
    with pytest.raises(ValueError, match=expected):
        Parameter("x", symbol="x", unit="1", **options)
