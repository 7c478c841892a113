"""Tests photon transfer of various simulated cameras against their true values."""

import io
from contextlib import nullcontext
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from scipy.stats import norm, poisson

from fitting import folders, noise
from fitting.codes import Converter
from fitting.noise.doubts import printed_times
from fitting.noise.emva1288 import ranges
from fitting.noise.findings import _dimmest_alone, _glow, _light_offset
from fitting.noise.level_sums import LevelSums, Unlit
from fitting.noise.levels import knee_of, linear_levels
from fitting.noise.live_pixels import LivePixels, hits
from fitting.noise.neighbours import COPIES, above_dark
from fitting.noise.periodic import periodic_in_words, periodic_structure
from fitting.noise.quantised import _sums_at_nodes, quantised_moments, window_for
from fitting.noise.raw_frames import combs, processing_in_words
from fitting.noise.section import section
from fitting.noise.sensor import bits_of, fitted_sensor
from jaxvision.files.images import write_image

K, QE, SHAPE, PHOTONS = 0.25, 0.5, (64, 64), np.linspace(300, 28_000, 8)


def camera(rng, *, read, dsnu=1.0, offset=64.0, bits=12, convert=np.asarray, light=None):
    """Return a calibrated 12-bit camera whose numbers pass through `convert`."""
    die = dsnu * rng.standard_normal(SHAPE), 1 + 0.01 * rng.standard_normal(SHAPE)

    def frame(photons):
        own = die[1] if light is None else die[1] * light(rng)
        electrons = rng.poisson(QE * photons * own) + die[0] + read * rng.standard_normal(SHAPE)
        return convert(np.clip(np.round(K * electrons + offset), 0, 4095))

    flats = [[frame(p), frame(p)] for p in PHOTONS]
    darks = [[frame(0.0), frame(0.0)] for _ in PHOTONS]
    measured = noise.from_frames(
        flats, darks, [0.01] * len(PHOTONS), list(PHOTONS), camera=noise.Camera(bits=bits)
    )
    return noise.calibrate(measured)


def estimates(calibration):
    """Return the estimates by name, those of the likelihood if there are two."""
    listed = section(calibration).estimates
    return {one.name: one for one in listed if one.method != "EMVA 1288"}


def assert_true(found, **truth):
    for name, value in truth.items():
        assert found[name].value is not None, found[name].reason
        assert abs(found[name].value - value) < 3.5 * found[name].standard_error, found[name]


@pytest.mark.slow
def test_rounded_moments_of_unequal_pixels_equal_a_sum_over_pixels():
    """The reference sums over 201 x 401 positions of offset and codes, with SciPy's Poisson
    distribution."""
    mu, gain, read, offset, spread = 3.0, 0.25, 0.7, 64.3, 0.3
    offsets = spread * np.linspace(-6, 6, 401)
    weight = norm.pdf(offsets / spread)
    weight /= weight.sum()
    codes, electrons = np.arange(58, 76), np.arange(40)
    edges = np.append(codes - 0.5, codes[-1] + 0.5)
    at = edges[:, None, None] - offset - offsets[None, :, None] - gain * electrons
    below = norm.cdf(at / (gain * read)) @ poisson.pmf(electrons, mu)
    chance = np.diff(below, axis=0)  # (codes, offsets)
    mean = codes @ chance
    variance = codes**2 @ chance - mean**2
    window = window_for(
        (0,), np.array([65.0]), deviation=0.8, read_noise=gain * read, spread=spread
    )
    own = jax.tree.map(lambda leaf: leaf[0], window)
    arguments = (jnp.asarray(x) for x in (mu, gain, read, offset))
    found = quantised_moments(*arguments, own, spread=jnp.asarray(spread))
    assert found.spatial is not None
    assert found.uneven is not None
    average = mean @ weight
    np.testing.assert_allclose(found.mean, average, atol=1e-6)
    np.testing.assert_allclose(found.variance, variance @ weight, atol=1e-6)
    np.testing.assert_allclose(found.spatial, (mean - average) ** 2 @ weight, atol=1e-6)
    np.testing.assert_allclose(
        found.uneven, (variance - variance @ weight) ** 2 @ weight, atol=1e-6
    )


@pytest.mark.parametrize(("frequencies", "nodes", "turn"), [(363, 513, 0.004), (6, 3, 0.3)])
def test_sums_over_frequencies_at_the_offsets_equal_a_product(frequencies, nodes, turn):
    rng, places = np.random.default_rng(0), np.arange(nodes) - nodes // 2
    summands = rng.normal(size=frequencies) + 1j * rng.normal(size=frequencies)
    by_hand = summands @ np.exp(1j * turn * np.outer(np.arange(frequencies), places))
    found = _sums_at_nodes(jnp.asarray(summands), jnp.asarray(turn), nodes)
    np.testing.assert_allclose(found, by_hand, atol=1e-12 * np.abs(by_hand).max())


@pytest.mark.slow
@pytest.mark.parametrize(("dsnu", "offset"), [(1.0, 64.0), (1.0, 64.3), (2.0, 64.0)])
def test_unequal_offsets_of_a_quiet_sensor_are_not_read_noise(dsnu, offset):
    found = estimates(camera(np.random.default_rng(0), read=0.8, dsnu=dsnu, offset=offset))
    assert_true(found, system_gain=K, read_noise=0.8, dsnu=dsnu)
    assert found["read_noise"].standard_error < 0.03


