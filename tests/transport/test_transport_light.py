"""Ray trees against a ray-by-ray tracer in NumPy; light tracing against path tracing."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision.brdf.glass import Glass
from jaxvision.core._vector import as_array
from jaxvision.geometry import Ray, ball_around
from jaxvision.lights import LightFieldLight, Window
from jaxvision.scene import Box, Disc, Distortion, Plane, Quad, Scene, Sphere, Surface, TriangleMesh
from jaxvision.transport import (
    Paths,
    light_traced,
    path_traced,
    ray_traced,
    ray_tree_radiance,
    ray_tree_radiances,
)
from jaxvision.transport._emitters import emitters_of
from jaxvision.transport.light_paths import _emit as emitted

KEY = jax.random.key(2)
BLACK = jv.Lambert([0.0, 0.0])

# ------------------------------------------------ mirror and glass, ray by ray

GLASS, MIRROR = (np.array([0.0, 0, 0]), 0.6, 1.45), (np.array([1.1, 0.4, -0.2]), 0.4)
REFLECTANCE = np.array([0.9, 0.6])
WALLS = [  # corner, edges, emission: an open box around both spheres
    ([-3.0, -3, -3], [6.0, 0, 0], [0, 6.0, 0], [1.0, 0.2]),
    ([-3.0, -3, -3], [0, 6.0, 0], [0, 0, 6.0], [0.3, 0.8]),
    ([3.0, -3, -3], [0, 0, 6.0], [0, 6.0, 0], [0.5, 0.1]),
    ([-3.0, 3, -3], [6.0, 0, 0], [0, 0, 6.0], [0.05, 2.0]),
]


def sphere_by_numpy(o, d, centre, radius):
    f = o - centre
    b, c = f @ d, f @ f - radius**2
    if b * b <= c:
        return np.inf
    root = np.sqrt(b * b - c)
    return next((t for t in (-b - root, -b + root) if t > 1e-9), np.inf)


def walls_by_numpy(o, d):
    best = (np.inf, np.zeros(2))
    for corner, u, v, emission in WALLS:
        corner, u, v = (np.array(x) for x in (corner, u, v))
        n = np.cross(u, v)
        if n @ d == 0:
            continue
        t = n @ (corner - o) / (n @ d)
        inside = o + t * d - corner
        a, b = inside @ u / (u @ u), inside @ v / (v @ v)
        if 1e-9 < t < best[0] and 0 <= a <= 1 and 0 <= b <= 1:
            best = (t, np.array(emission) if n @ d < 0 else np.zeros(2))
    return best


def traced_by_numpy(o, d, weight=1.0):
    """Return the radiance by Whitted's recursion, until a branch weighs less than 1e-9."""
    if weight < 1e-9:
        return np.zeros(2)
    d = d / np.linalg.norm(d)  # otherwise its length drifts, and a ray meets its start again
    ball, mirror = sphere_by_numpy(o, d, *GLASS[:2]), sphere_by_numpy(o, d, *MIRROR)
    wall, emission = walls_by_numpy(o, d)
    nearest = min(ball, mirror, wall)
    if nearest == np.inf:
        return np.zeros(2)
    p = o + nearest * d
    if nearest == wall:
        return emission
    if nearest == mirror:
        n = (p - MIRROR[0]) / MIRROR[1]
        return REFLECTANCE * traced_by_numpy(p, d - 2 * (d @ n) * n, weight)
    n, n_in, n_out = (p - GLASS[0]) / GLASS[1], 1.0, GLASS[2]
    if d @ n > 0:
        n, n_in, n_out = -n, GLASS[2], 1.0
    cos_i = -d @ n
    mirrored = d + 2 * cos_i * n
    sine = n_in / n_out * np.sqrt(1 - cos_i**2)
    if sine >= 1:
        return traced_by_numpy(p, mirrored, weight)
    cos_t = np.sqrt(1 - sine**2)
    s = (n_in * cos_i - n_out * cos_t) / (n_in * cos_i + n_out * cos_t)
    q = (n_in * cos_t - n_out * cos_i) / (n_in * cos_t + n_out * cos_i)
    r = (s * s + q * q) / 2
    refracted = n_in / n_out * d + (n_in / n_out * cos_i - cos_t) * n
    there = traced_by_numpy(p, mirrored, weight * r)
    through = traced_by_numpy(p, refracted, weight * (1 - r))
    return r * there + (n_in / n_out) ** 2 * (1 - r) * through


