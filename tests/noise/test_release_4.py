"""Tests EMVA 1288, release 4.0, against simulated patterns, closed forms and the reference
implementation."""

from contextlib import nullcontext
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import convolve2d
from scipy.stats import norm

from fitting import folders
from fitting.checks.emva1288 import CASES, NAMES, places
from fitting.checks.simulations import simulated
from fitting.noise import Camera, Stacks, release_4_sheet, stacks_from_frames
from fitting.noise.emva1288 import statistics
from fitting.noise.levels import Levels, PhotonTransfer
from fitting.noise.release_4.average_frames import histogram, outliers, spectrogram
from fitting.noise.release_4.general import slopes
from fitting.noise.release_4.nonuniformity import high_pass, loss_of_filter, split
from fitting.noise.release_4.saturation import Numbers, ranges
from fitting.noise.release_4.section import LINEARITY, _deviation, sections
from fitting.noise.release_4.sheet import figures
from jaxvision.files.images import write_image

SHAPE = (30, 40)


def frames(level, count):
    """Return frames of integers from a hash of position, frame and level, equal on all machines."""
    f, m, n = np.meshgrid(np.arange(count), *map(np.arange, SHAPE), indexing="ij")

    def u(*terms):
        h = np.zeros(f.shape, np.uint64)
        for term in terms:
            h = (h ^ np.asarray(term, np.uint64)) * np.uint64(6364136223846793005)
            h += np.uint64(1442695040888963407)
            h ^= h >> np.uint64(33)
        return (h >> np.uint64(40)).astype(float) / 2**24 - 0.5

    signal = 45.0 * level * (1 + 0.05 * u(m, n, 1) + 0.04 * u(n, 2) + 0.03 * u(m, 3))
    offset = 30 + 6 * u(m, n, 4) + 5 * u(n, 5) + 4 * u(m, 6)
    noise = np.sqrt(12 * (9 + 0.4 * signal)) * u(f, m, n, level + 7)
    return np.clip(np.round(offset + signal + noise), 0, 1023)


# Results of emva1288 1.0.2 with NumPy 1.26.4 for these frames: 24 levels and a dark of two frames
# each, with nonuniformities at level 11.
REFERENCE = {
    "K": 0.38748799030887904,
    "R": 0.15005989010988996,
    "QE": 38.72633316719634,
    "sigma_y_dark": 3.0097756814715906,
    "sigma_d": 7.7315942508069,
    "u_p_min": 21.34827417426515,
    "u_p_sat": 6000.0,
    "u_e_sat": 2323.57999003178,
    "SNR_max": 48.20352673852589,
    "DR": 281.05316387742766,
    "LE": (-0.13884290894700058, 0.1049824346765305),
    "bright": (117.51243154017239, 18.334385926723485, 28.712989626835082, 70.46505598661383),
    "dark": (6.623143591882124, 1.4075157690085378, 1.728932194326198, 3.4866956285473893),
    "sigma_2_y_stack": (200.13125, 9.05875),
    "histogram": [1, 0, 1, 0, 4, 4, 3, 5, 16, 16, 23, 15],
    "first_class": -10.539583333333333,
    "power": [64.31670139, 12.26225683, 9.15403136, 7.7512334],
}


@pytest.fixture(scope="module")
def stacks():
    return stacks_from_frames(
        [list(frames(level, 2)) for level in range(1, 25)],
        [list(frames(0, 2))],
        [0.01] * 24,
        photons=[300.0 * level for level in range(1, 25)],
        camera=Camera(bits=10),
        dark_exposures=[0.01],
    )


def test_values_equal_the_reference_where_it_follows_the_standard(stacks):
    measurement = stacks.measurement
    within, clipped = ranges(measurement, None)  # the reference uses the saturation of release 3.1
    assert not clipped
    found = figures(statistics(measurement, within.saturation), measurement, within)
    same = {
        "K": "system_gain",
        "R": "responsivity",
        "QE": "quantum_efficiency",
        "sigma_y_dark": "temporal_dark_noise",
        "sigma_d": "read_noise",
        "u_p_sat": "saturation_photons",
        "u_e_sat": "saturation_electrons",
        "SNR_max": "snr_max",
    }
    for name, own in same.items():
        np.testing.assert_allclose(found[own], REFERENCE[name], rtol=1e-6, err_msg=name)
    # The reference's threshold lacks the 1/4 of (26).
    sigma = REFERENCE["sigma_y_dark"] / REFERENCE["K"]
    exact = (np.sqrt(sigma**2 + 0.25) + 0.5) / (sigma + 0.5) * REFERENCE["u_p_min"]
    np.testing.assert_allclose(found["threshold_photons"], exact, rtol=1e-6)
    np.testing.assert_allclose(
        found["dynamic_range"], REFERENCE["DR"] * REFERENCE["u_p_min"] / exact, rtol=1e-6
    )
    # The reference has the extremes of the deviations, not the mean of their absolute values (63).
    assert 0 < found["linearity_error"] < max(np.abs(REFERENCE["LE"]))


