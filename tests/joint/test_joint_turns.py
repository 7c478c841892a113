"""Tests joint fits with stated errors of light directions of one degree, which are estimated from
the images."""

import numpy as np
import pytest
from oracles.sphere_photographs import expose, light_directions, shade

from fitting.joint import calibrate, from_photographs
from fitting.joint.fit import likeliest_turns
from fitting.reflectance.from_images.lights import shift_lights
from fitting.rig import Camera, SphereGeometry

SIZE, RADIUS, LIGHT, GAIN, READ = 40, 18.0, 3000.0, 0.25, 6.0
TRUTH = {"diffuse": 0.4, "specular": 0.45, "exponent": 40.0}
SD = np.radians(1.0)
CAMERA = Camera(
    bits=12, black_level=60.0, black_sd=0.5, gain=GAIN, gain_sd=0.01, read_noise=READ, prnu_sd=0.0
)


def off(lights, rng):
    """Return the directions with random errors along two axes perpendicular to each."""
    step = SD * rng.standard_normal(lights.shape)
    moved = lights + step - np.sum(step * lights, axis=1, keepdims=True) * lights
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def photographed(lights, rng):
    """Return photographs of a Phong sphere in DN, (lights, SIZE, SIZE)."""
    nodes, shares = np.polynomial.legendre.leggauss(4)  # positions in a pixel, along each side
    at = (np.arange(SIZE)[:, None] + nodes / 2).ravel() - (SIZE - 1) / 2
    row, column = np.meshgrid(at, at, indexing="ij")
    x, y = column / RADIUS, -row / RADIUS
    inside = x**2 + y**2 < 1
    normal = np.stack([x, y, np.sqrt(np.where(inside, 1 - x**2 - y**2, np.nan))], axis=-1)
    surface = (TRUTH[name] for name in ("diffuse", "specular", "exponent"))
    signal = shade(normal, lights, "phong", *surface)
    signal = signal.reshape(-1, SIZE, 4, SIZE, 4)
    signal = np.einsum("liajb,a,b->lij", signal, shares / 2, shares / 2)
    return expose(rng, LIGHT * signal, gain=GAIN, read_noise=READ, black=60, clip=4095)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_light_directions_wrong_by_a_degree_are_estimated_without_bias(seed):
    """With the stated directions, k_s and the exponent were biased by 6 standard errors."""
    rng = np.random.default_rng(seed)
    lights = light_directions(12, seed=rng)
    actual = off(lights, rng)
    middle = (SIZE - 1) / 2
    measurement = from_photographs(
        list(photographed(actual, rng)),
        lights,
        camera=CAMERA,
        sphere=SphereGeometry(centre=(middle, middle), radius=RADIUS),
        intensities=np.full(12, LIGHT),
        direction_sd=SD,
        held_out=[11],
    )
    found = calibrate(measurement)
    (fit,) = found.fits
    posterior = found.posteriors["grey"]
    error = np.sqrt(np.diagonal(posterior.covariance))
    for i, parameter in enumerate(fit.space):
        if parameter.name in TRUTH:
            miss = fit.vector[i] - np.log(TRUTH[parameter.name])
            assert abs(miss) < 3.5 * error[i], parameter.name
    turns = likeliest_turns(fit)
    assert turns is not None
    across = np.zeros((12, 2))
    across[fit.grid.lights] = turns[0].T
    seen = shift_lights(measurement, across)
    cosine = np.sum(seen.wi[:11, 0] * actual[:11], axis=1)
    assert np.degrees(np.arccos(np.minimum(cosine, 1))).max() < 0.1
