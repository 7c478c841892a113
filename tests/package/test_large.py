"""Tests sums over a hundred million pixels, ten million observations, a million patches and a
million steps of a chain: they equal the same sums in float64 up to rounding. Each test takes
minutes and up to 7 GB."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from scipy.signal import lfilter

import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, fit
from fitting.inference.convergence import autocorrelation_times, effective_draws, split_r_hat
from jaxvision import development, filters, histogram, point_ops
from jaxvision.scene import Quad
from jaxvision.transport.radiosity import closure_error, form_factor_table, plan_patches

pytestmark = pytest.mark.slow

SIDE = 10_000  # pixels
MANY = 10_000_000  # observations
EPS32 = 2.0**-23


@pytest.fixture(scope="module")
def picture():
    """Return a picture as dark as photographs, with 12 % in the first of 256 bins."""
    return np.random.default_rng(1).beta(0.5, 3, (SIDE, SIDE)).astype(np.float32)


@pytest.fixture(scope="module")
def codes(picture):
    return (picture * 255).astype(np.uint8)


def test_counts_are_exact(picture):
    found = histogram.exact_histogram(picture, bins=256, value_range=(0.0, 1.0))
    expected = np.histogram(picture, 256, (0, 1))[0]
    np.testing.assert_array_equal(np.asarray(found.counts).ravel(), expected)


def test_soft_counts_equal_a_count_pixel_by_pixel(picture):
    """The reference weights triangles between the centres of bins, in float64."""
    bins = 64
    found = np.asarray(histogram.soft_histogram(picture, bins=bins).counts, np.float64).ravel()
    place = np.clip(picture.ravel().astype(np.float64) * bins - 0.5, 0, bins - 1)
    left = np.minimum(place.astype(int), bins - 2)
    share = place - left
    expected = np.bincount(left, 1 - share, bins) + np.bincount(left + 1, share, bins)
    np.testing.assert_allclose(found, expected, rtol=4 * EPS32)


def test_quantiles_lie_within_their_bin(picture):
    shares = np.array([0.001, 0.3, 0.5, 0.999])
    counts = histogram.exact_histogram(picture, bins=4096)
    found = [float(histogram.quantile(counts, share)) for share in shares]
    np.testing.assert_allclose(found, np.quantile(picture, shares), atol=1 / 4096)


def test_codes_are_equalised_by_their_counts(codes):
    found = np.asarray(histogram.equalise(codes))
    counts = np.bincount(codes.ravel(), minlength=256)
    up_to, first = np.cumsum(counts), counts[counts > 0][0]
    table = np.round((up_to - first) / (codes.size - first) * 255).astype(np.uint8)
    np.testing.assert_array_equal(found, table[codes])


def test_windows_of_an_integral_image_are_accurate(picture):
    """The windows are at the far corner, where the sum is over 1e8 pixels."""
    sums = jax.jit(lambda x: filters.window_sum(filters.integral_image(x), (5, 7))[-9:, -9:])
    expected = ndimage.uniform_filter(picture[-99:, -99:].astype(np.float64), (5, 7)) * 35
    np.testing.assert_allclose(sums(picture), expected[-11:-2, -12:-3], rtol=8 * EPS32)


def test_a_blur_is_the_same_far_from_the_first_pixel(picture):
    found = np.asarray(filters.gaussian(picture, 3.0))
    for at in (slice(0, 80), slice(SIDE // 2, SIDE // 2 + 80), slice(SIDE - 80, SIDE)):
        few = np.asarray(filters.gaussian(picture[at, at], 3.0))
        np.testing.assert_allclose(found[at, at][30:50, 30:50], few[30:50, 30:50], rtol=2 * EPS32)


def test_means_of_all_pixels_equal_float64(picture):
    colour = np.stack([picture, 0.5 * picture, picture**2], axis=-1)
    gains = np.asarray(development.grey_world_gains(colour), np.float64)
    means = colour.reshape(-1, 3).mean(axis=0, dtype=np.float64)
    np.testing.assert_allclose(gains[0] / gains, means / means[0], rtol=8 * EPS32)
    lit = picture + np.float32(0.01)
    found = np.asarray(point_ops.scaled_to_key(lit))[-1, -1]
    middle = np.exp(np.log(lit, dtype=np.float64).mean())
    np.testing.assert_allclose(found, 0.18 * lit[-1, -1] / middle, rtol=16 * EPS32)


def test_a_mosaic_is_demosaiced_like_its_parts(picture):
    found = development.demosaic(picture, "RGGB")
    for at in (slice(0, 80), slice(SIDE - 80, SIDE)):
        few = development.demosaic(picture[at, at], "RGGB")
        np.testing.assert_array_equal(found[at, at][30:50, 30:50], few[30:50, 30:50])


def test_a_frame_has_the_mean_and_the_variance_of_its_charge():
    """The electrons are Poisson with Gaussian read noise, in digital numbers, compared within 5
    standard errors."""
    sensor = jv.Sensor(
        quantum_efficiency=0.5,
        shot_noise=jv.PoissonShotNoise(),
        read_noise=4.0,
        gain=0.25,
        offset=60.0,
        bits=12,
    )
    photons = jnp.full((SIDE, SIDE, 1), 1600.0, jnp.float32)
    sensor = jv.as_dtype(sensor, jnp.float32)
    raw = np.asarray(jax.jit(jv.raw_image)(jax.random.key(3), sensor, photons))
    mean = 60 + 0.25 * 800
    variance = 0.25**2 * (800 + 4.0**2) + 1 / 12
    found = raw.mean(dtype=np.float64), raw.var(dtype=np.float64)
    assert abs(found[0] - mean) < 5 * np.sqrt(variance) / SIDE
    # The error of a variance is sqrt(2) of itself over the root of the count, plus the Poisson's
    # fourth moment.
    assert abs(found[1] - variance) < 5 * np.sqrt(2.01) * variance / SIDE


def test_a_fit_of_all_observations_equals_weighted_least_squares():
    """The reference is NumPy's closed form in float64, from all observations at once."""
    time = np.linspace(0.0, 3.0, MANY)
    values = 1 - 0.2 * time + 0.02 * np.random.default_rng(5).standard_normal(MANY)
    found = fit(
        Problem(
            {"base": Parameter(start=0.0), "slope": Parameter(start=0.0)},
            lambda base, slope, inputs: base + slope * inputs,
            Gaussian(0.02),
            values,
            inputs=time,
        ),
        starts=1,
    )
    design = np.stack([np.ones(MANY), time], axis=1)
    normal = design.T @ design
    best = np.linalg.solve(normal, design.T @ values)
    errors = 0.02 * np.sqrt(np.diag(np.linalg.inv(normal)))
    for one, value, error in zip(found.estimates, best, errors, strict=True):
        assert abs(one.value - value) < 0.02 * error
        np.testing.assert_allclose(one.standard_error, error, rtol=1e-4)
    assert found.converged


