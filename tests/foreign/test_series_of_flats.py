"""Tests flats and darks of cameras with light leaks, afterglow, changes of gain, or movement
between frames."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from noise_findings import told
from PIL import Image

from fitting import noise
from fitting.codes import converter_in_words, converter_of
from fitting.frame_checks.heads import Stated, odd_heads
from fitting.noise import calibration as calibrations
from fitting.noise.across_settings.prediction import predict_settings
from fitting.noise.calibration import steady_linearity
from fitting.noise.doubts import drifting
from fitting.noise.emva1288 import evaluate, ranges
from fitting.noise.findings import _glow, _periodic
from fitting.noise.levels import linear_levels, shot_of, signal_of
from fitting.noise.levels_table import read_table
from fitting.noise.live_pixels import stuck_bits
from fitting.noise.pattern import fitted_pattern
from fitting.noise.periodic import periodic_structure
from fitting.noise.raw_frames import processing_in_words
from fitting.noise.section import _why_hidden, section
from jaxvision.errors import InputError

K, READ, BLACK, SHAPE = 0.5, 3.0, 64.0, (64, 64)
ELECTRONS = np.linspace(300, 7000, 8)
EXPOSURES = ELECTRONS / ELECTRONS[-1]  # s


def exposed(rng, electrons, *, gain=K, prnu=1.0, offsets=0.0, dtype=np.uint16):
    """Return a 12-bit frame."""
    e = rng.poisson(np.broadcast_to(electrons * prnu, SHAPE)) + READ * rng.standard_normal(SHAPE)
    return np.clip(np.rint(BLACK + gain * e + offsets), 0, 4095).astype(dtype)


def series(rng, *, frames=3, leak=0.0, count=None):
    """Return flats and darks. `leak` is the signal of each pixel without light, in electrons per
    second."""
    prnu, offsets = 1 + 0.005 * rng.standard_normal(SHAPE), 0.5 * rng.standard_normal(SHAPE)
    own = {"prnu": prnu, "offsets": offsets}
    flats, darks = [], []
    for electrons, seconds in zip(ELECTRONS[:count], EXPOSURES, strict=False):
        more = leak * seconds
        flats.append([exposed(rng, electrons + more, **own) for _ in range(frames)])
        darks.append([exposed(rng, more, **own) for _ in range(frames)])
    return flats, darks


def measured(flats, darks, **others):
    times = list(EXPOSURES[: len(flats)])
    return noise.from_frames(flats, darks, times, camera=noise.Camera(bits=12), **others)


def test_light_leaks_are_named_if_darks_become_uneven():
    leak = 400 * np.linspace(0, 1, SHAPE[1]) ** 2
    found = measured(*series(np.random.default_rng(1), leak=leak))
    (said,) = told(SimpleNamespace(measurement=found), "glow")
    # At t s the leak has a standard deviation of K t std(leak).
    uneven = float(said.split("by ")[1].split()[0])
    assert abs(uneven / (K * leak.std()) - 1) < 0.02
    assert "Light leaks in" in said


def test_unequal_dark_current_is_not_a_light_leak():
    rng = np.random.default_rng(2)
    own = rng.exponential(200, SHAPE)
    found = measured(*series(rng, leak=own))
    assert _glow(SimpleNamespace(measurement=found)) is None


@pytest.mark.slow
def test_the_standards_values_are_given_if_the_likelihood_has_no_maximum(monkeypatch):
    def none(*_, **__):
        raise InputError("The best fit is no proper maximum, so it has no standard errors.")

    monkeypatch.setattr(calibrations, "choose_model", none)
    found = noise.calibrate(measured(*series(np.random.default_rng(3))))
    told = section(found)
    gain, missing = (one for one in told.estimates if one.name == "system_gain")
    assert gain.method == "EMVA 1288"
    assert abs(gain.value - K) < 3.5 * gain.standard_error < 0.1 * K
    assert missing.value is None
    assert "no maximum" in missing.reason
    assert any("no proper maximum" in one for one in told.findings)
    assert not told.records
    for picture in told.pictures:
        picture.draw()
    with pytest.raises(InputError, match="no proper maximum"):
        _ = found.chosen


def test_a_pattern_that_fits_no_model_is_not_called_hidden_under_noise():
    """The offsets are 70 DN at 1 s, and the likelihood is fitted to all levels."""
    leak = 400 * np.linspace(0, 1, SHAPE[1]) ** 2
    found = measured(*series(np.random.default_rng(4), leak=leak))
    pattern = fitted_pattern(found, np.arange(len(ELECTRONS)))
    assert not pattern.dark.significant
    assert "more frames do not help" in _why_hidden(pattern, pattern.dark)


def test_a_pattern_below_the_noise_is_called_hidden():
    rng = np.random.default_rng(5)
    levels = [[[exposed(rng, x) for _ in range(2)] for x in own] for own in (ELECTRONS, 8 * [0.0])]
    pattern = fitted_pattern(measured(*levels), np.arange(len(ELECTRONS)))
    for spread in (pattern.dark, pattern.response):
        assert spread.significant or "take more frames" in _why_hidden(pattern, spread)
    assert not pattern.response.significant


def doubted(found):
    return {doubt.of: doubt.sentence for doubt in found.doubts}


def test_afterglow_of_flats_is_not_dark_current():
    """A dark after a flat has a hundredth of its charge, and the next dark half of that."""
    rng = np.random.default_rng(6)
    flats, _ = series(rng)
    darks = [[exposed(rng, 0.01 * x * 0.5**i) for i in range(3)] for x in ELECTRONS]
    ((names, told),) = doubted(measured(flats, darks)).items()
    assert names == ("dark_current_mean", "dark_current_variance", "dark_current")
    assert "afterglow" in told
    # 99 and 66 DN are the first and the third mean of the brightest level: 64 + 35 and 64 + 9 DN.
    first, _, third = (float(x) for x in told.split("means of ")[1].split(" DN")[0].split(","))
    assert abs(first - 99) < 0.2
    assert abs(third - 72.75) < 0.2


def test_levels_of_two_gains_are_named_at_the_break():
    rng = np.random.default_rng(7)
    gains = np.where(np.arange(8) < 4, K, 4 * K)
    own = [(light / (gain / K), gain) for light, gain in zip(ELECTRONS, gains, strict=True)]
    flats = [[exposed(rng, light, gain=gain) for _ in range(2)] for light, gain in own]
    darks = [[exposed(rng, 0.0, gain=gain) for _ in range(2)] for _, gain in own]
    ((names, told),) = doubted(measured(flats, darks)).items()
    assert "system_gain" in names
    assert "up to that of flats[3][0]" in told
    assert "from that of flats[4][0] on" in told
    low, high = (float(told.split(word)[1].split(" DN")[0]) for word in ("signal is ", "[0], and "))
    assert abs(low / K - 1) < 0.05
    assert abs(high / (4 * K) - 1) < 0.05


def test_darks_with_the_cameras_noise_reduction_are_named():
    """The camera subtracts a dark from the fifth exposure on."""
    rng = np.random.default_rng(8)

    def own(i, electrons):
        size = K * READ if i > 3 else 0.0
        return [
            exposed(rng, electrons, offsets=size * rng.standard_normal(SHAPE)) for _ in range(2)
        ]

    flats = [own(i, x) for i, x in enumerate(ELECTRONS)]
    found = measured(flats, [own(i, 0.0) for i in range(8)])
    ((names, told),) = doubted(found).items()
    assert "read_noise" in names
    assert "system_gain" not in names
    assert "up to the level of darks[3][0]" in told
    assert f"from that of darks[4][0] ({EXPOSURES[4]:.3g} s) on" in told


def test_two_gains_in_the_headers_of_fits_files_are_distinguished(tmp_path):
    """GAIN is in the camera's own unit, where 0 is a gain, too."""
    stated = []
    for i, gain in enumerate([0, 0, 0, 120]):
        head = fits.Header({"GAIN": gain})
        fits.PrimaryHDU(np.zeros((4, 4), np.int16), head).writeto(tmp_path / f"{i}.fits")
        stated.append(Stated(f"{i}.fits", tmp_path / f"{i}.fits", 1.0))
    (odd,), _ = odd_heads(tmp_path, stated)
    assert odd.names == ("3.fits",)
    assert odd.reason == "its metadata say GAIN = 120, those of the others GAIN = 0"
    with pytest.raises(InputError, match=r"GAIN = 0, those of 3\.fits GAIN = 120"):
        odd_heads(tmp_path, stated[2:])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.sweep
