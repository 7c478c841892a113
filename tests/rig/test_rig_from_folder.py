"""Tests `jaxvision-fit init`: rigs from names and headers of files, and the values that these
lack."""

import datetime
import logging
import os
import re
import tomllib
from functools import partial

import jax
import numpy as np
import pytest
from commands import called
from photographs import photograph
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from fitting.cli import app
from fitting.rig import load_rig
from fitting.rig_from_folder import _Image, _warmth, rig_of, write_rig
from jaxvision.cli.command_line import say_what_is_done
from jaxvision.errors import InputError
from jaxvision.files.image_settings import ImageSettings, read_settings
from jaxvision.files.images import write_image

run = partial(called, app)


def test_exif_makes_an_exposure_stack(tmp_path):
    for i, seconds in enumerate((1 / 8, 1 / 60, 2.0)):
        photograph(tmp_path / f"view{i + 9}.jpg", seconds=seconds)
    status, stdout, stderr = run("init", tmp_path)
    assert (status, stderr) == (0, "")
    assert f"Then: jaxvision-fit response {tmp_path}" in stdout
    assert "To do" not in stdout
    rig = load_rig(tmp_path)
    assert [(one.file, one.exposure) for one in rig.exposure] == [
        ("view9.jpg", 0.125),
        ("view10.jpg", pytest.approx(1 / 60, rel=1e-5)),
        ("view11.jpg", 2.0),
    ]
    assert rig.camera.bits == 8
    assert rig.camera.date == datetime.date(2026, 5, 4)
    assert (tmp_path / "rig.toml").read_text().startswith("# Maker Model 3\n")
    status, _, stderr = run("init", tmp_path)
    assert status == 2
    assert "is there already" in stderr


@pytest.mark.parametrize(
    ("tags", "exposure", "f_number"),
    [
        ({0x9201: 6.0, 0x9202: 4.0}, 1 / 64, 4.0),
        ({0x9201: -1.0, 0x9202: 0.0}, 2.0, None),
        ({0x829A: 0.5, 0x9201: 6.0, 0x829D: 0.0, 0x9202: 4.0}, 0.5, None),
    ],
)
def test_apex_values_are_used_if_alone(tags, exposure, f_number, tmp_path):
    head = Image.Exif()
    head[0x8769] = {tag: IFDRational(int(10 * value), 10) for tag, value in tags.items()}
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg", exif=head)
    found = read_settings(tmp_path / "a.jpg")
    assert (found.exposure, found.f_number) == (exposure, f_number)


def test_verbose_prints_one_line_per_compiled_program(capfd):
    """Nothing else of JAX's log is printed."""
    loggers = [logging.getLogger(name) for name in ("jaxvision", "jax")]
    before = [(one.level, one.propagate, [*one.handlers]) for one in loggers]
    try:
        say_what_is_done()
        jax.jit(lambda x: x * 3.75 + 1)(np.float32(2)).block_until_ready()
    finally:
        for one, (level, propagate, handlers) in zip(loggers, before, strict=True):
            one.level, one.propagate, one.handlers = level, propagate, handlers
    (line,) = capfd.readouterr().err.strip().split("\n")
    assert re.fullmatch(r" *[\d.]+ s  Finished XLA compilation of jit\(<lambda>\) in .* sec", line)


def test_verbose_prints_what_is_read_and_version_its_packages(tmp_path):
    photograph(tmp_path / "a.jpg", seconds=0.5)
    loggers = [logging.getLogger(name) for name in ("jaxvision", "jax")]
    before = [(one.level, one.propagate, [*one.handlers]) for one in loggers]
    try:
        status, _, stderr = run("-v", "init", tmp_path)
    finally:
        for one, (level, propagate, handlers) in zip(loggers, before, strict=True):
            one.level, one.propagate, one.handlers = level, propagate, handlers
    assert status == 0
    assert re.search(rf"^ *[\d.]+ s  read {tmp_path}/a.jpg: 8x10x3 uint8$", stderr, re.MULTILINE)
    status, stdout, _ = run("--version", "-v")
    assert status == 0
    assert f"numpy {np.__version__}\n" in stdout
    assert "Devices: " in stdout
    assert "Compiled programs: " in stdout
    status, _, stderr = run("-v")
    assert status == 2
    assert "Missing command" in stderr


