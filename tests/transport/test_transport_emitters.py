"""Direct sampling of emitters: none shadows itself, at any angle and scale, and the strategies
estimate the same integral, against closed forms.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import jaxvision as jv
from jaxvision.core._random import Stream, seed_of
from jaxvision.core._vector import as_array
from jaxvision.geometry import Ray
from jaxvision.optics import look_at
from jaxvision.scene import Disc, Pinhole, Quad, Scene, Sphere, Surface, TriangleMesh
from jaxvision.transport import (
    Paths,
    light_traced,
    path_radiance,
    path_sample,
    path_traced,
    ray_tree_radiance,
)
from jaxvision.transport._emitters import toward_emitter
from jaxvision.transport._vertices import hidden, meet, world_of
from jaxvision.transport.radiosity import plan_patches, radiosity

KEY = jax.random.key(6)
by_rays = jax.jit(ray_tree_radiance)
from_lights = jax.jit(light_traced, static_argnames=("paths", "depth", "samples"))
GREY, BLACK = jv.Lambert([0.5 / np.pi]), jv.Lambert([0.0])
FLOOR = Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), GREY)
DOWN = np.array([0.0, 0, -1])
LOOKS = Ray(jnp.asarray([0.01, 0.02, 0.5]), jnp.asarray(DOWN))  # at the floor from above
POINT = np.array([0.01, 0.02, 0])


def wide(half):
    """Return a square one metre above the floor that emits downwards."""
    return [-half, -half, 1.0], [0, 2 * half, 0.0], [2 * half, 0, 0.0]


TILTED = [-1.0, -2.0, 0.2], [0.0, 4.0, 0.5], [3.0, 0.0, 2.0]


def polygon_irradiance(point, corners):
    """Return the irradiance by Lambert's contour formula, for polygons wholly above the floor."""
    away = np.asarray(corners) - point
    away /= np.linalg.norm(away, axis=1)[:, None]
    following = np.roll(away, -1, axis=0)
    across = np.cross(away, following)
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, (away * following).sum(axis=1))
    return abs((angle * across[:, 2] / sine).sum()) / 2


def quad_irradiance(corner, u, v):
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    return polygon_irradiance(POINT, [corner, corner + u, corner + u + v, corner + v])


def sphere_irradiance(centre, radius):
    away = np.array(centre) - POINT
    return np.pi * radius**2 * away[2] / np.linalg.norm(away) ** 3


SHAPES = {
    "wide quad": Quad(*wide(20.0)),
    "tilted quad": Quad(*TILTED),
    "sphere": Sphere([0.3, 0.2, 1.0], 0.25),
    "disc": Disc([0.0, 0.1, 1.0], [0.0, 0.6, -0.8], 1.2),
    "mesh": TriangleMesh([[-9.0, -9, 1], [-9, 9.0, 1], [9.0, 0, 1]], [[0, 1, 2]]),
}


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("name", SHAPES)
def test_emitters_never_hide_themselves(name, dtype):
    """For 20000 sampled places nothing lies in front of the emitter, whether it is as large as the
    floor, 1e4 times as large and as far, or both are tiny; a small leaf just in front of it hides
    all of them."""
    floor = Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0])

    def blocked(scale, of_floor):
        def scaled(shape, by):
            lengths = ("corner", "edge_u", "edge_v", "centre", "radius", "vertices")
            return jax.tree_util.tree_map_with_path(
                lambda path, x: x.astype(dtype) * by if path[0].name in lengths else x, shape
            )

        scene = Scene(
            [
                Surface(scaled(floor, of_floor), GREY),
                Surface(scaled(SHAPES[name], scale), BLACK, [1.0], two_sided=name == "mesh"),
            ],
            [],
        )
        world = world_of(jv.as_dtype(scene, dtype))
        start = jnp.asarray([0.01, 0.02, 0.05], dtype) * of_floor
        met = meet(world.surfaces, Ray(start, jnp.asarray(DOWN, dtype)))

        def one(u):
            toward = toward_emitter(world.emitters, met.hit.point, u)
            dark = hidden(world.surfaces, met, toward.direction, toward.clear)
            return dark & (toward.irradiance[0] > 0) & (toward.direction.z > 0)

        u = jax.random.uniform(KEY, (20000, 3), dtype)
        return jax.vmap(one)(u).sum()

    count = jax.jit(blocked)
    for scale, of_floor in ((1.0, 1.0), (1e3, 1.0), (1e4, 1.0), (1e-3, 1e-3), (1e4, 1e4)):
        assert int(count(jnp.asarray(scale, dtype), jnp.asarray(of_floor, dtype))) == 0


@pytest.mark.slow
def test_a_leaf_just_before_a_lamp_hides_it():
    """The leaf lies at a thousandth of the distance in front of a wide lamp, or of an emitting
    quad, above a floor."""
    leaf = Surface(Quad([-30.0, -30, 0.999], [60.0, 0, 0], [0, 60.0, 0]), BLACK)
    lamp = Surface(Quad(*wide(20.0)), BLACK, [1.0])
    scene = jv.as_dtype(Scene([FLOOR, lamp, leaf], []), jnp.float32)
    found = by_rays(scene, jv.as_dtype(LOOKS, jnp.float32))
    assert float(found[0]) == 0


