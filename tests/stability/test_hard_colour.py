"""Colour conversions where a naive formula loses digits: near greys, near black, large differences.

Values against 50 digits for the same floating-point inputs, the error in units of the last place of
the largest term; gradients finite.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import both_precisions, eps

from jaxvision import colour_spaces as cs
from jaxvision.matting.compositing import over, unpremultiply
from jaxvision.point_ops import (
    clip,
    correct_vignetting,
    exposure,
    gamma_decode,
    gamma_encode,
    reinhard,
    srgb_decode,
    srgb_encode,
)

RNG = np.random.default_rng(17)
WHITE = [0.95045, 1.0, 1.08906]


def numbers(x):
    return [exact.number(v) for v in x]


def lightness(t):
    return mp.cbrt(t) if t > mp.mpf(216) / 24389 else t * mp.mpf(841) / 108 + mp.mpf(4) / 29


@both_precisions
def test_lab_and_luv_of_near_greys_and_near_blacks(dtype):
    """Lab takes differences of nearly equal cube roots: an error of 500 ulp(f) in a*, of a
    conditioning that no formula escapes. u' - u'_n over one denominator keeps its digits."""
    white = jnp.asarray(WHITE, dtype)
    xn, yn, zn = numbers(white)
    colours = [
        scale * (np.asarray(WHITE) * (1 + 1e-3 * RNG.normal(size=3)))
        for scale in (1e-12, 1e-6, 0.00885, 0.00886, 0.2, 1.0, 100.0)
    ]
    xyz = jnp.asarray(colours, dtype)
    lab, luv = (jax.jit(f)(xyz, white) for f in (cs.xyz_to_lab, cs.xyz_to_luv))
    for colour, got_lab, got_luv in zip(xyz, lab, luv, strict=True):
        x, y, z = numbers(colour)
        fx, fy, fz = (lightness(v) for v in (x / xn, y / yn, z / zn))
        true_lab = [116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)]
        for got, truth, size in zip(got_lab, true_lab, (116 * fy, 500 * fx, 200 * fy), strict=True):
            assert abs(exact.number(got) - truth) <= 4 * eps(dtype) * size
        total, total_n = x + 15 * y + 3 * z, xn + 15 * yn + 3 * zn
        scale = 13 * true_lab[0]
        u = scale * (4 * x / total - 4 * xn / total_n)
        v = scale * (9 * y / total - 9 * yn / total_n)
        # L* itself carries 4 eps (116 f) / L*, the difference of products 4 eps of one product
        of_lightness = 116 * fy / true_lab[0]
        for got, truth, share in ((got_luv[1], u, 4 * xn), (got_luv[2], v, 9 * yn)):
            bound = abs(truth) * of_lightness + scale * share / total_n
            assert abs(exact.number(got) - truth) <= 6 * eps(dtype) * bound


def chroma_weight(c):
    return mp.sqrt(c**7 / (c**7 + mp.mpf(25) ** 7))


def hue(a, b):
    return mp.mpf(0) if a == b == 0 else mp.atan2(b, a) % (2 * mp.pi)


def delta_e(first, second):
    """Sharma's equations in the order of the paper."""
    l1, a1, b1 = numbers(first)
    l2, a2, b2 = numbers(second)
    g = (1 - chroma_weight((mp.hypot(a1, b1) + mp.hypot(a2, b2)) / 2)) / 2
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2, h1, h2 = mp.hypot(a1, b1), mp.hypot(a2, b2), hue(a1, b1), hue(a2, b2)
    dh = h2 - h1
    if c1 * c2 == 0:
        dh = mp.mpf(0)
    elif dh > mp.pi:
        dh -= 2 * mp.pi
    elif dh < -mp.pi:
        dh += 2 * mp.pi
    d_hue = 2 * mp.sqrt(c1 * c2) * mp.sin(dh / 2)
    mean_l, mean_c, mean_h = (l1 + l2) / 2, (c1 + c2) / 2, (h1 + h2) / 2
    if c1 * c2 == 0:
        mean_h = h1 + h2
    elif abs(h1 - h2) > mp.pi:
        mean_h += mp.pi if h1 + h2 < 2 * mp.pi else -mp.pi
    deg = mp.pi / 180
    t = 1 - mp.mpf("0.17") * mp.cos(mean_h - 30 * deg) + mp.mpf("0.24") * mp.cos(2 * mean_h)
    t += mp.mpf("0.32") * mp.cos(3 * mean_h + 6 * deg) - mp.mpf("0.2") * mp.cos(
        4 * mean_h - 63 * deg
    )
    theta = 30 * deg * mp.exp(-(((mean_h / deg - 275) / 25) ** 2))
    r_t = -2 * chroma_weight(mean_c) * mp.sin(2 * theta)
    s_l = 1 + mp.mpf("0.015") * (mean_l - 50) ** 2 / mp.sqrt(20 + (mean_l - 50) ** 2)
    light, c = (l2 - l1) / s_l, (c2 - c1) / (1 + mp.mpf("0.045") * mean_c)
    h = d_hue / (1 + mp.mpf("0.015") * mean_c * t)
    return mp.sqrt(light * light + c * c + h * h + r_t * c * h)


