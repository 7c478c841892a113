"""Tests FITS files of other programs: the phase of their mosaics, blank values, units and axes."""

import numpy as np
import pytest

from fitting.rig_from_folder import rig_of
from jaxvision.errors import InputError
from jaxvision.files.image_settings import read_settings
from jaxvision.files.images import read_image

fits = pytest.importorskip("astropy.io.fits")
RGGB = np.array([["R", "G"], ["G", "B"]])


def phase(path, rows=4, **header):
    fits.writeto(path, np.zeros((rows, 6), np.uint16), fits.Header(header), overwrite=True)
    return read_settings(path).pattern


@pytest.mark.parametrize("down", [0, 1, 2, 5])
@pytest.mark.parametrize("right", [0, 1, 3])
def test_the_phase_of_a_mosaic_starts_at_its_offsets(tmp_path, right, down):
    expected = "".join(np.roll(RGGB, (-down, -right), (0, 1)).ravel())
    header = {"BAYERPAT": " rggb ", "XBAYROFF": right, "YBAYROFF": down}
    assert phase(tmp_path / "a.fits", **header) == expected


@pytest.mark.parametrize("rows", [4, 5])
@pytest.mark.parametrize("order", ["TOP-DOWN", "BOTTOM-UP", None])
def test_rows_from_below_change_the_phase(tmp_path, order, rows):
    """The pattern is for the upright picture, so for bottom-up files its rows start with the
    last."""
    header = {"BAYERPAT": "GRBG"} | ({"ROWORDER": order} if order else {})
    upright = np.tile(np.array([["G", "R"], ["B", "G"]]), (3, 3))[:rows]
    stored = upright[::-1] if order == "BOTTOM-UP" else upright
    assert phase(tmp_path / "a.fits", rows, **header) == "".join(stored[:2, :2].ravel())


def test_other_words_for_the_mosaic(tmp_path):
    assert phase(tmp_path / "a.fits", COLORTYP="BGGR") == "BGGR"
    assert phase(tmp_path / "a.fits", COLORTYP="RAW16") is None
    with pytest.warns(UserWarning, match=r"a\.fits: its mosaic \(RGGR\) is not used"):
        assert phase(tmp_path / "a.fits", BAYERPAT="RGGR") is None


@pytest.mark.parametrize("dtype", ["u1", "i2", "u2", "i4"])
def test_blank_pixels_are_no_numbers(tmp_path, dtype):
    codes = np.arange(12, dtype=dtype).reshape(3, 4)
    header = fits.Header({"BLANK": 7 - (32768 if dtype == "u2" else 0)})
    fits.writeto(tmp_path / "a.fits", codes, header)
    read = read_image(tmp_path / "a.fits")
    expected = codes.astype(float)
    expected[1, 3] = np.nan
    np.testing.assert_array_equal(read, expected)


def test_scales_are_applied(tmp_path):
    unit = fits.PrimaryHDU(np.arange(6, dtype=np.int16).reshape(2, 3))
    unit.header["BSCALE"], unit.header["BZERO"] = 0.5, 10.0
    unit.writeto(tmp_path / "a.fits")
    np.testing.assert_array_equal(
        read_image(tmp_path / "a.fits"), np.arange(6).reshape(2, 3) / 2 + 10
    )


def test_units_are_named_and_chosen(tmp_path):
    image, errors = np.ones((2, 3), np.float32), np.full((2, 3), 2, np.float32)
    table = fits.BinTableHDU.from_columns([fits.Column("x", "E", array=[1.0])], name="STARS")
    head = fits.PrimaryHDU(header=fits.Header({"EXPTIME": 3.0, "CCD-TEMP": -20.0}))
    units = [head, fits.ImageHDU(image, name="SCI"), fits.ImageHDU(errors, name="ERR"), table]
    file = tmp_path / "a.fits"
    fits.HDUList(units).writeto(file)
    said = r"unit 2 \(ERR\), unit 3 \(STARS\) are not used"
    with pytest.warns(UserWarning, match=said):
        np.testing.assert_array_equal(read_image(file), image)
    for part in ("ERR", 2):
        np.testing.assert_array_equal(read_image(file, part=part), errors)
    with pytest.raises(InputError, match="has no image 'STARS'; its units are 0 PRIMARY, 1 SCI"):
        read_image(file, part="STARS")
    settings = read_settings(file)  # the first unit has no image
    assert (settings.exposure, settings.temperature) == pytest.approx((3.0, 253.15))