def test_good_series_cause_no_warning(seed):
    """The series have dark current, a lamp that warms up, and a drifting black level."""
    rng = np.random.default_rng(20 + seed)
    flats, darks = [], []
    for light, seconds in zip(ELECTRONS, EXPOSURES, strict=True):
        drift = rng.normal(0, 0.3, (2, 3))
        warming = 1 + 0.002 * np.arange(3)
        dark = 100 * seconds * seed
        flats.append(
            [
                exposed(rng, light * w + dark, offsets=d)
                for w, d in zip(warming, drift[0], strict=True)
            ]
        )
        darks.append([exposed(rng, dark, offsets=d) for d in drift[1]])
    assert measured(flats, darks).doubts == ()


def moving(rng, frames, *, step=1, prnu=0.03):
    """Return flats and darks where the pixels of odd frames are shifted by some rows."""
    die = 1 + prnu * rng.standard_normal((SHAPE[0] + step, SHAPE[1]))
    own = [die[(i % 2) * step :][: SHAPE[0]] for i in range(frames)]
    flats = [[exposed(rng, x, prnu=p) for p in own] for x in ELECTRONS]
    return flats, [[exposed(rng, 0.0) for _ in range(2)] for _ in ELECTRONS]


def test_frames_between_which_the_camera_moved_are_left_out():
    found = measured(*moving(np.random.default_rng(9), 4))
    signal = found.bright.mean - found.dark.mean
    shot = found.bright.variance - found.dark.variance
    np.testing.assert_allclose(shot / signal, K, rtol=6 * np.sqrt(2 / np.prod(SHAPE)))
    response = fitted_pattern(found, np.arange(len(ELECTRONS))).response
    assert abs(np.sqrt(response.variance) / 0.03 - 1) < 5 / np.sqrt(2 * np.prod(SHAPE))
    (told,) = found.bright.left_out
    assert told.startswith("flats[0][1], flats[0][3], flats[1][1] and 13 more were left out")
    assert "flats[0][0] and flats[0][2]" in told


