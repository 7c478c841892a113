"""Tests that frames that do not belong are named and left out, and that the others give the
camera."""

import io
from fractions import Fraction
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from fitting.frame_checks.frame import frame_sample
from fitting.frame_checks.levels import odd_frames
from fitting.joint import from_photographs as joint_photographs
from fitting.noise import Camera, calibrate, from_frames, read_photon_transfer
from fitting.noise.findings import is_no_sensor, processing
from fitting.noise.levels import linear_levels
from fitting.noise.raw_frames import processing_in_words, tone_curve
from fitting.reflectance.from_images.read import read_reflectance_observation
from fitting.response import from_stack
from fitting.response.read import read_exposure_stack
from fitting.rig import SphereGeometry
from jaxvision.errors import InputError

GAIN, BLACK, READ_NOISE, FULL = 0.4, 64.0, 2.3, 4095
ELECTRONS = np.linspace(250, 9000, 14)
TIMES = np.linspace(0.0005, 0.02, 14)


def frame(electrons, seed):
    """Return a 12-bit frame, (64, 64)."""
    rng = np.random.default_rng(seed)
    counted = rng.poisson(electrons, (64, 64)) + rng.normal(0, READ_NOISE, (64, 64))
    return np.clip(np.round(GAIN * counted + BLACK), 0, FULL).astype(np.uint16)


FLATS = [[frame(x, 2 * i), frame(x, 2 * i + 1)] for i, x in enumerate(ELECTRONS)]
DARKS = [[frame(0, 100 + 2 * i), frame(0, 101 + 2 * i)] for i in range(14)]


def read(flats=FLATS, darks=DARKS):
    return from_frames(flats, darks, list(TIMES), ELECTRONS / 0.6, camera=Camera(bits=12))


def put(frames, **by_place):
    """Return the frames with those named by `l6_1` and the like replaced."""
    changed = [list(level) for level in frames]
    for place, image in by_place.items():
        level, i = place[1:].split("_")
        changed[int(level)][int(i)] = image
    return changed


WHITE = np.full((64, 64), FULL, np.uint16)


def hand(image):
    """Return the image with a corner covered by a hand. No pixel is brighter."""
    covered = image.astype(float)
    covered[:16, :20] = BLACK + 0.4 * (covered[:16, :20] - BLACK)
    return covered.round().astype(np.uint16)


def averaged(level):
    return np.mean([frame(ELECTRONS[level], 500 + i) for i in range(16)], 0).round().astype(int)


def test_frames_that_belong_are_all_used():
    measured = read()
    assert measured.bright.left_out == measured.dark.left_out == ()


@pytest.mark.parametrize("spread", [0.01, 0.05])
def test_a_flickering_lamp_is_no_bad_frame(spread):
    rng = np.random.default_rng(3)
    light = ELECTRONS[:, None] * (1 + spread * rng.standard_normal((14, 2)))
    flickering = [[frame(x, 300 + i), frame(y, 320 + i)] for i, (x, y) in enumerate(light)]
    assert read(flickering).bright.left_out == ()


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (WHITE, "100 % of its pixels are saturated"),
        (np.zeros((64, 64), np.uint16), "100 % of its pixels are 0 DN"),
        (frame(0, 7), "its mean is 6"),
        (frame(1.1 * ELECTRONS[6], 7), "its mean is 19"),
        (hand(FLATS[6][1]), "left out: it"),
        (FLATS[6][0], "equal to flats[6][0] in every pixel"),
        (FLATS[7][1], "its mean is"),
    ],
)
def test_a_deviating_flat_is_named_and_its_level_left_out(image, words):
    measured = read(put(FLATS, l6_1=image))
    first, second = measured.bright.left_out
    assert first.startswith("flats[6][1] was left out: ")
    assert words in first
    assert second == "flats[6][0] was left out: it is the only remaining frame of its level."
    np.testing.assert_allclose(measured.bright.light, np.delete(ELECTRONS, 6) / 0.6)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (WHITE, "saturated"),
        (frame(1.1 * ELECTRONS[6], 7), "its mean"),
        (hand(FLATS[6][1]), "its mean"),
        (averaged(6), "times the variance"),
        (FLATS[6][0], "equal to flats[6][0]"),
    ],
)
@pytest.mark.sweep
def test_of_five_frames_only_the_deviating_one_is_left_out(image, words):
    five = [
        [*level, *(frame(x, 900 + 3 * i + k) for k in range(3))]
        for i, (level, x) in enumerate(zip(FLATS, ELECTRONS, strict=True))
    ]
    told, *others = read(put(five, l6_3=image)).bright.left_out
    assert others == []
    assert told.startswith("flats[6][3] was left out: ")
    assert words in told


