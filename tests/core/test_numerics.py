"""Tests the numerical primitives against mpmath, in ULP, and their gradients at every edge."""

from fractions import Fraction
from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import both_precisions

import jaxvision as jv
from jaxvision.core import _numerics as num
from jaxvision.core._vector import as_array
from jaxvision.geometry._places import _pick

RNG = np.random.default_rng(20240501)


def unit_pairs(dtype, angle, count=8):
    """Return pairs of nearly unit vectors about `angle` apart, rounded to `dtype`."""
    u = RNG.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    side = np.cross(u, RNG.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return jnp.asarray(u, dtype), jnp.asarray(np.cos(angle) * u + np.sin(angle) * side, dtype)


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_norm_and_normalize(dtype, scale):
    v = jnp.asarray(RNG.normal(size=(8, 3)) * scale, dtype)
    lengths, units = num.norm(v), num.normalize(v)
    assert lengths.dtype == units.dtype == dtype
    for row, got, direction in zip(v, lengths, units, strict=True):
        truth = exact.length(exact.vector(row))
        assert exact.ulps(got, truth) <= 3
        for component, unit_component in zip(row, direction, strict=True):
            assert exact.ulps(unit_component, exact.number(component) / truth) <= 6


@both_precisions
def test_arctan2_and_its_slopes(dtype):
    """The angle is mpmath's, and the slopes are x / (x^2 + y^2) and -y / (x^2 + y^2)."""
    angles = np.array([0.0, 1e-6, 0.3, 0.7, 0.9, 1.5707, 1.5709, 2.0, 3.0, np.pi])
    lengths = np.array([1e-12, 1.0, 1e12])[:, None]
    x, y = (jnp.asarray((lengths * f(angles)).ravel(), dtype) for f in (np.cos, np.sin))
    slopes = jax.jit(jax.vmap(jax.value_and_grad(num.arctan2, argnums=(0, 1))))
    for a, b, value, by_y, by_x in zip(x, y, *jax.tree.leaves(slopes(y, x)), strict=True):
        a, b = exact.number(a), exact.number(b)
        assert exact.ulps(value, mp.atan2(b, a)) <= 4
        square = a * a + b * b
        assert exact.ulps(by_y, a / square) <= 8
        assert exact.ulps(by_x, -b / square) <= 8


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("angle", [1e-3, 0.1, 1.0, 1.5, 3.0])
def test_angles(dtype, angle):
    u, v = unit_pairs(dtype, angle)
    for a, b, got in zip(u, v, num.angle_between(u, v), strict=True):
        truth = exact.angle(exact.vector(a), exact.vector(b))
        # the inputs have unit length up to half a ULP, which changes angles near pi by as much
        assert exact.ulps(got, truth) <= 4


@both_precisions
def test_divide_gives_the_default_without_a_quotient(dtype):
    a, b = jnp.asarray([3, 1, 2, jnp.nan], dtype), jnp.asarray([4, 0, -2, 5], dtype)
    default, chosen = num.divide(a, b), num.divide(a, b, b != 0, jnp.inf)
    assert default.dtype == chosen.dtype == dtype
    np.testing.assert_array_equal(default, [0.75, 0, 0, jnp.nan])
    np.testing.assert_array_equal(chosen, [0.75, jnp.inf, -1, jnp.nan])
    slopes = jax.grad(lambda a, b: num.divide(a, b).sum(), (0, 1))(a[:3], b[:3])
    np.testing.assert_array_equal(slopes, [[0.25, 0, 0], [-3 / 16, 0, 0]])


@pytest.mark.slow
@both_precisions
def test_sine_and_cosine_of_turns(dtype):
    """Many turns, angles next to multiples of an eighth, tiny and negative ones. Quarters are
    exact."""
    eighths = np.arange(17) / 8
    turns = [RNG.random(200), eighths * (1 + 1e-6), [1e-6, 1e-20, -0.3, 7.3, 1000.1]]
    turns = np.concatenate(turns).astype(dtype)
    for x, *got in zip(turns, *num.sine_cosine(jnp.asarray(turns)), strict=True):
        for value, truth in zip(got, (mp.sinpi, mp.cospi), strict=True):
            assert value.dtype == dtype
            assert exact.ulps(value, truth(2 * exact.number(x))) <= 2
    quarters = jnp.arange(-4, 9, dtype=dtype) / 4
    sine, cosine = num.sine_cosine(quarters)
    np.testing.assert_array_equal(sine, np.tile([0, 1, 0, -1], 4)[:13])
    np.testing.assert_array_equal(cosine, np.tile([1, 0, -1, 0], 4)[:13])
    _, slopes = jax.jvp(num.sine_cosine, (quarters,), (jnp.ones_like(quarters),))
    np.testing.assert_allclose(slopes[0], 2 * np.pi * cosine, rtol=1e-6)
    np.testing.assert_allclose(slopes[1], -2 * np.pi * sine, rtol=1e-6)


@both_precisions
@pytest.mark.parametrize("angle", [1e-3, 0.1, 1.0, 1.1, 1.5])
def test_log_cos(dtype, angle):
    """The unit vectors have errors of eps / 2 themselves, which change log cos by as much."""
    u, v = unit_pairs(dtype, angle)
    eps = float(jnp.finfo(dtype).eps)
    for a, b, got in zip(u, v, num.log_cos_between(u, v), strict=True):
        truth = mp.log(exact.cosine(exact.vector(a), exact.vector(b)))
        bound = 4 * eps * (abs(truth) if angle < 0.5 else 1 / np.cos(angle))
        assert abs(exact.number(got) - truth) <= bound


@pytest.mark.slow
@both_precisions
def test_log_cos_at_a_right_angle_and_beyond_stands_for_zero(dtype):
    u = jnp.asarray([0, 0, 1], dtype)
    beyond = jnp.asarray([[1, 0, 0], [0, 0.6, -0.8], [0, 0, -1], [0, 0, 0]], dtype)
    values = jax.vmap(lambda v: num.log_cos_between(u, v))(beyond)
    assert (values == jnp.asarray(num.log_of_zero(dtype), dtype)).all()
    assert (jax.vmap(jax.grad(lambda v: num.log_cos_between(u, v)))(beyond) == 0).all()


@pytest.mark.slow
@both_precisions
def test_gradients_are_finite_at_every_edge(dtype):
    x = jnp.asarray([0.0, -1.0, 1e-30, 1.0, 1e30], dtype)
    one = jnp.ones((), dtype)
    scalar = {
        "sqrt": num.safe_sqrt,
        "log": num.safe_log,
        "power": lambda t: num.power(t, one / 2),
        "exponent": lambda t: num.power(jnp.zeros_like(t), t),
    }
    for name, function in scalar.items():
        assert jnp.isfinite(jax.vmap(jax.grad(function))(x)).all(), name
    z = jnp.asarray([0, 0, 1], dtype)
    vectors = jnp.asarray([[0, 0, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [1e-30, 0, 0]], dtype)
    functions = {
        "norm": num.norm,
        "normalize": lambda v: num.normalize(v).sum(),
        "angle": lambda v: num.angle_between(z, v),
        "angle to itself": lambda v: num.angle_between(v, v),
        "log cos": lambda v: num.log_cos_between(z, v),
    }
    for name, function in functions.items():
        assert jnp.isfinite(jax.vmap(jax.grad(function))(vectors)).all(), name


def test_defined_values_at_the_edges():
    zero, x = jnp.zeros(3), jnp.asarray([-1.0, 0.0, 4.0])
    assert num.norm(zero) == 0
    assert (num.normalize(zero) == 0).all()
    assert num.angle_between(zero, zero) == 0
    np.testing.assert_array_equal(num.safe_sqrt(x), [0, 0, 2])
    np.testing.assert_array_equal(num.power(x, jnp.asarray(2.0)), [0, 0, 16])
    assert num.safe_log(x)[0] == num.log_of_zero(jnp.float64)
    assert float(num.safe_log(x, floor=0.5)[1]) == np.log(0.5)
    assert num.norm(jnp.asarray([jnp.inf, 0, 0])) == jnp.inf


def test_gradient_of_norm_is_the_unit_vector():
    v = jnp.asarray([3.0, -4.0, 12.0])
    np.testing.assert_allclose(jax.grad(num.norm)(v), np.asarray(v) / 13, rtol=1e-15)


@both_precisions
def test_the_cross_product_of_nearly_parallel_vectors_keeps_its_digits(dtype):
    """The reference uses rational numbers. For vectors within a thousandth of parallel the plain
    formula loses three digits."""
    rng = np.random.default_rng(3)
    u = rng.normal(size=(200, 3)).astype(dtype)
    v = (1.25 * u + 1e-3 * rng.normal(size=(200, 3)).astype(dtype)).astype(dtype)
    found = np.asarray(as_array(jax.jit(num.exact_cross)(jnp.asarray(u), jnp.asarray(v))))
    for a, b, n in zip(u.tolist(), v.tolist(), found.tolist(), strict=True):
        a, b, n = ([Fraction(x) for x in row] for row in (a, b, n))
        true = [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]
        error = max(abs(x - y) for x, y in zip(n, true, strict=True))
        assert error <= 2 * float(jnp.finfo(dtype).eps) * max(abs(x) for x in true)


@both_precisions
def test_log1p_in_ulps(dtype):
    """The reference is mpmath. Between -0.414 and -0.29, XLA's function is wrong by up to 128 ULP
    in float64."""
    x = np.concatenate(
        [
            np.linspace(-0.45, -0.2, 400),
            np.linspace(-0.99, 3, 200),
            RNG.choice([-1, 1], 100) * np.geomspace(1e-30, 0.1, 100),
            [-0.41420596889248495, -0.3905364989720889, 1e30],
        ]
    ).astype(dtype)
    got = jax.jit(num.log1p)(jnp.asarray(x))
    assert got.dtype == dtype
    assert max(exact.ulps(y, mp.log1p(mp.mpf(float(v)))) for v, y in zip(x, got, strict=True)) < 2.5
    edges = num.log1p(jnp.asarray([-2.0, -1.0, -0.0, np.inf, np.nan], dtype))
    np.testing.assert_array_equal(edges, [np.nan, -np.inf, 0, np.inf, np.nan])
    slopes = jax.vmap(jax.grad(num.log1p))(jnp.asarray([-0.75, -0.25, 0.0, 3.0], dtype))
    np.testing.assert_allclose(slopes, [4, 4 / 3, 1, 0.25], rtol=1e-6)


def test_running_sums_never_decrease_and_are_constant_over_zeros():
    """The sum is over 300,000 weights in float32, half of them 0. `jnp.cumsum` decreases at some of
    them."""
    rng = np.random.default_rng(0)
    weights = jnp.asarray(
        rng.uniform(size=300_000) * (rng.uniform(size=300_000) < 0.5), jnp.float32
    )
    total = np.asarray(num.running_sum(weights))
    rises = np.diff(total, prepend=np.float32(0))
    assert (rises >= 0).all()
    assert (rises[np.asarray(weights) == 0] == 0).all()
    np.testing.assert_allclose(total, np.cumsum(np.asarray(weights, float)), rtol=1e-5, atol=1e-3)
    places = jnp.asarray(np.append(rng.uniform(size=20_000), 1 - 2.0**-24), jnp.float32)
    chosen = jax.vmap(lambda u: _pick(weights.at[-5:].set(0), u)[0])(places)
    assert (weights.at[-5:].set(0)[chosen] > 0).all()


@pytest.mark.slow
def test_no_small_number_of_half_precision_is_taken_for_zero():
    """Of a divisor in float16 down to 6e-5: layers of alpha .05, dark xyY, a focal length."""
    half = partial(jnp.asarray, dtype=jnp.float16)
    colour = jv.matting.compositing.unpremultiply(half([[0.02, 0.01, 0.0, 0.05]]))
    np.testing.assert_allclose(colour, [[0.4, 0.2, 0]], rtol=2e-3)
    xyz = jv.colour_spaces.xyy_to_xyz(half([0.3, 0.05, 0.2]))
    np.testing.assert_allclose(xyz, [1.2, 0.2, 2.6], rtol=2e-3)
    assert jv.optics.image_vergence(half(2.0), half(0.05)) == pytest.approx(19.5, rel=2e-3)
    with jax.numpy_dtype_promotion("standard"):  # the coefficients are in float32
        bent = jv.optics.undistort(jv.Distortion([-0.1]), half(0.4875), half(0.0))
    np.testing.assert_allclose(bent, [0.5, 0], atol=1e-3)
