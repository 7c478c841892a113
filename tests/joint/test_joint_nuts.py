"""Tests the joint posterior, with shared errors marginalised, against NUTS draws of all parameters
and errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_joint import BALL, BLACK, GAMMA, LIGHT, READ, photographs

from fitting.inference import nuts
from fitting.inference.emcee_run import Emcee
from fitting.inference.parameters import Parameter, log_prior, to_unconstrained
from fitting.inference.posterior import sample
from fitting.joint import calibrate, from_photographs, marginal
from fitting.joint.model import log_posterior, predicted, values_at, weights
from fitting.rig import Camera

pytest.importorskip("blackjax")


def of_all(vector, data):
    """Return the log density with the relative error of each light as a parameter."""
    theta, errors = jnp.split(vector, [len(data.space)])
    values, cells = values_at(theta, data), data.cells
    model = predicted(values, data, cells)
    weight = weights(cells, model)
    assert model.image_errors is not None
    sizes = errors / values["light_scatter"]
    left = cells.mean - model.mean - sizes[:, None] * model.image_errors[:, 0]
    volume = jnp.sum(jnp.log(jnp.where(weight > 0, weight, 1)))
    total = (volume - jnp.sum(weight * left**2) - sizes @ sizes) / 2
    total -= len(errors) * jnp.log(values["light_scatter"])
    total += marginal.scatter_log_density(cells.scatter, cells.count, model.variance)
    return total + log_prior(data.space, theta)


def light_errors(vector, data):
    """Return means and standard deviations of the lights' relative errors given all other
    parameters."""
    values = values_at(vector, data)
    model = predicted(values, data, data.cells)
    weight = weights(data.cells, model)
    assert model.image_errors is not None
    left = marginal.Residuals(data.cells.mean - model.mean, weight, model.image_errors)
    found = marginal.image_error_means(left)
    return tuple(values["light_scatter"] * x[:, 0] for x in found)


@pytest.mark.slow
def test_marginal_draws_equal_those_with_the_lights_errors():
    """emcee samples the marginal density, and NUTS the full one."""
    images, lights = photographs(np.random.default_rng(0), lights=13)
    camera = Camera(
        bits=12, black_level=BLACK, black_sd=0.5, gamma=GAMMA, gamma_sd=0.5,
        read_noise=READ, read_noise_sd=1.0,
    )  # fmt: skip
    given = BALL | {"intensities": np.full(13, LIGHT), "held_out": [12]}
    found = calibrate(from_photographs(images, lights, camera=camera, **given, intensity_sd=0.01))
    (fit,), posterior = found.fits, found.posteriors["grey"]
    mode, data, count = jnp.asarray(fit.vector), fit.data, len(fit.space)

    options = Emcee(steps=3000)
    drawn = sample(log_posterior, fit.space, mode, posterior.covariance, data, options=options)
    assert not drawn.missing_steps

    errors, spread = (np.asarray(x) for x in light_errors(mode, data))
    follow = np.asarray(jax.jacfwd(lambda v: light_errors(v, data)[0])(mode)) @ posterior.covariance
    whole = np.block(
        [
            [posterior.covariance, follow.T],
            [follow, np.diag(spread**2) + follow @ np.linalg.solve(posterior.covariance, follow.T)],
        ]
    )
    space = (*fit.space, *(Parameter(f"error_{i}") for i in range(len(errors))))
    start = jnp.concatenate([mode, jnp.asarray(errors)])
    options = nuts.Nuts(draws=1500)
    reference = nuts.nuts(of_all, space, start, whole, data, options=options)
    assert reference.divergences == 0

    ours, theirs = (
        np.asarray(to_unconstrained(fit.space, jnp.asarray(p.samples[:, :count])))
        for p in (drawn, reference)
    )
    mean, deviation = theirs.mean(axis=0), theirs.std(axis=0)
    assert np.abs((ours.mean(axis=0) - mean) / deviation).max() < 0.1
    np.testing.assert_allclose(ours.std(axis=0), deviation, rtol=0.05)
