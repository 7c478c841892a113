"""Tests every shape against points known to be on it, meshes against Embree and for holes, and
rounding of rays that start on a surface."""

import re
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxvision import Vec, as_array, as_dtype
from jaxvision.geometry import (
    Encounter,
    Ray,
    _mesh,
    hit_shape,
    intersect,
    nearest_shape,
    occluded,
    problems,
)
from jaxvision.geometry.checks import warn_of_shapes
from jaxvision.scene import Box, Disc, Plane, Quad, Sphere, TriangleMesh

RNG = np.random.default_rng(19)
TURN = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
CUBE = trimesh.creation.box(extents=[1, 2, 3])
BALL = trimesh.creation.icosphere(subdivisions=3)


def mesh_of(made, **options):
    return TriangleMesh(made.vertices, made.faces, **options)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def rays(origins, directions, dtype=jnp.float64):
    return Ray(Vec(*jnp.asarray(origins, dtype).T), Vec(*jnp.asarray(unit(directions), dtype).T))


@jax.jit
def meet(ray, shapes):
    def one(ray):
        encounter = nearest_shape(ray, shapes)
        return encounter, hit_shape(ray, shapes, encounter)

    return jax.vmap(one)(ray)


def quad_points(n):
    u, v = RNG.uniform(0, 1, size=(2, n, 1))
    corner, edge_u, edge_v = np.array([[-1.0, 0, 4], [2, 0.5, 0], [0.3, 2, 0.4]])
    normal = np.cross(edge_u, edge_v)
    return Quad(corner, edge_u, edge_v), corner + u * edge_u + v * edge_v, normal


def disc_points(n):
    a, b, normal = TURN
    radius, phi = np.sqrt(RNG.uniform(0, 1, (n, 1))) * 0.7, RNG.uniform(0, 2 * np.pi, (n, 1))
    centre = np.array([0.2, 0.1, 4])
    points = centre + radius * (np.cos(phi) * a + np.sin(phi) * b)
    return Disc(centre, 3 * normal, 0.7), points, normal


@pytest.mark.sweep
@pytest.mark.parametrize("make", [quad_points, disc_points])
def test_a_ray_to_a_known_point_of_a_flat_shape_hits_it_there(make):
    shape, points, normal = make(200)
    origins = RNG.uniform(-1, 1, size=(200, 3))
    encounter, hit = meet(rays(origins, points - origins), [shape])
    assert (encounter.shape == 0).all()
    np.testing.assert_allclose(as_array(hit.point), points, atol=1e-13)
    np.testing.assert_allclose(hit.distance, np.linalg.norm(points - origins, axis=1), rtol=1e-13)
    expected = np.broadcast_to(unit(normal), points.shape)
    np.testing.assert_allclose(as_array(hit.normal), expected, atol=1e-14)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("make", [quad_points, disc_points])
def test_a_ray_past_the_rim_of_a_flat_shape_misses_it(make):
    shape, points, _ = make(400)
    middle = points.mean(axis=0)
    beyond = middle + 2.5 * (points - middle)
    bound = np.linalg.norm(points - middle, axis=1).max()
    beyond = beyond[np.linalg.norm(beyond - middle, axis=1) > 1.02 * bound]
    assert len(beyond) > 50
    origins = np.zeros_like(beyond)
    encounter, hit = meet(rays(origins, beyond), [shape])
    assert (encounter.shape == -1).all()
    assert jnp.isinf(hit.distance).all()
    assert (as_array(hit.normal) == 0).all()


def box_distance_by_faces(origin, direction, half):
    """Return the nearest intersection with any of six rectangles, one at a time."""
    best, normal = np.inf, np.zeros(3)
    for axis in range(3):
        for side in (-1, 1):
            t = (side * half[axis] - origin[axis]) / direction[axis]
            place = np.delete(origin + t * direction, axis)
            if 0 < t < best and (np.abs(place) <= np.delete(half, axis)).all():
                best, normal = t, side * np.eye(3)[axis]
    return best, normal


