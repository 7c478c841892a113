"""Certified distances and shadow tests, against quadratic programmes and sampled segments."""

import numpy as np
import pytest
from oracles.direct_light import hit
from oracles.random_scenes import Draw
from scipy.optimize import nnls

import jaxvision as jv
from jaxvision.effects.blocking import may_block
from jaxvision.effects.bodies import gap, stacked
from jaxvision.effects.cells import cells_of, eye_of, in_view
from jaxvision.effects.illumination import source_of
from jaxvision.effects.stages import Ends

WHOLE = 1e4  # weight of "the shares sum to 1" in least squares


def twice(record):
    return Ends(record, record)


def random_body(rng):
    """Points and radii: a ball, a parallelogram, a box or a cloud."""
    c, kind = rng.uniform(-1, 1, 3), rng.integers(4)
    if kind == 0:
        return c[None], np.array([rng.uniform(0.05, 0.5)])
    if kind == 1:
        u, v = rng.normal(size=(2, 3)) * 0.7
        points = c + np.array([0 * u, u, v, u + v])
    elif kind == 2:
        signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        points = c + (signs * rng.uniform(0.05, 0.6, 3)) @ turn
    else:
        points = c + rng.normal(size=(12, 3)) * 0.4
    return points, np.zeros(len(points))


def true_distance(a, b):
    """By least squares over the shares of each body's points."""
    (p, r), (q, s) = a, b
    ones, none = np.ones(len(p)), np.zeros(len(q))
    sums = WHOLE * np.stack([np.r_[ones, none], np.r_[0 * ones, none + 1]])
    system = np.concatenate([np.concatenate([p.T, -q.T], 1), sums])
    share, _ = nnls(system, np.r_[0, 0, 0, WHOLE, WHOLE])
    x, y = share[: len(p)], share[len(p) :]
    apart = np.linalg.norm(p.T @ (x / x.sum()) - q.T @ (y / y.sum()))
    return max(apart - r.max() - s.max(), 0.0)


def test_gap_is_below_the_true_distance_and_near_it():
    rng = np.random.default_rng(0)
    pairs = [(random_body(rng), random_body(rng)) for _ in range(1000)]
    found = gap(stacked([a for a, _ in pairs]), stacked([b for _, b in pairs]))
    true = np.array([true_distance(*pair) for pair in pairs])
    assert np.all(found <= true + 1e-9)
    apart = true > 1e-6
    assert np.mean(found[apart] >= 0.99 * true[apart]) >= 0.9
    assert not found[~apart].any()


def test_a_body_may_move_within_its_box():
    low, high = jv.Sphere([0, 0, 0], 0.1), jv.Sphere([0, 0, 1], 0.3)
    (cell,) = cells_of(
        [Ends(jv.Surface(low, jv.Lambert([0.1])), jv.Surface(high, jv.Lambert([0.1])))],
        about=np.zeros(3),
    ).radius
    assert cell == pytest.approx(0.8)


def segments(light, receiver, rng, count):
    """Starts on a surface and ends at a light, of `count` segments that carry light."""
    cells = cells_of([twice(receiver)], about=np.zeros(3))
    while True:
        aim = cells.centre[rng.integers(len(cells.centre), size=count)]
        aim = aim + rng.normal(size=(count, 3)) * 0.02
        start = aim + 5 * rng.normal(size=(count, 3))
        d = (aim - start) / np.linalg.norm(aim - start, axis=1, keepdims=True)
        t, normal, _ = hit(receiver.shape, start, d)
        on = np.isfinite(t) & ((normal * d).sum(1) < 0)
        p, normal = (start + np.where(on, t, 0)[:, None] * d)[on], normal[on]
        if len(p):
            break
    if isinstance(light, jv.DirectionalLight):
        to = p + 50 * np.asarray(light.direction) / np.linalg.norm(light.direction)
    elif isinstance(light, jv.RectangleLight):
        s, t = rng.uniform(size=(2, len(p), 1))
        to = np.asarray(light.corner) + s * np.asarray(light.edge_u) + t * np.asarray(light.edge_v)
        across = np.cross(light.edge_u, light.edge_v)
        lit = ((p - to) @ across) > 0
        p, to, normal = p[lit], to[lit], normal[lit]
    else:
        to = np.broadcast_to(np.asarray(light.position), p.shape)
    front = ((to - p) * normal).sum(1) > 0
    return p[front] + 1e-6 * normal[front], to[front]


@pytest.mark.parametrize("count", [15, pytest.param(1000, marks=pytest.mark.slow)])
def test_what_may_not_block_is_never_met_by_a_segment(count):
    """And of the triples that no segment finds blocked, 70 % are proved."""
    silent = proved = 0
    for seed in range(count):
        draw = Draw(seed)
        rng, lambert = draw.rng, jv.Lambert([0.1])
        receiver, occluder = (jv.Surface(draw.shape(), lambert) for _ in range(2))
        light = draw.light()
        while not isinstance(light, jv.PointLight | jv.RectangleLight | jv.DirectionalLight):
            light = draw.light()
        p, to = segments(light, receiver, rng, 4096)
        d = to - p
        length = np.linalg.norm(d, axis=1)
        t, _, _ = hit(occluder.shape, p, d / np.maximum(length, 1e-300)[:, None])
        met = bool((t < length - 2e-6).any()) if len(p) else False
        surfaces = [twice(receiver), twice(occluder)]
        may = may_block([source_of(twice(light))], surfaces)[0, 0, 1]
        assert may or not met, f"seed {seed}"
        silent += not met
        proved += not may
    assert proved >= 0.7 * silent


def test_a_convex_room_and_a_lone_ball_cast_no_shadows():
    walls = [
        jv.Quad([-1, 1, -1], [2, 0, 0], [0, 0, 2]),
        jv.Quad([-1, -1, -1], [0, 0, 2], [2, 0, 0]),
        jv.Quad([-1, -1, 1], [0, 2, 0], [2, 0, 0]),
        jv.Quad([-1, -1, -1], [0, 2, 0], [0, 0, 2]),
        jv.Quad([1, -1, -1], [0, 0, 2], [0, 2, 0]),
    ]
    surfaces = [twice(jv.Surface(wall, jv.Lambert([0.1]))) for wall in walls]
    lamp = source_of(twice(jv.PointLight([0, 0, -0.9], [1.0])))
    assert not may_block([lamp], surfaces).any()
    ball = twice(jv.Surface(jv.Sphere([0, 0, 0], 0.3), jv.Lambert([0.1])))
    assert may_block([lamp], [*surfaces, ball]).any()
    assert not may_block([lamp], [ball]).any()
    mesh = jv.TriangleMesh(np.eye(3), np.array([[0, 1, 2]]))
    assert may_block([lamp], [twice(jv.Surface(mesh, jv.Lambert([0.1])))])[0, 0, 0]


def test_what_a_pixel_sees_is_in_view():
    view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 0.001, resolution=(20, 30))
    eye = eye_of(twice(view))
    places = np.array(
        [[0, 0, 1.0], [0.3, 0.2, 1], [0.31, 0, 1], [0, 0.22, 1], [0, 0, -1], [2, 0, 1]]
    )
    bodies = stacked([(p[None], np.zeros(1)) for p in places])
    assert in_view(eye, bodies).tolist() == [True, True, True, False, False, False]
