"""Path tracing: closed forms, quadrature, conservation, and independence of tiles and parts."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import cornell_box

import jaxvision as jv
from jaxvision import brdf
from jaxvision.brdf.blinn import BlinnBRDF, NormalisedBlinn
from jaxvision.brdf.gaussian_lobe import GaussianLobeBRDF
from jaxvision.brdf.glass import Glass
from jaxvision.brdf.phong import NormalisedPhong, PhongBRDF
from jaxvision.core._random import Stream, seed_of
from jaxvision.geometry import Ray
from jaxvision.rendering import PixelSamples, photograph
from jaxvision.scene import Box, Pinhole, Plane, Quad, Scene, Sphere, Surface
from jaxvision.transport import (
    Paths,
    path_along,
    path_radiance,
    path_sample,
    path_traced,
    path_traced_pixels,
)
from jaxvision.transport.radiosity import plan_patches, radiosity, radiosity_image

KEY = jax.random.key(4)


def unit(*v):
    return jnp.asarray(v, float) / np.linalg.norm(v)


def mean_of_paths(scene, ray, method, count, key=KEY):
    """Return (mean, standard error) of many single paths at once."""
    seed = seed_of(key)

    def one(pixel):
        return path_sample(scene, ray, Stream(pixel, jnp.uint32(0), seed), method=method)

    values = np.asarray(jax.jit(jax.vmap(one))(jnp.arange(count, dtype=jnp.uint32)))
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(count)


# ------------------------------------------------ closed sphere

INSIDE = Ray(jnp.asarray([0.1, 0.2, 0.3]), jnp.asarray([0, 0.6, 0.8]))


def closed(albedo, emission):
    wall = Surface(
        Sphere([0.0, 0, 0], 1.0), jv.Lambert(np.array(albedo) / np.pi), emission, two_sided=True
    )
    return Scene([wall], [])


def slow(*values):
    return [pytest.param(*value, marks=pytest.mark.slow) for value in values]


@pytest.mark.sweep("balance")
@pytest.mark.parametrize("strategy", ["balance", *slow(("lights",), ("surfaces",), ("power",))])
def test_radiance_in_a_closed_sphere(strategy):
    """L = Le / (1 - albedo), which is 1 for .5 and .5, and 2 for .75 and .5, less the tail
    albedo^depth."""
    method = Paths(1, 30, strategy=strategy)
    mean, error = mean_of_paths(closed([0.5, 0.75], [0.5, 0.5]), INSIDE, method, 200)
    expected = 0.5 / (1 - np.array([0.5, 0.75])) * (1 - np.array([0.5, 0.75]) ** 30)
    assert np.all(np.abs(mean - expected) <= 4 * error + 1e-9)


@pytest.mark.slow
def test_roulette_is_unbiased():
    """Russian roulette leaves the mean unchanged; 60 segments leave out 1e-18."""
    mean, error = mean_of_paths(closed([0.5], [0.5]), INSIDE, Paths(1, 60, roulette=1), 2000)
    assert 1e-4 < error[0] < 0.05
    assert abs(mean[0] - 1) < 4 * error[0]


# ------------------------------------------------ white furnace

FURNACE = {
    "lambert": jv.Lambert([0.25, 0.1]),
    "phong": jv.Phong([0.1, 0.05], [0.3], 8.0),
    "phong_brdf": PhongBRDF([0.1, 0.05], [0.3], 8.0),
    "normalised_phong": NormalisedPhong([0.3, 0.2], [0.5], 8.0),
    "blinn": jv.Blinn([0.1, 0.05], [0.3], 12.0),
    "blinn_brdf": BlinnBRDF([0.1, 0.05], [0.3], 12.0),
    "normalised_blinn": NormalisedBlinn([0.3, 0.2], [0.5], 12.0),
    "gaussian": jv.GaussianLobe([0.1, 0.05], [0.3], 9.0),
    "gaussian_brdf": GaussianLobeBRDF([0.1, 0.05], [0.3], 9.0),
    "oren_nayar": jv.OrenNayar([0.25, 0.1], 0.4),
    "eon": jv.EON([0.25, 0.1], 0.8),
    "coated": jv.Coated(jv.Lambert([0.25, 0.1]), jv.Dielectric([1.5]), 0.3),
    "torrance_sparrow": jv.TorranceSparrow([0.1, 0.05], [0.6], 0.3),
    "dichromatic": jv.Dichromatic(
        jv.Lambert([0.25]), jv.TorranceSparrow([0.0], [0.6], 0.4), [0.9, 0.4], [1.0]
    ),
    "measured": jv.HalfDifferenceTable(
        np.random.default_rng(5).uniform(0.1, 0.3, (6, 5, 4, 2)),
    ),
    "mirror": jv.Mirror([0.9, 0.4]),
}
SKY = jv.environment_map(np.ones((2, 4, 2)))
GLANCE = Ray(jnp.asarray([0.6, 0.0, 3.0]), unit(0, 0, -1))  # meets the unit sphere at cos = .8


QUICK = ("lambert", "mirror")


@pytest.mark.sweep("lambert")
@pytest.mark.parametrize(
    "name", [*QUICK, *slow(*((name,) for name in FURNACE if name not in QUICK))]
)
def test_white_furnace_gives_the_albedo(name):
    """Under the same light from everywhere, a convex body has its albedo as radiance."""
    material = FURNACE[name]
    scene = Scene([Surface(Sphere([0.0, 0, 0], 1.0), material)], [SKY])
    mean, error = mean_of_paths(scene, GLANCE, Paths(1, 2), 3000)
    expected = np.broadcast_to(brdf.albedo(material, jnp.asarray([0.6, 0, 0.8])), 2)
    assert np.all(error < 0.01)
    np.testing.assert_array_less(np.abs(mean - expected), 4.5 * error + 4e-4)


@pytest.mark.slow
def test_white_furnace_of_glass_gives_one():
    """Clear glass absorbs nothing, so the radiance is 1, except for what is still inside after 40
    segments."""
    scene = Scene([Surface(Sphere([0.0, 0, 0], 1.0), Glass(1.5))], [SKY])
    mean, _ = mean_of_paths(scene, GLANCE, Paths(1, 40), 500)
    np.testing.assert_allclose(mean, 1, atol=1e-6)


# ------------------------------------------------ against quadrature

LAMP = ([-0.5, -0.5, 1.5], [0.0, 1.0, 0], [1.0, 0.0, 0])  # emits downwards
FLOOR = Quad([-2.0, -2, 0], [4.0, 0, 0], [0, 4.0, 0])
WALL = Quad([1.0, -1, 0.2], [0, 0, 1.0], [0, 2.0, 0])  # faces -x


def corner_scene(*, lamp_is_surface):
    surfaces = [Surface(FLOOR, jv.Lambert([0.2])), Surface(WALL, jv.Lambert([0.25]))]
    if lamp_is_surface:
        return Scene([*surfaces, Surface(Quad(*LAMP), jv.Lambert([0.0]), [3.0])], [])
    return Scene(surfaces, [jv.RectangleLight(*LAMP, [3.0])])


def nodes(corner, u, v, order):
    x, w = np.polynomial.legendre.leggauss(order)
    a, b = np.meshgrid((x + 1) / 2, (x + 1) / 2, indexing="ij")
    area = np.linalg.norm(np.cross(u, v))
    points = np.array(corner) + a.reshape(-1, 1) * np.array(u) + b.reshape(-1, 1) * np.array(v)
    return points, np.outer(w, w).ravel() / 4 * area


def kernel(x, nx, y, ny):
    """Return cos cos' / d^2 from points x to points y."""
    d = y[None] - x[:, None]
    d2 = (d**2).sum(-1)
    return np.maximum(d @ nx, 0) * np.maximum(-(d @ ny), 0) / d2**2


