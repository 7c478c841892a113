"""Smooth interfaces: Snell's law, Fresnel reflectance, total reflection, slabs."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import brdf
from jaxvision.brdf.glass import Glass, refracted_direction
from jaxvision.core._vector import as_array
from jaxvision.geometry import Ray
from jaxvision.scene import Box, Quad, Scene, Surface
from jaxvision.transport import ray_tree_radiance


def at(theta, phi=0.3):
    return jnp.asarray(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], float
    )


def reflectance(theta_i, n):
    """Return the Fresnel reflectance from sines and tangents of sums and differences of angles."""
    theta_t = np.arcsin(np.sin(theta_i) / n)
    s = np.sin(theta_i - theta_t) / np.sin(theta_i + theta_t)
    p = np.tan(theta_i - theta_t) / np.tan(theta_i + theta_t)
    return (s**2 + p**2) / 2


@pytest.mark.parametrize("n", [1.5, 1 / 1.5, 1.0001, 2.4])
@pytest.mark.parametrize("theta", [0.05, 0.4, 0.7])
@pytest.mark.parametrize("side", [1, -1])
def test_refraction_obeys_snells_law(n, theta, side):
    """The refracted direction has the ratio of sines, lies in the plane of incidence on the other
    side, and has length 1."""
    w = at(theta) * jnp.asarray([1.0, 1.0, side])
    t = np.asarray(as_array(refracted_direction(w, jnp.asarray(n))))
    assert np.hypot(t[0], t[1]) == pytest.approx(np.sin(theta) / n, rel=1e-13)
    assert np.linalg.norm(t) == pytest.approx(1, rel=1e-14)
    assert np.dot(np.cross(t, [0, 0, 1]), np.asarray(w)) == pytest.approx(0, abs=1e-15)
    assert t[2] * side < 0
    assert t[0] * w[0] < 0


def test_refraction_is_reversible():
    """Refracting back through the interface gives the original direction."""
    w, n = at(0.9), jnp.asarray(1.7)
    through = refracted_direction(w, n)
    np.testing.assert_allclose(as_array(refracted_direction(through, 1 / n)), w, rtol=1e-14)


@pytest.mark.parametrize("theta", [0.1, 0.5, 1.2])
def test_reflectance_from_both_sides(theta):
    """From outside the reflectance is Fresnel's; from inside, along the refracted ray, it is the
    same."""
    glass, w = Glass(1.5), at(theta)
    split = brdf.specular(glass, w)
    assert float(split.reflectance[0]) == pytest.approx(reflectance(theta, 1.5), rel=1e-12)
    back = brdf.specular(glass, split.refracted)
    assert float(back.reflectance[0]) == pytest.approx(float(split.reflectance[0]), rel=1e-12)
    assert float(back.eta) == pytest.approx(1 / 1.5)


def test_total_reflection_inside():
    """Beyond arcsin(1 / n) all light is reflected, and the mirrored ray stays inside."""
    critical = np.arcsin(1 / 1.5)
    for theta, total in ((critical - 1e-3, False), (critical + 1e-3, True), (1.5, True)):
        split = brdf.specular(Glass(1.5), at(theta) * jnp.asarray([1.0, 1.0, -1.0]))
        assert (float(split.reflectance[0]) == 1) is total
        assert float(split.mirrored.z) < 0
        if total:
            assert float(split.refracted.z) == 0
            assert np.linalg.norm(as_array(split.refracted)) == pytest.approx(1, rel=1e-14)


@pytest.mark.slow
def test_glass_is_a_delta_brdf():
    glass, w = Glass(1.5), at(0.6)
    assert float(brdf.evaluate(glass, w, w)[0]) == 0
    assert float(brdf.shading(glass, w, w)[0]) == 0
    assert float(brdf.pdf(glass, w, w)) == 0
    assert float(brdf.albedo(glass, w)[0]) == pytest.approx(reflectance(0.6, 1.5), rel=1e-12)
    u = jax.random.uniform(jax.random.key(0), (4000, 3))
    z = jax.vmap(lambda u: brdf.sample(glass, w, u)[2])(u)
    assert float((z > 0).mean()) == pytest.approx(reflectance(0.6, 1.5), abs=4 * 0.2 / 4000**0.5)


@pytest.mark.sweep
@pytest.mark.parametrize(("theta", "absorption"), [(0.0, None), (0.6, None), (0.6, 0.8)])
def test_slab_transmission_in_closed_form(theta, absorption):
    """A slab that absorbs 1 - a along one crossing transmits T = (1 - R)^2 a / (1 - R^2 a^2)."""
    n, thickness = 1.5, 0.1
    back = Quad([-50, -50, -1], [100, 0, 0], [0, 100, 0])
    glass = Glass(n, absorption=None if absorption is None else [absorption])
    black = brdf.lambert.Lambert([0.0])
    scene = Scene(
        [Surface(Box([0, 0, 0], [40, 40, thickness / 2]), glass), Surface(back, black, [2.0])], []
    )
    w = at(theta)
    trace = jax.jit(partial(ray_tree_radiance, rays=24))
    seen = trace(scene, Ray(2 * w, -w))
    r = reflectance(theta, n) if theta else ((n - 1) / (n + 1)) ** 2
    way = thickness / np.cos(np.arcsin(np.sin(theta) / n))
    a = np.exp(-(absorption or 0) * way)
    assert float(seen[0]) == pytest.approx(2 * (1 - r) ** 2 * a / (1 - r**2 * a**2), rel=1e-9)
    if absorption is None:
        assert float(seen[0]) == pytest.approx(2 * (1 - 2 * r / (1 + r)), rel=1e-9)
        within = trace(scene, Ray(jnp.zeros(3), -at(np.arcsin(np.sin(theta) / n))))
        assert float(within[0]) == pytest.approx(2 * n**2 / (1 + r), rel=1e-9)