def test_names_give_levels_of_flats_and_darks(tmp_path):
    for kind in ("flat", "dark"):
        for ms in (2, 10, 250):
            for frame in range(2):
                pixels = np.full((6, 8), 100 + 12 * ms, np.uint16)
                pixels[0, :3] = 100 + 12 * ms - np.arange(1, 4)
                write_image(tmp_path / f"{kind}_{ms}ms_{frame}.tif", pixels)
    path, found = write_rig(tmp_path)
    rig = load_rig(path)
    assert found.kind == "noise"
    assert [flat.exposure for flat in rig.flat] == [0.002, 0.010, 0.250]
    assert rig.dark[2].files == ("dark_250ms_0.tif", "dark_250ms_1.tif")
    assert rig.camera.bits == 12  # 3100 DN
    assert [sentence.split(";")[0] for sentence in found.missing] == [
        "bits = 12 is the least that holds 3100 DN",
        "photons of the flats: give them for the quantum efficiency.",
    ]


def test_flats_and_darks_of_several_gains_have_separate_entries(tmp_path):
    for kind in ("flat", "dark"):
        for iso in (100, 400):
            for frame in range(2):
                name = f"{kind}_{iso}_{frame}.jpg"
                photograph(tmp_path / name, seconds=0.5, iso=iso)
    path, found = write_rig(tmp_path)
    rig = load_rig(path)
    assert [(one.iso, one.exposure) for one in rig.flat] == [(100, 0.5), (400, 0.5)]
    assert rig.dark[1].files == ("dark_400_0.jpg", "dark_400_1.jpg")
    assert not any("ISO" in sentence for sentence in found.missing)
    photograph(tmp_path / "scene.jpg", seconds=0.5, iso=200)
    photograph(tmp_path / "scene2.jpg", seconds=1, iso=400)
    assert any("differ in ISO (200, 400)" in sentence for sentence in rig_of(tmp_path).missing)


@pytest.mark.parametrize("kind", ["images", "flats"])
@pytest.mark.parametrize("seconds", [(0.1, 0.1, 0.1), (0.1, 0.2, 0.4)])
def test_different_apertures_are_named(kind, seconds, tmp_path):
    """The exposure times then do not determine the light."""
    for i, (time, number) in enumerate(zip(seconds, (2.8, 11, 8), strict=True)):
        photograph(tmp_path / f"{kind[:-1]}{i}.jpg", seconds=time, f_number=number)
    said = f"The {kind} differ in aperture (f/2.8, f/8, f/11); keep those of one aperture."
    assert said in rig_of(tmp_path).missing
    for i in range(3):
        (tmp_path / f"dark{i}.jpg").write_bytes((tmp_path / f"{kind[:-1]}{i}.jpg").read_bytes())
        (tmp_path / f"{kind[:-1]}{i}.jpg").unlink()
    assert not any("aperture" in sentence for sentence in rig_of(tmp_path).missing)


def test_different_temperatures_are_settings():
    def image(name, kelvin):
        return _Image(name, ImageSettings(temperature=kelvin), 1.0)

    images = [image(f"a{i}", 290 + 0.5 * i) for i in range(4)] + [image("b", 300.04)]
    assert _warmth(images) == dict.fromkeys(("a0", "a1", "a2", "a3"), 290.8) | {"b": 300.0}
    assert _warmth(images[:4]) == {}