def test_spatial_variances_equal_the_reference_except_for_its_divisor(stacks):
    # It divides the variance of all pixels by N M - 1, where (35) divides by N M.
    lit, unlit = (list(frames(level, 2)) for level in (11, 0))
    for name, own, stack in (("bright", lit, 0), ("dark", unlit, 1)):
        image = np.mean(own, axis=0)
        temporal = np.var(own, axis=0, ddof=1).mean()
        np.testing.assert_allclose(temporal, REFERENCE["sigma_2_y_stack"][stack], rtol=1e-12)
        rows, columns = SHAPE
        found, reference = split(image, temporal / 2), np.array(REFERENCE[name])
        less = image.var(ddof=1) - image.var()
        m_n = rows * columns - rows - columns
        moved = np.array([1, -rows / m_n, -columns / m_n, rows * columns / m_n]) * less
        np.testing.assert_allclose(found, reference - moved, rtol=1e-9)
    assert stacks.averages is not None
    image = stacks.averages.unlit.image
    np.testing.assert_allclose(image, np.mean(unlit, axis=0))
    found = histogram(image, 2)
    assert found.counts[:12].tolist() == REFERENCE["histogram"]
    np.testing.assert_allclose(found.centres[0], REFERENCE["first_class"], rtol=1e-12)
    np.testing.assert_allclose(spectrogram(image, 1).power[:4], REFERENCE["power"], rtol=1e-8)


def test_simulated_rows_columns_and_pixels_are_recovered():
    rng = np.random.default_rng(0)
    row, col, pixel = (
        rng.standard_normal(s) * size for s, size in (((20, 1), 2.0), ((1, 30), 3.0), ((20, 30), 5))
    )
    row, col = row - row.mean(), col - col.mean()
    pixel = pixel - pixel.mean(axis=0) - pixel.mean(axis=1, keepdims=True) + pixel.mean()
    own = np.mean(pixel**2) / (1 - 1 / 20 - 1 / 30)  # (42) assumes independent pixels
    found = split(100 + row + col + pixel, 0.0)
    np.testing.assert_allclose(found.total, np.mean((row + col + pixel) ** 2))
    expected = (np.mean(row**2) - own / 30, np.mean(col**2) - own / 20, own)
    np.testing.assert_allclose(found[1:], expected, rtol=1e-10)
    np.testing.assert_allclose(found.total, sum(found[1:]), rtol=1e-10)


def test_the_high_pass_has_three_windows_and_the_stated_loss():
    rng = np.random.default_rng(1)
    image = rng.standard_normal((40, 50))
    smooth = image
    for window in (np.ones((7, 7)), np.ones((11, 11)), np.outer([1, 2, 1], [1, 2, 1])):
        smooth = convolve2d(smooth, window / window.sum(), mode="valid")
    np.testing.assert_allclose(high_pass(image), image[9:-9, 9:-9] - smooth, atol=1e-12)
    y, x = np.mgrid[:40, :50]
    np.testing.assert_allclose(high_pass(3 + 0.1 * x - 0.2 * y), 0, atol=1e-12)  # as of light
    pixels = high_pass(rng.standard_normal((600, 600)))
    rows = high_pass(rng.standard_normal((6000, 1)) * np.ones((6000, 19)))
    loss = loss_of_filter()
    np.testing.assert_allclose(pixels.var(), loss.pixels, rtol=0.02)
    np.testing.assert_allclose(rows.var(), loss.lines, rtol=0.1)
    assert loss.line_degrees < 1