def spheres():
    surfaces = [Surface(Quad(c, u, v), BLACK, e) for c, u, v, e in WALLS]
    surfaces.append(Surface(Sphere(GLASS[0], GLASS[1]), Glass(GLASS[2])))
    surfaces.append(Surface(Sphere(*MIRROR), jv.Mirror(REFLECTANCE)))
    return Scene(surfaces, [])


@pytest.mark.slow
def test_glass_and_mirror_against_a_recursive_tracer():
    """Forty rays at both spheres, and twenty from within the glass, where radiance is scaled once,
    have the radiance of an independent recursion with all branches above 1e-9, for trees of 40
    rays."""
    rng = np.random.default_rng(1)
    eyes = np.repeat([[0.3, -2.5, 0.4], [0.3, -2.5, 0.4], [0.1, -0.2, 0.05]], 20, axis=0)
    targets = np.repeat([np.zeros(3), MIRROR[0], np.zeros(3)], 20, axis=0)
    targets += rng.uniform(-0.25, 0.25, targets.shape)  # not grazing: few branches count
    directions = targets - eyes
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scene = spheres()

    def one(eye, direction):
        return ray_tree_radiance(scene, Ray(eye, direction), rays=40)

    seen = np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(eyes), jnp.asarray(directions)))
    expected = np.array([traced_by_numpy(o, d) for o, d in zip(eyes, directions, strict=True)])
    assert np.ptp(expected[:, 0]) > 0.2
    np.testing.assert_allclose(seen, expected, rtol=1e-7, atol=1e-7)


@pytest.mark.slow
def test_ray_trees_in_blocks_match_single_rays():
    """With more rays than a block, few of them to glass, values and gradients are those of the rays
    one by one."""
    floor = Surface(Plane([0, 0, -1.0], [0, 0, 1.0]), jv.Lambert([0.2, 0.1]))
    ball = Surface(Sphere([0.1, 0, 0], 0.5), Glass(1.5))
    scene = Scene([floor, ball], [jv.PointLight([1.0, 0.5, 2], [3.0, 4])])
    rng = np.random.default_rng(5)
    eyes = np.array([0, 0, 3.0]) + rng.uniform(-1, 1, (700, 3)) * [2, 2, 0.5]
    down = np.broadcast_to([0, 0, -1.0], eyes.shape)
    along, weights = jax.vmap(Ray)(jnp.asarray(eyes), down), rng.uniform(size=(700, 1))

    def one_by_one(scene):
        return jax.vmap(lambda ray: ray_tree_radiance(scene, ray, rays=3))(along)

    def together(scene):
        return ray_tree_radiances(scene, along, rays=3)

    def value_and_slope(function):
        pull = jax.grad(lambda s: (function(s) * weights).sum(), allow_int=True)
        return jax.jit(lambda s: (function(s), pull(s)))(scene)

    (expected, slope), (seen, same_slope) = map(value_and_slope, (one_by_one, together))
    assert (np.asarray(expected) > 0).mean() > 0.8  # the glass casts a shadow
    np.testing.assert_allclose(seen, expected, rtol=1e-12, atol=1e-12)
    for a, b in zip(jax.tree.leaves(same_slope), jax.tree.leaves(slope), strict=True):
        if jnp.issubdtype(a.dtype, jnp.floating):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_ray_tree_matches_the_path_tracer_without_interreflection():
    """For a diffuse floor, a mirror and a lamp with a soft shadow, both tracers agree."""
    floor = Surface(Plane([0, 0, 0], [0, 0, 1.0]), jv.Lambert([0.2, 0.1]))
    ball = Surface(Sphere([0.3, 0.2, 0.4], 0.3), BLACK)
    lamp = jv.RectangleLight([-0.3, -0.3, 2.0], [0, 0.6, 0], [0.6, 0, 0], [5.0, 4.0])
    scene = Scene([floor, ball], [lamp])
    down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    view = jv.Orthographic([0.0, 0, 1.5], down, 0.1, resolution=(6, 8))
    tree = jax.jit(ray_traced)(scene, view)
    paths = jax.jit(partial(path_traced, method=Paths(400, 2, strategy="lights")))(KEY, scene, view)
    apart = np.abs(tree - paths.radiance)
    flat = np.asarray(paths.error) < 0.02 * np.asarray(paths.radiance)
    assert flat.mean() > 0.4
    assert np.median(apart[flat] / np.asarray(paths.radiance)[flat]) < 0.02


