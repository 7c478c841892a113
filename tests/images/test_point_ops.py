"""Tests point operators against loops, published values, inverses and superposition, and at
edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import loops

from jaxvision.point_ops import (
    blend,
    clip,
    contrast_brightness,
    correct_vignetting,
    cross_dissolve,
    exposure,
    filmic,
    gain_bias,
    gamma_decode,
    gamma_encode,
    graded_filter,
    log_curve,
    lookup,
    lookup_3d,
    lookup_codes,
    reinhard,
    scaled_to_key,
    set_luminance,
    srgb_decode,
    srgb_encode,
    vignette,
)

RNG = np.random.default_rng(2)


X = np.concatenate([np.linspace(-0.1, 1.5, 33), [0.0, 0.0031308, 0.0031309, 0.04045, 0.04046]])


def test_srgb_against_the_loop():
    np.testing.assert_allclose(
        srgb_encode(jnp.asarray(X)), [loops.srgb_encode(x) for x in X], rtol=1e-14
    )
    np.testing.assert_allclose(
        srgb_decode(jnp.asarray(X)), [loops.srgb_decode(x) for x in X], rtol=1e-14
    )


def test_srgb_of_known_greys():
    """A reflectance of 0.18 is code 118 of 255, and code 128 is 21.6 % of white."""
    assert round(float(srgb_encode(jnp.asarray(0.18))) * 255) == 118
    np.testing.assert_allclose(srgb_decode(jnp.asarray(128 / 255)), 0.2158605, atol=5e-8)


def test_inverses():
    x = jnp.linspace(0, 2, 50)
    np.testing.assert_allclose(gamma_decode(gamma_encode(x, jnp.asarray(2.2)), jnp.asarray(2.2)), x)
    # the two published thresholds are slightly inconsistent: 12.92 * 0.0031308 = 0.04044994
    np.testing.assert_allclose(srgb_decode(srgb_encode(x)), x, rtol=1e-14)


def test_gamma_and_gain_by_hand():
    x = jnp.asarray([-1.0, 0.0, 0.25, 4.0])
    np.testing.assert_allclose(gamma_encode(x, jnp.asarray(2.0)), [0, 0, 0.5, 2], rtol=1e-15)
    np.testing.assert_allclose(gamma_decode(x, jnp.asarray(2.0)), [0, 0, 0.0625, 16], rtol=1e-15)
    np.testing.assert_array_equal(gain_bias(x, jnp.asarray(2.0), jnp.asarray(1.0)), 2 * x + 1)


@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)])
def test_finite_gradients_and_kept_dtype(dtype):
    g = jnp.asarray(2.2, dtype)
    x = jnp.asarray([-1.0, 0.0, 1e-30, 0.0031308, 0.04045, 1.0, 100.0], dtype)
    curves = (
        srgb_encode,
        srgb_decode,
        lambda t: gamma_encode(t, g),
        lambda t: gamma_decode(t, g),
        lambda t: gamma_encode(x[1], t + 2),
    )
    both = jax.jit(lambda t: [(f(t), jax.vmap(jax.grad(f))(t)) for f in curves])
    for value, slope in both(x):
        assert value.dtype == dtype
        assert jnp.isfinite(value).all()
        assert jnp.isfinite(slope).all()


# ------------------------------------------------ superposition

F, G = (jnp.asarray(RNG.uniform(0.1, 2, size=(2, 5, 7, 3))) for _ in range(2))
MAP = jnp.asarray(RNG.uniform(0.5, 1, size=(1, 5, 7, 1)))
FALLOFF = jnp.asarray([-0.3, 0.05, -0.1])


def scalar(value, dtype=jnp.float64):
    return jnp.asarray(value, dtype)


LINEAR = {
    "gain": lambda x: gain_bias(x, scalar(1.7), scalar(0.0)),
    "gain map": lambda x: gain_bias(x, MAP, scalar(0.0)),
    "exposure": lambda x: exposure(x, scalar(-1.3)),
    "graded filter": lambda x: graded_filter(x, scalar(0.6), scalar(0.3), scalar(0.1), scalar(0.5)),
    "vignette": lambda x: vignette(x, FALLOFF),
    "correct vignetting": lambda x: correct_vignetting(x, FALLOFF),
}
NOT_LINEAR = {
    "bias": lambda x: gain_bias(x, scalar(1.0), scalar(0.1)),
    "gamma": lambda x: gamma_encode(x, scalar(2.2)),
    "sRGB": srgb_encode,
    "Reinhard": reinhard,
    "filmic": filmic,
    "clip": lambda x: clip(x, scalar(0.0), scalar(1.0)),
}


def superposition_error(operator):
    """Return the largest |h(a f + b g) - (a h(f) + b h(g))|."""
    a, b = 0.7, 1.9
    error = jax.jit(
        lambda f, g: jnp.abs(operator(a * f + b * g) - (a * operator(f) + b * operator(g))).max()
    )
    return float(error(F, G))


@pytest.mark.parametrize("name", LINEAR)
def test_superposition_holds(name):
    assert superposition_error(LINEAR[name]) < 1e-14


@pytest.mark.parametrize("name", NOT_LINEAR)
def test_superposition_fails(name):
    assert superposition_error(NOT_LINEAR[name]) > 0.1


# ------------------------------------------------ maps over the picture


@pytest.mark.slow
def test_vignetting_by_the_loop_and_back():
    image = np.asarray(F)
    expected = np.empty_like(image)
    for i in range(5):
        for j in range(7):
            r2 = ((i - 2) ** 2 + (j - 3) ** 2) / (2**2 + 3**2)
            expected[:, i, j] = image[:, i, j] * (1 - 0.3 * r2 + 0.05 * r2**2 - 0.1 * r2**3)
    shaded = vignette(F, FALLOFF)
    np.testing.assert_allclose(shaded, expected, rtol=1e-14)
    np.testing.assert_allclose(correct_vignetting(shaded, FALLOFF), F, rtol=1e-14)


@pytest.mark.slow
def test_a_lens_with_black_corners():
    """1 - 2 r^2 is below 0 in the corners, which are black, and stay black after correction."""
    dark = jnp.asarray([-2.0])
    shaded = vignette(F, dark)
    assert (shaded[:, 0, 0] == 0).all()
    summed = jax.value_and_grad(lambda k: correct_vignetting(shaded, k).sum())
    corrected, slope = jax.jit(summed)(dark)
    assert jnp.isfinite(corrected)
    assert jnp.isfinite(slope).all()
    assert (correct_vignetting(shaded, dark)[:, 0, 0] == 0).all()
    one_pixel = jnp.ones((1, 1, 3))
    np.testing.assert_array_equal(vignette(one_pixel, dark), one_pixel)


def test_graded_filter_by_hand():
    """The filter darkens to the right: zero density on the left, half at the centre line, and all
    on the right. Rotated upwards, it varies along rows."""
    image = jnp.ones((5, 5, 1))
    density = scalar(0.6)
    graded = jax.jit(graded_filter)
    right = graded(image, density, scalar(0.0), scalar(0.0), scalar(0.8))[..., 0]
    s = np.array([0, 0.15625, 0.5, 0.84375, 1])  # 3 t^2 - 2 t^3 at t = 0, 1/4, 1/2, 3/4, 1
    np.testing.assert_allclose(right, np.broadcast_to(10 ** (-0.6 * s), (5, 5)), rtol=1e-14)
    up = graded(image, density, scalar(np.pi / 2), scalar(0.0), scalar(0.8))[..., 0]
    np.testing.assert_allclose(up, right[:, ::-1].T, rtol=1e-14)
    shifted = graded(image, density, scalar(0.0), scalar(0.2), scalar(0.8))[..., 0]
    np.testing.assert_allclose(shifted[:, 3], right[:, 2], rtol=1e-14)
    step = graded(image, 0.6, 0.0, 0.0, 0.0)[0, :, 0]
    np.testing.assert_allclose(step, [1, 1, 10**-0.3, 10**-0.6, 10**-0.6], rtol=1e-14)


# ------------------------------------------------ blends


def test_contrast_turns_about_its_pivot():
    x = jnp.asarray([0.0, 0.5, 1.0])
    np.testing.assert_allclose(
        contrast_brightness(x, scalar(2.0), scalar(0.0)), [-0.5, 0.5, 1.5], rtol=1e-15
    )
    np.testing.assert_allclose(
        contrast_brightness(x, scalar(2.0), scalar(0.1), pivot=0.0), [0.1, 1.1, 2.1], rtol=1e-15
    )


def test_dissolve_from_one_sequence_to_the_other():
    first, second = (jnp.asarray(RNG.uniform(size=(5, 2, 3, 3))) for _ in range(2))
    mixed = cross_dissolve(first, second)
    np.testing.assert_array_equal(mixed[0], first[0])
    np.testing.assert_array_equal(mixed[-1], second[-1])
    for i in range(5):
        expected = np.asarray(first[i]) * (1 - i / 4) + np.asarray(second[i]) * (i / 4)
        np.testing.assert_allclose(mixed[i], expected, rtol=1e-14)
    np.testing.assert_allclose(blend(first, first, scalar(0.3)), first, rtol=1e-15)
    with pytest.raises(ValueError, match=r"one shape and at least two frames, got \(5,.*\(4,"):
        cross_dissolve(first, second[:4])
    with pytest.raises(ValueError, match="at least two frames"):
        cross_dissolve(first[:1], second[:1])


# ------------------------------------------------ tables


@pytest.mark.slow
def test_lookup_as_numpy():
    table = RNG.uniform(size=17)
    x = np.concatenate([RNG.uniform(-0.3, 1.3, size=200), np.linspace(0, 1, 17), [-0.0]])
    ours = lookup(jnp.asarray(x), jnp.asarray(table))
    np.testing.assert_allclose(ours, np.interp(x, np.linspace(0, 1, 17), table), rtol=1e-13)
    with pytest.raises(ValueError, match="at least two entries, got 1"):
        lookup(jnp.asarray(x), jnp.ones(1))


@pytest.mark.slow
def test_lookup_of_codes_is_the_table():
    table = jnp.asarray(RNG.uniform(size=256))
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_array_equal(lookup_codes(jnp.asarray(codes), table).ravel(), table)
    beyond = lookup_codes(jnp.asarray([-3, 300]), table)
    np.testing.assert_array_equal(beyond, table[jnp.asarray([0, 255])])


@pytest.mark.slow
def test_lookup_3d_as_scipy():
    from scipy.interpolate import RegularGridInterpolator

    table = RNG.uniform(size=(3, 4, 5, 2))
    axes = [np.linspace(0, 1, n) for n in table.shape[:3]]
    image = RNG.uniform(-0.1, 1.1, size=(6, 7, 3))
    expected = RegularGridInterpolator(axes, table)(np.clip(image, 0, 1))
    ours = jax.jit(lookup_3d)(jnp.asarray(image), jnp.asarray(table))
    np.testing.assert_allclose(ours, expected, rtol=1e-12)
    identity = jnp.asarray(np.stack(np.meshgrid(*[axes[0]] * 3, indexing="ij"), axis=-1))
    inside = jnp.asarray(np.clip(image, 0, 1))
    np.testing.assert_allclose(lookup_3d(inside, identity), inside, rtol=1e-13, atol=1e-15)
    with pytest.raises(ValueError, match="two entries an axis"):
        lookup_3d(inside, jnp.ones((1, 2, 2, 3)))


# ------------------------------------------------ tone mapping


def test_reinhard_at_its_fixed_points():
    x = jnp.asarray([0.0, 1.0, 4.0])
    np.testing.assert_allclose(reinhard(x), [0, 0.5, 0.8], rtol=1e-15)
    np.testing.assert_allclose(reinhard(x, white=scalar(4.0))[2], 1.0, rtol=1e-15)
    assert float(reinhard(jnp.asarray(jnp.inf))) == 1.0
    # a larger white is nearer to the simple curve
    np.testing.assert_allclose(reinhard(x, white=scalar(1e9)), reinhard(x), rtol=1e-15)
    slope = jax.jit(jax.vmap(jax.grad(reinhard)))(jnp.asarray([-1e-9, 0.0, 1e-9]))
    np.testing.assert_allclose(slope, 1, rtol=1e-8)


@pytest.mark.slow
def test_the_key_of_a_picture():
    luminance = RNG.uniform(0.01, 10, size=(8, 9))
    ours = scaled_to_key(jnp.asarray(luminance), key_value=0.36)
    expected = 0.36 * luminance / np.exp(np.mean(np.log(luminance)))
    np.testing.assert_allclose(ours, expected, rtol=1e-13)
    for black in (jnp.zeros((4, 4)), jnp.zeros((4, 4)).at[0, 0].set(1.0)):
        scaled, slope = jax.jit(jax.value_and_grad(lambda x: scaled_to_key(x).sum()))(black)
        assert jnp.isfinite(scaled)
        assert jnp.isfinite(slope).all()
    holes = luminance.copy()
    holes[2, 3], holes[4, 4] = np.nan, np.inf
    finite = np.isfinite(holes)
    expected = 0.18 * holes / np.exp(np.mean(np.log(holes[finite])))
    np.testing.assert_allclose(scaled_to_key(jnp.asarray(holes)), expected, rtol=1e-13)


def test_black_pixels_that_change_the_key_are_named():
    """A fifth of the picture is a black border, so the rest becomes 16 times as bright."""
    luminance = RNG.uniform(0.5, 1.0, size=(10, 10))
    whole = scaled_to_key(jnp.asarray(luminance))
    bordered = np.where(np.arange(10)[:, None] < 2, 0, luminance)
    with pytest.warns(UserWarning, match="20% of the luminance is at or below 0"):
        brighter = scaled_to_key(jnp.asarray(bordered))
    assert 10 < float(brighter[5, 5] / whole[5, 5]) < 20
    left_out = scaled_to_key(jnp.asarray(np.where(bordered > 0, bordered, np.nan)))
    expected = 0.18 * luminance[2:] / np.exp(np.mean(np.log(luminance[2:])))
    np.testing.assert_allclose(left_out[2:], expected, rtol=1e-12)


def test_log_curve_ends():
    x = jnp.asarray([-1.0, 0.0, 1.0, 1e-8])
    np.testing.assert_allclose(
        log_curve(x, scalar(255.0)), [0, 0, 1, 255e-8 / np.log(256)], rtol=2e-6
    )


def test_a_curve_of_the_luminance_keeps_the_chromaticity():
    image = jnp.asarray(RNG.uniform(0.1, 5, size=(4, 4, 3)))
    y = image.mean(axis=-1)
    mapped = set_luminance(image, y, reinhard(y))
    np.testing.assert_allclose(mapped.mean(axis=-1), reinhard(y), rtol=1e-14)
    shares = [x / x.sum(axis=-1, keepdims=True) for x in (mapped, image)]
    np.testing.assert_allclose(*shares, rtol=1e-14)
    assert (set_luminance(jnp.zeros((1, 3)), jnp.zeros(1), jnp.ones(1)) == 0).all()


# ------------------------------------------------ fast forms, edges, types


def test_fast_forms_have_the_documented_errors():
    """The error is up to 16 gamma ULP for dark values, which are large powers of two."""
    x = np.geomspace(1e-5, 1, 20_001).astype(np.float32)
    eps = np.finfo(np.float32).eps
    for curve in (gamma_encode, gamma_decode):
        g = np.float32(2.2)
        power = 1 / g if curve is gamma_encode else g  # as rounded to float32
        truth = x.astype(np.float64) ** np.float64(np.float32(power))
        for method, bound in (("power", 2), ("exp2", 16 * power)):
            found = np.asarray(curve(jnp.asarray(x), jnp.asarray(g), method=method), np.float64)
            error = np.abs(found / truth - 1).max() / eps
            assert error <= bound, (curve, method, error)
            if method == "exp2":
                assert error > 2, "as exact as power: say so"
    with pytest.raises(ValueError, match=r"method must be one of power, exp2, got 'fast'"):
        gamma_encode(jnp.asarray(x), jnp.asarray(g), method="fast")


CURVES = {
    "encode": lambda x: gamma_encode(x, 2.2),
    "decode": lambda x: gamma_decode(x, 2.2),
    "sRGB encode": srgb_encode,
    "sRGB decode": srgb_decode,
    "exp2 encode": lambda x: gamma_encode(x, 2.2, method="exp2"),
    "exp2 sRGB": lambda x: srgb_decode(srgb_encode(x, method="exp2"), method="exp2"),
    "reinhard": lambda x: reinhard(x, white=3.0),
    "filmic": filmic,
    "log": lambda x: log_curve(x, 100.0),
    "clip": lambda x: clip(x, 0.0, 1.0),
    "lookup": lambda x: lookup(x, jnp.asarray([0.0, 0.5, 0.1], x.dtype)),
    "lookup 3d": lambda x: lookup_3d(
        jnp.stack([x, 0 * x, 0 * x], axis=-1), jnp.ones((2, 2, 2, 1), x.dtype)
    )[..., 0],
    "gain": lambda x: gain_bias(x, 1.5, 0.1),
    "blend": lambda x: blend(x, jnp.ones_like(x), 0.3),
    "of the luminance": lambda x: set_luminance(x[..., None], x, jnp.ones_like(x))[..., 0],
    "exposure": lambda x: exposure(x, 1.5),
    "contrast": lambda x: contrast_brightness(x, 2.0, 0.1),
}


def together(x):
    """Return the value and the slope of every curve at the numbers x, in one program."""
    return {n: (f(x), jax.vmap(jax.grad(f))(x)) for n, f in CURVES.items()}


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)])
def test_curves_are_finite_keep_the_dtype_and_nan(dtype):
    """NaN and infinity in one pixel do not change the others."""
    x = jnp.asarray([-1e6, -1.0, 0.0, 1e-30, 0.5, 1.0, 1e6], dtype)
    run = jax.jit(together)
    clean = run(x)
    broken = {bad: run(x.at[4].set(bad)) for bad in (np.nan, np.inf)}
    others = jnp.asarray([0, 1, 2, 3, 5, 6])
    for name, (value, slope) in clean.items():
        assert value.dtype == slope.dtype == dtype, name
        assert jnp.isfinite(value).all(), name
        assert jnp.isfinite(slope).all(), name
        assert jnp.isnan(broken[np.nan][name][0][4]), name
        for found, _ in (broken[bad][name] for bad in broken):
            np.testing.assert_array_equal(found[others], value[others], err_msg=name)


def test_integer_codes_are_refused_as_colours(as_for_users):
    """Integer arithmetic would wrap around or round to 0."""
    codes = jnp.asarray([[[0, 118, 255]]], jnp.uint8)
    calls = [
        *(CURVES[name] for name in CURVES if name not in ("blend", "of the luminance")),
        lambda x: gain_bias(x, 1.5, 0.1),
        lambda x: exposure(x, 1.0),
        lambda x: vignette(x, FALLOFF),
        lambda x: correct_vignetting(x, FALLOFF),
        lambda x: graded_filter(x, 0.6, 0.0, 0.0, 0.8),
        lambda x: set_luminance(x, x[..., 0], x[..., 0]),
        lambda x: blend(x, x, 0.5),
        lambda x: cross_dissolve(jnp.stack([x, x]), jnp.stack([x, x])),
        scaled_to_key,
    ]
    for call in calls:
        with pytest.raises(ValueError, match="floating and relative, got uint8; divide by 255"):
            call(codes)
    for wrong, said in (
        (codes.astype(jnp.uint16), 65535),
        (codes.astype(complex), "the largest value"),
    ):
        with pytest.raises(ValueError, match=rf"got {wrong.dtype}; divide by {said}\."):
            srgb_encode(wrong)
    np.testing.assert_allclose(srgb_encode(0.18), loops.srgb_encode(0.18), rtol=1e-14)
    with pytest.raises(ValueError, match=r"\(..., h, w, bands\), got shape \(3,\)"):
        vignette(jnp.ones(3), FALLOFF)
    with pytest.raises(ValueError, match=r"a last axis of 3, got shape \(2, 4\)"):
        lookup_3d(jnp.ones((2, 4)), jnp.ones((2, 2, 2, 1)))


@pytest.mark.parametrize("decode", [srgb_decode, lambda x: gamma_decode(x, 2.2)])
def test_encoded_values_far_above_white_are_named(decode):
    """Means of codes are not integers. 1.5 may be outside a gamut or a range."""
    with pytest.warns(UserWarning, match=r"up to 200\.5, where 1 is white: divide codes"):
        decode(jnp.asarray([[0.0, 127.25, 200.5]]))
    decode(jnp.asarray([[-0.1, 0.5, 1.5, jnp.inf, jnp.nan]]))
