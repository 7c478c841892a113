"""Tests headers written by other programs: lengths, scales and black levels are used, named or
refused."""

import re
import struct
import warnings
import zlib

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from raw_contents import dng

from jaxvision.errors import InputError
from jaxvision.files.image_settings import read_settings
from jaxvision.files.images import read_image

CODES = (np.arange(12).reshape(3, 4) * 300 + 7).astype(">u2")


@pytest.mark.parametrize("ending", [b"\r\n", b" # of a program\n", b"#\r\n", b"\n"])
@pytest.mark.parametrize(
    ("head", "pixels"),
    [
        (b"P5\n4 3\n65535", CODES),
        (b"P5\n4 3\n255", np.full((3, 4), 10, np.uint8)),  # 10 is white space
        (b"Pf\n4 3\n-1.0", np.linspace(1, 2, 12, dtype="<f4").reshape(3, 4)),
    ],
)
def test_a_netpbm_header_ends_with_its_line(ending, head, pixels, tmp_path):
    stored = pixels[::-1] if head.startswith(b"Pf") else pixels
    suffix = ".pfm" if head.startswith(b"Pf") else ".pgm"
    file = tmp_path / f"picture{suffix}"
    file.write_bytes(head + ending + stored.tobytes())
    np.testing.assert_array_equal(read_image(file), pixels)
    file.write_bytes(head + ending + stored.tobytes() + b"more")
    if ending == b"\n":
        with pytest.warns(UserWarning, match="4 bytes after its first picture"):
            np.testing.assert_array_equal(read_image(file), pixels)
    else:
        with pytest.raises(InputError, match="its length fits no such head"):
            read_image(file)


def test_floating_numbers_of_a_dng_are_refused(tmp_path):
    """LibRaw scales them so that the brightest of each file is 16383."""
    file = tmp_path / "merged.dng"
    file.write_bytes(dng(np.full((32, 32), 500, np.uint16), more=[(339, 3, [3])]))
    with pytest.raises(InputError, match="floating numbers, which LibRaw scales"):
        read_image(file)


@pytest.mark.parametrize(
    ("black", "more", "level"),
    [
        ((60, 70, 80, 90), [], (60.0, 70.0, 80.0, 90.0)),
        ((60, 60, 60, 60, 90, 90, 90, 90), [(50713, 3, [4, 2])], None),
        ((64,), [(50715, 10, [(200 * (i > 15), 1) for i in range(32)])], None),
        ((64,), [(50715, 10, [(0, 1)] * 32)], 64.0),
        ((64,), [(50716, 10, [(8 * (i % 2), 1) for i in range(32)])], (64.0, 64.0, 72.0, 72.0)),
        (None, [(50714, 5, [(129, 2)])], 64.5),
    ],
)
def test_black_levels_beyond_a_mosaics_are_named(black, more, level, tmp_path):
    """LibRaw gives the mean of rows and columns, or the first sites only."""
    file = tmp_path / "raw.dng"
    file.write_bytes(dng(np.full((32, 32), 500, np.uint16), black=black or (), more=more))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert read_settings(file).black_level == level
    named = [one for one in caught if "black level is not used" in str(one.message)]
    assert len(named) == (level is None)


def test_imagejs_calibration_of_codes_is_named(tmp_path):
    """Signed images are stored as codes from 0 with a calibration."""
    words = b"ImageJ=1.54f\ncf=0\nc0=-32768.0\nc1=1.0\nvunit=Gray Value\n\0"
    assert _warnings(_tiff(tmp_path, words)) == [
        "not used: its calibration by ImageJ (cf = 0, c0 = -32768.0, c1 = 1.0): the codes are as "
        "stored."
    ]
    assert not _warnings(_tiff(tmp_path, b"ImageJ=1.54f\nunit=inch\n\0"))


