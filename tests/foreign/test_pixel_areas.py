"""Tests that pixels are means over their areas, in predictions, fits and normal maps."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.sphere_photographs import shade, sphere_normals

from fitting import joint, reflectance
from fitting.checks.reflectance import directions
from fitting.inference.estimates import find
from fitting.inference.posterior import estimates
from fitting.reflectance.from_images.pixel_area import recognise_points
from fitting.reflectance.from_images.read import POINTS
from fitting.reflectance.from_images.read import _normals_within as normals_within
from fitting.reflectance.from_images.samples import View, predict, select
from fitting.reflectance.from_images.signal import Form
from fitting.rig import Camera, SphereGeometry

SIZE, RADIUS, LIGHT, GAIN, READ, BLACK = 40, 17.0, 2400.0, 0.25, 4.0, 64.0
TRUTH = {"diffuse": 0.9, "specular": 0.5, "exponent": 25.0}
BALL = SphereGeometry(centre=((SIZE - 1) / 2, (SIZE - 1) / 2), radius=RADIUS, radius_m=0.1)
TILTS, TURNS = np.radians(12 + 45 * np.sqrt(np.arange(8) / 8)), np.arange(8) * 2.399
LIGHTS = np.stack(
    [np.sin(TILTS) * np.cos(TURNS), np.sin(TILTS) * np.sin(TURNS), np.cos(TILTS)], axis=-1
)


def signal(lights, parts, *, near=False):
    """Return the DN of a Phong ball by NumPy, (lights, SIZE, SIZE), each the mean of parts x parts
    points."""
    row, column = (np.indices((SIZE * parts,) * 2) + 0.5) / parts - SIZE / 2
    x, y = column / RADIUS, -row / RADIUS
    on = x**2 + y**2 < 1
    normal = np.stack([x, y, np.sqrt(np.where(on, 1 - x**2 - y**2, 0))], axis=-1)
    found = []
    for light in lights:
        toward = light - 0.1 * normal if near else np.broadcast_to(light, normal.shape)
        distance = np.linalg.norm(toward, axis=-1)
        toward, strength = toward / distance[..., None], distance**-2 if near else 1.0
        cosine = np.einsum("hwc,hwc->hw", normal, toward)
        mirrored = np.maximum(2 * cosine * normal[..., 2] - toward[..., 2], 0)
        shading = TRUTH["diffuse"] * cosine + TRUTH["specular"] * mirrored ** TRUTH["exponent"]
        points = LIGHT * strength * np.where(on & (cosine > 0), shading, 0)
        found.append(points.reshape(SIZE, parts, SIZE, parts).mean(axis=(1, 3)))
    return np.stack(found)


def observed(images, lights=LIGHTS, **options):
    camera = Camera(bits=12, black_level=BLACK, gain=GAIN, read_noise=READ)
    given = {"camera": camera, "sphere": BALL, "intensities": np.full(len(lights), LIGHT)}
    return joint.from_photographs(list(images), lights, **(given | options))


def exposed(rng, linear):
    noisy = rng.poisson(linear / GAIN) + READ * rng.standard_normal(linear.shape)
    return np.clip(np.round(GAIN * noisy + BLACK), 0, 4095)


@pytest.mark.parametrize("near", [False, True])
def test_predictions_are_means_over_areas(near):
    """The reference takes means of 24 x 24 points, including the terminator, where centres are
    wrong by up to 32 DN."""
    lights = 1.2 * LIGHTS[:3] if near else LIGHTS[:3]
    seen = observed(signal(lights, 1, near=near) + BLACK, lights, point_lights=near)
    chosen = select(seen, held_out=False, form=Form("phong"), minimum_cosine=0.0)
    view = View(seen, 0, chosen)
    vector, samples = np.log([*TRUTH.values()]), view.samples(Form("phong"))
    middle = predict(vector, replace(samples, points=())).signal
    mean = predict(vector, samples).signal
    at = chosen.light, seen.rows[chosen.pixel], seen.columns[chosen.pixel]
    exact, points = (signal(lights, parts, near=near)[at] for parts in (24, 1))
    np.testing.assert_allclose(middle, points, rtol=1e-6)
    difference = exact - points
    assert np.abs(difference).max() > 10
    np.testing.assert_allclose(mean - middle, difference, atol=0.15 * np.abs(difference).max())
    highlight = middle > 0.8 * middle.max()
    np.testing.assert_allclose((mean - exact)[highlight], 0, atol=0.01 * np.abs(difference).max())


def test_normals_within_pixels_of_a_map_are_interpolated():
    row, column = np.indices((SIZE, SIZE)) - (SIZE - 1) / 2
    x, y = column / RADIUS, -row / RADIUS
    on = np.hypot(x, y) < 0.8
    ball = np.stack([x, y, np.sqrt(np.where(on, 1 - x**2 - y**2, 1))], axis=-1)
    within = normals_within(np.where(on[..., None], ball, np.nan), *np.nonzero(on))
    x, y = x[on] + POINTS[0, :, None] / RADIUS, y[on] - POINTS[1, :, None] / RADIUS
    exact = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1)
    inner = np.hypot(x, y).max(axis=0) < 0.7
    assert np.linalg.norm(within - exact, axis=-1)[:, inner].max() < 0.1 * 0.3 / RADIUS


@pytest.mark.parametrize(
    ("parts", "gain", "words"),
    [
        (1, 2.0, "pixels were taken as points"),
        (1, 30.0, "The noise hides whether pixels are means"),
        (8, 2.0, ""),
    ],
)
def test_shot_noise_that_hides_the_type_of_pixels_is_reported(parts, gain, words):
    """The residuals are at the true parameters, with noise."""
    shape = {"read_noise": READ, "gain": gain}
    linear = signal(LIGHTS, parts)
    electrons = np.random.default_rng(0).poisson(linear / gain)
    images = np.clip(np.round(gain * electrons + BLACK), 0, 4095)
    seen = observed(images, camera=Camera(bits=12, black_level=BLACK, **shape))
    chosen = select(seen, held_out=False, form=Form("phong"), minimum_cosine=0.0)
    samples = View(seen, 0, chosen).samples(Form("phong"))
    vector = np.log([*TRUTH.values()])
    deviation = np.sqrt(gain * np.maximum(predict(vector, samples).signal, 1) + 1 / 12)
    view, samples = View(seen, 0, chosen), replace(samples, deviation=deviation)
    found = recognise_points(seen, vector, samples, view=view, form=Form("phong"))
    assert (found.within is None) == ("points" in words)
    assert words in " ".join(found.findings)
    assert bool(words) == (found is not seen)


@pytest.mark.slow
@pytest.mark.parametrize("parts", [1, 8])
@pytest.mark.parametrize("top", [4095, 2400])
def test_highlights_of_a_few_pixels_have_the_right_width(top, parts):
    """The pictures are from a camera, or rendered at pixel centres."""
    images = np.minimum(exposed(np.random.default_rng(0), signal(LIGHTS, parts)), top)
    camera = Camera(bits=12, black_level=BLACK, gain=GAIN, read_noise=READ, saturation=top)
    seen = observed(images, camera=camera)
    for calibrate in (reflectance.calibrate, joint.calibrate):
        calibration = calibrate(seen, model="phong")
        assert (calibration.observation.within is None) == (parts == 1)
        said = " ".join(calibration.observation.findings)
        assert ("pixels were taken as points" in said) == (parts == 1)
        found = {one.name: one for one in estimates(calibration.posteriors["grey"])}
        for name, true in TRUTH.items():
            value, error = found[name].value, found[name].standard_error
            assert value is not None
            assert error is not None
            assert abs(value - true) < 3.5 * error, name


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [30.0, 80.0])
def test_points_of_a_coarse_ball_are_recognised(exponent):
    """A ball of 14 pixels: as means, the exponent was 40 and 168."""
    lights, size, radius = directions(8), 16, 7.0
    linear = 3000 * shade(sphere_normals(size, radius), lights, "phong", 0.4, 0.45, exponent)
    seen = observed(
        exposed(np.random.default_rng(1), linear),
        lights,
        sphere=SphereGeometry(centre=((size - 1) / 2,) * 2, radius=radius),
        intensities=np.full(len(lights), 3000.0),
    )
    found = find(reflectance.calibrate(seen, model="phong").section.estimates, "exponent")
    low, high = found.interval_95
    assert low < exponent < high < 1.15 * low


@pytest.mark.slow
@pytest.mark.parametrize("parts", [1, 8])
def test_channels_are_fitted_as_if_alone(parts):
    """The brightest channel, here the middle one, is fitted before the others."""
    shares = 0.5, 1.0, 0.7
    linear = [signal(LIGHTS, parts) * share for share in shares]
    rng = np.random.default_rng(0)
    grey = [exposed(rng, one) for one in linear]
    calibration = reflectance.calibrate(observed(np.stack(grey, axis=-1)), model="phong")
    assert [fit.channel for fit in calibration.chosen_fits] == ["red", "green", "blue"]
    for images, fit in zip(grey, calibration.chosen_fits, strict=True):
        alone = reflectance.calibrate(observed(images), model="phong").chosen_fits[0]
        np.testing.assert_allclose(
            fit.vector, alone.vector, atol=0.01 * alone.information[0, 0] ** -0.5
        )