def mean_of_paths(scene, ray, method, count):
    """Return (mean, standard error) of many single paths at once."""
    seed = seed_of(KEY)

    def one(scene, pixel):
        return path_sample(scene, ray, Stream(pixel, jnp.uint32(0), seed), method=method)

    numbers = jnp.arange(count, dtype=jnp.uint32)
    values = np.asarray(jax.jit(jax.vmap(one, in_axes=(None, 0)))(scene, numbers))
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(count)


EMITTERS = {
    "wide quad": (Quad(*wide(5.0)), quad_irradiance(*wide(5.0))),
    "tilted quad": (Quad(*TILTED), quad_irradiance(*TILTED)),
    "sphere": (Sphere([0.3, 0.2, 1.0], 0.25), sphere_irradiance([0.3, 0.2, 1.0], 0.25)),
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", EMITTERS)
@pytest.mark.parametrize("strategy", ["lights", "surfaces"])
def test_each_strategy_finds_the_closed_form(name, strategy):
    """A floor of albedo .5 under a surface of radiance 1 has the radiance .5 E / pi."""
    shape, irradiance = EMITTERS[name]
    scene = Scene([FLOOR, Surface(shape, BLACK, [1.0])], [])
    mean, error = mean_of_paths(scene, LOOKS, Paths(1, 2, strategy=strategy), 200_000)
    expected = 0.5 * irradiance / np.pi
    assert error[0] < 0.012 * expected
    assert abs(mean[0] - expected) < 4 * error[0]


@pytest.mark.slow
def test_weights_among_several_emitters():
    """Each of three emitters is drawn a third of the time, which the weight of one hit by chance
    must include: the radiance is .5 / pi times the sum of their irradiances."""
    centre, radius = [1.8, 0.2, 0.6], 0.5  # so large that either way finds it as easily
    ball = Surface(Sphere(centre, radius), BLACK, [10.0])
    lights = [jv.RectangleLight(*wide(1.0), [1.0]), jv.PointLight([0.01, 0.02, 2.0], [0.4])]
    irradiance = quad_irradiance(*wide(1.0)) + 10 * sphere_irradiance(centre, radius) + 0.4 / 4
    scene = Scene([FLOOR, ball], lights)
    mean, error = mean_of_paths(scene, LOOKS, Paths(1, 2, strategy="balance"), 40_000)
    expected = 0.5 * irradiance / np.pi
    assert error[0] < 0.005 * expected
    assert abs(mean[0] - expected) < 4 * error[0]


@pytest.mark.slow
def test_a_lamp_in_the_plane_of_the_ceiling_is_not_hidden():
    """In float32 a lamp in the plane of a ceiling lights the floor, also far from the floor and the
    origin."""
    for scale in (1.0, 1e4):
        corner, u, v = (np.array(x) * scale for x in wide(5.0))
        ceiling = [np.array(x) * scale for x in wide(9.0)]
        scene = Scene(
            [FLOOR, Surface(Quad(*ceiling), GREY)], [jv.RectangleLight(corner, u, v, [1.0])]
        )
        scene, ray = jv.as_dtype((scene, LOOKS), jnp.float32)
        alone = Scene(scene.surfaces[:1], scene.lights)
        shown, unhidden = by_rays(scene, ray), by_rays(alone, ray)
        assert float(shown[0]) > 0.05
        np.testing.assert_allclose(shown, unhidden, rtol=1e-3)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_point_light_alone(dtype):
    """With a point light and no emitting surface, the radiance is albedo I cos / (pi d^2)."""
    scene = jv.as_dtype(Scene([FLOOR], [jv.PointLight([0.01, 0.02, 2.0], [3.0])]), dtype)
    traced = path_radiance(KEY, scene, jv.as_dtype(LOOKS, dtype), method=Paths(2, 3))
    assert traced.radiance.dtype == dtype
    np.testing.assert_allclose(traced.radiance, 0.5 / np.pi * 3 / 4, rtol=1e-5)


@pytest.mark.slow
def test_error_of_many_samples_does_not_overflow():
    """n (n - 1) of 50000 samples does not fit an int32."""
    scene, ray = jv.as_dtype((Scene([Surface(FLOOR.shape, BLACK, [2.0])], []), LOOKS), jnp.float32)
    traced = path_radiance(KEY, scene, ray, method=Paths(50_000, 1))
    np.testing.assert_allclose(traced.radiance, 2, rtol=1e-6)
    assert float(traced.error[0]) < 1e-6


def camera(position, target, field, pixels):
    rotation = look_at(*(jnp.asarray(x, float) for x in (position, target, [0, 1.0, 0])))
    return Pinhole(jnp.asarray(position, float), rotation, 1.0, field, resolution=(pixels, pixels))


@pytest.mark.slow
def test_a_lamp_hides_the_wall_behind_it():
    """A pixel of the lamp shows only the lamp's radiance, though the wall behind it is bright and
    its light passes the lamp on the way to other surfaces."""
    wall = Surface(Quad([-2.0, -2, 0], [4.0, 0, 0], [0, 4.0, 0]), GREY)
    lights = [
        jv.RectangleLight([-0.5, -0.5, 1], [1.0, 0, 0], [0, 1.0, 0], [1.0]),  # toward the camera
        jv.PointLight([0.0, 1.9, 3.0], [20.0]),
    ]
    view = camera([0.0, 0, 4], [0.0, 0, 0], 0.1, 5)
    seen = from_lights(KEY, Scene([wall], lights), view, paths=4000, depth=2, samples=2)
    np.testing.assert_allclose(seen.radiance[2, 2], 1, rtol=1e-6)
    assert float(seen.radiance[::4, ::4].sum()) > 0.3  # the wall, in the corners of the picture


@pytest.mark.slow
def test_interpolated_normals_in_path_and_light_tracing():
    """The radiance is f_r cos_s(light) E from every side, by paths from the camera and from the
    light."""
    lean = np.array([np.sin(0.6), 0, np.cos(0.6)])
    corners = [[-4.0, -4, 0], [4.0, -4, 0], [0, 5.0, 0]]
    triangle = TriangleMesh(corners, [[0, 1, 2]], normals=np.tile(lean, (3, 1)))
    scene = Scene([Surface(triangle, GREY)], [jv.DirectionalLight([0.0, 0, 1], [1.0])])
    expected = 0.5 / np.pi * np.cos(0.6)
    view = camera([-3.0, 0, 3], [0.0, 0, 0], 0.06, 2)
    eye = path_traced(KEY, scene, view, method=Paths(2, 2)).radiance
    np.testing.assert_allclose(eye, expected, rtol=1e-9)
    light = from_lights(KEY, scene, view, paths=400_000, depth=2, samples=1)
    error = float(jnp.sqrt((light.error**2).mean() / light.error.size))
    assert error < 0.1 * expected
    assert abs(float(light.radiance.mean()) - expected) < 4 * error


@pytest.mark.slow
def test_interpolated_normals_create_no_light():
    """A white icosahedron that is shaded as a ball, under a sky of radiance 1, is nowhere brighter
    than 1. Of the directions about the shading normal, (1 - cos) / 2 of the light would come
    through the face itself: that part is lost, up to a tenth at a corner, and so is a face seen
    from behind the shading normal."""
    ball = trimesh.creation.icosahedron()
    vertices = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    mesh = TriangleMesh(vertices, ball.faces, normals=vertices)
    sky = jv.environment_map(np.ones((2, 4, 1)))
    scene = Scene([Surface(mesh, jv.Lambert([1 / np.pi]))], [sky])
    toward = np.random.default_rng(3).normal(size=(20_000, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    aside = np.cross(toward, np.roll(toward, 1, axis=1))
    rays = Ray(jnp.asarray(3 * toward + 0.8 * aside), jnp.asarray(-toward))
    seed = seed_of(KEY)

    def one(ray, pixel):
        stream = Stream(pixel, jnp.uint32(0), seed)
        return path_sample(scene, ray, stream, method=Paths(1, 4, strategy="surfaces"))[0]

    met = jax.vmap(partial(meet, world_of(scene).surfaces))(rays)
    assert met.hit.shading_normal is not None
    shades, face = as_array(met.hit.shading_normal), as_array(met.hit.normal)
    on_ball = np.asarray(met.surface) >= 0
    assert on_ball.mean() > 0.5
    cosine = np.sum(np.asarray(shades) * np.asarray(face), axis=1)
    seen = np.sum(np.asarray(shades) * toward, axis=1) > 0
    expected = np.where(seen, (1 + cosine) / 2, 0)
    pixels = jnp.arange(len(toward), dtype=jnp.uint32)
    found = np.asarray(jax.jit(jax.vmap(one))(rays, pixels))
    assert found.max() < 1 + 1e-12
    apart = (found - expected)[on_ball]
    assert abs(apart.mean()) < 4 * apart.std() / np.sqrt(apart.size)
    assert 0.88 < expected[on_ball & seen].min() < 0.92
    assert expected[on_ball & seen].mean() > 0.95
    assert seen[on_ball].mean() > 0.97


@pytest.mark.slow
def test_ambient_light_is_not_traced():
    """Tracers that compute interreflection leave ambient light out and give black; light tracing
    raises an error."""
    scene = Scene([FLOOR], [], ambient=jv.AmbientLight([3.0]))
    traced = path_radiance(KEY, scene, LOOKS, method=Paths(2, 3))
    np.testing.assert_array_equal(traced.radiance, 0)
    np.testing.assert_array_equal(by_rays(scene, LOOKS), 0)
    plan = plan_patches(scene, size=1.0)
    np.testing.assert_array_equal(radiosity(scene, plan).radiosity, 0)
    view = camera([0.0, 0, 4], [0.0, 0, 0], 0.1, 2)
    with pytest.raises(ValueError, match="something that shines"):
        light_traced(KEY, scene, view, paths=10)
