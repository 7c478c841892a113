"""Shadows against ray-by-ray NumPy and the closed form of a cut rectangle; what shines, both sides
of a surface, meshes; and that an absent shadow leaves nothing behind."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxvision import (
    AmbientLight,
    DirectionalLight,
    Lambert,
    MonteCarlo,
    Orthographic,
    PointLight,
    Quadrature,
    RectangleLight,
    Scene,
    Sphere,
    Surface,
    as_dtype,
    rectangle_irradiance,
    rendering,
)
from jaxvision.brdf.phong import NormalisedPhong, PhongBRDF
from jaxvision.geometry import Ray
from jaxvision.lights import Balanced
from jaxvision.rendering import PixelSamples, bake, radiance_along, render, shade_baked
from jaxvision.scene import Plane, Quad, TriangleMesh

KD = [0.3, 0.2]
FLOOR = Surface(Plane([0, 0, 0], [0, 0, 1]), Lambert(KD))
BALL = Sphere([0.3, -0.2, 1.0], 0.6)
SIDE = 24
VIEW = Orthographic([0, 0, 9], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], 0.2, resolution=(SIDE, SIDE))


def floor_points():
    step = (np.arange(SIDE) - (SIDE - 1) / 2) * 0.2
    return step[None, :] * np.ones((SIDE, 1)), -step[:, None] * np.ones((1, SIDE))


def blocked_by_ball(point, lamp):
    """Whether the segment passes the ball: the distance of its nearest point to the centre."""
    centre, way = np.asarray(BALL.centre), lamp - point
    t = np.clip(np.dot(centre - point, way) / np.dot(way, way), 0, 1)
    return bool(np.linalg.norm(point + t * way - centre) < float(BALL.radius))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_hard_shadows_against_a_loop_over_pixels(dtype):
    """E = I cos / d^2 on the floor, where the segment to the lamp passes the ball 0; the sun's
    shadow beside it, from the other side."""
    lamp, sun = np.array([1.5, 1, 3.0]), np.array([-1.0, 0, 2])
    lights = [PointLight(lamp, [5.0, 4]), DirectionalLight(sun, [1.0, 2])]
    scene, view = as_dtype((Scene([FLOOR, Surface(BALL, Lambert(KD))], lights), VIEW), dtype)
    image = np.asarray(jax.jit(render)(scene, view))
    assert image.dtype == dtype
    compared = dark = 0
    for i, j in np.ndindex(SIDE, SIDE):
        x, y = (float(c[i, j]) for c in floor_points())
        point = np.array([x, y, 0.0])
        if np.hypot(x - 0.3, y + 0.2) < 0.65:
            continue  # the ball itself is seen
        way = lamp - point
        d = np.linalg.norm(way)
        e = np.zeros(2)
        shadows = blocked_by_ball(point, lamp), blocked_by_ball(point, point + 50 * sun)
        if not shadows[0]:
            e += np.array([5.0, 4]) * way[2] / d**3
        if not shadows[1]:
            e += np.array([1.0, 2]) * sun[2] / np.linalg.norm(sun)
        np.testing.assert_allclose(
            image[i, j], np.multiply(KD, e), rtol=2e-6 if dtype == jnp.float32 else 1e-12
        )
        compared, dark = compared + 1, dark + sum(shadows)
    assert compared > 400
    assert dark > 40


WINDOW = {"corner": [-1.0, -1, 2], "edge_u": [0.0, 2, 0], "edge_v": [2.0, 0, 0]}
LAMP = RectangleLight(**WINDOW, radiance=[3.0, 2])
RULES = {
    "quadrature": (Quadrature(48), 0.03),
    "monte carlo": (MonteCarlo(jax.random.key(5), 2048), 0.01),
    "balanced": (Balanced(jax.random.key(6), 2048), 0.04),
}


@pytest.mark.parametrize("rule", RULES)
def test_a_soft_shadow_is_the_rectangle_that_the_blocker_leaves(rule):
    """A long plate at half the height hides x > c of the lamp from each point: what is left is a
    rectangle, whose irradiance has a closed form."""
    rule, tolerance = RULES[rule]
    plate = Surface(Quad([0.1, -50, 1], [60, 0, 0], [0, 100, 0]), Lambert(KD))
    scene = Scene([FLOOR, plate], [LAMP])
    x = jnp.linspace(-1.2, 1.2, 7)

    def at(x):
        origin = jnp.stack([x, jnp.asarray(0.2), jnp.asarray(0.5)])
        return radiance_along(scene, Ray(origin, jnp.asarray([0.0, 0, -1])), rule=rule)

    got = jax.jit(jax.vmap(at))(x)
    normal = jnp.asarray([0.0, 0, 1])
    cuts = []
    for place, value in zip(np.asarray(x), np.asarray(got), strict=True):
        edge = np.clip(place + 2 * (0.1 - place), -1, 1)  # the plate's rim, cast onto the lamp
        cuts.append(edge)
        if edge == -1:
            assert (value == 0).all()
            continue
        left = RectangleLight(WINDOW["corner"], WINDOW["edge_u"], [edge + 1, 0, 0], LAMP.radiance)
        truth = rectangle_irradiance(left, jnp.asarray([place, 0.2, 0.0]), normal)
        whole = rectangle_irradiance(LAMP, jnp.asarray([place, 0.2, 0.0]), normal)
        bound = float(tolerance * 0.3 * whole.max())
        np.testing.assert_allclose(value, np.multiply(KD, truth), atol=bound)
    assert (np.abs(cuts) < 1).sum() >= 4


def operations(jaxpr):
    """How many operations a trace holds, those inside its calls and loops too."""
    inner = (
        value
        for equation in jaxpr.eqns
        for value in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
        )
    )
    jaxprs = [getattr(value, "jaxpr", value) for value in inner]
    return len(jaxpr.eqns) + sum(operations(x) for x in jaxprs if hasattr(x, "eqns"))


def test_an_absent_shadow_is_not_traced():
    """From the jaxpr: without shadows fewer operations, and one shape that cannot shade itself
    has none to begin with."""
    light = [PointLight([1.5, 1, 3.0], [5.0, 4])]
    two = Scene([FLOOR, Surface(BALL, Lambert(KD))], light)

    def count(scene, **options):
        return operations(jax.make_jaxpr(partial(render, **options))(scene, VIEW).jaxpr)

    assert count(two) > count(two, shadows=False) + 30
    for alone in (FLOOR, Surface(BALL, Lambert(KD))):
        assert count(Scene([alone], light)) == count(Scene([alone], light), shadows=False)
    both_sides = Scene([Surface(BALL, Lambert(KD), two_sided=True)], light)
    assert count(both_sides) > count(both_sides, shadows=False) + 30


def ray(origin, direction):
    return Ray(jnp.asarray(origin), jnp.asarray(direction))


def test_both_sides_of_a_surface():
    """Seen and lit from behind: black, unless both sides are fronts; then as if turned over."""
    light = [PointLight([0, 0, -2.0], [5.0, 4])]
    up = ray([0.5, 0, -1.0], [0.0, 0, 1])
    front = Scene([Surface(Plane([0, 0, 0], [0, 0, -1]), Lambert(KD))], light)
    back = Scene([FLOOR], light)
    both = Scene([Surface(FLOOR.shape, FLOOR.material, two_sided=True)], light)
    expected = radiance_along(front, up)
    assert (expected > 0).all()
    assert (radiance_along(back, up) == 0).all()
    np.testing.assert_allclose(radiance_along(both, up), expected, rtol=1e-14)
    inside = Scene(
        [Surface(Sphere([0, 0, 0], 1), Lambert(KD), two_sided=True)],
        [PointLight([0, 0, 0.5], [5.0, 4]), PointLight([0, 0, 3], [9.0, 9])],
    )
    seen = radiance_along(inside, ray([0, 0, 0.0], [0.0, 0, 1]))
    np.testing.assert_allclose(seen, np.multiply(KD, [5.0, 4]) / 0.25, rtol=1e-12)


def test_a_surface_that_shines_is_seen_shining_from_its_front():
    lamp = Surface(Sphere([0, 0, 3], 1), Lambert(KD), [7.0, 8])
    scene = Scene([lamp, FLOOR], [PointLight([0, 0, 1], [2.0, 3])])
    up, down = ray([0, 0, 1.0], [0.0, 0, 1]), ray([3, 0, 1.0], [0.0, 0, -1])
    expected = np.array([7.0, 8]) + np.multiply(KD, [2.0, 3])
    np.testing.assert_allclose(radiance_along(scene, up), expected)
    unlit = np.multiply(KD, [2.0, 3]) / 10**1.5  # by the point alone
    np.testing.assert_allclose(radiance_along(scene, down), unlit)
    assert (radiance_along(scene, ray([0, 0, 3.0], [0.0, 0, 1])) == 0).all()  # its back
    with pytest.raises(ValueError, match=r"surfaces\[0\]\.emission must have 2 bands, got 3"):
        Scene([Surface(BALL, Lambert(KD), [1.0, 1, 1])], [])


def test_a_mesh_with_normals_looks_like_the_ball_it_stands_for():
    """3840 triangles with the ball's own normals: radiance within the squared size of a triangle,
    shadow on the floor included; flat ones are ten times worse."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = ball.vertices * float(BALL.radius) + np.asarray(BALL.centre)
    light = [PointLight([1.5, 1, 3.0], [5.0, 4])]

    def image(shape):
        scene = Scene([FLOOR, Surface(shape, Lambert(KD))], light)
        return np.asarray(jax.jit(render)(scene, VIEW))

    truth = image(BALL)
    smooth = np.abs(image(TriangleMesh(vertices, ball.faces, normals=ball.vertices)) - truth)
    flat = np.abs(image(TriangleMesh(vertices, ball.faces)) - truth)
    assert np.median(smooth[smooth > 1e-9]) < 0.1 * np.median(flat[flat > 1e-9])
    assert (smooth.max(axis=-1) > 0.02).mean() < 0.03  # the terminator and the two silhouettes


