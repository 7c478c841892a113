"""Tests the counter-based random numbers: uniform, independent along every index, and
reproducible."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxvision.core._random import Stream, lattice_point, seed_of, uniforms

SEED = seed_of(jax.random.key(11))


def numbers(pixels, samples, blocks, *, seed=SEED, dtype=jnp.float32):
    """Return the numbers, (pixels, samples, 4 blocks)."""

    def block(p, s, b):
        return uniforms(Stream(p, s, seed), b, dtype)

    over = jax.vmap(jax.vmap(jax.vmap(block, (None, None, 0)), (None, 0, None)), (0, None, None))
    made = jax.jit(over)(*(jnp.asarray(i, jnp.uint32) for i in (pixels, samples, blocks)))
    return np.asarray(made).reshape(len(pixels), len(samples), -1)


@pytest.fixture(scope="module")
def drawn():
    return numbers(np.arange(512), np.arange(64), np.arange(4))  # 2^19 numbers


@pytest.mark.slow
def test_uniform(drawn):
    """All numbers pass the Kolmogorov-Smirnov test, and 256 bins of each dimension for five seeds
    the chi-square test. Its 80 levels must be uniform themselves, so one of 1e-3 is to be
    expected."""
    assert stats.kstest(drawn.ravel(), "uniform").pvalue > 1e-3
    assert drawn.min() >= 0
    assert drawn.max() < 1
    levels = []
    for key in range(5):
        made = numbers(
            np.arange(512), np.arange(64), np.arange(4), seed=seed_of(jax.random.key(key))
        )
        for dimension in np.moveaxis(made, -1, 0):
            counts = np.bincount((dimension.ravel() * 256).astype(int), minlength=256)
            levels.append(stats.chisquare(counts).pvalue)
    assert stats.kstest(levels, "uniform").pvalue > 1e-3
    assert min(levels) > 1e-5


def test_low_bits_are_uniform(drawn):
    """The last 8 of 24 bits are tested."""
    low = (drawn.ravel() * 2**24).astype(int) % 256
    assert stats.chisquare(np.bincount(low, minlength=256)).pvalue > 1e-4


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("lag", [1, 2, 3, 7])
def test_neighbouring_pixels_samples_and_dimensions_are_independent(drawn, axis, lag):
    """Correlations are within 4 sigma of 0, and pairs are uniform over a 16 x 16 grid, without
    planes or stripes."""
    a = np.take(drawn, range(drawn.shape[axis] - lag), axis).ravel()
    b = np.take(drawn, range(lag, drawn.shape[axis]), axis).ravel()
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(a.size)
    cell = (a * 16).astype(int) * 16 + (b * 16).astype(int)
    assert stats.chisquare(np.bincount(cell, minlength=256)).pvalue > 1e-4


def test_far_apart_indices_and_other_seeds_share_nothing(drawn):
    far = numbers(np.arange(2**31, 2**31 + 64), np.arange(2**20, 2**20 + 64), [0, 900])
    other = numbers(np.arange(64), np.arange(64), [0, 1], seed=seed_of(jax.random.key(12)))
    near = drawn[:64, :, :8]
    for made in (far, other):
        assert abs(np.corrcoef(made.ravel(), near.ravel())[0, 1]) < 4 / np.sqrt(near.size)
        assert stats.kstest(made.ravel(), "uniform").pvalue > 1e-3


def test_mean_of_a_pixel_falls_as_for_independent_samples(drawn):
    """The variance of means over n samples is 1 / (12 n), on which the stated errors of pictures
    are based."""
    means = drawn.mean(axis=1)
    expected = 1 / 12 / drawn.shape[1]
    assert abs(means.var() / expected - 1) < 4 * np.sqrt(2 / means.size)


def test_double_precision_has_finer_steps_of_the_same_numbers(drawn):
    wide = numbers(np.arange(32), np.arange(4), [0], dtype=jnp.float64)
    assert wide.dtype == np.float64
    np.testing.assert_array_equal(np.floor(wide * 2**24) / 2**24, drawn[:32, :4, :4])
    assert np.any(wide * 2**24 % 1 != 0)
    assert np.all(wide * 2**32 % 1 == 0)


def test_known_value():
    """pcg4d of (1, 2, 3, 4) without a seed, computed with Python's integers."""
    mask, v = 2**32 - 1, [1, 2, 3, 4]
    v = [(x * 1664525 + 1013904223) & mask for x in v]
    for turn in range(2):
        x, y, z, w = v
        x = (x + y * w) & mask
        y = (y + z * x) & mask
        z = (z + x * y) & mask
        w = (w + y * z) & mask
        v = [x, y, z, w] if turn else [a ^ (a >> 16) for a in (x, y, z, w)]
    stream = Stream(jnp.uint32(1), jnp.uint32(2), jnp.asarray([0, 4], jnp.uint32))
    np.testing.assert_array_equal(uniforms(stream, 3, jnp.float64), np.array(v) / 2**32)


def places(pixels, samples, dimensions, dtype=jnp.float64):
    """Return the lattice points, (pixels, samples, dimensions), with one lattice for each pixel."""
    place = lambda p, s: lattice_point(Stream(p, s, SEED), dimensions, dtype)  # noqa: E731
    over = jax.jit(jax.vmap(jax.vmap(place, (None, 0)), (0, None)))
    return np.asarray(over(*(jnp.arange(n, dtype=jnp.uint32) for n in (pixels, samples))))


@pytest.mark.parametrize(("dimensions", "root"), [(2, 1.32471795724), (4, 1.16730397826)])
def test_samples_of_a_pixel_are_a_kronecker_sequence_with_a_shift_of_its_own(dimensions, root):
    """The steps are powers of the roots of x^3 = x + 1 and x^5 = x + 1, as given by Roberts."""
    made = places(512, 64, dimensions)
    steps = (made[:, 1:] - made[:, :-1]) % 1
    expected = np.broadcast_to(root ** -np.arange(1.0, dimensions + 1), steps.shape)
    np.testing.assert_allclose(steps, expected, rtol=1e-8)
    assert stats.kstest(made[:, 0].ravel(), "uniform").pvalue > 1e-3
    a, b = made[:-1, 0].ravel(), made[1:, 0].ravel()
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(a.size)


def test_a_lattice_covers_a_pixel_more_evenly_than_independent_numbers():
    """64 samples estimate the part of a pixel left of and above a corner."""
    made, corner = places(512, 64, 2), np.array([0.4, 0.7])
    covered = (made < corner).all(axis=-1).mean(axis=1)
    p = corner.prod()
    assert abs(covered.mean() - p) < 4 * np.sqrt(p * (1 - p) / 64 / 512)
    assert covered.var() < 0.2 * p * (1 - p) / 64


def test_a_pixel_of_one_ray_has_no_numbers():
    with pytest.raises(ValueError, match="give it samples"):
        lattice_point(Stream(jnp.uint32(1), None, None), 2, jnp.float32)
