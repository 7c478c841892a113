"""Tests that exactly the surfaces that no ray of direct light hits are dropped, against plain ray
casting in NumPy, which shares no code with the bounds."""

import jax
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects import Tolerance

GREY = jv.Lambert([0.2])
NOTHING = Tolerance(0.0)


def axes_toward(forward, rng=None):
    """Return the rows right, down and forward, rotated about forward at random if `rng` is
    given."""
    forward = forward / np.linalg.norm(forward)
    side = np.array([0.0, 0.0, 1.0]) if rng is None else rng.standard_normal(3)
    right = np.cross(forward, side)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def street(far):
    floor = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), GREY)
    ball = jv.Surface(jv.Sphere([0, 0, 1.0], 0.5), GREY)
    turns = np.arange(far) / 40 * np.pi + np.pi
    balls = [
        jv.Surface(jv.Sphere([1000 * np.cos(t), 1000 * np.sin(t), 1.0], 0.5), GREY) for t in turns
    ]
    return jv.Scene([floor, *balls, ball], jv.PointLight([1, 1, 4.0], [5.0]))


def looking_down(side=16):
    toward = axes_toward(np.array([0.0, 4.0, -1.0]))
    return jv.Pinhole([0, -4, 2.0], toward, 0.03, 0.03 / side, resolution=(side, side))


@pytest.mark.slow
def test_forty_balls_out_of_view_are_not_in_the_program():
    whole, view = street(40), looking_down()
    pruned = effects.prune(whole, view, NOTHING, level=1.0)
    assert len(pruned.scene.surfaces) == 2
    assert jax.tree.structure(pruned.scene) == jax.tree.structure(street(0))
    names = [effect.name for effect in pruned.certificate.dropped]
    assert names == [f"surfaces[{i}]" for i in range(1, 41)]
    assert pruned.certificate.total == 0
    np.testing.assert_array_equal(jv.render(pruned.scene, view), jv.render(whole, view))


def test_a_body_with_a_shadow_or_a_requested_number_is_kept():
    view = looking_down()

    def left(scene, **asked):
        return effects.prune(scene, view, NOTHING, level=1.0, **asked).scene

    def beside(place):
        ball = jv.Surface(jv.Sphere(place, 0.5), GREY)
        scene = street(0)
        return jv.Scene([scene.surfaces[0], ball, scene.surfaces[1]], scene.lights)

    assert len(left(beside([0.0, -9.0, 1.0])).surfaces) == 2  # behind the camera
    over = beside([0.6, 0.6, 3.0])  # out of view, between the lamp and the floor
    assert len(left(over).surfaces) == 3
    away = beside([0.0, -9.0, 1.0])
    assert len(left(away, free={"surfaces[2].shape.radius": (0.4, 0.6)}).surfaces) == 3
    assert len(left(away, free={"surfaces[0].material.diffuse": (0.1, 0.3)}).surfaces) == 2
    assert len(left(away, depth=3).surfaces) == 3  # light bounces to it
    some = jv.Scene(away.surfaces, away.lights, occluders=(1, 2))
    assert left(some).occluders == (1,)


def _hits(shape, origin, way, far):
    """Return (rays,) whether each ray of unit direction hits a shape nearer than `far`."""
    if isinstance(shape, jv.Sphere):
        away = origin - np.asarray(shape.centre)
        b, c = (away * way).sum(1), (away**2).sum(1) - float(shape.radius) ** 2
        root = np.sqrt(np.maximum(b * b - c, 0))
        return (b * b > c) & (-b + root > 0) & (-b - root < far)
    corner, u, v = (np.asarray(x) for x in (shape.corner, shape.edge_u, shape.edge_v))
    system = np.stack([np.broadcast_to(u, way.shape), np.broadcast_to(v, way.shape), -way], -1)
    s, t, distance = np.linalg.solve(system, (origin - corner)[..., None])[..., 0].T
    return (s > 0) & (s < 1) & (t > 0) & (t < 1) & (distance > 0) & (distance < far)


