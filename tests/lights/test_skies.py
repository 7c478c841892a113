"""Tests skies and the sun: closed forms of the horizontal irradiance, and tables against
independent ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate
from scipy.special import expn

import jaxvision as jv
from jaxvision import lights

UP = jnp.array([0.0, 0.0, 1.0])
RADIANCE = jax.jit(jax.vmap(lights.sky_radiance, in_axes=(None, None, 0)))


def level(parameters, sun):
    """Return the irradiance of level ground for a zenith radiance of 1."""
    nodes, weights = jv.geometry.hemisphere.product_nodes(200, 64)
    return float(weights @ (np.asarray(RADIANCE(parameters, sun, nodes)) * nodes[:, 2]))


@pytest.mark.parametrize(("kind", "a", "b"), [(1, 4.0, -0.7), (3, 1.1, -0.8), (5, 0.0, -1.0)])
def test_overcast_skies_have_closed_form_integrals(kind, a, b):
    """The relative radiance is (1 + a exp(b / cos)) / (1 + a exp(b))."""
    expected = 2 * np.pi * (0.5 + a * expn(3, -b)) / (1 + a * np.exp(b))
    sun = jnp.array([0.6, 0, 0.8])
    assert level(jnp.asarray(lights.cie_sky(kind)), sun) == pytest.approx(expected, rel=1e-6)
    assert kind != 5 or expected == pytest.approx(np.pi)


@pytest.mark.sweep("15")
@pytest.mark.parametrize("kind", [4, 8, 12, 15])
def test_skies_against_the_standards_formula(kind):
    """The reference is plain NumPy by angles. The picture of the sky gives the stated irradiance on
    level ground."""
    a, b, c, d, e = lights.cie_sky(kind)
    sun = np.array([np.sin(0.9), 0, np.cos(0.9)])
    rng = np.random.default_rng(0)
    z, phi = np.arccos(rng.uniform(0.01, 1, 200)), rng.uniform(0, 2 * np.pi, 200)
    at = np.stack([np.sin(z) * np.cos(phi), np.sin(z) * np.sin(phi), np.cos(z)], -1)
    chi = np.arccos(np.clip(np.cos(0.9) * np.cos(z) + np.sin(0.9) * np.sin(z) * np.cos(phi), -1, 1))

    def f(x):
        return 1 + c * (np.exp(d * x) - np.exp(d * np.pi / 2)) + e * np.cos(x) ** 2

    expected = (1 + a * np.exp(b / np.cos(z))) * f(chi) / ((1 + a * np.exp(b)) * f(0.9))
    got = RADIANCE(jnp.asarray(lights.cie_sky(kind)), jnp.asarray(sun), jnp.asarray(at))
    np.testing.assert_allclose(got, expected, rtol=1e-9)
    sky = lights.daylight(kind, sun, irradiance=[50.0])
    arriving = jv.irradiance(sky, jnp.zeros(3), UP, rule=jv.Quadrature(128))
    np.testing.assert_allclose(arriving, 50, rtol=3e-3)


@pytest.mark.parametrize(
    ("clearness", "brightness", "zenith"), [(1.02, 0.2, 0.9), (1.3, 0.3, 0.5), (8.0, 0.1, 1.0)]
)
def test_perezs_sky_follows_his_formula(clearness, brightness, zenith):
    """The radiance is (1 + a exp(b / cos Z)) (1 + c exp(d chi) + e cos^2 chi), with Perez's
    coefficients for three ranges of clearness from the paper's table."""
    table = {
        1.02: [
            (1.3525, -0.2576, -0.2690, -1.4366), (-0.7670, 0.0007, 1.2734, -0.1233),
            (2.8, 0.6004, 1.2375, 1.0), (1.8734, 0.6297, 0.9738, 0.2809),
            (0.0356, -0.1246, -0.5718, 0.9938),
        ],
        1.3: [
            (-1.1, -0.2515, 0.8952, 0.0156), (0.2782, -0.1812, -4.5, 1.1766),
            (24.7219, -13.0812, -37.7, 34.8438), (-5.0, 1.5218, 3.9229, -2.6204),
            (-0.0156, 0.1597, 0.4199, -0.5562),
        ],
        8.0: [
            (-1.05, 0.0289, 0.4260, 0.3590), (-0.3250, 0.1156, 0.7781, 0.0025),
            (31.0625, -14.5, -46.1148, 55.3750), (-7.2312, 0.4050, 13.35, 0.6234),
            (1.5, -0.6426, 1.8564, 0.5636),
        ],
    }[clearness]  # fmt: skip
    own = [p + q * zenith + brightness * (r + s * zenith) for p, q, r, s in table]
    if clearness == 1.02:
        (p, q, r, s), (t, u, v, w) = table[2:4]
        own[2] = np.exp((brightness * (p + q * zenith)) ** r) - s
        own[3] = -np.exp(brightness * (t + u * zenith)) + v + brightness * w
    a, b, c, d, e = own

    def perez(z, chi):
        return (1 + a * np.exp(b / np.cos(z))) * (1 + c * np.exp(d * chi) + e * np.cos(chi) ** 2)

    parameters = jnp.asarray(lights.perez_sky(zenith, clearness, brightness))
    sun = jnp.array([np.sin(zenith), 0, np.cos(zenith)])
    for z in (0.0, 0.4, 1.2):
        at = jnp.array([np.sin(z), 0, np.cos(z)])
        got = float(lights.sky_radiance(parameters, sun, at))
        assert got == pytest.approx(perez(z, abs(z - zenith)) / perez(0, zenith), rel=1e-9)


