"""Tests certified distances and shadow tests against quadratic programmes and sampled segments."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.direct_light import hit
from oracles.random_scenes import Draw
from scipy.optimize import nnls

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects.angles import cos_seen, toward_eye
from jaxvision.effects.blocking import is_convex, may_block
from jaxvision.effects.bodies import body_of, gap, is_closed, stacked
from jaxvision.effects.cells import Cells, Eye, cells_of, eye_of, visible_flags
from jaxvision.effects.illumination import source_of
from jaxvision.effects.stages import Ends
from jaxvision.effects.umbra import hidden, shaded

WHOLE = 1e4  # weight of the constraint that the shares sum to 1, in least squares


def twice(record):
    return Ends(record, record)


def test_directions_to_an_extended_eye_are_within_their_cone():
    """The directions go from any point of a ball to any point of a lens. The cone is tight for a
    ray along both rims."""
    rng = np.random.default_rng(0)
    radius, away = np.array([0.1, 0.5, 0.0]), np.array([[3.0, 0, 0], [0, -2, 1], [1, 1, 1]])
    cells = Cells(away, radius, np.eye(3), np.zeros(3), np.arange(3))
    eye = Eye(np.zeros(3), 0.0, 0.4, np.eye(3), np.zeros((0, 3)), np.zeros(0), False, False)
    toward, width = toward_eye(cells, eye)
    apart = rng.normal(size=(3, 20_000, 3))
    apart *= (radius + eye.size)[:, None, None] / np.linalg.norm(apart, axis=-1, keepdims=True)
    rays = apart - away[:, None]
    cosines = np.einsum("cnk,ck->cn", rays, toward) / np.linalg.norm(rays, axis=-1)
    widest = np.arccos(cosines).max(axis=1)
    assert (widest <= width).all()
    assert (widest > 0.98 * width).all()


def random_body(rng):
    """Return points and radii of a ball, a parallelogram, a box or a cloud."""
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
    """Return the distance by least squares over the weights of each body's points."""
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
    """Return `count` segments that carry light, from a surface to a light."""
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
def test_no_segment_is_blocked_where_it_is_proved_free(count):
    """Of the triples where no segment is blocked, at least 70 % are proved."""
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


def test_everything_a_pixel_sees_is_in_view():
    view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 0.001, resolution=(20, 30))
    eye = eye_of(twice(view))
    places = np.array(
        [[0, 0, 1.0], [0.3, 0.2, 1], [0.31, 0, 1], [0, 0.22, 1], [0, 0, -1], [2, 0, 1]]
    )
    bodies = stacked([(p[None], np.zeros(1)) for p in places])
    assert visible_flags(eye, bodies).tolist() == [True, True, True, False, False, False]


TURN = np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2 + np.eye(3))[0]
CENTRES = [1.3, 0, 0.5], [2.3, 0.2, 0.7]
FREE = {
    "box": (lambda c, s: jv.Box(c, s), [0.1, 0.1, 0.05], [1.1, 0.4, 0.05]),
    "turned box": (lambda c, s: jv.Box(c, s, rotation=TURN), [0.1, 0.1, 0.05], [1.1, 0.4, 0.05]),
    "disc": (lambda c, s: jv.Disc(c, [0.3, 0, 1.0], s), 0.1, 1.1),
    "ball": (lambda c, s: jv.Sphere(c, s), 0.1, 1.1),
    "parallelogram": (lambda c, s: jv.Quad(c, s, [0, 1.0, 0.1]), [-0.5, 0, -1.0], [1.0, 0.2, 1]),
}


