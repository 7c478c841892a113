"""Tests raw files and FITS against bytes written by the tests and by astropy."""

import datetime
import struct
import sys

import numpy as np
import pytest
from raw_contents import dng

from fitting.rig_from_folder import rig_of
from jaxvision.errors import InputError
from jaxvision.files.image_settings import read_settings
from jaxvision.files.images import read_image


@pytest.fixture
def codes():
    return np.random.default_rng(0).integers(64, 4096, (48, 64)).astype(np.uint16)


@pytest.mark.parametrize("exif_apart", [True, False])
def test_raw_files_give_the_mosaic_and_its_settings(exif_apart, tmp_path, codes):
    pytest.importorskip("rawpy")
    (tmp_path / "a.dng").write_bytes(dng(codes, exif_apart=exif_apart))
    np.testing.assert_array_equal(read_image(tmp_path / "a.dng"), codes)
    said = read_settings(tmp_path / "a.dng")
    assert said.exposure == pytest.approx(1 / 60)
    assert said.f_number == pytest.approx(2.8)
    assert (said.iso, said.camera, said.pattern) == (400, "Maker Model 3", "BGGR")
    assert (said.black_level, said.saturation) == (64, 4095)
    assert said.taken == datetime.datetime(2026, 5, 4, 12, 30)


def test_raw_files_give_the_black_level_of_each_site(tmp_path, codes):
    """The order is that of the pattern, BGGR, as in a rig."""
    pytest.importorskip("rawpy")
    for name in ("scene_1-8s.dng", "scene_1-2s.dng"):
        (tmp_path / name).write_bytes(dng(codes, black=(60, 62, 63, 68)))
    assert read_settings(tmp_path / "scene_1-8s.dng").black_level == (60, 62, 63, 68)
    assert "black_level = [60, 62, 63, 68]" in rig_of(tmp_path).text


def test_fits_files_give_their_numbers_and_header(tmp_path, codes):
    fits = pytest.importorskip("astropy.io.fits")
    header = fits.Header(
        {"EXPTIME": 0.5, "DATE-OBS": "2026-05-04T12:30:00.5", "CCD-TEMP": -10.0, "INSTRUME": "X"}
    )
    fits.writeto(tmp_path / "a.fits", codes, header)  # as 16 bits with BZERO
    read = read_image(tmp_path / "a.fits")
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, codes)
    said = read_settings(tmp_path / "a.fits")
    assert (said.exposure, said.temperature, said.camera) == (0.5, 263.15, "X")
    assert said.taken.date() == datetime.date(2026, 5, 4)
    cube = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    fits.writeto(tmp_path / "b.fit", cube)
    with pytest.warns(UserWarning, match="2 planes of its third axis are taken as channels"):
        read = read_image(tmp_path / "b.fit")
    np.testing.assert_array_equal(read, np.moveaxis(cube, 0, -1))


def test_raw_files_whose_pixels_or_head_are_damaged(tmp_path, codes):
    """The pixels are read after the file is opened, and the header by another library."""
    whole, path = dng(codes), tmp_path / "a.dng"
    path.write_bytes(whole[:-100])
    for read in (read_image, read_settings):
        with pytest.raises(InputError, match=r"a\.dng: not readable as a raw file"):
            read(path)
    path.write_bytes(whole.replace(struct.pack("<HHI", 34665, 4, 1), bytes(8)))
    assert read_settings(path).exposure is None
    path.write_bytes(b"II*\0" + struct.pack("<I", 2**31))
    with pytest.raises(InputError, match=r"a\.dng: (its EXIF is damaged|not readable)"):
        read_settings(path)


CARDS = {
    "without a width": ("NAXIS1  ", "WIDTH   "),
    "a number of axes that is a word": (
        "NAXIS   =                    2",
        "NAXIS   = 'two'               ",
    ),
    "a width that is a word": ("NAXIS1  =                   64", "NAXIS1  = 'wide'              "),
    "no end": ("END     ", "OPEN    "),
}


@pytest.mark.parametrize("damage", CARDS)
@pytest.mark.filterwarnings("ignore")
def test_fits_with_a_damaged_header(damage, tmp_path, codes):
    fits = pytest.importorskip("astropy.io.fits")
    path = tmp_path / "a.fits"
    fits.writeto(path, codes)
    card, other = (text.encode() for text in CARDS[damage])
    content = path.read_bytes()
    assert card in content
    path.write_bytes(content.replace(card, other, 1))
    with pytest.raises(InputError, match=r"a\.fits: "):
        read_image(path)


@pytest.mark.parametrize("suffix", [".dng", ".fits"])
def test_damaged_files_and_missing_extras_are_sentences(suffix, tmp_path, monkeypatch):
    pytest.importorskip("rawpy")
    pytest.importorskip("astropy")
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"no such thing" * 40)
    with pytest.raises(InputError, match="not readable as"):
        read_image(path)
    monkeypatch.setitem(sys.modules, "rawpy", None)
    monkeypatch.setitem(sys.modules, "astropy.io.fits", None)
    with pytest.raises(InputError, match=r"pip install 'jaxvision-imaging\[(raw|fits)\]'"):
        read_image(path)


def test_an_orientation_of_a_raw_file_is_named(tmp_path, codes):
    pytest.importorskip("rawpy")
    (tmp_path / "a.dng").write_bytes(dng(codes, orientation=6))
    with pytest.warns(
        UserWarning, match=r"a\.dng: not used: its orientation: rows and columns are"
    ):
        np.testing.assert_array_equal(read_image(tmp_path / "a.dng"), codes)


@pytest.mark.parametrize(("second", "told"), [(0, True), (65537, False)])
def test_a_second_raw_picture_of_a_dng_is_named(tmp_path, recwarn, second, told):
    """After a preview the file has two mosaics. The second is a frame of its own or a smaller
    copy."""
    tifffile = pytest.importorskip("tifffile")
    raw = np.random.default_rng(0).integers(64, 4000, (64, 96)).astype(np.uint16)
    head = [(50706, "B", 4, bytes([1, 4, 0, 0]), True), (50708, "s", 0, "camera", True)]
    cfa = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes([0, 1, 1, 2]), True)]
    with tifffile.TiffWriter(tmp_path / "a.dng") as sink:
        preview = np.zeros((16, 24, 3), np.uint8)
        sink.write(preview, photometric="rgb", subfiletype=1, subifds=2, extratags=head)
        sink.write(raw, photometric=32803, extratags=cfa)
        sink.write(raw + 1, photometric=32803, subfiletype=second, extratags=cfa)
    np.testing.assert_array_equal(read_image(tmp_path / "a.dng"), raw)
    said = " ".join(str(one.message) for one in recwarn)
    assert ("1 of its 2 raw pictures" in said) == told