def corner_by_quadrature(x):
    """Return direct light plus direct light reflected by the wall to the floor, by three Gauss
    rules."""
    up, down, left = np.array([0, 0, 1.0]), np.array([0, 0, -1.0]), np.array([-1.0, 0, 0])
    lamp, lamp_weight = nodes(*LAMP, 24)
    wall, wall_weight = nodes([1.0, -1, 0.2], [0, 0, 1.0], [0, 2.0, 0], 40)
    x = np.array([x])
    direct = 0.2 * 3 * kernel(x, up, lamp, down) @ lamp_weight
    of_wall = 0.25 * 3 * kernel(wall, left, lamp, down) @ lamp_weight
    return (direct + 0.2 * kernel(x, up, wall, left) @ (wall_weight * of_wall))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strategy", "lamp_is_surface"),
    [
        ("lights", True),
        ("surfaces", True),
        ("balance", False),
        *slow(("balance", True), ("lights", False), ("surfaces", False), ("power", False)),
    ],
)
def test_direct_light_and_one_bounce_against_quadrature(strategy, lamp_is_surface):
    """Each strategy agrees with quadrature, for a lamp that is a light or a surface."""
    point, eye = np.array([0.3, 0.2, 0.0]), np.array([-1.5, 0.2, 1.0])
    ray = Ray(jnp.asarray(eye), unit(*(point - eye)))
    scene = corner_scene(lamp_is_surface=lamp_is_surface)
    mean, error = mean_of_paths(scene, ray, Paths(1, 3, strategy=strategy), 20000)
    assert error[0] < 0.02 * mean[0]
    assert abs(mean[0] - corner_by_quadrature(point)) < 4 * error[0]


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_an_emitting_ceiling_does_not_shade_itself(dtype):
    """An emitting ceiling is seen from a floor up to 89 degrees from its normal, where a shadow ray
    that starts off the floor meets the ceiling early; the irradiance is the form factor in closed
    form."""
    side, height = 60.0, 1.0
    floor = Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), jv.Lambert([1 / np.pi]))
    lamp = Quad([30.0, -2.0, height], [0, 4.0, 0], [side - 30.0, 0, 0])
    scene = jv.as_dtype(Scene([floor, Surface(lamp, jv.Lambert([0.0]), [1.0])], []), dtype)
    ray = Ray(*(jnp.asarray(v, dtype) for v in ([0.0, 0, 0.5], [0, 0, -1.0])))
    mean, error = mean_of_paths(scene, ray, Paths(1, 2, strategy="lights"), 20000)

    def corner(a, b):  # of a parallel rectangle, one corner above the point (Howell, B-3)
        p, q = np.hypot(1, a), np.hypot(1, b)
        return (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2 * np.pi)

    expected = 2 * (corner(side, 2.0) - corner(30.0, 2.0))
    assert error[0] < 0.02 * expected
    assert abs(mean[0] - expected) < 4 * error[0]