def test_headers_distinguish_flats_and_darks(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")

    def write(name, said):
        header = fits.Header({"EXPTIME": 0.5, "IMAGETYP": said})
        fits.writeto(tmp_path / name, np.full((6, 8), 900, np.uint16), header)

    for i, said in enumerate(("Flat Field", "FLAT", "DARK", "Dark Frame", "BIAS", "Light Frame")):
        write(f"img{i}.fits", said)
    path, found = write_rig(tmp_path)
    rig = load_rig(path)
    assert [one.files for one in rig.flat] == [("img0.fits", "img1.fits")]
    assert [one.files for one in rig.dark] == [("img2.fits", "img3.fits", "img4.fits")]
    assert [one.file for one in rig.exposure] == ["img5.fits"]
    assert not any("IMAGETYP" in sentence for sentence in found.missing)
    write("dark_nebula.fits", "LIGHT")
    write("lamp.fits", "OBJECT")
    found = rig_of(tmp_path)
    content = tomllib.loads(found.text)
    assert [one["file"] for one in content["exposure"]] == ["dark_nebula.fits", "img5.fits"]
    assert [one["file"] for one in content["light"]] == ["lamp.fits"]
    (doubt,) = [sentence for sentence in found.missing if "IMAGETYP" in sentence]
    assert doubt == (
        "dark_nebula.fits: taken by its IMAGETYP, LIGHT; correct that if it is a dark, "
        "as its name says."
    )


def test_unknown_values_are_written_as_comments(tmp_path):
    (tmp_path / "lamps").mkdir()
    for i in range(3):
        write_image(tmp_path / "lamps" / f"{i}.png", np.full((4, 4), 7, np.uint8))
    write_image(tmp_path / "mask.png", np.ones((4, 4), np.uint8))
    write_image(tmp_path / "flat1.png", np.full((4, 4), 7, np.uint8))
    found = rig_of(tmp_path)
    content = tomllib.loads(found.text)
    assert [one["file"] for one in content["light"]] == [f"lamps/{i}.png" for i in range(3)]
    assert content["geometry"] == {"mask": "mask.png"}
    assert "# direction = [?, ?, ?]" in found.text
    for words in ("Directions toward", "The shape", "two images or more", "Exposures of flats"):
        assert any(words in sentence for sentence in found.missing)


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("flat_8ms_0", 0.008),
        ("scene-1_8s", 0.125),
        ("a 2.5s", 2.5),
        ("b_500us", 5e-4),
        ("b_1500\u00b5s", 1.5e-3),
        ("b_1500\u03bcs", 1.5e-3),
        ("b_exp500us_1", 5e-4),
        ("b_temp5s", None),
        ("v2 30ms", 0.03),
        ("img_0001_8ms", 0.008),
        ("DSC_0123_1s", 1.0),
        ("2026-11-20_8ms", 0.008),
        ("2026-11-1-4s", 4.0),
        ("flat_0_0s", None),
        ("plain_12", None),
        ("frames3", None),
    ],
)
def test_exposure_times_are_read_from_names(name, seconds, tmp_path):
    write_image(tmp_path / f"{name}.png", np.full((4, 4), 7, np.uint8))
    found = tomllib.loads(rig_of(tmp_path).text)
    entry = {**found}.get("flat", found.get("exposure"))[0]
    assert entry.get("exposure") == (None if seconds is None else pytest.approx(seconds))


def test_a_number_before_the_time_is_a_counter_or_a_fraction(tmp_path):
    """1_5s may be either. The other names decide, or a sentence asks."""
    for name in ("flat_1_5s", "flat_2_10s"):
        write_image(tmp_path / f"{name}.png", np.full((4, 4), 7, np.uint8))
    found = rig_of(tmp_path)
    assert [one["exposure"] for one in tomllib.loads(found.text)["flat"]] == [5, 10]
    assert not any("read as" in sentence for sentence in found.missing)
    (tmp_path / "flat_2_10s.png").unlink()
    found = rig_of(tmp_path)
    assert tomllib.loads(found.text)["flat"][0]["exposure"] == pytest.approx(0.2)
    assert any("read as 1/5 s; correct it if that is 5 s." in said for said in found.missing)


def test_a_merged_map_is_not_an_exposure(tmp_path):
    """Its numbers, up to 274, would be taken for the camera's."""
    for i, seconds in enumerate((0.5, 1.0)):
        photograph(tmp_path / f"view{i}.jpg", seconds=seconds)
    write_image(tmp_path / "merged.hdr", np.full((6, 8, 3), 274.0, np.float32))
    status, stdout, _ = run("init", tmp_path)
    assert status == 0
    assert "Left out: merged.hdr: holds floating numbers, and the other images hold whole" in stdout
    rig = load_rig(tmp_path)
    assert [one.file for one in rig.exposure] == ["view0.jpg", "view1.jpg"]
    assert rig.camera.bits == 8
    for i in range(2):
        (tmp_path / f"view{i}.jpg").unlink()
    found = rig_of(tmp_path)
    assert [one["file"] for one in tomllib.loads(found.text)["exposure"]] == ["merged.hdr"]
    assert "merged.hdr is the only exposure; a response needs two or more." in found.missing


