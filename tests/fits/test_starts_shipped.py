"""Tests searches of the shipped calibrations from a hundred random starts: at least 98 reach the
optimum that the calibration finds, or are reported as failed."""

import jax.numpy as jnp
import numpy as np
import pytest

from fitting.checks import joint, noise, reflectance
from fitting.inference.newton import minimise
from fitting.inference.parameters import names
from fitting.inference.search import negative_log_density
from fitting.joint.calibration import calibrate as calibrate_joint
from fitting.joint.fit import is_searched_shape
from fitting.joint.model import cost as joint_cost
from fitting.noise.calibration import calibrate as calibrate_noise
from fitting.noise.statement import replace_parameters
from fitting.reflectance.from_images.fit import fit_channel
from fitting.reflectance.from_images.optimum import optimum
from fitting.reflectance.from_images.samples import View, cost_and_information, predict
from fitting.reflectance.from_images.signal import Form
from fitting.reflectance.models import has_lobe, is_searched, shape_range
from fitting.reflectance.names import MODELS

STARTS = 100
SAME = 0.01  # of the log likelihood, a seventh of a standard deviation


def outcomes(search, cost, best, starts):
    """Return how many searches reach the optimum, are reported as failed, and neither."""
    reached = said = 0
    for start in starts:
        vector, converged = search(jnp.asarray(start))
        if not converged:
            said += 1
        elif float(cost(vector)) < best + SAME:
            reached += 1
    return reached, said, len(starts) - reached - said


def judge(found, at_least):
    reached, said, wrong = found
    print(f"{reached} reach the optimum, {said} say that they fail, {wrong} do neither")
    assert wrong <= 2
    assert reached >= at_least


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_searches_of_reflectance(model):
    """Amplitudes are from a hundredth to ten times the light, and shapes over the whole range."""
    observation, chosen, cells = reflectance.SPHERE.observed
    view = View(observation, 0, chosen)
    fit = fit_channel(view, Form(model), cells)
    rng = np.random.default_rng(7)
    ranges = [(0.01, 10.0)] * (1 + has_lobe(model))
    ranges += [] if model == "lambert" else [shape_range(model)]
    starts = [[rng.uniform(*np.log(ends)) for ends in ranges] for _ in range(STARTS)]

    def search(start):
        found, _, converged = optimum(np.asarray(start), fit.samples)
        return found.vector, converged

    def cost(vector):
        return cost_and_information(predict(vector, fit.samples), fit.samples)[0]

    judge(outcomes(search, cost, cost(fit.vector), starts), 60)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.0, 10.0])
def test_searches_of_noise(factor):
    """Positive numbers start within a factor of the optimum, and others within as many
    deviations."""
    chosen = calibrate_noise(noise.measured(noise.CASES["clean"], 0)).chosen
    starts = about(chosen.optimum.vector, chosen.optimum.information, chosen.space, factor)
    problem = replace_parameters(chosen.problem, chosen.space)

    def search(start):
        found = minimise(negative_log_density, start, problem)
        return found.vector, bool(found.converged)

    def cost(vector):
        return negative_log_density(vector, problem)

    judge(outcomes(search, cost, float(cost(jnp.asarray(chosen.optimum.vector))), starts), 60)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.0, 7.0])
def test_searches_of_joint_fits(factor):
    measurement = joint.photographed(joint.CASES["12 lights off by 1 %"], 0)
    (fit,) = calibrate_joint(measurement, fit_gamma=True).fits
    starts = about(fit.vector, fit.information, fit.space, factor)

    def search(start):
        found = minimise(joint_cost, start, fit.data)
        return found.vector, bool(found.converged) and is_searched_shape(found.vector, fit.data)

    best = float(joint_cost(jnp.asarray(fit.vector), fit.data))
    judge(outcomes(search, lambda v: joint_cost(v, fit.data), best, starts), 60)


def about(vector, information, space, factor):
    rng = np.random.default_rng(8)
    vector = np.asarray(vector)
    deviation = np.sqrt(np.diagonal(np.linalg.inv(np.asarray(information))))
    logs = np.array([parameter.transform == "log" for parameter in space])
    width = np.where(logs, np.log(factor), factor * deviation)
    return vector + width * rng.uniform(-1, 1, (STARTS, vector.size))


@pytest.mark.slow
def test_a_lobe_beyond_the_searched_range_is_not_an_optimum():
    """The start is on the plateau of facets so rough that they no longer reflect a highlight."""
    observation, chosen, cells = reflectance.SPHERE.observed
    view = View(observation, 0, chosen)
    fit = fit_channel(view, Form("torrance-sparrow-beckmann"), cells)
    assert fit.converged
    *_, converged = optimum(np.array([-0.9, 8.5, 11.4]), fit.samples)
    assert not converged
    assert is_searched("oren-nayar", 1e-6)
    assert not is_searched("phong", 30_000.0)
    assert len(names(fit.space)) == 3
