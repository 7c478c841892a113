"""Tests full shadows and the reach of shadows against sampled segments, and by hand."""

import numpy as np
import pytest
from oracles.direct_light import hit
from oracles.random_scenes import Draw
from test_effects_bodies import segments, twice

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects.blocking import may_block
from jaxvision.effects.cells import cells_of, eye_of
from jaxvision.effects.illumination import source_of
from jaxvision.effects.radiance import scene_stage
from jaxvision.effects.stages import Ends
from jaxvision.effects.umbra import hidden, shaded, umbra_flags

GREY = jv.Lambert([0.25])
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
VIEW = jv.Pinhole([0, 0, 3], DOWN, 0.05, 0.05 / 16, resolution=(16, 16))


def lamp(draw):
    """Return a point, a rectangle or a direction that shines down on everything."""
    x, y = draw.rng.uniform(-1, 1, 2)
    kind = draw.rng.integers(3)
    if kind == 0:
        return jv.PointLight([x, y, 2], [1.0])
    if kind == 1:
        return jv.DirectionalLight([x, y, 2], [1.0])
    return jv.RectangleLight([x, y, 2], [0, 0.3, 0], [0.3, 0, 0], [1.0])


@pytest.mark.parametrize("count", [10, pytest.param(1000, marks=pytest.mark.slow)])
def test_proved_shadows_are_full_and_no_segment_is_blocked_out_of_reach(count):
    """A screen is between lamp and receiver. At least 70 % of the screens that block all segments
    are proved to do so."""
    whole = proved = reached = 0
    for seed in range(count):
        draw = Draw(seed)
        light, size = lamp(draw), draw.rng.uniform(0.2, 2)
        screen = jv.Quad([-size, -size, 1], [2 * size, 0, 0], [0, 2 * size, 0])
        if draw.rng.random() < 0.3:
            screen = jv.Disc([0, 0, 1], [0.1, 0, 1.0], size)
        surfaces = [twice(jv.Surface(shape, GREY)) for shape in (draw.shape(), screen)]
        p, to = segments(light, surfaces[0].low, draw.rng, 2048)
        if not len(p):
            continue
        d = to - p
        length = np.linalg.norm(d, axis=1)
        met = hit(screen, p, d / length[:, None])[0] < length - 2e-6
        source, cells = source_of(twice(light)), cells_of(surfaces, about=np.zeros(3))
        dark = umbra_flags([source], surfaces, cells)[0]
        own = cells.surface == 0
        here = own & (np.linalg.norm(p[:, None] - cells.centre, axis=2) <= cells.radius + 1e-9)
        assert here.any(1).all()
        assert met[(dark | ~here).all(1)].all(), f"seed {seed}"
        assert met.all() or not dark[own].all(), f"seed {seed}"
        assert not umbra_flags([source], surfaces, cells, occluders=()).any()
        whole, proved = whole + met.all(), proved + dark[own].all()
        every = np.ones((1, len(cells.radius)), bool)
        within = shaded([source], surfaces, cells, may=may_block([source], surfaces), wanted=every)
        assert (here & within)[met].any(1).all(), f"seed {seed}"
        reached += within[0, own].any()
    assert proved >= 0.7 * whole > 0
    assert reached < count


@pytest.mark.parametrize("depth", [0.0, 1e-9, 0.1])
def test_surfaces_in_the_plane_of_an_occluder_are_not_in_its_shadow(depth):
    """A sheet on the floor and a box flush with it see the lamp. The floor below them does not."""
    floor = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), GREY)
    sheet = jv.Surface(jv.Disc([0, 0, -depth], [0, 0, 1.0], 0.2), GREY)
    flush = jv.Surface(jv.Box([0.5, 0, -0.1 - depth], [0.1, 0.1, 0.1]), GREY)
    surfaces = [twice(own) for own in (floor, sheet, flush)]
    cells = cells_of(surfaces, about=np.zeros(3))
    sources = [source_of(twice(jv.PointLight([0, 0, 2], [1.0])))]
    up = cells.axis[:, 2] > 0.9
    assert umbra_flags(sources, surfaces, cells)[0, up & (cells.surface > 0)].any() == (
        depth > 0.01
    )
    assert not umbra_flags(sources, surfaces, cells)[0, cells.surface == 0].any()