@pytest.mark.parametrize("kind", FREE)
def test_a_free_body_contains_every_shape_of_its_box(kind):
    """The body contains the shape at every position and size, along 200 directions, by the shape's
    own extent."""
    rng, (shape, small, large) = np.random.default_rng(0), FREE[kind]
    body = body_of(Ends(shape(CENTRES[0], small), shape(CENTRES[1], large)))
    assert body is not None
    points, radii = body
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    most = (points @ directions.T + radii[:, None]).max(0)
    for trial in range(100):
        ends = rng.integers(2, size=6) if trial < 64 else rng.uniform(size=6)
        centre = (1 - ends[:3]) * CENTRES[0] + ends[:3] * np.array(CENTRES[1])
        size = (1 - ends[3:]) * np.asarray(small) + ends[3:] * np.asarray(large)
        size = size[0] if np.ndim(small) == 0 else size
        there = surface_points(kind, centre, size, rng)
        assert np.all((there @ directions.T).max(0) <= most + 1e-9)


def surface_points(kind, centre, size, rng):
    """Return points on a shape, including its corners."""
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
    turn = rng.uniform(0, 2 * np.pi, (400, 1))
    match kind:
        case "box":
            return centre + signs * size
        case "turned box":
            return centre + (signs * size) @ TURN
        case "disc":
            u, v = np.array([1, 0, -0.3]) / np.sqrt(1.09), np.array([0, 1.0, 0])
            return centre + size * (np.cos(turn) * u + np.sin(turn) * v)
        case "ball":
            off = rng.normal(size=(400, 3))
            return centre + size * off / np.linalg.norm(off, axis=1)[:, None]
    other = np.array([0, 1.0, 0.1])
    return centre + np.stack([0 * size, size, other, size + other])


def test_an_unknown_direction_comes_from_everywhere():
    """A box around the origin contains all directions, even if the mean of its corners is the
    origin."""
    lows, highs = ([-1, -1, -1], [1, 1, 1]), ([-0.1, -0.2, 0.0], [0.3, 1.0, 1.0])
    for low, high in (lows, highs):
        source = source_of(Ends(*(jv.DirectionalLight(d, [1.0]) for d in (low, high))))
        assert source.size == np.pi


@pytest.mark.parametrize(("away", "over"), [(5000.0, 0.03), (20000.0, 0.1), (100.0, 0.003)])
def test_shadows_far_from_the_origin(away, over):
    """A sheet, a floor and a lamp are so far from the origin that float32 has few digits for the
    gap. The strip in shadow, by similar triangles, is in the picture."""
    floor = jv.Surface(jv.Quad([-1, -1, away], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.3]))
    sheet = jv.Surface(jv.Quad([0, -1, away + over], [1, 0, 0], [0, 2, 0]), jv.Lambert([0.0]))
    lamp = jv.PointLight([5.0, 0, away + 5.0], [100.0])
    scene = jv.Scene([floor, sheet], [lamp])
    scene32 = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), scene)
    low, high = (float(surface.shape.corner[2]) for surface in scene32.surfaces)
    over = high - low
    strip = 5.0 * over / (5.0 - over)  # m, the shadow on the floor beside the sheet
    down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    view = jv.Orthographic([0, 0, away + 3], down, strip / 4, resolution=(4, 8))
    row = {e.name: e for e in effects.inspect(scene32, view)}["shadows[0]"]
    assert row.bound >= 0.3 * 100 * 5 / 50**1.5 * 0.99


