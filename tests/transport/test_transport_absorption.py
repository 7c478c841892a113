"""Light within absorbing bodies: exp(-a d) along every segment, for lights that are sampled or hit
by chance, from the camera and from the light. Index 1, so that nothing is refracted or mirrored.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import Lambert, PointLight, RectangleLight, environment_map
from jaxvision.brdf.glass import Glass
from jaxvision.geometry import Ray
from jaxvision.optics import look_at
from jaxvision.scene import Pinhole, Plane, Quad, Scene, Sphere, Surface, TriangleMesh
from jaxvision.transport import Paths, light_traced, path_radiance, path_traced, ray_tree_radiance

by_paths = jax.jit(path_radiance, static_argnames="method")
by_rays = jax.jit(ray_tree_radiance)
KEY = jax.random.key(8)
DOWN = np.array([0, 0, -1.0])
GREY = Lambert([0.5 / np.pi])
LEAF = Surface(Quad([-0.5, -0.5, -0.5], [1.0, 0, 0], [0, 1.0, 0]), GREY)


def ball(radius, absorption):
    return Surface(Sphere([0.0, 0, 0], radius), Glass(1.0, absorption=absorption))


BALL = ball(2.0, [1.0])


def both(scene, ray, depth=4):
    """Return the radiance by paths and by the ray tree."""
    path = by_paths(KEY, scene, ray, method=Paths(2, depth, strategy="lights"))
    return [float(path.radiance[0]), float(by_rays(scene, ray)[0])]


@pytest.mark.slow
def test_lamp_in_a_body_is_absorbed_up_to_the_lamp():
    """Absorption counts up to the lamp and not to the surface behind it."""
    lamp = RectangleLight([-0.5, -0.5, 1], [1.0, 0, 0], [0, 1.0, 0], [1.0])
    ray = Ray(jnp.asarray([0.1, 0.1, 3.0]), jnp.asarray([0, 0, -1.0]))
    expected = np.exp(-(np.sqrt(4 - 0.02) - 1))
    np.testing.assert_allclose(both(Scene([BALL], [lamp]), ray), expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["lights", "surfaces", "balance"])
def test_every_strategy_finds_an_emitting_ball_through_a_body(strategy):
    """Every strategy agrees with a sum over the ball's surface, with exp(-d) from each place of
    it."""
    centre, radius = np.array([0, 0, 1.3]), 0.5
    core = Surface(Sphere(centre, radius), Lambert([0.0]), [1.0])
    n = 400
    z = (2 * np.arange(n) + 1) / n - 1
    phi = 2 * np.pi * (np.arange(n) + 0.5) / n
    z, phi = (x.reshape(-1) for x in np.meshgrid(z, phi))
    normal = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], -1)
    away = centre + radius * normal - np.array([0.1, 0.1, -0.5])
    d = np.linalg.norm(away, axis=1)
    cosine = np.maximum(-(normal * away).sum(axis=1) / d, 0)
    share = cosine * away[:, 2] / d**3 * np.exp(-d)
    irradiance = share.mean() * 4 * np.pi * radius**2
    start = np.array([2.3, 0.1, 0.1])
    toward = np.array([0.1, 0.1, -0.5]) - start
    toward /= np.linalg.norm(toward)
    b = start @ toward
    within = np.linalg.norm(np.array([0.1, 0.1, -0.5]) - start) - (
        -b - np.sqrt(b * b - start @ start + 4)
    )
    expected = 0.5 / np.pi * irradiance * np.exp(-within)
    method = Paths(20_000, 3, strategy=strategy)
    ray = Ray(jnp.asarray(start), jnp.asarray(toward))
    traced = by_paths(KEY, Scene([BALL, core, LEAF], []), ray, method=method)
    assert float(traced.error[0]) < 0.03 * expected
    assert abs(float(traced.radiance[0]) - expected) < 4 * float(traced.error[0])


OCTAHEDRON = TriangleMesh(
    2 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]),
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]],
)
OF_MESH = Surface(OCTAHEDRON, Glass(1.0, absorption=[1.0]))
WATER = Surface(Plane([0.0, 0, 0.7], [0, 0, 1.0]), Glass(1.0, absorption=[1.0]))
NESTED = {
    "from outside": ([BALL], [0, 0, 3.0], 4.0),
    "from within": ([BALL], [0, 0, 0.5], 2.5),
    "a clear core": ([BALL, ball(1.0, None)], [0, 0, 3.0], 2.0),
    "a dark core": ([BALL, ball(1.0, [3.0])], [0, 0, 3.0], 2 + 6.0),
    "from within the core": ([ball(1.0, [3.0]), BALL], [0, 0, 0.25], 3 * 1.25 + 1),
    "from between, through the core": ([ball(1.0, [3.0]), BALL], [0, 0, 1.5], 0.5 + 6 + 1),
    "from within a mesh": ([OF_MESH], [0.05, 0.02, 0.5], 0.5 + 2 - 0.07),  # |x| + |y| + |z| = 2
}


@pytest.mark.slow
@pytest.mark.parametrize("name", NESTED)
def test_absorption_through_nested_bodies(name):
    """A sky of radiance 1, seen straight down, has the radiance exp(-sum of a d)."""
    surfaces, start, depth = NESTED[name]
    ray = Ray(jnp.asarray(start, float), jnp.asarray([0, 0, -1.0]))
    found = both(Scene(surfaces, [environment_map(np.ones((2, 4, 1)))]), ray, depth=6)
    np.testing.assert_allclose(found, np.exp(-depth), rtol=1e-5)


@pytest.mark.slow
def test_water_below_a_plane_absorbs_down_to_its_floor():
    """The floor lies 1.2 m below the surface of a body of water that has no other side."""
    floor = Surface(Quad([-9.0, -9, -0.5], [18.0, 0, 0], [0, 18.0, 0]), Lambert([0.0]), [1.0])
    ray = Ray(jnp.asarray([0.1, 0.2, 3.0]), jnp.asarray([0, 0, -1.0]))
    np.testing.assert_allclose(both(Scene([WATER, floor], []), ray), np.exp(-1.2), rtol=1e-5)


@pytest.mark.slow
def test_light_tracing_within_a_body_matches_path_tracing():
    """With a bulb and a camera inside the ball, light tracing is absorbed as much as path
    tracing."""
    scene = Scene([BALL, LEAF], [PointLight([0.3, -0.1, 0.6], [3.0])])
    position, target = jnp.asarray([0.0, 0, 1.2]), jnp.asarray([0.0, 0, -0.5])
    rotation = look_at(position, target, jnp.asarray([0, 1.0, 0]))
    view = Pinhole(position, rotation, 1.0, 0.2, resolution=(2, 2))
    eye = jax.jit(path_traced, static_argnames="method")(
        KEY, scene, view, method=Paths(64, 2, strategy="lights")
    )
    light = jax.jit(light_traced, static_argnames=("paths", "depth", "samples"))(
        KEY, scene, view, paths=100_000, depth=2, samples=1
    )
    error = np.sqrt(np.asarray(eye.error**2 + light.error**2))
    assert (error < 0.05 * np.asarray(eye.radiance)).all()
    assert (np.abs(eye.radiance - light.radiance) < 4 * error).all()


def test_shadow_rays_within_a_body_are_absorbed():
    """With camera, leaf and bulb in the ball, light is multiplied by exp(-d) from bulb to leaf and
    from leaf to camera."""
    bulb, target = np.array([0.3, -0.1, 0.6]), np.array([0.1, 0.1, -0.5])
    away = bulb - target
    d = np.linalg.norm(away)
    expected = 0.5 / np.pi * 3 * away[2] / d**3 * np.exp(-d - 0.7)
    ray = Ray(jnp.asarray(target - 0.7 * DOWN), jnp.asarray(DOWN))
    scene = Scene([BALL, LEAF], [PointLight(bulb, [3.0])])
    found = by_paths(KEY, scene, ray, method=Paths(1, 2, strategy="lights"))
    np.testing.assert_allclose(found.radiance[0], expected, rtol=1e-6)
