"""Tests image files written by other programs, with independent packers and formulas: codes,
channels, windows and parts are those of the file."""

import re
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest

from fitting.noise import read_photon_transfer
from fitting.observation import read_frame, read_mask
from fitting.rig import Camera
from fitting.rig_from_folder import rig_of
from jaxvision.errors import InputError
from jaxvision.files.cameras import read_camera
from jaxvision.files.image_settings import read_settings
from jaxvision.files.images import read_channels, read_environment, read_image, write_image
from jaxvision.files.images import write_exr as write_blocks
from jaxvision.files.meshes import read_mesh

oiio = pytest.importorskip("OpenImageIO")


def packed(codes, bits):
    """Return rows of codes, (h, n), with the first bit first and each row starting at a whole byte
    (TIFF 6.0)."""
    rows = []
    for row in codes:
        digits = "".join(format(int(code), f"0{bits}b") for code in row)
        digits += "0" * (-len(digits) % 8)
        rows.append(int(digits, 2).to_bytes(len(digits) // 8, "big"))
    return b"".join(rows)


def write_tiff(
    path, codes, bits, *, photometric=1, tags=(), data=None, order=">", pages=1, subfile=0
):
    """Write a TIFF of one sample per pixel, byte by byte. All pages have the same content."""
    height, width = np.shape(codes)
    data = packed(codes, bits) if data is None else data
    out = (b"MM" if order == ">" else b"II") + struct.pack(order + "HI", 42, 8 + len(data)) + data
    for page in range(pages):
        entries = {
            254: (4, [subfile]),
            256: (3, [width]),
            257: (3, [height]),
            258: (3, [bits]),
            259: (3, [1]),
            262: (3, [photometric]),
            273: (4, [8]),
            277: (3, [1]),
            278: (3, [height]),
            279: (4, [len(data)]),
            **dict(tags),
        }
        entries = {tag: entry for tag, entry in entries.items() if entry}
        start = len(out)
        after = start + 2 + 12 * len(entries) + 4
        table, blobs = struct.pack(order + "H", len(entries)), b""
        for tag in sorted(entries):
            kind, values = entries[tag]
            letter = {1: "B", 3: "H", 4: "I", 5: "I"}[kind]
            raw = struct.pack(f"{order}{len(values)}{letter}", *values)
            table += struct.pack(order + "HHI", tag, kind, len(values) // (1 + (kind == 5)))
            if len(raw) > 4:
                table += struct.pack(order + "I", after + len(blobs))
                blobs += raw
            else:
                table += raw.ljust(4, b"\0")
        following = after + len(blobs) if page + 1 < pages else 0
        out += table + struct.pack(order + "I", following) + blobs
    Path(path).write_bytes(out)


def write_with_directory(path, codes, bits, tag, entries, *, tags=(), subfile=0):
    """Write a TIFF with a second directory, to which a tag of the first points."""
    at = 0
    for _ in range(2):  # the second time its offset is known
        write_tiff(path, codes, bits, tags={**dict(tags), tag: (4, [at])}, subfile=subfile)
        at = Path(path).stat().st_size
    table = struct.pack(">H", len(entries))
    for name, (kind, value) in sorted(entries.items()):
        table += struct.pack(">HHI", name, kind, 1) + struct.pack(
            f">{'H2x' if kind == 3 else 'I'}", value
        )
    with Path(path).open("ab") as stream:
        stream.write(table + bytes(4))


def write_png(path, codes, depth, *, colour=0, chunks=()):
    """Write a PNG byte by byte (ISO/IEC 15948)."""

    def chunk(kind, content):
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    width = np.shape(codes)[1] // (3 if colour == 2 else 1)
    rows = [b"\0" + packed([row], depth) for row in codes]
    head = struct.pack(">IIBBBBB", width, len(rows), depth, colour, 0, 0, 0)
    body = b"".join(chunk(*one) for one in [(b"IHDR", head), *chunks])
    body += chunk(b"IDAT", zlib.compress(b"".join(rows))) + chunk(b"IEND", b"")
    Path(path).write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def write_exr(path, names, *, shape=(4, 5), at=(0, 0), window=None, formats=(), title=""):
    """Write an EXR whose channels are each their number plus the pixel's position, and return the
    values."""
    height, width = shape
    spec = oiio.ImageSpec(width, height, len(names), "float")
    spec.channelnames = tuple(names)
    spec.y, spec.x = at
    if formats:
        spec.set_format(oiio.TypeDesc(formats[0]))
        spec.channelformats = tuple(formats)
    if window:
        spec.full_y, spec.full_x, spec.full_height, spec.full_width = window
    if title:
        spec.attribute("oiio:subimagename", title)
    values = np.arange(height * width, dtype=np.float32).reshape(height, width, 1) / 64
    values = np.ascontiguousarray(values + np.arange(1, len(names) + 1, dtype=np.float32))
    sink = oiio.ImageOutput.create(str(path))
    assert sink.open(str(path), spec)
    assert sink.write_image(values)
    sink.close()
    return values


# ------------------------------------------------ codes


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("bits", [1, 2, 4, 6, 8, 10, 12, 14, 16])
def test_every_code_of_a_tiff_of_any_depth(tmp_path, bits, order):
    codes = np.arange(2**bits).reshape(-1, min(2**bits, 256))
    if bits == 16:
        data = codes.astype(order + "u2").tobytes()
        write_tiff(tmp_path / "a.tif", codes, bits, order=order, data=data)
    else:
        write_tiff(tmp_path / "a.tif", codes, bits, order=order)
    read = read_image(tmp_path / "a.tif")
    assert read.dtype == (np.uint8 if bits <= 8 else np.uint16)
    np.testing.assert_array_equal(read, codes)
    assert read_settings(tmp_path / "a.tif").bits == bits


def test_a_tiff_without_a_stated_depth_has_one_bit(tmp_path):
    codes = np.random.default_rng(0).integers(0, 2, (5, 11))
    write_tiff(tmp_path / "a.tif", codes, 1, tags={258: None})
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), codes)
    assert read_settings(tmp_path / "a.tif").bits == 1


@pytest.mark.parametrize("within", [True, False])
def test_the_sensitivity_in_a_tiff_is_read(tmp_path, within):
    codes, file = np.zeros((2, 3), int), tmp_path / "a.tif"
    if within:
        write_with_directory(file, codes, 8, 34665, {34855: (3, 400)})
    else:  # in the main directory, as in TIFF/EP
        write_tiff(file, codes, 8, tags={34855: (3, [400])})
    assert read_settings(file).iso == 400


@pytest.mark.parametrize("bits", [1, 4, 8, 12, 16])
def test_white_as_zero_is_reversed_at_every_depth(tmp_path, bits):
    """OpenImageIO reverses only up to 8 bits."""
    codes = np.arange(2**bits).reshape(-1, min(2**bits, 256))
    data = codes.astype(">u2").tobytes() if bits == 16 else None
    write_tiff(tmp_path / "a.tif", codes, bits, photometric=0, data=data)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), 2**bits - 1 - codes)