def test_gdals_scale_and_missing_values_are_named(tmp_path):
    """Reflectances from satellites are codes with a scale and a code for missing values."""
    words = (
        b'<GDALMetadata><Item name="SCALE" sample="0" role="scale">0.0001</Item>'
        b'<Item name="OFFSET" sample="0" role="offset">-0.1</Item></GDALMetadata>\0'
    )
    more = [(42112, 2, len(words), 201), (42113, 2, 6, 201 + len(words))]
    file = _tiff(tmp_path, b"\0", more)
    file.write_bytes(file.read_bytes() + words + b"-9999\0")
    assert _warnings(file) == [
        "not used: its scale = 0.0001, offset = -0.1 by GDAL: the numbers are as stored; that "
        "pixels of -9999 are missing, by GDAL."
    ]
    plain = words.replace(b"0.0001", b"1.0000").replace(b"-0.1", b"-0.0")
    file = _tiff(tmp_path, b"\0", more[:1])
    file.write_bytes(file.read_bytes() + plain)
    assert not _warnings(file)


def test_the_luminance_of_white_is_named(tmp_path):
    import OpenImageIO as oiio

    file = tmp_path / "a.exr"
    spec = oiio.ImageSpec(2, 2, 3, "float")
    spec.attribute("whiteLuminance", 100.0)
    out = oiio.ImageOutput.create(str(file))
    out.open(str(file), spec)
    out.write_image(np.ones((2, 2, 3), np.float32))
    out.close()
    (said,) = _warnings(file, np.ones((2, 2, 3)))
    assert "luminance of white, 100 cd m^-2: values are relative, as stored" in said


def _warnings(file, pixels=((1, 2), (3, 4))):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(read_image(file), pixels)
    return [str(one.message).removeprefix(f"{file}: ") for one in caught]