def left_aligned(frame):
    return 16 * frame


@pytest.mark.slow
@pytest.mark.parametrize(
    ("convert", "bits", "step", "said"),
    [
        (left_aligned, 16, 16, "multiple of 16: the converter has 12 bits"),
        (
            lambda frame: np.round(frame * 65535 / 4095),
            16,
            65535 / 4095,
            "scaled and rounded again",
        ),
        (lambda frame: (frame / 16).astype(np.float32), 12, 1 / 16, "multiple of 1/16"),
    ],
    ids=["left-aligned", "scaled", "divided"],
)
def test_the_step_of_the_converter_is_the_files_own(convert, bits, step, said):
    calibration = camera(np.random.default_rng(1), read=4.0, convert=convert, bits=bits)
    found = estimates(calibration)
    assert_true(found, system_gain=K * step, quantum_efficiency=50.0, read_noise=4.0, dsnu=1.0)
    assert any(said in sentence for sentence in section(calibration).findings)


def averages(flats, darks):
    """Return frames that are single, means of 16 or medians of 15, scaled as masters are."""
    rng = np.random.default_rng(24)

    def frame(photons, kind):
        many = rng.poisson(QE * photons, (16, *SHAPE)) + 4 * rng.standard_normal((16, *SHAPE))
        many = np.round(K * many + 64)
        medians = 1.0173 * np.median(many[:15], axis=0)
        return {"single": many[0], "means": many.mean(axis=0), "medians": medians}[kind]

    frames = [[frame(p, flats), frame(p, flats)] for p in PHOTONS]
    unlit = [[frame(0.0, darks), frame(0.0, darks)] for _ in PHOTONS]
    times = [0.01] * len(PHOTONS)
    return noise.from_frames(frames, unlit, times, list(PHOTONS), camera=noise.Camera(bits=12))


@pytest.mark.sweep("means-single", "single-single")
@pytest.mark.parametrize(
    ("flats", "darks", "lost", "said"),
    [
        ("single", "means", "read_noise", "the darks are multiples of 1/16, those of the flats"),
        ("single", "medians", "read_noise", "the darks are on no grid, those of the flats"),
        ("means", "single", "system_gain", "the flats are multiples of 1/16, those of the darks"),
        ("single", "single", None, None),
        ("means", "means", None, None),
    ],
)
def test_averages_in_the_darks_or_in_the_flats_are_distinguished(flats, darks, lost, said):
    doubts = averages(flats, darks).doubts
    assert len(doubts) == (lost is not None)
    assert all(lost in one.of and said in one.sentence for one in doubts)


@pytest.mark.slow
def test_averages_in_the_darks_affect_only_the_dark_noise():
    """Means of 16 have a quarter of the noise. The gain is from the flats."""
    calibration = noise.calibrate(averages("single", "means"))
    found, told = estimates(calibration), " ".join(section(calibration).findings)
    assert found["read_noise"].value is None
    assert abs(found["system_gain"].value - K) < 4 * found["system_gain"].standard_error
    assert "too small and its quantum efficiency" not in told


@pytest.mark.parametrize(
    ("top", "step", "bits"), [(65520, 16.0, 12), (4095, 1.0, 12), (16383, 1.0, 14)]
)
def test_bits_of_a_converter_are_those_of_its_codes(top, step, bits):
    assert bits_of(top, Converter(step=step)) == bits


@pytest.mark.slow
def test_left_aligned_numbers_of_a_quiet_sensor_give_the_same_warnings():
    calibration = camera(np.random.default_rng(2), read=0.8, convert=left_aligned, bits=16)
    assert_true(estimates(calibration), read_noise=0.8, dsnu=1.0, system_gain=16 * K)
    told = " ".join(section(calibration).findings)
    assert "Dark variance is below 61.4 DN²" in told
    assert "Black is clipped, or read noise is too small" in told
    sensor = fitted_sensor(calibration)[0]
    assert sensor.bits == pytest.approx(12)
    assert float(sensor.gain) == pytest.approx(K, rel=0.02)
    assert float(sensor.offset) == pytest.approx(64, abs=0.05)


@pytest.mark.slow
def test_a_quantisation_floor_is_an_upper_limit_and_darks_show_their_noise():
    calibration = camera(np.random.default_rng(3), read=1.2, dsnu=0.0, offset=63.9)
    by_method = {(one.name, one.method): one for one in section(calibration).estimates}
    for name, side in (("temporal_dark_noise", "below 0.49 DN"), ("read_noise", "below 1.58 e⁻")):
        standard = by_method[name, "EMVA 1288"]
        assert standard.value is None
        assert standard.reason.startswith(side[:9])
    shown = by_method["temporal_dark_noise", "likelihood"]
    scatter = float(np.sqrt(np.mean(np.asarray(calibration.measurement.dark.variance))))
    assert abs(shown.value - scatter) < 4 * shown.standard_error
    assert_true(estimates(calibration), read_noise=1.2)
    for one in by_method.values():
        assert one.value is None or one.standard_error > 0, one


@pytest.mark.slow
def test_a_read_noise_below_a_tenth_of_a_code_is_an_upper_limit():
    calibration = camera(np.random.default_rng(4), read=0.1, dsnu=0.0, offset=64.49)
    read = estimates(calibration)["read_noise"]
    assert read.value is None
    assert read.reason.startswith("below ")
    assert 0.4 <= float(read.reason.split()[1]) < 1.5