def test_pairs_between_which_the_camera_moved_are_refused():
    with pytest.raises(InputError, match="the two frames of a level differ by a pattern"):
        measured(*moving(np.random.default_rng(10), 2))


@pytest.mark.parametrize("frames", [2, 5])
def test_unequal_pixels_without_movement_are_not_called_moved(frames):
    found = measured(*moving(np.random.default_rng(11), frames, step=0))
    assert found.bright.left_out == ()


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (np.s_[:, ::2], "32 columns (0, 2, 4, 6, ...), where bit 3 of the codes is always 1"),
        (np.s_[5:7], "rows 5, 6, where bit 3 of the codes is always 1"),
        (np.s_[::2, 1::2], "row and column (0, 1) of every cell of 2 x 2, where bit 3"),
    ],
)
def test_lines_with_a_stuck_bit_are_named_and_left_out(place, said):
    """Bit 3 is always 1. From the other pixels, gain, black level and dark noise are right."""
    flats, darks = series(np.random.default_rng(12))
    for frame in (frame for level in (*flats, *darks) for frame in level):
        frame[place] |= 8
    found = measured(flats, darks)
    (told,) = (one for one in found.remarks if "always" in one)
    assert said in told
    signal = found.bright.mean - found.dark.mean
    shot = found.bright.variance - found.dark.variance
    np.testing.assert_allclose(shot / signal, K, rtol=6 / np.sqrt(float(found.bright.pixels)))
    np.testing.assert_allclose(found.dark.mean, BLACK, atol=0.15)
    np.testing.assert_allclose(found.dark.variance, (K * READ) ** 2 + 1 / 12, rtol=0.15)


@pytest.mark.parametrize("step", [1, 16])
def test_clean_and_left_aligned_numbers_have_no_stuck_bit(step):
    flats, darks = series(np.random.default_rng(13))
    assert stuck_bits([step * one for one in (*flats[-1], *flats[-2], *darks[-1])]) == []