def _tiff(folder, words, more=(), *, count=1):
    """Write 16-bit grey codes 1 to 4 in two columns, with a description and more tags."""
    own = [
        (256, 3, 1, 2),
        (257, 3, 1, 2 // count),
        (258, 3, count, 16 * (1 + 65536 * (count - 1))),
        (259, 3, 1, 1),
        (262, 3, 1, 1),
        (270, 2, len(words), 200),
        (273, 4, 1, 190),
        (277, 3, 1, 1),
        (278, 3, 1, 2),
        (279, 4, 1, 8),
    ]
    tags = sorted({tag[0]: tag for tag in (*own, *more)}.values())
    data = b"II*\0" + struct.pack("<IH", 8, len(tags))
    data += b"".join(struct.pack("<HHII", *tag) for tag in tags) + b"\0" * 4
    data = data.ljust(190, b"\0") + struct.pack("<4H", 1, 2, 3, 4)
    file = folder / "imagej.tif"
    file.write_bytes(data.ljust(200, b"\0") + words)
    return file


@pytest.mark.parametrize(("alpha", "named"), [(1, True), (2, False)])
def test_premultiplied_colours_are_named(alpha, named, tmp_path):
    """The same codes mean twice the brightness of half-covered white in one of the two files."""
    words = b"\0"
    tags = [(338, 3, 1, alpha), (262, 3, 1, 1), (277, 3, 1, 2)]
    told = _warnings(_tiff(tmp_path, words, tags, count=2), [[[1, 2], [3, 4]]])
    assert any("multiplied by alpha" in one for one in told) == named


def _png(*chunks):
    """Return a grey PNG of 2 x 3 codes, with chunks before its pixels."""
    head = struct.pack(">IIBBBBB", 3, 2, 8, 0, 0, 0, 0)
    rows = zlib.compress(b"".join(b"\0" + bytes([10 * i, 20, 30]) for i in range(2)))
    parts = [(b"IHDR", head), *chunks, (b"IDAT", rows), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in parts
    )


@pytest.mark.parametrize(
    ("chunk", "words"),
    [
        (
            (b"pCAL", b"heat\0" + struct.pack(">iiBB", 0, 255, 0, 2) + b"K\0" + b"273\0" + b"51"),
            r"its calibration 'heat' in K \(pCAL: codes 0 to 255, law 0 of 273 51\)",
        ),
        ((b"sCAL", b"\1" + b"0.1\0" + b"0.2"), r"the size of its pixels, 0\.1 x 0\.2 m \(sCAL\)"),
        ((b"gAMA", struct.pack(">I", 100000)), r"its exponent of 1 \(gAMA\)"),
        ((b"cICP", bytes([9, 16, 0, 1])), r"its transfer curve \(cICP: PQ\)"),
        ((b"gAMA", struct.pack(">I", 45455)), None),
        ((b"cICP", bytes([1, 13, 0, 1])), None),
        ((b"pCAL", b"short"), None),
        ((b"sCAL", b""), None),
    ],
)
def test_chunks_of_a_png_about_its_numbers_are_named(chunk, words, tmp_path):
    file = tmp_path / "a.png"
    file.write_bytes(_png(chunk))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(read_image(file), [[0, 20, 30], [10, 20, 30]])
    assert len(said) == (words is not None)
    assert re.search(words or "", " ".join(str(one.message) for one in said))


def _icc(primaries, curve, space=b"RGB "):
    """Return the profile of a screen from the XYZ of its primaries under D50 and one curve."""
    places = [
        b"XYZ \0\0\0\0" + struct.pack(">3i", *np.int32(np.array(p) * 65536)) for p in primaries
    ]
    curves = [curve + b"\0" * (-len(curve) % 4)] * 3
    names = [b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC"]
    table, body, start = b"", b"", 128 + 4 + 12 * 6
    for name, data in zip(names, places + curves, strict=True):
        table += struct.pack(">4sII", name, start + len(body), len(data))
        body += data
    size = struct.pack(">I", start + len(body))
    head = size + b"none" + bytes([2, 16, 0, 0]) + b"mntr" + space + b"XYZ " + bytes(12) + b"acsp"
    head += bytes(28) + struct.pack(">3i", 63190, 65536, 54061)
    return head.ljust(128, b"\0") + struct.pack(">I", 6) + table + body


SRGB = ((0.4361, 0.2225, 0.0139), (0.3851, 0.7169, 0.0971), (0.1431, 0.0606, 0.7141))
ADOBE = ((0.6097, 0.3111, 0.0195), (0.2053, 0.6257, 0.0609), (0.1492, 0.0632, 0.7446))
LINES = {  # u8Fixed8 exponents, a table, and a function
    "2.2": b"curv\0\0\0\0" + struct.pack(">IH", 1, 563),
    "1": b"curv\0\0\0\0" + struct.pack(">I", 0),
    "1.8": b"curv\0\0\0\0"
    + struct.pack(">I257H", 257, *np.int64(65535 * np.linspace(0, 1, 257) ** 1.8)),
    "sRGB": b"para\0\0\0\0\0\3\0\0"
    + struct.pack(
        ">5i", *(round(65536 * x) for x in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045))
    ),
}


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
@pytest.mark.parametrize(
    ("primaries", "curve", "words"),
    [
        (SRGB, "sRGB", None),
        (SRGB, "2.2", None),
        (ADOBE, "2.2", r"not used: its primaries \(ICC profile"),
        (
            SRGB,
            "1",
            r"not used: its tone curve \(ICC profile.*: half of the largest code is 0.5 of",
        ),
        (SRGB, "1.8", r"largest code is 0.29 of the light, where sRGB has 0.21\)"),
    ],
)
def test_icc_profiles_other_than_srgb_are_named(primaries, curve, words, suffix, tmp_path):
    codes = np.full((16, 16, 3), 128, np.uint8)
    file = tmp_path / f"a.{suffix}"
    Image.fromarray(codes).save(file, icc_profile=_icc(primaries, LINES[curve]))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(read_image(file), codes)
    assert len(said) == (words is not None)
    assert re.search(words or "", " ".join(str(one.message) for one in said))


@pytest.mark.parametrize(
    ("chunk", "words"),
    [
        ((b"cHRM", (31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000)), r"0\.06; cHRM\)"),
        ((b"cHRM", (31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)), None),
        ((b"cICP", (12, 13, 0, 1)), r"its primaries \(cICP: Display P3\)"),
    ],
)
def test_primaries_of_a_png_other_than_srgb_are_named(chunk, words, tmp_path):
    name, numbers = chunk
    info, file = PngInfo(), tmp_path / "a.png"
    info.add(name, bytes(numbers) if name == b"cICP" else struct.pack(">8I", *numbers))
    Image.fromarray(np.full((4, 4, 3), 99, np.uint8)).save(file, pnginfo=info)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        read_image(file)
    assert len(said) == (words is not None)
    assert re.search(words or "", " ".join(str(one.message) for one in said))
