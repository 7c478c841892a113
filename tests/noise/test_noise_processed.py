"""Tests what a camera's prediction says about processed frames, and about other dies of the same
camera."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import jaxvision as jv
from fitting.noise import Camera, calibrate, from_frames, predict
from fitting.noise.doubts import drifting
from fitting.noise.findings import _dark_noises
from fitting.noise.findings import findings as findings_of
from fitting.noise.levels import linear_levels
from fitting.noise.prediction.section import findings
from jaxvision.errors import InputError

GAIN, EFFICIENCY, READ, BLACK, CURRENT, PRNU, DSNU = 0.4, 0.6, 5.0, 64.0, 40.0, 0.01, 2.0
PHOTONS, SECONDS = np.linspace(600.0, 14_000.0, 8), np.linspace(0.01, 0.14, 8)
SENSOR = jv.Sensor(
    shot_noise=jv.PoissonShotNoise(),
    quantum_efficiency=EFFICIENCY,
    read_noise=READ,
    dark_current=CURRENT,
    prnu=PRNU,
    dsnu=DSNU,
    gain=GAIN,
    offset=BLACK,
    bits=12,
)

SENSOR_OF_UNEQUAL_PIXELS = replace(SENSOR, prnu=0.05, dsnu=20.0)


def series(
    seed,
    process=lambda one: one(),
    *,
    gain=GAIN,
    size=64,
    light=1.0,
    prnu=PRNU,
    dsnu=DSNU,
    shading=1.0,
    count=4,
    lamp=lambda number: 1.0,
):
    """Return flats and darks of `count` frames. `process` gets a function that returns the next
    frame."""
    rng = np.random.default_rng(seed)
    gains, offsets = (
        1 + prnu * rng.normal(size=(size, size)),
        dsnu * rng.normal(size=(size, size)),
    )

    taken = itertools.count()

    def level(photons, seconds):
        def frame():
            now = photons * lamp(next(taken))
            charge = rng.poisson(EFFICIENCY * now * gains * shading + CURRENT * seconds)
            charge = charge + offsets + READ * rng.normal(size=gains.shape)
            return np.clip(np.round(gain * charge + BLACK), 0, 4095)

        return [process(frame) for _ in range(count)]

    flats = [level(*at) for at in zip(light * PHOTONS, SECONDS, strict=True)]
    return flats, [level(0.0, seconds) for seconds in SECONDS]


def predicted(flats, darks, *, bits=12, seconds=SECONDS, sensor=SENSOR):
    made = from_frames(flats, darks, list(seconds), list(PHOTONS), camera=Camera(bits=bits))
    return predict(sensor, made)


def smoothed(frame):
    return np.round(ndimage.gaussian_filter(frame(), 0.6))


def binned(frame):
    return np.round(frame().reshape(32, 2, 32, 2).mean((1, 3)))


@pytest.mark.sweep("smoothed", "sharpened")
@pytest.mark.parametrize(
    ("process", "keys", "words"),
    [
        (
            lambda frame: np.round(np.mean([frame() for _ in range(4)], axis=0)),
            {"all_noise"},
            r"or in means of (3\.[89]|4\.0)\d* ± ",
        ),
        (binned, {"all_noise"}, r"or in means of (3\.[89]|4\.0)\d* ± "),
        (
            smoothed,
            {"all_noise", "filter_along_rows", "filter_along_columns"},
            "as in frames that were smoothed",
        ),
        (
            lambda frame: np.round(2 * (one := frame()) - ndimage.uniform_filter(one, 3)),
            {"all_noise", "filter_along_rows", "filter_along_columns"},
            "as in frames that were sharpened",
        ),
    ],
    ids=["averaged", "binned", "smoothed", "sharpened"],
)
def test_filtered_noise_is_named(process, keys, words):
    found = predicted(*series(1, process))
    named = {one.key for one in found.missing}
    assert keys <= named
    assert not {"gain", "light", "shot_noise", "black_level"} & named
    assert any(re.search(words, one) for one in findings(found))


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
def test_another_die_is_predicted_within_the_spread_of_its_pixels(seed):
    """Means of gains and offsets over 64 x 64 pixels deviate by 1/64 of PRNU and DSNU."""
    found = predicted(*series(10 + seed, prnu=0.05, dsnu=20.0), sensor=SENSOR_OF_UNEQUAL_PIXELS)
    assert found.main_comparison.missed == []
    of_means = found.main_comparison.camera[:16, :16]
    signal = np.where(
        np.asarray(found.main_comparison.lit.lit), found.main_comparison.found.by_light[0], 0.0
    )
    by_hand = (np.outer(signal, signal) * 0.05**2 + (GAIN * 20.0) ** 2) / 64**2
    np.testing.assert_allclose(of_means, by_hand, rtol=1e-6)


@pytest.mark.slow
def test_a_gain_of_twice_the_stated_one_has_its_size():
    """The gain is found also with .8 of the stated light."""
    for stated in (1.0, 2.5):
        frames = series(2, gain=2 * GAIN, light=0.4)
        made = from_frames(
            *frames, list(SECONDS), list(0.4 * stated * PHOTONS), camera=Camera(bits=12)
        )
        told = " ".join(one.clause for one in predict(SENSOR, made).missing)
        (size,) = re.findall(r"a gain larger by (\S+) ±", told)
        assert float(size) == pytest.approx(100, abs=1.5)
        lost = re.findall(r"(\S+) ± \S+ % less light", told)
        assert len(lost) == (stated > 1)
        for one in lost:
            assert float(one) == pytest.approx(100 * (1 - 1 / stated), abs=1.5)


def test_frames_divided_by_a_flat_are_named():
    flats, darks = series(3)
    gains = np.mean(flats[-1], axis=0) - np.mean(darks[-1], axis=0)
    gains = gains / gains.mean()
    flats = [[np.round(BLACK + (one - BLACK) / gains) for one in x] for x in flats]
    assert any("as after a division by a flat" in one for one in findings(predicted(flats, darks)))


def test_subtracted_darks_are_named():
    flats, darks = series(4)
    own = [np.round(np.mean(level, axis=0)) - BLACK for level in darks]
    flats, darks = (
        [[one - black for one in x] for x, black in zip(levels, own, strict=True)]
        for levels in (flats, darks)
    )
    (found,) = predicted(flats, darks).missing
    assert found.key == "dark_subtraction"


@pytest.mark.slow
def test_frames_of_converted_numbers_are_named():
    flats, darks = series(5)
    for change, bits, words in (
        (lambda x: x // 16, 8, "8, as a copy of fewer bits"),
        (lambda x: 4 * x + np.arange(64) % 4, 14, "14, as the sum of frames or pixels"),
        (lambda x: x + np.arange(64) % 4 / 4, 12, r"multiples of 1/4, as in means of 4 frames"),
        (lambda x: 2 * (x // 2), 12, r"their values are multiples of 2"),
    ):
        own = [[[change(one) for one in level] for level in x] for x in (flats, darks)]
        with pytest.raises(InputError, match=words):
            predicted(*own, bits=bits)


def test_exposures_in_another_unit_and_clipped_black_are_named():
    flats, darks = series(6)
    told = findings(predicted(flats, darks, seconds=100 * SECONDS))
    assert any("exposures may be in another unit than seconds" in one for one in told)
    flats, darks = ([[np.maximum(one - BLACK, 0) for one in x] for x in y] for y in (flats, darks))
    told = findings(predicted(flats, darks))
    assert any("black was subtracted, and numbers below 0 became 0" in one for one in told)


def test_frames_that_are_left_out_are_named():
    flats, darks = series(7)
    flats[3][1] = flats[6][1]
    told = findings(predicted(flats, darks))
    assert any(one.startswith("flats[3][1] was left out") for one in told)


def test_a_temperature_dependent_dark_current_uses_its_temperature():
    """At the reference temperature Arrhenius' law gives the rate itself."""
    law = jv.ArrheniusDarkCurrent(CURRENT, 300.0, 300.0, 0.6)
    frames = series(11)
    plain, warm = (
        predicted(*frames, sensor=s) for s in (SENSOR, replace(SENSOR, dark_current=law))
    )
    assert findings(warm) == findings(plain)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"prnu": 0.02},
            r"gains of neighbouring pixels differ by (2|2\.\d|1\.9) % rms, where .* 1 %",
        ),
        ({"prnu": 0.005}, r"gains of the pixels differ by less than 0\.5\d? % rms, where .* 1 %"),
        (
            {"dsnu": 6.0},
            r"offsets of neighbouring pixels differ by (5\.\d|6|6\.\d) e⁻ rms, where .* 2",
        ),
    ],
)
def test_another_spread_of_gains_or_offsets_is_named(changed, words):
    """A larger spread is also found under light that falls by half, which adds to a frame's
    spread."""
    for light in (1.0, np.linspace(1.0, 0.5, 64))[: 1 + ("less" not in words)]:
        found = findings(predicted(*series(1, shading=light, **changed)))
        assert sum("pixels differ" in one for one in found) == 1
        assert any(re.search(words, one) for one in found)