def test_wavelengths_in_names_separate_stacks(tmp_path):
    names = [f"chart30cm_{band}nm_{ms}ms.png" for band in (400, 450) for ms in (25, 100)]
    for name in names:
        write_image(tmp_path / name, np.full((4, 4), 7, np.uint8))
    path, _ = write_rig(tmp_path)
    assert [(one.group, one.exposure) for one in load_rig(path).exposure] == [
        ("400nm", 0.025),
        ("400nm", 0.1),
        ("450nm", 0.025),
        ("450nm", 0.1),
    ]
    (tmp_path / names[1]).unlink()
    said = f"{names[0]} is the only exposure of 400nm; a response needs two or more."
    assert said in rig_of(tmp_path).missing
    (tmp_path / names[0]).unlink()
    assert "group" not in rig_of(tmp_path).text


def test_darks_alone_are_named_as_incomplete(tmp_path):
    for frame in range(2):
        write_image(tmp_path / f"dark_25ms_{frame}.png", np.full((4, 4), 7, np.uint8))
    status, stdout, _ = run("init", tmp_path)
    assert status == 0
    assert "To do: Nothing can be calibrated yet: add flats for the noise" in stdout
    assert "Then" not in stdout


def test_a_fraction_of_a_second_is_written_as_a_fraction(tmp_path):
    for name, seconds in (("a", 1 / 30), ("b", 1 / 125), ("c", 0.3), ("d", 2.0)):
        photograph(tmp_path / f"{name}.jpg", seconds=seconds)
    for name in ("e_1-60s", "f_8ms"):
        write_image(tmp_path / f"{name}.png", np.full((4, 4), 7, np.uint8))
    path, found = write_rig(tmp_path)
    written = [one["exposure"] for one in tomllib.loads(found.text)["exposure"]]
    assert written == ["1/30", "1/125", 0.3, 2, "1/60", 0.008]
    assert load_rig(path).exposure[0].exposure == 1 / 30


def test_names_are_quoted_for_toml(tmp_path):
    name = 'a "b" c\\d\x7f.png'
    write_image(tmp_path / name, np.full((4, 4), 7, np.uint8))
    assert tomllib.loads(rig_of(tmp_path).text)["exposure"][0]["file"] == name