@pytest.mark.slow
def test_unsupported_ray_tree_options_raise():
    with pytest.raises(ValueError, match=r"rays must be a whole number of at least 1, got 0"):
        ray_tree_radiance(spheres(), Ray(jnp.zeros(3), jnp.asarray([0.0, 0, 1])), rays=0)


# ------------------------------------------------ emission from sources

U = np.random.default_rng(3).random((100000, 5))
SMALL = Surface(Sphere([0.0, 0, 0], 0.5), BLACK)


def irradiance_from(light=None, surface=None):
    """Return the mean irradiance, and its error, of a disc of radius .5 at z = 0 that faces +z, by
    counting emitted rays."""
    surfaces = [SMALL] if surface is None else [SMALL, surface]
    scene = Scene(surfaces, [] if light is None else [light])
    emitters, ball = emitters_of(scene), ball_around([s.shape for s in surfaces])
    rays = jax.jit(jax.vmap(lambda u: emitted(emitters, ball, u)))(jnp.asarray(U))
    o, d = np.asarray(as_array(rays.ray.origin)), np.asarray(as_array(rays.ray.direction))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -o[:, 2] / d[:, 2]
        p = o + t[:, None] * d
        hits = (t > 0) & (d[:, 2] < 0) & (np.hypot(p[:, 0], p[:, 1]) < 0.5)
    values = np.where(hits, np.asarray(rays.flux)[:, 0], 0) / (np.pi * 0.25)
    return values.mean(), values.std() / np.sqrt(len(values))


def disc_by_quadrature(radiance_at):
    """Return the mean over the receiver of the irradiance at a point, by quadrature on rings."""
    x, w = np.polynomial.legendre.leggauss(12)
    r = 0.25 * (x + 1)
    phi = 2 * np.pi * (np.arange(16) + 0.5) / 16
    values = [[radiance_at(np.array([a * np.cos(b), a * np.sin(b), 0])) for b in phi] for a in r]
    return (np.mean(values, axis=1) * r * w).sum() * 0.25 * 2 / 0.25


def from_patch(corner, u, v, radiance=2.0):
    x, w = np.polynomial.legendre.leggauss(16)
    corner, u, v = (np.array(a, float) for a in (corner, u, v))
    n = np.cross(u, v)

    def at(p):
        total = 0.0
        for a, wa in zip(x, w, strict=True):
            d = corner + u * (a + 1) / 2 + v * ((x + 1) / 2)[:, None] - p
            d2 = (d**2).sum(-1)
            total += wa / 4 * (w * np.maximum(d[:, 2], 0) * np.maximum(-(d @ n), 0) / d2**2).sum()
        return radiance * total

    return at