def test_uneven_light_is_not_a_spread_of_gains():
    found = findings(predicted(*series(3, shading=np.linspace(1.0, 0.5, 64))))
    assert not any("pixels differ" in one for one in found)


@pytest.mark.parametrize("count", [2, 4])
def test_means_that_were_rounded_again_are_explained(count):
    found = predicted(*series(1, lambda one: np.round(np.mean([one() for _ in range(count)], 0))))
    (missing,) = found.missing
    assert missing.after["variances"].ratio < 2
    (number, error) = map(float, re.search(r"means of (\S+) ± (\S+)", missing.clause).groups())
    assert abs(number - count) < 3 * error


@pytest.mark.slow
@pytest.mark.parametrize("lowest", [62, 65])
def test_black_that_was_clipped_above_0_is_predicted(lowest):
    """The camera's own code 0 is below the clipping level."""
    frames = series(1)
    found = predicted(*([[np.maximum(one, lowest) for one in x] for x in y] for y in frames))
    assert found.main_comparison.missed == []
    assert any(f"No value of the darks is below {lowest} DN" in one for one in findings(found))


def test_unequal_columns_of_later_frames_are_named():
    odd = np.arange(64) % 2
    frames = ([[one + 3 * odd for one in x] for x in y] for y in series(1))
    told = " ".join(findings(predicted(*frames)))
    assert re.search(r"Even and odd columns differ in black level by (2\.9|3\.0)\d* DN", told)


