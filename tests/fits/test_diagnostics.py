"""Tests identifiability against the textbook variance inflation factor and against constructed
collinearity."""

import numpy as np
import pytest

from fitting.inference.diagnostics import identifiability
from fitting.inference.parameters import Parameter

SPACE = tuple(Parameter(name, symbol=name, unit="1") for name in ("gain", "gamma", "exponent"))


def design(correlation):
    rng = np.random.default_rng(0)
    a, b, c = rng.standard_normal((3, 400))
    return np.stack([a, correlation * a + np.sqrt(1 - correlation**2) * b, 50 * c], axis=1)


@pytest.mark.parametrize("correlation", [0.0, 0.9, 0.999])
def test_inflation_is_the_root_of_the_variance_inflation_factor(correlation):
    """VIF_i = 1 / (1 - R_i^2), with R_i^2 from regressing column i on the others without an
    intercept."""
    columns = design(correlation)
    judged = identifiability(SPACE, columns.T @ columns)
    for i in range(3):
        others = np.delete(columns, i, axis=1)
        residual = columns[:, i] - others @ np.linalg.lstsq(others, columns[:, i])[0]
        unexplained = residual @ residual / (columns[:, i] @ columns[:, i])
        np.testing.assert_allclose(judged.inflation[i], 1 / np.sqrt(unexplained), rtol=1e-6)
    assert judged.determined


def test_a_collinear_pair_is_named_and_a_good_design_is_not():
    assert identifiability(SPACE, design(0.1).T @ design(0.1)).sentences == ()
    (sentence,) = identifiability(SPACE, design(0.999).T @ design(0.999)).sentences
    assert "gain" in sentence
    assert "gamma" in sentence
    assert "exponent" not in sentence


def test_an_unidentifiable_direction_is_reported_and_not_inverted():
    columns = design(1.0)
    judged = identifiability(SPACE, columns.T @ columns)
    assert not judged.determined
    assert np.isinf(judged.inflation[:2]).all()
    assert np.isfinite(judged.inflation[2])
    assert "cannot distinguish gain and gamma" in judged.sentences[0]


@pytest.mark.parametrize("value", [0.0, np.nan, -1.0])
def test_a_parameter_without_influence_on_the_data(value):
    judged = identifiability(SPACE, np.diag([1.0, value, 2.0]))
    assert not judged.determined
    assert judged.sentences == ("The data say nothing about gamma.",)


def test_scaling_a_parameter_changes_nothing():
    gram = design(0.9).T @ design(0.9)
    scale = np.diag([1e6, 1e-6, 1.0])
    np.testing.assert_allclose(
        identifiability(SPACE, scale @ gram @ scale).inflation,
        identifiability(SPACE, gram).inflation,
        rtol=1e-6,
    )


@pytest.mark.parametrize(("error", "told"), [(0.003, False), (0.2, True)])
def test_collinearity_is_reported_where_it_matters(error, told):
    """A gain and an identity parameter at 5 have this relative error, 22 times larger than if the
    other were known."""
    space = (Parameter("gain", symbol="K", unit="1", transform="log"), SPACE[1])
    spread = np.array([1.0, 5.0]) * error
    covariance = np.outer(spread, spread) * np.array([[1, 0.999], [0.999, 1]])
    judged = identifiability(space, np.linalg.inv(covariance), vector=np.array([0.3, 5.0]))
    assert bool(judged.sentences) == told
    np.testing.assert_allclose(judged.inflation, (1 - 0.999**2) ** -0.5)
    for sentence in judged.sentences:
        assert "is known to 20 %, 22 times less well" in sentence


@pytest.mark.parametrize(("origin", "told"), [(1.7e9, False), (0.0, True)])
def test_a_line_over_dates_in_seconds_is_advised_to_shift_its_origin(origin, told):
    """With minutes since 1970 the condition number is 1e13. The same line is identifiable if time
    starts at 0."""
    seconds = origin + 60.0 * np.arange(30)
    columns = np.stack([seconds, np.ones(30)], axis=1) / 0.01
    judged = identifiability(SPACE[:2], columns.T @ columns)
    assert judged.determined == told
    assert told or "subtract a constant from them" in judged.sentences[0]
