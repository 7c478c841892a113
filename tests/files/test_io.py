"""Tests that image files are read back as written, in bit depth and values, with one sentence where
this is impossible."""

from pathlib import Path

import numpy as np
import pytest

from jaxvision.errors import InputError
from jaxvision.files import images as io
from jaxvision.files._heads import png_chunks
from jaxvision.files.images import (
    LONGEST_REASON,
    check_writable,
    read_image,
    write_exr,
    write_image,
)

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (1, 1), (4, 6, 4)])
def test_integer_files_keep_every_bit(tmp_path, suffix, dtype, shape):
    pixels = RNG.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    write_image(tmp_path / f"a{suffix}", pixels)
    read = read_image(tmp_path / f"a{suffix}")
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, pixels)


def test_where_no_file_can_be_made_is_said():
    with pytest.raises(InputError, match=r"^/proc/x\.exr: cannot be written: no file can be made"):
        check_writable(Path("/proc/x.exr"))


def test_sixteen_bit_png_is_sixteen_bit_on_disk(tmp_path):
    """Byte 24 of a PNG is the bit depth in its IHDR chunk (PNG specification, 11.2.2)."""
    write_image(tmp_path / "a.png", np.array([[0, 257, 65535]], np.uint16))
    assert (tmp_path / "a.png").read_bytes()[24] == 16


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_exr_keeps_float32(tmp_path, shape):
    radiance = RNG.lognormal(0, 5, shape).astype(np.float32)
    write_image(tmp_path / "a.exr", radiance.astype(np.float64))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), radiance)


def test_hdr_keeps_the_largest_channel_to_its_eight_bit_mantissa(tmp_path):
    radiance = RNG.lognormal(0, 3, (6, 5, 3)).astype(np.float32)
    write_image(tmp_path / "a.hdr", radiance)
    step = radiance.max(axis=-1, keepdims=True) / 128
    assert (np.abs(read_image(tmp_path / "a.hdr") - radiance) <= step).all()


def test_non_contiguous_pixels(tmp_path):
    pixels = RNG.integers(0, 65535, (8, 10, 3), np.uint16)[::2, ::-1]
    write_image(tmp_path / "a.png", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), pixels)


@pytest.mark.parametrize(
    ("name", "pixels", "expected"),
    [
        ("a.bmp", np.zeros((2, 2), np.uint8), "unknown image suffix"),
        ("a.jpg", np.zeros((2, 2), np.uint16), "uint16 pixels do not fit .jpg"),
        ("a.jpg", np.zeros((2, 2)), "float64 pixels do not fit .jpg"),
        ("a.jpg", np.zeros((2, 2, 4), np.uint8), "one or three channels"),
        ("a.png", np.zeros((2, 2)), r"float64 pixels do not fit .png.*to_integers makes codes"),
        ("a.png", np.zeros((2, 2), np.int32), "int32 pixels do not fit"),
        ("a.exr", np.zeros((2, 2), np.uint8), "uint8 pixels do not fit .exr"),
        ("a.hdr", np.zeros((2, 2)), "three channels"),
        ("a.png", np.zeros((2, 2, 2, 2), np.uint8), "an image is"),
        ("a.png", np.zeros((0, 2), np.uint8), "an image is"),
    ],
)
def test_unwritable_pixels_are_refused_and_leave_no_file(tmp_path, name, pixels, expected):
    with pytest.raises(InputError, match=expected):
        write_image(tmp_path / name, pixels)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.exr", "a.hdr", "a.npy"])
def test_unreadable_files_are_named(tmp_path, name):
    file = tmp_path / name
    with pytest.raises(InputError, match=r"a\.\w+: no such image file"):
        read_image(file)
    file.write_bytes(b"not an image at all, whatever its name says")
    with pytest.raises(InputError, match=r"not readable as an image|not a NumPy array"):
        read_image(file)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".exr"])
def test_files_cut_short_are_named(tmp_path, suffix):
    pixels = RNG.integers(0, 255, (200, 200), np.uint8)
    file = tmp_path / f"a{suffix}"
    write_image(file, pixels.astype(np.float32) if suffix == ".exr" else pixels)
    file.write_bytes(file.read_bytes()[:9000])
    with pytest.raises(InputError, match=f"a{suffix}.*(damaged|not readable)"):
        read_image(file)


@pytest.mark.parametrize("damage", ["cut", "end", "bit", "name"])
def test_a_damaged_png_is_one_sentence_and_no_line_of_libpng(tmp_path, capfd, damage):
    file = tmp_path / "a.png"
    write_image(file, RNG.integers(0, 255, (40, 40), np.uint8))
    chunks = png_chunks(file)
    assert chunks is not None
    assert chunks.fault is None
    whole = file.read_bytes()
    if damage == "name":
        file.write_bytes(whole.replace(b"IDAT", b"IDA\n"))
    elif damage == "bit":
        middle = len(whole) // 2
        file.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    else:
        file.write_bytes(whole[: 700 if damage == "cut" else -4])
    expected = {"bit": "check sum of its chunk IDAT", "name": "check sum of its chunk 4944410a is"}
    expected = expected.get(damage, "last chunk is missing")
    with pytest.raises(InputError, match=rf"a\.png: the file is damaged.*{expected}"):
        read_image(file)
    assert capfd.readouterr() == ("", "")


def test_a_failed_write_keeps_the_old_file(tmp_path):
    write_image(tmp_path / "a.png", np.full((2, 2), 7, np.uint8))
    with pytest.raises(InputError):
        write_image(tmp_path / "a.png", np.zeros((2, 2)))
    assert (read_image(tmp_path / "a.png") == 7).all()