@pytest.mark.sweep
@pytest.mark.parametrize("rotation", [None, TURN])
def test_box_against_its_six_faces(rotation):
    half, centre = np.array([0.5, 1.0, 1.5]), np.array([0.3, -0.2, 0.4])
    turn = np.eye(3) if rotation is None else rotation
    inside = RNG.uniform(-1, 1, size=(50, 3)) * half
    outside = 4 * unit(RNG.normal(size=(150, 3)))
    local = np.concatenate([inside, outside])
    toward = RNG.uniform(-1.5, 1.5, size=local.shape) - local
    directions = unit(toward)
    truth = [box_distance_by_faces(o, d, half) for o, d in zip(local, directions, strict=True)]
    distance, normal = (np.asarray(x) for x in zip(*truth, strict=True))
    shape = Box(centre, half, rotation=rotation)
    _, hit = meet(rays(local @ turn + centre, directions @ turn), [shape])
    assert 60 < np.isfinite(distance).sum() < 200
    np.testing.assert_allclose(hit.distance, distance, rtol=1e-12)
    np.testing.assert_allclose(as_array(hit.normal), normal @ turn, atol=1e-14)


# ---------------------------------------------------------------- meshes


@pytest.mark.sweep
@pytest.mark.parametrize("scale", [1e-3, 1, 1e4])
@pytest.mark.parametrize("searched", [True, False])
def test_no_ray_leaves_a_closed_mesh(scale, searched, monkeypatch):
    """From inside a ball of triangles, every ray hits one in float32, including rays at its
    vertices and edges, with and without Embree."""
    monkeypatch.setattr(_mesh, "_TRIED", 100 if searched else 10**6)
    count = 100_000 if searched else 20_000
    corners = np.asarray(BALL.vertices)
    edges = corners[np.asarray(BALL.edges_unique)].mean(axis=1)
    origin = np.array([0.1, 0.2, -0.3])
    aimed = np.concatenate([corners, edges]) - origin
    random = RNG.normal(size=(count - len(aimed), 3))
    directions = np.concatenate([aimed, random])
    mesh = as_dtype(TriangleMesh(scale * BALL.vertices, BALL.faces), jnp.float32)
    ray = rays(scale * np.broadcast_to(origin, directions.shape), directions, jnp.float32)
    meets = jax.jit(lambda ray: jax.vmap(lambda r: nearest_shape(r, [mesh]))(ray))
    assert (meets(ray).shape == 0).all()


@pytest.mark.slow
def test_the_tree_and_the_loop_find_the_same_triangles(monkeypatch):
    pytest.importorskip("embreex")
    origins = 3 * unit(RNG.normal(size=(3000, 3)))
    ray = rays(origins, 0.8 * RNG.normal(size=origins.shape) - origins, jnp.float32)
    mesh = as_dtype(mesh_of(BALL), jnp.float32)
    by_tree, _ = jax.jit(lambda r: meet(r, [mesh]))(ray)
    monkeypatch.setattr(_mesh, "_TRIED", 10**6)
    by_loop, hit = jax.jit(lambda r: meet.__wrapped__(r, [mesh]))(ray)
    assert 0.2 < (by_loop.shape == 0).mean() < 0.98
    assert (by_tree.shape == by_loop.shape).mean() > 0.999
    assert (by_tree.primitive == by_loop.primitive).mean() > 0.999
    inside = hit.distance < jnp.inf
    radius = np.linalg.norm(as_array(hit.point), axis=1)[np.asarray(inside)]
    assert (radius <= 1 + 1e-6).all()