def two_amplifiers(rng, *, gain=0.5, over=400):
    """Return codes of one amplifier below 400 DN, and of another with steps of 16 above."""
    frames = []
    for electrons in (0.0, 60.0, 120.0, 240.0, 400.0, 1500.0, 3000.0, 6000.0):
        e = rng.poisson(electrons, (2, *SHAPE))
        fine = np.rint(BLACK + gain * (e + READ * rng.standard_normal(e.shape)))
        coarse = BLACK + 16 * np.rint(gain * (e + 25 * rng.standard_normal(e.shape)) / 16)
        frames.append(list(np.where(fine < over, fine, coarse).astype(np.uint16)))
    return frames


def test_codes_of_a_second_amplifier_are_named_and_left_out():
    darks, *flats = two_amplifiers(np.random.default_rng(14))
    found = measured(flats, [darks], dark_exposures=[0.1])
    converter = found.converter
    assert (converter.step, converter.coarse_step) == (1.0, 16.0)
    assert 400 <= converter.coarse_from < 800
    np.testing.assert_array_equal(linear_levels(found), range(4))
    (told,) = converter_in_words(converter, 4095.0)
    assert told.startswith(f"From {converter.coarse_from:g} DN on numbers lie 16 apart")


def test_one_amplifier_has_steps_of_one_size():
    flats, darks = series(np.random.default_rng(15))
    every = [frame for level in (*flats, *darks) for frame in level]
    for frames in (every, [16 * frame for frame in every], every[:3]):
        assert converter_of(frames).coarse_from is None


def test_single_precision_numbers_are_divided_by_integers():
    flats, _ = series(np.random.default_rng(16), count=3)
    (told,) = converter_in_words(converter_of([x / 65535 for level in flats for x in level]), 1.0)
    assert "multiple of 1/65535: the frames were divided by 65535" in told


def resized(frame, factor):
    """Return a frame resized by a bicubic filter, as by an export."""
    size = tuple(round(factor * n) for n in frame.shape[::-1])
    image = Image.fromarray(frame.astype(np.float32)).resize(size, Image.Resampling.BICUBIC)
    return np.clip(np.rint(np.asarray(image)), 0, 4095).astype(np.uint16)


@pytest.mark.parametrize(("factor", "every"), [(4 / 3, "fourth"), (2, "second")])
def test_resized_flats_are_not_jpeg_and_get_no_taps(factor, every):
    flats, darks = (
        [[resized(frame, factor) for frame in level] for level in levels]
        for levels in series(np.random.default_rng(17))
    )
    found = measured(flats, darks)
    usable = np.arange(len(ELECTRONS))
    (told,) = processing_in_words(found, usable)
    assert f"less across every {every} row and column, as in frames that were resized" in told
    periodic = periodic_structure(found, usable)
    shown = {"system_gain": SimpleNamespace(value=K, standard_error=0.01)}
    seen = SimpleNamespace(measurement=found, usable=usable, periodic=periodic, gain=K, shown=shown)
    assert not _periodic(seen)


def test_numbers_below_zero_are_refused_by_their_cause():
    flats, darks = series(np.random.default_rng(18), count=3)
    with pytest.raises(InputError, match=r"below 0, down to -\d+, as where a black level was"):
        measured(*([[x.astype(np.int16) - 64 for x in y] for y in z] for z in (flats, darks)))


def table(folder, power):
    """Write exact moments of a camera as a table, with variances raised to a power."""
    variance = K**2 * (ELECTRONS + READ**2)
    rows = [
        f"{e},{e},{BLACK + K * e},{v**power},{BLACK},{(K * READ) ** (2 * power)},4096"
        for e, v in zip(ELECTRONS, variance, strict=True)
    ]
    heads = "photons_per_pixel,exposure_s,mean_bright_DN,var_bright_DN2,mean_dark_DN,var_dark_DN2"
    (folder / "levels.csv").write_text("\n".join([f"{heads},pixels", *rows]))
    return folder / "levels.csv"


def test_standard_deviations_in_a_table_of_variances_are_refused(tmp_path):
    read_table(table(tmp_path, 1), 12)
    with pytest.raises(InputError, match="their squares are, as those of standard deviations"):
        read_table(table(tmp_path, 0.5), 12)