def test_gradients_through_shadows():
    """Radiance is linear in k_d and in the light's intensity, so their gradients are quotients;
    in the light's place, finite differences where no shadow edge passes."""
    light = PointLight([1.5, 1, 3.0], [5.0, 4])
    scene = Scene([FLOOR, Surface(BALL, Lambert(KD))], [light])
    down = ray([-1.0, 0.5, 5.0], [0.0, 0, -1])

    def total(scene):
        return radiance_along(scene, down).sum()

    value, slope = jax.jit(jax.value_and_grad(total))(scene)
    kd, intensity = slope.surfaces[0].material.diffuse, slope.lights[0].intensity
    np.testing.assert_allclose((kd * jnp.asarray(KD)).sum(), value, rtol=1e-13)
    np.testing.assert_allclose((intensity * light.intensity).sum(), value, rtol=1e-13)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))
    step = 1e-5

    def moved(d):
        lamp = PointLight(light.position + d, light.intensity)
        return float(total(Scene(scene.surfaces, [lamp])))

    for axis in np.eye(3):
        numeric = (moved(step * axis) - moved(-step * axis)) / (2 * step)
        np.testing.assert_allclose(slope.lights[0].position @ axis, numeric, rtol=1e-6)


def test_many_rays_a_pixel_cover_an_edge_by_its_part():
    """A plate that ends a quarter into the second pixel; one ray through the centre misses it."""
    view = Orthographic([0, 0, 9], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], 1.0, resolution=(1, 2))
    plate = Surface(Quad([-1, -5, 0], [1.25, 0, 0], [0, 10, 0]), Lambert([0.3]))
    scene = Scene([plate], [DirectionalLight([0, 0, 1], [2.0])])
    np.testing.assert_allclose(render(scene, view).ravel(), [0.6, 0], rtol=1e-12)
    samples = PixelSamples(jax.random.key(0), 4000)
    mean = jax.jit(render)(scene, view, samples=samples).ravel()
    error = 0.6 * np.sqrt(0.25 * 0.75 / 4000)
    np.testing.assert_allclose(mean, [0.6, 0.15], atol=4 * error)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        PixelSamples(jax.random.key(0), 0)