@pytest.mark.parametrize("where", ["left and right", "top and bottom"])
def test_halves_of_unequal_gain_are_named(where):
    """A step of the signal shows them where variances alone do not."""
    gains = np.where(np.arange(64) < 32, GAIN, 1.03 * GAIN)
    gains = gains if where == "left and right" else gains[:, None]
    told = " ".join(findings(predicted(*series(3, gain=gains, count=2))))
    (size,) = re.findall(rf"The {where} halves differ in signal by (\S+) %", told)
    assert float(size) == pytest.approx(3, abs=0.3)
    assert "a mean over all of these pixels" in told


@pytest.mark.slow
def test_vignetting_is_not_named_as_unequal_halves():
    """The light falls by 70 %, off centre, or to one side."""
    rows, columns = np.mgrid[-1:1:64j, -1:1:64j]
    for shading in (
        1 - 0.35 * ((rows - 0.2) ** 2 + (columns + 0.1) ** 2),
        (1 + 0.3 * columns) * (1 - 0.2 * rows**2),
    ):
        told = findings(predicted(*series(4, shading=shading)))
        assert not any("halves" in one or "quarters" in one for one in told)


@pytest.mark.slow
def test_photons_in_another_unit_are_named():
    """They are per second instead of per exposure, or a thousand times too many."""
    frames, camera = series(1, count=2), Camera(bits=12)
    with pytest.raises(InputError, match="so they are stated per second; give photons per pixel"):
        from_frames(*frames, list(SECONDS), list(PHOTONS / SECONDS), camera=camera)
    with pytest.raises(InputError, match=r"signal falls from .* the photons of the levels are in"):
        from_frames(*frames, list(SECONDS), list(PHOTONS[::-1]), camera=camera)
    for scale in (1, 100, 1000):
        made = from_frames(*frames, list(SECONDS), list(scale * PHOTONS), camera=camera)
        told = findings_of(calibrate(made))
        assert sum("the light is stated too high" in one for one in told) == (scale > 1)


@pytest.mark.slow
def test_levels_that_saturate_in_a_part_of_the_frame_are_not_used():
    """The light rises by 30 % to one side. The mean is 10 standard deviations below the end of the
    range."""
    flats, darks = series(3, shading=1 + np.linspace(-0.3, 0.3, 64), count=2)
    measured = from_frames(flats, darks, list(SECONDS), list(PHOTONS), camera=Camera(bits=12))
    assert measured.clear.all()
    assert float(measured.bright.ended[-1]) == np.mean(np.array(flats[-1]) == 4095)
    found, told = calibrate(measured), predict(SENSOR, measured)
    assert {*range(6)} <= {*found.usable.tolist()} <= {*range(7)}
    gain = found.estimates["system_gain"]
    assert abs(gain.value - GAIN) < 3 * gain.standard_error < 0.015
    for sentences in (findings_of(found), findings(told)):
        assert any("1 level is not used because a part of the pixels" in one for one in sentences)
        assert not any("lens shading" in one for one in sentences)
    assert told.main_comparison.missed == []