def test_a_12_bit_tiff_needs_a_rig_of_12_bits(tmp_path):
    write_tiff(tmp_path / "dark.tif", [[64, 70, 4095]], 12)
    assert read_frame(tmp_path / "dark.tif", Camera(bits=12)).max() == 4095
    with pytest.raises(InputError, match=r"dark\.tif: 12-bit data, but the rig declares 14 bits"):
        read_frame(tmp_path / "dark.tif", Camera(bits=14))


def test_frames_of_12_bits_are_refused_in_a_rig_of_14(tmp_path):
    rng, rig = np.random.default_rng(0), "[camera]\nbits = 14\n"
    for i, mean in enumerate([64, 300, 900, 1500, 2100]):
        names = [f"{i}_{k}.tif" for k in (0, 1)]
        for name in names:
            write_tiff(tmp_path / name, rng.poisson(mean, (16, 16)), 12)
        kind = "flat" if i else "dark"
        rig += f"[[{kind}]]\nfiles = {names}\nexposure = {0.01 * max(i, 1)}\n"
    (tmp_path / "rig.toml").write_text(rig)
    with pytest.raises(InputError, match="12-bit data, but the rig declares 14 bits"):
        read_photon_transfer(tmp_path)


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
def test_every_code_of_a_grey_png(tmp_path, depth):
    codes = np.arange(2**depth)[None]
    write_png(tmp_path / "a.png", codes, depth)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), codes)
    assert read_settings(tmp_path / "a.png").bits == depth


@pytest.mark.parametrize("how", ["shifted", "repeated", "scaled"])
def test_significant_bits_of_a_png_give_the_original_codes(tmp_path, how):
    """12 bits are stored in 16, in each of the ways that the specification allows (12.4)."""
    codes = np.arange(4096)
    stored = {
        "shifted": codes << 4,
        "repeated": codes << 4 | codes >> 8,
        "scaled": np.round(codes * (65535 / 4095)).astype(int),
    }[how]
    write_png(tmp_path / "a.png", stored.reshape(64, 64), 16, chunks=[(b"sBIT", b"\x0c")])
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), codes.reshape(64, 64))
    assert read_settings(tmp_path / "a.png").bits == 12


def test_significant_bits_that_contradict_the_numbers_are_named(tmp_path):
    stored = np.array([[5, 4095, 70]])
    write_png(tmp_path / "a.png", stored, 16, chunks=[(b"sBIT", b"\x0c")])
    with pytest.warns(UserWarning, match=r"its sBIT \(12 significant bits\) is not used"):
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), stored)


@pytest.mark.parametrize(("step", "dtype"), [(257, np.uint8), (256, np.uint8), (190, np.uint16)])
@pytest.mark.parametrize("bits", [4, 8])
def test_a_tiff_palette_keeps_its_16_bits(tmp_path, bits, step, dtype):
    count = 2**bits
    palette = np.stack([np.arange(count), np.arange(count)[::-1], np.full(count, 3)]) * step
    indices = np.arange(count)[None]
    tags = {320: (3, palette.ravel().tolist())}
    write_tiff(tmp_path / "a.tif", indices, bits, photometric=3, tags=tags)
    expected = palette.T[indices] // (step if dtype == np.uint8 else 1)
    read = read_image(tmp_path / "a.tif")
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, expected)


@pytest.mark.parametrize("photometric", [5, 8])
def test_inks_and_lab_are_refused(tmp_path, photometric):
    tags = {258: (3, [8] * 4), 277: (3, [4])} if photometric == 5 else {}
    tags = tags or {258: (3, [8] * 3), 277: (3, [3])}
    write_tiff(
        *(tmp_path / "a.tif", np.zeros((2, 2)), 8),
        photometric=photometric,
        tags=tags,
        data=bytes(16),
    )
    with pytest.raises(InputError, match=r"holds (amounts of ink|CIE Lab).*convert it to RGB"):
        read_image(tmp_path / "a.tif")