def test_saturation_is_where_15_of_10000_numbers_are_at_the_limit(stacks):
    bright = replace(stacks.measurement.bright, pixels=jnp.asarray(1e6))
    measurement = replace(stacks.measurement, bright=bright)
    light = np.asarray(measurement.bright.light)
    # For numbers whose normal deviate is linear in the light: .15 % at 5,900 photons.
    shares = norm.cdf(norm.ppf(0.0015) + (light - 5900) / 500)
    spread = np.full(24, 50.0)
    within, clipped = ranges(measurement, Numbers(shares, spread))
    assert clipped
    np.testing.assert_allclose(np.asarray(within.saturation), 5900, rtol=1e-6)
    assert not bool(within.linearity[light > 6000].any())
    # All or none are at the limit: the mean continues at .15 DN per photon to 2.97 deviations below
    # it.
    mean = np.asarray(measurement.bright.mean)
    shares = np.where(light > 5400, 1.0, 0.0)
    within, clipped = ranges(measurement, Numbers(shares, spread))
    rate = (mean[17] - mean[16]) / 300
    expected = 5400 + (1022.5 - mean[17] + norm.ppf(0.0015) * 50) / rate
    np.testing.assert_allclose(
        np.asarray(within.saturation), min(max(expected, 5400), 5700), rtol=1e-9
    )
    within, clipped = ranges(measurement, Numbers(np.zeros(24), spread))
    assert not clipped
    assert within.saturation == 6000  # where the variance is largest


def test_histograms_count_every_pixel():
    rng = np.random.default_rng(2)
    image = rng.integers(0, 2000, (50, 60)) / 8  # an average of 8 frames
    found = histogram(image, 8)
    assert found.counts.sum() == image.size
    width = found.centres[1] - found.centres[0]
    np.testing.assert_allclose(width, 1.0)  # 8 steps of 1/8 DN: 2,000 steps in 256 classes
    deviation = found.deviations[100]
    away = np.abs(image - image.mean())
    np.testing.assert_allclose(found.share[100], 100 * np.mean(away >= deviation))
    assert found.share[0] == 100
    image = rng.standard_normal((100, 100))
    image[0, :3] = 20
    assert [one.pixels >= 3 for one in outliers(image)] == [True] * 3
    assert outliers(image)[2].interval[0] > outliers(image)[2].expected


def test_a_spectrogram_gives_the_variance_and_the_wave():
    rng = np.random.default_rng(3)
    image = rng.standard_normal((400, 64))
    found = spectrogram(image, 1)
    both = found.power[1:-1].sum() * 2 + found.power[0] + found.power[-1]
    np.testing.assert_allclose(both / 64, image.var(), rtol=1e-12)
    assert np.mean((found.power > found.band[0]) & (found.power < found.band[1])) > 0.8
    wave = np.tile(3 * np.sin(2 * np.pi * np.arange(64) / 8), (400, 1))
    found = spectrogram(image + wave, 1)
    assert found.cycles[np.argmax(found.power)] == 1 / 8
    np.testing.assert_allclose(found.power.max(), 64 * 9 / 4, rtol=0.05)


@pytest.mark.slow
def test_a_nonlinear_response_has_the_input_snr_of_the_linear_one():
    light = np.linspace(50, 6000, 60)
    electrons = 0.5 * light
    sigma = np.sqrt(electrons + 36)

    def stacks_of(response, slope):
        bright = levels_of(light, 20 + response, (slope * sigma) ** 2)
        dark = levels_of(np.zeros(1), np.full(1, 20.0), np.full(1, 36.0 * slope[0] ** 2))
        return Stacks(PhotonTransfer(bright, dark, jnp.zeros(60, int), jnp.asarray(0.0)))

    straight = release_4_sheet(stacks_of(0.3 * electrons, np.full(60, 0.3))).general
    bent = release_4_sheet(
        stacks_of(900 * (1 - np.exp(-electrons / 2000)), 0.45 * np.exp(-electrons / 2000))
    ).general
    exact = electrons / sigma
    np.testing.assert_allclose(straight.input, exact[: len(straight.input)], rtol=1e-9)
    np.testing.assert_allclose(bent.input, exact[: len(bent.input)], rtol=2e-3)
    assert abs(bent.output[-1] / exact[len(bent.output) - 1] - 1) > 0.2
    threshold = (np.sqrt(36 + 0.25) + 0.5) / 0.5  # (26)
    np.testing.assert_allclose(straight.values["threshold_photons"], threshold, rtol=1e-9)
    np.testing.assert_allclose(straight.values["efficiency_bound"], 100 * exact[-1] ** 2 / 6000)


def levels_of(light, mean, variance):
    count = len(light)
    return Levels(
        light=jnp.asarray(light),
        exposure=jnp.full(count, 0.01),
        mean=jnp.asarray(mean),
        variance=jnp.asarray(variance),
        frames=jnp.full(count, 2.0),
        pixels=jnp.asarray(10_000.0),
    )


