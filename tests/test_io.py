"""Files come back as they went: depth, values, and one sentence when they cannot."""

import numpy as np
import pytest

from jaxvision.errors import InputError
from jaxvision.io import read_image, write_image

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


def test_sixteen_bit_png_is_sixteen_bit_on_disk(tmp_path):
    """Byte 24 of a PNG is the bit depth of its IHDR chunk (PNG specification, 11.2.2)."""
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
        ("a.jpg", np.zeros((2, 2), np.uint8), "unknown image suffix"),
        ("a.png", np.zeros((2, 2)), "float64 pixels do not fit .png"),
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


def test_a_failed_write_keeps_the_old_file(tmp_path):
    write_image(tmp_path / "a.png", np.full((2, 2), 7, np.uint8))
    with pytest.raises(InputError):
        write_image(tmp_path / "a.png", np.zeros((2, 2)))
    assert (read_image(tmp_path / "a.png") == 7).all()
