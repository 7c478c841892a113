"""Tests user-defined types: two lights, a BRDF and a half-silvered mirror, each registered once and
then used by every integrator, against NumPy and closed forms of the same scenes."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import brdf, lights
from jaxvision.errors import InputError
from jaxvision.geometry import intersect, point_on, surface_area
from jaxvision.scene import Disc
from jaxvision.transport import ray_tree_radiance
from jaxvision.transport.radiosity import plan_patches, radiosity, radiosity_along

KEY = jax.random.key(11)

# ------------------------------------------------ the types, as a user would write them


class Headlamp(jv.Light):
    """A lamp with intensity I [cos(theta)]+^4 about an axis, in W sr^-1."""

    position: jax.Array = eqx.field(converter=jnp.asarray)
    axis: jax.Array = eqx.field(converter=jnp.asarray)
    strength: jax.Array = eqx.field(converter=jnp.asarray)


def from_spot(light, point):
    toward = jv.as_vec(light.position - point)
    square = toward.x**2 + toward.y**2 + toward.z**2
    distance = jnp.sqrt(jnp.where(square > 0, square, 1))
    wi = toward * (1 / distance)
    axis = jv.as_vec(light.axis)
    cosine = jnp.maximum(-(wi.x * axis.x + wi.y * axis.y + wi.z * axis.z), 0)
    irradiance = light.strength * jnp.where(square > 0, cosine**4 / distance**2, 0)
    return lights.Incident(wi, irradiance, jnp.where(square > 0, distance, 0))


class DiscLamp(jv.Light):
    """A disc with uniform radiance from its front."""

    disc: Disc
    glow: jax.Array = eqx.field(converter=jnp.asarray)


def disc_seen(light, ray):
    hit = intersect(ray, light.disc)
    front = hit.normal.x * ray.direction.x + hit.normal.y * ray.direction.y
    meets = (front + hit.normal.z * ray.direction.z < 0) & jnp.isfinite(hit.distance)
    distance = jnp.where(meets, hit.distance, jnp.inf)
    return lights.Seen(distance, jnp.where(meets, light.glow, 0))


def disc_sample(light, point, u):
    place = point_on(light.disc, u)
    toward = place.point - jv.as_vec(point)
    square = toward.x**2 + toward.y**2 + toward.z**2
    distance = jnp.sqrt(square)
    wi = toward * (1 / distance)
    n = place.normal
    cosine = jnp.maximum(-(n.x * wi.x + n.y * wi.y + n.z * wi.z), 0)
    direction = jv.as_array(wi) if isinstance(point, jax.Array) else wi
    solid_angle = surface_area(light.disc) * cosine / square
    return lights.Incident(direction, light.glow * solid_angle, distance)


def disc_pdf(light, point, wi):
    hit = intersect(jv.Ray(point, wi), light.disc)
    w, n = jv.as_vec(wi), hit.normal
    cosine = -(n.x * w.x + n.y * w.y + n.z * w.z)
    meets = (cosine > 0) & jnp.isfinite(hit.distance)
    distance = jnp.where(meets, hit.distance, 0)
    return distance**2 / (jnp.where(meets, cosine, 1) * surface_area(light.disc))


class Minnaert(jv.Material):
    """f_r = rho / pi (cos(theta_i) cos(theta_o))^(k - 1)  (Minnaert, ApJ 93 (1941))."""

    rho: jax.Array = eqx.field(converter=jnp.asarray)
    k: jax.Array = eqx.field(converter=jnp.asarray)


def minnaert(material, wi, wo):
    both = (wi.z > 0) & (wo.z > 0)
    product = jnp.where(both, wi.z * wo.z, 1)
    return jnp.where(both, material.rho / jnp.pi * product ** (material.k - 1), 0)


class HalfSilvered(jv.Material):
    """A thin sheet that mirrors a part of the light and transmits a part."""

    mirrors: jax.Array = eqx.field(converter=jnp.asarray)
    passes: jax.Array = eqx.field(converter=jnp.asarray)


def both_ways(material, w):
    mirrored = jv.as_vec(jnp.stack([-w.x, -w.y, w.z]))
    return brdf.Specular(mirrored, material.mirrors, -w, material.passes)


lights.register(Headlamp, incident=from_spot)
lights.register_extended(
    DiscLamp,
    seen=disc_seen,
    sample=disc_sample,
    pdf=disc_pdf,
    emitted=lambda light, u: lights.emitted_from_surface(light.disc, light.glow, u),
)
brdf.register(Minnaert, evaluate=minnaert)
brdf.register_delta(HalfSilvered, specular=both_ways)

# ------------------------------------------------ the scenes

RHO, K = np.array([0.6, 0.3]), 1.7
STRENGTH, GLOW = np.array([3.0, 1.5]), np.array([5.0, 2.0])
FLOOR = jv.Quad([-3.0, -3, 0], [6.0, 0, 0], [0, 6.0, 0])
ROUGH, WHITE = jv.Surface(FLOOR, Minnaert(RHO, K)), jv.Surface(FLOOR, jv.Lambert(RHO / np.pi))
SPOT_AT, LAMP_AT, RADIUS = np.array([0.3, -0.2, 1.5]), np.array([-0.2, 0.1, 1.2]), 0.4
SPOT = Headlamp(SPOT_AT, np.array([0, 0, -1.0]), STRENGTH)
LAMP = DiscLamp(Disc(LAMP_AT, [0, 0, -1.0], RADIUS), GLOW)
KINDS = {"spot": SPOT, "disc": LAMP}
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
PITCH, ROWS, COLUMNS = 0.5, 2, 3
VIEW = jv.Orthographic([0.1, 0.05, 1.0], DOWN, PITCH, resolution=(ROWS, COLUMNS))


def on_floor(fine=1):
    """Return points of the floor that pixels see, (rows, columns, fine^2, 3)."""
    rows = (np.arange(ROWS * fine) + 0.5) / fine - ROWS / 2
    columns = (np.arange(COLUMNS * fine) + 0.5) / fine - COLUMNS / 2
    y, x = np.meshgrid(0.05 - rows * PITCH, 0.1 + columns * PITCH, indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1).reshape(ROWS, fine, COLUMNS, fine, 3)
    return points.transpose(0, 2, 1, 3, 4).reshape(ROWS, COLUMNS, fine * fine, 3)


def reflected(points, diffuse, at=SPOT_AT):
    """Return the radiance straight up from the floor under the spot, W m^-2 sr^-1."""
    away = at - points
    square = (away**2).sum(-1)
    cosine = away[..., 2] / np.sqrt(square)  # of incidence and to the lamp's axis
    f = 1 / np.pi if diffuse else cosine ** (K - 1) / np.pi
    return (f * cosine**5 / square)[..., None] * RHO * STRENGTH


def reflected_of_disc(points, diffuse):
    """Return the same radiance under the disc, by rings."""
    x, w = np.polynomial.legendre.leggauss(24)
    r, phi = RADIUS * np.sqrt((x + 1) / 2), 2 * np.pi * (np.arange(48) + 0.5) / 48
    ring = np.stack([np.outer(r, np.cos(phi)), np.outer(r, np.sin(phi))], axis=-1).reshape(-1, 2)
    weights = np.repeat(w / 2 / 48, 48) * np.pi * RADIUS**2
    places = LAMP_AT + np.concatenate([ring, 0 * ring[:, :1]], axis=1)
    away = places - points[..., None, :]
    square = (away**2).sum(-1)
    cosine = away[..., 2] / np.sqrt(square)
    f = 1 / np.pi if diffuse else cosine ** (K - 1) / np.pi
    return ((f * cosine**2 / square) @ weights)[..., None] * RHO * GLOW


EXPECTED = {"spot": reflected, "disc": reflected_of_disc}


# ------------------------------------------------ the integrators


def within_noise(got, error, expected, most=0.05):
    assert (np.asarray(error) < most * expected.max()).all()
    assert (np.abs(got - expected) < 4.5 * np.asarray(error) + 1e-3 * expected).all()


@pytest.mark.sweep
@pytest.mark.parametrize("strategy", ["lights", "surfaces", "balance"])
def test_paths(strategy):
    """The direct light of both lamps is found by each strategy, at one point seen straight down."""
    method = jv.Paths(4000, 2, strategy=strategy)
    ray = jv.Ray(jnp.asarray([0.1, 0.3, 1.0]), jnp.asarray([0, 0, -1.0]))
    found = jax.jit(partial(jv.path_radiance, method=method))(
        KEY, jv.Scene([ROUGH], [SPOT, LAMP]), ray
    )
    point = np.array([[0.1, 0.3, 0.0]])
    expected = sum(of(point, diffuse=False)[0] for of in EXPECTED.values())
    within_noise(found.radiance, found.error, expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_light_paths(name):
    """The light in each pixel equals the mean over the pixel."""
    trace = jax.jit(partial(jv.light_traced, paths=60000, depth=2, samples=2))
    found = trace(KEY, jv.Scene([ROUGH], [KINDS[name]]), VIEW)
    expected = EXPECTED[name](on_floor(6), diffuse=False).mean(axis=2)
    within_noise(found.radiance, found.error, expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_radiosity(name):
    """A single diffuse floor lights nothing. Its reflected radiance, averaged over its elements,
    tends to the value at the point. Other families are refused."""
    plan = plan_patches(jv.Scene([WHITE], []), size=0.5, split=4)

    @jax.jit
    def along(scene, ray):
        solution = radiosity(scene, plan, rule=jv.Quadrature(8))
        return radiosity_along(scene, plan, solution, ray, rule=jv.Quadrature(8))

    ray = jv.Ray(jnp.asarray([0.1, 0.3, 1.0]), jnp.asarray([0, 0, -1.0]))
    got = along(jv.Scene([WHITE], [KINDS[name]]), ray)
    expected = EXPECTED[name](np.array([[0.1, 0.3, 0.0]]), diffuse=True)[0]
    np.testing.assert_allclose(got, expected, rtol=1e-3)
    for surface in (ROUGH, jv.Surface(FLOOR, HalfSilvered([0.4], [0.5]))):
        kind = type(surface.material).__name__
        with pytest.raises(ValueError, match=rf"must be Lambert for radiosity, got {kind}\.$"):
            plan_patches(jv.Scene([surface], [SPOT]), size=0.5)


# ------------------------------------------------ the half-silvered mirror

MIRRORS, PASSES = np.array([0.3, 0.5]), np.array([0.6, 0.2])
SHEET = jv.Surface(
    jv.Quad([-3.0, -3, 0.8], [6.0, 0, 0], [0, 6.0, 0]), HalfSilvered(MIRRORS, PASSES)
)
CEILING = jv.Surface(
    jv.Quad([-3.0, -3, 3], [0, 6.0, 0], [6.0, 0, 0]), jv.Lambert([0.0, 0.0]), [2.0, 7.0]
)
LOW = np.array([0.3, -0.2, 0.5])  # a spot below the sheet
BELOW = Headlamp(LOW, np.array([0, 0, -1.0]), STRENGTH)


@pytest.mark.slow
def test_half_silvered_shows_the_mirrored_and_the_transmitted_scene():
    """The view from above shows the ceiling mirrored and the floor, lit by a lamp below the sheet,
    transmitted. Ray trees are exact, and paths within their noise. Direct light, which follows no
    ray, is 0."""
    scene = jv.Scene([ROUGH, SHEET, CEILING], [BELOW])
    ray = jv.Ray(jnp.asarray([0.1, 0.3, 2.0]), jnp.asarray([0, 0, -1.0]))
    floor = reflected(np.array([[0.1, 0.3, 0.0]]), diffuse=False, at=LOW)[0]
    expected = MIRRORS * np.array([2.0, 7.0]) + PASSES * floor

    @jax.jit
    def both(scene):
        return ray_tree_radiance(scene, ray, rays=4), jv.path_radiance(
            KEY, scene, ray, method=jv.Paths(6000, 3)
        )

    tree, paths = both(scene)
    np.testing.assert_allclose(tree, expected, rtol=1e-12)
    within_noise(paths.radiance, paths.error, expected)


@pytest.mark.slow
def test_half_silvered_transmits_light_onto_surfaces_behind():
    """In light tracing, a spot above the sheet lights the floor below, reduced in each band by the
    transmission, however the path is chosen."""
    trace = jax.jit(partial(jv.light_traced, paths=60000, depth=3, samples=2))
    view = jv.Orthographic([0.1, 0.05, 0.6], DOWN, PITCH, resolution=(ROWS, COLUMNS))
    found = trace(KEY, jv.Scene([ROUGH, SHEET], [SPOT]), view)
    expected = PASSES * reflected(on_floor(6), diffuse=False).mean(axis=2)
    within_noise(found.radiance, found.error, expected, most=0.1)


# ------------------------------------------------ optional parts of a type


class NoRays(DiscLamp):
    """A disc registered without the rays that leave it."""


@pytest.mark.slow
def test_an_extended_light_without_rays_is_refused_only_by_light_tracing():
    lights.register_extended(NoRays, seen=disc_seen, sample=disc_sample, pdf=disc_pdf)
    scene = jv.Scene([ROUGH], [NoRays(LAMP.disc, LAMP.glow)])
    with pytest.raises(ValueError, match=r"needs NoRays to be registered with `emitted`.*leave it"):
        jv.light_traced(KEY, scene, VIEW, paths=4)
    assert (np.asarray(jv.render(scene, VIEW)) > 0).all()


def test_two_lights_of_one_word_are_refused_by_a_scene_file(monkeypatch):
    from jaxvision.files.scenes.tables import light_tables
    from jaxvision.lights import _registry

    monkeypatch.setattr(_registry, "_KINDS", dict(lights.kinds()))
    lights.register(Headlamp, incident=from_spot, word="point")
    with pytest.raises(InputError, match=r'"point" .*PointLight and .*Headlamp.* another `word`'):
        light_tables()