def electron_multiplying(rng, electrons, gain=50.0):
    """Return a frame of an EMCCD with .1 DN per multiplied electron."""
    counts = rng.poisson(electrons, SHAPE)
    behind = np.where(counts > 0, rng.gamma(np.maximum(counts, 1), gain), 0.0)
    return np.rint(500 + 0.1 * (behind + 25 * rng.standard_normal(SHAPE))).astype(np.uint16)


def test_multiplied_electrons_are_named_and_have_no_gain():
    """Each photoelectron gives 5 DN, and variance over signal is 10 DN."""
    rng = np.random.default_rng(19)
    light = np.geomspace(1, 1000, 8)
    flats = [[electron_multiplying(rng, x) for _ in range(2)] for x in light]
    darks = [[electron_multiplying(rng, 0.0) for _ in range(2)]]
    bits = noise.Camera(bits=14)
    found = noise.from_frames(
        flats, darks, [0.01] * 8, list(light / 0.6), camera=bits, dark_exposures=[0.01]
    )
    ((names, told),) = doubted(found).items()
    assert "quantum_efficiency" in names
    half = float(told.split("the codes, which is ")[1].split(" DN")[0])
    assert abs(half / 5 - 1) < 0.05


@pytest.mark.parametrize("gain", [0.5, 5.0])
def test_dim_flats_are_as_skewed_as_poisson_noise(gain):
    rng = np.random.default_rng(20)
    light = np.geomspace(1, 500, 8)
    hot = rng.exponential(2.0, SHAPE)

    def frame(electrons):
        e = rng.poisson(electrons + hot) + READ * rng.standard_normal(SHAPE)
        return np.rint(200 + gain * e).astype(np.uint16)

    levels = [[[frame(x) for _ in range(2)] for x in own] for own in (light, 0 * light)]
    found = noise.from_frames(*levels, [0.01] * 8, list(light), camera=noise.Camera(bits=14))
    assert found.doubts == ()


def ageing(rng, fall, *, flicker=0.0):
    """Return fourteen levels of two frames in turn, under a lamp that falls by a share in total."""
    light, order = np.linspace(300, 7000, 14), iter(np.linspace(0, 1, 28))

    def lit(electrons):
        return exposed(rng, electrons * (1 - fall * next(order)) * (1 + flicker * rng.normal()))

    flats = [[lit(x), lit(x)] for x in light]
    darks = [[exposed(rng, 0.0), exposed(rng, 0.0)] for _ in light]
    times = list(light / light[-1])
    return noise.from_frames(flats, darks, times, camera=noise.Camera(bits=12))


@pytest.mark.slow
def test_a_fading_lamp_is_not_a_curved_response():
    found = noise.calibrate(ageing(np.random.default_rng(20), 0.08))
    gain = found.estimates["system_gain"]
    assert abs(gain.value - K) < 3 * gain.standard_error < 0.03 * K
    assert not any("not linear" in one for one in section(found).findings)


def test_a_fading_lamp_is_named_with_its_rate():
    """The lamp loses 0.08 / 27 of the first frame per frame, which is 0.3084 % of a frame in the
    middle."""
    found = ageing(np.random.default_rng(20), 0.08)
    drift = SimpleNamespace(measurement=found, usable=linear_levels(found))
    (said,) = told(drift, "drifting")
    assert abs(float(said.split("falls by ")[1].split()[0]) - 0.308) < 0.03


@pytest.mark.sweep
@pytest.mark.parametrize("flicker", [0.02, 0.0])
def test_a_lamp_that_flickers_does_not_drift(flicker):
    for seed in range(3):
        found = ageing(np.random.default_rng(seed), 0.0, flicker=flicker)
        assert drifting(found, linear_levels(found)) is None


def own_darks(rng, seconds, current):
    """Return darks of long exposures, whose dark current fills half of the range."""
    return [[exposed(rng, current * t) for _ in range(2)] for t in seconds]


