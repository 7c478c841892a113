"""Tests the three textbook BRDFs against evaluations with 50 digits, and the physical laws that
they obey or violate."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import exact

from jaxvision.brdf import at_angles, evaluate, reflect
from jaxvision.brdf.gaussian_lobe import (
    GaussianLobe,
    gaussian_lobe_shading,
    squared_angle_between,
)
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.phong import NormalisedPhong, Phong, phong_shading

RNG = np.random.default_rng(11)
Z = jnp.asarray([0.0, 0.0, 1.0])
KD, KS = jnp.asarray([0.2, 0.1, 0.05]), jnp.asarray([0.3, 0.4, 0.5])
MATERIALS = [Lambert(KD), Phong(KD, KS, 12.0), GaussianLobe(KD, KS, 3.0)]


def direction(theta, phi=0.0):
    """Return the unit vector at polar angle theta from +z."""
    return jnp.asarray(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], jnp.float64
    )


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_squared_angle_in_ulps_and_its_gradient(dtype):
    """Angles from 0 to pi are compared, in ULP, with the angle of the same rounded vectors computed
    with 50 digits."""
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


@pytest.mark.sweep
@pytest.mark.parametrize("shade", [phong_shading, gaussian_lobe_shading])
def test_a_viewer_below_the_surface_sees_nothing(shade):
    """The mirror direction is seen best from below the surface, or from just below it."""
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
    """The lobe's cosine is 0 up to a rounding error of either sign. A program may compute it twice
    with different rounding, if exponents are in a loop around the directions."""
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


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_rotating_everything_changes_nothing(material):
    q, _ = np.linalg.qr(RNG.normal(size=(3, 3)))
    wi, wo = direction(0.5, 0.2), direction(0.9, 2.5)
    turned = reflect(material, *(jnp.asarray(q) @ v for v in (Z, wi, wo)))
    np.testing.assert_allclose(turned, reflect(material, Z, wi, wo), rtol=1e-13)


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_four_angles_are_two_directions(material):
    for theta_i, phi_i, theta_o, phi_o in RNG.uniform(0, [1.5, 6.0, 1.5, 6.0], (4, 4)):
        expected = evaluate(material, direction(theta_i, phi_i), direction(theta_o, phi_o))
        got = at_angles(material, theta_i, phi_i, theta_o, phi_o)
        np.testing.assert_allclose(got, expected, rtol=1e-12)
    np.testing.assert_array_equal(at_angles(material, 1.6, 0.0, 0.2, 0.0), 0)