@pytest.mark.slow
def test_without_embree_meshes_work_and_say_so_once(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex", None)
    monkeypatch.setattr(_mesh._embree, "available", lambda: False)
    _mesh._warn_of_slow_search.cache_clear()
    ray = Ray(jnp.asarray([0.0, 0, 3]), jnp.asarray([0.0, 0, -1]))
    with pytest.warns(UserWarning, match="install embreex"):
        first = nearest_shape(ray, [mesh_of(BALL)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        second = nearest_shape(ray, [mesh_of(BALL)])
    assert int(first.shape) == int(second.shape) == 0


@pytest.mark.slow
def test_gradients_reach_the_vertices_of_the_hit_triangle():
    """Moving a whole ball along the ray moves the hit by as much. Embree does not affect the
    gradient."""
    ray = Ray(jnp.asarray([0.05, 0.02, 3]), jnp.asarray([0.0, 0, -1]))
    mesh = mesh_of(BALL)

    def distance(shift):
        moved = TriangleMesh(mesh.vertices + shift * jnp.asarray([[0.0, 0, 1]]), mesh.faces)
        return intersect(ray, moved).distance

    np.testing.assert_allclose(jax.grad(distance)(jnp.asarray(0.0)), -1, rtol=1e-12)
    step = 1e-4

    def stretched(scale):
        return intersect(ray, TriangleMesh(scale * mesh.vertices, mesh.faces)).distance

    slope = (stretched(1 + step) - stretched(1 - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(stretched)(jnp.asarray(1.0)), slope, rtol=1e-6)


def test_normals_and_uv_are_interpolated():
    """They are interpolated with the weights of a known point. The true normal is that of the
    plane."""
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    normals, uv = unit(RNG.normal(size=(3, 3)) + np.array([0, 0, 3])), RNG.uniform(size=(3, 2))
    mesh = TriangleMesh(corners, [[0, 1, 2]], normals=normals, uv=uv)
    weights = RNG.dirichlet([1, 1, 1], size=100)
    points = weights @ corners
    origins = points + np.array([0.3, -0.2, 2.0])
    ray = rays(origins, points - origins)
    _, hit = meet(ray, [Sphere([0, 0, -9], 1), mesh])
    np.testing.assert_allclose(as_array(hit.shading_normal), unit(weights @ normals), atol=1e-13)
    np.testing.assert_allclose(np.stack(hit.uv, axis=1), weights @ uv, atol=1e-13)
    np.testing.assert_allclose(as_array(hit.normal), np.tile([0, 0, 1.0], (100, 1)), atol=1e-15)


# ---------------------------------------------------------------- rays from a surface


def surface_points(count, dtype, scale):
    """Return (shapes, hits, shape of each hit) seen by cameras next to several shapes."""
    shapes = [
        Sphere(np.multiply(scale, [0.3, 0.1, 3]), scale * 1.0),
        Plane([0, -scale, 0], [0, 1, 0]),
        Box(np.multiply(scale, [3, 0.2, 4]), np.full(3, scale * 1.0), rotation=TURN),
        Disc(np.multiply(scale, [-3, 0, 4]), TURN[0], scale * 1.5),
        TriangleMesh(scale * (BALL.vertices + np.array([0, 3, 4])), BALL.faces),
    ]
    shapes = [as_dtype(shape, dtype) for shape in shapes]
    directions = RNG.normal(size=(count, 3)) + np.array([0, 0, 1])
    ray = rays(np.zeros((count, 3)), directions, dtype)
    encounter, hit = meet(ray, shapes)
    seen = np.asarray(encounter.shape) >= 0
    assert seen.mean() > 0.4
    hit = jax.tree.map(lambda x: x[seen], hit)
    return shapes, hit, np.asarray(encounter.shape)[seen]


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1, 1e4])
def test_no_self_shadowing(scale):
    """A visible point sees the camera: in float32, at any angle, no shadow ray hits the shape that
    it starts from."""
    shapes, hit, which = surface_points(20_000, jnp.float32, scale)
    toward = -as_array(hit.point)
    distance = jnp.linalg.norm(toward, axis=1)
    direction = Vec(*(toward / distance[:, None]).T)
    slant = np.abs((as_array(hit.normal) * as_array(direction)).sum(axis=1))
    assert slant.min() < 0.01

    @jax.jit
    def blocked(hit, direction, distance):
        def by_each(h, d, far):
            own = [occluded(h.point, h.normal, d, far, [s], size=h.size) for s in shapes]
            return jnp.stack(own)

        return jax.vmap(by_each)(hit, direction, distance)

    assert not blocked(hit, direction, distance)[np.arange(len(which)), which].any()


@pytest.mark.slow
def test_occlusion_is_a_hit_before_the_end():
    """For random points and ends, a segment is blocked exactly if the nearest hit of its ray is
    before its end, for every shape. Both ends are excluded."""
    shapes = [
        Sphere([0, 0, 3], 1),
        Quad([-2, -1, 2], [1, 0, 0.5], [0, 1, 0]),
        Box([2, 0, 3], [0.5, 1, 0.5]),
        mesh_of(CUBE),
    ]
    origins = RNG.uniform(-1, 4, size=(4000, 3))
    ray, far = rays(origins, RNG.normal(size=origins.shape)), RNG.uniform(0.2, 4, size=4000)
    _, hit = meet(ray, shapes)
    zero = jnp.zeros(3)
    blocked = jax.jit(jax.vmap(lambda r, far: occluded(r.origin, zero, r.direction, far, shapes)))(
        ray, jnp.asarray(far)
    )
    np.testing.assert_array_equal(blocked, np.asarray(hit.distance) < far)
    assert 0.1 < blocked.mean() < 0.9


@pytest.mark.slow
def test_many_shapes_are_found_like_few():
    """Forty spheres, searched in chunks, give the nearest hit of forty single ones."""
    spheres = [
        Sphere(c, r)
        for c, r in zip(RNG.normal(size=(40, 3)) * 3, RNG.uniform(0.2, 0.8, 40), strict=True)
    ]
    shapes = [Plane([0, -5, 0], [0, 1, 0]), *spheres]
    ray = rays(
        RNG.normal(size=(500, 3)) + np.array([0, 0, 9]), RNG.normal(size=(500, 3)) - [0, 0, 3]
    )
    encounter, _ = meet(ray, shapes)
    single = jax.jit(lambda ray, shape: jax.vmap(lambda r: intersect(r, shape).distance)(ray))
    distances = np.stack([single(ray, shape) for shape in shapes])
    nearest = np.where(np.isinf(distances.min(axis=0)), -1, distances.argmin(axis=0))
    np.testing.assert_array_equal(encounter.shape, nearest)
    assert len(np.unique(nearest)) > 15


# ---------------------------------------------------------------- invalid geometry


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (Sphere([0, 0, np.nan], 1), "centre holds a number that is not finite"),
        (Sphere([0, 0, 0], 0), "radius must be positive, got 0 m"),
        (  # as after a failed step of a fit
            jax.tree.map(jnp.zeros_like, Plane([0, 0, 0], [0, 0, 1])),
            "normal must have a direction",
        ),
        (Disc([0, 0, 0], [0, 0, 1], 0), "radius must be positive"),
        (Quad([0, 0, 0], [1, 0, 0], [2, 0, 0]), "span no area"),
        (Box([0, 0, 0], [1, 0, 1]), "half_extents must be positive"),
        (Box([0, 0, 0], [1, 1, 1], rotation=2 * np.eye(3)), "not unit and orthogonal"),
        (TriangleMesh([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]]), "not finite: 2 "),
        (
            jax.tree.map(lambda x: 2 * x, TriangleMesh(np.eye(3), [[0, 1, 2]])),
            "outside 0 to 2: 0",
        ),
        (TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]), "without area"),
    ],
)
def test_problems_are_named_in_one_sentence(shape, words):
    (sentence,) = problems(shape)
    assert re.search(words, sentence)
    assert sentence.endswith(".")