@pytest.mark.slow
@pytest.mark.parametrize("current", [200.0, 4000.0])
def test_a_large_dark_current_is_found_and_does_not_change_the_gain(current):
    rng, seconds = np.random.default_rng(5), [0.01, 0.1, 0.5, 1.0]
    flats = [[exposed(rng, e + 0.01 * current) for _ in range(2)] for e in ELECTRONS]
    darks = own_darks(rng, seconds, current)
    of = {"camera": noise.Camera(bits=12), "dark_exposures": seconds}
    found = noise.calibrate(noise.from_frames(flats, darks, [0.01] * 8, ELECTRONS, **of))
    values, errors = found.chosen.values, found.chosen.errors
    assert abs(float(values["system_gain"]) / K - 1) < 0.03
    off = float(values["dark_current"]) / current - 1
    assert abs(off) < 4 * (errors["dark_current"] / current + errors["system_gain"])


@pytest.mark.slow
def test_settings_with_their_own_steps_are_predicted():
    def frames(rng, iso, step):
        def shot(electrons):
            return step * exposed(rng, electrons, gain=K * iso / 100 / step)

        flats = [[shot(e) for _ in range(2)] for e in ELECTRONS / (iso / 100)]
        darks, of = [[shot(0) for _ in range(2)]], {"dark_exposures": [0.01]}
        of["camera"] = noise.Camera(bits=14)
        measured = noise.from_frames(flats, darks, [0.01] * 8, ELECTRONS / (iso / 100), **of)
        return noise.FramesOfSetting(noise.Setting(iso), measured)

    rng = np.random.default_rng(6)  # the second gain multiplies the first gain's numbers
    camera = noise.calibrate_settings([frames(rng, 100, 1), frames(rng, 400, 4)])
    (one, _), (four, _) = (noise.sensor_at(camera, gain=iso) for iso in (100, 400))
    assert abs(float(four.gain) / float(one.gain) - 1) < 0.03
    assert (float(one.bits), float(four.bits)) == (14, 12)
    for predicted in predict_settings(camera):
        assert not predicted.main_comparison.missed


@pytest.mark.slow
def test_one_level_in_the_linear_range_does_not_affect_the_other_results():
    rng, light = np.random.default_rng(7), np.array([1.0, 2, 5, 10, 20, 40, 600, 7000])
    flats = [[exposed(rng, e) for _ in range(2)] for e in light]
    darks, of = [[exposed(rng, 0) for _ in range(2)]], {"dark_exposures": [0.01]}
    found = noise.from_frames(flats, darks, [0.01] * 8, light, camera=noise.Camera(bits=12), **of)
    sheet = evaluate(found, ranges(found))
    value, error = (float(one["responsivity"]) for one in (sheet.values, sheet.errors))
    assert abs(value - K) < 4 * error < 0.1
    assert np.isfinite(float(sheet.errors["system_gain"]))
    assert not np.isfinite(float(sheet.values["linearity_error_max"]))


@pytest.mark.slow
@pytest.mark.parametrize(("stated", "named"), [(BLACK, False), (BLACK + 100, True)])
def test_a_stated_black_level_that_the_darks_contradict_is_named(stated, named):
    flats, darks = series(np.random.default_rng(8))
    camera = noise.Camera(bits=12, black_level=stated)
    found = noise.from_frames(flats, darks, list(EXPOSURES), camera=camera)
    assert any("states 164 DN, but the darks have 64" in x for x in found.remarks) == named


def under_lamp(rng, lamp, *, bend=0.0, efficiency=0.6, taken=None):
    """Return a calibration of levels of two frames, with a factor of the lamp's light for each."""
    photons = np.linspace(900, 9000, 10)
    gains, top = 1 + 0.01 * rng.standard_normal((64, 96)), K * efficiency * photons[-1]

    def frame(electrons):
        signal = K * rng.poisson(electrons * gains)
        signal = signal * (1 - bend * signal / top) + K * rng.normal(0, 4, gains.shape)
        return np.clip(np.round(signal + 64), 0, 4095).astype(np.uint16)

    flats = [[frame(efficiency * p * x) for _ in "ab"] for p, x in zip(photons, lamp, strict=True)]
    darks = [[frame(0.0) for _ in "ab"] for _ in photons]
    times = list(photons / photons[-1])
    camera = noise.Camera(bits=12)
    found = noise.from_frames(flats, darks, times, list(photons), camera=camera)
    if taken is not None:
        found = replace(found, bright=replace(found.bright, taken=np.asarray(taken, float)))
    return noise.calibrate(found)