@pytest.mark.slow
def test_cornell_box_matches_radiosity():
    """Paths of up to 40 segments agree with radiosity on patches of 6 cm and a final gather."""
    scene, view = cornell_box.scene(emissive_surface=True), cornell_box.view(16)
    method = Paths(4096, 40, strategy="lights", roulette=3)
    paths = jax.jit(partial(path_traced, method=method))(KEY, scene, view)
    plan = plan_patches(scene, size=0.06)

    samples = PixelSamples(KEY, 256)

    @jax.jit
    def by_patches(scene, view):
        return radiosity_image(scene, plan, radiosity(scene, plan), view, samples=samples)

    patches = np.asarray(by_patches(scene, view))
    seen, noise = np.asarray(paths.radiance), np.asarray(paths.error)
    steady = (noise < 0.03 * seen) & (seen > 0)
    assert steady.mean() > 0.7
    apart = (patches - seen)[steady] / seen[steady]
    assert abs(apart.mean()) < 0.002
    assert np.sqrt(np.mean(apart**2)) < 0.025


# ------------------------------------------------ independence

VIEW = Pinhole(
    [-1.5, 0.0, 1.0], np.array([[0, -1.0, 0], [0, 0, -1], [1, 0, 0]]), 1.0, 0.2, resolution=(5, 7)
)


@pytest.mark.slow
def test_pixels_do_not_depend_on_the_tiles():
    """Every pixel is equal to the last bit in tiles of any length and order."""
    method = Paths(4, 3)
    scene = corner_scene(lamp_is_surface=True)
    traced = jax.jit(partial(path_traced_pixels, method=method))
    rows, columns = (x.ravel() for x in np.indices((5, 7)))
    whole = traced(KEY, scene, VIEW, rows, columns)
    order = np.random.default_rng(0).permutation(35)
    for piece in np.split(order, [2]):
        part = traced(KEY, scene, VIEW, rows[piece], columns[piece])
        np.testing.assert_array_equal(part.radiance, whole.radiance[piece])
        np.testing.assert_array_equal(part.error, whole.error[piece])
    picture = jax.jit(partial(path_traced, method=method))(KEY, scene, VIEW)
    np.testing.assert_array_equal(picture.radiance.reshape(35, -1), whole.radiance)
    other = traced(jax.random.key(5), scene, VIEW, rows, columns)
    assert np.mean(other.radiance == whole.radiance) < 0.5