def _random_scene(rng):
    """Return balls and quads near and far, lamps of three types, and a view of three types."""
    surfaces = [jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), GREY)] * int(rng.integers(2))
    for _ in range(int(rng.integers(4, 12))):
        place = rng.normal(0, rng.choice([2.0, 20.0]), 3)
        size = rng.uniform(0.2, 2.0)
        if rng.random() < 0.5:
            shape = jv.Sphere(place, size)
        else:
            u, v = rng.standard_normal((2, 3))
            shape = jv.Quad(place, size * u, size * v)
        surfaces.append(jv.Surface(shape, GREY, two_sided=rng.random() < 0.5))
    lamps = []
    for _ in range(int(rng.integers(1, 3))):
        place, (u, v) = rng.normal(0, 5, 3), rng.standard_normal((2, 3))
        v -= (u @ v) / (u @ u) * u
        lamps.append(
            [
                lambda place=place, **_: jv.PointLight(place, [5.0]),
                lambda place=place, u=u, v=v: jv.RectangleLight(place, u, v, [5.0]),
                lambda u=u, **_: jv.DirectionalLight(u / np.linalg.norm(u), [5.0]),
            ][rng.integers(3)]()
        )
    eye, toward = rng.normal(0, 5, 3), axes_toward(rng.standard_normal(3), rng)
    match rng.integers(3):
        case 0:
            view = jv.Pinhole(eye, toward, 0.03, 0.001, resolution=(20, 30))
        case 1:
            view = jv.Orthographic(eye, toward, 0.2, resolution=(20, 30))
        case _:
            view = jv.ThinLens(
                eye, toward, 1.0, 0.03, f_number=1.5, focus_distance=4.0, resolution=(20, 30)
            )
    return jv.Scene(surfaces, lamps), view


def _eye_rays(view, count, rng):
    """Return origins and unit directions, (count, 3), through random positions in the picture."""
    right, down, forward = np.asarray(view.rotation)
    x, y = (rng.uniform(-0.5, 0.5, (2, count)) * [[30], [20]]) * float(view.pixel_pitch)
    plane = x[:, None] * right + y[:, None] * down
    place = np.asarray(view.position)
    if isinstance(view, jv.Orthographic):
        return place + plane, np.broadcast_to(forward, plane.shape)
    f = float(view.focal_length)
    if isinstance(view, jv.Pinhole):
        way, start = plane / f + forward, np.broadcast_to(place, plane.shape)
    else:
        focus = float(view.focus_distance)  # the sensor is f z / (z - f) behind the lens
        radius, turn = f / float(view.f_number) / 2, rng.uniform(0, 2 * np.pi, (count, 1))
        start = place + radius * (np.cos(turn) * right + np.sin(turn) * down)
        way = place + focus * (plane * (focus - f) / (f * focus) + forward) - start
    return start, way / np.linalg.norm(way, axis=1, keepdims=True)


def _lamp_rays(lamp, seen, rng):
    """Return unit directions and distances from visible points, (n, 3), to random points of a
    lamp."""
    if isinstance(lamp, jv.DirectionalLight):
        way = np.broadcast_to(np.asarray(lamp.direction), seen.shape)
        return way, np.full(len(seen), np.inf)
    if isinstance(lamp, jv.PointLight):
        there = np.broadcast_to(np.asarray(lamp.position), seen.shape)
    else:
        s, t = rng.uniform(size=(2, len(seen), 1))
        there = np.asarray(lamp.corner) + s * np.asarray(lamp.edge_u) + t * np.asarray(lamp.edge_v)
    far = np.linalg.norm(there - seen, axis=1)
    return (there - seen) / far[:, None], far


def _check_no_ray_meets_what_is_dropped(seed, rays):
    rng = np.random.default_rng(seed)
    scene, view = _random_scene(rng)
    pruned = effects.prune(scene, view, NOTHING, level=1.0)
    names = {effect.name for effect in pruned.certificate.dropped}
    dropped = [i for i in range(len(scene.surfaces)) if f"surfaces[{i}]" in names]
    assert len(pruned.scene.surfaces) == len(scene.surfaces) - len(dropped)
    start, way = _eye_rays(view, rays, rng)
    # a point anywhere along a ray from the eye may be on a visible surface
    seen = start + way * 10 ** rng.uniform(-1, 2, (rays, 1))
    for i in dropped:
        shape = scene.surfaces[i].shape
        assert not _hits(shape, start, way, np.inf).any(), (seed, i)
        for lamp in scene.lights:
            toward, far = _lamp_rays(lamp, seen, rng)
            assert not _hits(shape, seen, toward, far).any(), (seed, i)
    return len(dropped), len(scene.surfaces)


def test_no_ray_meets_a_dropped_surface_in_ten_random_scenes():
    counts = np.array([_check_no_ray_meets_what_is_dropped(seed, 2000) for seed in range(10)])
    assert counts[:, 0].sum() >= 5


@pytest.mark.slow
def test_no_ray_meets_a_dropped_surface_in_300_random_scenes():
    counts = [_check_no_ray_meets_what_is_dropped(seed, 20000) for seed in range(1000, 1300)]
    dropped, surfaces = np.sum(counts, axis=0)
    assert dropped > 0.1 * surfaces
