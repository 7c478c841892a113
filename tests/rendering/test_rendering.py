"""Tests shadows against ray-by-ray NumPy and the closed form of a clipped rectangle, emission,
two-sided surfaces, meshes, and that absent shadows leave nothing in the program."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxvision import (
    DirectionalLight,
    Lambert,
    MonteCarlo,
    OrenNayar,
    Orthographic,
    PointLight,
    Quadrature,
    RectangleLight,
    Scene,
    Sphere,
    Surface,
    ThinLens,
    as_dtype,
    rectangle_irradiance,
)
from jaxvision.brdf.phong import NormalisedPhong, PhongBRDF
from jaxvision.core._random import Stream, seed_of
from jaxvision.geometry import Ray
from jaxvision.lights import Balanced, rules_of
from jaxvision.rendering import (
    PixelSamples,
    direct_along,
    numbers_of,
    photograph,
    radiance_along,
    render,
    sample_ray,
)
from jaxvision.rendering.shadows import Leaving, visibility
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
    """Return whether the segment passes through the ball, by the distance of its nearest point from
    the centre."""
    centre, way = np.asarray(BALL.centre), lamp - point
    t = np.clip(np.dot(centre - point, way) / np.dot(way, way), 0, 1)
    return bool(np.linalg.norm(point + t * way - centre) < float(BALL.radius))


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_hard_shadows_against_a_loop_over_pixels(dtype):
    """The floor has E = I cos / d^2, and 0 where the segment to the lamp passes through the
    ball."""
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
            continue  # the ball itself
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


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("rule", RULES)
def test_a_soft_shadow_is_the_unblocked_rectangle(rule):
    """A long plate at half the height hides x > c of the lamp from each point."""
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
        edge = np.clip(
            place + 2 * (0.1 - place), -1, 1
        )  # the plate's edge, projected onto the lamp
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


def operations(jaxpr, call=None):
    """Return the number of operations in a trace, or of calls of one name, including inner calls
    and loops."""
    inner = (
        value
        for equation in jaxpr.eqns
        for value in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
        )
    )
    jaxprs = [getattr(value, "jaxpr", value) for value in inner]
    own = sum(call in (None, equation.params.get("name")) for equation in jaxpr.eqns)
    return own + sum(operations(x, call) for x in jaxprs if hasattr(x, "eqns"))


@pytest.mark.slow
@pytest.mark.parametrize("rule", [Quadrature(2), MonteCarlo(jax.random.key(1), 3)])
def test_shadows_are_computed_once_for_all_types_of_material(rule):
    """With four types of material the program has as many shadow tests as with one."""
    lights = [PointLight([1.5, 1, 3.0], [5.0, 4]), LAMP]
    kinds = [Lambert(KD), PhongBRDF(KD, KD, 9.0), NormalisedPhong(KD, KD, 9.0), OrenNayar(KD, 0.3)]

    def count(materials):
        spheres = [Sphere([x, 0.0, 1], 0.4) for x in (-1.5, -0.5, 0.5, 1.5)]
        scene = Scene([Surface(*pair) for pair in zip(spheres, materials, strict=True)], lights)
        program = jax.make_jaxpr(lambda scene: render(scene, VIEW, rule=rule))(scene)
        return operations(program.jaxpr, "_blocks")

    assert count(kinds) == count([kinds[0]] * 4) > 0


@pytest.mark.slow
def test_only_named_occluders_block():
    """A ball and a plate block a lamp. Each alone as an occluder gives only its own shadow, and
    both together the usual picture."""
    plate = Surface(Quad([-2.0, 1.0, 1], [1.5, 0, 0], [0, 1.5, 0]), Lambert(KD))
    surfaces, light = (
        [FLOOR, Surface(BALL, Lambert(KD)), plate],
        [PointLight([0, 0, 6.0], [5.0, 4])],
    )
    draw = jax.jit(render)

    def picture(occluders):
        return np.asarray(draw(Scene(surfaces, light, occluders=occluders), VIEW))

    whole, none = picture(None), picture(())
    np.testing.assert_array_equal(picture([0, 1, 2]), whole)
    by_ball, by_plate = picture([1]) < 0.5 * none, picture([2]) < 0.5 * none
    assert by_ball.any()
    assert by_plate.any()
    assert not (by_ball & by_plate).any()
    np.testing.assert_array_equal(by_ball | by_plate, whole < 0.5 * none)
    for wrong, said in (([3], "numbers of 3 surfaces, got 3"), ([-1], "at least 0, got -1")):
        with pytest.raises(ValueError, match=said):
            Scene(surfaces, light, occluders=wrong)


@pytest.mark.slow
def test_each_light_uses_its_own_rule():
    """The picture of lamps with different rules is the sum of pictures of each lamp with its
    rule."""
    fine, drawn = Quadrature(6), MonteCarlo(jax.random.key(3), 7)
    other = RectangleLight([1.0, 1, 3], [0, 0.5, 0], [0.5, 0, 0], [3.0, 2])
    point = PointLight([1.5, 1, 3.0], [5.0, 4])
    surfaces = [FLOOR, Surface(BALL, PhongBRDF(KD, KD, 9.0))]
    lights, rules = [LAMP, point, other, LAMP], [fine, drawn, None, drawn]

    @jax.jit
    def both():
        whole = render(Scene(surfaces, lights, rules=rules), VIEW, rule=Quadrature(2))
        parts = [
            render(Scene(surfaces, [light]), VIEW, rule=rule or Quadrature(2))
            for light, rule in zip(lights, rules, strict=True)
        ]
        return whole, sum(parts)

    np.testing.assert_allclose(*both(), rtol=1e-12)
    with pytest.raises(ValueError, match="for each of 4 lights, got 1"):
        Scene(surfaces, lights, rules=[fine])
    with pytest.raises(ValueError, match=r"Scene\.rules\[1\] must be a record"):
        render(Scene(surfaces, lights, rules=[fine, "fine", None, None]), VIEW)
    with pytest.raises(ValueError, match="one for each of 4 lights, got 2"):
        visibility(lights, jnp.zeros(3), [BALL], Leaving(jnp.eye(3)[2]), rule=(fine, fine))


@pytest.mark.slow
def test_a_thin_lens_needs_samples():
    """One ray through its centre would give a pinhole picture, in focus everywhere."""
    scene = Scene([Surface(BALL, Lambert(KD))], [PointLight([1.5, 1, -3.0], [5.0, 4])])
    about = {"resolution": (3, 4), "focus_distance": 0.5}
    lens = ThinLens([0.3, 0, -1], np.eye(3), 0.05, 1e-2, f_number=2.0, **about)
    with pytest.raises(ValueError, match="give samples, or use a Pinhole"):
        render(scene, lens)
    closed = ThinLens([0.3, 0, -1], np.eye(3), 0.05, 1e-2, f_number=np.inf, **about)
    image = render(scene, closed)
    assert (image > 0).any()
    samples = PixelSamples(jax.random.key(0), 2)
    assert render(scene, lens, samples=samples).shape == image.shape


def ray(origin, direction):
    return Ray(jnp.asarray(origin), jnp.asarray(direction))


def test_both_sides_of_a_surface():
    """Seen and lit from behind, a surface is black unless it is two-sided, and then as if turned
    over."""
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


def test_emission_is_seen_from_the_front():
    lamp = Surface(Sphere([0, 0, 3], 1), Lambert(KD), [7.0, 8])
    scene = Scene([lamp, FLOOR], [PointLight([0, 0, 1], [2.0, 3])])
    up, down = ray([0, 0, 1.0], [0.0, 0, 1]), ray([3, 0, 1.0], [0.0, 0, -1])
    expected = np.array([7.0, 8]) + np.multiply(KD, [2.0, 3])
    np.testing.assert_allclose(radiance_along(scene, up), expected)
    unlit = np.multiply(KD, [2.0, 3]) / 10**1.5  # light of the point only
    np.testing.assert_allclose(radiance_along(scene, down), unlit)
    assert (radiance_along(scene, ray([0, 0, 3.0], [0.0, 0, 1])) == 0).all()  # from behind
    with pytest.raises(ValueError, match=r"surfaces\[0\]\.emission must have 2 bands, got 3"):
        Scene([Surface(BALL, Lambert(KD), [1.0, 1, 1])], [])


@pytest.mark.slow
def test_a_mesh_with_normals_looks_like_the_ball():
    """The mesh has 3840 triangles with the ball's own normals."""
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
    assert (smooth.max(axis=-1) > 0.02).mean() < 0.03  # terminator and two silhouettes