def transfer(gain_of_darks, *, current=0.0, size=128, count=4, seed=0):
    """Return flats of 8 levels of one lamp, with darks of another gain and dark current (e⁻/s)."""
    rng = np.random.default_rng(seed)

    def frames(signal, gain):
        electrons = rng.poisson(signal, (count, size, size)) + rng.normal(
            0, READ, (count, size, size)
        )
        return list(np.round(gain * electrons + BLACK).astype(np.uint16))

    times = PHOTONS / 1e5
    flats = [frames(EFFICIENCY * light + current * light / 1e5, GAIN) for light in PHOTONS]
    darks = [frames(current * time, gain_of_darks) for time in times]
    return from_frames(flats, darks, list(times), list(PHOTONS), camera=Camera(bits=12))


@pytest.mark.parametrize("ratio", [0.4, 1.6])
def test_darks_of_another_gain_are_named_by_their_noise(ratio):
    made = transfer(ratio * GAIN, size=160)
    found = _dark_noises(made, linear_levels(made))
    assert found["differ"]
    np.testing.assert_allclose(found["darks"], np.hypot(ratio * GAIN * READ, 12**-0.5), rtol=0.01)
    np.testing.assert_allclose(found["flats"], np.hypot(GAIN * READ, 12**-0.5), rtol=0.25)


def test_darks_of_the_same_camera_have_the_noise_of_its_flats():
    for seed in range(2):
        made = transfer(GAIN, size=64, seed=seed)
        found = _dark_noises(made, linear_levels(made))
        assert not found["differ"]
        assert 1.0 < found["factor"] < 2.0


@pytest.mark.slow
def test_the_share_of_dark_current_in_the_signal_is_reported():
    """The dark current is a tenth of the signal of the light."""
    current = 0.1 * EFFICIENCY * 1e5
    told = " ".join(findings_of(calibrate(transfer(GAIN, current=current, size=64))))
    assert "Dark current gives 10 % of the signal of the light" in told
    assert "Dark current gives" not in " ".join(findings_of(calibrate(transfer(GAIN, size=64))))


@pytest.mark.slow
def test_a_lamp_that_warms_up_is_not_a_curved_response():
    """The lamp rises by 6 %, with a time constant of 10 frames."""
    flats, darks = series(1, lamp=lambda number: 1 - 0.06 * np.exp(-number / 10))
    made = from_frames(flats, darks, list(SECONDS), list(PHOTONS), camera=Camera(bits=12))
    found = drifting(made, linear_levels(made))
    mean = 0.06 * (1 - np.exp(-32 / 10)) / 32
    assert found.share == pytest.approx(mean, abs=4 * found.error + 0.05 * mean)
    calibration = calibrate(made)
    gain = calibration.estimates["system_gain"]
    assert abs(gain.value - GAIN) < 3 * gain.standard_error < 0.01
    told = " ".join(findings_of(calibration))
    assert "as when a lamp or a camera warms up" in told
    assert "not linear: the gain" not in told


@pytest.mark.sweep
@pytest.mark.parametrize("flicker", [0.0, 0.001, 0.01])
def test_flicker_is_not_called_warming_up(flicker):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        frames = series(seed, lamp=lambda number, rng=rng: 1 + flicker * rng.normal())
        made = from_frames(*frames, list(SECONDS), list(PHOTONS), camera=Camera(bits=12))
        assert drifting(made, linear_levels(made)) is None


@pytest.mark.slow
def test_exposures_that_may_be_milliseconds_are_named():
    flats, darks = series(6, count=2)
    for scale in (1, 1000):
        times = list(scale * SECONDS)
        made = from_frames(flats, darks, times, list(PHOTONS), camera=Camera(bits=12))
        told = [one for one in findings_of(calibrate(made)) if "read as seconds" in one]
        assert len(told) == (scale > 1)
    (current,) = re.findall(r"the dark current is (\S+) e⁻/s, not", told[0])
    assert float(current) == pytest.approx(CURRENT, abs=3)


def test_inverted_numbers_are_named():
    flats, darks = ([[4095 - one for one in x] for x in y] for y in series(1))
    for frames in ((flats, darks), series(1)[::-1]):
        with pytest.raises(InputError, match="every flat is darker than its darks"):
            predicted(*frames)
