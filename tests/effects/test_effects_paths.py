"""Tests how effects change light between surfaces, against closed forms, sums over small patches in
NumPy, and the path tracer."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects
from jaxvision.rendering import PixelSamples, photograph
from jaxvision.transport import Paths
from jaxvision.transport.paths import path_along

DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
DULL = 0.25  # sr^-1


def view_from(place, rotation=DOWN):
    return jv.Pinhole(place, rotation, 0.05, 0.05 / 32, resolution=(8, 8))


def toward(place, target):
    """Return the rows right, down and forward of a rotation."""
    forward = np.subtract(target, place) / np.linalg.norm(np.subtract(target, place))
    right = np.cross(forward, [0, 0, 1.0])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def bounds(surfaces, lights, view, depth):
    """Return the bounds by name. For "bounces" it is the bound of the longest paths only."""
    found = effects.inspect(jv.Scene(surfaces, lights), view, depth=depth)
    return {effect.name: effect.bound for effect in found}


def patches(corner, u, v, side):
    """Return the centres, (side^2, 3), of the patches of a rectangle, and the area of each."""
    t = (np.arange(side) + 0.5) / side
    s, t = (x.ravel()[:, None] for x in np.meshgrid(t, t))
    area = np.linalg.norm(np.cross(u, v)) / side**2
    return np.add(corner, s * np.array(u) + t * np.array(v)), area


@pytest.mark.parametrize("depth", [2, 3, 4, 5])
def test_emission_is_reflected_in_each_further_segment(depth):
    """Two plates face each other. The roof, which is out of view, emits."""
    floor, roof = ([-0.5, -0.5, z] for z in (0.0, 1.0))
    side, area = 12, 1 / 144
    below, _ = patches(floor, [1, 0, 0], [0, 1, 0], side)
    apart = np.linalg.norm(below[:, None] + [0, 0, 1.0] - below, axis=-1)
    t = DULL * area / apart**4  # f cos cos / r^2 from one plate to the other
    of_floor, of_roof, added = np.zeros(144), np.ones(144), []
    for _ in range(depth - 1):
        of_floor, of_roof = t @ of_roof, t @ of_floor
        added.append(of_floor.max())
    surfaces = [
        jv.Surface(jv.Quad(floor, [1, 0, 0], [0, 1, 0]), jv.Lambert([DULL])),
        jv.Surface(jv.Quad(roof, [0, 1, 0], [1, 0, 0]), jv.Lambert([DULL]), [1.0]),
    ]
    found = bounds(surfaces, [], view_from([0, 0, 0.5]), depth)
    assert sum(added) > 0.1
    assert sum(added) <= found["surfaces[1].emission"]
    assert depth == 2 or added[-1] <= found["bounces"]


ROUGH = 0.6  # rad
IN_A_BRIGHT_BALL = [
    (jv.NormalisedPhong([0.1], [0.5], 300.0), "specular", 0.5),
    (jv.TorranceSparrow([0.1], [0.5], 0.05), "specular", 0.98 * 0.5),
    (jv.OrenNayar([0.1], ROUGH), "sigma", np.pi * 0.1 * 0.5 * ROUGH**2 / (ROUGH**2 + 0.33)),
]


@pytest.mark.parametrize(("material", "field", "change"), IN_A_BRIGHT_BALL)
def test_lobes_and_rough_facets_reflect_emitted_light(material, field, change):
    """The irradiance is from a uniform radiance of 1, and the view along the normal."""
    plate = jv.Surface(jv.Disc([0, 0, 0], [0, 0, 1], 0.1), material)
    ball = jv.Surface(jv.Sphere([0, 0, 0], 2.0), jv.Lambert([0.0]), [1.0], two_sided=True)
    found = bounds([plate, ball], [], view_from([0, 0, 1]), 2)
    assert change <= found[f"surfaces[0].material.{field}"] * (1 + 1e-9)


def test_a_narrow_lobe_collects_the_light_of_a_small_bright_surface():
    """A lamp shines up at a small roof, whose light the floor's lobe reflects. In the centre, seen
    from above, the radiance is the sum over the roof's patches of k_s (n + 2) / (2 pi) cos^n times
    the cosine."""
    n, k_s, width = 3000.0, 0.9, 0.2
    lamp = np.array([0, 0, 1.0])
    corner = [-width / 2, -width / 2, 2.0]
    places, area = patches(corner, [width, 0, 0], [0, width, 0], 300)
    from_lamp = np.linalg.norm(places - lamp, axis=1)
    roof = DULL / from_lamp**4  # at height 1, cos = 1 / r at both ends
    apart = np.linalg.norm(places, axis=1)
    cos = 2 / apart
    lobe = k_s * (n + 2) / (2 * np.pi) * cos ** (n + 1)
    seen = np.sum(roof * lobe * cos * area / apart**2)
    surfaces = [
        jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.NormalisedPhong([0.0], [k_s], n)),
        jv.Surface(jv.Quad(corner, [0, width, 0], [width, 0, 0]), jv.Lambert([DULL])),
    ]
    lights = [jv.SmallLight(lamp, [0, 0, 1.0], [1.0])]
    found = bounds(surfaces, lights, view_from([0, 0, 0.5]), 3)
    assert seen > 0.9 * k_s * DULL
    assert seen <= found["bounces"]
    assert seen <= found["surfaces[0].material.specular"]
    assert seen <= found["lights[0]"]


def test_a_lobe_that_points_away_from_the_eye_lights_what_is_seen():
    """A small glossy floor reflects a lamp onto a matte wall, the only thing in view. The reference
    sums over patches of the floor for the wall's centre."""
    n, k_s, width = 300.0, 0.9, 0.5
    lamp, wall = np.array([-1.0, 0, 1]), np.array([1.0, 0, 1])
    facing = np.array([-1.0, 0, -1]) / np.sqrt(2)
    corner = [-width / 2, -width / 2, 0.0]
    places, area = patches(corner, [width, 0, 0], [0, width, 0], 60)
    to_lamp, to_wall = lamp - places, wall - places
    near, far = (np.linalg.norm(x, axis=1) for x in (to_lamp, to_wall))
    mirrored = to_lamp * [-1, -1, 1] / near[:, None]
    off = np.sum(mirrored * to_wall, axis=1) / far
    floor = k_s * (n + 2) / (2 * np.pi) * off**n * to_lamp[:, 2] / near**3
    lit = floor * to_wall[:, 2] / far * (-to_wall @ facing / far) * area / far**2
    seen = DULL * np.sum(lit)
    across = np.array([0.2, 0, -0.2])
    surfaces = [
        jv.Surface(
            jv.Quad(corner, [width, 0, 0], [0, width, 0]), jv.NormalisedPhong([0.0], [k_s], n)
        ),
        jv.Surface(
            jv.Quad(wall - across / 2 - [0, 0.1, 0], [0, 0.2, 0], across), jv.Lambert([DULL])
        ),
    ]
    assert np.cross([0, 0.2, 0], across) @ facing > 0
    eye = [-0.5, -2.0, 0.5]
    view = view_from(eye, toward(eye, wall))
    found = bounds(surfaces, [jv.PointLight(lamp, [1.0])], view, 3)
    assert seen > 0.01
    assert seen <= found["bounces"]
    assert seen <= found["lights[0]"]