PATCH = ([-0.3, -0.2, 1.2], [0.0, 0.4, 0], [0.6, 0.0, 0])
CORNERS = np.array([PATCH[0], np.add(PATCH[0], PATCH[1]), np.add(PATCH[0], PATCH[2])])
SOURCES = {
    "point": (
        {"light": jv.PointLight([0.2, 0, 1.0], [3.0, 3.0])},
        lambda p: 3 / ((p - [0.2, 0, 1]) @ (p - [0.2, 0, 1])) ** 1.5,
    ),
    "small": (
        {"light": jv.SmallLight([0.2, 0, 1.0], [0, 0, -2.0], [3.0, 3.0])},
        lambda p: 3 / ((p - [0.2, 0, 1]) @ (p - [0.2, 0, 1])) ** 2,
    ),
    "directional": ({"light": jv.DirectionalLight([0.6, 0, 0.8], [3.0, 3.0])}, lambda p: 2.4),
    "sky": ({"light": jv.environment_map(np.full((4, 8, 2), 0.5))}, lambda p: 0.5 * np.pi),
    "rectangle": ({"light": jv.RectangleLight(*PATCH, [2.0, 2.0])}, from_patch(*PATCH)),
    "light field": (
        {
            "light": LightFieldLight(
                np.full((1, 1, 1, 1, 2), 2.0),
                Window(*PATCH),
                Window([-1.5, -1.5, 2.2], [0, 3.0, 0], [3.0, 0, 0]),
            )
        },
        from_patch(*PATCH),
    ),
    "quad": ({"surface": Surface(Quad(*PATCH), BLACK, [2.0, 2.0])}, from_patch(*PATCH)),
    "sphere": (
        {"surface": Surface(Sphere([0.0, 0, 2.0], 0.4), BLACK, [2.0, 2.0])},
        lambda p: 2 * np.pi * 0.16 * 2 / (p @ p + 4) ** 1.5,
    ),
}


@pytest.mark.sweep("light field")
@pytest.mark.parametrize("name", sorted(SOURCES))
def test_emitted_rays_of_a_source_give_its_irradiance(name):
    """The irradiance of a receiver by counting emitted rays is the integral of 1 / d^2 by NumPy."""
    source, at = SOURCES[name]
    mean, error = irradiance_from(**source)
    assert error < 0.05 * mean
    assert abs(mean - disc_by_quadrature(at)) < 4 * error


@pytest.mark.slow
def test_a_disc_and_a_triangle_have_the_flux_of_their_area():
    """A disc, a triangle and a box emit the flux pi A L; a mesh of two halves emits that of the
    rectangle."""
    halves = TriangleMesh(
        np.vstack([CORNERS, CORNERS[1] + CORNERS[2] - CORNERS[0]]), [[0, 1, 2], [1, 3, 2]]
    )
    mesh = irradiance_from(surface=Surface(halves, BLACK, [2.0, 2.0]))
    quad = disc_by_quadrature(from_patch(*PATCH))
    assert abs(mesh[0] - quad) < 4 * mesh[1]
    disc = irradiance_from(
        surface=Surface(Disc([0.0, 0, 1.0], [0, 0, -1.0], 0.3), BLACK, [2.0, 2.0])
    )
    # coaxial discs: F of radii .5 and .3 at distance 1 (Howell, C-41)
    a, b, h = 0.3, 0.5, 1.0
    x = 1 + (h**2 + b**2) / a**2
    factor = (x - np.sqrt(x**2 - 4 * (b / a) ** 2)) / 2
    expected = 2 * np.pi * factor * (np.pi * a**2) / (np.pi * b**2)
    assert abs(disc[0] - expected) < 4 * disc[1]


@pytest.mark.slow
def test_infinite_lights_need_a_bounded_scene():
    scene = Scene(
        [Surface(Plane([0, 0, 0], [0, 0, 1.0]), BLACK)],
        [jv.DirectionalLight([0, 0, 1.0], [1.0, 1])],
    )
    view = jv.Orthographic([0.0, 0, 1], np.eye(3), 0.1, resolution=(2, 2))
    with pytest.raises(ValueError, match="a scene that ends, got a Plane"):
        light_traced(KEY, scene, view, paths=4)


