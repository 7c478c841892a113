"""Tests Porter and Duff's algebra against pictures of actual coverage, and its laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import loops

from jaxvision.matting import compositing as c

RNG = np.random.default_rng(6)


def layer(*shape):
    alpha = RNG.uniform(size=(*shape, 1))
    return jnp.asarray(np.concatenate([RNG.uniform(size=(*shape, 3)) * alpha, alpha], axis=-1))


A, B, C = layer(4, 5), layer(4, 5), layer(4, 5)

# The picture in each of four regions (neither, only A, only B, both), from the paper's table 1.
PICTURES = {
    "clear": "0000",
    "front": "0A0A",
    "back": "00BB",
    "over": "0ABA",
    "back over": "0ABB",
    "in": "000A",
    "back in": "000B",
    "out": "0A00",
    "back out": "00B0",
    "atop": "00BA",
    "back atop": "0A0B",
    "xor": "0AB0",
}


@pytest.mark.parametrize("operator", PICTURES)
def test_operators_equal_uncorrelated_coverage(operator):
    """A pixel consists of four regions of area (1-a)(1-b), a(1-b), (1-a)b and ab, each with one
    colour."""
    found = np.asarray(c.composite(A, B, operator=operator))
    for i, j in np.ndindex(4, 5):
        a, b = float(A[i, j, 3]), float(B[i, j, 3])
        areas = [(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b]
        straight = {"0": np.zeros(4), "A": A[i, j] / a, "B": B[i, j] / b}
        expected = sum(
            area * np.asarray(straight[shown])
            for area, shown in zip(areas, PICTURES[operator], strict=True)
        )
        np.testing.assert_allclose(found[i, j], expected, rtol=1e-12, atol=1e-15)


def test_plus_dissolves_one_picture_into_the_other():
    mixed = c.composite(
        c.dissolve(A, jnp.asarray(0.3)), c.dissolve(B, jnp.asarray(0.7)), operator="plus"
    )
    np.testing.assert_allclose(mixed, 0.3 * np.asarray(A) + 0.7 * np.asarray(B), rtol=1e-14)


def test_over_is_associative_and_not_commutative():
    left, right = c.over(c.over(A, B), C), c.over(A, c.over(B, C))
    np.testing.assert_allclose(left, right, rtol=1e-13)
    assert np.abs(c.over(A, B) - c.over(B, A)).max() > 0.1


def test_layers_are_composited_from_the_back():
    stack = jnp.stack([A, B, C])
    np.testing.assert_allclose(c.flatten(stack), c.over(A, c.over(B, C)), rtol=1e-14)
    np.testing.assert_array_equal(c.flatten(stack[:1]), A)


def test_empty_and_full_coverage():
    nothing, opaque = jnp.zeros_like(A), c.premultiply(A[..., :3], jnp.ones((4, 5, 1)))
    np.testing.assert_array_equal(c.over(nothing, A), A)
    np.testing.assert_array_equal(c.over(A, nothing), A)
    np.testing.assert_array_equal(c.over(opaque, A), opaque)


def test_an_error_of_the_coverage_moves_the_composite():
    """The errors agree with draws of the coverage; that of a hidden pixel is exact."""
    own, behind, sd = np.asarray(A), np.asarray(B), RNG.uniform(0.01, 0.1, (4, 5, 1))
    made, found = c.over(A, B, alpha_sd=sd)
    np.testing.assert_array_equal(made, c.over(A, B))
    alpha = own[..., 3:] + sd * np.random.default_rng(0).normal(size=(4000, 4, 5, 1))
    front = own / own[..., 3:] * alpha
    drawn = (front + (1 - alpha) * behind).std(axis=0)
    np.testing.assert_allclose(found, drawn, rtol=0.06)  # five standard errors
    hidden = c.over(jnp.array([0.5, 1.0]), jnp.array([0.2, 1.0]), alpha_sd=0.1 * jnp.ones(1))[1]
    np.testing.assert_allclose(hidden, [0.03, 0], rtol=1e-12)
    with pytest.raises(ValueError, match="alpha_sd"):
        c.over(A, B, alpha_sd=-sd)


def test_straight_and_premultiplied():
    straight = jnp.asarray(RNG.uniform(size=(4, 5, 3)))
    alpha = A[..., 3:]
    premultiplied = c.premultiply(straight, alpha)
    np.testing.assert_allclose(c.unpremultiply(premultiplied), straight, rtol=1e-14)
    np.testing.assert_array_equal(premultiplied[..., 3:], alpha)
    darker = c.darken(premultiplied, jnp.asarray(0.5))
    np.testing.assert_allclose(c.unpremultiply(darker), straight / 2, rtol=1e-14)
    np.testing.assert_array_equal(darker[..., 3:], alpha)


def test_files_are_composited_in_linear_light():
    """White at half coverage over black is half the light, code 188 and not 128."""
    linear, encoded = jax.jit(c.layer_from_srgb), jax.jit(c.layer_to_srgb)
    white, black = (linear(np.array(rgba)) for rgba in ([1.0, 1.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]))
    seen = np.asarray(encoded(jax.jit(c.over)(white, black)))
    np.testing.assert_allclose(seen[:3], loops.srgb_encode(0.5), rtol=1e-13)
    assert round(float(seen[0]) * 255) == 188
    rgba = RNG.uniform(0.05, 1, size=(3, 3, 4))
    np.testing.assert_allclose(encoded(linear(rgba)), rgba, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)])
def test_uncovered_pixels_have_no_colour_and_no_gradient(dtype):
    for light in (0.0, 0.3):
        empty = jnp.asarray([light, light, light, 0.0], dtype)
        value, slope = jax.value_and_grad(lambda x: c.layer_to_srgb(x).sum())(empty)
        assert value == 0
        assert value.dtype == dtype
        assert jnp.isfinite(slope).all()
    faint = jnp.asarray([1e-30, 1e-30, 1e-30, 1e-30], dtype)
    assert jnp.isfinite(jax.grad(lambda x: c.unpremultiply(x).sum())(faint)).all()


def test_alpha_outside_its_range_is_named_and_defined_under_a_trace():
    wrong = A.at[0, 0, 3].set(1.5).at[1, 1, 3].set(-0.1).at[2, 2, 3].set(jnp.nan)
    for call in (
        lambda: c.over(wrong, B),
        lambda: c.over(B, wrong),
        lambda: c.unpremultiply(wrong),
        lambda: c.premultiply(B[..., :3], wrong[..., 3:]),
    ):
        with pytest.raises(ValueError, match=r"alpha must lie in \[0, 1\]: 3 of 20 values do not"):
            call()
    traced = jax.jit(c.over)(wrong, B)
    np.testing.assert_allclose(traced[0, 0], wrong[0, 0] - 0.5 * B[0, 0], rtol=1e-14)
    assert jnp.isnan(jax.jit(c.unpremultiply)(wrong)[2, 2]).all()


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_rounding_is_not_an_invalid_alpha(dtype):
    """Blurred full coverage, a sum of rounded weights, is 1 within a few ULP, and is accepted."""
    eps = float(jnp.finfo(dtype).eps)
    nearly = jnp.asarray([1 + 4 * eps, 1 + 99 * eps, -99 * eps], dtype)[:, None]
    layer = jnp.concatenate([jnp.full((3, 1), 0.5, dtype), nearly], axis=-1)
    np.testing.assert_array_equal(c.over(layer, jnp.zeros_like(layer)), layer)
    with pytest.raises(ValueError, match="1 of 3 values do not"):
        c.checked_alpha(nearly.at[0].set(1 + 110 * eps))


def test_numbers_for_fractions():
    np.testing.assert_array_equal(c.dissolve(A, 0.3), c.dissolve(A, jnp.asarray(0.3)))
    np.testing.assert_array_equal(c.darken(A, 0.3), c.darken(A, jnp.asarray(0.3)))


def test_codes_and_mismatched_shapes_are_named(as_for_users):
    codes = jnp.full((4, 5, 4), 128, jnp.uint8)
    for call in (
        lambda: c.over(codes, A),
        lambda: c.over(A, codes),
        lambda: c.flatten(jnp.stack([codes, codes])),
        lambda: c.dissolve(codes, 0.5),
        lambda: c.darken(codes, 0.5),
        lambda: c.premultiply(codes[..., :3], A[..., 3:]),
        lambda: c.premultiply(A[..., :3], codes[..., 3:]),
        lambda: c.unpremultiply(codes),
        lambda: c.layer_from_srgb(codes),
        lambda: c.layer_to_srgb(codes),
    ):
        with pytest.raises(ValueError, match="floating and relative, got uint8; divide by 255"):
            call()
    with pytest.raises(ValueError, match=r"alpha must be \(..., 1\).*\(4, 5\) and \(4, 5, 3\)"):
        c.premultiply(A[..., :3], A[..., 3])
    with pytest.raises(ValueError, match=r"at least one layer, got shape \(0, 4, 5, 4\)"):
        c.flatten(jnp.zeros((0, 4, 5, 4)))


def test_bad_calls_are_named():
    with pytest.raises(ValueError, match=r"operator must be one of clear, front.*got 'under'"):
        c.composite(A, B, operator="under")
    with pytest.raises(ValueError, match=r"same channels.*\(4, 5, 4\) and \(4, 5, 3\)"):
        c.over(A, B[..., :3])
    with pytest.raises(ValueError, match="same channels"):
        c.over(A[..., :1], B[..., :1])


def soft_disc(colour, coverage_first):
    """Return a soft disc of one colour, (40, 40, 4), premultiplied or not."""
    row, column = np.mgrid[:40, :40] - 19.5
    alpha = np.clip((14 - np.hypot(row, column)) / 5, 0, 1)[..., None]
    light = np.broadcast_to(colour, (40, 40, 3)) * (alpha if coverage_first else 1)
    return np.concatenate([light, alpha], axis=-1)


def test_straight_colours_are_named_where_premultiplied_ones_are_needed():
    behind = np.concatenate([np.full((40, 40, 3), 0.3), np.ones((40, 40, 1))], axis=-1)
    with pytest.warns(UserWarning, match=r"front: light exceeds .* in 100% of the pixels"):
        c.over(soft_disc([0.8, 0.5, 0.2], False), behind)
    right = c.over(soft_disc([0.8, 0.5, 0.2], True), behind)  # must cause no warning
    alpha = soft_disc([0, 0, 0], True)[..., 3:]
    np.testing.assert_allclose(
        right[..., :3], alpha * [0.8, 0.5, 0.2] + (1 - alpha) * 0.3, rtol=1e-5
    )
    c.over(soft_disc([8.0, 5.0, 2.0], True), behind)  # light above 1 may exceed its coverage


def test_colours_multiplied_twice_are_named():
    with pytest.warns(UserWarning, match="No colour exceeds its coverage"):
        c.layer_from_srgb(np.round(255 * soft_disc([0.8, 0.5, 0.2], True)) / 255)
    for straight in ([0.8, 0.5, 0.2], [0.15, 0.1, 0.1], [0.0, 0.0, 0.0]):
        c.layer_from_srgb(np.round(255 * soft_disc(straight, False)) / 255)