ORDER = np.array([4, 7, 0, 9, 2, 5, 8, 1, 6, 3])  # order of the levels in time


@pytest.mark.slow
@pytest.mark.parametrize("lamp", [0.003, 0.01])
def test_file_times_distinguish_a_drift_from_a_curve(lamp):
    """The levels are in random order, and the lamp changes by a share per minute."""
    found = under_lamp(np.random.default_rng(1), 1 + lamp * ORDER, taken=60 * ORDER)
    (said,) = told(found, "drift of the light")
    assert "from the first to the last level, by the times in their files" in said
    change = float(said.split("rises by ")[1].split()[0])
    assert abs(change - 900 * lamp / (1 + 4.5 * lamp)) < 0.25
    assert not told(found, "compression")
    low, high = found.estimates["quantum_efficiency"].interval_95
    assert low < 60 < high


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.015, 0.02])
def test_file_times_distinguish_a_curve_from_a_drift(bend):
    """In the order of the light, both would explain the frames."""
    found = under_lamp(np.random.default_rng(0), np.ones(10), bend=bend, taken=60 * ORDER)
    assert not told(found, "drift or curve")
    assert not told(found, "drift of the light")
    assert found.estimates["linearity_error_min"].value is not None
    assert told(found, "compression")


def test_times_of_files_are_read(tmp_path):
    rng = np.random.default_rng(0)
    lines = ["[camera]", "bits = 12"]
    for kind, electrons in (("flat", ELECTRONS), ("dark", 0 * ELECTRONS)):
        for i, light in enumerate(electrons):
            names = [f"{kind}_{i}_{j}.tif" for j in range(2)]
            for j, name in enumerate(names):
                stamp = f"2026:05:04 10:{(7 * i) % 10:02d}:{j:02d}"
                picture = Image.fromarray(exposed(rng, light))
                picture.save(tmp_path / name, tiffinfo={306: stamp})
            lines += [f"[[{kind}]]", f"files = {names}", f"exposure = {EXPOSURES[i]}"]
    (tmp_path / "rig.toml").write_text("\n".join(lines).replace("'", '"'))
    taken = noise.read_photon_transfer(tmp_path).bright.taken
    wanted = 60.0 * ((7 * np.arange(len(ELECTRONS))) % 10)
    np.testing.assert_allclose(taken, wanted - wanted.min())


@pytest.mark.slow
@pytest.mark.parametrize(("lamp", "key"), [(0.01, "drift of the light"), (0.001, "drift or curve")])
def test_a_lamp_that_drifts_between_levels_is_not_a_curved_response(lamp, key):
    """The lamp gives the stated light at the first level, and a share more at each further one."""
    found = under_lamp(np.random.default_rng(1), 1 + lamp * np.arange(10))
    for name, truth in (("system_gain", K), ("quantum_efficiency", 60.0)):
        low, high = found.estimates[name].interval_95
        assert low < truth < high, found.estimates[name]
    linearity = found.estimates.get("linearity_error_max")
    assert (linearity is None) == (key == "drift of the light")
    if linearity is not None:
        assert linearity.interval_95[0] < 0.01  # %; a maximum of deviations is at least 0
    assert told(found, key)
    assert not told(found, "compression")


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.015, 0.02])
def test_a_curve_that_may_be_a_drift_keeps_its_linearity_error(bend):
    """The reference linearity error is computed by hand: deviations from a line with weights 1 /
    signal^2."""
    found = under_lamp(np.random.default_rng(0), np.ones(10), bend=bend)
    light = np.linspace(900, 9000, 10)
    signal = light * (1 - bend * light / light[-1])
    use = np.asarray(found.within.linearity)
    light, signal = light[use], signal[use]
    line = np.polynomial.Polynomial.fit(light, signal, 1, w=1 / signal)(light)
    by_hand = 100 * np.array([(signal / line - 1).min(), (signal / line - 1).max()])
    assert told(found, "drift or curve")
    np.testing.assert_allclose(steady_linearity(found), by_hand, rtol=0.06)
    for name, truth in zip(("linearity_error_min", "linearity_error_max"), by_hand, strict=True):
        low, high = found.estimates[name].interval_95
        assert low < truth < high