@pytest.mark.slow
@both_precisions
def test_delta_e_2000_of_greys_and_close_colours(dtype):
    """Chroma from 0 to 1e4, the 7th power of which exceeds float32. Colours may be so close that
    their chromas and hues, each rounded, are equal."""
    pairs = [
        ([50, -60, 1e-6], [50, -60, -1e-6]),
        ([50, 60, 1e-4], [50, 60, -1e-4]),
        ([65.8, 14.84, -73.67], [65.8, 14.840001, -73.67001]),
        ([30, 40, 20], [30, 40, 20.001]),
        ([50, 0, 0], [50, 1e-20, 1e-21]),
        ([50, 0, 0], [50, 0, 0]),
        ([50, 0, 0], [51, 1e-4, 0]),
        ([0, 0, 0], [100, 0, 0]),
        ([50, 1e4, -1e4], [60, 9e3, -1.1e4]),
        ([30, 20, -70], [30.01, 20.01, -70.02]),
        ([30, 1e-8, 1e-8], [30, -1e-8, 1e-8]),
    ]
    first, second = (jnp.asarray([pair[i] for pair in pairs], dtype) for i in (0, 1))
    both = jax.jit(jax.vmap(jax.value_and_grad(cs.delta_e_2000)))
    found, slope = both(first, second)
    assert jnp.isfinite(slope).all()
    for got, one, two in zip(found, first, second, strict=True):
        truth = delta_e(one, two)
        assert abs(exact.number(got) - truth) <= 16 * eps(dtype) * truth


@jax.jit
def transfer(x, gamma):
    """Every transfer function of relative values, with gamma as an array and as a number."""
    return {
        "encode": srgb_encode(x),
        "decode": srgb_decode(x),
        "root": gamma_encode(x, gamma),
        "root by a number": gamma_encode(x, 2.2),
        "power": gamma_decode(x, gamma),
        "power by a number": gamma_decode(x, 2.2),
        "stops": exposure(jnp.ones_like(x), jnp.log2(x)),
    }


@both_precisions
def test_edges_of_the_transfer_functions(dtype):
    """NaN in each argument arrives; infinity and numbers below 0 are what the text says."""
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
def test_reinhard_of_the_brightest_numbers(dtype):
    """x^2 is out of range long before the result is; so is its slope's square."""
    x = jnp.asarray([1e-30, 0.3, 3e3, 1e15, 3.7e19, 1e20, 1e30, 1e37], dtype)
    w = exact.number(jnp.asarray(3.0, dtype))
    both = jax.jit(jax.vmap(jax.value_and_grad(lambda x: reinhard(x, white=3.0))))
    for v, value, slope in zip(numbers(x), *both(x), strict=True):
        assert exact.ulps(value, v * (1 + v / w**2) / (1 + v)) <= 4
        assert exact.ulps(slope, (1 + v * (2 + v) / w**2) / (1 + v) ** 2) <= 6


@both_precisions
def test_the_darkest_colours_keep_their_digits(dtype):
    """Below (6/29)^3 of the white, L* is (29/3)^3 Y and no difference from 16; and back."""
    white = jnp.asarray(WHITE, dtype)
    dark = np.geomspace(1e-12, 6e-3, 12)[:, None] * np.asarray([1.1, 0.7, 0.4])
    xyz = jnp.asarray(dark, dtype)

    @jax.jit
    def there_and_back(xyz):
        lab, luv = cs.xyz_to_lab(xyz, white), cs.xyz_to_luv(xyz, white)
        return lab, luv[..., 0], cs.lab_to_xyz(lab, white)

    lab, of_luv, back = there_and_back(xyz)
    for i, colour in enumerate(xyz):
        x, y, z = (v / w for v, w in zip(numbers(colour), numbers(white), strict=True))
        for lightness in (lab[i, 0], of_luv[i]):
            assert exact.ulps(lightness, mp.mpf(24389) / 27 * y) <= 3
        f = mp.mpf(841) / 108
        for got, truth in zip(lab[i, 1:], (500 * f * (x - y), 200 * f * (y - z)), strict=True):
            assert exact.ulps(got, truth) <= 8
    np.testing.assert_allclose(back, xyz, rtol=6 * eps(dtype))


@both_precisions
def test_differences_of_colours_with_nan_are_nan(dtype):
    """And not a perfect match."""
    lab = jnp.asarray([50, 1, 2], dtype)
    for i in range(3):
        broken = lab.at[i].set(jnp.nan)
        assert jnp.isnan(cs.delta_e_76(broken, lab)), i
        assert jnp.isnan(cs.delta_e_2000(broken, lab)), i
        assert jnp.isnan(cs.to_lch(broken)).any(), i


@both_precisions
def test_hues_of_many_turns(dtype):
    """Beyond the digits of the dtype every hue is a whole number of turns."""
    for convert in (cs.hsv_to_rgb, cs.hsl_to_rgb):
        once, far = (jnp.asarray([hue, 0.5, 0.6], dtype) for hue in (0.0, 1e30))
        np.testing.assert_array_equal(convert(far), convert(once))


@both_precisions
def test_a_thousand_faint_layers(dtype):
    """Coverage of n layers of alpha a is 1 - (1 - a)^n: rounding adds up to n eps / 2 at most."""
    alpha, n = 1e-3, 1000
    layer = jnp.asarray([alpha / 2, alpha], dtype)
    stacked = jax.lax.fori_loop(0, n, lambda _, below: over(layer, below), jnp.zeros(2, dtype))
    covered = -mp.expm1(n * mp.log1p(-exact.number(layer[1])))
    assert abs(exact.number(stacked[1]) - covered) <= n * eps(dtype) / 2
    colour = unpremultiply(stacked)
    assert abs(float(colour[0]) - 0.5) <= n * eps(dtype)