@pytest.mark.slow
def test_row_flicker_of_a_tenth_of_a_percent_does_not_change_the_sheet():
    def rows(rng):
        return 1 + 0.001 * rng.standard_normal((SHAPE[0], 1))

    calibration = camera(np.random.default_rng(5), read=4.0, light=rows)
    assert_true(
        estimates(calibration),
        system_gain=K, quantum_efficiency=50.0, read_noise=4.0, dsnu=1.0, prnu=1.0,
    )  # fmt: skip
    assert list(calibration.flicker) == ["rows"]
    assert "follow from the independent noise of pixels" in section(calibration).findings[0]


ROW, COLUMN = np.indices(SHAPE)
ODD = ROW % 2, COLUMN % 2
MOSAIC = np.select([ODD[0] + ODD[1] == 0, ODD[0] + ODD[1] == 2], [0.6, 0.4], 1.0)
RIGHT = COLUMN // (SHAPE[1] // 2)


def read_out(rng, *, gain=K, offset=64.0, light=1.0, columns=0.0):
    """Return flats and darks of pixels with the given differences, and columns with random
    offsets."""
    fixed = offset + columns * rng.standard_normal((1, SHAPE[1]))

    def frame(photons):
        electrons = rng.poisson(QE * photons * light * np.ones(SHAPE))
        electrons = electrons + 4 * rng.standard_normal(SHAPE)
        return np.clip(np.round(gain * electrons + fixed), 0, 65535)

    flats = [[frame(p), frame(p)] for p in PHOTONS]
    darks = [[frame(0.0), frame(0.0)] for _ in PHOTONS]
    return flats, darks, [0.01] * len(PHOTONS), list(PHOTONS)


def structure(frames):
    measured = noise.from_frames(*frames, camera=noise.Camera(bits=16))
    return periodic_structure(measured, linear_levels(measured))


def test_two_amplifiers_are_found_and_named():
    frames = read_out(
        np.random.default_rng(6),
        gain=np.where(COLUMN % 2, 0.31, 0.25),
        offset=np.where(COLUMN % 2, 80.0, 64.0),
    )
    (found,) = structure(frames)
    assert (found.where, found.period) == ("columns", 2)
    np.testing.assert_allclose(found.gains, (0.25, 0.31), rtol=0.03)
    np.testing.assert_allclose(np.diff(found.offsets), 16, atol=0.1)
    named, widened = periodic_in_words((found,), 0.28)
    assert named.startswith("Even and odd columns differ in gain by 2")
    assert "camera.taps = [1, 2]" in named
    assert "is not the gain of any pixel" in widened


@pytest.mark.sweep("mosaic", "halves", "three rows", "eight rows")
@pytest.mark.parametrize(
    ("camera", "where", "period", "what"),
    [
        ({"offset": 64 + np.array([0.0, 4, 0, 2])[COLUMN % 4]}, "columns", 4, "offsets"),
        ({"offset": 64 + 3.0 * (ROW % 8 == 5)}, "rows", 8, "offsets"),
        ({"light": np.where(ROW % 2, 0.97, 1.0)}, "rows", 2, "signals"),
        ({"light": MOSAIC}, "mosaic", 2, "signals"),
        ({"gain": np.array([0.25, 0.27, 0.31])[COLUMN % 3]}, "columns", 3, "gains"),
        ({"gain": np.array([0.25, 0.27, 0.31])[ROW % 3]}, "rows", 3, "gains"),
        ({"offset": 64 + np.array([0.0, 2, 5, 1, 3])[COLUMN % 5]}, "columns", 5, "offsets"),
        ({"gain": np.array([0.25, 0.31, 0.26, 0.28, 0.23, 0.3])[ROW % 6]}, "rows", 6, "gains"),
        ({"gain": np.where(RIGHT, 0.28, 0.25)}, "left and right", 0, "gains"),
    ],
    ids=[
        *("four taps", "eight rows", "interlaced", "mosaic", "three taps", "three rows"),
        *("five columns", "six rows", "halves"),
    ],
)
def test_structure_of_a_known_period_is_found(camera, where, period, what):
    (found,) = structure(read_out(np.random.default_rng(7), **camera))
    assert (found.where, found.period) == (where, period)
    assert getattr(found, what)
    assert len(periodic_in_words((found,), K)) == 1 + bool(found.gains)


@pytest.mark.slow
def test_unequal_columns_and_vignetting_are_not_structure():
    alarms = 0
    for seed in range(12):
        falls = 1 - 0.3 * ((COLUMN - 20) ** 2 + (ROW - 40) ** 2) / SHAPE[0] ** 2
        rng = np.random.default_rng(100 + seed)
        alarms += bool(structure(read_out(rng, columns=1.5, light=falls)))
    assert alarms == 0