def test_a_write_that_dies_half_way_keeps_the_old_file(tmp_path, monkeypatch):
    file = tmp_path / "a.png"
    write_image(file, np.full((2, 2), 7, np.uint8))

    def dies(partial, *_):
        partial.write_bytes(b"half of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(io, "_write", dies)
    with pytest.raises(KeyboardInterrupt):
        write_image(file, np.zeros((2, 2), np.uint8))
    assert (read_image(file) == 7).all()
    assert list(tmp_path.iterdir()) == [file]


# ------------------------------------------------ JPEG


def quantisation_tables(data):
    """Return the 8-bit tables of a JPEG's DQT segments (ITU-T T.81, B.2.4.1) by their number."""
    tables, at = {}, 2
    while data[at + 1] != 0xDA:
        size = int.from_bytes(data[at + 2 : at + 4], "big")
        segment = data[at + 4 : at + 2 + size]
        while data[at + 1] == 0xDB and segment:
            tables[segment[0] & 15] = np.frombuffer(segment[1:65], np.uint8).astype(int)
            segment = segment[65:]
        at += 2 + size
    return tables


# The first row of the luminance table of ITU-T T.81, K.1, in the file's zigzag order.
_LUMINANCE = np.array([16, 11, 12, 14, 12, 10, 16, 14])


@pytest.mark.parametrize("quality", [1, 30, 50, 75, 89, 90, 100])
def test_jpeg_quality_is_libjpegs(tmp_path, quality):
    """libjpeg scales the tables of T.81 by 5000 / q below 50 and by 200 - 2 q above, in per
    cent."""
    pixels = RNG.integers(0, 255, (32, 40, 3), np.uint8)
    write_image(tmp_path / "a.jpg", pixels, quality=quality)
    tables = quantisation_tables((tmp_path / "a.jpg").read_bytes())
    scale = 5000 // quality if quality < 50 else 200 - 2 * quality
    expected = np.clip((_LUMINANCE * scale + 50) // 100, 1, 255)
    np.testing.assert_array_equal(tables[0][:8], expected)


def test_a_smooth_picture_survives_jpeg(tmp_path):
    """The errors of a ramp in all three colours are about the quantisation at each quality."""
    ramp = np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1)
    pixels = np.dstack([ramp * 3, ramp.sum(-1)]).astype(np.uint8)
    errors = []
    for quality in (100, 95, 50, 5):
        write_image(tmp_path / "a.jpeg", pixels, quality=quality)
        read = read_image(tmp_path / "a.jpeg")
        assert read.shape == pixels.shape
        assert read.dtype == np.uint8
        errors.append(np.abs(read.astype(int) - pixels).mean())
    assert errors == sorted(errors)
    assert errors[0] < 0.6
    assert 2 < errors[3] < 20
    write_image(tmp_path / "grey.jpg", pixels[..., 0])
    assert read_image(tmp_path / "grey.jpg").shape == (48, 64)


@pytest.mark.parametrize("quality", [0, 101])
def test_jpeg_quality_has_a_range(tmp_path, quality):
    with pytest.raises(InputError, match=r"quality is 1 to 100"):
        write_image(tmp_path / "a.jpg", np.zeros((8, 8), np.uint8), quality=quality)
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------ EXR in pieces


def test_exr_is_written_row_by_row(tmp_path):
    picture = RNG.lognormal(0, 2, (45, 6, 4)).astype(np.float32)
    names = [f"band.{i}" for i in range(4)]
    blocks = (picture[i : i + 16] for i in range(0, 45, 16))
    write_exr(
        tmp_path / "a.exr",
        blocks,
        shape=picture.shape,
        channels=names,
        attributes={"jaxvision:seed": 3, "jaxvision:unit": "W"},
    )
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), picture)
    with pytest.raises(ValueError, match="the blocks hold 16 rows where the picture has 45"):
        write_exr(tmp_path / "b.exr", [picture[:16]], shape=picture.shape)
    with pytest.raises(ValueError, match="does not fit at row 0"):
        write_exr(tmp_path / "b.exr", [picture[:, :3]], shape=picture.shape)
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr"]


def test_every_damage_of_a_header_is_a_sentence(tmp_path):
    """The file has a byte that is not text, which the library's own message would quote, or a
    truncated tuple."""
    write_image(tmp_path / "a.exr", np.ones((2, 2), np.float32))
    written = (tmp_path / "a.exr").read_bytes()
    damaged = bytearray(written)
    damaged[16] = 0xFF
    (tmp_path / "a.exr").write_bytes(damaged)
    with pytest.raises(InputError, match=r"a\.exr: (not readable|the file is damaged)"):
        read_image(tmp_path / "a.exr")
    (tmp_path / "a.exr").write_bytes(bytes(written).replace(b"channels", b"channelt"))
    with pytest.raises(InputError) as caught:  # each complaint, under the file's path
        read_image(tmp_path / "a.exr")
    words = str(caught.value)
    assert "\n" not in words
    assert len(words) < LONGEST_REASON + len(str(tmp_path)) + 120
    np.save(tmp_path / "a.npy", np.ones((2, 2)))
    sound = (tmp_path / "a.npy").read_bytes()
    for damage in ((b"(2, 2)", b"(2, 2 "), (b"<f8", b",f8"), (b" 'fortran", b"b'fortran")):
        (tmp_path / "a.npy").write_bytes(sound.replace(*damage))
        with pytest.raises(InputError, match=r"a\.npy: not a NumPy array file"):
            read_image(tmp_path / "a.npy")