@pytest.mark.slow
def test_an_emitting_plane_raises():
    floor = Plane([0, 0, 0], [0, 0, 1.0])
    view = jv.Orthographic([0.0, 0, 1], np.eye(3), 0.1, resolution=(2, 2))
    scene = Scene([ROOM[0], Surface(floor, BLACK, [2.0, 2.0])], [])
    with pytest.raises(ValueError, match=r"Scene\.surfaces\[1\] shines without end"):
        light_traced(KEY, scene, view, paths=4)


# ------------------------------------------------ light tracing against path tracing

ROOM = [
    Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), jv.Lambert([0.2, 0.1])),
    Surface(Quad([1.0, -1, 0], [0, 0, 1.5], [0, 2.0, 0]), jv.Lambert([0.1, 0.25])),
    Surface(Box([-0.2, 0.1, 0.2], [0.2, 0.2, 0.2]), jv.Lambert([0.2, 0.2])),
]
CEILING = ([-0.4, -0.4, 1.4], [0, 0.8, 0], [0.8, 0, 0])
EYE = jv.Pinhole(
    [-0.6, 0.0, 1.2],
    np.array([[0, -1.0, 0], [-0.6, 0, -0.8], [0.8, 0, -0.6]]),
    1.0,
    0.2,
    resolution=(6, 6),
)


def chi_square(a, b):
    """Return the mean of squared differences in units of their errors, over pixels that both
    tracers reached."""
    variance = np.square(a.error) + np.square(b.error)
    seen = np.asarray(variance) > 0
    assert seen.mean() > 0.9
    return (np.square(a.radiance - b.radiance)[seen] / variance[seen]).mean()


@pytest.mark.slow
def test_light_tracing_matches_path_tracing():
    """In a room with a box, shadows and a lamp, both tracers agree at each pixel within the
    errors."""
    scene = Scene(ROOM, [jv.RectangleLight(*CEILING, [3.0, 2.0])])
    light = jax.jit(partial(light_traced, paths=150000, depth=4))(KEY, scene, EYE)
    path = jax.jit(partial(path_traced, method=Paths(600, 4, strategy="lights")))(KEY, scene, EYE)
    assert float(np.mean(light.error) / np.mean(light.radiance)) < 0.05
    # 36 pixels, where both bands are lit by the same paths
    assert abs(chi_square(light, path) - 1) < 4 * np.sqrt(2 / 36)
    totals = [np.asarray(x.radiance).mean() for x in (light, path)]
    assert totals[0] == pytest.approx(totals[1], rel=0.01)


@pytest.mark.slow
def test_nan_in_the_scene_is_nan_in_the_picture_of_each_tracer():
    """A lamp or shape at NaN gives NaN everywhere, an albedo of NaN gives NaN in its band alone."""
    view = jv.Orthographic((0, 0, 2), np.diag([1, -1, -1]), 0.9, resolution=(2, 1))

    @jax.jit
    def pictures(lamp_z, radius, albedo):
        floor = Surface(Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.2, 0.2]))
        roof = Surface(Quad([-1, -1, 5], [0, 2, 0], [2, 0, 0]), jv.Lambert([albedo, 0.2]))
        ball = Surface(Sphere([0.9, 0.9, 0.1], radius), jv.Lambert([0.2, 0.2]))
        scene = Scene([floor, roof, ball], [jv.SmallLight((0, 0, lamp_z), (0, 0, 1), (9, 9))])
        light = light_traced(KEY, scene, view, paths=40000, depth=4)
        paths = path_traced(KEY, scene, view, method=Paths(16, 4, roulette=1))
        return light.radiance, paths.radiance

    known, (light, _) = pictures(1.5, 0.1, 0.2), pictures(1.5, 0.1, np.nan)
    assert np.mean(known) > 0
    assert all(
        np.isnan(x).all() for x in (*pictures(np.nan, 0.1, 0.2), *pictures(1.5, np.nan, 0.2))
    )
    assert np.isnan(light[..., 0]).all()
    for band, right in zip(pictures(1.5, 0.1, np.nan), known, strict=True):
        np.testing.assert_allclose(band[..., 1], right[..., 1], rtol=1e-5)