@pytest.mark.slow
def test_the_gain_without_the_frame_is_the_cameras():
    found = calibrate(read(put(FLATS, l6_1=WHITE))).estimates["system_gain"]
    assert abs(found.value - GAIN) < 3 * found.standard_error
    assert found.standard_error < 0.004


def test_a_level_that_saturates_between_others_is_named():
    measured = read(put(FLATS, l6_0=WHITE, l6_1=WHITE))
    (told,) = measured.bright.left_out
    assert told.startswith("flats[6][0] and flats[6][1] were left out: 100 % of the pixels are sat")


@pytest.mark.sweep
@pytest.mark.parametrize("pair", [(6, 9), (6, 7), (1, 13)])
def test_levels_whose_light_is_exchanged_are_named(pair):
    swapped = list(FLATS)
    swapped[pair[0]], swapped[pair[1]] = swapped[pair[1]], swapped[pair[0]]
    (told,) = read(swapped).bright.left_out
    assert all(f"flats[{i}][0]" in told for i in pair)
    assert "fit the other levels if their light is exchanged" in told


def test_two_averaged_frames_are_named_by_the_levels_beside_them():
    (told,) = read(put(FLATS, l6_0=averaged(6), l6_1=averaged(6)[::-1])).bright.left_out
    assert told.startswith(
        "flats[6][0] and flats[6][1] were left out: the variance of their difference"
    )


def test_a_dark_with_light_is_named():
    first, second = read(darks=put(DARKS, l3_1=frame(100, 7))).dark.left_out
    assert first.startswith("darks[3][1] was left out: its mean is 10")
    assert second.startswith("darks[3][0] was left out: it is the only remaining frame")


def test_contradicting_halves_are_left_to_the_user():
    bad = [[a, np.full_like(a, FULL)] for a, _ in FLATS]
    with pytest.raises(InputError, match=r"half of its 28 frames.*flats\[0\].*Keep those"):
        read(bad)


def test_saturating_levels_at_the_end_are_not_left_out():
    rng = np.random.default_rng(0)
    light = np.geomspace(100, 40000, 14)

    def saturating(x):
        electrons = np.minimum(rng.poisson(x, (64, 64)), 9000) + rng.normal(0, 2.3, (64, 64))
        return np.clip(np.round(GAIN * electrons + BLACK), 0, FULL).astype(np.uint16)

    flats = [[saturating(x), saturating(x)] for x in light]
    measured = from_frames(flats, DARKS, list(TIMES), light, camera=Camera(bits=12))
    assert measured.bright.left_out == ()
    assert all(a < b for a, b in pairwise(measured.bright.light.tolist()))


def test_darks_without_the_offset_of_the_flats_are_refused():
    subtracted = [[np.clip(d.astype(int) - 64, 0, None) for d in level] for level in DARKS]
    with pytest.raises(InputError, match=r"6\d.* DN by their light, but the darks have 0\.3\d+ DN"):
        read(darks=subtracted)
    flats = [[np.clip(f.astype(int) - 64, 0, None) for f in level] for level in FLATS]
    with pytest.raises(InputError, match=r"by their light, but the darks have 64 DN"):
        read(flats)