@pytest.mark.slow
def test_the_gain_of_two_amplifiers_covers_both_and_each_tap_has_its_own():
    frames = read_out(
        np.random.default_rng(8),
        gain=np.where(COLUMN % 2, 0.31, 0.25),
        offset=np.where(COLUMN % 2, 80.0, 64.0),
    )
    together = noise.calibrate(noise.from_frames(*frames, camera=noise.Camera(bits=14)))
    low, high = together.estimates["system_gain"].interval_95
    assert low < 0.25 < 0.31 < high
    taps = noise.Camera(bits=14, taps=(1, 2))
    for channel, gain, black in (("tap 0,0", 0.25, 64.0), ("tap 0,1", 0.31, 80.0)):
        own = noise.calibrate(noise.from_frames(*frames, camera=taps, channel=channel))
        assert own.periodic == ()
        assert_true(own.estimates, system_gain=gain, black_level=black, read_noise=4.0)


@pytest.mark.slow
def test_the_command_calibrates_each_tap(tmp_path):
    flats, darks, *_ = read_out(np.random.default_rng(9), gain=np.where(COLUMN % 2, 0.31, 0.25))
    lines = ["[camera]", "bits = 14", "taps = [1, 2]"]
    for kind, levels in (("flat", flats), ("dark", darks)):
        for i, level in enumerate(levels):
            names = [f"{kind}_{i}_{j}.png" for j in range(len(level))]
            for name, frame in zip(names, level, strict=True):
                write_image(tmp_path / name, frame.astype(np.uint16))
            lines += [f"[[{kind}]]", f"files = {names}", "exposure = 0.01"]
            lines += [f"photons = {PHOTONS[i]}"] * (kind == "flat")
    (tmp_path / "rig.toml").write_text("\n".join(lines).replace("'", '"'))
    sections, _ = folders.noise(
        tmp_path,
        lambda label: nullcontext(lambda done, total: None),
        lambda kind, progress: {"sampling": None},
    )
    assert [one.kind for one in sections] == ["noise", "noise_tap_0_1"]
    for one, gain in zip(sections, (0.25, 0.31), strict=True):
        found = one.estimate("system_gain", method="likelihood")
        assert abs(found.value - gain) < 3.5 * found.standard_error
    assert sections[0].tables[0].title == "Sites by likelihood"
    assert len(sections[0].tables[0].rows) == 2


@pytest.mark.parametrize("count", [2, 5])
def test_a_lamp_that_flickers_between_frames_is_not_taken_for_other_effects(count):
    rng = np.random.default_rng(count)

    def frame(photons):
        light = photons * (1 + 0.03 * rng.standard_normal()) if photons else 0.0
        electrons = rng.poisson(QE * light, SHAPE) + 4 * rng.standard_normal(SHAPE)
        return np.clip(np.round(K * electrons + 64), 0, 4095)

    flats = [[frame(p) for _ in range(count)] for p in PHOTONS]
    darks = [[frame(0.0), frame(0.0)] for _ in PHOTONS]
    measured = noise.from_frames(
        flats, darks, [0.01] * len(PHOTONS), list(PHOTONS), camera=noise.Camera(bits=12)
    )
    assert measured.bright.left_out == ()
    assert periodic_structure(measured, linear_levels(measured)) == ()
    found, variances, _ = above_dark(measured)
    shares = np.sum(found * COPIES, axis=(1, 2))
    errors = np.sqrt(np.sum(variances * COPIES**2, axis=(1, 2)))
    assert np.abs(shares / errors).max() < 4
    gains = (measured.bright.quarters - measured.dark.quarters)[:, 1, :6]
    own = measured.bright.variance - measured.dark.variance.mean()
    assert np.abs(gains / own[:, None] - 1).max() < 5 * np.sqrt(2 / (64 * 16 * (count - 1)))


def test_three_amplifiers_are_named_with_their_taps():
    frames = read_out(np.random.default_rng(7), gain=np.array([0.25, 0.27, 0.31])[COLUMN % 3])
    first, *_ = periodic_in_words(structure(frames), 0.28)
    assert first.startswith("The columns of every three differ in gain by 2")
    assert "camera.taps = [1, 3]" in first


@pytest.mark.parametrize(("offset", "said"), [(-11e-6, 0), (-49e-6, 0), (-60e-6, 1)])
def test_an_offset_of_the_light_within_twice_its_error_is_not_reported(offset, said):
    found = SimpleNamespace(
        likelihood=...,
        chosen=SimpleNamespace(values={"light_offset"}, data=SimpleNamespace(photons_known=False)),
        estimates={"light_offset": SimpleNamespace(value=offset, standard_error=25e-6)},
    )
    assert bool(_light_offset(True, found)) == said


@pytest.mark.slow
def test_a_stated_gain_that_the_frames_contradict_is_named():
    rng = np.random.default_rng(6)

    def frame(photons):
        electrons = rng.poisson(QE * photons, SHAPE) + 4.0 * rng.standard_normal(SHAPE)
        return np.round(K * electrons + 64.0)

    flats = [[frame(p), frame(p)] for p in PHOTONS]
    darks = [[frame(0.0), frame(0.0)] for _ in PHOTONS]
    stated = noise.Camera(bits=12, gain=0.5, read_noise=4.0)
    times, photons = [0.01] * len(PHOTONS), list(PHOTONS)
    found = noise.calibrate(noise.from_frames(flats, darks, times, photons, camera=stated))
    told = [one for one in section(found).findings if "Other calibrations of this rig use" in one]
    assert len(told) == 1
    assert told[0].startswith("camera.gain states 0.5 DN/e⁻, but the frames have 0.2")


