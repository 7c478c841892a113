"""Tests problems reduced to the effects that matter for their scene and camera."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from traced import primitives

import jaxvision as jv
from fitting import InputError, Parameter, Problem, SensorNoise, Tied, called_for, fit
from fitting.fits.result import section
from fitting.inference.problem import log_likelihood
from jaxvision.optics import sensor_irradiance

DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
FLOOR = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25]))
BALL = jv.Surface(jv.Sphere([0.3, 0, 0.3], 0.2), jv.Phong([0.2], [1e-9], 20.0))
LAMPS = jv.PointLight([0, 9000.0, 9000], [1.0]), jv.PointLight([0.5, 0, 2], [2e4])
FAINT = jv.PointLight([0, 0, 9000.0], [1.0])
VIEW = jv.Orthographic([0, 0, 3], DOWN, 0.2, resolution=(6, 6), f_number=4.0)
SENSOR = jv.Sensor(
    shot_noise=jv.GaussianShotNoise(), dark_current=1e-6, read_noise=3.0, row_noise=1e-3, gain=1.0
)
RECORDS = {
    "scene": jv.Scene([FLOOR, BALL], [*LAMPS, FAINT]),
    "camera": jv.Camera(VIEW, replace(SENSOR, full_well=1e6)),
}
LAMP, ROWS = "scene.lights[1].intensity", "camera.sensor.row_noise"


def shown(scene, camera):
    return sensor_irradiance(camera.view, jv.render(scene, camera.view))


def stated(parameters=None, data=None, **records):
    parameters = parameters or {LAMP: Parameter(lower=5e3, upper=4e4)}
    data = np.ones((6, 6, 1)) if data is None else data
    likelihood = SensorNoise("camera.sensor")
    return Problem(parameters, shown, likelihood, data, records=RECORDS | records)


def traced(problem):
    vector = jnp.zeros(len(problem.space))
    return primitives(lambda v: log_likelihood(v, problem), vector)


@pytest.mark.slow
def test_negligible_effects_are_not_traced():
    """The faint lamp, the lobe and the row noise of the likelihood are dropped."""
    whole = stated()
    less = called_for(whole)
    gone = {effect.name for effect in less.left_out.dropped}
    assert gone >= {"lights[2]", "surfaces[1].material.specular", "sensor.row_noise"}
    assert len(less.records["scene"].lights) == 2
    assert less.records["camera"].sensor.row_noise is None
    before, after = traced(whole), traced(less)
    assert sum(after.values()) < 0.8 * sum(before.values())
    assert less.with_data(np.zeros((6, 6, 1))).left_out is less.left_out


@pytest.mark.slow
def test_bounds_hold_over_the_range_of_free_parameters():
    """A lamp that may be 1e9 times as bright is not negligible."""
    far = "scene.lights[2].intensity[0]"
    kept = called_for(stated({far: Parameter(lower=0.0, upper=1e9), ROWS: 50.0}))
    assert len(kept.records["scene"].lights) == 3
    assert float(kept.records["camera"].sensor.row_noise) == 50
    assert "sensor.row_noise" not in {effect.name for effect in kept.left_out.dropped}


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({LAMP: Parameter(lower=5e3)}, "has no end; give it bounds or a prior"),
        ({f"{LAMP}[0]": Tied(lambda v: 2 * v["x"]), "x": Parameter(lower=1, upper=2)}, "is tied"),
    ],
)
def test_parameters_without_a_range_are_refused(parameters, sentence):
    with pytest.raises(InputError, match=sentence):
        called_for(stated(parameters))


@pytest.mark.slow
def test_a_prediction_that_contradicts_the_records_is_refused():
    """The prediction has ten thousand times the light of the records, so its shot noise is not
    negligible."""
    dim = {"scene.lights[1].intensity": Parameter(lower=0.5, upper=4.0)}
    scene = replace(RECORDS["scene"], lights=(LAMPS[0], replace(LAMPS[1], intensity=[2.0]), FAINT))
    problem = stated(dim, scene=scene)
    brighter = Problem(
        dim,
        lambda scene, camera: 1e4 * shown(scene, camera),
        problem.likelihood,
        problem.data,
        records=problem.records,
    )
    assert "sensor.shot_noise" in {e.name for e in called_for(problem).left_out.dropped}
    with pytest.raises(InputError, match="predict must render the scene"):
        called_for(brighter)


def test_a_scene_and_a_camera_are_needed():
    with pytest.raises(InputError, match="2 Scene records"):
        called_for(stated(other=RECORDS["scene"]))


@pytest.mark.slow
def test_a_fit_finds_the_same_and_its_report_lists_what_was_left_out():
    light = np.asarray(jax.jit(shown)(*RECORDS.values()))
    data = SensorNoise(SENSOR).draw(jax.random.key(0), light)
    whole = stated(data=data)
    less = called_for(whole)
    one, two = (fit(problem, start={LAMP: [1e4]}) for problem in (whole, less))
    sd = one.estimates[0].standard_error
    assert abs(one.values[LAMP] - two.values[LAMP]) < 0.2 * sd
    (table,) = (t for t in section(two, "Fit").tables if t.title == "Left out")
    assert len(table.rows) == len(less.left_out.dropped)
    assert "Dropped" in table.caption
    assert not [t for t in section(one, "Fit").tables if t.title == "Left out"]