@pytest.mark.slow
def test_a_bias_of_no_exposure_and_stray_light_are_read():
    """Stray light of 300 electrons enters in every exposure, including zero time."""
    lit = [0.0, *TIMES[1:]]
    stray = [[frame(300 + 4.5e5 * t, 60 + 2 * i + k) for k in (0, 1)] for i, t in enumerate(lit)]
    kept = [DARKS[0], *DARKS[1:]]
    given = {"camera": Camera(bits=12), "dark_exposures": lit}
    measured = from_frames(stray, kept, lit, None, **given)
    assert measured.bright.left_out == ()
    found = calibrate(measured)
    gain = found.estimates["system_gain"]
    assert abs(gain.value - GAIN) < 3 * gain.standard_error


BRACKET = [1 / 64, 1 / 16, 1 / 4, 1, 4]


def scene(seconds, seed=0):
    """Return an image, (60, 80), of a 12-bit linear camera: two decades of light and a pattern."""
    patches = np.kron(np.random.default_rng(seed).standard_normal((6, 8)), np.ones((10, 10)))
    light = np.geomspace(1, 300, 80) * np.exp(0.5 * patches)
    rng = np.random.default_rng(int(1000 * seconds) + seed)
    counted = rng.poisson(light * seconds * 40) / 4 + rng.normal(0, 2, light.shape)
    return np.clip(np.round(60 + counted), 0, 4095).astype(np.uint16)


STACK = [scene(t) for t in BRACKET]


def stack(images=STACK, times=BRACKET):
    return from_stack(images, times, camera=Camera(bits=12, black_level=60.0))


def left_out(stack):
    return [told for told in stack.remarks if "left out" in told]


def test_a_bracket_of_one_scene_is_used_whole():
    assert left_out(stack()) == []
    assert len(stack().planes[0].exposures) == 5


@pytest.mark.parametrize("pair", [(1, 2), (1, 3), (0, 4), (3, 4)])
def test_exchanged_times_are_named(pair):
    images = list(STACK)
    images[pair[0]], images[pair[1]] = images[pair[1]], images[pair[0]]
    found = stack(images)
    assert [told.split()[0] for told in left_out(found)] == [f"images[{i}]" for i in pair]
    assert all("check the order of the times" in told for told in left_out(found))
    assert len(found.planes[0].exposures) == 3


def test_an_image_of_another_scene_is_named():
    found = stack([*STACK[:2], scene(1 / 4, seed=5)[:, ::-1], *STACK[3:]])
    (told,) = left_out(found)
    assert told.startswith(
        "images[2] was left out: the brightness order of its pixels matches no other image"
    )
    assert found.planes[0].files == tuple(f"images[{i}]" for i in (0, 1, 3, 4))


def test_a_saturated_image_is_named():
    (told,) = left_out(stack([*STACK[:4], np.full((60, 80), 4095, np.uint16)]))
    assert told.startswith("images[4] was left out: every pixel is saturated")


def test_two_contradicting_images_are_left_to_the_user():
    with pytest.raises(InputError, match=r"images\[1\] is darker than images\[0\].*Keep those"):
        stack(STACK[3:][::-1], [1, 4])


def with_head(file, image, *, iso=100, seconds=1.0):
    """Write an 8-bit JPEG with this EXIF."""
    exif = Image.Exif()
    time = IFDRational(Fraction(seconds).limit_denominator(1000))
    exif[0x8769] = {0x829A: time, 0x8827: iso}
    Image.fromarray(image).save(file, exif=exif, quality=100)


def test_exposures_with_contradicting_headers_are_named(tmp_path):
    entries = ["[camera]", "bits = 8"]
    for i, t in enumerate(BRACKET):
        image = np.clip(scene(t) / 16.0, 0, 255).round().astype(np.uint8)
        iso, seconds = (400 if i == 1 else 100), (t / 4 if i == 3 else t)
        with_head(tmp_path / f"{i}.jpg", image, iso=iso, seconds=seconds)
        entries += ["[[exposure]]", f'file = "{i}.jpg"', f"exposure = {t}"]
    (tmp_path / "rig.toml").write_text("\n".join(entries))
    found = read_exposure_stack(tmp_path)
    assert sorted(left_out(found)) == [
        "1.jpg was left out: its metadata say ISO 400, those of the others ISO 100.",
        "3.jpg was left out: its metadata say an exposure of 0.25 s, the rig 1 s.",
    ]
    assert found.planes[0].files == ("0.jpg", "2.jpg", "4.jpg")


