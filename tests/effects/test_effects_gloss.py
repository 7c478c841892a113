"""Tests surfaces in focus that look different from each part of a lens, against sums over the lens
in NumPy and pictures."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects
from jaxvision.brdf import shading
from jaxvision.rendering import PixelSamples

FOCAL, DISTANCE = 0.05, 0.5
LAMP = np.array([0.03, 0.02, 0.0])


def lens(f_number, **parts):
    parts = {"focus_distance": DISTANCE, "resolution": (3, 3), **parts}
    return jv.ThinLens(np.zeros(3), np.eye(3), FOCAL, 5e-4, f_number=f_number, **parts)


def facing(material, **parts):
    """Return a card in focus."""
    return jv.Surface(
        jv.Quad([-0.15, -0.15, DISTANCE], [0, 0.3, 0], [0.3, 0, 0]), material, **parts
    )


def defocus(scene, view, **asked):
    return {row.name: row for row in effects.inspect(scene, view, **asked)}["view.defocus"]


def normalised(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def glints(exponent, f_number):
    """Return the radiance of a PhongBRDF with k_s = 1 at points in the picture, seen by the whole
    lens and by its centre."""
    side = np.linspace(-0.01, 0.01, 41)
    x = np.stack([*np.meshgrid(side, side), np.full((41, 41), DISTANCE)], -1).reshape(-1, 1, 3)
    radius = FOCAL / f_number / 2
    r, turn = np.meshgrid(np.sqrt((np.arange(12) + 0.5) / 12), 2 * np.pi * np.arange(24) / 24)
    points = radius * np.stack([r * np.cos(turn), r * np.sin(turn), 0 * r], -1).reshape(-1, 3)
    to_light = LAMP - x
    wi = normalised(to_light)
    cos_i = -wi[..., 2]
    mirrored = wi * [-1, -1, 1]
    irradiance = cos_i / (to_light**2).sum(-1)

    def radiance(place):
        cosine = (mirrored * normalised(place - x)).sum(-1)
        return irradiance * np.maximum(cosine, 0) ** exponent

    return radiance(points).mean(1), radiance(np.zeros((1, 3)))[:, 0]


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("exponent", "f_number"), [(100, 2.0), (1000, 2.0), (30, 8.0), (100, 16.0)]
)
def test_a_glossy_card_in_focus_differs_over_the_lens(exponent, f_number):
    by_lens, by_middle = glints(exponent, f_number)
    scene = jv.Scene([facing(jv.PhongBRDF([0.1], [1.0], exponent))], jv.PointLight(LAMP, [1.0]))
    view = lens(f_number)
    row, gain = defocus(scene, view), np.pi / (4 * f_number**2) * (1 - FOCAL / DISTANCE) ** 2
    changed = np.abs(by_lens - by_middle).max() * gain
    assert row.place == 0
    assert changed > 1e-4 * by_middle.max() * gain
    assert changed <= row.bound <= 2 * by_middle.max() * gain
    if f_number > 10:  # where the bound on the slope applies, it is far below the glint
        assert row.bound <= 0.2 * by_middle.max() * gain
    samples = PixelSamples(jax.random.key(0), 4)
    left = effects.prune(scene, view, "0%", samples=samples)
    assert isinstance(left.camera, jv.ThinLens)


def test_a_matte_card_looks_the_same_from_all_of_the_lens():
    """The card is under a lamp and ambient light, and emits light."""
    card = facing(jv.Lambert([0.2], ambient=[0.1]), emission=[0.1])
    lamps = [
        jv.PointLight(LAMP, [1.0]),
        jv.RectangleLight([0, 0, -0.2], [0.1, 0, 0], [0, 0.1, 0], [1.0]),
    ]
    scene = jv.Scene([card], lamps, ambient=jv.AmbientLight([0.2]))
    row = defocus(scene, lens(2.0))
    assert (row.bound, row.place, row.rank) == (0, 0, "exact")


@pytest.mark.sweep
@pytest.mark.parametrize(
    "material",
    [
        jv.TorranceSparrow([0.1], [0.5], 0.3),
        jv.OrenNayar([0.2], 0.5),
        jv.EON([0.2], 0.7),
        jv.OrenNayar([0.2], 0.5, form="full"),
        jv.NormalisedBlinn([0.1], [0.5], 20.0),
        jv.GaussianLobeBRDF([0.1], [0.5], 4.0),
        jv.Dichromatic(jv.OrenNayar([0.2], 0.4), jv.Phong([0.0], [0.3], 9.0), [1.0], [1.0]),
    ],
    ids=lambda material: type(material).__name__,
)
def test_the_bound_holds_between_any_two_points_of_the_lens(material):
    """The radiance from points of a card varies over the rim of the lens by at most the bound."""
    place = np.array([0.4, 0.1, 0.1])
    rng, frame = np.random.default_rng(0), np.array([1.0, -1, -1])  # the card faces -z
    x = np.concatenate([rng.uniform(-0.01, 0.01, (40, 2)), np.full((40, 1), DISTANCE)], 1)
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    rim = FOCAL / 2 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    wo = normalised(rim[:, None] - x)
    wi = np.broadcast_to(normalised(place - x), wo.shape)
    pairs = jax.vmap(jax.vmap(shading, in_axes=(None, 0, 0)), in_axes=(None, 0, 0))
    sent = np.asarray(jax.jit(pairs)(material, wi * frame, wo * frame))
    sent = sent[..., 0] / ((place - x) ** 2).sum(1)
    scene = jv.Scene([facing(material)], jv.PointLight(place, [1.0]))
    bound = defocus(scene, lens(1.0)).bound / (np.pi / 4 * (1 - FOCAL / DISTANCE) ** 2)
    assert 0 < np.ptp(sent, axis=0).max() <= bound


def test_reflections_in_a_mirror_are_not_in_focus():
    """The emitters are behind the camera, seen in a mirror that is in focus. In direct light it
    shows the sky."""
    mirror = facing(jv.Mirror([0.5]))
    sky = jv.environment_map(np.linspace(0, 1, 128).reshape(8, 16, 1))
    for scene, depth in (
        (jv.Scene([mirror], [sky]), None),
        (jv.Scene([mirror, facing(jv.Lambert([0.1]), emission=[1.0])], []), 3),
        (jv.Scene([facing(jv.Glass(1.5))], [sky]), 3),
    ):
        row = defocus(scene, lens(2.0), depth=depth)
        assert np.isinf(row.bound)
        left = effects.prune(
            scene,
            lens(2.0),
            "1%",
            level=1.0,
            depth=depth,
            samples=PixelSamples(jax.random.key(0), 4),
        )
        assert isinstance(left.camera, jv.ThinLens)
    black = replace(mirror, material=jv.Mirror([0.0]))
    assert defocus(jv.Scene([black], jv.PointLight(LAMP, [1.0])), lens(2.0)).bound == 0
