"""Checks of coverage: right places pass, planted faults are flagged, runs go on; real fits hold."""

import numpy as np
import pytest
from scipy.special import ndtr

import fitting
from fitting import Gaussian, Normal, Parameter, Problem
from fitting.checks import noise, reflectance
from fitting.checks.coverage import coverage
from fitting.checks.section import section
from fitting.checks.simulations import simulated
from jaxvision.errors import InputError


def z_of(count, *, sd=1.0, mean=0.0, seed=0):
    return ndtr(mean + sd * np.random.default_rng(seed).standard_normal((count, 3)))


def test_right_places_are_not_flagged():
    """One check in a hundred may be."""
    flagged = [
        any(one.faults for one in coverage(z_of(500, seed=seed), ("a", "b", "c")))
        for seed in range(100)
    ]
    assert np.sum(flagged) <= 5


@pytest.mark.parametrize("fault", [{"sd": 1.25}, {"sd": 0.8}, {"mean": 0.2}])
def test_planted_faults_are_flagged(fault):
    """Errors that are .8 and 1.25 times what they should be, and a bias of a fifth of one."""
    for one in coverage(z_of(2000, **fault), ("a", "b", "c")):
        assert one.faults
        assert abs(one.z_sd - fault.get("sd", 1.0)) < 0.05
        assert abs(one.z_mean - fault.get("mean", 0.0)) < 0.1


def test_a_check_goes_on_where_it_stopped(tmp_path):
    file, asked = tmp_path / "places.npy", []

    def simulate(seed):
        if seed == 25 and len(asked) == 25:
            raise KeyboardInterrupt
        asked.append(seed)
        if seed == 3:
            raise InputError("no interval.")
        return np.random.default_rng(seed).uniform(size=2)

    with pytest.raises(KeyboardInterrupt):
        simulated(simulate, 30, parameters=2, kept=file)
    rows = simulated(simulate, 30, parameters=2, kept=file)
    assert asked == [*range(25), *range(20, 30)]
    assert np.flatnonzero(np.isnan(rows[:, 0])).tolist() == [3]
    told = section("toy", {"case": coverage(rows, ("a", "b"))}, 30).findings
    assert any("1 of 30 fits print no interval" in sentence for sentence in told)


def line():
    x = np.linspace(-1, 1, 20)
    return Problem(
        {"a": Parameter(prior=Normal(0.0, 1.0)), "b": Parameter(prior=Normal(0.0, 1.0))},
        predict=lambda a, b, inputs: a + b * inputs,
        likelihood=Gaussian(sd=0.3),
        data=np.zeros(20),
        inputs=x,
    )


@pytest.mark.slow
def test_intervals_of_a_straight_line_hold(tmp_path):
    found = fitting.check(line(), simulations=200, kept=tmp_path / "kept.npy")
    assert not found.faults
    for one in found.coverage:
        assert abs(one.z_sd - 1) < 4 / np.sqrt(2 * 200)
    assert "95 %" in str(found)


def test_a_check_needs_something_to_draw_from():
    free = Problem({"a": Parameter(start=0.0)}, lambda a: a, Gaussian(sd=1.0), np.zeros(()))
    with pytest.raises(InputError, match="neither prior nor bounds"):
        fitting.check(free)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["clean", "lights off by 1 %", "4 lights off by 1 %"])
def test_intervals_of_reflectance_hold(case):
    sphere = reflectance.CASES[case]
    places = simulated(lambda seed: reflectance.places(sphere, seed), 200, parameters=3)
    for one in coverage(places, reflectance.NAMES):
        assert not one.faults, one
        assert 0.8 < one.z_sd < 1.35


@pytest.mark.slow
def test_intervals_of_a_clean_camera_hold():
    camera = noise.CASES["clean"]
    places = simulated(lambda seed: noise.places(camera, seed), 100, parameters=5)
    for one in coverage(places, noise.NAMES):
        assert not one.faults, one
