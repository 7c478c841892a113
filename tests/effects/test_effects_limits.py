"""Tests pruning with numbers that are not finite, with meaningless words, and with paths of any
length."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects import bounces, seconds
from jaxvision.lights.rectangle import _small_light as small_light
from jaxvision.rendering import render

GREY = jv.Lambert([0.25])
FLOOR = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), GREY)
ROOF = jv.Surface(jv.Quad([-1, -1, 4], [0, 2, 0], [2, 0, 0]), GREY)
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
VIEW = jv.Pinhole([0, 0, 3], DOWN, 0.05, 0.05 / 8, resolution=(8, 8))
POINT = jv.PointLight([0, 0, 2], [1.0])
BALL = jv.Sphere([0, 0, 0.5], 0.2)


@pytest.mark.parametrize(
    ("surfaces", "lights", "name"),
    [
        ([FLOOR], [POINT, replace(POINT, position=[0, 0, np.nan])], "lights[1].position"),
        ([FLOOR], [POINT, replace(POINT, position=[0, 0, np.inf])], "lights[1].position"),
        ([FLOOR], [POINT, replace(POINT, intensity=[np.nan])], "lights[1].intensity"),
        (
            [FLOOR, jv.Surface(replace(BALL, centre=[0, np.nan, 0]), GREY)],
            [POINT],
            "surfaces[1].shape.centre",
        ),
    ],
)
def test_no_effect_is_dropped_if_a_number_is_not_finite(surfaces, lights, name):
    """A lamp at NaN makes the whole picture NaN, and must not be dropped as one without effect."""
    pruned = effects.prune(jv.Scene(surfaces, lights), VIEW, "10%", level=1.0)
    assert not pruned.certificate.dropped
    for effect in pruned.certificate.kept:
        assert effect.bound == np.inf
        assert effect.why.startswith(f"{name} is not finite")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"level": np.inf}, "above 0 and finite"),
        ({"level": np.nan}, "above 0 and finite"),
        ({"level": 0.0}, "is black; leave the tolerance out"),
        ({"depth": 0}, "depth must be a whole number of segments, at least 1"),
        ({"moments": 0}, "moments must be at least 1"),
    ],
)
def test_numbers_out_of_range_are_refused(options, sentence):
    with pytest.raises(jv.InputError, match=sentence):
        effects.prune(jv.Scene(FLOOR, POINT), VIEW, "1%", **{"level": 1.0} | options)


def test_no_tolerance_drops_effects_without_a_bound():
    with pytest.raises(jv.InputError, match="finite"):
        effects.Tolerance(np.inf)
    with pytest.raises(jv.InputError, match="a number and its unit"):
        effects.parse("1e400%")
    with pytest.raises(jv.InputError, match="place"):
        effects.parse("1%", place=np.nan)


def test_paths_of_any_length_are_bounded_in_a_few_rows():
    """Two plates send each other at most rho F of their light."""
    scene = jv.Scene([FLOOR, ROOF], [POINT])
    found = effects.inspect(scene, VIEW, depth=100_000)
    bounds = np.array([effect.bound for effect in found if effect.name == "bounces"])
    assert 20 < len(bounds) < 60
    assert np.all(bounds > 0)
    assert np.all(np.diff(bounds) <= 0)
    few = [e.bound for e in effects.inspect(scene, VIEW, depth=30) if e.name == "bounces"]
    assert few[:9] == pytest.approx(bounds[:9], rel=1e-6)


def test_the_second_derivative_of_a_small_lamp():
    """The 12 of `effects.extent` is the largest second difference along a line, over random planes
    and positions."""
    rng = np.random.default_rng(0)
    normal, along, apart = (rng.normal(size=(20_000, 3)) for _ in range(3))
    normal[:100] = apart[:100] = along[:100]  # the largest case
    normal, along, apart = (x / np.linalg.norm(x, axis=1)[:, None] for x in (normal, along, apart))

    def integrand(h):
        moved = apart + h * along
        return (normal * moved).sum(1) / np.linalg.norm(moved, axis=1) ** 4

    h = 1e-4
    second = (integrand(h) - 2 * integrand(0) + integrand(-h)) / h**2
    assert 11.99 < np.abs(second).max() < 12.01


def test_effects_with_the_same_remaining_program_share_its_time(monkeypatch):
    """A scene where one of several glossy balls becomes matte has the same program, whichever ball
    it is. So do paths of all lengths."""
    asked = {}

    def in_turns(runs, advance):
        asked.update(runs)
        return dict.fromkeys(runs, 1.0)

    monkeypatch.setattr(seconds, "_median_seconds", in_turns)
    shiny = jv.Phong([0.2], [0.1], 20.0)
    balls = [jv.Surface(replace(BALL, centre=[x, 0, 0.5]), shiny) for x in (-0.5, 0.0, 0.5)]
    found = effects.inspect(jv.Scene([FLOOR, *balls], [POINT]), VIEW, depth=5, time=True)
    taken = [effect.seconds for effect in found if "specular" in effect.name]
    assert taken == [0.0] * 3
    lengths = {kind[-1][1] for kind in asked if kind[0] == "scene"}
    assert lengths == {2, 3, 4, 5}
    # the whole scene, without the lamp, with one matte ball
    assert len({kind[:-1] for kind in asked if kind[0] == "scene"}) == 3


def test_shadows_that_are_not_traced_save_nothing():
    """One convex shape, or a scene without occluders, traces no shadows anyway."""
    balls = [FLOOR, jv.Surface(BALL, GREY)]
    for scene, saves in (
        (jv.Scene([FLOOR], [POINT]), 0.02),
        (jv.Scene(balls, [POINT], occluders=()), 0.02),
        (jv.Scene(balls, [POINT]), 0.4),
    ):
        (shadows,) = (e for e in effects.inspect(scene, VIEW) if e.name == "shadows[0]")
        assert shadows.saves == saves


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize(
    "material",
    [
        jv.Phong([0.1], [1.0], 1.0),
        jv.GaussianLobe([0.1], [1.0], 0.5),
        jv.GaussianLobeBRDF([0.0], [1.0], 0.05),
    ],
    ids=lambda material: type(material).__name__,
)
def test_a_lamp_cut_by_the_horizon_is_bounded_as_a_point(material):
    """A lobe without a cosine ends abruptly at the horizon, so half of the lamp is cut off, or all
    of it as a point."""
    floor = jv.Surface(jv.Quad([-0.5, -0.5, 0], [1, 0, 0], [0, 1, 0]), material)
    r = np.sqrt(0.5)
    view = jv.Pinhole(
        [-2.0, 0, 2], [[0, -1, 0], [-r, 0, -r], [r, 0, -r]], 1.0, 0.02, resolution=(2, 2)
    )
    rule = jv.Quadrature(8)
    for middle, half in ((0.0, 0.005), (0.02, 0.1)):
        lamp = jv.RectangleLight(
            [10.0, -half, middle - half], [0, 0, 2 * half], [0, 2 * half, 0], [1e4]
        )
        scene = jv.Scene(floor, lamp, occluders=())
        (bound,) = (e.bound for e in effects.inspect(scene, view) if e.name == "lights[0].extent")
        place = replace(scene, lights=(small_light(lamp),))
        full, small = (jax.jit(render)(one, view, rule=rule) for one in (scene, place))
        assert float(jnp.abs(full - small).max()) <= bound * (1 + 1e-9)


def test_a_picture_without_a_finite_pixel_is_named_as_such():
    scene = jv.Scene(FLOOR, replace(POINT, intensity=[np.nan]))
    with pytest.raises(jv.InputError, match="no pixel of the picture is finite and lit"):
        effects.prune(scene, VIEW, "1%")


@pytest.mark.parametrize("text", ["0%", "0DN", "0sigma", "0"])
def test_a_tolerance_of_zero_moves_nothing(text):
    found = effects.parse(text)
    assert (found.value, found.place, found.rare) == (0, 0, 0)
    assert effects.Tolerance(0.0) == effects.parse("0")
    given = effects.parse(text, place=0.2, rare=0.5)
    assert (given.place, given.rare) == (0.2, 0.5)
    assert (effects.parse("1%").place, effects.Tolerance(0.1).rare) == (0.1, 0.01)


def test_a_blur_below_a_tenth_of_a_pixel_stays_at_a_tolerance_of_zero():
    """The blur by the lens equation is r z_i |1 / z - 1 / z_f| over the pitch."""
    view = jv.ThinLens(
        np.zeros(3), np.eye(3), 0.05, 1e-4, f_number=4.0, focus_distance=1.0, resolution=(4, 4)
    )
    card = jv.Quad([-0.01, -0.01, 1.02], [0, 0.02, 0], [0.02, 0, 0])
    scene = jv.Scene([jv.Surface(card, jv.Lambert([0.3]), [1.0])], [])
    pixels = 0.05 / 8 / (1 / 0.05 - 1) * (1 - 1 / 1.02) / 1e-4
    samples = jv.PixelSamples(jax.random.key(0), 4)
    for tolerance, kind in (("0%", jv.ThinLens), ("1%", jv.Pinhole)):
        left = effects.prune(scene, view, tolerance, level=1.0, samples=samples)
        assert type(left.camera) is kind
    assert left.certificate.place == pytest.approx(pixels, rel=1e-6)


def test_bounds_of_paths_in_a_large_scene_are_quick_and_not_too_small(monkeypatch):
    """With 270 balls, shares are added without their order, and the tail follows the norm."""
    rng = np.random.default_rng(5)
    places = rng.uniform(-1, 1, (270, 2))
    glossy = jv.Phong([0.1], [0.2], 20.0)
    balls = [
        jv.Surface(jv.Sphere([x, y, 0.1], 0.03), glossy if k % 90 == 0 else GREY)
        for k, (x, y) in enumerate(places)
    ]
    scene = jv.Scene([FLOOR, *balls], [POINT])
    quick = effects.inspect(scene, VIEW, depth=5)
    monkeypatch.setattr(bounces, "_ORDERED", np.inf)
    slow = effects.inspect(scene, VIEW, depth=5)
    ratios = [one.bound / other.bound for one, other in zip(quick, slow, strict=True) if one.bound]
    assert len(ratios) > 7
    assert min(ratios) > 1 - 1e-9
    assert max(ratios) < 1.5