@pytest.mark.slow
def test_glass_of_an_unknown_index_is_not_black():
    """The maximum of XLA passes over NaN, from some thousand numbers on."""
    floor = Surface(Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.2, 0.2]))
    view = jv.Orthographic((0, 0, 2), np.diag([1, -1, -1]), 0.1, resolution=(2, 1))

    @jax.jit
    def picture(index):
        ball = Surface(Sphere([0, 0, 0.5], 0.3), Glass(index))
        return jv.ray_traced(Scene([floor, ball], [jv.PointLight((0, 3, 1), (9, 9))]), view, rays=6)

    assert picture(1.5).min() > 0
    assert np.isnan(picture(np.nan)).all()


@pytest.mark.slow
def test_light_tracing_through_a_lens_with_distortion():
    """A wall under a point light, seen through a barrel distortion, has its exact radiance."""
    k = -0.2
    view = jv.Pinhole(
        [0.0, 0, 0], np.eye(3), 0.01, 1e-3, resolution=(16, 16), distortion=Distortion([k])
    )
    wall = Surface(Quad([-9.0, -9, 1], [0, 18.0, 0], [18.0, 0, 0]), jv.Lambert([0.25]))
    lamp = np.array([0.1, -0.2, 0.4])
    scene = Scene([wall], [jv.PointLight(lamp, [3.0])])
    trace = jax.jit(partial(light_traced, paths=20_000, depth=2, samples=1))
    traced = trace(KEY, scene, view)
    side = (np.arange(16) - 7.5) * 0.1
    down, right = np.meshgrid(side, side, indexing="ij")
    distorted = np.hypot(right, down)
    low, high = np.zeros_like(distorted), np.full_like(distorted, 1.29)  # the fold of the lens
    for _ in range(50):
        middle = (low + high) / 2
        short = middle * (1 + k * middle**2) < distorted
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    ideal = low / distorted
    away = lamp - np.stack([right * ideal, down * ideal, np.ones_like(right)], axis=-1)
    square = (away**2).sum(axis=-1)
    expected = 0.25 * 3 * -away[..., 2] / square**1.5
    seen = distorted < 0.8  # short of the fold
    for part in (right < 0, right > 0, distorted < 0.4, distorted > 0.6):
        chosen = seen & part
        mean, error = (np.asarray(x)[chosen, 0] for x in (traced.radiance, traced.error))
        total, spread = mean.sum(), np.sqrt((error**2).sum())
        assert spread < 0.03 * total
        assert abs(total - expected[chosen].sum()) < 4 * spread


@pytest.mark.slow
def test_caustic_of_a_glass_ball():
    """For a lamp large enough that paths hit it by chance, both tracers agree on the caustic, where
    light tracing has much the smaller error."""
    lamp = jv.RectangleLight([-0.4, -0.4, 3.0], [0, 0.8, 0], [0.8, 0, 0], [20.0, 20.0])
    floor = Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), jv.Lambert([0.2, 0.1]))
    scene = Scene([floor, Surface(Sphere([0.0, 0, 0.7], 0.4), Glass(1.5))], [lamp])
    up = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    # from between ball and floor, so that the glass is not in the picture
    view = jv.Orthographic([0.0, 0, 0.2], up * np.array([[1], [-1], [-1]]), 0.1, resolution=(8, 8))
    light = jax.jit(partial(light_traced, paths=400000, depth=6))(KEY, scene, view)
    path = jax.jit(partial(path_traced, method=Paths(6000, 6)))(KEY, scene, view)
    bright = np.asarray(light.radiance)[..., 0].max()
    assert bright > 3 * np.median(np.asarray(light.radiance)[..., 0])
    assert 0.7 < chi_square(light, path) < 1.4
