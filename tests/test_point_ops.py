"""Tone curves against a loop and published values, inverses, and edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import loops

from jaxvision.point_ops import gain_bias, gamma_decode, gamma_encode, srgb_decode, srgb_encode

X = np.concatenate([np.linspace(-0.1, 1.5, 33), [0.0, 0.0031308, 0.0031309, 0.04045, 0.04046]])


def test_srgb_against_the_loop():
    np.testing.assert_allclose(
        srgb_encode(jnp.asarray(X)), [loops.srgb_encode(x) for x in X], rtol=1e-14
    )
    np.testing.assert_allclose(
        srgb_decode(jnp.asarray(X)), [loops.srgb_decode(x) for x in X], rtol=1e-14
    )


def test_srgb_of_known_greys():
    """Reflectance 0.18 is code 118 of 255, and code 128 is 21.6 % of white: the usual tables of
    sRGB values."""
    assert round(float(srgb_encode(jnp.asarray(0.18))) * 255) == 118
    np.testing.assert_allclose(srgb_decode(jnp.asarray(128 / 255)), 0.2158605, atol=5e-8)


def test_inverses():
    x = jnp.linspace(0, 2, 50)
    np.testing.assert_allclose(gamma_decode(gamma_encode(x, jnp.asarray(2.2)), jnp.asarray(2.2)), x)
    # the two published thresholds do not quite meet: 12.92 * 0.0031308 = 0.04044994
    np.testing.assert_allclose(srgb_decode(srgb_encode(x)), x, rtol=1e-14)


def test_gamma_and_gain_by_hand():
    x = jnp.asarray([-1.0, 0.0, 0.25, 4.0])
    np.testing.assert_allclose(gamma_encode(x, jnp.asarray(2.0)), [0, 0, 0.5, 2], rtol=1e-15)
    np.testing.assert_allclose(gamma_decode(x, jnp.asarray(2.0)), [0, 0, 0.0625, 16], rtol=1e-15)
    np.testing.assert_array_equal(gain_bias(x, jnp.asarray(2.0), jnp.asarray(1.0)), 2 * x + 1)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_finite_gradients_and_kept_dtype(dtype):
    g = jnp.asarray(2.2, dtype)
    x = jnp.asarray([-1.0, 0.0, 1e-30, 0.0031308, 0.04045, 1.0, 100.0], dtype)
    for curve in (
        srgb_encode,
        srgb_decode,
        lambda t: gamma_encode(t, g),
        lambda t: gamma_decode(t, g),
        lambda t: gamma_encode(x[1], t + 2),
    ):
        assert curve(x).dtype == dtype
        assert jnp.isfinite(curve(x)).all()
        assert jnp.isfinite(jax.vmap(jax.grad(curve))(x)).all()