def test_valid_shapes_have_no_problems():
    for shape in (Sphere([0, 0, 0], 1), Box([0, 0, 0], [1, 1, 1], rotation=TURN), mesh_of(BALL)):
        assert problems(shape) == []


def test_shapes_are_checked_when_they_are_made():
    with pytest.raises(ValueError, match=r"TriangleMesh\.vertices must have shape"):
        TriangleMesh([[0, 0], [1, 1]], [[0, 1, 1]])
    with pytest.raises(ValueError, match="whole numbers"):
        TriangleMesh([[0, 0, 0.0]], [[0.5, 1, 2]])
    for last in (3, -1):  # counted from 1, or from the end, as in OBJ files
        with pytest.raises(ValueError, match=rf"its 3 vertices, from 0 to 2, got {last}\."):
            TriangleMesh(np.eye(3), [[0, 1, last]])
    with pytest.raises(ValueError, match="at least one triangle"):
        TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), int))
    with pytest.raises(ValueError, match=r"normals must have shape \(3, 3\)"):
        TriangleMesh(np.eye(3), [[0, 1, 2]], normals=np.zeros((2, 3)))


def test_a_miss_has_no_triangle_of_a_mesh():
    ray = Ray(jnp.zeros(3), jnp.asarray([0.0, 0, 1]))
    nothing = Encounter(jnp.asarray(-1), jnp.asarray(-1))
    hit = hit_shape(ray, [mesh_of(CUBE)], nothing)
    assert jnp.isinf(hit.distance)
    assert (as_array(hit.normal) == 0).all()