def test_headers_of_two_gains_are_left_to_the_user(tmp_path):
    entries = ["[camera]", "bits = 8"]
    for i, iso in enumerate((100, 400)):
        image = np.clip(scene(BRACKET[i + 2]) / 16.0, 0, 255).round().astype(np.uint8)
        with_head(tmp_path / f"{i}.jpg", image, iso=iso, seconds=BRACKET[i + 2])
        entries += ["[[exposure]]", f'file = "{i}.jpg"', f"exposure = {BRACKET[i + 2]}"]
    (tmp_path / "rig.toml").write_text("\n".join(entries))
    with pytest.raises(InputError, match=r"0\.jpg say ISO 100, those of 1\.jpg ISO 400"):
        read_exposure_stack(tmp_path)


def test_a_light_that_was_taken_at_another_gain_is_named(tmp_path):
    y, x = (np.mgrid[:40, :40] - 19.5) / 18.0
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    entries = ["[camera]", "bits = 8", "[geometry]"]
    entries += ["sphere = { centre = [19.5, 19.5], radius = 18.0 }"]
    for i, toward in enumerate([(0.6, 0, 0.8), (-0.6, 0, 0.8), (0, 0.6, 0.8), (0, 0, 1)]):
        shade = np.clip(x * toward[0] - y * toward[1] + z * toward[2], 0, 1)
        image = np.where(z > 0, 200 * shade, 0).astype(np.uint8)
        with_head(tmp_path / f"{i}.jpg", image, iso=800 if i == 2 else 100)
        entries += ["[[light]]", f'file = "{i}.jpg"', f"direction = {list(toward)}"]
    (tmp_path / "rig.toml").write_text("\n".join(entries))
    found = read_reflectance_observation(tmp_path)
    assert found.files == ("0.jpg", "1.jpg", "3.jpg")
    assert found.findings[0] == (
        "2.jpg was left out: its metadata say ISO 800, those of the others ISO 100."
    )


def test_different_exposures_of_lights_are_named(tmp_path):
    """The rig's lights have no exposure time, so the estimated intensities include it."""
    entries = ["[camera]", "bits = 8", "[geometry]"]
    entries += ["sphere = { centre = [19.5, 19.5], radius = 18.0 }"]
    for i, toward in enumerate([(0.6, 0, 0.8), (-0.6, 0, 0.8), (0, 0.6, 0.8), (0, 0, 1)]):
        with_head(tmp_path / f"{i}.jpg", np.full((40, 40), 90, np.uint8), seconds=1 + i % 2)
        entries += ["[[light]]", f'file = "{i}.jpg"', f"direction = {list(toward)}"]
    (tmp_path / "rig.toml").write_text("\n".join(entries))
    found = read_reflectance_observation(tmp_path)
    assert found.findings[0].startswith(
        "By their metadata, the images differ in settings (exposure 1 s to 2 s)"
    )
    assert found.findings[1].startswith("0.jpg, 1.jpg, 2.jpg and others are JPEG")