def test_rows_of_a_million_patches_sum_to_one():
    """In a cube seen from inside, all light that leaves an element arrives."""
    axes, grey, walls = np.eye(3), jv.Lambert([0.5 / np.pi]), []
    for k in range(3):
        u, v = axes[(k + 1) % 3], axes[(k + 2) % 3]
        walls += [Quad(np.zeros(3), u, v), Quad(axes[k], v, u)]
    scene = jv.Scene([jv.Surface(wall, grey) for wall in walls], [])
    plan = plan_patches(scene, size=1 / 408, split=1)
    elements = jnp.array([0, 1234, 83_000, 499_500, 998_000])
    table = form_factor_table(scene, plan, elements=elements)
    assert table.shape == (5, 6 * 408**2)
    assert np.abs(closure_error(table)).max() < 1e-4
    np.testing.assert_allclose(
        closure_error(table), np.asarray(table, np.float64).sum(axis=1) - 1, atol=4 * EPS32
    )


def test_autocorrelation_times_of_a_million_steps():
    """The walkers have a known memory, x' = r x + noise, where tau = (1 + r) / (1 - r)."""
    steps, walkers, kept = 1_000_000, 8, 0.9
    noise = np.random.default_rng(7).standard_normal((steps, walkers))
    chain = lfilter([np.sqrt(1 - kept**2)], [1, -kept], noise, axis=0)
    tau = (1 + kept) / (1 - kept)
    np.testing.assert_allclose(autocorrelation_times(chain[..., None]), tau, rtol=0.02)
    np.testing.assert_allclose(effective_draws(chain.T), steps * walkers / tau, rtol=0.02)
    assert split_r_hat(chain.T) < 1.0002