@pytest.mark.parametrize("size", [1e-15, 1e-12, 1e15, 5e17])
def test_shapes_of_any_size_are_hit_like_those_of_a_metre(size):
    """Products of lengths overflow or underflow float32 long before the lengths do."""
    way = unit(np.array([-0.1, 0.1, 2.0]))

    def met(make, scale):
        shape = as_dtype(make(scale), jnp.float32)
        one = as_dtype(Ray(np.multiply(scale, [0.4, 0.3, -2.0]), way), jnp.float32)
        assert problems(shape) == []
        return float(intersect(one, shape).distance) / scale, int(nearest_shape(one, [shape]).shape)

    for make in (
        lambda s: TriangleMesh(s * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]]),
        lambda s: Quad([0, 0, 0], [s, 0, 0], [0, s, 0]),
        lambda s: Disc([0, 0, 0], [0, 0, 1], s),
        lambda s: Sphere([0, 0, 0], s),
        lambda s: Box([0, 0, 0], [s, s, s]),
    ):
        distance, number = met(make, size)
        assert number == 0
        assert distance == pytest.approx(met(make, 1.0)[0], rel=1e-5)


def test_sizes_beyond_the_range_are_named():
    for size in (1e-17, 1e19):
        (said,) = problems(as_dtype(Sphere([0, 0, 0], size), jnp.float32))
        assert "leave the range of float32" in said
        assert problems(as_dtype(Sphere([0, 0, 0], size), jnp.float64)) == []


@pytest.mark.sweep
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_ray_that_is_not_finite_has_hits_of_nan(number):
    shapes = [
        Sphere([0, 0, 0], 1),
        Box([0, 0, 0], [1, 1, 1]),
        Plane([0, 0, 0], [0, 0, 1]),
        Disc([0, 0, 0], [0, 0, 1], 1),
        Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]),
        TriangleMesh([[-1.0, -1, 0], [2, -1, 0], [-1, 2, 0]], [[0, 1, 2]]),
    ]

    @jax.jit
    def numbers(origin, direction):
        one = Ray(origin, direction)
        hits = [intersect(one, shape) for shape in shapes]
        hits.append(hit_shape(one, shapes, nearest_shape(one, shapes)))
        return jnp.stack([jnp.stack([h.distance, h.point.x, h.normal.z]) for h in hits])

    given = np.array([0.1, 0, 5, 0, 0, -1])
    assert np.isfinite(numbers(given[:3], given[3:])).all()
    for at in range(6):
        lost = np.where(np.arange(6) == at, number, given)
        assert np.isnan(numbers(lost[:3], lost[3:])).all()


@pytest.mark.sweep
def test_a_shape_at_nan_has_hits_of_nan():
    floor, ray = Plane([0, 0, 0], [0, 0, 1]), Ray([0.1, 0, 5], [0, 0, -1])

    @jax.jit
    def distances(z):
        found = []
        for shape in (
            Sphere([z, 0, 1], 1),
            Disc([0, 0, 1], [0, z, 1], 1),
            Quad([z, 0, 1], [1, 0, 0], [0, 1, 0]),
        ):
            both = [floor, shape]
            found += [intersect(ray, shape), hit_shape(ray, both, nearest_shape(ray, both))]
        return jnp.stack([hit.distance for hit in found])

    assert np.isfinite(distances(0.01)).all()
    assert np.isnan(distances(np.nan)).all()


def test_shapes_that_rays_miss_or_meet_twice_are_named():
    """Every renderer names them at the first scene whose numbers are known."""
    hole = TriangleMesh([[0, 0, 1.0], [1, 0, 1], [0, np.nan, 1]], [[0, 1, 2]])
    ball = Sphere([0, 0, 0], 1)
    mesh = TriangleMesh(CUBE.vertices, CUBE.faces)
    for shapes, said in (
        ([hole], "1 of its 3 vertices are not finite"),
        ([Quad([0, 0, np.inf], [1, 0, 0], [0, 1, 0])], "Quad.corner holds a number that is not"),
        ([ball, hole, ball], "1 of its 3"),
        (
            [TriangleMesh(np.eye(3), [[0, 1, 2]], normals=np.full((3, 3), np.nan))],
            "TriangleMesh.normals holds",
        ),
        ([ball, Sphere([0, 0, 0], 2), Sphere([0, 0, 0], 1)], r"surfaces\[2\]: lies exactly where"),
        ([mesh, TriangleMesh(CUBE.vertices, CUBE.faces)], r"surfaces\[1\]: lies exactly where"),
    ):
        with pytest.warns(UserWarning, match=said):
            warn_of_shapes(*shapes)
    moved = np.asarray(CUBE.vertices) + 1e-3 * (np.arange(8)[:, None] == 7)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_shapes(mesh, TriangleMesh(moved, CUBE.faces), ball, Disc([0, 0, 0], [0, 0, 1], 1))