@pytest.mark.slow
def test_darks_of_another_camera_may_explain_an_offset_of_the_light():
    """Darks 6 DN above the flats' black level look as if 48 photons were missing in each flat."""
    rng = np.random.default_rng(5)

    def frame(photons, offset):
        electrons = rng.poisson(QE * photons, SHAPE) + 4.0 * rng.standard_normal(SHAPE)
        return np.round(K * electrons + offset)

    flats = [[frame(p, 64.0), frame(p, 64.0)] for p in PHOTONS]
    darks = [[frame(0.0, 70.0), frame(0.0, 70.0)] for _ in PHOTONS]
    times, photons = [0.01] * len(PHOTONS), list(PHOTONS)
    measured = noise.from_frames(flats, darks, times, photons, camera=noise.Camera(bits=12))
    told = " ".join(section(noise.calibrate(measured)).findings)
    assert "photons less than recorded" in told
    assert "leaked" not in told
    moved = float(told.split("temperature, ")[1].split(" DN above the flats' black level")[0])
    assert abs(moved - 6.0) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("bits", [12, 16])
@pytest.mark.sweep
def test_dead_columns_rows_and_pixels_are_left_out(bits):
    """The pixels are 0, and stuck at the highest code, in every frame."""
    rng = np.random.default_rng(12)
    prnu = 1 + 0.01 * rng.standard_normal(SHAPE)
    flats, darks, *others = read_out(rng, light=prnu)
    for frame in (frame for level in (*flats, *darks) for frame in level):
        frame[:, [5, 20, 21]] = 0
        frame[40] = 0
        frame[[3, 50], [30, 60]] = 2**bits - 1
    measured = noise.from_frames(flats, darks, *others, camera=noise.Camera(bits=bits))
    (remark,) = (told for told in measured.remarks if "dead" in told)
    assert "255 of 4096 pixels were left out: 255 that are dead or stuck" in remark
    assert "columns 5, 20, 21; row 40; row and column (3, 30), (50, 60)" in remark
    assert float(measured.bright.pixels) == float(measured.dark.pixels) == 3841
    assert measured.bright.shared.shape.tolist() == [63, 61]
    np.testing.assert_allclose(measured.dark.mean, 64, atol=5 * np.sqrt(1.08 / 3841 / 2))
    assert periodic_structure(measured, linear_levels(measured)) == ()
    calibration = noise.calibrate(measured)
    assert_true(estimates(calibration), system_gain=K, read_noise=4.0, prnu=1.0)
    assert not any("anding" in told for told in section(calibration).findings)


def test_hot_and_stuck_pixels_are_left_out_of_flats_and_darks():
    """One per cent of the pixels has a dark current of 3,000 electrons, with shot noise."""
    rng = np.random.default_rng(14)
    flats, darks, *others = read_out(rng)
    hot = rng.random(SHAPE) < 0.01
    for frame in (frame for level in (*flats, *darks) for frame in level):
        frame[hot] += np.round(K * rng.poisson(3000, int(hot.sum())))
        frame[[9, 44], [17, 2]] = 700 + rng.integers(-1, 2, 2)
    count = int(hot.sum())
    alone = noise.darks_from_frames(darks, others[0], camera=noise.Camera(bits=16))
    measured = noise.from_frames(flats, darks, *others, camera=noise.Camera(bits=16))
    (remark,) = (told for told in measured.remarks if "hot" in told)
    assert f"{count + 2} of 4096 pixels were left out: 2 that are dead or stuck" in remark
    assert f"{count} that are hot" in remark
    assert f"{count + 2} that are hot" in alone.left_out[0]
    for dark in (measured.dark, alone):
        assert float(dark.pixels) == 4096 - count - 2
        error = np.sqrt(2 / (4094 - count))
        np.testing.assert_allclose(dark.variance, 1 + 1 / 12, rtol=5 * error)
        np.testing.assert_allclose(dark.mean, 64, atol=5 * np.sqrt(1.1 / 4000 / 2))


def levels_of(count, *, flicker=0.0, vignette=0.0, dead=0.0, frames=2, electrons=10_000):
    """Return variances of simulated levels, relative to those for their mean light, and the number
    of pixels used."""
    found = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        away = np.hypot(*(np.mgrid[:64, :64] / 64 - 0.5))
        light = electrons * (1 - 2 * vignette * away**2) * (1 + 0.01 * rng.standard_normal(SHAPE))
        live = LivePixels(rng.random(SHAPE) >= dead)
        stack = [
            K * rng.poisson(light * (1 + flicker * rng.standard_normal())) + 64
            for _ in range(frames)
        ]
        sums = LevelSums(stack[0] * live.mask, 1e9, live, Unlit(64.0, 0.0))
        for i, frame in enumerate(stack):
            sums.add(str(i), frame * live.mask)
        level = sums.level()
        mean, variance = level.numbers["mean"], level.numbers["variance"]
        lines = np.array(level.lines[:2]) / variance
        found.append([variance / (K * (mean - 64)), *lines, live.count])
    return np.array(found).T


@pytest.mark.parametrize(("frames", "flicker"), [(2, 0.03), (2, 0.1), (4, 0.03)])
@pytest.mark.sweep
def test_flicker_over_uneven_light_does_not_change_the_variance(frames, flicker):
    """The light falls by 60 % towards the corners. From whole frames, 3 % of flicker would add a
    fifth to the variance."""
    ratio, rows, columns, _ = levels_of(40, flicker=flicker, vignette=0.6, frames=frames)
    for values, truth in ((ratio, 1.0), (rows, 0.0), (columns, 0.0)):
        assert abs(values.mean() - truth) < 3.5 * values.std() / np.sqrt(40)
    assert abs(ratio - 1).max() < 5 * np.sqrt(2 / 4096 / (frames - 1))