def test_a_flat_of_a_joint_measurement_that_does_not_belong_is_named():
    y, x = (np.mgrid[:40, :40] - 19.5) / 18.0
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    lights = np.array([(0.6, 0, 0.8), (-0.6, 0, 0.8), (0, 0.6, 0.8), (0, 0, 1)])
    shades = [np.clip(x * a - y * b + z * c, 0, 1) for a, b, c in lights]
    ball = SphereGeometry(centre=(19.5, 19.5), radius=18.0)
    given = {"camera": Camera(bits=12, black_level=BLACK), "sphere": ball}
    flats = [[frame(e, 40 + 3 * i + k) for k in range(3)] for i, e in enumerate((500, 2000, 4000))]
    flats[1][2] = np.zeros((64, 64), np.uint16)
    images = [np.round(BLACK + 3000 * shade).astype(np.uint16) for shade in shades]
    found = joint_photographs(images, lights, flats=flats, darks=DARKS[:1], **given)
    assert found.levels is not None
    np.testing.assert_allclose(found.levels[0].freedom, [2 * 4095, 4095, 2 * 4095, 4095])
    assert found.findings[0].startswith("flats[1][2] was left out: 100 % of its pixels are 0 DN")


def enough(kind):
    """Return flats and darks of 64 x 64 pixels that were processed in a given way."""
    rng = np.random.default_rng(4)

    def raw(electrons, gain=GAIN, black=BLACK, noise=READ_NOISE):
        counted = rng.poisson(electrons, (64, 64)) + rng.normal(0, noise, (64, 64))
        return gain * counted + black

    def jpeg(electrons):
        eight = np.clip(np.round(raw(electrons, 0.025, 4, 20)), 0, 255).astype(np.uint8)
        kept = io.BytesIO()
        Image.fromarray(eight).save(kept, "JPEG", quality=90)
        return np.asarray(Image.open(kept))

    def curved(electrons):
        linear = np.clip((np.round(raw(electrons)) - BLACK) / (FULL - BLACK), 0, 1)
        if kind == "gamma":
            return np.round(255 * linear ** (1 / 2.2))
        low = linear <= 0.0031308
        return np.round(255 * np.where(low, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))

    def level(electrons, count):
        if kind in ("jpeg", "gamma", "sRGB"):
            return [(jpeg if kind == "jpeg" else curved)(electrons) for _ in range(count)]
        running, frames = raw(electrons), []
        for _ in range(8 + count):
            running = 0.5 * running + 0.5 * raw(electrons)
            frames.append(np.clip(np.round(running), 0, FULL))
        return frames[8:]

    flats = [level(x, 12 if i == 7 else 2) for i, x in enumerate(ELECTRONS)]
    return flats, [level(0, 2) for _ in range(14)]


def measured_of(kind):
    bits = 12 if kind == "denoised" else 8
    return from_frames(*enough(kind), list(TIMES), ELECTRONS / 0.6, camera=Camera(bits=bits))


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("jpeg", "coefficients of the cosine transform are multiples of a step, because JPEG"),
        ("denoised", "the frames of a level share noise, as after temporal denoising"),
    ],
)
def test_processed_noise_is_named(kind, words):
    measured = measured_of(kind)
    (told,) = processing_in_words(measured, linear_levels(measured))
    assert words in told


@pytest.mark.parametrize(
    ("measure", "none"),
    [(lambda: measured_of("jpeg"), True), (lambda: measured_of("denoised"), True), (read, False)],
    ids=["jpeg", "denoised", "raw"],
)
def test_files_that_are_not_raw_make_no_sensor(measure, none):
    measured = measure()
    levels = linear_levels(measured)
    found = SimpleNamespace(
        measurement=measured, usable=levels, least_efficiency=0.6, likelihood=SimpleNamespace()
    )
    assert is_no_sensor(found) == none
    assert any("No sensor file is written" in told for told in processing(found)) == none


@pytest.mark.parametrize("kind", ["gamma", "sRGB"])
def test_frames_behind_a_tone_curve_are_refused_as_such(kind):
    with pytest.raises(InputError, match="after a tone curve"):
        measured_of(kind)


def test_raw_frames_are_taken_as_raw():
    measured = read()
    assert processing_in_words(measured, linear_levels(measured)) == []


