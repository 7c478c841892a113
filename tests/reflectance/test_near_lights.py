"""Tests normals under lights at known positions, on surfaces of known depth."""

import numpy as np
import pytest
from test_photometric_stereo import rough

from fitting.reflectance import photometric_stereo
from fitting.reflectance.stereo.lights import light_covariance, solved
from jaxvision.errors import InputError

RNG = np.random.default_rng(4)
AZIMUTHS = np.array([0.1, 1.2, 2.0, 3.1, 4.4, 5.3, 0.6, 3.7])
LIGHTS = np.stack([0.4 * np.cos(AZIMUTHS), 0.3 * np.sin(AZIMUTHS), 0.4 + 0.04 * AZIMUTHS], axis=1)
POWERS = RNG.uniform(0.5, 2.0, 8)
SIDE = 24


def surface(kind):
    """Return points (m) and normals of a tilted plane, or of a ball of 15 cm with a background."""
    y, x = np.mgrid[0.14 : -0.14 : SIDE * 1j, -0.14 : 0.14 : SIDE * 1j]
    if kind == "plane":
        normal = np.array([0.2, -0.1, 1.0]) / np.sqrt(1.05)
        points = np.stack([x, y, (0.1 * y - 0.2 * x)], axis=-1)
        return points, np.broadcast_to(normal, points.shape)
    inside = np.hypot(x, y) < 0.13
    points = np.stack([x, y, np.sqrt(np.where(inside, 0.15**2 - x**2 - y**2, np.nan))], axis=-1)
    return points, points / 0.15


def read(points, normals, albedo, lights=LIGHTS, shade=None):
    """Return readings by a loop over lights and pixels, from the definition."""
    images = np.zeros((len(lights), *points.shape[:2]))
    for k, light in enumerate(lights):
        for i, j in np.ndindex(images.shape[1:]):
            toward = light - points[i, j]
            distance = np.sqrt((toward**2).sum())
            cosine = max(float(toward @ normals[i, j]) / distance, 0)
            if shade is not None and cosine > 0:
                cosine = shade(toward[None] / distance, normals[i, j][None])[0, 0]
            images[k, i, j] = POWERS[k] * albedo[i, j] * cosine / distance**2
    return images


def off(found, normals):
    across = np.linalg.norm(np.cross(found.normals, normals), axis=-1)
    return np.arctan2(across, (found.normals * normals).sum(-1))


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_normals_are_exact_without_noise_and_covered_with_it(kind):
    points, normals = surface(kind)
    known = np.isfinite(points).all(axis=-1)
    albedo = 100 + 50 * np.sin(40 * points[..., 0])
    images = read(points, normals, np.nan_to_num(albedo))
    found = photometric_stereo(images, LIGHTS, intensities=POWERS, points=points)
    np.testing.assert_allclose(found.albedo[known], albedo[known], rtol=1e-12)
    assert off(found, normals)[known].max() < 1e-12
    assert np.isnan(found.albedo[~known]).all()
    noisy = images + RNG.normal(0, 1, images.shape)
    found = photometric_stereo(noisy, LIGHTS, intensities=POWERS, points=points)
    inside = (off(found, normals) < 2.448 * found.normal_sd)[known].mean()
    assert 0.92 < inside < 0.98  # with a standard error of .01
    assert not found.findings
    middle = LIGHTS - np.nanmean(points, axis=(0, 1))
    distance = np.linalg.norm(middle, axis=1)
    distant = photometric_stereo(
        noisy, middle / distance[:, None], intensities=POWERS / distance**2
    )
    assert np.nanmedian(off(distant, normals)) > 20 * np.nanmedian(off(found, normals))


def test_distant_positions_equal_directions():
    points, normals = surface("ball")
    images = read(points, normals, np.full(points.shape[:2], 100.0), 1e6 * LIGHTS) * 1e12
    images += RNG.normal(0, 1, images.shape)
    near = photometric_stereo(images, 1e6 * LIGHTS, intensities=1e12 * POWERS, points=points)
    far = np.linalg.norm(LIGHTS, axis=1)
    distant = photometric_stereo(
        np.where(np.isfinite(points[..., 0]), images, np.nan),
        LIGHTS / far[:, None],
        intensities=POWERS / far**2,
    )
    for name in ("normals", "albedo", "normal_sd", "albedo_sd", "used"):
        ours, theirs = getattr(near, name), getattr(distant, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def test_errors_of_positions_and_powers_are_propagated():
    """The reference is a weighted fit for each changed number."""
    points, normals = (a[4:20:5, 4:20:5].reshape(1, -1, 3) for a in surface("plane"))
    readings = read(points, normals, np.full(points.shape[:2], 100.0))[:, 0]
    weights = RNG.uniform(0.2, 1.0, readings.shape)
    sds = np.array([0.004, 0.002, 0.003, 0.01])

    def rows(lights, powers):
        toward = lights[:, None] - points
        return toward * powers[:, None, None] / np.linalg.norm(toward, axis=-1, keepdims=True) ** 3

    def fitted(lights, powers):
        root = np.sqrt(weights)
        own = rows(lights, powers) * root[..., None]
        pairs = zip(np.swapaxes(own, 0, 1), (root * readings).T, strict=True)
        return np.array([np.linalg.lstsq(*pair)[0] for pair in pairs])

    expected, step = np.zeros((readings.shape[1], 3, 3)), 1e-6
    for k, a in np.ndindex(8, 4):
        lights, powers = LIGHTS.copy(), POWERS.copy()
        if a < 3:
            lights[k, a] += step
        else:
            powers[k] *= 1 + step
        moved = sds[a] * (fitted(lights, powers) - fitted(LIGHTS, POWERS)) / step
        expected += moved[:, :, None] * moved[:, None, :]
    own = rows(LIGHTS, POWERS)
    g, inverse = solved(own, readings, weights)
    np.testing.assert_allclose(g, 100 * normals[0], rtol=1e-12)
    covariance = np.einsum("ij,ab->iajb", np.eye(8), np.diag(sds**2))
    distances = np.linalg.norm(LIGHTS[:, None] - points, axis=-1)
    found = light_covariance(own, weights, inverse, g, covariance, distances)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * expected.max())


@pytest.mark.slow
def test_a_rough_surface_near_its_lights():
    points, normals = (a[::2, ::2] for a in surface("ball"))
    known = np.isfinite(points).all(axis=-1)
    images = read(points, normals, np.full(known.shape, 300.0), shade=lambda *of: rough(*of, 0.4))
    images += RNG.normal(0, 1, images.shape)
    plain, found = (
        photometric_stereo(
            images, LIGHTS, intensities=POWERS, points=points, model=model, robust=False
        )
        for model in ("lambert", "oren-nayar")
    )
    np.testing.assert_allclose(found.materials[0][0], 0.4, rtol=0.03)
    missed = off(found, normals)
    assert np.median(missed[known]) < 0.2 * np.median(off(plain, normals)[known])
    assert (missed < 2.448 * found.normal_sd)[known].mean() > 0.85


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.zeros((SIDE, SIDE)), "a position"),
        (np.full((SIDE, SIDE, 3), np.nan), "not finite in any pixel"),
        (np.broadcast_to(LIGHTS[0], (SIDE, SIDE, 3)), "away from all points"),
        (None, "also give points"),
    ],
)
def test_bad_points_are_a_sentence(points, said):
    with pytest.raises(InputError, match=said):
        photometric_stereo(np.ones((8, SIDE, SIDE)), LIGHTS, points=points)
