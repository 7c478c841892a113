"""Tests resolution from an edge, against pictures averaged over 16 x 16 positions in each pixel."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from scipy.stats import chi2, norm

import jaxvision as jv
from fitting import resolution
from fitting.resolution import Blur
from fitting.resolution.edge import _free_transfer
from fitting.resolution.model import edge_spread, edge_transfer
from fitting.resolution.pixels import select_band
from jaxvision.errors import InputError

NODES = (np.arange(16) + 0.5) / 16 - 0.5
ANGLES = 2 * np.pi * (np.arange(40) + 0.5) / 40
RADII = np.sqrt((np.arange(20) + 0.5) / 20) / 2  # for a disc of diameter 1


def spread(distance, angle, gaussian, disc=0.0):
    """Return the share of light of a pixel at a distance from a sharp edge, by brute force."""
    turn = np.radians(angle)
    x, y = np.meshgrid(NODES, NODES)
    shifts = (np.cos(turn) * x + np.sin(turn) * y).ravel()
    if disc:
        shifts = (shifts[:, None] + disc * np.outer(RADII, np.cos(ANGLES)).ravel()).ravel()
    return norm.cdf((np.asarray(distance)[..., None] + shifts) / gaussian).mean(-1)


def places(shape, angle, place):
    y, x = np.indices(shape) - (np.array(shape)[:, None, None] - 1) / 2
    return np.cos(np.radians(angle)) * x + np.sin(np.radians(angle)) * y - place


def expected(shape, angle, place, gaussian, low=100.0, high=1000.0):
    distance = places(shape, angle, place)
    fine = np.linspace(distance.min(), distance.max(), 4000)
    return low + (high - low) * np.interp(distance, fine, spread(fine, angle, gaussian))


def noisy(mean, rng, gain=0.25, read=5.0):
    return np.round(mean + rng.normal(size=mean.shape) * np.sqrt(read**2 + gain * mean))


@pytest.mark.sweep
@pytest.mark.parametrize("angle", [5.0, 38.0, 180.0])
@pytest.mark.parametrize(("shape", "blur"), [("gaussian", 0.4), ("disc", 2.5)])
def test_edge_spread_equals_light_averaged_over_pixels(angle, shape, blur):
    distance = np.linspace(-4, 4, 41)
    gaussian, disc = (blur, 0.0) if shape == "gaussian" else (1e-3, blur)
    with jax.enable_x64(True):
        at = {"angle": angle, "blur": blur}
        found = edge_spread(jnp.asarray(distance), at, Blur(shape, None), 20.0)
    assert np.allclose(found, spread(distance, angle, gaussian, disc), atol=2e-3)


@pytest.mark.sweep
@pytest.mark.parametrize(("shape", "blur"), [("gaussian", 0.7), ("disc", 2.0)])
def test_transfer_is_the_transform_of_the_line_spread(shape, blur):
    at, frequency = {"angle": 10.0, "blur": blur}, np.array([0.1, 0.3, 0.6])
    with jax.enable_x64(True):
        place = jnp.linspace(-8, 8, 3201)
        edge = np.asarray(edge_spread(place, at, Blur(shape, None), 20.0))
        found = edge_transfer(jnp.asarray(frequency), at, Blur(shape, None))
    wave = np.cos(2 * np.pi * np.outer(frequency, np.asarray(place)))
    assert np.allclose(found, wave @ np.gradient(edge), atol=1e-4)


@pytest.mark.slow
def test_diffraction_blurs_by_an_airy_pattern():
    """The reference sums `optics.airy_kernel` in fifths of a pixel over pixels."""
    with jax.enable_x64(True):  # wavelength times f-number: 1.5 pixels
        kernel = np.asarray(jv.optics.airy_kernel(1.5e-6, 1.0, 0.2e-6, size=401, order=4))
        place = (np.arange(401) - 200 + 0.5) / 5
        wanted = np.convolve(kernel.sum(0), np.full(5, 0.2), "same").cumsum()
        at = {"angle": 0.0, "blur": 0.0}
        found = edge_spread(jnp.asarray(place), at, Blur("gaussian", 1.5), 100.0)
    assert np.abs(np.asarray(found) - wanted)[np.abs(place) < 5].max() < 4e-3


@pytest.mark.slow
def test_the_free_transfer_is_unbiased_below_the_noise():
    rng, reach = np.random.default_rng(3), 10.0
    distance = rng.uniform(-reach, reach, 900)
    sd, truth = np.full(900, 2.0), 0.4
    order = np.arange(1, 40, 2)
    signal = 2 / (np.pi * order[3]) * truth * np.sin(2 * np.pi * distance * order[3] / (4 * reach))
    found = []
    for _ in range(200):
        made = _free_transfer(distance, signal + sd * rng.normal(size=900), sd, reach, None)
        found.append(made[0][1])
    error = np.sqrt(np.diag(made[1]) / 200)
    wanted = np.where(order == order[3], truth, 0)[: len(found[0])]
    z = (np.mean(found, 0) - wanted) / error
    assert error.max() > 0.005
    assert np.abs(z).max() < 4


EDGE = noisy(expected((40, 40), 5, 0, 0.5), np.random.default_rng(1))


@pytest.mark.parametrize(
    ("image", "options", "words"),
    [
        (np.ones((4, 40)), {}, "at least 8 x 8"),
        (np.full((40, 40), np.nan), {}, "no pixel"),
        (np.random.default_rng(0).normal(100, 5, (40, 40)), {}, "edge"),
        (np.minimum(EDGE, 1000), {}, "clipped"),
        (expected((40, 12), 5, 0, 0.5) + 0.01 * np.arange(12), {}, "beside the edge"),
        (np.ones((40, 40, 3)), {}, "band is None"),
        (np.ones((40, 40)), {"diffraction": -1.0}, "diffraction is -1"),
        (np.ones((40, 40)), {"reach": 2}, "reach is 2"),
        (EDGE, {"shape": "square"}, "shape is"),
    ],
)
def test_unmeasurable_edges_are_refused(image, options, words):
    with pytest.raises(jv.errors.InputError, match=words):
        resolution.from_edge(image, **options)


@pytest.mark.slow
def test_intervals_cover_the_true_values():
    """Over forty edges at random angles, the widths' z and the chi-square of the transfer function
    are right."""
    rng, z, free = np.random.default_rng(4), [], []
    for _ in range(40):
        angle, gaussian = rng.uniform(0, 360), rng.uniform(0.4, 1.2)
        mean = expected((48, 48), angle, rng.uniform(-1, 1), gaussian)
        found = resolution.from_edge(noisy(mean, rng))
        (width,) = (e for e in found.estimates if e.name == "blur")
        z.append((width.value - gaussian) / width.standard_error)
        turn = np.radians(angle)
        f = found.frequency
        truth = np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))
        missed = found.otf - truth * np.exp(-2 * (np.pi * gaussian * f) ** 2)
        free.append(chi2.sf(missed @ np.linalg.pinv(found.otf_covariance) @ missed, f.size))
    assert np.mean(np.abs(z) < 1.96) > 0.84
    assert abs(np.mean(z)) < 4 / np.sqrt(40)
    assert np.mean(np.array(free) < 0.05) < 0.16


def test_unequal_amplifiers_are_brought_to_one_scale():
    """Even and odd columns, and the sites of a mosaic that the taps name, by NumPy."""
    light = np.random.default_rng(3).uniform(100, 900, (24, 24))
    column = np.indices(light.shape)[1]
    taps = jv.Taps(((0, 1),), gain=[0.9, 1.1], offset=[-2.0, 3.0])
    raw = 64 + np.array([-2.0, 3.0])[column % 2] + np.array([0.9, 1.1])[column % 2] * light
    for image in (raw, raw[..., None]):
        found = select_band(image, jv.Sensor(offset=64.0, taps=taps), None)
        np.testing.assert_allclose(found, 64 + light, rtol=1e-6)
    taps = jv.Taps(((0, 1),), gain=[0.9, 1.1], offset=[-2.0, 3.0], names=("red", "blue"))
    found = select_band(raw, jv.Sensor(offset=64.0, taps=taps), 2)
    assert np.isnan(found[:, ::2]).all()
    np.testing.assert_allclose(found[:, 1::2], 64 + 1.1 * light[:, 1::2], rtol=1e-6)


@pytest.mark.slow
def test_a_plane_of_a_mosaic_needs_no_demosaicing():
    rng = np.random.default_rng(5)
    sensor = jv.Sensor(colour_filter=jv.ColourFilter(np.eye(3), pattern="RGGB"), bits=12)
    mean = expected((64, 64), 7.0, 0.4, 0.6)
    mean[::2, ::2] = expected((64, 64), 7.0, 0.4, 1.4)[::2, ::2]  # red is less sharp
    raw = noisy(mean, rng)
    for band, truth in ((0, 1.4), (1, 0.6)):
        found = resolution.from_edge(raw, sensor=sensor, band=band)
        (width,) = (e for e in found.estimates if e.name == "blur")
        assert abs(width.value - truth) < 4 * width.standard_error
        assert width.standard_error < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_an_edge_that_overshoots_is_called_sharpened(share):
    """Overshoot is also found if the MTF stays below 1, as for an unsharp mask of .6."""
    raw = noisy(expected((64, 64), 5.0, 0.0, 0.7), np.random.default_rng(8))
    sharp = raw + share * (raw - ndimage.gaussian_filter(raw, 1.0))
    told = " ".join(resolution.from_edge(sharp).findings)
    assert ("overshoots a level by" in told) == (share > 0)


@pytest.mark.slow
def test_sharpening_smoothing_and_the_psf_are_reported():
    rng = np.random.default_rng(6)
    mean = expected((64, 64), 5.0, 0.0, 0.7)
    found = resolution.from_edge(noisy(mean, rng))
    psf = found.psf(9)
    assert psf.sum() == pytest.approx(1)
    assert psf[4, 4] == pytest.approx((2 * norm.cdf(0.5 / 0.7) - 1) ** 2, abs=0.04)
    assert str(found)
    raw = noisy(mean, rng)
    sharp = raw + 1.5 * (raw - ndimage.gaussian_filter(raw, 1.0))
    told = " ".join(resolution.from_edge(sharp).findings)
    assert "sharpened" in told
    assert "errors of neighbouring pixels are correlated" in told


@pytest.mark.slow
def test_a_synthetic_edge_of_8_bits_without_noise_is_measured():
    """The edge is a Gaussian of full width 2.101 pixels at 16.78 degrees."""
    mean = expected((100, 100), 16.78, 0.2, 2.101 / 2.35482, low=51.0, high=204.0)
    found = resolution.from_edge(np.round(mean))
    angle, width = found.fit.values["angle"], found.fit.values["blur"]
    assert angle == pytest.approx(16.78, abs=0.005)
    assert 2.35482 * width == pytest.approx(2.101, abs=0.003)
    low, high = next(one for one in found.estimates if one.name == "blur").interval_95
    assert low <= 2.101 / 2.35482 <= high
    assert "highest value, 204" in " ".join(found.findings)


@pytest.mark.slow
def test_pictures_without_a_linear_edge_are_named():
    """Earlier, a mosaic without its sensor was taken for a compressed picture."""
    mean = expected((48, 48), 5.0, 0.3, 0.8)
    rng = np.random.default_rng(2)
    tiles = np.tile([[0.55, 1.0], [1.0, 0.4]], (24, 24))
    with pytest.raises(InputError, match=r"sites of a 2 x 2 mosaic differ by \d+%; give one band"):
        resolution.from_edge(noisy(mean * tiles, rng))
    linear = noisy(mean, rng) / 1100
    encoded = np.round(255 * np.asarray(jv.srgb_encode(jnp.asarray(np.clip(linear, 0, 1)))))
    told = str(resolution.from_edge(encoded))
    assert "Decode sRGB or another gamma" in told
    assert "start" not in told


def encoded_edge(gamma, seed, *, low=100.0, size=64, noise=(4.0, 0.02)):
    """Return 12-bit numbers with a gamma, of a linear camera's edge with blur .7."""
    mean = expected((size, size), 5.0, 0.3, 0.7, low=low)
    linear = mean + np.random.default_rng(seed).normal(size=mean.shape) * np.sqrt(
        noise[0] + noise[1] * mean
    )
    return np.round(4095 * (linear / 1100) ** (1 / gamma))