def test_slopes_of_parabolas_are_exact():
    light = np.array([10.0, 11.0, 30.0, 31.0, 80.0, 200.0, 210.0])
    np.testing.assert_allclose(slopes(light) @ (3 * light - 0.01 * light**2), 3 - 0.02 * light)


@pytest.mark.slow
def test_the_sections_name_the_features_of_the_frames(stacks):
    linear, general = sections(release_4_sheet(stacks))
    assert [one.kind for one in (linear, general)] == [
        "noise_release_4_linear",
        "noise_release_4_general",
    ]
    for name in ("dsnu", "dsnu_row", "prnu_col", "prnu_pixel"):
        for method in ("EMVA 1288 R4", "no high-pass"):
            found = linear.estimate(name, method=method)
            assert found.value is not None
            assert found.interval_95 is not None
            assert found.interval_95[0] < found.value < found.interval_95[1]
    assert len(linear.pictures) == 5
    rows = {table.title: len(table.rows) for table in linear.tables}
    assert rows["Spatial variances of all levels"] == 25
    assert 40 < (general.estimate("input_snr_max").value or 0) < 50
    assert "DSNU row" in repr(release_4_sheet(stacks))
    # A table of sums has no pixels, and the section says so.
    linear, _ = sections(release_4_sheet(replace(stacks, numbers=None, averages=None, bright=())))
    assert "pixels" in linear.estimate("dsnu_row").reason
    assert any("table of sums" in told for told in linear.findings)


@pytest.mark.slow
def test_the_sections_name_a_mosaic_that_nobody_stated():
    """The sheet is that of all sites."""
    rng, levels = np.random.default_rng(0), np.linspace(300, 8000, 8)
    efficiency = 0.5 * np.tile([[0.5, 1.0], [1.0, 0.35]], (32, 32))

    def shot(electrons):
        noisy = rng.poisson(electrons, (2, 64, 64)) + rng.normal(0, 4, (2, 64, 64))
        return list(np.round(64 + 0.25 * noisy))

    for each, said in ((efficiency, True), (0 * efficiency + 0.5, False)):
        stacks = stacks_from_frames(
            [shot(level * each) for level in levels],
            [shot(0 * each)],
            [0.01] * 8,
            photons=list(levels),
            camera=Camera(bits=12),
            dark_exposures=[0.01],
        )
        findings = sections(release_4_sheet(stacks))[0].findings
        assert any("as with a colour mosaic; give camera.pattern" in s for s in findings) == said


@pytest.mark.slow
def test_the_command_adds_a_sheet_for_each_site(tmp_path):
    text = '[camera]\nbits = 10\npattern = "RGGB"\n'
    for level in range(13):
        names = [f"{level}_{i}.tif" for i in range(2)]
        for name, frame in zip(names, frames(level, 2), strict=True):
            write_image(tmp_path / name, frame.astype(np.uint16))
        kind, light = ("flat", f"photons = {300 * level}") if level else ("dark", "")
        text += f"[[{kind}]]\nfiles = {names}\nexposure = 0.01\n{light}\n"
    (tmp_path / "rig.toml").write_text(text)
    found, _ = folders.noise(
        tmp_path,
        lambda name: nullcontext(lambda done, total: None),
        lambda kind, progress: {"sampling": None, "seed": 0},
        release="4.0",
    )
    added = [one for one in found if one.kind.startswith("noise_release_4")]
    assert len(added) == 8
    assert len({one.kind for one in found}) == len(found)
    assert any("too small for the high-pass" in told for told in added[0].findings)
    one = folders.noise(
        tmp_path,
        lambda name: nullcontext(lambda done, total: None),
        lambda kind, progress: {"sampling": None, "seed": 0},
        channel="red",
        release="4.0",
    )[0]
    assert [section.kind for section in one[1:]] == [
        "noise_release_4_linear",
        "noise_release_4_general",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_intervals_cover_the_true_value(name):
    count = 60
    found = simulated(
        lambda seed: places(CASES[name], seed), count, parameters=len(NAMES), kept=None
    )
    covered = np.mean((found > 0.025) & (found < 0.975), axis=0)
    assert covered.min() > 0.85, dict(zip(NAMES, covered, strict=True))


def test_a_variance_below_0_gives_no_limit_of_0():
    draws = np.linspace(-2.0, -1.0, 100)
    told = _deviation(LINEARITY, -1.5, draws, 1.0, 1.0, "")
    assert told.value is None
    assert "its variance comes out below 0" in told.reason
    limit = _deviation(LINEARITY, 0.5, draws + 1.5, 1.0, 1.0, "")
    assert f"below {np.sqrt(0.475):.3g}" in limit.reason