def test_formats_whose_codes_cannot_be_recovered_are_refused(tmp_path):
    """OpenImageIO stretches a DPX of 10 bits to 16, for example."""
    spec = oiio.ImageSpec(4, 2, 3, "uint16")
    spec.attribute("oiio:BitsPerSample", 10)
    sink = oiio.ImageOutput.create(str(tmp_path / "a.dpx"))
    assert sink.open(str(tmp_path / "a.dpx"), spec)
    sink.write_image(np.zeros((2, 4, 3), np.uint16))
    sink.close()
    with pytest.raises(InputError, match=r"a\.dpx: is a file of dpx, whose codes do not come back"):
        read_image(tmp_path / "a.dpx")


# ------------------------------------------------ PGM, PPM, PFM, TGA


@pytest.mark.parametrize("largest", [1, 100, 255, 1023, 4095, 65535])
@pytest.mark.parametrize("magic", ["P2", "P3", "P5", "P6"])
def test_codes_of_netpbm_are_not_stretched(tmp_path, magic, largest):
    channels = 3 if magic in ("P3", "P6") else 1
    codes = np.linspace(0, largest, 12 * channels).astype(int).reshape(3, 4 * channels)
    head = f"{magic}\n# by hand\n4 3 # size\n{largest}\n".encode()
    if magic in ("P2", "P3"):
        body = "\n".join(" ".join(map(str, row)) for row in codes).encode() + b"\n"
    else:
        body = codes.astype(">u1" if largest < 256 else ">u2").tobytes()
    file = tmp_path / ("a.ppm" if channels == 3 else "a.pgm")
    file.write_bytes(head + body)
    read = read_image(file)
    assert read.dtype == (np.uint8 if largest < 256 else np.uint16)
    np.testing.assert_array_equal(read.reshape(codes.shape), codes)
    settings = read_settings(file)
    assert settings.bits == max(1, int(np.ceil(np.log2(largest + 1))))
    assert settings.saturation == (100 if largest == 100 else None)


def test_bitmaps_and_floats_of_netpbm(tmp_path):
    (tmp_path / "a.pbm").write_bytes(b"P4\n10 2\n" + packed([[1, 0] * 5, [0] * 9 + [1]], 1))
    white = 1 - np.array([[1, 0] * 5, [0] * 9 + [1]])
    np.testing.assert_array_equal(read_image(tmp_path / "a.pbm"), white)
    (tmp_path / "b.pbm").write_text("P1\n3 2\n101\n0 1 1\n")
    np.testing.assert_array_equal(read_image(tmp_path / "b.pbm"), [[0, 1, 0], [1, 0, 0]])
    values = np.arange(6, dtype=np.float32).reshape(2, 3) / 7
    for scale, kind in ((-1.0, "<f4"), (1.0, ">f4")):
        head = f"Pf\n3 2\n{scale}\n".encode()
        (tmp_path / "a.pfm").write_bytes(head + values[::-1].astype(kind).tobytes())
        np.testing.assert_array_equal(read_image(tmp_path / "a.pfm"), values)


def test_data_after_a_netpbm_picture_are_named(tmp_path):
    one = b"P5 2 1 255\n\x01\x02"
    (tmp_path / "a.pgm").write_bytes(one + one)
    with pytest.warns(UserWarning, match="13 bytes after its first picture are not used"):
        np.testing.assert_array_equal(read_image(tmp_path / "a.pgm"), [[1, 2]])


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"P5 2 2 255\n\x01", "holds 1 of 4 bytes"),
        (b"P2 2 1 255\n1 x\n", "words that are no numbers"),
        (b"P2 2 1 255\n1 256\n", "outside 0 to 255"),
        (b"P5 2 1 100\n\x01\xff", "holds 255, above its largest code 100"),
        (b"P5 2 0 100\n", "says 2 x 0"),
        (b"P5 2 2 70000\n", "largest code 70000"),
        (b"P7\nWIDTH 2\n", "not a PGM, PPM, PBM or PFM"),
    ],
)
def test_damaged_netpbm_is_one_sentence(tmp_path, content, reason):
    (tmp_path / "a.pgm").write_bytes(content)
    with pytest.raises(InputError, match=reason):
        read_image(tmp_path / "a.pgm")


