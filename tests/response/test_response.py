"""Tests response calibration from a rig folder to a section: planes, masks, merged map, findings,
refusals."""

import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.stacks import exposure_stack, gamma, srgb
from scipy import stats

from fitting.inference.estimates import find
from fitting.inference.formatting import format_with_error
from fitting.response import from_stack
from fitting.response.calibration import calibrate as calibrate_response
from fitting.response.calibration import radiance_images
from fitting.response.curve import fit_response_curve
from fitting.response.figures import curve_figure, radiance_figure
from fitting.response.findings import findings
from fitting.response.radiance_map import merge
from fitting.response.read import read_exposure_stack
from fitting.response.section import curve_columns
from fitting.response.section import section as response_section
from fitting.rig import Camera, load_rig
from jaxvision.errors import InputError
from jaxvision.files.images import write_image

TIMES = 2.0 ** np.arange(-4, 5)
SIZE = (64, 80)


def write_rig(folder: Path, images, times=TIMES, *, camera: str = "bits = 8") -> Path:
    entries = []
    for i, (image, t) in enumerate(zip(images, times, strict=True)):
        write_image(folder / f"{i}.png", image)
        entries.append(f'[[exposure]]\nfile = "{i}.png"\nexposure = {t}\n')
    (folder / "rig.toml").write_text(f"[camera]\n{camera}\n" + "\n".join(entries))
    return folder


def colour_images(response=srgb, seed=0, bands=3):
    rng = np.random.default_rng(seed)
    stacks = [exposure_stack(response, TIMES, rng, pixels=SIZE[0] * SIZE[1]) for _ in range(bands)]
    # Sorted along the rows, because in a scene of noise few pixels would be far from clipped ones.
    planes = [codes[:, np.argsort(irradiance)] for irradiance, codes in stacks]
    return np.stack(planes, axis=-1).reshape(len(TIMES), *SIZE, bands).astype(np.uint8)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    folder = write_rig(tmp_path_factory.mktemp("rig"), colour_images())
    return calibrate_response(read_exposure_stack(folder))