@pytest.mark.slow
def test_saturation_and_light_that_is_stated_wrongly_are_no_tone_curve():
    bright = np.concatenate([ELECTRONS, [12000, 15000, 20000, 30000, 60000]])
    flats = [[frame(x, 800 + 2 * i), frame(x, 801 + 2 * i)] for i, x in enumerate(bright)]
    of = {"camera": Camera(bits=12), "dark_exposures": [TIMES[0]]}
    for stated in (bright / 0.6, (bright / 0.6) ** 1.4):
        assert tone_curve(from_frames(flats, DARKS[:1], [0.01] * 19, stated, **of)) is None


def test_jpeg_files_are_named(tmp_path):
    """The JPEG quality is so high that no blocks are visible."""
    rng, text = np.random.default_rng(6), "[camera]\nbits = 8\n"
    for i, electrons in enumerate([0, *np.linspace(500, 9000, 8)]):
        kind = "flat" if electrons else "dark"
        names = [f"{kind}_{i}_{j}.jpg" for j in range(2)]
        for name in names:
            signal = 0.025 * (rng.poisson(electrons, (32, 32)) + rng.normal(0, 40, (32, 32))) + 8
            eight = np.clip(np.round(signal), 0, 255).astype(np.uint8)
            Image.fromarray(eight).save(tmp_path / name, quality=98)
        text += f"[[{kind}]]\nfiles = {names}\nexposure = 0.01\n"
        text += f"photons = {2 * electrons}\n" if electrons else ""
    (tmp_path / "rig.toml").write_text(text)
    measured = read_photon_transfer(tmp_path)
    (told,) = processing_in_words(measured, linear_levels(measured))
    assert told.startswith("flat_1_0.jpg, flat_1_1.jpg, flat_2_0.jpg and 15 more are JPEG, which")


@pytest.mark.parametrize("seed", [9, 28, 36, 46])
def test_darks_with_almost_one_code_are_not_rejected(seed):
    """Row noise of a tenth of a code, like that of pixels, raises a few rows."""
    rng, small = np.random.default_rng(seed), [0.1, 0.13, 0.16][seed % 3]
    seen = [
        [
            frame_sample(f"{i} {j}", np.round(64 + small * noise), top=FULL)
            for j in range([2, 4][seed // 9 % 2])
            for noise in [rng.standard_normal((32, 32)) + rng.standard_normal((32, 1))]
        ]
        for i in range(3)
    ]
    assert odd_frames(seen, light=[0.01, 0.1, 1.0]) == []


@pytest.mark.parametrize("count", [5, 8])
@pytest.mark.sweep
def test_good_frames_under_flicker_are_not_called_smoothed(count):
    """The pixels have a PRNU of one per cent, and the light falls off towards the corners."""
    die = 1 + 0.01 * np.random.default_rng(99).standard_normal((64, 64))
    x = np.linspace(-1, 1, 64)
    die *= 1 - 0.2 * (x**2 + x[:, None] ** 2)
    for seed in range(6):
        rng = np.random.default_rng(seed)

        def flat(mean, rng=rng):
            lit = mean * (1 + 0.03 * rng.standard_normal()) * die
            return np.round(GAIN * (rng.poisson(lit) + rng.normal(0, READ_NOISE, (64, 64))) + BLACK)

        levels = [
            [frame_sample(f"{i}_{j}", flat(x), top=FULL) for j in range(count)]
            for i, x in enumerate(ELECTRONS)
        ]
        assert odd_frames(levels, light=ELECTRONS, black=np.full(14, BLACK)) == []


@pytest.mark.parametrize("level", [1, 7, 13])
def test_a_level_without_light_is_called_so(level):
    off = [frame(0, 900), frame(0, 901)]
    measured = read([off if i == level else frames for i, frames in enumerate(FLATS)])
    (sentence,) = measured.bright.left_out
    assert f"flats[{level}][0] and flats[{level}][1] were left out" in sentence
    assert "as if the lamp was off or the shutter closed" in sentence
    assert "averaged" not in sentence


def test_each_copy_in_a_level_is_compared_with_its_own_original():
    first, second = FLATS[3]
    levels = [[first, second, first, second], *FLATS[4:9]]
    named = [
        [frame_sample(f"f{i}_{j}", one, top=FULL) for j, one in enumerate(own)]
        for i, own in enumerate(levels)
    ]
    black = np.full(len(levels), BLACK)
    reasons = {
        one.names: one.reason for one in odd_frames(named, light=ELECTRONS[3:9], black=black)
    }
    assert reasons["f0_2",] == "equal to f0_0 in every pixel, as a copy is"
    assert reasons["f0_3",] == "equal to f0_1 in every pixel, as a copy is"


def test_a_level_of_too_much_variance_is_not_called_copied():
    rng = np.random.default_rng(0)
    loud = [np.round(x + rng.normal(0, 60, (64, 64))).clip(0, FULL) for x in FLATS[7]]
    (sentence,) = read([loud if i == 7 else x for i, x in enumerate(FLATS)]).bright.left_out
    assert "as if the camera moved" in sentence


def lit(change=None, flicker=0.0, seed=0, drift=0.0):
    """Return the frames that are left out of flats of 14 levels, some of which `change`
    modifies."""
    rng = np.random.default_rng(seed)
    away = np.mgrid[:64, :64] / 64 - 0.5
    levels = []
    for i, electrons in enumerate(ELECTRONS):
        level = []
        for k in range(2):
            light = electrons * (1 + flicker * rng.standard_normal()) * np.ones((64, 64))
            light *= 1.0 if change is None else change(i, k, *away)
            counted = rng.poisson(light) + READ_NOISE * rng.standard_normal((64, 64))
            black = BLACK + drift * rng.standard_normal()
            level.append(frame_sample(f"{i}_{k}", np.round(GAIN * counted + black), top=FULL))
        levels.append(level)
    return odd_frames(levels, light=ELECTRONS, black=np.full(14, BLACK))


@pytest.mark.sweep("0.003-6.0-seeds0")
@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 40), marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("flicker", "drift"), [(0.0, 0.0), (0.003, 0.0), (0.01, 0.0), (0.0, 2.0), (0.003, 6.0)]
)
def test_a_clean_camera_loses_no_frame(flicker, drift, seeds):
    """The lamps flicker by a share of their light, or the black level drifts from frame to frame,
    in DN."""
    found = [lit(flicker=flicker, drift=drift, seed=seed) for seed in seeds]
    assert [odd.sentence for own in found for odd in own] == []