@pytest.mark.parametrize("corner", [0x00, 0x10, 0x20, 0x30])
def test_tga_from_any_corner(tmp_path, corner):
    """Bit 5 of the descriptor says that rows start at the top, and bit 4 that columns start at the
    right."""
    picture = np.random.default_rng(1).integers(0, 256, (3, 4, 3), np.uint8)
    stored = picture if corner & 0x20 else picture[::-1]
    stored = stored[:, ::-1] if corner & 0x10 else stored
    head = struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 4, 3, 24, corner)
    (tmp_path / "a.tga").write_bytes(head + stored[..., ::-1].tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga"), picture)


@pytest.mark.parametrize(("depth", "size"), [(16, 2), (24, 3)])
@pytest.mark.parametrize("palette", [False, True])
def test_colours_of_a_tga_have_the_bits_of_the_file(tmp_path, palette, depth, size):
    """Colours have 5 bits each in 16, blue first, or 8 in 24, in pixels or in a palette."""
    colours = np.array([[0, 1, 2], [31, 0, 7], [4, 31, 31], [9, 8, 30]])  # R, G, B
    if depth == 16:
        stored = (colours @ [1 << 10, 1 << 5, 1]).astype("<u2").tobytes()
    else:
        stored = colours[:, ::-1].astype("u1").tobytes()
    kind, mapped = (1, (1, 0, 4, depth)) if palette else (2, (0, 0, 0, 0))
    head = struct.pack("<BBBHHB", 0, mapped[0], kind, *mapped[1:])
    head += struct.pack("<HHHHBB", 0, 0, 4, 1, 8 if palette else depth, 0x20)
    (tmp_path / "a.tga").write_bytes(head + stored + (bytes(range(4)) if palette else b""))
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga")[0], colours)
    assert read_settings(tmp_path / "a.tga").bits == (5 if depth == 16 else 8)


def test_a_folder_of_pgm_makes_a_rig(tmp_path):
    for i in (1, 2, 4, 8):
        codes = np.full((4, 4), 400 * i, ">u2")
        (tmp_path / f"scene_{i}ms.pgm").write_bytes(b"P5 4 4 4095\n" + codes.tobytes())
    found = rig_of(tmp_path)
    assert found.kind == "response"
    assert "bits = 12\n" in found.text
    write_tiff(tmp_path / "scene_16ms.tif", [[1, 2]], 10)
    assert any("depth (10 and 12 bits)" in said for said in rig_of(tmp_path).missing)


# ------------------------------------------------ Radiance


def write_hdr(path, stored, *, head=b"", size=None):
    first, second = stored.shape[:2]
    size = size or b"-Y %d +X %d" % (first, second)
    text = b"#?RADIANCE\n" + head + b"FORMAT=32-bit_rle_rgbe\n\n" + size + b"\n"
    Path(path).write_bytes(text + stored.tobytes())


def value_of(stored):
    """Return values by `colr_color` of Radiance's color.c."""
    value = np.zeros((*stored.shape[:2], 3))
    for place in np.ndindex(stored.shape[:2]):
        *mantissas, exponent = map(int, stored[place])
        if exponent:
            value[place] = [(m + 0.5) * 2.0 ** (exponent - 136) for m in mantissas]
    return value


RGBE = np.array(
    [
        [[128, 64, 32, 129], [200, 3, 0, 120]],
        [[0, 0, 0, 0], [255, 9, 9, 140]],
        [[5, 6, 7, 100]] * 2,
    ],
    np.uint8,
)


def test_radiance_files_are_read_as_by_radiance(tmp_path):
    write_hdr(tmp_path / "a.hdr", RGBE)
    np.testing.assert_array_equal(read_image(tmp_path / "a.hdr"), value_of(RGBE).astype("f4"))


def test_no_light_is_lost_by_writing_and_reading_radiance(tmp_path):
    light = np.random.default_rng(0).uniform(0.5, 1, (200, 300, 1)).repeat(3, 2).astype("f4")
    light[:, :20] = 0
    write_image(tmp_path / "a.hdr", light)
    read = read_image(tmp_path / "a.hdr")
    assert not read[:, :20].any()
    ratio = read[:, 20:].astype(float) / light[:, 20:]
    assert abs(ratio.mean() - 1) < 6 * ratio.std() / np.sqrt(ratio.size / 3)
    assert abs(ratio - 1).max() < 1 / 255  # half a step of .5


@pytest.mark.parametrize("value", [-0.5, np.nan, np.inf, 2.0**127, 3.3e38])
def test_values_beyond_radiances_range_are_refused(tmp_path, value):
    light = np.ones((2, 3, 3), np.float32)
    light[1, 2, 0] = value
    with pytest.raises(InputError, match=r"1 values are negative, not finite, or .*; write EXR"):
        write_image(tmp_path / "a.hdr", light)
    assert not (tmp_path / "a.hdr").exists()
    light[1, 2] = 0.99 * 2.0**127
    write_image(tmp_path / "a.hdr", light)
    np.testing.assert_allclose(read_image(tmp_path / "a.hdr"), light, rtol=1 / 128)


def test_exposure_and_colour_correction_are_undone(tmp_path):
    head = b"EXPOSURE=2\nSOFTWARE=x\nEXPOSURE= 0.25\nCOLORCORR= 1 2 4\nCOLORCORR=1 1 .5\n"
    write_hdr(tmp_path / "a.hdr", RGBE, head=head)
    expected = value_of(RGBE) / 0.5 / [1, 2, 2]
    np.testing.assert_allclose(read_image(tmp_path / "a.hdr"), expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("size", "upright"),
    [
        (b"+Y 3 +X 2", lambda v: v[::-1]),
        (b"-Y 3 -X 2", lambda v: v[:, ::-1]),
        (b"+X 3 -Y 2", lambda v: v.swapaxes(0, 1)),
        (b"-X 3 +Y 2", lambda v: v.swapaxes(0, 1)[::-1, ::-1]),
    ],
)
def test_radiance_pictures_stand_upright(tmp_path, size, upright):
    write_hdr(tmp_path / "a.hdr", RGBE, size=size)
    np.testing.assert_allclose(read_image(tmp_path / "a.hdr"), upright(value_of(RGBE)), rtol=1e-6)


def test_old_run_lengths_of_radiance(tmp_path):
    """A pixel 1, 1, 1, n repeats the previous one n times, and a second such pixel n times 256."""
    stored = np.array([[[10, 20, 30, 129], [1, 1, 1, 3], [1, 1, 1, 1], [5, 6, 7, 128]]], np.uint8)
    write_hdr(tmp_path / "a.hdr", stored, size=b"-Y 1 +X 261")
    read = read_image(tmp_path / "a.hdr")
    ends = value_of(stored[:, [0, 3]])[0]
    np.testing.assert_allclose(read[0, [0, 1, 259, 260]], ends[[0, 0, 0, 1]], rtol=1e-6)


def test_keys_of_radiance_headers_are_used_refused_or_named(tmp_path):
    write_hdr(tmp_path / "a.hdr", RGBE, head=b"PIXASPECT=2\n")
    with pytest.warns(UserWarning, match="pixels are not square"):
        read_image(tmp_path / "a.hdr")
    write_hdr(tmp_path / "a.hdr", RGBE, head=b"PRIMARIES=.64 .33 .3 .6 .15 .06 .31 .33\n")
    with pytest.warns(UserWarning, match="primaries .* are not used"):
        read_image(tmp_path / "a.hdr")
    text = (tmp_path / "a.hdr").read_bytes().replace(b"_rgbe", b"_xyze")
    (tmp_path / "a.hdr").write_bytes(text)
    with pytest.raises(InputError, match="holds CIE XYZ"):
        read_image(tmp_path / "a.hdr")
    write_hdr(tmp_path / "a.hdr", RGBE[:, :1], size=b"-Y 3 +X 9")
    with pytest.raises(InputError, match="holds 3 of 27 pixels"):
        read_image(tmp_path / "a.hdr")


# ------------------------------------------------ names, windows, parts


def test_channels_of_an_exr_are_found_by_name(tmp_path):
    values = write_exr(tmp_path / "a.exr", ["R", "G", "B", "Z"])
    with pytest.warns(UserWarning, match=r"a\.exr: its channel Z is not used"):
        pixels, names = read_channels(tmp_path / "a.exr")
    assert names == ("red", "green", "blue")
    np.testing.assert_array_equal(pixels, values[..., :3])
    values = write_exr(tmp_path / "b.exr", ["B", "A", "G", "left.R", "R"])
    with pytest.warns(UserWarning, match=r"its channel left\.R is not used"):
        pixels, names = read_channels(tmp_path / "b.exr")
    assert names == ("red", "green", "blue", "alpha")
    np.testing.assert_array_equal(pixels, values[..., [4, 2, 0, 1]])
    values = write_exr(tmp_path / "c.exr", ["Y", "Z"])
    with pytest.warns(UserWarning, match="its channel Z is not used"):
        np.testing.assert_array_equal(read_image(tmp_path / "c.exr"), values[..., 0])
    write_exr(tmp_path / "d.exr", ["Z"])
    assert read_channels(tmp_path / "d.exr")[1] == ("Z",)


@pytest.mark.parametrize("seed", [2**31 - 1, 2**32 - 1])
def test_the_header_of_an_exr_holds_any_seed(tmp_path, seed):
    file, block = tmp_path / "a.exr", np.ones((2, 2, 3), np.float32)
    write_blocks(file, [block], shape=block.shape, attributes={"seed": seed})
    assert int(oiio.ImageInput.open(str(file)).spec().getattribute("seed")) == seed


@pytest.mark.parametrize(
    ("layer", "called"), [("", "CIE X, Y and Z"), ("N.", r"N\.X, N\.Y and N\.Z")]
)
def test_xyz_is_named(layer, called, tmp_path):
    """The channels X, Y and Z of a layer are normals or positions, not colours."""
    write_exr(tmp_path / "a.exr", [layer + name for name in "XYZ"])
    with pytest.warns(UserWarning, match=f"holds {called}, not R, G and B"):
        assert read_channels(tmp_path / "a.exr")[1] == ("X", "Y", "Z")


@pytest.mark.parametrize("count", [3, 12, 105])
def test_many_channels_of_an_exr_keep_their_order(count, tmp_path):
    """The format sorts channels alphabetically, with channel10 before channel4."""
    pixels = np.arange(2 * 3 * count, dtype=np.float32).reshape(2, 3, count)
    write_image(tmp_path / "a.exr", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


def test_bands_of_an_exr_are_in_the_order_of_their_wavelengths(tmp_path):
    write_exr(tmp_path / "a.exr", ["1000nm", "450nm", "650,5nm"])
    assert read_channels(tmp_path / "a.exr")[1] == ("450nm", "650,5nm", "1000nm")


@pytest.mark.parametrize("compression", ["dwaa", "dwab", "b44", "b44a", "zip", "piz", "pxr24"])
@pytest.mark.parametrize("sample", ["half", "float"])
def test_a_lossy_compression_is_named(compression, sample, tmp_path):
    """The compression is named if numbers change by more than 1e-4."""
    written = np.random.default_rng(0).uniform(0, 1, (64, 64, 3)).astype(np.float16)
    spec = oiio.ImageSpec(64, 64, 3, sample)
    spec.attribute("compression", compression)
    out = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert out.open(str(tmp_path / "a.exr"), spec)
    out.write_image(written.astype(np.float32))
    out.close()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        read = read_image(tmp_path / "a.exr")
    lost = np.abs(read - written).max()
    named = [f"its compression ({compression}) is lossy" in str(w.message) for w in said]
    assert named == [True] * int(lost > 1e-4), lost


def test_a_tiff_in_jpeg_is_named(tmp_path):
    image = pytest.importorskip("PIL.Image")
    codes = np.random.default_rng(0).integers(0, 256, (16, 16, 3), np.uint8)
    image.fromarray(codes).save(tmp_path / "a.tif", compression="jpeg")
    with pytest.warns(UserWarning, match=r"compression \(jpeg\) is lossy"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("tag", "values", "said"),
    [
        (301, (3, [257 * i for i in range(256)]), r"TransferFunction: half .* is 0\.5 of the"),
        (301, (3, [round(65535 * (i / 255) ** 2.2) for i in range(256)]), None),
        (319, (5, [64, 100, 33, 100, 21, 100, 71, 100, 15, 100, 6, 100]), r"primaries \(0\.64, 0"),
        (319, (5, [64, 100, 33, 100, 30, 100, 60, 100, 15, 100, 6, 100]), None),
    ],
)
def test_colours_in_the_tags_of_a_tiff_are_named(tag, values, said, tmp_path):
    codes = np.arange(12, dtype=np.uint8).reshape(3, 4)
    write_tiff(tmp_path / "a.tif", codes, 8, tags=[(tag, values)])
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), codes)
    assert [bool(said and re.search(said, str(w.message))) for w in found] == [True] * bool(said)