def test_a_third_axis_that_is_not_colour_is_said(tmp_path):
    cube = np.arange(24, dtype=np.float32).reshape(3, 2, 4)
    fits.writeto(tmp_path / "rgb.fits", cube, fits.Header({"CTYPE3": "RGB"}))
    np.testing.assert_array_equal(read_image(tmp_path / "rgb.fits"), np.moveaxis(cube, 0, -1))
    fits.writeto(tmp_path / "open.fits", cube)  # frames, filters or colours
    with pytest.warns(UserWarning, match="the 3 planes of its third axis are taken as channels"):
        read_image(tmp_path / "open.fits")
    fits.writeto(tmp_path / "time.fits", cube, fits.Header({"CTYPE3": "TIME"}))
    with pytest.warns(
        UserWarning, match=r"3 planes of its third axis \(TIME\) are taken as channels"
    ):
        read_image(tmp_path / "time.fits")
    fits.writeto(tmp_path / "one.fits", cube[None, :1])
    np.testing.assert_array_equal(read_image(tmp_path / "one.fits"), cube[0])


def test_a_file_cut_short_is_one_sentence(tmp_path):
    fits.writeto(tmp_path / "a.fits", np.zeros((100, 100), np.float32))
    whole = (tmp_path / "a.fits").read_bytes()
    (tmp_path / "a.fits").write_bytes(whole[:20_000])
    with pytest.raises(InputError, match=r"a\.fits: (the file is cut short|not readable as FITS)"):
        read_image(tmp_path / "a.fits")
    strange = whole.replace(b"conforms", b"c\xf6nforms")  # a header that causes a warning
    for data in (whole, strange):
        (tmp_path / "a.fits").write_bytes(data[:43_000])  # in the padding of the last block
        with pytest.raises(InputError, match=r"a\.fits: the file is cut short; copy it again"):
            read_image(tmp_path / "a.fits")


@pytest.mark.parametrize("pedestal", [-100, 100])
def test_a_pedestal_is_a_black_level_in_either_sign(tmp_path, pedestal):
    """In SBIG's convention the number must be added to reach 0. Others write the number that was
    added."""
    fits.writeto(tmp_path / "a.fits", np.zeros((2, 2)), fits.Header({"PEDESTAL": pedestal}))
    assert read_settings(tmp_path / "a.fits").black_level == 100


def test_an_exposure_that_is_no_number_hides_none(tmp_path):
    head = fits.Header({"EXPTIME": "0.5 s", "EXPOSURE": 0.5})
    fits.writeto(tmp_path / "a.fits", np.zeros((2, 2)), head)
    assert read_settings(tmp_path / "a.fits").exposure == 0.5


@pytest.mark.parametrize(("kind", "name"), [("Bias Frame", "b"), ("zero", "b"), (None, "bias")])
def test_a_bias_frame_has_no_exposure(tmp_path, kind, name):
    head = {"EXPTIME": 0.0} | ({"IMAGETYP": kind} if kind else {})
    for i in range(2):
        unit = fits.PrimaryHDU(np.full((20, 20), 100 + i, np.uint16), fits.Header(head))
        unit.writeto(tmp_path / f"{name}_{i}.fits")
    found = rig_of(tmp_path)
    assert "exposure = 0  # a bias frame" in found.text
    assert not any("Exposures" in sentence for sentence in found.missing)