CUBE = np.stack(np.meshgrid(*[[0.0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
SIDES += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]


@pytest.mark.parametrize(
    ("vertices", "faces", "closed"),
    [
        (CUBE, SIDES, True),
        (CUBE[np.ravel(SIDES)], np.arange(36).reshape(12, 3), True),  # each corner several times
        (CUBE, SIDES[1:], False),
        (CUBE, [face[::-1] for face in SIDES], False),  # inside out
        (CUBE, [SIDES[0][::-1], *SIDES[1:]], False),
        (np.concatenate([CUBE, CUBE + 2]), [*SIDES, *(np.array(SIDES) + 8)], True),
        (np.concatenate([CUBE, CUBE / 2 + 2]), [*SIDES, *(np.array(SIDES)[:, ::-1] + 8)], False),
    ],
)
def test_which_meshes_bound_a_body(vertices, faces, closed):
    assert is_closed(twice(jv.TriangleMesh(vertices, faces))) is closed
    assert not is_closed(twice(jv.Quad([0, 0, 0], [1, 0, 0], [0, 1, 0])))


def tilted(vertices):
    """Return vertices rotated and rounded to float32."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    return (np.asarray(vertices) @ (turn * np.sign(np.linalg.det(turn))) + 3).astype(np.float32)


DENTED = np.where((CUBE == 1).all(1)[:, None], 0.6, CUBE)  # a corner pushed in


@pytest.mark.parametrize(
    ("vertices", "faces", "convex"),
    [
        (CUBE, SIDES, True),
        (tilted(CUBE), SIDES, True),
        (DENTED, SIDES, False),
        (CUBE, SIDES[1:], False),
        (CUBE, [face[::-1] for face in SIDES], False),
        (np.concatenate([CUBE, CUBE + 2]), [*SIDES, *(np.array(SIDES) + 8)], False),
    ],
)
def test_the_outer_side_of_a_convex_mesh_is_not_in_its_own_shadow(vertices, faces, convex):
    mesh = jv.TriangleMesh(vertices, faces)
    assert is_convex(twice(mesh)) is convex
    lamp = source_of(twice(jv.PointLight([9.0, 8, 7], [1.0])))
    view = jv.Pinhole([0.5, 0.5, -9], np.eye(3), 1.0, 0.1, resolution=(9, 9))
    for two_sided in (False, True):
        own = [twice(jv.Surface(mesh, jv.Lambert([0.1]), two_sided=two_sided))]
        may = may_block([lamp], own)
        assert may[0, 0, 0] == (two_sided or not convex)
        cells = cells_of(own, about=np.zeros(3))
        seen = cos_seen(cells, eye_of(twice(view)))[1] > 0
        seen &= ~hidden(own, cells, eye_of(twice(view)))
        assert seen.any()
        dark = shaded([lamp], own, cells, may=may, wanted=seen[None])
        assert not (convex and dark.any())
    if convex:
        surface, light = jv.Surface(mesh, jv.Lambert([0.1])), jv.PointLight([4.0, 3, 6], [1.0])
        p, to = segments(light, surface, np.random.default_rng(0), 4096)
        length = np.linalg.norm(to - p, axis=1)
        t, _, _ = hit(mesh, p, (to - p) / length[:, None])
        assert len(p) > 100
        assert not (t < length - 2e-6).any()


def test_a_room_around_lamp_and_receiver_blocks_nothing():
    """The segment between two points of a convex body stays inside. A segment that leaves the body
    may be blocked."""
    grey = jv.Lambert([0.1])
    shapes = {
        "box": jv.Box(
            [0.0, 0, 1], [2.0, 2, 1], rotation=[[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]
        ),
        "ball": jv.Sphere([0.0, 0, 1], 3.0),
    }
    floor = jv.Surface(
        jv.Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), grey
    )  # touches the box's own
    lamp = source_of(twice(jv.PointLight([0.5, 0.0, 1.9], [1.0])))
    for shape in shapes.values():
        room = jv.Surface(shape, grey, two_sided=True)
        assert not may_block([lamp], [twice(room), twice(floor)])[..., 0].any()
        outside = source_of(twice(jv.PointLight([0.0, 0.0, 4.5], [1.0])))
        assert may_block([outside], [twice(room), twice(floor)])[0, 1, 0]
        wide = replace(floor, shape=jv.Quad([-4.0, -4, 0.5], [8.0, 0, 0], [0, 8.0, 0]))
        assert may_block([lamp], [twice(room), twice(wide)])[0, 1, 0]
        shrinks = replace(room, shape=replace(shape, centre=jnp.asarray([0.0, 0, 1.5])))
        assert may_block([lamp], [Ends(room, shrinks), twice(floor)])[0, 1, 0]