def test_errors_use_the_number_of_remaining_pixels():
    ratio, _, _, count = levels_of(120, dead=0.3)
    z = (ratio - 1) / np.sqrt(2 / count)
    assert abs(z.mean()) < 3.5 / np.sqrt(120)
    assert 0.8 < z.std() < 1.2


def jpeg(frame, quality):
    """Return a frame after JPEG compression."""
    file = io.BytesIO()
    Image.fromarray(frame.astype(np.uint8)).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


@pytest.mark.parametrize("quality", [100, 98, 95, 85, None])
@pytest.mark.sweep
def test_frames_from_jpegs_of_high_quality_are_named(quality):
    """With 8 bits, K is 2, 13 and 20 % too large at quality 100, 98 and 95, and half at 85."""
    rng = np.random.default_rng(15)

    def frame(electrons):
        dn = 0.025 * (rng.poisson(electrons, (128, 128)) + 30 * rng.standard_normal((128, 128)))
        raw = np.clip(np.round(8 + dn), 0, 255).astype(np.uint8)
        return raw if quality is None else jpeg(raw, quality)

    electrons = np.linspace(300, 9000, 8)
    flats = [[frame(e), frame(e)] for e in electrons]
    of = {"camera": noise.Camera(bits=8), "dark_exposures": [0.01]}
    darks = [[frame(0), frame(0)]]
    measured = noise.from_frames(flats, darks, [0.01] * 8, list(2 * electrons), **of)
    told = processing_in_words(measured, linear_levels(measured))
    assert len(told) == (quality is not None)
    assert all("JPEG" in sentence for sentence in told)


def test_raw_numbers_are_not_taken_for_jpeg():
    """The raw numbers have any noise, and may be in the upper bits of 16."""
    rng = np.random.default_rng(16)
    for step in (1, 4, 16):
        for deviation in rng.uniform(0.3, 8, 40):
            raw = step * np.round(100 + deviation * rng.standard_normal((64, 64)))
            assert np.sum(np.nan_to_num(combs(raw)).max(axis=0) > 5) < 10