@pytest.mark.parametrize("rule", [Quadrature(3), MonteCarlo(jax.random.key(2), 5)])
def test_baked_geometry_gives_the_same_picture_and_gradient(rule):
    """With other materials and a brighter lamp than were baked: equal to tracing anew."""
    plate = Surface(Quad([0.1, -50, 1], [60, 0, 0], [0, 100, 0]), Lambert(KD), [0.5, 0.4])
    lamps = [PointLight([-1.5, 1, 3.0], [5.0, 4]), LAMP]
    baked = bake(Scene([FLOOR, Surface(BALL, Lambert(KD)), plate], lamps), VIEW, rule=rule)

    def scene(kd):
        brighter = [PointLight([-1.5, 1, 3.0], [9.0, 2]), lamps[1]]
        return Scene([FLOOR, Surface(BALL, Lambert(kd)), plate], brighter)

    def losses(kd):
        again, traced = shade_baked(baked, scene(kd)), render(scene(kd), VIEW, rule=rule)
        return (again**2).sum(), (traced**2).sum()

    kd = jnp.asarray([0.25, 0.1])
    (again, traced), slopes = jax.jit(lambda kd: (losses(kd), jax.jacrev(losses)(kd)))(kd)
    np.testing.assert_allclose(again, traced, rtol=1e-12)
    np.testing.assert_allclose(*slopes, rtol=1e-11)
    with pytest.raises(ValueError, match="Balanced"):
        bake(scene(kd), VIEW, rule=Balanced(jax.random.key(1), 4))