def test_a_grey_gif_is_grey(tmp_path):
    codes = np.arange(12, dtype=np.uint8).reshape(3, 4)
    image = pytest.importorskip("PIL.Image")
    image.fromarray(codes).save(tmp_path / "a.gif")
    read, names = read_channels(tmp_path / "a.gif")
    np.testing.assert_array_equal(read, codes)
    assert names == ("grey",)
    colours = np.stack([codes, codes, codes + 1], -1)
    image.fromarray(colours).save(tmp_path / "b.gif")
    np.testing.assert_array_equal(read_image(tmp_path / "b.gif")[..., :3], colours)


@pytest.mark.parametrize(
    ("name", "shape", "reason"),
    [
        ("a.png", (2, 3, 5), "PNG holds one to four channels, got 5; write TIFF"),
        ("a.jpg", (1, 65536), "JPEG holds at most 65535 rows and columns"),
    ],
)
def test_losses_of_a_format_are_named(tmp_path, name, shape, reason):
    with pytest.raises(InputError, match=reason):
        write_image(tmp_path / name, np.zeros(shape, np.uint8))


def test_layers_of_an_exr_are_chosen_by_name(tmp_path):
    names = [f"{side}.{colour}" for side in ("left", "right") for colour in "RGB"]
    values = write_exr(tmp_path / "a.exr", names)
    with pytest.raises(InputError, match=r"holds the layers left, right.*choose one by part"):
        read_image(tmp_path / "a.exr")
    with pytest.warns(UserWarning, match=r"its channels left\.R, left\.G, left\.B are not used"):
        pixels = read_image(tmp_path / "a.exr", part="right")
    np.testing.assert_array_equal(pixels, values[..., 3:])
    with pytest.raises(InputError, match="has no part 'rihgt'; the nearest is 'right'"):
        read_image(tmp_path / "a.exr", part="rihgt")