@pytest.mark.parametrize(("size", "seen"), [(0.6, False), (0.1, True)])
def test_a_wall_hides_surfaces_behind_it_from_the_eye(size, seen):
    """A pixel sees a lamp and a floor only past a small wall."""
    wall = jv.Surface(jv.Quad([-size, -size, 2], [2 * size, 0, 0], [0, 2 * size, 0]), GREY)
    floor = jv.Surface(jv.Quad([-0.5, -0.5, 0], [1, 0, 0], [0, 1, 0]), GREY)
    up = jv.RectangleLight([-0.2, -0.2, 1], [0.4, 0, 0], [0, 0.4, 0], [1.0])
    scene = jv.Scene([wall, floor], [up, jv.PointLight([0, 0, 1.5], [1.0])])
    rows, _, onward = scene_stage(Ends(scene, scene), Ends(VIEW, VIEW))
    assert ("may be seen" in rows[0].effect.why) == seen
    sums = onward.sums
    assert sums.seen[sums.cells.surface == 1].any() == seen
    assert sums.seen[sums.cells.surface == 0].any()


def test_a_lamp_above_the_ceiling_is_dropped_unless_shadows_were():
    """The lamp is in full shadow, so its bound is zero. Without shadows it lights the floor."""
    floor = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), GREY)
    roof = jv.Surface(jv.Quad([-1, -1, 3.5], [0, 2, 0], [2, 0, 0]), GREY)
    lights = [jv.PointLight([0, 0, 5], [1.0]), jv.PointLight([0, 0, 2], [1.0])]
    scene = jv.Scene([floor, roof], lights)
    rows, _, _ = scene_stage(Ends(scene, scene), Ends(VIEW, VIEW))
    row = rows[0]
    assert (row.effect.name, row.effect.rank, row.effect.bound) == ("lights[0]", "exact", 0)
    assert row.after is not None
    assert np.max(row.after(frozenset({"shadows[0]"}))) == pytest.approx(0.25 / 25)
    left = effects.prune(scene, VIEW, "0%", level=1.0)
    assert [float(light.position[2]) for light in left.scene.lights] == [2.0]
    bare = jv.Scene([floor, roof], lights, occluders=())
    bound = effects.inspect(bare, VIEW)[0].bound
    assert bound == pytest.approx(0.25 / 25)


@pytest.mark.parametrize(("place", "unseen"), [((0, 0, 3), True), ((0, 0, 0.1), False)])
def test_the_inside_of_a_ball_is_seen_only_from_inside(place, unseen):
    ball = twice(jv.Surface(jv.Sphere([0, 0, 0], 1.0), GREY, two_sided=True))
    cells = cells_of([ball], about=np.zeros(3))
    view = jv.Pinhole(place, DOWN, 0.05, 0.001, resolution=(8, 8))
    found = hidden([ball], cells, eye_of(twice(view)))
    inner = (cells.centre * cells.axis).sum(1) < 0
    assert inner.any()
    assert np.array_equal(found, inner & unseen)


def test_a_light_of_free_direction_casts_shadows_beside_its_centre():
    """A screen is next to the column above a tile. A sun that tilts up to 11 degrees from upright
    casts its shadow on the tile, and one that tilts up to 1 degree does not."""
    tile = twice(jv.Surface(jv.Quad([-0.1, -0.1, 0], [0.2, 0, 0], [0, 0.2, 0]), GREY))
    screen = twice(jv.Surface(jv.Sphere([1.0, 0, 8], 0.3), GREY))
    for tilt, expected in ((0.2, True), (0.02, False)):
        low, high = (jv.DirectionalLight([x, 0, 1.0], [1.0]) for x in (-tilt, tilt))
        over = np.linspace(-tilt, tilt, 41)[:, None] * [1, 0, 0] + [0, 0, 1.0]
        over /= np.linalg.norm(over, axis=1)[:, None]
        shaded_at = np.isfinite(hit(screen.low.shape, np.zeros((41, 3)), over)[0]).any()
        assert shaded_at == expected
        assert may_block([source_of(Ends(low, high))], [tile, screen])[0, 0, 1] == expected
