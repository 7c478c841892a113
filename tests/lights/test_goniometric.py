"""Tests lamps with measured distributions, and spots, against closed forms and quadrature, and
their samplers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import jaxvision as jv
from jaxvision import lights
from jaxvision.lights.goniometric import _largest_radiance

UP = jnp.array([0.0, 0.0, 1.0])


def lobed(system="C"):
    """Return a distribution with a different value at every node."""
    rng = np.random.default_rng(0)
    vertical = np.radians([0, 10, 25, 60, 90, 140] if system == "C" else [-90, -40, 0, 15, 90])
    horizontal = np.radians([0, 40, 130, 270, 360] if system == "C" else [-90, -20, 30, 90])
    table = rng.uniform(0.2, 1, (len(vertical), len(horizontal)))
    if system == "C":
        table[:, -1], table[0] = table[:, 0], table[0, 0]
    return table, vertical, horizontal


@pytest.mark.sweep
@pytest.mark.parametrize("system", "CBA")
def test_the_flux_is_the_integral_of_the_irradiance(system):
    """The reference integrates over a sphere around the lamp, cell by cell between the nodes, with
    a bilinear formula in NumPy and angles by arcsin and arctan."""
    table, vertical, horizontal = lobed(system)
    lamp = jv.GoniometricLight([0.0] * 3, [2.0, 3.0], table, vertical, horizontal, system=system)
    x, w = np.polynomial.legendre.leggauss(8)

    def nodes(edges):
        a, b = edges[:-1, None], edges[1:, None]
        return ((a + b) / 2 + (b - a) / 2 * x).ravel(), ((b - a) / 2 * w).ravel()

    (v, dv), (h, dh) = nodes(vertical), nodes(horizontal)
    v, h = (a.ravel() for a in np.meshgrid(v, h, indexing="ij"))
    sin_v, cos_v = np.sin(v), np.cos(v)
    w = {
        "C": (sin_v * np.cos(h), sin_v * np.sin(h), -cos_v),
        "B": (sin_v, -cos_v * np.sin(h), -cos_v * np.cos(h)),
        "A": (cos_v * np.cos(h), -cos_v * np.sin(h), sin_v),
    }[system]
    at = jnp.asarray(np.stack(w, axis=-1))
    arriving = jax.jit(jax.vmap(jv.incident, in_axes=(None, 0)))(lamp, at).irradiance
    solid = (np.outer(dv, dh).ravel() * (sin_v if system == "C" else cos_v))[:, None]
    flux = np.asarray(lights.flux(lamp))
    np.testing.assert_allclose((np.asarray(arriving) * solid).sum(0), flux, rtol=1e-8)


def test_the_intensity_at_a_node_and_between_is_bilinear():
    table, vertical, horizontal = lobed()
    lamp = jv.GoniometricLight([0.0] * 3, [1.0], table, vertical, horizontal)

    def at(gamma, c):
        g, c = np.radians([gamma, c])
        w = [np.sin(g) * np.cos(c), np.sin(g) * np.sin(c), -np.cos(g)]
        return float(lights.relative_intensity(lamp, w))

    assert at(25, 40) == pytest.approx(table[2, 1], rel=1e-9)
    assert at(25, 85) == pytest.approx((table[2, 1] + table[2, 2]) / 2, rel=1e-9)
    assert at(42.5, 315) == pytest.approx(table[2:4, 3:5].mean(), rel=1e-9)
    assert at(0, 77) == pytest.approx(table[0, 0], rel=1e-9)
    assert at(141, 0) == 0
    slope = jax.grad(lambda w: lights.relative_intensity(lamp, w))(jnp.array([0.0, 0, -1]))
    assert np.isfinite(slope).all()


@pytest.mark.sweep
@pytest.mark.parametrize("falloff", ["smooth", "smoothstep", "linear"])
def test_a_spot_emits_the_integral_of_its_formula(falloff):
    """The flux is checked against its closed form, and through the sphere by emitted rays."""
    inner, outer = np.radians([20.0, 50.0])
    spot = jv.SpotLight([0.0] * 3, [0.6, 0, 0.8], [5.0], inner, outer, falloff=falloff)
    c, d = np.cos([inner, outer])

    def share(t):
        if falloff == "linear":
            return np.clip((outer - t) / (outer - inner), 0, 1)
        part = np.clip((np.cos(t) - d) / (c - d), 0, 1)
        return part**2 if falloff == "smooth" else part**2 * (3 - 2 * part)

    flux = (
        5 * 2 * np.pi * integrate.quad(lambda t: np.sin(t) * share(t), 0, outer, points=[inner])[0]
    )
    if falloff != "linear":
        mean = 1 / 3 if falloff == "smooth" else 1 / 2  # mean between the cones
        assert flux == pytest.approx(10 * np.pi * (1 - c + (c - d) * mean), rel=1e-9)
    u = jnp.asarray(np.random.default_rng(1).random((20_000, 4)))
    rays = jax.vmap(lambda u: lights.emitted(spot, u, around=None))(u)
    assert float(rays.flux.mean()) == pytest.approx(flux, abs=4 * float(rays.flux.std()) / 141)
    for theta in np.radians([0, 20, 30, 49, 51, 90]):
        axis, across = np.array([0.6, 0, 0.8]), np.array([0.8, 0, -0.6])
        place = 2 * (np.cos(theta) * axis + np.sin(theta) * across)
        got = float(jv.incident(spot, jnp.asarray(place)).irradiance[0])
        assert got == pytest.approx(5 / 4 * share(theta), abs=1e-9)


@pytest.mark.slow
def test_an_opening_is_a_point_from_afar_and_an_area_nearby():
    """At 100 m it equals a point light. Nearby it equals the sum over 200 x 200 points of the
    opening."""
    table = np.array([[1.0, 0.8, 1.0], [0.7, 0.9, 0.7], [0, 0, 0]])
    angles = np.radians([0, 40, 90]), np.radians([0, 180, 360])
    lamp = jv.GoniometricAreaLight([-0.5, 0.3, 2], [1, 0, 0], [0, -0.6, 0], [4.0], table, *angles)
    point = jv.GoniometricLight([0, 0, 2.0], [4.0], table, *angles)
    rule = jv.Quadrature(24)
    far = jnp.array([30.0, 20.0, -98.0])
    at_point = jv.incident(point, far)
    got = jv.irradiance(lamp, far, UP, rule=rule)
    np.testing.assert_allclose(got, at_point.irradiance * at_point.direction[2], rtol=1e-4)
    rule, near = jv.Quadrature(48), jnp.array([0.3, 0.2, 1.5])
    s = (np.arange(100) + 0.5) / 100
    places = np.stack(np.meshgrid(-0.5 + s, 0.3 - 0.6 * s, [2.0]), -1).reshape(-1, 3)
    each = jax.vmap(lambda p: jv.incident(jv.GoniometricLight(p, [4.0], table, *angles), near))
    arriving = each(jnp.asarray(places))
    expected = (arriving.irradiance[:, 0] * arriving.direction[:, 2]).mean()
    np.testing.assert_allclose(jv.irradiance(lamp, near, UP, rule=rule)[0], expected, rtol=2e-4)
    # the radiance along rays, over the directions of the sampler, is the same light
    rule = jv.MonteCarlo(jax.random.key(0), 4096)
    np.testing.assert_allclose(jv.irradiance(lamp, near, UP, rule=rule)[0], expected, rtol=0.01)
    wi = lights.direction_sample(lamp, near, jnp.array([0.3, 0.6]))
    seen = lights.radiance_from(lamp, near, wi.direction)
    density = lights.direction_pdf(lamp, near, wi.direction)
    np.testing.assert_allclose(seen / density, wi.irradiance, rtol=1e-6)
    assert float(wi.density) == pytest.approx(float(density), rel=1e-6)
    u = jnp.asarray(np.random.default_rng(2).random((40_000, 4)))
    rays = jax.vmap(lambda u: lights.emitted(lamp, u, around=None).flux)(u)
    flux = float(lights.flux(point)[0])
    assert float(rays.mean()) == pytest.approx(flux, abs=4 * float(rays.std()) / 200)


def test_impossible_lamps_are_named():
    even = np.ones((2, 1))
    with pytest.raises(ValueError, match=r"SpotLight.inner must be below outer"):
        jv.SpotLight([0.0] * 3, [0, 0, 1], [1.0], 0.5, 0.4)
    with pytest.raises(ValueError, match=r"vertical must increase"):
        jv.GoniometricLight([0.0] * 3, [1.0], even, [1.0, 0.5], [0.0])
    with pytest.raises(ValueError, match=r"horizontal must span a turn"):
        jv.GoniometricLight([0.0] * 3, [1.0], np.ones((2, 2)), [0, 1.0], [0.0, 3.0])
    point = [0.0] * 3, [1.0]
    for table, vertical, more, words in (
        (even, [0, 90.0], {}, r"vertical must be in rad, from 0 to 3.1416 in system C, got \[0"),
        (even, [0, 90.0], {"system": "A"}, r"vertical must be in rad, from -1.5708 to 1.5708"),
        (even, [0, np.nan], {}, r"vertical must be in rad"),
        (np.nan * even, [0, 1.0], {}, r"distribution must be finite, at least 0, got nan"),
        (even, [0, 1.0], {"rotation": 2 * np.eye(3)}, r"rotation must be a rotation, .* x, y and"),
    ):
        with pytest.raises(ValueError, match=words):
            jv.GoniometricLight(*point, table, vertical, [0.0], **more)
    for edge, words in (
        ([1.0, -1, 0], r"edge_u and edge_v must be at a right angle, got 45 degrees"),
        ([0.0, 0, 0], r"edge_v must have a direction, got a vector of length 0"),
    ):
        with pytest.raises(ValueError, match=words):
            jv.GoniometricAreaLight([0.0] * 3, [1.0, 0, 0], edge, [1.0], even, [0, 1.0], [0.0])
    upward = jv.Luminaire(even, [0, np.pi], [0.0], [1.0, 1, 0], 100.0, 9.0)
    with pytest.raises(ValueError, match="shines upward too"):
        jv.goniometric_light(upward, [0, 0, 2], opening=True)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_lamp_that_is_dark_along_its_plane_has_a_bound(dtype):
    """The 90 degrees of a file exceed pi / 2 in float32."""
    candela = np.array([170.0, 140, 60, 0])
    angles = np.radians([0.0, 30, 60, 90])
    with jax.enable_x64(dtype == jnp.float64):
        sizes = [0.0] * 3, [0.3, 0, 0], [0, -0.3, 0]
        numbers = (jnp.asarray(x, dtype) for x in ([1.0], candela[:, None], angles, [0.0]))
        lamp = jv.GoniometricAreaLight(*sizes, *numbers)
        found = float(_largest_radiance(lamp)[0])
    brightest = (candela[:3] / np.cos(angles[:3])).max() / 0.3**2  # at the file's angles
    assert brightest <= found < 3 * brightest