@pytest.mark.slow
def test_a_gamma_is_estimated_from_the_shape_of_the_edge():
    """Power and blur are within their stated errors."""
    told = str(resolution.from_edge(encoded_edge(1.4, 0)))
    power, error, width, wide = map(
        float, re.search(r"power of (\S+) ± (\S+), .* blur is (\S+) ± (\S+) pix", told).groups()
    )
    assert abs(power - 1 / 1.4) < 3 * error < 0.3
    assert abs(width - 0.7) < 3 * wide < 0.05


def test_linear_numbers_have_no_gamma():
    for sensor in (None, jv.Sensor(bits=12)):
        told = str(resolution.from_edge(encoded_edge(1.0, 1), sensor=sensor))
        assert "not symmetric" not in told
        assert "bright side has" not in told
        assert ("taken as linear" in told) == (sensor is None)


@pytest.mark.slow
def test_gammas_of_edges_are_within_their_errors():
    """Power and blur of encoded edges are right. Linear edges, also with another blur or uneven,
    have no gamma."""
    powers = []
    for seed in range(12):
        for gamma in (1.0, 1.2, 2.2):
            image = encoded_edge(gamma, seed, low=(100.0, 300.0)[seed % 2])
            told = str(resolution.from_edge(image))
            seen = re.search(r"power of (\S+) ± (\S+),", told)
            if seen is not None:
                power, error = map(float, seen.groups())
                powers.append((power - 1 / gamma) / error)
            assert gamma < 2 or "not symmetric" in told or "bright side has" in told
            assert gamma > 1 or seen is None
            assert seen or "gamma of up to" in told or gamma == 1.0
    assert np.abs(powers).max() < 4