def test_object_numbers_are_not_light(tmp_path):
    """OpenImageIO would divide integers by 4294967295, like those beside colours."""
    write_exr(tmp_path / "a.exr", ["R", "G", "B", "id"], formats=["half"] * 3 + ["uint"])
    with pytest.warns(UserWarning, match="channel id is not used"):
        assert read_image(tmp_path / "a.exr").shape == (4, 5, 3)
    write_exr(tmp_path / "a.exr", ["id"], formats=["uint"])
    with pytest.raises(InputError, match="samples are of type uint"):
        read_image(tmp_path / "a.exr")
    write_exr(tmp_path / "a.exr", ["Y", "RY", "BY"])
    with pytest.raises(InputError, match="luminance and chroma"):
        read_image(tmp_path / "a.exr")


def test_a_data_window_keeps_its_place(tmp_path):
    values = write_exr(tmp_path / "a.exr", ["R", "G", "B"], at=(2, 3), window=(0, 0, 8, 10))
    whole = np.zeros((8, 10, 3))
    whole[2:6, 3:8] = values
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), whole)
    values = write_exr(tmp_path / "b.exr", ["R", "G", "B"], at=(-1, -2), window=(0, 0, 2, 4))
    with pytest.warns(UserWarning, match="14 pixels outside its display window of 2 x 4"):
        read = read_image(tmp_path / "b.exr")
    np.testing.assert_array_equal(read[:, :3], values[1:3, 2:])
    assert not read[:, 3].any()
    write_exr(tmp_path / "c.exr", ["R", "G", "B"], at=(20, 0), window=(0, 0, 8, 10))
    with pytest.raises(InputError, match="none of its pixels lies within its display window"):
        read_image(tmp_path / "c.exr")
    write_exr(tmp_path / "d.exr", ["R", "G", "B"], window=(0, 0, 30000, 30000))
    with pytest.raises(InputError, match="4 x 5 pixels of a display window of 30000 x 30000"):
        read_image(tmp_path / "d.exr")


def test_primaries_other_than_srgbs_are_named(tmp_path):
    """The primaries are those of ACES, whose red is another colour."""
    spec = oiio.ImageSpec(4, 2, 3, "float")
    aces = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
    spec.attribute("chromaticities", "float[8]", aces)
    sink = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert sink.open(str(tmp_path / "a.exr"), spec)
    sink.write_image(np.ones((2, 4, 3), np.float32))
    sink.close()
    with pytest.warns(UserWarning, match=r"not used: its primaries \(0\.7347, 0\.2653, 0, 1"):
        read_image(tmp_path / "a.exr")


def test_colours_of_12_bits(tmp_path):
    colours = np.random.default_rng(2).integers(0, 4096, (5, 7, 3))
    tags = {258: (3, [12] * 3), 277: (3, [3])}
    data = packed(colours.reshape(5, 21), 12)
    write_tiff(tmp_path / "a.tif", colours[..., 0], 12, photometric=2, tags=tags, data=data)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), colours)


def test_a_cropped_sky_loads(tmp_path):
    values = write_exr(
        *(tmp_path / "sky.exr", ["R", "G", "B", "A"]),
        shape=(3, 12),
        at=(1, 0),
        window=(0, 0, 6, 12),
    )
    sky = read_environment(tmp_path / "sky.exr")
    assert sky.shape == (6, 12, 3)
    np.testing.assert_array_equal(sky[1:4], values[..., :3])
    assert not sky[[0, 4, 5]].any()


