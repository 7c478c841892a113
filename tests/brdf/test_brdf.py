"""The three families against the textbook in 50 digits, and the laws they do and do not obey."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from jax.test_util import check_grads
from oracles import exact

from jaxvision import as_dtype
from jaxvision.brdf import at_angles, evaluate, reflect
from jaxvision.brdf.gaussian_lobe import (
    GaussianLobe,
    gaussian_lobe,
    gaussian_lobe_shading,
    squared_angle_between,
)
from jaxvision.brdf.lambert import Lambert, lambert_shading
from jaxvision.brdf.phong import NormalisedPhong, Phong, phong_lobe, phong_shading
from jaxvision.core._numerics import log_of_zero

RNG = np.random.default_rng(11)
Z = jnp.asarray([0.0, 0.0, 1.0])
KD, KS = jnp.asarray([0.2, 0.1, 0.05]), jnp.asarray([0.3, 0.4, 0.5])
MATERIALS = [Lambert(KD), Phong(KD, KS, 12.0), GaussianLobe(KD, KS, 3.0)]


def direction(theta, phi=0.0):
    """Unit vector at polar angle theta from +z."""
    return jnp.asarray(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], jnp.float64
    )


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 30.0, 1e6])
def test_phong_lobe_in_ulps(dtype, exponent):
    """exp of a rounded argument x is good to about |x| / 2 + 1 units."""
    log_cos = jnp.asarray([0, -1e-8, -1e-6, -0.01, -0.5, -3], dtype)
    n = jnp.asarray(exponent, dtype)
    for x, got in zip(log_cos, phong_lobe(log_cos, n), strict=True):
        argument = exact.number(x) * exact.number(n)
        if argument > log_of_zero(dtype) + 1:
            assert exact.ulps(got, mp.exp(argument)) <= 1 + abs(argument)
        else:
            assert got <= jnp.finfo(dtype).tiny * 3


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gaussian_lobe_in_ulps(dtype):
    theta = jnp.asarray([0, 1e-4, 0.1, 0.5, 2.0], dtype)
    c = jnp.asarray(2.5, dtype)
    for x, got in zip(theta, gaussian_lobe(theta, c), strict=True):
        argument = -((exact.number(x) * exact.number(c)) ** 2)
        assert exact.ulps(got, mp.exp(argument)) <= 1 + 3 * abs(argument)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_squared_angle_in_ulps_and_its_gradient(dtype):
    """From nothing to opposite directions, against the angle of the very numbers in 50 digits;
    d theta^2 / d theta = 2 theta along the arc, finite at both ends. Vectors eps off unit length
    lie that much apart, of theta."""
    eps = float(jnp.finfo(dtype).eps)
    angles = [0.0, 1e-10, 1e-4, 0.1, 0.7, 1.5, 1.6, 2.5, 3.1, 3.1415, np.pi]
    axis = jnp.asarray(direction(0.3, 1.0), dtype)
    frame = np.linalg.qr(np.stack([direction(0.3, 1.0), *np.eye(3)[:2]]).T)[0]
    sign = np.sign(frame[:, 0] @ direction(0.3, 1.0))
    along, across = sign * frame[:, 0], frame[:, 1]
    slope = jax.grad(lambda w: squared_angle_between(axis, w))
    for angle in angles:
        w = jnp.asarray(np.cos(angle) * along + np.sin(angle) * across, dtype)
        got, gradient = squared_angle_between(axis, w), slope(w)
        assert got.dtype == dtype
        assert jnp.isfinite(gradient).all()
        truth = exact.angle(exact.vector(axis), exact.vector(w))
        if truth > 20 * eps:
            assert exact.ulps(got, truth**2) <= 12 + 4 * eps / truth**2
        else:
            assert got <= (40 * eps) ** 2
        if 1e-4 <= angle < 3.1:
            turned = np.asarray(gradient) @ (np.cos(angle) * across - np.sin(angle) * along)
            assert turned == pytest.approx(
                2 * angle, rel=2000 * float(jnp.finfo(dtype).eps) + 1e-12
            )


def test_lobes_broadcast_a_scalar_and_keep_float32():
    x = jnp.asarray([-0.1, -0.2], jnp.float32)
    assert phong_lobe(x, jnp.float32(3)).shape == (2,)
    assert phong_lobe(jnp.float32(-0.1), -x).shape == (2,)
    assert phong_lobe(x, jnp.float32(3)).dtype == jnp.float32
    assert gaussian_lobe(-x, jnp.float32(3)).dtype == jnp.float32


def test_phong_shading_in_degrees():
    """By hand: light at 30 degrees, view 20 degrees from the mirror direction."""
    wi, wo = direction(np.pi / 6), direction(np.pi / 6 - np.pi / 9, np.pi)
    got = phong_shading(Z, wi, wo, KD, KS, jnp.asarray(7.0))
    expected = np.asarray(KD) * np.cos(np.pi / 6) + np.asarray(KS) * np.cos(np.pi / 9) ** 7
    np.testing.assert_allclose(got, expected, rtol=1e-14)


def test_gaussian_lobe_shading_in_degrees():
    wi, wo = direction(np.pi / 6), direction(np.pi / 6 - np.pi / 9, np.pi)
    got = gaussian_lobe_shading(Z, wi, wo, KD, KS, jnp.asarray(2.0))
    lobe = np.exp(-((2 * np.pi / 9) ** 2))
    expected = np.asarray(KD) * np.cos(np.pi / 6) + np.asarray(KS) * lobe
    np.testing.assert_allclose(got, expected, rtol=1e-14)


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_attached_shadow_is_exactly_zero(material):
    value = jax.jit(jax.vmap(lambda wi: reflect(material, Z, wi, direction(1.4))))
    below = jnp.stack([direction(t) for t in (np.pi / 2 + 1e-6, 2.0, np.pi)] + [0 * Z])
    assert (value(below) == 0).all()
    assert (value(direction(np.pi / 2 - 1e-6)[None]) > 0).all()


@pytest.mark.sweep
@pytest.mark.parametrize("shade", [phong_shading, gaussian_lobe_shading])
def test_a_viewer_below_the_surface_sees_nothing(shade):
    """Where the mirror direction is seen best from below, or only just: exactly 0, as `reflect`
    has it; the light below too."""
    wi = jnp.asarray([0.6, 0, 0.8])
    below = [[-0.8, 0, -0.6], [-1.0, 0, 0], [0.6, 0, -0.8]]
    shaded = jax.jit(jax.vmap(shade, in_axes=(None, None, 0, None, None, None)))
    got = shaded(Z, wi, jnp.asarray(below), KD, KS, jnp.asarray(1.0))
    assert (got == 0).all()
    family = {phong_shading: Phong, gaussian_lobe_shading: GaussianLobe}[shade]
    wo = jnp.asarray([-0.96, 0, 0.28])
    np.testing.assert_allclose(
        jax.jit(shade)(Z, wi, wo, KD, KS, jnp.asarray(1.0)),
        jax.jit(reflect)(family(KD, KS, 1.0), Z, wi, wo),
        rtol=1e-14,
    )


def test_a_view_across_the_mirror_direction_sees_no_highlight():
    """The cosine of the lobe is 0 but for rounding, of either sign, and a program may compute it
    twice: with exponents in a loop around the directions, in two ways."""
    rng = np.random.default_rng(3)
    wo, other = rng.normal(size=(2, 500, 3))
    mirror = np.cross(wo, other)
    wi = mirror * [-1, -1, 1]
    wi, wo = (np.sign(v[:, 2:]) * v / np.linalg.norm(v, axis=1)[:, None] for v in (wi, wo))

    def lobes(exponents, wi, wo):
        def lobe(exponent):
            material = NormalisedPhong(jnp.zeros(1), jnp.ones(1), exponent)
            return jax.vmap(evaluate, (None, 0, 0))(material, wi, wo)

        return jax.lax.map(lobe, exponents)

    found = jax.jit(lobes)(jnp.array([5.0, 20.0]), *(jnp.asarray(v) for v in (wi, wo)))
    np.testing.assert_allclose(found, 0, atol=1e-12)


def test_specular_term_has_no_cosine_of_incidence():
    """At a grazing light the mirror view sees k_s in full: what tells Phong SHADING from a BRDF
    in the rendering equation."""
    wi, wo = direction(np.pi / 2 - 1e-3), direction(np.pi / 2 - 1e-3, np.pi)
    for material in MATERIALS[1:]:
        np.testing.assert_allclose(reflect(material, Z, wi, wo), KS + KD * 1e-3, rtol=1e-5)


def test_a_white_lambert_surface_returns_what_arrives():
    """Albedo 1: k_d = 1 / pi; radiance k_d E over the hemisphere, times cosine, is E again."""
    cos_o, weight = np.polynomial.legendre.leggauss(8)
    cos_o, weight = (cos_o + 1) / 2, weight / 2
    radiance = float(lambert_shading(Z, direction(0.4), jnp.asarray([1 / np.pi]))[0])
    exitance = 2 * np.pi * (weight * cos_o).sum() * radiance
    np.testing.assert_allclose(exitance, np.cos(0.4), rtol=1e-14)


def test_lambert_is_the_same_from_everywhere_and_linear_in_albedo():
    wi = direction(0.7)
    values = [reflect(MATERIALS[0], Z, wi, direction(t, p)) for t, p in [(0.1, 0), (1.2, 2)]]
    np.testing.assert_array_equal(values[0], values[1])
    np.testing.assert_allclose(lambert_shading(Z, wi, 2 * KD), 2 * values[0], rtol=1e-15)


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_rotating_everything_changes_nothing(material):
    q, _ = np.linalg.qr(RNG.normal(size=(3, 3)))
    wi, wo = direction(0.5, 0.2), direction(0.9, 2.5)
    turned = reflect(material, *(jnp.asarray(q) @ v for v in (Z, wi, wo)))
    np.testing.assert_allclose(turned, reflect(material, Z, wi, wo), rtol=1e-13)


def test_large_exponent_and_gaussian_agree():
    """cos^n theta -> exp(-n theta^2 / 2): a Gaussian lobe of c^2 = n / 2, to order n theta^4."""
    n, theta = 1e6, 1e-3
    phong = phong_lobe(jnp.asarray(np.log(np.cos(theta))), jnp.asarray(n))
    gauss = gaussian_lobe(jnp.asarray(theta), jnp.asarray(np.sqrt(n / 2)))
    np.testing.assert_allclose(phong, gauss, rtol=n * theta**4 / 6)


@pytest.mark.sweep
@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_gradient_matches_central_differences(material):
    wi, wo = direction(0.5, 0.2), direction(0.8, 3.0)

    def value(parameters, light):
        return reflect(jax.tree.map(jnp.asarray, parameters), Z, jnp.asarray(light), wo).sum()

    check_grads(value, (material, wi), order=1, modes=["rev"], atol=1e-6, rtol=1e-6)


def test_float32_stays_float32():
    for material in MATERIALS:
        vectors = (v.astype(jnp.float32) for v in (Z, direction(0.3), direction(0.2)))
        assert reflect(as_dtype(material, jnp.float32), *vectors).dtype == jnp.float32


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_four_angles_are_two_directions(material):
    for theta_i, phi_i, theta_o, phi_o in RNG.uniform(0, [1.5, 6.0, 1.5, 6.0], (4, 4)):
        expected = evaluate(material, direction(theta_i, phi_i), direction(theta_o, phi_o))
        got = at_angles(material, theta_i, phi_i, theta_o, phi_o)
        np.testing.assert_allclose(got, expected, rtol=1e-12)
    np.testing.assert_array_equal(at_angles(material, 1.6, 0.0, 0.2, 0.0), 0)