def test_glass_around_the_eye_or_of_a_low_index_increases_radiance():
    """Inside a body of index n the radiance is up to n^2 times the outside one. For light that
    leaves a bubble of index n < 1 the factor is up to 1 / n^2, and through a glass ball at most
    1."""
    sky = jv.environment_map(np.ones((4, 8, 1)))

    def of_sky(index, place):
        ball = jv.Surface(jv.Sphere([0, 0, 0], 1.0), jv.Glass(index))
        return bounds([ball], [sky], view_from(place), 3)["lights[0]"]

    straight = [1 - ((n - 1) / (n + 1)) ** 2 for n in (1.5, 1.0)]
    assert of_sky(1.5, [0, 0, 0.0]) >= straight[0] * 1.5**2
    assert of_sky(1.5, [0, 0, 3.0]) < 4
    shining = jv.Surface(jv.Sphere([0, 0, 0], 0.1), jv.Lambert([0.0]), [1.0])
    bubble = jv.Surface(jv.Sphere([0, 0, 0], 1.0), jv.Glass(1 / 1.5))
    found = bounds([bubble, shining], [], view_from([0, 0, 3.0]), 2)
    assert found["surfaces[1].emission"] >= straight[0] * 1.5**2


def of_random_records(seed):
    """Return a floor, a wall and two balls with random lobes and bodies, some of which emit, and a
    lamp. The structure is always the same, so that one program renders all."""
    rng = np.random.default_rng(seed)
    some = lambda most: rng.uniform(0, most, 1) * rng.choice([1, 1, 1e-3])  # noqa: E731
    shine = lambda: rng.choice([0, 1, 1e-2]) * rng.uniform(0.5, 1, 1)  # noqa: E731
    place = lambda: rng.uniform([-1, -1, 0.6], [1, 1, 2])  # noqa: E731
    lobe = jv.NormalisedPhong(some(0.15), some(0.5), rng.choice([1.0, 20.0, 300.0]))
    facets = jv.TorranceSparrow(some(0.15), some(0.5), rng.choice([0.1, 0.5]))
    rough = jv.OrenNayar(some(0.3), rng.uniform(0.1, 1))
    surfaces = [
        jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), lobe, shine()),
        jv.Surface(jv.Quad([-1, 1, 0], [2, 0, 0], [0, 0, 2]), jv.Lambert(some(0.3)), shine()),
        jv.Surface(jv.Sphere(place(), rng.uniform(0.1, 0.5)), facets, shine()),
        jv.Surface(jv.Sphere(place(), rng.uniform(0.1, 0.5)), rough, shine()),
    ]
    lights = [jv.PointLight(rng.uniform([-2, -2, 2.6], [2, 0, 4]), rng.uniform(0.1, 5, 1))]
    eye = rng.uniform([-1, -4, 1], [1, -3, 3])
    view = jv.Pinhole(eye, toward(eye, [0, 0, 0.5]), 1.0, 0.2, resolution=(4, 4))
    return jv.Scene(surfaces, lights), view, int(rng.integers(2, 6))