@pytest.mark.slow
def test_samples_in_parts_match_all_samples_at_once():
    scene, at = corner_scene(lamp_is_surface=True), (np.array([2, 4]), np.array([3, 1]))

    def part(samples, first):
        traced = partial(path_traced_pixels, method=Paths(samples, 3), first_sample=first)
        return np.asarray(jax.jit(traced)(KEY, scene, VIEW, *at).radiance)

    np.testing.assert_allclose((part(3, 0) + part(3, 3)) / 2, part(6, 0), rtol=1e-13)


@pytest.mark.slow
def test_a_traced_depth_matches_the_fixed_depth():
    """Between a floor and an emitting ceiling, where each segment adds light, a traced depth gives
    the radiance of the fixed depth."""
    floor = Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), jv.Lambert([0.2]))
    ceiling = Surface(Quad([-1.0, -1, 1], [0, 2.0, 0], [2.0, 0, 0]), jv.Lambert([0.2]), [1.0])
    scene, one = Scene([floor, ceiling], []), Paths(1, 4)
    view = Pinhole([0.0, 0, 0.5], np.diag([1.0, -1, -1]), 1.0, 0.2, resolution=(2, 2))
    seen = jax.jit(
        lambda depth: (
            photograph(path_along(scene, one, depth=depth), view, PixelSamples(KEY, 1)).radiance
        )
    )
    fixed = jax.jit(partial(path_traced, method=one))(KEY, scene, view).radiance
    np.testing.assert_allclose(seen(jnp.uint32(4)), fixed, rtol=1e-12)
    assert np.sum(seen(jnp.uint32(2))) < 0.99 * np.sum(fixed)


@pytest.mark.slow
def test_mean_and_error_of_three_paths_against_numpy():
    """Mean and standard error are those of NumPy over three paths from a floor to an emitting
    ceiling."""
    floor = Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), jv.Lambert([0.1, 0.2]))
    ceiling = Surface(
        Quad([-1.0, -1, 1], [0, 2.0, 0], [2.0, 0, 0]), jv.Lambert([0.1, 0.2]), [1.0, 2]
    )
    scene, method = Scene([floor, ceiling], []), Paths(3, 2, strategy="lights")
    ray = Ray(jnp.asarray([0.1, 0.2, 0.5]), unit(0, 0, -1))
    seed, pixel = seed_of(KEY), jnp.uint32(0)

    def both(numbers):
        one = partial(path_sample, scene, ray, method=method)
        paths = jax.vmap(lambda number: one(Stream(pixel, number, seed)))(numbers)
        return path_radiance(KEY, scene, ray, method=method), paths

    traced, values = jax.jit(both)(jnp.arange(3, dtype=jnp.uint32))
    np.testing.assert_allclose(traced.radiance, np.mean(values, axis=0), rtol=1e-12)
    deviation = np.std(values, axis=0, ddof=1)
    assert deviation.min() > 0
    np.testing.assert_allclose(traced.error, deviation / np.sqrt(3), rtol=1e-10)


def test_a_bounce_is_traced_once(monkeypatch):
    """The bounce is traced once for any number of samples and depth, since a compile cache cannot
    save the time of tracing."""
    from jaxvision.transport import paths

    calls, bounce = [], paths._bounce

    def counted(*arguments):
        calls.append(1)
        return bounce(*arguments)

    monkeypatch.setattr(paths, "_bounce", counted)
    wall, view = closed([0.5], [0.5]), Pinhole(np.zeros(3), np.eye(3), 1.0, 0.1, resolution=(2, 2))
    for method in (Paths(4, 3), Paths(4, 3, roulette=1)):
        calls.clear()
        jax.make_jaxpr(partial(path_traced, method=method))(KEY, wall, view)
        assert len(calls) == 1


@pytest.mark.slow
def test_unneeded_densities_are_not_computed(monkeypatch):
    """At each bounce a material computes the density of the drawn direction and, for the balance
    strategy, that toward the lamp, unless no ray can hit an emitter."""
    pdf, asked = brdf.pdf, []
    monkeypatch.setattr(brdf, "pdf", lambda *arguments: asked.append(1) or pdf(*arguments))
    ray = Ray(jnp.asarray([-1.5, 0.2, 1.0]), unit(1.8, 0, -1))

    def densities(light, strategy):
        asked.clear()
        scene, method = Scene([Surface(FLOOR, jv.Lambert([0.1]))], [light]), Paths(1, 2)
        method = dataclasses.replace(method, strategy=strategy)
        jax.make_jaxpr(lambda ray: path_radiance(KEY, scene, ray, method=method))(ray)
        return len(asked)

    point = jv.PointLight([0, 0, 1.0], [1.0])
    lamp = jv.RectangleLight([0, 0, 1.0], [0, 1.0, 0], [1.0, 0, 0], [1.0])
    drawn = densities(lamp, "lights")
    assert drawn > 0
    assert densities(point, "balance") == drawn
    assert densities(lamp, "balance") == 2 * drawn