def test_folders_without_images(tmp_path):
    with pytest.raises(InputError, match="holds no images"):
        write_rig(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        write_rig(tmp_path / "none")


def test_names_and_cameras_that_are_not_text(tmp_path):
    head = Image.Exif()
    head[0x010F] = b"Ma\xcfker\x01"
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg", exif=head)
    write_rig(tmp_path)
    assert tomllib.loads((tmp_path / "rig.toml").read_text())["camera"]["bits"] == 8
    (tmp_path / "a.jpg").rename(tmp_path / os.fsdecode(b"\xcf.jpg"))
    (tmp_path / "rig.toml").unlink()
    with pytest.raises(InputError, match=r"\\udccf\.jpg': the path is not UTF-8; rename that"):
        write_rig(tmp_path)


def test_types_written_in_one_word_are_recognised(tmp_path):
    """These are names used by astronomy programs. A dark of flats is a dark."""
    kinds = {"DarkFlat": "dark", "FLATDARK": "dark", "DarkFrame": "dark", "BiasFrame": "dark"}
    kinds |= {"FlatField": "flat", "flatframe": "flat", "darkness": "exposure"}
    for name, kind in kinds.items():
        (tmp_path / name).mkdir()
        for frame in range(2):
            file = tmp_path / name / f"{name}_2.5s_{frame}.png"
            write_image(file, np.full((4, 4), 7, np.uint8))
        rig = tomllib.loads(rig_of(tmp_path / name).text)
        assert {"dark", "flat", "exposure"} & rig.keys() == {kind}, name


def test_hidden_files_are_not_images(tmp_path):
    """macOS writes these next to each file on a memory stick, with the image's suffix."""
    for n in range(2):
        write_image(tmp_path / f"IMG_{n}_{n + 1}s.tif", np.full((4, 4), 7, np.uint16))
    (tmp_path / ".thumbs").mkdir()
    for hidden in ("._IMG_0_1s.tif", ".thumbs/IMG_0_1s.tif"):
        (tmp_path / hidden).write_bytes(b"\0\5\x16\7" + bytes(100))
    found = rig_of(tmp_path)
    assert found.left_out == []
    assert [one["exposure"] for one in tomllib.loads(found.text)["exposure"]] == [1, 2]


def test_copies_in_another_format_and_thumbnails_are_left_out(tmp_path):
    for n in range(2):
        image = np.full((16, 16), 7, np.uint8)
        for name in (
            f"IMG_{n}_{n + 1}s.tif",
            f"IMG_{n}_{n + 1}s.jpg",
            f"IMG_{n}_{n + 1}s_thumb.png",
        ):
            write_image(tmp_path / name, image)
    found = rig_of(tmp_path)
    files = [one["file"] for one in tomllib.loads(found.text)["exposure"]]
    assert files == ["IMG_0_1s.tif", "IMG_1_2s.tif"]
    assert found.left_out == [
        "IMG_0_1s.jpg: another file of this name is no JPEG.",
        "IMG_0_1s_thumb.png: is a thumbnail, by its name.",
        "IMG_1_2s.jpg: another file of this name is no JPEG.",
        "IMG_1_2s_thumb.png: is a thumbnail, by its name.",
    ]


@pytest.mark.parametrize(
    ("process", "words"),
    [
        (lambda x: x, None),
        (lambda x: x + np.arange(64) % 4 / 4, r"The numbers are multiples of 1/4, as in means"),
        (lambda x: x - 64, r"The least number is -\d+, as after a subtraction"),
        (
            lambda x: np.maximum(x - 64, 0),
            r"\d\d % of the darks' pixels are 0 DN and none are below",
        ),
        (lambda x: np.maximum(x, 65), r"\d\d % of the darks' pixels are 65 DN and none are below"),
        (lambda x: x / 4095, r"All numbers lie between 0 and 1"),
    ],
)
def test_processed_frames_are_described(process, words, tmp_path):
    rng = np.random.default_rng(0)
    for kind, light in (("dark", 0), ("flat", 900)):
        for i in range(2):
            frame = np.round(64 + rng.poisson(light, (64, 64)) + rng.normal(0, 2, (64, 64)))
            np.save(tmp_path / f"{kind}_8ms_{i}.npy", process(frame))
    missing = rig_of(tmp_path).missing
    assert sum("camera" in one or "black" in one for one in missing) == (words is not None)
    assert words is None or any(re.match(words, one) for one in missing)


def test_a_header_time_that_differs_from_the_name_is_named(tmp_path):
    for name in ("dark_8ms_0", "flat_80ms_0"):
        photograph(tmp_path / f"{name}.jpg", seconds=0.008)
    told = [one for one in rig_of(tmp_path).missing if "its header says" in one]
    assert told == ["flat_80ms_0.jpg: its header says 0.008 s, which was taken; its name 0.08 s."]


def test_links_to_images_are_not_counted_again(tmp_path):
    """One link is to the folder itself, and one is next to the file that it leads to."""
    for n in range(2):
        write_image(tmp_path / f"IMG_{n}_{n + 1}s.tif", np.full((4, 4), 7, np.uint16))
    (tmp_path / "run").mkdir()
    write_image(tmp_path / "run" / "IMG_3_4s.tif", np.full((4, 4), 7, np.uint16))
    (tmp_path / "a").symlink_to("run")
    (tmp_path / "latest").symlink_to(".")
    (tmp_path / "0.tif").symlink_to("IMG_0_1s.tif")
    found = rig_of(tmp_path)
    listed = [one["file"] for one in tomllib.loads(found.text)["exposure"]]
    assert listed == ["IMG_0_1s.tif", "IMG_1_2s.tif", "run/IMG_3_4s.tif"]
    assert found.left_out == ["5 names of images that other names lead to as links."]


def test_only_images_without_a_time_are_named_as_such(tmp_path):
    for name in ("view_1s.tif", "view_2s.tif", "view.tif"):
        write_image(tmp_path / name, np.full((4, 4), 7, np.uint16))
    assert "Exposures of view.tif are in neither files nor names" in " ".join(
        rig_of(tmp_path).missing
    )