def without(scene, name):
    """Return the scene with one effect set to 0."""
    surfaces, lights = list(scene.surfaces), list(scene.lights)
    if name == "lights[0]":
        return replace(scene, lights=(replace(lights[0], intensity=0 * lights[0].intensity),))
    i, field = int(name[9]), name.rsplit(".", 1)[1]
    own = surfaces[i]
    if field == "emission":
        surfaces[i] = replace(own, emission=0 * own.emission)
    else:
        value = 0 * getattr(own.material, field)
        surfaces[i] = replace(own, material=replace(own.material, **{field: value}))
    return replace(scene, surfaces=tuple(surfaces))


@jax.jit
def drawn(scene, view, depth):
    samples = PixelSamples(jax.random.key(0), 128)
    return photograph(path_along(scene, Paths(128), depth=depth), view, samples)


def surely_changed(full, small):
    """Return the largest change of a pixel beyond five standard errors."""
    error = np.hypot(full.error, small.error)
    return np.max(np.abs(full.radiance - small.radiance) - 5 * error)


@pytest.mark.slow
def test_random_scenes_by_paths():
    """Effects are set to 0 one by one, and all droppable ones at three tolerances, in the path
    tracer."""
    changed = 0
    for seed in range(12):
        scene, view, depth = of_random_records(seed)
        full = drawn(scene, view, jnp.asarray(depth))
        level = float(full.radiance.max())
        for effect in effects.inspect(scene, view, depth=depth):
            if effect.name.endswith((".emission", ".specular", ".sigma", "lights[0]")):
                small = drawn(without(scene, effect.name), view, jnp.asarray(depth))
                change = surely_changed(full, small)
                assert change <= effect.bound, (seed, effect)
                changed += change > 0
        for tolerance in ("0%", "1%", "10%"):
            pruned = effects.prune(scene, view, tolerance, depth=depth, level=level)
            left = scene
            for effect in pruned.certificate.dropped:
                if effect.name.startswith(("surfaces", "lights")):
                    left = without(left, effect.name)
            small = drawn(left, view, jnp.asarray(pruned.depth))
            assert surely_changed(full, small) <= pruned.certificate.total * level, (
                seed,
                tolerance,
            )
    assert changed > 20, changed


SHEETS = [
    jv.Quad([-50, -50, 0], [100, 0, 0], [0, 100, 0]),
    jv.Disc([0, 0, 0], [0, 0, 1], 50.0),
    jv.TriangleMesh(
        [[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0.0]], [[0, 1, 2], [0, 2, 3]]
    ),
]


@pytest.mark.parametrize("sheet", SHEETS, ids=lambda sheet: type(sheet).__name__)
def test_an_open_sheet_of_glass_that_is_hit_from_behind(sheet):
    """Radiance divided by the square of the index is conserved."""
    n, a, way = 1.33, 0.3, 5.0
    seen = n**2 * (1 - ((n - 1) / (n + 1)) ** 2)
    wall = jv.Surface(
        jv.Quad([-200, -200, way], [0, 400, 0], [400, 0, 0]), jv.Lambert([0.0]), emission=[1.0]
    )
    view = view_from([0, 0, -2.0], np.eye(3))
    found = bounds([jv.Surface(sheet, jv.Glass(n)), wall], [], view, 2)
    assert seen <= found["surfaces[1].emission"] <= 1.05 * seen
    small = hundredth(sheet)
    found = bounds([jv.Surface(small, jv.Glass(n, absorption=[a])), wall], [], view, 2)
    assert found["surfaces[0].material.absorption"] >= seen * (1 - np.exp(-a * 2.0))


def hundredth(sheet):
    """Return a shape scaled by a hundredth."""
    match sheet:
        case jv.Quad():
            return jv.Quad(
                *(0.01 * np.asarray(x) for x in (sheet.corner, sheet.edge_u, sheet.edge_v))
            )
        case jv.Disc():
            return replace(sheet, radius=0.5)
    return replace(sheet, vertices=0.01 * np.asarray(sheet.vertices))


def test_a_ball_of_glass_adds_no_light():
    wall = jv.Surface(jv.Quad([-9, -9, 5], [0, 18, 0], [18, 0, 0]), jv.Lambert([0.0]), [1.0])
    ball = jv.Surface(jv.Sphere([0, 0, 2.0], 0.5), jv.Glass(1.5))
    found = bounds([ball, wall], [], view_from([0, 0, -2.0], np.eye(3)), 3)
    assert 1 <= found["surfaces[1].emission"] <= 2 + 1e-9  # at most once per further segment
