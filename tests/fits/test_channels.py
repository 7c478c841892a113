"""Tests problems of several channels, with separate and shared parameters."""

import jax.numpy as jnp
import numpy as np
import pytest

from fitting import Candidate, Clustered, Gaussian, Parameter, Problem, Tied, fit, stack_channels
from jaxvision.errors import InputError

TIME = np.linspace(0.0, 2.0, 40)
HEIGHTS = np.array([1.0, 2.0, 5.0])
NOISE = np.random.default_rng(3).standard_normal((40, 3))
DATA = np.exp(-1.5 * TIME)[:, None] * HEIGHTS + 0.01 * NOISE
FREE = {"height": Parameter(lower=0, linear=True), "rate": Parameter(lower=0.1, upper=9)}


def decay(height, rate, inputs):
    return height * jnp.exp(-rate * inputs)


ONE = Problem(FREE, decay, Gaussian(sd=0.01), np.zeros(40), inputs=TIME)


def errors(found):
    return np.sqrt(np.diagonal(found.posterior.covariance))


@pytest.mark.slow
def test_channels_that_share_nothing_equal_separate_fits():
    found = fit(stack_channels(ONE, DATA), starts=4)
    for c in range(3):
        alone = fit(ONE.with_data(DATA[:, c]), starts=4)
        sd = errors(alone)
        together = found.optimum.vector.reshape(2, 3)[:, c]
        assert np.max(np.abs(together - alone.optimum.vector) / sd) < 1e-3
        np.testing.assert_allclose(errors(found).reshape(2, 3)[:, c], sd, rtol=1e-3)


@pytest.mark.slow
def test_channels_that_share_a_rate_equal_the_joint_problem():
    found = fit(stack_channels(ONE, DATA, shared=["rate"]), starts=4)
    free = {"height": Parameter(shape=(3,), lower=0, start=1.0), "rate": FREE["rate"]}

    def written_out(height, rate, inputs):
        return height[None] * jnp.exp(-rate * inputs)[:, None]

    whole = fit(Problem(free, written_out, Gaussian(sd=0.01), DATA, inputs=TIME), starts=4)
    assert np.max(np.abs(found.optimum.vector - whole.optimum.vector) / errors(whole)) < 1e-3
    np.testing.assert_allclose(errors(found), errors(whole), rtol=1e-3)
    assert found.values["height"].shape == (3,)


@pytest.mark.slow
def test_inputs_and_starts_may_differ_between_channels():
    """The channels have their own times, and the fitted noise is the scatter of the residuals."""
    times = TIME[:, None] * np.array([1.0, 0.5, 2.0])
    data = HEIGHTS * np.exp(-1.5 * times) + 0.02 * NOISE

    def begin(data):
        return {"height": data[0], "rate": jnp.asarray(1.0)}

    free = {
        "height": Parameter(),
        "rate": Parameter(lower=0.1, upper=9),
        "sd": Parameter(transform="log", lower=1e-3, upper=1),
    }
    one = Problem(free, decay, Gaussian(sd="sd"), np.zeros(40), inputs=TIME, start=begin)
    found = fit(stack_channels(one, data, shared=["rate", "sd"], inputs=times), starts=4)
    assert abs(found.values["rate"] - 1.5) < 0.05
    missed = data - found.values["height"] * np.exp(-found.values["rate"] * times)
    np.testing.assert_allclose(found.values["sd"], missed.std(), rtol=0.02)


@pytest.mark.slow
def test_groups_apply_to_every_channel_and_terms_stay_for_all():
    labels = np.repeat(np.arange(10), 4)
    free = FREE | {"base": Candidate(Parameter(linear=True))}
    one = Problem(
        free,
        lambda height, rate, base, inputs: decay(height, rate, inputs) + base,
        Clustered(Gaussian(sd=0.01), labels),
        np.zeros(40),
        inputs=TIME,
    )
    several = stack_channels(one, DATA, shared=["rate"])
    assert several.likelihood.labels.shape == (40, 3)
    found = fit(several, starts=4)
    assert [choice.kept for choice in found.choices] == [False]
    assert found.values["base"].shape == (3,)


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: stack_channels(ONE, DATA[:5]), r"data of shape \(5, 3\) do not fit"),
        (lambda: stack_channels(ONE, DATA, shared=["ratio"]), "shared names 'ratio'"),
        (
            lambda: stack_channels(
                Problem(
                    FREE | {"sd": Parameter(lower=0.001, upper=1)},
                    decay,
                    Gaussian(sd="sd"),
                    np.zeros(40),
                    inputs=TIME,
                ),
                DATA,
            ),
            "the likelihood names sd: add it to shared",
        ),
        (
            lambda: stack_channels(ONE, DATA, inputs=TIME[:3]),
            r"an array of shape \(3,\) is neither",
        ),
        (
            lambda: stack_channels(
                Problem(
                    FREE | {"other": Tied(lambda values: values["rate"])},
                    decay,
                    Gaussian(sd=0.01),
                    np.zeros(40),
                    inputs=TIME,
                ),
                DATA,
            ),
            "other is tied to others",
        ),
    ],
)
def test_mismatched_channels_are_refused(make, expected):
    with pytest.raises(InputError, match=expected):
        make()
