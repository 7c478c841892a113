"""Tests light directions from shading against those of the rig: signs, order, one light,
outlines."""

import re

import numpy as np
import pytest

from fitting.observation import rig_in_memory
from fitting.reflectance.from_images.read import read_reflectance_observation
from fitting.reflectance.from_images.shading_check import contradictions, directions_by_shading

SIDE, RADIUS = 64, 28.0
HEIGHT = np.linspace(0.95, 0.35, 8)
TURN = 2.4 * np.arange(8)
WIDE = np.sqrt(1 - HEIGHT**2)
LIGHTS = np.stack([WIDE * np.cos(TURN), WIDE * np.sin(TURN), HEIGHT], axis=-1)


def ball(*, specular=0.3, albedo=0.5):
    """Return a matte ball with a Phong lobe under LIGHTS, with sensor noise."""
    y, x = (SIDE - 1) / 2 - np.mgrid[:SIDE, :SIDE][0], np.mgrid[:SIDE, :SIDE][1] - (SIDE - 1) / 2
    flat = (x**2 + y**2) / RADIUS**2
    z = np.sqrt(np.clip(1 - flat, 0, None))
    rng, images = np.random.default_rng(0), []
    for light in LIGHTS:
        cosine = np.clip((x * light[0] + y * light[1]) / RADIUS + z * light[2], 0, None)
        cosine = cosine * (flat < 1)
        mirrored = np.clip(2 * cosine * z - light[2], 0, None) * (cosine > 0)
        electrons = rng.poisson(16000 * (albedo * cosine + specular * mirrored**30))
        images.append(np.clip(np.round(electrons / 4), 0, 4095).astype(np.uint16))
    return images


def observed(images, lights, **sphere):
    files = {f"{i}.tif": image for i, image in enumerate(images)}
    entries = [{"file": f, "direction": v.tolist()} for f, v in zip(files, lights, strict=True)]
    shape = {"centre": [(SIDE - 1) / 2] * 2, "radius": RADIUS} | sphere
    camera = {"bits": 12, "gain": 0.25, "read_noise": 1.0, "black_level": 0.0}
    rig, load = rig_in_memory(files, camera=camera, light=entries, geometry={"sphere": shape})
    return read_reflectance_observation(rig, load=load)


def test_shading_gives_the_directions():
    observation = observed(ball(), LIGHTS)
    shown, told = directions_by_shading(observation)
    assert told.all()
    np.testing.assert_allclose(np.sum(shown * LIGHTS, axis=1), 1, atol=1e-4)  # .8 degrees
    assert contradictions(observation) == []


def test_copies_of_an_image_are_named():
    images = ball()
    images[5], images[7] = images[2], images[2]
    sentences = contradictions(observed(images, LIGHTS))
    assert sentences[0].startswith("Images of equal numbers are copies of one exposure: 2.tif, 5.")
    assert "7.tif" in sentences[0]


def test_an_encoding_found_by_a_fit_is_undone_first():
    encoded = [np.round(4095 * (image / 4095) ** (1 / 2.2)).astype(np.uint16) for image in ball()]
    observation = observed(encoded, LIGHTS)
    assert "the camera's gamma" in contradictions(observation)[0]
    assert contradictions(observation, gamma=2.2) == []


@pytest.mark.parametrize(
    ("lights", "expected"),
    [
        (LIGHTS * [1, -1, 1], "with the sign of y turned around it would be 0°"),
        (LIGHTS * [-1, 1, 1], "with the sign of x turned around it would be 0°"),
        (LIGHTS[:, [1, 0, 2]], "with x and y exchanged it would be 0°"),
        (LIGHTS[::-1], "with the files in another order it would be 0°"),
        (LIGHTS @ [[0.5, 0, 0.75**0.5], [0, 1, 0], [-(0.75**0.5), 0, 0.5]], "the camera's gamma"),
        (np.where(np.arange(8)[:, None] == 3, LIGHTS[6], LIGHTS), "1 of 8 lights .*: 3.tif "),
    ],
    ids=["y", "x", "exchanged", "order", "turned", "one"],
)
def test_contradictions_of_the_rig_are_named(lights, expected):
    images = [image for image, light in zip(ball(), lights, strict=True) if light[2] > 0]
    [sentence] = contradictions(observed(images, lights[lights[:, 2] > 0]))
    assert re.search(expected, sentence), sentence


def test_an_outline_beyond_the_object_is_named():
    [sentence] = contradictions(observed(ball(), LIGHTS, radius=31.5))
    assert "of the object's pixels stay dark under every light" in sentence


def test_a_mirror_gives_no_direction():
    mirror = ball(albedo=2e-3, specular=3.0)
    assert not directions_by_shading(observed(mirror, LIGHTS))[1].any()