@pytest.mark.slow
def test_the_sun_is_a_disc():
    """Checked are its irradiance on level ground by quadrature, by its radiance, and its penumbra:
    half the light where an edge hides half of the disc."""
    sun = jv.SunDisc([0, 0.6, 0.8], [100.0], 0.05)
    arriving = jv.irradiance(sun, jnp.zeros(3), UP, rule=jv.Quadrature(16))
    np.testing.assert_allclose(arriving, 80, rtol=1e-6)
    seen = lights.radiance_from(sun, jnp.zeros(3), jnp.array([0, 0.6, 0.8]))
    np.testing.assert_allclose(seen, 100 / np.pi / np.sin(0.05) ** 2, rtol=1e-9)
    outside = jnp.array([np.sin(0.06), 0.6 * np.cos(0.06), 0.8 * np.cos(0.06)])
    assert float(lights.radiance_from(sun, jnp.zeros(3), outside)[0]) == 0
    inside = lights.direction_sample(sun, jnp.zeros(3), jnp.array([0.9, 0.3]))
    density = lights.direction_pdf(sun, jnp.zeros(3), inside.direction)
    np.testing.assert_allclose(seen / density, inside.irradiance, rtol=1e-9)
    assert float(inside.density) == pytest.approx(float(density), rel=1e-12)
    screen = jv.Quad([-5, -5, 1], [5.0, 0, 0], [0, 10, 0])  # with its edge over x = 0
    floor = jv.Surface(jv.Quad([-1, -2, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([1 / np.pi]))
    scene = jv.Scene([floor, jv.Surface(screen, jv.Lambert([0.0]), two_sided=True)], [sun])
    half = 0.05 / 0.8  # half of the penumbra, m

    def lit(x):
        view = jv.Orthographic(
            (x, -0.75, 0.5), [[1.0, 0, 0], [0, -1, 0], [0, 0, -1]], 1e-4, resolution=(1, 1)
        )
        return float(jv.render(scene, view, rule=jv.Quadrature(64))[0, 0, 0]) * np.pi / 80

    assert lit(-1.3 * half) == 0
    assert lit(1.3 * half) == pytest.approx(1, rel=1e-6)
    assert lit(0.0) == pytest.approx(0.5, abs=0.03)
    share = 0.5 + integrate.quad(lambda t: 2 / np.pi * np.sqrt(1 - t * t), 0, 0.5)[0]
    assert lit(0.5 * half) == pytest.approx(share, abs=0.03)


def test_invalid_skies_are_named():
    with pytest.raises(ValueError, match="kind must be a whole number from 1 to 15"):
        lights.cie_sky(17)
    with pytest.raises(ValueError, match="the sun must stand above the horizon"):
        lights.daylight(12, [0, 0, -1], irradiance=[1.0])
    with pytest.raises(ValueError, match=r"a finite vector with a direction, got \[ ?0"):
        lights.daylight(12, [0, 0, 0], irradiance=[1.0])
    with pytest.raises(ValueError, match="a Perez sky has a clearness of at least 1"):
        lights.perez_sky(0.5, 0.5, 0.2)


@pytest.mark.parametrize("whole", [np.int64, np.uint8, jnp.asarray])
@pytest.mark.parametrize("kind", [12, 16])
def test_an_integer_of_any_library_names_a_sky(whole, kind):
    want, got = (
        lights.daylight(number, [0, 0.6, 0.8], irradiance=[1.0], rows=16).radiance
        for number in (kind, whole(kind))
    )
    np.testing.assert_array_equal(got, want)


def test_a_negative_sky_is_named():
    with pytest.warns(UserWarning, match=r"falls below 0 in \d+% of the upper half"):
        lights.daylight(
            lights.perez_sky(0.6, 2.2, 0.05), [np.sin(0.6), 0, np.cos(0.6)], irradiance=[100.0]
        )
    with pytest.raises(ValueError, match="a brightness from 0 to 1"):
        lights.perez_sky(0.5, 4.0, 30.0)