@pytest.mark.parametrize("size", [0.01, -0.02, 0.03])
def test_a_lamp_that_changed_in_one_frame_is_named(size):
    first, *_ = lit(lambda i, k, y, x: 1 + size * ((i, k) == (6, 1)))
    assert first.names == ("6_1",)
    assert "its mean is" in first.reason


@pytest.mark.parametrize("place", [6, 13])
@pytest.mark.parametrize("depth", [0.05, 0.3])
def test_a_soft_shadow_is_reported_for_its_level_only(place, depth):
    def shadow(i, k, y, x):
        return 1 - depth * np.exp(-((x - 0.2) ** 2 + y**2) / 0.02) * (i == place)

    (odd,) = lit(shadow, flicker=0.003)
    assert odd.names == (f"{place}_0", f"{place}_1")
    assert "distribution of light over the frame differs from all other levels" in odd.reason


@pytest.mark.parametrize("place", [2, 6, 11])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_level_with_a_wrong_exposure_time_is_named(place, factor):
    """The change is smaller than the step to the neighbouring levels, so the order is unchanged."""
    (odd,) = lit(lambda i, k, y, x: factor if i == place else 1.0, flicker=0.001)
    assert odd.names == (f"{place}_0", f"{place}_1")
    told = float(odd.reason.removeprefix("the signal is ").split()[0])
    assert told == pytest.approx(factor, abs=0.015)
    assert "its exposure time (or its light) is not the stated one" in odd.reason


def test_a_nonlinear_camera_keeps_its_levels():
    bent = [1 - 0.15 * t / TIMES[-1] for t in TIMES]
    assert lit(lambda i, k, y, x: bent[i]) == []
