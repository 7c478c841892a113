"""Tests the estimated influence of effects on a fitted number against fits without the effects."""

import jax
import numpy as np
import pytest

import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, SensorNoise, called_for, fit, influence
from fitting.fits.depicted import removable_effects
from jaxvision.errors import InputError
from jaxvision.optics import sensor_irradiance

DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
INTENSITY, EXPONENT, DIFFUSE = (
    "scene.lights[0].intensity",
    "scene.surfaces[1].material.exponent",
    "scene.surfaces[1].material.diffuse",
)
FREE = {  # without starts, each problem's own start would be compiled in
    INTENSITY: Parameter(start=[2e4], lower=1e3, upper=1e5),
    EXPONENT: Parameter(start=20.0, lower=3.0, upper=200.0),
    DIFFUSE: Parameter(start=[0.3], lower=0.01, upper=0.9),
}


def shown(scene, camera):
    return sensor_irradiance(camera.view, jv.render(scene, camera.view))


def planted(seed):
    """Return a problem of a ball on a floor under a lamp, with effects of random sizes."""
    rng = np.random.default_rng([56, seed])

    def some(least, most):
        return float(np.exp(rng.uniform(np.log(least), np.log(most))))

    place = [rng.uniform(-0.8, 0.8), rng.uniform(-0.8, 0.8), 2.0]
    lamps = [
        jv.PointLight(place, [some(1e4, 3e4)]),
        jv.PointLight([0, 0, 9.0], [some(1.0, 1e4)]),
    ]
    ball = jv.Phong([rng.uniform(0.1, 0.5)], [rng.uniform(0.2, 0.5)], some(8, 50))
    surfaces = [
        jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25])),
        jv.Surface(jv.Sphere([0.0, 0, 0.3], 0.25), ball),
    ]
    view = jv.Orthographic([0, 0, 3], DOWN, 0.04, resolution=(18, 18), f_number=4.0)
    sensor = jv.Sensor(
        shot_noise=jv.GaussianShotNoise(),
        dark_current=some(1e-3, 10),
        mixing=jv.sensor.even_mixing(some(1e-5, 0.03)),
        read_noise=3.0,
        row_noise=some(0.01, 1),
        gain=0.5,
        exposure_time=1.0,
    )
    scene = jv.Scene(surfaces, lamps, ambient=jv.AmbientLight([some(1e-3, 20)]))
    light = np.asarray(jax.jit(shown)(scene, jv.Camera(view, sensor)))
    data = SensorNoise(sensor).draw(jax.random.key(seed), light)
    records = {"scene": scene, "camera": jv.Camera(view, sensor)}
    return Problem(FREE, shown, SensorNoise("camera.sensor"), data, records=records)


@pytest.mark.slow
def test_no_refit_moves_by_more_than_its_bound():
    """Each effect of 40 problems is left out, and the problem fitted again."""
    ratios = []
    for seed in range(40):
        whole, target = planted(seed), list(FREE)[seed % 3]
        found = fit(whole, starts=2)
        values = {name: found.values[name] for name in FREE}
        (name,) = (n.name for n in whole.space if n.name.startswith(target))
        promised = influence(found, name)
        _, left = removable_effects(whole)
        for effect in promised.effects:
            again = fit(left((effect.effect,)), start=values)
            moved = (again.values[target] - found.values[target]).item() / promised.sd
            assert abs(moved) <= effect.bound + 1e-5 or not again.optimum.stationary
            if abs(moved) > 1e-4:
                ratios.append(effect.bound / abs(moved))
    assert len(ratios) > 150
    assert np.median(ratios) < 2


@pytest.mark.slow
def test_a_problem_drops_effects_without_influence_on_its_target():
    """More effects are dropped for one parameter than for all."""
    whole = planted(0)
    small, smaller = called_for(whole), called_for(whole, target="exponent")
    before, after = ({e.name for e in one.left_out.dropped} for one in (small, smaller))
    assert before < after
    assert "sensor.read_noise" not in after
    one, two = fit(whole, starts=4), fit(smaller, starts=4)
    sd = influence(one, "exponent").sd
    assert abs(one.values[EXPONENT] - two.values[EXPONENT]) < 0.1 * sd
    told = [x for x in two.findings if "moves exponent by at most" in x]
    assert len(told) == len([e for e in smaller.left_out.dropped if e.rank == "estimate"]) > 0


@pytest.mark.slow
def test_integer_and_half_precision_data_have_the_influence_of_floats():
    """Two lamps are over a floor. Without the far one, the near one gains its share, by
    projection."""
    floor = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25]))
    lamps = [jv.PointLight([0, 0, 2], [800.0]), jv.PointLight([0, 0, 20], [800.0])]
    view = jv.Orthographic([0, 0, 3], DOWN, 0.2, resolution=(3, 3))
    scene = jv.Scene(floor, lamps)
    true = np.round(np.asarray(jv.render(scene, view)))

    def moved(data):
        problem = Problem(
            {"scene.lights[0].intensity": Parameter(lower=1.0, upper=2000.0)},
            predict=lambda scene, camera: jv.render(scene, camera.view),
            likelihood=Gaussian(sd=0.01),
            data=data,
            records={"scene": scene, "camera": jv.Camera(view, jv.Sensor())},
        )
        found = influence(problem, "intensity[0]")
        return (
            found.value,
            found.sd,
            found.shift_by("lights[1]").shift,
            found.shift_by("shadows").bound,
        )

    whole, squares = moved(true), 0.2**2 * np.add.outer([1, 0, 1], [1, 0, 1])
    near, far = (height / (height**2 + squares) ** 1.5 for height in (2, 20))
    gained = 800 * np.sum(near * far) / np.sum(near**2)
    assert whole[2] * whole[1] == pytest.approx(gained, rel=1e-4)
    np.testing.assert_allclose(moved(true.astype(np.uint8)), whole, rtol=1e-6, atol=1e-6)
    without = np.zeros(true.shape, bool)
    without[0, 0] = True
    masked = moved(np.ma.masked_array(np.where(without, 99.0, true), without))
    missing = moved(np.where(without, np.nan, true))
    np.testing.assert_allclose(masked, missing, rtol=1e-6, atol=1e-6)
    one = moved(np.where(np.arange(9).reshape(3, 3)[..., None] == 4, true, np.nan))
    assert one[2] * one[1] == pytest.approx(8, rel=1e-4)
    with pytest.raises(InputError, match="influence: fitted must be a Fit, got int; fit gives one"):
        influence(3, "intensity")