def test_parts_of_an_exr_are_named_and_chosen(tmp_path):
    specs = []
    for title in ("beauty", "depth"):
        spec = oiio.ImageSpec(5, 4, 3 if title == "beauty" else 1, "float")
        spec.attribute("oiio:subimagename", title)
        specs.append(spec)
    file = tmp_path / "a.exr"
    sink = oiio.ImageOutput.create(str(file))
    assert sink.open(str(file), tuple(specs))
    sink.write_image(np.full((4, 5, 3), 1, np.float32))
    assert sink.open(str(file), specs[1], "AppendSubimage")
    sink.write_image(np.full((4, 5, 1), 2, np.float32))
    sink.close()
    with pytest.warns(UserWarning, match="2 pictures; beauty is read, and depth is not used"):
        assert read_image(file).shape == (4, 5, 3)
    for part in (1, "depth"):
        assert (read_image(file, part=part) == 2).all()
    with pytest.raises(InputError, match="has no picture 2; it has 2, from 0"):
        read_image(file, part=2)


def test_a_smaller_copy_before_the_picture_is_skipped(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffWriter(tmp_path / "a.tif") as sink:
        sink.write(np.zeros((4, 4), np.uint8), subfiletype=1)
        sink.write(np.full((8, 8), 700, np.uint16))
    assert (read_image(tmp_path / "a.tif") == 700).all()
    assert read_settings(tmp_path / "a.tif").bits == 16


def test_pages_of_a_tiff_are_named_and_copies_are_not(tmp_path):
    write_tiff(tmp_path / "a.tif", [[1, 2]], 8, pages=3)
    with pytest.warns(UserWarning, match="3 pictures; number 0 is read, and number 1, number 2"):
        read_image(tmp_path / "a.tif")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_image(tmp_path / "a.tif", part=2)
    write_tiff(tmp_path / "b.tif", [[1, 2]], 8, subfile=1)
    with pytest.raises(InputError, match="small copies or masks"):
        read_image(tmp_path / "b.tif")


def test_a_picture_in_a_subifd_is_named(tmp_path):
    inside = {254: (4, 0), 256: (3, 60), 257: (3, 40), 258: (3, 16)}
    file = tmp_path / "a.tif"
    write_with_directory(file, np.zeros((4, 6), int), 8, 330, inside)
    with pytest.warns(UserWarning, match="its picture of 40 x 60 and 16 bits in a SubIFD"):
        assert read_image(file).shape == (4, 6)
    write_with_directory(file, np.zeros((4, 6), int), 8, 330, {**inside, 254: (4, 1)})
    with warnings.catch_warnings(action="error"):
        read_image(file)  # a smaller copy


@pytest.mark.parametrize("suffix", [".tif", ".png", ".jpg"])
def test_an_orientation_is_named(tmp_path, suffix):
    image = pytest.importorskip("PIL.Image")
    picture = image.fromarray(np.arange(12, dtype=np.uint8).reshape(3, 4))
    exif = picture.getexif()
    exif[0x112] = 6
    picture.save(tmp_path / f"a{suffix}", exif=exif)
    with pytest.warns(UserWarning, match=r"its orientation \(tag 6\): rows and columns are as"):
        assert read_image(tmp_path / f"a{suffix}").shape == (3, 4)


def test_animations_and_gain_maps_are_named(tmp_path):
    image = pytest.importorskip("PIL.Image")
    frames = [image.fromarray(np.full((3, 4), i, np.uint8)) for i in (5, 9)]
    frames[0].save(tmp_path / "a.png", save_all=True, append_images=frames[1:])
    with pytest.warns(UserWarning, match="its animation of 2 frames"):
        assert (read_image(tmp_path / "a.png") == 5).all()
    frames[0].save(tmp_path / "a.gif", save_all=True, append_images=frames[1:])
    with pytest.warns(UserWarning, match="holds 2 pictures"):
        read_image(tmp_path / "a.gif")
    frames[0].save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=frames[1:])
    with pytest.warns(UserWarning, match="not used: 1 further picture after the first"):
        read_image(tmp_path / "a.jpg")
    frames[0].save(tmp_path / "c.jpg", progressive=True)
    plain = (tmp_path / "c.jpg").read_bytes()
    (tmp_path / "c.jpg").write_bytes(plain + b"a film" + bytes(9))
    with pytest.warns(UserWarning, match="not used: 6 bytes after its picture"):
        read_image(tmp_path / "c.jpg")
    (tmp_path / "c.jpg").write_bytes(plain + bytes(9))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_image(tmp_path / "c.jpg")
    image.new("CMYK", (4, 3)).save(tmp_path / "b.jpg")
    with pytest.raises(InputError, match="amounts of ink"):
        read_image(tmp_path / "b.jpg")


def test_a_mosaic_in_tiff_gives_its_phase(tmp_path):
    tags = {33421: (3, [2, 2]), 33422: (1, [1, 0, 2, 1])}
    write_tiff(tmp_path / "a.tif", np.eye(4), 8, photometric=32803, tags=tags)
    assert read_settings(tmp_path / "a.tif").pattern == "GRBG"
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), np.eye(4))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_inspect_labels_channels_by_their_meaning(tmp_path, capsys):
    from typer.testing import CliRunner

    from jaxvision.cli import app

    write_exr(tmp_path / "a.exr", ["Z"])
    said = CliRunner().invoke(app, ["inspect", str(tmp_path / "a.exr")]).output
    assert "Z" in said
    write_exr(tmp_path / "b.exr", ["R", "G", "B", "Z"])
    said = CliRunner().invoke(app, ["inspect", str(tmp_path / "b.exr")]).output
    assert "alpha" not in said
    assert "jaxvision: " in said
    write_exr(tmp_path / "d.exr", ["left.Y", "right.Y"])
    said = CliRunner().invoke(app, ["inspect", str(tmp_path / "d.exr"), "--part", "right"]).output
    assert "grey" in said
    write_tiff(tmp_path / "c.tif", [[0, 4095, 9]], 12)
    said = CliRunner().invoke(app, ["inspect", str(tmp_path / "c.tif"), "--json"]).output
    assert '"saturated": 1' in said


