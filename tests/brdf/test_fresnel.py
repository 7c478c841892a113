"""Tests Fresnel reflectance against the complex amplitudes with 50 digits, and at known angles."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact

from jaxvision.brdf.fresnel import (
    Conductor,
    Dielectric,
    Schlick,
    fresnel,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_schlick,
)

both_precisions = pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])


def amplitudes(cos_i, eta, k=0):
    """Return the unpolarised reflectance from the amplitudes of both polarisations, for any complex
    index."""
    m = mp.mpc(eta, k)
    cos_t = mp.sqrt(1 - (1 - cos_i**2) / m**2)
    s = (cos_i - m * cos_t) / (cos_i + m * cos_t)
    p = (m * cos_i - cos_t) / (m * cos_i + cos_t)
    return (abs(s) ** 2 + abs(p) ** 2) / 2


@both_precisions
def test_high_reflectance_in_ulps(dtype):
    """At grazing angles R = 1 - T has as many digits as T, which is small. Metals are tested at
    every angle."""
    cosines = jnp.asarray(np.geomspace(1e-8, 0.1, 30), dtype)
    metals = jax.jit(jax.vmap(fresnel_conductor, (0, None, None)))
    glasses = jax.jit(jax.vmap(fresnel_dielectric, (0, None)))
    for eta, k in ((1.5, 0.0), (2.4, 0.0), (0.2, 3.1), (3.0, 20.0), (0.05, 0.05)):
        index, absorbed = jnp.asarray([eta], dtype), jnp.asarray([k], dtype)
        got = [metals(cosines, index, absorbed)]
        got += [] if k else [glasses(cosines, index)]
        numbers = exact.number(index.item()), exact.number(absorbed.item())
        for i, c in enumerate(np.asarray(cosines)):
            truth = amplitudes(exact.number(c), *numbers)
            if truth > 0.51:
                assert all(exact.ulps(np.asarray(found)[i, 0], truth) <= 3 for found in got), (
                    eta,
                    k,
                    c,
                )


def test_nan_reflects_nothing_and_no_index_is_too_large():
    metal, glass = jax.jit(fresnel_conductor), jax.jit(fresnel_dielectric)
    for dtype in (np.float32, np.float64):
        nan, half, one, huge = (np.array([x], dtype) for x in (np.nan, 0.5, 1, 1e30))
        for c, eta, k in ((nan, one, one), (half, nan, one), (half, one, nan)):
            assert np.isnan(metal(c[0], eta, k)).all()
            assert np.isnan(glass(c[0], eta + 0 * k)).all()
        assert np.asarray(glass(half[0], huge)) == pytest.approx(1)
        assert np.asarray(metal(half[0], huge, one)) == pytest.approx(1)
        assert np.asarray(metal(half[0], one, huge)) == pytest.approx(1)


def test_known_angles():
    """Glass reflects 4 % at normal incidence, no p-polarised light at Brewster's angle, and all
    light beyond the critical angle."""
    glass, reflected = np.array([1.5]), jax.jit(fresnel_dielectric)
    np.testing.assert_allclose(reflected(np.array(1.0), glass), 0.04, rtol=1e-14)
    brewster = np.cos(np.arctan(1.5))
    r_s = (1 - 1.5**2) / (brewster + np.sqrt(1.5**2 - 1 + brewster**2)) ** 2
    at_brewster = reflected(np.array(brewster), glass)
    np.testing.assert_allclose(at_brewster, r_s**2 / 2, rtol=1e-13)
    beyond = np.array(np.cos(np.arcsin(1 / 1.5)) - 1e-6)
    np.testing.assert_array_equal(reflected(beyond, 1 / glass), 1)


def test_schlick_is_near_the_exact_value_and_dispatch_picks_the_right_one():
    c = jnp.asarray(0.3)
    np.testing.assert_allclose(
        fresnel_schlick(c, jnp.asarray([0.04])), 0.04 + 0.96 * 0.7**5, rtol=1e-14
    )
    eta, k = jnp.asarray([1.5, 0.3]), jnp.asarray([0.0, 2.0])
    both = fresnel(Conductor(eta, k), c)
    np.testing.assert_allclose(both[0], fresnel(Dielectric([1.5]), c)[0], rtol=1e-13)
    np.testing.assert_allclose(fresnel(Schlick([0.04]), c), both[0], atol=0.03)


@pytest.mark.slow
@pytest.mark.sweep
@both_precisions
def test_gradients_are_finite_everywhere(dtype):
    cosines = jnp.asarray([-0.5, 0, 1e-8, 0.6, 0.8, 1, 1.5], dtype)
    indices = jnp.asarray([0.6, 0.8, 1.0, 1.5], dtype)  # 0.6: critical at a cosine of 0.8

    def total(c, eta):
        k = eta / 2
        parts = fresnel_dielectric(c, eta), fresnel_conductor(c, eta, k), fresnel_schlick(c, k)
        return sum(part.sum() for part in parts)

    slopes = jax.jit(jax.vmap(jax.grad(total, argnums=(0, 1)), in_axes=(0, None)))(cosines, indices)
    assert all(jnp.isfinite(s).all() for s in slopes)
