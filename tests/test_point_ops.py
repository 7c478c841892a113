"""Point operators against loops, published values, inverses, superposition and edges."""

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
    srgb_decode,
    srgb_encode,
    vignette,
    with_luminance,
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
    """The largest |h(a f + b g) - (a h(f) + b h(g))|."""
    a, b = 0.7, 1.9
    return float(jnp.abs(operator(a * F + b * G) - (a * operator(F) + b * operator(G))).max())


@pytest.mark.parametrize("name", LINEAR)
def test_superposition_holds(name):
    assert superposition_error(LINEAR[name]) < 1e-14


@pytest.mark.parametrize("name", NOT_LINEAR)
def test_superposition_fails(name):
    assert superposition_error(NOT_LINEAR[name]) > 0.1


# ------------------------------------------------ maps over the picture


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


def test_a_lens_that_lets_nothing_through():
    """1 - 2 r^2 is below 0 in the corners: black there, and still black after correction."""
    dark = jnp.asarray([-2.0])
    shaded = vignette(F, dark)
    assert (shaded[:, 0, 0] == 0).all()
    corrected, slope = jax.value_and_grad(lambda k: correct_vignetting(shaded, k).sum())(dark)
    assert jnp.isfinite(corrected)
    assert jnp.isfinite(slope).all()
    assert (correct_vignetting(shaded, dark)[:, 0, 0] == 0).all()
    one_pixel = jnp.ones((1, 1, 3))
    np.testing.assert_array_equal(vignette(one_pixel, dark), one_pixel)


def test_graded_filter_by_hand():
    """Darker to the right: nothing on the left, half the density at the centre line, all of it on
    the right; turned up, rows instead of columns."""
    image = jnp.ones((5, 5, 1))
    density = scalar(0.6)
    right = graded_filter(image, density, scalar(0.0), scalar(0.0), scalar(0.8))[..., 0]
    s = np.array([0, 0.15625, 0.5, 0.84375, 1])  # 3 t^2 - 2 t^3 at t = 0, 1/4, 1/2, 3/4, 1
    np.testing.assert_allclose(right, np.broadcast_to(10 ** (-0.6 * s), (5, 5)), rtol=1e-14)
    up = graded_filter(image, density, scalar(np.pi / 2), scalar(0.0), scalar(0.8))[..., 0]
    np.testing.assert_allclose(up, right[:, ::-1].T, rtol=1e-14)
    shifted = graded_filter(image, density, scalar(0.0), scalar(0.2), scalar(0.8))[..., 0]
    np.testing.assert_allclose(shifted[:, 3], right[:, 2], rtol=1e-14)


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


def test_lookup_as_numpy():
    table = RNG.uniform(size=17)
    x = np.concatenate([RNG.uniform(-0.3, 1.3, size=200), np.linspace(0, 1, 17), [-0.0]])
    ours = lookup(jnp.asarray(x), jnp.asarray(table))
    np.testing.assert_allclose(ours, np.interp(x, np.linspace(0, 1, 17), table), rtol=1e-13)
    assert lookup(scalar(np.nan), jnp.asarray(table)) == table[0]
    with pytest.raises(ValueError, match="at least two entries, got 1"):
        lookup(jnp.asarray(x), jnp.ones(1))


def test_lookup_of_codes_is_the_table():
    table = jnp.asarray(RNG.uniform(size=256))
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_array_equal(lookup_codes(jnp.asarray(codes), table).ravel(), table)
    beyond = lookup_codes(jnp.asarray([-3, 300]), table)
    np.testing.assert_array_equal(beyond, table[jnp.asarray([0, 255])])


def test_lookup_3d_as_scipy():
    from scipy.interpolate import RegularGridInterpolator

    table = RNG.uniform(size=(3, 4, 5, 2))
    axes = [np.linspace(0, 1, n) for n in table.shape[:3]]
    image = RNG.uniform(-0.1, 1.1, size=(6, 7, 3))
    expected = RegularGridInterpolator(axes, table)(np.clip(image, 0, 1))
    ours = lookup_3d(jnp.asarray(image), jnp.asarray(table))
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
    # the more can burn out, the nearer to the simple curve
    np.testing.assert_allclose(reinhard(x, white=scalar(1e9)), reinhard(x), rtol=1e-15)
    slope = jax.vmap(jax.grad(reinhard))(jnp.asarray([-1e-9, 0.0, 1e-9]))
    np.testing.assert_allclose(slope, 1, rtol=1e-8)