@pytest.mark.slow
def test_a_curved_response_is_not_a_drifting_lamp():
    found = under_lamp(np.random.default_rng(0), np.ones(10), bend=0.1)
    assert not told(found, "drift of the light")
    assert not told(found, "drift or curve")
    efficiency = found.estimates["quantum_efficiency"]
    assert abs(efficiency.value - 60) < 3 * efficiency.standard_error < 1.2


@pytest.mark.slow
def test_levels_of_a_wandering_lamp_give_larger_errors_than_independent_ones():
    wander = 1 + 0.01 * np.array([0.0, 1.0, 2.0, 2.0, 1.0, 0.0, -1.0, -2.0, -2.0, -1.0])
    found = under_lamp(np.random.default_rng(0), wander)
    assert told(found, "lights that drift") or told(found, "drift of the light")
    assert found.estimates["quantum_efficiency"].standard_error > 0.6  # 1 % of 60 %
    mixed = wander[[2, 7, 1, 6, 3, 8, 0, 9, 4, 5]]
    found = under_lamp(np.random.default_rng(0), mixed)
    assert not told(found, "lights that drift")
    assert found.estimates["quantum_efficiency"].standard_error < 0.6


@pytest.mark.sweep("lit-7", "saturated-7")
@pytest.mark.parametrize("place", [0, 3, 7])
@pytest.mark.parametrize("what", ["saturated", "lit"])
def test_only_the_dark_level_with_light_is_left_out(place, what):
    """The flats of its exposure stay, and use the darks of the nearest exposure."""
    rng, light = np.random.default_rng(place), np.linspace(500, 4000, 8)
    flats, darks = ([[exposed(rng, x) for _ in "ab"] for x in of] for of in (light, 0 * light))
    full = np.full_like(darks[0][0], 4095)
    darks[place] = [full, full] if what == "saturated" else [exposed(rng, 3000.0) for _ in "ab"]
    times = list(light / light[-1])
    found = noise.from_frames(flats, darks, times, list(light), camera=noise.Camera(bits=12))
    (said,) = found.dark.left_out
    assert f"darks[{place}][0] and darks[{place}][1] were left out" in said
    assert ("100 % of the pixels are saturated" if what == "saturated" else "a line over") in said
    assert found.bright.left_out == ()
    assert len(found.bright.mean) == 8
    assert len(found.dark.mean) == 7
    gain = float(np.sum(shot_of(found)) / np.sum(signal_of(found)))
    assert abs(gain / K - 1) < 0.02


def test_saturated_darks_of_a_large_dark_current_are_left_out():
    """The last of ten darks has .5 · 8500 + 64 DN, where 4095 is full scale."""
    rng, seconds = np.random.default_rng(1), np.linspace(0.1, 1.0, 10)
    flats = [[exposed(rng, e) for _ in "ab"] for e in ELECTRONS]
    darks = own_darks(rng, seconds, 8500.0)
    of = {"camera": noise.Camera(bits=12), "dark_exposures": list(seconds)}
    found = noise.from_frames(flats, darks, [0.01] * 8, list(ELECTRONS), **of)
    (said,) = found.dark.left_out
    assert "are saturated, though they are darks" in said
    assert len(found.dark.mean) == 9


@pytest.mark.slow
def test_dim_flats_of_12_bits_are_calibrated():
    """All codes are below 256."""
    rng, light = np.random.default_rng(5), np.linspace(20, 200, 8)
    flats, darks = ([[exposed(rng, x) for _ in "ab"] for x in of] for of in (light, 0 * light))
    camera = noise.Camera(bits=12)
    found = noise.calibrate(
        noise.from_frames(flats, darks, list(light / 200), list(light / 0.5), camera=camera)
    )
    gain = found.estimates["system_gain"]
    assert abs(gain.value - K) < 3 * gain.standard_error < 0.06 * K
    (said,) = told(found, "dim flats")
    assert "DN of 4095" in said