def test_a_mesh_alone_shades_itself():
    """The mesh is a floor with a leaf above it, under a lamp."""
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = np.concatenate([square, 0.3 * square + [0, 0, 0.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = TriangleMesh(vertices, np.concatenate([faces, faces + 4]))
    scene = Scene([Surface(mesh, Lambert(KD))], [PointLight([0, 0, 2.0], [5.0, 4])])
    look = partial(radiance_along, scene)
    beside, under = (look(ray([x + 0.3, 0, 0.4], [-0.6, 0, -0.8])) for x in (0.7, 0.1))
    np.testing.assert_allclose(beside, np.multiply(KD, [5.0, 4]) * 2 / (0.49 + 4) ** 1.5)
    np.testing.assert_array_equal(under, 0)


@pytest.mark.slow
def test_gradients_through_shadows():
    """Radiance is linear in k_d and in the light's intensity, so the gradients are quotients."""
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


@pytest.mark.slow
def test_many_rays_per_pixel_give_the_covered_area():
    """A plate ends a quarter into the second pixel, where one ray through the centre misses it."""
    view = Orthographic([0, 0, 9], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], 1.0, resolution=(1, 2))
    plate = Surface(Quad([-1, -5, 0], [1.25, 0, 0], [0, 10, 0]), Lambert([0.3]))
    scene = Scene([plate], [DirectionalLight([0, 0, 1], [2.0])])
    draw = jax.jit(render)
    np.testing.assert_allclose(np.ravel(draw(scene, view)), [0.6, 0], rtol=1e-12)
    samples = PixelSamples(jax.random.key(0), 4000)
    mean = np.ravel(draw(scene, view, samples=samples))
    error = 0.6 * np.sqrt(0.25 * 0.75 / 4000)
    np.testing.assert_allclose(mean, [0.6, 0.15], atol=4 * error)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        PixelSamples(jax.random.key(0), 0)


LENS = ThinLens(
    VIEW.position, VIEW.rotation, 0.05, 1e-3, resolution=(5, 7), f_number=0.1, focus_distance=7.0
)


@pytest.mark.slow
def test_pixels_do_not_depend_on_tiles_nor_samples_on_calls():
    """Some pixels alone, in another order, equal those of the whole picture bit by bit."""
    lamps = [PointLight([1.5, 1, 3.0], [5.0, 4]), LAMP]
    scene = Scene([FLOOR, Surface(BALL, Lambert(KD))], lamps)
    rule, key = MonteCarlo(jax.random.key(1), 3), jax.random.key(2)

    @partial(jax.jit, static_argnames=("count", "first"))
    def traced(pixels, count, first):
        along, samples = direct_along(scene, rule), PixelSamples(key, count)
        return photograph(along, LENS, samples, pixels=pixels, first_sample=first)

    whole = jax.jit(lambda: photograph(direct_along(scene, rule), LENS, PixelSamples(key, 3)))()
    rows, columns = np.array([3, 0, 4]), np.array([2, 6, 0])
    some = traced((rows, columns), 3, 0)
    np.testing.assert_array_equal(some.radiance, whole.radiance[rows, columns])
    np.testing.assert_array_equal(some.error, whole.error[rows, columns])
    after, all_six = traced((rows, columns), 3, 3), traced((rows, columns), 6, 0)
    mean = (some.radiance + after.radiance) / 2
    np.testing.assert_allclose(mean, all_six.radiance, rtol=1e-13)
    assert (some.radiance != after.radiance).any()


def test_a_view_without_a_lens_draws_two_numbers_per_sample():
    """In the jaxpr there are four numbers only for a lens."""
    stream = Stream(jnp.uint32(1), jnp.uint32(2), jnp.zeros(2, jnp.uint32))

    def program(view):
        zero = jnp.zeros(())
        return str(jax.make_jaxpr(lambda stream: sample_ray(view, zero, zero, stream))(stream))

    assert "f64[2]" in program(VIEW)
    assert "f64[4]" not in program(VIEW)
    assert "f64[4]" in program(LENS)


def test_each_sample_of_a_pixel_has_its_own_key():
    """Random rules have a key for every pixel and sample, which is reproducible."""
    lamp = RectangleLight([0.0, 0, 1], [0, 1.0, 0], [1.0, 0, 0], [1.0, 1.0])
    rule, seed = MonteCarlo(jax.random.key(4), 1), seed_of(jax.random.key(5))

    def key(pixel, sample):
        stream = Stream(jnp.uint32(pixel), jnp.uint32(sample), seed)
        (own,) = rules_of(Scene([FLOOR], [lamp]), rule, numbers=numbers_of(stream))
        return tuple(np.asarray(jax.random.key_data(own.key)).tolist())

    assert len({key(pixel, sample) for pixel in range(3) for sample in range(3)}) == 9
    assert key(1, 2) == key(1, 2)