def test_an_opaque_alpha_makes_no_mask(tmp_path):
    colours = np.zeros((2, 3, 4), np.uint8)
    colours[..., 3] = 255
    colours[1, 2, :3] = 255
    write_image(tmp_path / "mask.png", colours)
    mask = read_mask(tmp_path / "mask.png", Camera(bits=8))
    np.testing.assert_array_equal(mask, colours[..., 0] > 0)
    colours[0, 0, 3] = 0
    write_image(tmp_path / "mask.png", colours)
    with pytest.raises(InputError, match="alpha channel that varies"):
        read_mask(tmp_path / "mask.png", Camera(bits=8))


def test_the_unit_of_a_mesh_is_named(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box()
    box.units = "mm"
    box.export(tmp_path / "a.glb")
    with pytest.warns(UserWarning, match="says that its unit is mm, which is not used"):
        read_mesh(tmp_path / "a.glb")
    assert float(read_mesh(tmp_path / "a.glb", scale=1e-3).vertices.max()) == pytest.approx(5e-4)


def test_bands_that_no_filter_uses_are_named(tmp_path):
    text = "[view]\nkind = 'Pinhole'\nfocal_length = 8e-3\npixel_pitch = 5e-6\n"
    text += "resolution = [4, 6]\n[sensor]\n[bands]\nfirst = 4e-7\nlast = 7e-7\nstep = 1e-8\n"
    (tmp_path / "a.toml").write_text(text)
    with pytest.warns(UserWarning, match="bands has no effect without"):
        read_camera(tmp_path / "a.toml")


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
@pytest.mark.parametrize(("kind", "speed"), [(1, 204800), (2, 102400), (3, 51200), (7, 102400)])
def test_a_sensitivity_beyond_16_bits_is_read(tmp_path, suffix, kind, speed):
    """By EXIF 2.3, 65535 stands for this value and more, and 0x8830 says which 32-bit tag has
    it."""
    spec = oiio.ImageSpec(4, 4, 3, "uint8")
    for name, value in (
        ("PhotographicSensitivity", 65535),
        ("SensitivityType", kind),
        ("StandardOutputSensitivity", 204800),
        ("RecommendedExposureIndex", 102400),
        ("ISOSpeed", 51200),
    ):
        spec.attribute(f"Exif:{name}", value)
    file = tmp_path / f"a.{suffix}"
    sink = oiio.ImageOutput.create(str(file))
    assert sink.open(str(file), spec)
    assert sink.write_image(np.zeros((4, 4, 3), np.uint8))
    assert sink.close()
    assert read_settings(file).iso == speed


def test_a_sensitivity_of_65535_or_more_is_named(tmp_path):
    spec = oiio.ImageSpec(4, 4, 3, "uint8")
    spec.attribute("Exif:PhotographicSensitivity", 65535)
    file = tmp_path / "a.jpg"
    sink = oiio.ImageOutput.create(str(file))
    assert sink.open(str(file), spec)
    assert sink.write_image(np.zeros((4, 4, 3), np.uint8))
    assert sink.close()
    with pytest.warns(UserWarning, match="ISO 65535, which stands for that and more"):
        assert read_settings(file).iso is None


def test_an_exr_keeps_every_number_or_is_refused(tmp_path):
    file = tmp_path / "a.exr"
    held = np.array([[[-3.5], [np.nan], [np.inf], [-np.inf], [1e-60], [3.4e38]]])
    write_blocks(file, [held], shape=held.shape)
    np.testing.assert_array_equal(read_image(file), held[..., 0].astype(np.float32))
    held[..., :2, 0] = 1e39
    write_image(tmp_path / "b.exr", np.float32(held[:, 2:]))
    many = np.full((1, 3, 1), 2**24 + 1)
    small = np.array([[[1e-41], [0.0], [1e-60]]])
    for pixels, said in (
        (held, "ends at 3.4e38: 2 of 6 numbers do not fit"),
        (many, "ends for whole numbers at 2.24: 3 of 3"),
        (small, "has its 7 digits from 1e-31 on: 2 of 3"),
    ):
        with pytest.raises(InputError, match=said):
            write_blocks(tmp_path / "c.exr", [pixels], shape=pixels.shape)
        if pixels.dtype == float:
            with pytest.raises(InputError, match=said):
                write_image(tmp_path / "c.exr", pixels)
        assert not (tmp_path / "c.exr").exists()


@pytest.mark.parametrize("head", [b"PF4\n8 6\n-1.0\n", b"P58 6\n255\n"])
def test_text_numbers_of_netpbm_end_in_white_space(tmp_path, head):
    file = tmp_path / "a.pfm"
    file.write_bytes(head + bytes(8 * 6 * 16))
    with pytest.raises(InputError, match=f"begins with b'{head[:3].decode()}'"):
        read_image(file)


@pytest.mark.parametrize("scale", ["0", "-0.0", "nan", "-inf"])
def test_a_pfm_whose_scale_gives_no_byte_order_is_refused(tmp_path, scale):
    (tmp_path / "a.pfm").write_bytes(f"Pf\n1 1\n{scale}\n".encode() + np.float32(1).tobytes())
    with pytest.raises(InputError, match=r"its scale is .*, whose sign should give the order"):
        read_image(tmp_path / "a.pfm")