# ------------------------------------------------ gradients


@pytest.mark.slow
def test_gradient_in_a_roughness_is_right_on_average():
    """The drawn directions have no gradient, and yet the mean gradient is that of the albedo."""

    def material(roughness):
        return jv.TorranceSparrow([0.05], [0.9], roughness)

    def one(roughness, pixel):
        ball = Surface(Sphere([0.0, 0, 0], 1.0), material(roughness))
        scene = Scene([ball], [jv.environment_map(np.ones((2, 4, 1)))])
        stream = Stream(pixel, jnp.uint32(0), seed_of(KEY))
        return path_sample(scene, GLANCE, stream, method=Paths(1, 2, strategy="surfaces"))[0]

    slopes = np.asarray(
        jax.jit(jax.vmap(jax.grad(one), (None, 0)))(
            jnp.asarray(0.5), jnp.arange(20000, dtype=jnp.uint32)
        )
    )
    wo, h = jnp.asarray([0.6, 0, 0.8]), 1e-3
    ahead, behind = (brdf.albedo(material(0.5 + s), wo)[0] for s in (h, -h))
    error = slopes.std() / np.sqrt(slopes.size)
    expected = float(ahead - behind) / (2 * h)
    assert abs(expected) > 8 * error
    assert abs(slopes.mean() - expected) < 4 * error


# ------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 0}, r"Paths.samples must be a whole number of at least 1, got 0."),
        ({"depth": 0}, r"Paths.depth must be a whole number of at least 1, got 0."),
        ({"roulette": -1}, r"Paths.roulette must be a whole number of at least 0, got -1."),
    ],
)
def test_path_options_out_of_range_raise(options, message):
    with pytest.raises(ValueError, match=message):
        Paths(**options)


@pytest.mark.slow
def test_scenes_without_light_and_rays_without_hits():
    """A scene without light is black; a ray that hits nothing is black or has the radiance of the
    sky."""
    up = Ray(jnp.asarray([0.0, 0, 1]), unit(0, 0, 1))
    dark = Scene([Surface(Plane([0, 0, 0], [0, 0, 1.0]), jv.Lambert([0.2]))], [])
    for ray in (up, Ray(up.origin, -up.direction)):
        traced = path_radiance(KEY, dark, ray, method=Paths(2, 4))
        np.testing.assert_array_equal(traced.radiance, 0)
    lit = Scene(dark.surfaces, [jv.environment_map(np.full((2, 4, 1), 3.0))])
    assert float(path_radiance(KEY, lit, up, method=Paths(2, 4)).radiance[0]) == pytest.approx(3)


def test_an_emitting_infinite_floor_lights_a_ceiling():
    """The plane cannot be sampled by area. Above a black floor of radiance 2, a ceiling of albedo
    .3 has radiance .6."""
    floor = Surface(Plane([0.0, 0, 0], [0, 0, 1.0]), jv.Lambert([0.0]), [2.0])
    ceiling = Surface(Plane([0.0, 0, 2], [0, 0, -1.0]), jv.Lambert([0.3 / np.pi]))
    up, scene = Ray(jnp.asarray([0.0, 0, 1]), unit(0, 0, 1)), Scene([floor, ceiling], [])
    traced = path_radiance(KEY, scene, up, method=Paths(4, 2))
    np.testing.assert_allclose(traced.radiance, [0.6], rtol=1e-12)


@pytest.mark.slow
def test_an_emitting_box_by_both_strategies():
    """Sampled by area over six faces, or hit by chance, the box gives the same irradiance."""
    lamp = Surface(Box([0.2, 0, 1.0], [0.2, 0.3, 0.1]), jv.Lambert([0.0]), [5.0])
    scene = Scene([Surface(FLOOR, jv.Lambert([0.3])), lamp], [])
    ray = Ray(jnp.asarray([-1.5, 0.2, 1.0]), unit(1.8, 0, -1))
    (a, da), (b, db) = (
        mean_of_paths(scene, ray, Paths(1, 2, strategy=s), 8000) for s in ("lights", "surfaces")
    )
    assert abs(a[0] - b[0]) < 4 * np.hypot(da[0], db[0])
    assert da[0] < db[0]
