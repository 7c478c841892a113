"""Tests that a wrong optimum is never reported as success: a hundred single starts of each problem,
spread over its box, end at the best optimum or are reported as failed."""

import jax.numpy as jnp
import numpy as np
import pytest

from fitting import Gaussian, Normal, Parameter, Problem, StudentT, fit, fit_map
from fitting.inference.parameters import to_natural
from fitting.inference.search import SAME_PLACE, spread_starts
from jaxvision import Orthographic, Phong, PointLight, Scene, Sphere, Surface, render
from jaxvision.errors import InputError

STARTS = 100
RNG = np.random.default_rng(8)


def ball():
    """Return the problem of the README's lamp."""
    axes = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    view = Orthographic((0.0, 0.0, 5.0), axes, 2.2 / 20, resolution=(20, 20))

    def scene(lamp, exponent, diffuse):
        material = Phong(diffuse=(diffuse,), specular=(0.4,), exponent=exponent)
        return Scene(
            [Surface(Sphere((0.0, 0.0, 0.0), 1.0), material)], [PointLight(lamp, (300.0,))]
        )

    picture = np.asarray(render(scene((1.0, 1.5, 3.0), 25.0, 0.3), view)[..., 0])
    return Problem(
        {
            "scene.lights[0].position": Parameter(lower=(-5, -5, 1.2), upper=5),
            "scene.surfaces[0].material.exponent": Parameter(lower=1, upper=1000, transform="log"),
            "scene.surfaces[0].material.diffuse": Parameter(lower=0, upper=1),
        },
        predict=lambda scene: render(scene, view)[..., 0],
        likelihood=Gaussian(sd=0.1),
        data=picture + 0.1 * RNG.standard_normal(picture.shape),
        records={"scene": scene((0.0, 0.0, 2.0), 10.0, 0.5)},
    )


def glow():
    """Return the decay under Student's t of the page on own models."""
    time = np.linspace(0.0, 4.0, 60)
    data = 1.5 * np.exp(-time / 0.8) + 0.2 + 0.02 * RNG.standard_t(4.0, 60)
    return Problem(
        {
            "amplitude": Parameter(lower=0, upper=5),
            "decay": Parameter(lower=0.1, upper=10, transform="log"),
            "background": Parameter(prior=Normal(0.1, 0.1)),
        },
        lambda inputs, amplitude, decay, background: (
            amplitude * jnp.exp(-inputs / decay) + background
        ),
        StudentT(scale=0.02, dof=4.0),
        data,
        inputs=time,
    )


def peak():
    """Return a peak on a background with unknown noise. Far from the peak the gradient vanishes."""
    place = np.linspace(0.0, 10.0, 80)
    data = 0.3 + 2 * np.exp(-(((place - 6.5) / 0.4) ** 2) / 2) + 0.1 * RNG.standard_normal(80)
    return Problem(
        {
            "height": Parameter(lower=0, upper=5),
            "centre": Parameter(lower=0, upper=10),
            "width": Parameter(lower=0.1, upper=3, transform="log"),
            "base": Parameter(lower=-1, upper=2),
        },
        lambda inputs, height, centre, width, base: (
            base + height * jnp.exp(-(((inputs - centre) / width) ** 2) / 2)
        ),
        Gaussian(sd=0.1),
        data,
        inputs=place,
    )


def counted(problem):
    """Return how many starts were right, reported as failed, and wrong without a report."""
    begin = spread_starts(problem, STARTS, seed=1)
    natural = np.asarray(to_natural(problem.space, jnp.asarray(begin)))
    shapes = [(p.name, p.shape or ()) for p in problem.free]
    costs, told = [], []
    for row in natural:
        parts = np.split(row, np.cumsum([int(np.prod(shape)) for _, shape in shapes])[:-1])
        start = {name: part.reshape(s) for (name, s), part in zip(shapes, parts, strict=True)}
        try:
            found = fit(problem, start=start)
        except InputError:
            costs.append(np.inf)
            told.append(True)
            continue
        costs.append(found.optimum.cost)
        told.append(not found.converged)
    best = np.array(costs) < min(costs) + SAME_PLACE
    failed = np.array(told)
    return int(np.sum(best & ~failed)), int(np.sum(failed)), int(np.sum(~best & ~failed))


@pytest.mark.slow
@pytest.mark.parametrize("stated", [ball, glow, peak])
def test_a_wrong_optimum_is_never_reported_as_success(stated):
    right, said, wrong = counted(stated())
    assert wrong == 0, f"{right} right, {said} said that they failed"
    assert right >= 50  # not everything is a failure


PEAK = np.linspace(0, 100, 400)


def narrow(height, centre, inputs):
    return height * jnp.exp(-(((inputs - centre) / 0.5) ** 2) / 2)


def highest(data, inputs):
    return {"height": jnp.nanmax(data), "centre": inputs[jnp.nanargmax(data)]}


def peak(data, **how):
    free = {"height": Parameter(), "centre": Parameter(lower=0, upper=100)}
    return Problem(free, narrow, Gaussian(sd=0.1), data, inputs=PEAK, **how)


@pytest.mark.slow
def test_a_start_from_the_data_finds_a_peak_that_one_search_misses():
    data = np.asarray(narrow(2.0, 37.3, PEAK)) + 0.1 * np.random.default_rng(0).standard_normal(400)
    data[100] = np.nan
    found = fit(peak(data, start=highest), starts=1)
    assert found.optimum.stationary
    np.testing.assert_allclose([*found.values.values()], [2.0, 37.3], atol=0.2)
    with pytest.raises(InputError, match="Nothing says where to search for height"):
        fit(peak(data))
    again = peak(data, start=highest).with_data(narrow(2.0, 80.0, PEAK))
    assert abs(fit(again, starts=1).values["centre"] - 80) < 0.01


@pytest.mark.slow
def test_each_pixel_of_a_map_starts_from_its_data():
    centres = np.array([12.0, 50.5, 93.0])
    images = np.stack([narrow(2.0, c, PEAK) for c in centres], axis=-1)
    maps = fit_map(peak(np.zeros(400), start=highest), images, starts=1)
    np.testing.assert_allclose(maps.estimate["centre"], centres, atol=1e-3)


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        (lambda data: data.max(), "start gives a .*: return natural values by name"),
        (lambda data: {"hight": data.max()}, "start names 'hight', no free parameter"),
        (lambda height: {"height": height}, "asks for 'height'"),
        (lambda data: {"height": data[:2]}, r"height has the shape \(\), its start \(2,\)"),
    ],
)
def test_an_invalid_start_is_refused(start, expected):
    with pytest.raises(InputError, match=expected):
        fit(peak(np.zeros(400), start=start))