def test_key_of_a_picture():
    luminance = RNG.uniform(0.01, 10, size=(8, 9))
    ours = scaled_to_key(jnp.asarray(luminance), key_value=0.36)
    expected = 0.36 * luminance / np.exp(np.mean(np.log(luminance)))
    np.testing.assert_allclose(ours, expected, rtol=1e-13)
    for black in (jnp.zeros((4, 4)), jnp.zeros((4, 4)).at[0, 0].set(1.0)):
        scaled, slope = jax.value_and_grad(lambda x: scaled_to_key(x).sum())(black)
        assert jnp.isfinite(scaled)
        assert jnp.isfinite(slope).all()


def test_filmic_of_the_published_fit():
    x = np.linspace(0, 3, 40)
    expected = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    np.testing.assert_allclose(filmic(jnp.asarray(x)), np.minimum(expected, 1), rtol=1e-14)
    ends = filmic(jnp.asarray([-1.0, 0.0, 1e30, 3e38], jnp.float32))
    np.testing.assert_array_equal(ends, [0, 0, 1, 1])


def test_log_curve_ends():
    x = jnp.asarray([-1.0, 0.0, 1.0, 1e-8])
    np.testing.assert_allclose(
        log_curve(x, scalar(255.0)), [0, 0, 1, 255e-8 / np.log(256)], rtol=2e-6
    )


def test_a_curve_of_the_luminance_keeps_the_chromaticity():
    image = jnp.asarray(RNG.uniform(0.1, 5, size=(4, 4, 3)))
    y = image.mean(axis=-1)
    mapped = with_luminance(image, y, reinhard(y))
    np.testing.assert_allclose(mapped.mean(axis=-1), reinhard(y), rtol=1e-14)
    shares = [x / x.sum(axis=-1, keepdims=True) for x in (mapped, image)]
    np.testing.assert_allclose(*shares, rtol=1e-14)
    assert (with_luminance(jnp.zeros((1, 3)), jnp.zeros(1), jnp.ones(1)) == 0).all()


# ------------------------------------------------ fast forms, edges, types


def test_fast_forms_err_as_documented():
    """Up to 60 units of the last place, where a dark value is a large power of two; the exact form
    within 2."""
    x = np.geomspace(1e-5, 1, 20_001).astype(np.float32)
    eps = np.finfo(np.float32).eps
    for curve in (gamma_encode, gamma_decode):
        g = np.float32(2.2)
        power = 1 / g if curve is gamma_encode else g  # as rounded to float32: the input
        truth = x.astype(np.float64) ** np.float64(np.float32(power))
        for method, bound in (("power", 2), ("exp2", 60)):
            found = np.asarray(curve(jnp.asarray(x), jnp.asarray(g), method=method), np.float64)
            error = np.abs(found / truth - 1).max() / eps
            assert error <= bound, (curve, method, error)
            if method == "exp2":
                assert error > 2, "as exact as power: say so"
    with pytest.raises(ValueError, match=r"method must be .power. or .exp2., got 'fast'"):
        gamma_encode(jnp.asarray(x), jnp.asarray(g), method="fast")


CURVES = {
    "exp2 encode": lambda x: gamma_encode(x, scalar(2.2, x.dtype), method="exp2"),
    "exp2 sRGB": lambda x: srgb_decode(srgb_encode(x, method="exp2"), method="exp2"),
    "reinhard": lambda x: reinhard(x, white=scalar(3.0, x.dtype)),
    "filmic": filmic,
    "log": lambda x: log_curve(x, scalar(100.0, x.dtype)),
    "clip": lambda x: clip(x, scalar(0.0, x.dtype), scalar(1.0, x.dtype)),
    "lookup": lambda x: lookup(x, jnp.asarray([0.0, 0.5, 0.1], x.dtype)),
    "exposure": lambda x: exposure(x, scalar(1.5, x.dtype)),
    "contrast": lambda x: contrast_brightness(x, scalar(2.0, x.dtype), scalar(0.1, x.dtype)),
}


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("name", CURVES)
def test_curves_are_finite_and_keep_the_dtype(name, dtype):
    x = jnp.asarray([-1e6, -1.0, 0.0, 1e-30, 0.5, 1.0, 1e6], dtype)
    curve = CURVES[name]
    assert curve(x).dtype == dtype
    assert jnp.isfinite(curve(x)).all()
    assert jnp.isfinite(jax.vmap(jax.grad(curve))(x)).all()


@pytest.mark.parametrize("name", ["reinhard", "filmic", "log", "exposure", "contrast", "clip"])
def test_nan_stays_in_its_own_pixel(name):
    out = CURVES[name](jnp.asarray([0.2, np.nan, 0.4]))
    assert jnp.isnan(out).tolist() == [False, True, False]
