"""Colour conversions where a naive formula loses digits: near greys, near black, large differences.

Values are compared with 50-digit results for the same floating-point inputs, with errors in units
of the last place of the largest term; gradients are finite.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
from oracles import exact
from precisions import both_precisions, eps

from jaxvision import colour_spaces as cs
from jaxvision.matting.compositing import over, unpremultiply
from jaxvision.point_ops import (
    clip,
    correct_vignetting,
    exposure,
    gamma_encode,
    srgb_decode,
    srgb_encode,
)


def numbers(x):
    return [exact.number(v) for v in x]


def hue(a, b):
    return mp.mpf(0) if a == b == 0 else mp.atan2(b, a) % (2 * mp.pi)


@both_precisions
def test_edges_of_the_transfer_functions(dtype):
    """NaN in an argument gives NaN; infinities and negative numbers give what the docstrings
    say."""
    edges = np.array([np.nan, np.inf, -np.inf, -1, 0], dtype)
    slope = float(np.array(12.92, dtype))
    encoded = jax.jit(srgb_encode)(edges)
    np.testing.assert_array_equal(encoded, [np.nan, np.inf, -np.inf, -slope, 0])
    decoded = np.asarray(jax.jit(srgb_decode)(edges))
    np.testing.assert_array_equal(decoded[:3], [np.nan, np.inf, -np.inf])
    powered = jax.jit(gamma_encode)(edges, np.array(2.2, dtype))
    np.testing.assert_array_equal(powered, [np.nan, np.inf, 0, 0, 0])
    stops = np.array([np.nan, np.inf, -np.inf, -126, 0, 127], dtype)
    powers = [np.nan, np.inf, 0, 2.0**-126, 1, 2.0**127]
    np.testing.assert_array_equal(jax.jit(exposure)(np.ones_like(stops), stops), powers)
    nan, zero, one, half = (np.array(x, dtype) for x in (np.nan, 0, 1, [-1, 0.5, 2]))
    clipped = jax.jit(clip)
    for low, high in ((nan, one), (zero, nan)):
        assert np.isnan(clipped(half, low, high)).sum() >= 2
    assert np.isnan(clipped(half, nan, one)).all()
    corrected = jax.jit(correct_vignetting)(np.ones((2, 2, 1), dtype), nan[None])
    assert np.isnan(corrected).all()


@both_precisions
def test_huge_hues_are_whole_turns(dtype):
    """A hue so large that the dtype has no digits below 1 is a whole number of turns."""
    for convert in (cs.hsv_to_rgb, cs.hsl_to_rgb):
        once, far = (jnp.asarray([hue, 0.5, 0.6], dtype) for hue in (0.0, 1e30))
        np.testing.assert_array_equal(convert(far), convert(once))


@both_precisions
def test_a_thousand_faint_layers(dtype):
    """The coverage of n layers of alpha a is 1 - (1 - a)^n; rounding adds up to n eps / 2 at
    most."""
    alpha, n = 1e-3, 1000
    layer = jnp.asarray([alpha / 2, alpha], dtype)
    stacked = jax.lax.fori_loop(0, n, lambda _, below: over(layer, below), jnp.zeros(2, dtype))
    covered = -mp.expm1(n * mp.log1p(-exact.number(layer[1])))
    assert abs(exact.number(stacked[1]) - covered) <= n * eps(dtype) / 2
    colour = unpremultiply(stacked)
    assert abs(float(colour[0]) - 0.5) <= n * eps(dtype)