@pytest.mark.parametrize("size", [64, 128])
def test_dark_blocks_next_to_lit_ones_are_not_taken_for_jpeg(size):
    """An eighth of the blocks has noise of 1.3 DN and the others of 20, as in a frame with covered
    columns."""
    rng = np.random.default_rng(18)
    found = np.zeros((16, 8, 8))
    for _ in range(10):
        frame = 20 * rng.standard_normal((size, size))
        frame[:, : size // 8] *= 1.3 / 20
        found += np.nan_to_num(combs(np.round(1000 + frame))) / np.sqrt(10)
    assert np.sum(found.max(axis=0) > 5) == 0


@pytest.mark.slow
def test_covered_columns_are_left_out_however_many_they_are():
    """A quarter of the columns is under metal. Two bad pixels there follow the light."""
    rng = np.random.default_rng(19)
    flats, darks, *others = read_out(rng)
    for frame in (frame for level in flats for frame in level):
        frame[:, :16] = np.round(64 + rng.standard_normal((64, 16)))
        frame[[3, 60], [2, 9]] = frame[[3, 60], [30, 31]]
    measured = noise.from_frames(flats, darks, *others, camera=noise.Camera(bits=16))
    (remark,) = (told for told in measured.remarks if "dead" in told)
    assert "1024 of 4096 pixels were left out" in remark
    assert remark.count(",.") == 0
    assert float(measured.bright.pixels) == 3072
    calibration = noise.calibrate(measured)
    assert_true(estimates(calibration), system_gain=K, quantum_efficiency=100 * QE)


def test_clipped_black_and_saturation_are_not_dead_pixels():
    flats, darks, *others = read_out(np.random.default_rng(13), offset=0.0)
    flats[-1] = [np.full(SHAPE, 65535.0)] * 2
    measured = noise.from_frames(flats, darks, *others, camera=noise.Camera(bits=16))
    assert not any("dead" in told for told in measured.remarks)


@pytest.mark.parametrize(("late", "alone"), [("the first", True), ("all", False)])
def test_an_offset_of_the_dimmest_level_only_is_distinguished_from_one_of_all(late, alone):
    stated = np.linspace(1e-3, 2e-2, 10)
    true = stated - np.where((late == "all") | (np.arange(10) == 0), 1e-4, 0)
    assert _dimmest_alone(*timed(stated, true, 2e-4)) == alone


def timed(times, true, scatter=0.0):
    """Return flats of a linear camera whose true exposure times differ from the stated ones."""
    rng = np.random.default_rng(17)
    true = np.asarray(true) * (1 + scatter * rng.standard_normal(len(true)))
    bright = SimpleNamespace(exposure=np.asarray(times), mean=64 + 3000 * true / true.max())
    dark = SimpleNamespace(mean=np.array([64.0]))
    of = {"photons_known": False, "dark_of": np.zeros(len(times), int)}
    return SimpleNamespace(bright=bright, dark=dark, **of), np.arange(len(times))


PRINTED = 1 / np.array([500, 250, 125, 60, 30, 15, 8, 4, 2, 1])
EXACT = 2.0 ** np.arange(-9, 1)


@pytest.mark.parametrize("scatter", [0.0, 0.003])
def test_times_that_cameras_print_are_named(scatter):
    worst = printed_times(*timed(PRINTED, EXACT, scatter))["worst"]
    assert any(
        word in worst for word in ("1/16 s for 1/15 s", "1/32 s for 1/30 s", "1/64 s for 1/60")
    )


@pytest.mark.parametrize(
    ("times", "true", "scatter"),
    [(EXACT, EXACT, 0.0), (PRINTED, PRINTED, 0.003), (EXACT, EXACT, 0.05), (PRINTED, EXACT, 0.05)],
    ids=["exact", "true as printed", "scatter", "both"],
)
def test_other_times_are_not_called_printed(times, true, scatter):
    assert printed_times(*timed(times, true, scatter)) is None


def test_gains_that_grow_towards_the_border_are_named():
    """A correction of lens shading multiplies numbers by 1 + 0.8 r^2, under uniform light."""
    distance = ((ROW - 31.5) ** 2 + (COLUMN - 31.5) ** 2) / 31.5**2
    (found,) = structure(read_out(np.random.default_rng(10), gain=K * (1 + 0.8 * distance)))
    assert (found.where, found.period) == ("centre and border", 0)
    near = distance <= np.median(distance)
    gains = [K * np.mean(1 + 0.8 * distance[zone]) for zone in (near, ~near)]
    squares = [K * np.mean((1 + 0.8 * distance[zone]) ** 2) for zone in (near, ~near)]
    expected = [square / gain * K for gain, square in zip(gains, squares, strict=True)]
    np.testing.assert_allclose(found.gains, expected, rtol=0.03)
    named, _ = periodic_in_words((found,), K)
    assert "correction of lens shading" in named


@pytest.mark.parametrize("share", [0.0, 0.003])
def test_cosmic_rays_are_left_out_and_named(share):
    """A share of the pixels of each frame is hit, with 3000 electrons on average."""
    rng = np.random.default_rng(11)

    def frame(photons):
        rays = rng.exponential(3000, SHAPE) * (rng.random(SHAPE) < share)
        electrons = rng.poisson(QE * photons, SHAPE) + rays + 4 * rng.standard_normal(SHAPE)
        return np.clip(np.round(K * electrons + 64), 0, 65535)

    levels = [[[frame(p) for _ in range(3)] for p in own] for own in (PHOTONS, 0 * PHOTONS)]
    times, camera = [0.01] * len(PHOTONS), noise.Camera(bits=16)
    measured = noise.from_frames(*levels, times, list(PHOTONS), camera=camera)
    bright, dark = measured.bright, measured.dark
    told = [one for one in (*bright.left_out, *dark.left_out) if "cosmic rays" in one]
    assert len(told) == 2 * bool(share)
    if share:
        expected = len(PHOTONS) * 3 * share * np.prod(SHAPE)
        assert all(0.7 < int(one.split()[0]) / expected < 1.1 for one in told)
    expected = K**2 * 16 + 1 / 12
    assert abs(float(dark.variance.mean()) / expected - 1) < 0.02
    gains = (bright.variance - dark.variance) / (bright.mean - dark.mean)
    # Three standard errors of 8 variances of 4096 pixels in three frames, plus the weakest hits.
    assert abs(float(gains.mean()) / K - 1) < 3 * np.sqrt(2 / (2 * 4096 * 8)) + 0.005


def test_tails_of_few_electrons_and_of_warm_pixels_are_not_cosmic_rays():
    rng, live = np.random.default_rng(12), LivePixels(np.ones((128, 128), bool))
    warm = 30 * rng.lognormal(0, 2, (128, 128))
    for mean in (0.001, 0.01, 0.1, 1.0, warm):
        frames = 20 * rng.poisson(mean, (2, 128, 128)) + 5 * rng.standard_normal((2, 128, 128))
        assert hits(np.round(frames[1]) - np.round(frames[0]), live) is None


@pytest.mark.slow
def test_a_knee_of_a_piecewise_linear_response_is_not_the_full_well():
    """Numbers above 1800 DN (1736 above black) are compressed to a quarter."""
    rng = np.random.default_rng(3)

    def frame(photons):
        electrons = rng.poisson(QE * photons, (128, 128)) + 4 * rng.standard_normal((128, 128))
        number = K * electrons + 64
        return np.round(np.where(number < 1800, number, 1800 + (number - 1800) / 4))

    found = noise.calibrate(
        noise.from_frames(
            [[frame(p), frame(p)] for p in PHOTONS],
            [[frame(0.0), frame(0.0)] for _ in PHOTONS],
            [0.01] * len(PHOTONS),
            list(PHOTONS),
            camera=noise.Camera(bits=12),
        )
    )
    knee = found.measurement.knee
    assert knee is not None
    assert knee.level == 4
    np.testing.assert_allclose([knee.slope, knee.signal], [0.25, 1736], rtol=0.1)
    np.testing.assert_array_equal(found.usable, range(4))
    figures = {one.name: one for one in section(found).estimates}
    assert_true({name: figures[name] for name in ("system_gain",)}, system_gain=K)
    assert figures["saturation_electrons"].value is None
    assert "has a knee" in figures["saturation_electrons"].reason
    assert any("a knee of a piecewise linear response" in text for text in section(found).findings)


@pytest.mark.sweep
@pytest.mark.parametrize("count", [60, 200])
def test_saturation_and_smooth_curves_are_not_knees(count):
    """There are five series of each type, without noise, and with the noise of 128 x 128 pixels."""
    rng = np.random.default_rng(0)
    for noisy in (0.0, np.sqrt(2) / 128):
        for _ in range(count):
            light = np.linspace(rng.uniform(0.01, 0.1), rng.uniform(0.9, 1.4), rng.integers(6, 25))
            clipped = np.minimum(light, 1)
            for signal, slope in (
                (light, np.ones_like(light)),
                (clipped, np.where(light < 1, 1, 1e-3)),
                (1 - np.exp(-light), np.exp(-light)),
                (light / (1 + light**8) ** (1 / 8), (1 + light**8) ** (-9 / 8)),
                (light - light**2 / 10, 1 - light / 5),
            ):
                shot = 1e4 * light * slope**2
                shot = shot * (1 + noisy * rng.standard_normal(len(light)))
                assert knee_of(1e4 * signal, shot, noisy * shot) is None


def test_a_saturating_series_without_known_light_has_its_well():
    rng = np.random.default_rng(0)
    flats = [[np.minimum(rng.poisson(p, (64, 64)), 9000) for _ in range(2)] for p in PHOTONS / 2]
    darks = [[10 + rng.poisson(9, (64, 64)) for _ in range(2)] for _ in PHOTONS]
    measured = noise.from_frames(
        [[10 + frame for frame in level] for level in flats],
        darks,
        [0.01] * len(PHOTONS),
        list(PHOTONS),
        camera=noise.Camera(bits=14),
    )
    assert measured.knee is None
    assert ranges(measured).saturation is not None


def exposed(rng, *, offset=64.0, side=128, read=4.0, dark=20.0, light=None, levels=12):
    """Return flats and darks of one lamp at increasing exposure times, and the stated values."""
    photons = np.linspace(600, 26_000, levels)
    times = photons / 1e6

    def frame(mean, time):
        mean = mean if light is None else mean * light(rng)
        electrons = rng.poisson(QE * mean + dark * time, (side, side))
        return np.clip(
            np.round(K * (electrons + read * rng.standard_normal((side, side))) + offset, 0),
            0,
            4095,
        )

    flats = [[frame(p, t), frame(p, t)] for p, t in zip(photons, times, strict=True)]
    darks = [[frame(0.0, t), frame(0.0, t)] for t in times]
    return flats, darks, list(times), list(photons)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 7, 8])