@pytest.mark.slow
def test_section_of_a_colour_stack(calibration):
    section = response_section(calibration)
    assert section.kind == "response"
    for channel in ("red", "green", "blue"):
        gamma = find(section.estimates, "gamma", group=channel)
        assert gamma.value is None
        assert "no pure gamma: the best one, 2." in gamma.reason
        assert channel in section.posteriors
    assert any("not a pure gamma" in sentence for sentence in section.findings)
    assert any("sRGB curve fits better" in sentence for sentence in section.findings)
    assert all(sentence.endswith(".") for sentence in section.findings)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("times", "change", "expected"),
    [
        (
            TIMES[::-1],
            np.asarray,
            r"7\.png is darker than 8\.png .*order of the times.*Keep those that belong",
        ),
        (
            TIMES,
            np.invert,
            r"1\.png is darker than 0\.png .*negative.*Keep those that belong",
        ),
        (TIMES * np.resize([1, 1.8], 9), np.asarray, "agree on no response curve"),
        pytest.param(
            TIMES,
            lambda x: np.random.default_rng(int(x.sum())).permuted(x),
            "agree on no response curve",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["reversed", "negatives", "wrong times", "noise"],
)
def test_images_that_contradict_their_times_are_refused(tmp_path, times, change, expected):
    images = [change(image[..., 0]) for image in colour_images(bands=1)]
    with pytest.raises(InputError, match=expected):
        calibrate_response(read_exposure_stack(load_rig(write_rig(tmp_path, images, times))))


@pytest.mark.slow
def test_the_whole_curve_is_in_the_section(calibration):
    """Every code of every channel is in the table. Where pixels were seen, it is the sRGB curve
    within 5 %."""
    curve = response_section(calibration).data["curve"]
    for channel in ("red", "green", "blue"):
        rows = (curve["channel"] == channel) & curve["seen"]
        code, exposure = curve["code"][rows] / 255, curve["exposure"][rows]
        assert rows.sum() > 200
        linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
        middle = (code > 0.1) & (code < 0.9)
        ratio = exposure[middle] / linear[middle]
        np.testing.assert_allclose(ratio / np.median(ratio), 1, atol=0.05)
        half = np.log(curve["upper_95"] / curve["lower_95"])[rows] / 2
        [fitted] = [c.curve for c in calibration.channels if c.plane.label == channel]
        quantile = stats.t.ppf(0.975, fitted.freedom[fitted.seen])
        error = curve["standard_error"][rows] / exposure
        np.testing.assert_allclose(half, quantile * error, rtol=1e-6)


@pytest.mark.slow
def test_a_notebook_shows_the_section(calibration):
    assert calibration.section is calibration.section
    assert calibration.section.title in calibration._repr_html_()
    assert pickle.loads(pickle.dumps(calibration)).section.findings == calibration.section.findings


@pytest.mark.slow
@pytest.mark.parametrize("pure", [True, False])
def test_the_legend_gives_the_error_of_a_pure_gamma(calibration, pure):
    """The stack is sRGB. A curve without departure from gamma is simulated."""
    shown = calibration
    if pure:
        none = [
            replace(c, gamma=replace(c.gamma, departure=0 * c.gamma.departure))
            for c in calibration.channels
        ]
        shown = replace(calibration, channels=tuple(none))
    texts = [text.get_text() for text in curve_figure(shown).axes[0].get_legend().texts]
    for text, channel in zip(texts, calibration.channels, strict=True):
        gamma = channel.gamma.gamma
        error = f"γ = {format_with_error(gamma.value, gamma.standard_error)}"
        assert text == f"{channel.plane.channel}, {error if pure else f'best γ {gamma.value:.3g}'}"


@pytest.mark.slow
def test_pictures_are_drawn(calibration, tmp_path):
    for picture in response_section(calibration).pictures:
        picture.draw().savefig(tmp_path / f"{picture.name}.png", dpi=40)
        assert (tmp_path / f"{picture.name}.png").stat().st_size > 2000


@pytest.mark.slow
def test_a_single_exposure_equals_the_map_where_it_is_not_clipped(calibration):
    """White and curve are the same, so the two pictures differ only by noise."""
    merged, single = (
        np.asarray(axes.images[0].get_array())
        for axes in radiance_figure(calibration, radiance_images(calibration)).axes[:2]
    )
    brightest = single.max((0, 1))
    within = (single > 0.2) & (single < 0.95 * brightest)
    assert within.mean() > 0.1
    assert np.median(abs(single - merged)[within]) < 0.01
    assert np.median((merged - single)[single == brightest]) >= 0


def test_the_merged_map_equals_the_scene():
    rng = np.random.default_rng(1)
    irradiance, codes = exposure_stack(gamma(2.2), TIMES, rng)
    merged = merge(codes, TIMES, fit_response_curve(codes, TIMES, bits=8))
    error = np.log(merged.radiance / irradiance)
    error -= np.median(error)
    # Shot noise of all electrons collected in the unclipped exposures.
    unclipped = (irradiance * TIMES[:, None] < 0.95) * TIMES[:, None]
    ideal = 1 / np.sqrt(8000 * irradiance * unclipped.sum(axis=0))
    bright = irradiance > 0.02
    assert np.std(error[bright]) < 1.5 * np.sqrt(np.mean(ideal[bright] ** 2))
    assert np.mean(np.abs(error) < 3 * merged.relative_error) > 0.9
    assert np.isfinite(merged.radiance).all()


def test_pixels_clipped_everywhere_are_bounds():
    rng = np.random.default_rng(2)
    irradiance, codes = exposure_stack(gamma(2.2), TIMES, rng)
    codes[:, 0], codes[:, 1] = 255, 0
    merged = merge(codes, TIMES, fit_response_curve(codes, TIMES, bits=8))
    assert merged.coverage[0] == merged.coverage[1] == 0
    # The pixels are compared with the brightest and darkest others.
    assert merged.radiance[0] > np.quantile(merged.radiance, 0.999)
    assert merged.radiance[1] < np.quantile(merged.radiance, 0.01)
    assert irradiance.min() > 0


@pytest.mark.slow
def test_a_mosaic_is_split_by_colour(tmp_path):
    rng = np.random.default_rng(3)
    _, codes = exposure_stack(gamma(1.0), TIMES, rng, pixels=96 * 128)
    images = codes.reshape(len(TIMES), 96, 128).astype(np.uint8)
    folder = write_rig(tmp_path, images, camera='bits = 8\npattern = "GBRG"')
    calibration = calibrate_response(read_exposure_stack(load_rig(folder)))
    names = [channel.plane.channel for channel in calibration.channels]
    assert names == ["green 1", "blue", "red", "green 2"]
    assert radiance_images(calibration)[""].shape == (48, 64, 3)


def test_black_level_is_estimated_from_unresponsive_pixels(tmp_path):
    rng = np.random.default_rng(4)
    _, codes = exposure_stack(gamma(2.2), TIMES, rng, pixels=SIZE[0] * SIZE[1], pedestal=20)
    codes[:, :200] = 20
    folder = write_rig(tmp_path, codes.reshape(len(TIMES), *SIZE).astype(np.uint8))
    stack = read_exposure_stack(load_rig(folder))
    assert stack.planes[0].black == 20
    assert stack.planes[0].clip == 255


def test_a_mask_selects_its_pixels(tmp_path):
    folder = write_rig(tmp_path, colour_images())
    mask = np.zeros(SIZE, bool)
    with pytest.raises(InputError, match="leaves no pixel"):
        read_exposure_stack(load_rig(folder), mask=mask)
    with pytest.raises(InputError, match="resize"):
        read_exposure_stack(load_rig(folder), mask=np.ones((3, 3), bool))
    mask[:2, :20] = True
    with pytest.raises(InputError, match="well exposed"):
        calibrate_response(read_exposure_stack(load_rig(folder), mask=mask))


@pytest.mark.parametrize(
    ("images", "times", "message"),
    [
        (np.full((2, 8, 8), 9, np.uint8), [1.0, 1.0], "different exposure times"),
        (np.full((1, 8, 8), 9, np.uint8), [1.0], "at least two"),
        ([np.zeros((8, 8), np.uint8), np.zeros((8, 9), np.uint8)], [1.0, 2.0], "same size"),
    ],
)
def test_unusable_stacks_are_refused(tmp_path, images, times, message):
    with pytest.raises(InputError, match=message):
        read_exposure_stack(load_rig(write_rig(tmp_path, images, times)))


def test_fractional_numbers_are_refused(tmp_path):
    folder = write_rig(tmp_path, colour_images())
    np.save(tmp_path / "half.npy", np.full((*SIZE, 3), 10.5))
    rig = (folder / "rig.toml").read_text().replace('"0.png"', '"half.npy"')
    (folder / "rig.toml").write_text(rig)
    with pytest.raises(InputError, match="fractions"):
        read_exposure_stack(load_rig(folder))


@pytest.mark.parametrize("level", [0, 255])
def test_dark_or_saturated_stacks_are_refused_with_the_reason(tmp_path, level):
    folder = write_rig(tmp_path, np.full((9, *SIZE), level, np.uint8))
    with pytest.raises(InputError, match="well exposed"):
        calibrate_response(read_exposure_stack(load_rig(folder)))


def test_a_code_far_beyond_all_pixels_has_no_upper_bound():
    curve = SimpleNamespace(
        codes=np.arange(2),
        log_exposure=np.array([0.0, 700.0]),
        standard_error=np.array([0.1, 50.0]),
        half_width=np.array([0.196, 98.0]),
        seen=np.array([True, False]),
    )
    columns = curve_columns([SimpleNamespace(curve=curve, plane=SimpleNamespace(name="grey"))])
    np.testing.assert_allclose(columns["upper_95"], [np.exp(0.196), np.inf], rtol=1e-4)
    np.testing.assert_allclose(columns["lower_95"], [np.exp(-0.196), 0.0], rtol=1e-4)


@pytest.mark.slow
def test_a_channel_that_fails_is_named_and_the_others_written(tmp_path):
    images = colour_images()
    images[..., 2] = 3
    calibration = calibrate_response(read_exposure_stack(load_rig(write_rig(tmp_path, images))))
    assert [channel.plane.channel for channel in calibration.channels] == ["red", "green"]
    merged = radiance_images(calibration)[""]
    assert np.isnan(merged[..., 2]).all()
    assert np.isfinite(merged[..., :2]).all()
    section = response_section(calibration)
    [named] = [text for text in section.findings if text.startswith("blue was not calibrated")]
    assert "NaN in the radiance map" in named
    section.pictures[3].draw()


@pytest.mark.slow
def test_a_small_picture_keeps_its_pixels_near_clipped_ones():
    """All raw pixels are next to a few clipped ones, so otherwise none would remain."""
    rng, times = np.random.default_rng(3), 2.0 ** np.arange(-4, 3)
    y, x = np.mgrid[:18, :18] / 18
    light = np.exp(3 * (x - 0.5) + 2 * np.sin(6 * y))
    electrons = (rng.poisson(8000 * np.clip(light * time, 0, 1)) for time in times)
    encoded = (255 * (n / 8000) ** (1 / 2.2) for n in electrons)
    images = [code.round().clip(0, 255).astype(np.uint8) for code in encoded]
    calibration = calibrate_response(from_stack(images, times, camera=Camera(bits=8)))
    (channel,) = calibration.channels
    assert not channel.clear
    assert any("near them count too" in sentence for sentence in findings(calibration))
    assert abs(channel.gamma.gamma.value - 2.2) < 4 * channel.gamma.gamma.standard_error