@pytest.mark.parametrize(("kind", "at_once"), [(PhongBRDF, 2), (NormalisedPhong, 2048)])
def test_baked_angles_serve_the_kinds_that_were_baked_and_others(kind, at_once, monkeypatch):
    """Of a lobe the angles were baked, shadows among them, the other's were not: both shade as
    light that is traced, with the same gradients, in parts as in one."""
    monkeypatch.setattr(rendering, "_BLOCKS", at_once)
    lamps, dark = [PointLight([-1.5, 1, 3.0], [5.0, 4]), LAMP], AmbientLight([0.2, 0.1])
    first = PhongBRDF(KD, [0.3], 9.0)
    baked = bake(Scene([FLOOR, Surface(BALL, first)], lamps, ambient=dark), VIEW)
    assert baked.angles[baked.kinds.index(PhongBRDF)] is not None

    def losses(exponent):
        material = kind([0.2, 0.3], [0.4], exponent, ambient=[0.5, 0.6])
        scene = Scene([FLOOR, Surface(BALL, material)], lamps, ambient=dark)
        return (shade_baked(baked, scene) ** 2).sum(), (render(scene, VIEW) ** 2).sum()

    (again, traced), slopes = jax.jit(lambda n: (losses(n), jax.jacrev(losses)(n)))(
        jnp.asarray(17.0)
    )
    np.testing.assert_allclose(again, traced, rtol=1e-12)
    np.testing.assert_allclose(*slopes, rtol=1e-11)


def test_baked_pictures_are_differentiated_both_ways_and_mapped():
    """Forward as backward, for one material or a stack of them; black where nothing is seen."""
    ball = Sphere([0.3, -0.2, 1.0], 0.4)
    scene = Scene([Surface(ball, Lambert(KD))], [PointLight([1.5, 1, 3.0], [5.0, 4])])
    view = Orthographic(VIEW.position, VIEW.rotation, 0.2, resolution=(8, 8))
    baked = bake(scene, view)

    def total(kd):
        picture = shade_baked(baked, Scene([Surface(ball, Lambert(kd))], scene.lights))
        return jnp.stack([picture.sum(), (picture**2).sum()])

    kd = jnp.asarray([[0.25, 0.1], [0.5, 0.4]])
    forward = jax.jit(jax.vmap(jax.jacfwd(total)))(kd)
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.jacrev(total)))(kd), forward, rtol=1e-13)
    assert (forward > 0).all()
    away = Orthographic([9.0, 9, 9], VIEW.rotation, 0.2, resolution=(8, 8))
    assert (shade_baked(bake(scene, away), scene) == 0).all()
