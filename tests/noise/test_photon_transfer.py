"""Tests reading photon transfer data: frames against NumPy on the whole stack, tables, and
refusals."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from oracles.cameras import CameraTruth, expose, moments

from fitting.noise import Camera, darks_from_frames
from fitting.noise.levels import linear_levels, saturation_index
from fitting.noise.read import read_photon_transfer
from jaxvision.errors import InputError
from jaxvision.files.images import write_image

SIZE = (24, 32)
EXPOSURES = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)


def write_rig(folder, *, camera="bits = 12", frames=3, light="photons = {p}", change=None):
    """Write a small rig, and return its stacks by name."""
    rng = np.random.default_rng(5)
    text, stacks = f"[camera]\n{camera}\n", {}
    for i, exposure in enumerate(EXPOSURES):
        photons = 1000.0 * (i + 1)
        for kind, amount in (("flat", photons), ("dark", 0.0)):
            stack = expose(rng, CameraTruth(), amount, exposure, (frames, *SIZE))
            stack = stack if change is None else change(kind, i, stack)
            stacks[kind, i] = stack
            names = [f"{kind}_{i}_{k}.tif" for k in range(frames)]
            for name, frame in zip(names, stack, strict=True):
                write_image(folder / name, frame.astype(np.uint16))
            text += f"[[{kind}]]\nfiles = {names!r}\nexposure = {exposure}\n"
            text += light.format(p=photons) + "\n" if kind == "flat" else ""
    (folder / "rig.toml").write_text(text)
    return stacks


def analysis_of_variance(stack):
    """Return the temporal variance of a pixel without that of whole frames, line by line."""
    count, h, w = stack.shape
    away = stack - stack.mean(axis=0)
    away = away - away.mean(axis=(1, 2), keepdims=True)
    rows, columns = away.mean(axis=2, keepdims=True), away.mean(axis=1, keepdims=True)
    of_rows = w * np.sum(rows**2) / ((count - 1) * (h - 1))  # w R + P
    of_columns = h * np.sum(columns**2) / ((count - 1) * (w - 1))  # h C + P
    pixels = np.sum((away - rows - columns) ** 2) / ((count - 1) * (h - 1) * (w - 1))  # P
    return pixels + (of_rows - pixels) / w + (of_columns - pixels) / h


def test_frames_are_reduced_to_the_moments_of_the_whole_stack(tmp_path):
    stacks = write_rig(tmp_path)
    read = read_photon_transfer(tmp_path)
    for kind, levels in (("flat", read.bright), ("dark", read.dark)):
        for i in range(len(EXPOSURES)):
            stack = stacks[kind, i]
            mean, _, spatial = moments(stack)
            np.testing.assert_allclose(levels.mean[i], mean, rtol=1e-13)
            np.testing.assert_allclose(levels.variance[i], analysis_of_variance(stack), rtol=1e-7)
            np.testing.assert_allclose(levels.spatial_variance[i], spatial, rtol=1e-11)
    np.testing.assert_array_equal(read.bright.light, 1000.0 * np.arange(1, 7))
    np.testing.assert_array_equal(read.dark_of, np.arange(6))
    assert read.full_scale == 4095
    assert read.photons_known


def test_a_flicker_of_whole_frames_does_not_raise_the_variance(tmp_path):
    def flicker(kind, i, stack):
        return stack + 40 * np.arange(len(stack))[:, None, None] * (kind == "flat")

    (tmp_path / "still").mkdir()
    (tmp_path / "flickering").mkdir()
    write_rig(tmp_path / "still")
    write_rig(tmp_path / "flickering", change=flicker)
    still, moving = (read_photon_transfer(tmp_path / name) for name in ("still", "flickering"))
    np.testing.assert_allclose(moving.bright.variance, still.bright.variance, rtol=1e-9)


def test_irradiance_is_converted_to_photons(tmp_path):
    camera = "bits = 12\nwavelength = 525e-9\npixel_pitch = 5e-6"
    write_rig(tmp_path, camera=camera, light="irradiance = 1e-3")
    read = read_photon_transfer(tmp_path)
    # EMVA 1288 eq. 4: 50.34 photons per (micrometre^2, ms, micrometre, microwatt / cm^2).
    expected = 50.34 * 25 * (np.array(EXPOSURES) * 1e3) * 0.525 * 0.1
    np.testing.assert_allclose(read.bright.light, expected, rtol=1e-4)


def test_without_photons_the_light_is_in_seconds(tmp_path):
    write_rig(tmp_path, light="")
    read = read_photon_transfer(tmp_path)
    assert not read.photons_known
    np.testing.assert_array_equal(read.bright.light, EXPOSURES)


def test_a_mosaic_gives_one_of_its_sites(tmp_path):
    stacks = write_rig(tmp_path, camera='bits = 12\npattern = "RGGB"')
    read = read_photon_transfer(tmp_path)
    np.testing.assert_allclose(read.bright.mean[2], stacks["flat", 2][:, 0::2, 1::2].mean())
    blue = read_photon_transfer(tmp_path, channel="blue")
    np.testing.assert_allclose(blue.bright.mean[2], stacks["flat", 2][:, 1::2, 1::2].mean())


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"change": lambda kind, i, s: s * 0 if kind == "dark" else s}, "black is clipped"),
        ({"change": lambda kind, i, s: s * 0 + 4095 if kind == "flat" else s}, "all are saturated"),
        (
            {"change": lambda kind, i, s: np.roll(s, 1, axis=2) * 0 + 60 + s % 3},
            "as dark as the darks",
        ),
        (
            {"change": lambda kind, i, s: 60 + s % 3 + 200 * (i + 1) * (kind == "flat")},
            "needs visible shot noise",
        ),
        ({"light": "photons = 1e33"}, "more than any pixel can hold"),
        ({"camera": "bits = 8"}, r"do not fit\s+8 bits"),
        ({"light": "irradiance = 1.0"}, "camera.wavelength and camera.pixel_pitch"),
    ],
)
def test_unusable_frames_are_refused_in_words(tmp_path, options, sentence):
    write_rig(tmp_path, **options)
    with pytest.raises(InputError, match=sentence):
        read_photon_transfer(tmp_path)


def test_too_small_or_different_frames_are_refused(tmp_path):
    write_rig(tmp_path)
    write_image(tmp_path / "flat_2_1.tif", np.full((24, 30), 500, np.uint16))
    (told,) = read_photon_transfer(tmp_path).bright.left_out
    assert told.startswith("flat_2_1.tif was left out: it is (24, 30), the others of its level")
    for file in tmp_path.glob("*.tif"):
        write_image(file, np.full((5, 5), 500, np.uint16))
    with pytest.raises(InputError, match="at least 100"):
        read_photon_transfer(tmp_path)


def test_a_dark_that_is_left_out_does_not_affect_the_converter():
    darks = [list(level) for level in np.random.default_rng(0).normal(64, 5, (3, 4, *SIZE)).round()]
    darks[1][2] = darks[1][2][:, :30] / 2 + 32  # an average of two, of another size
    found = darks_from_frames(darks, [0.1, 0.2, 0.3], camera=Camera(bits=12))
    assert len(found.left_out) == 1
    assert found.converter.step == 1


HEAD = (
    "exposure_ms,photons_per_pixel,mean_bright_DN,var_bright_DN2,mean_dark_DN,var_dark_DN2,pixels"
)
ROW = "{0},{1},{2},{3},20.0,6.0,10000"


def write_table(path, *, head=HEAD, rows=8, row=ROW, tail=()):
    lines = [head]
    lines += [
        row.format(i + 1, 1000 * (i + 1), 20 + 150 * (i + 1), 6 + 45 * (i + 1)) for i in range(rows)
    ]
    path.write_text("\n".join([*lines, *tail]) + "\n")
    return path


def test_sums_and_moments_give_the_same(tmp_path):
    pixels, frames = 10000, 4
    rng = np.random.default_rng(2)
    head = "exposure_s,photons_per_pixel,bright_sum,bright_pvar,dark_sum,dark_pvar,pixels,frames"
    lines, expected = [head], []
    for i in range(1, 6):
        cells = []
        for amount in (1000.0 * i, 0.0):
            stack = expose(rng, CameraTruth(), amount, 0.01 * i, (frames, pixels))
            sums, squares = stack.sum(axis=0), (stack**2).sum(axis=0)
            cells += [sums.sum(), frames * (frames * squares - sums**2).sum()]
            expected.append(moments(stack)[:2])
        lines.append(f"{0.01 * i},{1000 * i},{','.join(map(repr, map(float, cells)))},{pixels},4")
    file = tmp_path / "sums.csv"
    file.write_text("\n".join(lines))
    read = read_photon_transfer(file, bits=12)
    bright, dark = np.array(expected[0::2]), np.array(expected[1::2])
    np.testing.assert_allclose(np.stack([read.bright.mean, read.bright.variance], 1), bright)
    np.testing.assert_allclose(np.stack([read.dark.mean, read.dark.variance], 1), dark)
    assert read.full_scale == 4095


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"head": HEAD.replace("var_dark_DN2", "dark_variance")}, "no column var_dark_DN2"),
        ({"head": HEAD.replace("photons_per_pixel", "photons")}, "no column photons_per_pixel"),
        ({"head": HEAD.replace("exposure_ms", "exposure")}, "no exposure column"),
        (
            {"head": HEAD.replace("pixels", "size").replace("per_size", "per_pixel")},
            "number of pix",
        ),
        ({"rows": 0}, "holds no rows"),
        ({"head": HEAD.replace("pixels", '"pixels')}, "a quotation mark is not closed"),
        ({"rows": 3}, "at least 4 are needed"),
        ({"tail": ("9,9000,1,2",)}, "row 9 has 4 cells"),
        ({"tail": ("9,9000,x,2,3,4,10000",)}, "'x' in row 9 of column mean_bright_DN"),
        ({"tail": ("9,9000,nan,2,3,4,10000",)}, "row 9 of column mean_bright_DN is not finite"),
        ({"tail": ("9,9e33,900,2,3,4,10000",)}, "a flat has 9e.33 photons per pixel.*the unit"),
        ({"tail": ("9,9000,1500,400,20,6,20000",)}, "all need the same number"),
        ({"row": ROW.replace("20.0,6.0", "20.0,-6.0")}, "negative variance"),
        ({"row": ROW.replace("{0}", "0")}, "no flat has a positive exposure"),
    ],
)
def test_a_wrong_table_is_refused_with_its_column(tmp_path, options, sentence):
    with pytest.raises(InputError, match=sentence):
        read_photon_transfer(write_table(tmp_path / "ptc.csv", **options))


def test_a_missing_or_binary_table_and_a_wrong_depth_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such table"):
        read_photon_transfer(tmp_path / "none.csv")
    for content, sentence in ((b"\xff\xfe\x00\x81", "UTF-16"), (b"\x00\x01\x81", "binary.csv: ")):
        (tmp_path / "binary.csv").write_bytes(content)
        with pytest.raises(InputError, match=sentence):
            read_photon_transfer(tmp_path / "binary.csv")
    with pytest.raises(InputError, match="more than 8 bits"):
        read_photon_transfer(write_table(tmp_path / "ptc.csv"), bits=8)


@pytest.mark.slow
def test_saturation_is_the_peak_of_the_variance_only_if_it_falls_behind(tmp_path):
    rising = read_photon_transfer(write_table(tmp_path / "rising.csv"))
    assert saturation_index(rising.bright) is None
    np.testing.assert_array_equal(linear_levels(rising), jnp.arange(8))
    tail = ("9,9000,1370,411,20,6,10000", "10,10000,1380,50,20,6,10000")
    falling = read_photon_transfer(write_table(tmp_path / "falling.csv", tail=tail))
    assert saturation_index(falling.bright) == 8
    # 95 % of the saturation signal, 1350 DN, is between the signals 1200 and 1350.
    np.testing.assert_array_equal(linear_levels(falling), np.arange(8))


def test_levels_within_four_deviations_of_full_scale_are_left_out(tmp_path):
    measured = read_photon_transfer(write_table(tmp_path / "ptc.csv"))
    top, deviation = float(measured.bright.mean[5]), float(measured.bright.variance[5]) ** 0.5
    for deviations, usable in ((3.9, 5), (4.1, 6)):
        clipped = replace(measured, full_scale=top + deviations * deviation)
        np.testing.assert_array_equal(linear_levels(clipped), np.arange(usable))