@pytest.mark.sweep
def test_bands_of_a_dimmed_lamp_are_not_a_moving_camera(seed):
    """A lamp is dimmed by pulses, under a rolling shutter."""
    rows = np.arange(128)[:, None]

    def bands(rng):
        return 1 + 0.04 * np.sin(2 * np.pi * (rows / 41 + rng.uniform()))

    measured = noise.from_frames(
        *exposed(np.random.default_rng(seed), light=bands), camera=noise.Camera(bits=12)
    )
    assert len(measured.bright.mean) >= 10
    told = " ".join(measured.bright.left_out)
    assert not any(word in told for word in ("moved", "copies", "averaged"))


def test_a_left_aligned_level_is_named():
    flats, darks, *stated = exposed(np.random.default_rng(10))
    flats[5] = [16 * frame for frame in flats[5]]
    measured = noise.from_frames(flats, darks, *stated, camera=noise.Camera(bits=16))
    (told,) = measured.bright.left_out
    assert "its values are multiples of 16, those of other levels are not" in told
    assert measured.converter.coarse_from is None  # of the remaining levels


def test_darks_with_almost_one_code_are_not_uneven():
    """The read noise is .3 electrons at .25 DN per electron."""
    for seed in (2, 4, 6):
        frames = exposed(np.random.default_rng(seed), offset=10, side=64, read=0.3, dark=0.5)
        measured = noise.from_frames(*frames, camera=noise.Camera(bits=12))
        assert _glow(SimpleNamespace(measurement=measured)) is None


@pytest.mark.slow
def test_the_dark_current_of_clipped_black_is_not_attributed_to_compensation():
    frames = exposed(np.random.default_rng(14), offset=0, levels=14)
    found = noise.calibrate(noise.from_frames(*frames, camera=noise.Camera(bits=12)))
    told = " ".join(section(found).findings)
    assert "subtracts dark current" not in told
    assert "because black is clipped" in told
    assert_true({"dark_current": estimates(found)["dark_current"]}, dark_current=20)


@pytest.mark.slow
@pytest.mark.parametrize("lowest", [62, 65])
def test_black_clipped_above_0_does_not_lower_the_read_noise(lowest):
    """An earlier version gave a read noise of 2.91 +- .31 for a limit of 5, and a dark current of
    22.3 +- 2.0 for 40."""
    found = camera(
        np.random.default_rng(1), read=6.0, convert=lambda frame: np.maximum(frame, lowest)
    )
    assert any(
        f"No value of the darks is below {lowest} DN" in one for one in section(found).findings
    )
    assert_true(estimates(found), read_noise=6.0, system_gain=K, black_level=64.0)
