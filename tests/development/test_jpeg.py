"""Tests the loss of JPEG files, level by level, against libjpeg (through Pillow and OpenCV)."""

import io
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.development import jpeg, quantisation_tables

files = pytest.importorskip("PIL.Image")
RNG = np.random.default_rng(4)


def through_a_file(codes, quality, subsampling="4:2:0"):
    chroma = {"4:4:4": 0, "4:2:0": 2}[subsampling]
    buffer = io.BytesIO()
    options = {"subsampling": chroma} if codes.ndim == 3 else {}
    files.fromarray(codes).save(buffer, "JPEG", quality=quality, **options)
    return np.asarray(files.open(io.BytesIO(buffer.getvalue())))


def relative(codes, dtype=jnp.float32):
    planes = codes if codes.ndim == 3 else codes[..., None]
    return jnp.asarray(planes / 255, dtype)


def levels(picture):
    """Return the codes of a result, which must be integers already."""
    codes = 255 * np.asarray(picture, np.float64)
    np.testing.assert_allclose(codes, np.round(codes), atol=2e-5)
    return np.round(codes).astype(int)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
def test_half_precision_passes_through_float32(compressed, dtype):
    picture = relative(RNG.integers(0, 256, (9, 7, 3))).astype(dtype)
    got, wide = (compressed(x, 90.0) for x in (picture, picture.astype(jnp.float32)))
    assert got.dtype == dtype
    np.testing.assert_array_equal(got, wide.astype(dtype))


@pytest.fixture(scope="module")
def compressed():
    """Return `jpeg`, compiled once for each shape and subsampling."""
    return jax.jit(jpeg, static_argnames=("subsampling", "rounding"))


def test_tables_are_libjpegs_at_every_quality():
    blank = files.fromarray(np.zeros((8, 8, 3), np.uint8))
    tables = jax.jit(quantisation_tables)
    for quality in range(1, 101):
        buffer = io.BytesIO()
        blank.save(buffer, "JPEG", quality=quality)
        stored = files.open(io.BytesIO(buffer.getvalue())).quantization
        for dtype in (jnp.float32, jnp.float64):
            for ours, theirs in zip(tables(dtype(quality)), stored.values(), strict=True):
                np.testing.assert_array_equal(ours.ravel(), theirs)


PICTURES = {
    # odd sizes have incomplete blocks, and chroma of half a pixel
    "photograph": lambda: pytest.importorskip("skimage.data").astronaut()[90:193, 170:283],
    "noise": lambda: RNG.integers(0, 256, size=(41, 54, 3)).astype(np.uint8),
}


@pytest.mark.sweep
@pytest.mark.parametrize("subsampling", ["4:4:4", "4:2:0"])
@pytest.mark.parametrize("name", PICTURES)
def test_no_level_differs_from_libjpeg(name, subsampling, compressed):
    codes = PICTURES[name]()
    for quality in (1, 10, 35, 50, 75, 85, 92, 95, 100):
        ours = compressed(relative(codes), jnp.float32(quality), subsampling=subsampling)
        truth = through_a_file(codes, quality, subsampling)
        np.testing.assert_array_equal(levels(ours), truth, err_msg=f"quality {quality}")


@pytest.mark.slow
def test_the_same_levels_in_double_precision(compressed):
    codes = PICTURES["photograph"]()
    ours = compressed(relative(codes, jnp.float64), jnp.asarray(60.0))
    np.testing.assert_array_equal(levels(ours), through_a_file(codes, 60))


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("shape", [(1, 1, 3), (3, 17, 3), (16, 16, 3), (9, 8)])
def test_small_and_grey_pictures(shape, compressed):
    codes = RNG.integers(0, 256, size=shape).astype(np.uint8)
    ours = levels(compressed(relative(codes), jnp.float32(80)))
    truth = through_a_file(codes, 80)
    np.testing.assert_array_equal(ours if codes.ndim == 3 else ours[..., 0], truth)


@pytest.mark.sweep
@pytest.mark.parametrize("shape", [(7, 1, 3), (17, 2, 3), (9, 4, 3), (5, 5, 3)])
def test_pictures_of_few_columns(shape, compressed):
    """libjpeg repeats chroma of up to two columns, without its triangle filter."""
    codes = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    truth = through_a_file(codes, 99)
    np.testing.assert_array_equal(levels(compressed(relative(codes), jnp.float32(99))), truth)


@pytest.mark.slow
def test_opencv_reads_the_same(compressed):
    cv2 = pytest.importorskip("cv2")
    codes = PICTURES["photograph"]()
    _, buffer = cv2.imencode(".jpg", codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 70])
    truth = cv2.imdecode(buffer, cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(levels(compressed(relative(codes), jnp.float32(70))), truth)


@pytest.mark.slow
def test_values_beyond_the_codes_are_clipped(compressed):
    wild = RNG.uniform(0, 1, size=(16, 16, 3)).astype(np.float32)
    wild[5, 6], wild[7, 8] = np.inf, -np.inf
    wild[9, 10] = 1.7
    tame = np.clip(wild, 0, 1)
    quality = jnp.float32(75)
    np.testing.assert_array_equal(
        compressed(jnp.asarray(wild), quality), compressed(jnp.asarray(tame), quality)
    )


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("rounding", ["straight_through", "cubic"])
@pytest.mark.parametrize(("subsampling", "block"), [("4:4:4", 8), ("4:2:0", 16)])
def test_nan_spreads_over_all_dependent_pixels(rounding, subsampling, block):
    """NaN spreads over the pixel's block and, with chroma at half size, to the neighbouring pixels
    that share a chroma sample."""
    compressed = partial(jpeg, subsampling=subsampling, rounding=rounding)
    picture = RNG.uniform(0, 1, size=(48, 48, 3)).astype(np.float32)
    dark, bright, unknown = picture.copy(), picture.copy(), picture.copy()
    dark[20, 21], bright[20, 21], unknown[20, 21, 1] = 0, (1, 0, 1), np.nan
    quality = jnp.float32(90)
    found = np.isnan(np.asarray(compressed(unknown, quality)))
    assert found[compressed(dark, quality) != compressed(bright, quality)].all()
    corner, beside = (20 // block * block, 21 // block * block), block == 16
    (top, bottom), (left, right) = ((at - beside, at + block + beside) for at in corner)
    assert found[top:bottom, left:right].sum() == found.sum() > 0
    assert np.isnan(compressed(np.full((9, 9, 1), np.nan), 50.0)).all()


@pytest.mark.slow
def test_gradients_pass_as_if_nothing_were_rounded(compressed):
    """Without rounding and with full chroma, compression is the identity up to the 13 bits of the
    cosines. With chroma at half size the sum of each colour is preserved."""
    picture = jnp.asarray(RNG.uniform(0.3, 0.7, size=(16, 24, 3)))
    tangent = jnp.asarray(RNG.normal(size=picture.shape))

    def change(subsampling):
        f = partial(compressed, quality=jnp.asarray(75.0), subsampling=subsampling)
        return jax.jvp(f, (picture,), (tangent,))[1]

    np.testing.assert_allclose(change("4:4:4"), tangent, atol=2e-3)
    np.testing.assert_allclose(change("4:2:0").sum((0, 1)), tangent.sum((0, 1)), atol=2e-3 * 384)


@pytest.mark.parametrize(("quality", "code"), [(50.0, 135.3), (20.0, 91.8), (90.0, 200.4)])
def test_soft_rounding_of_one_coefficient(quality, code, compressed):
    """A uniform grey has one coefficient, 8 (code - 128), and is decoded with its soft rounding."""
    step = {50.0: 16, 20.0: 40, 90.0: 3.2}[quality]  # 16 times the scale, not rounded
    level = 8 * (code - 128) / step
    soft = np.round(level) + (level - np.round(level)) ** 3
    flat = jnp.full((8, 8, 1), code / 255)
    ours = compressed(flat, jnp.asarray(quality), rounding="cubic")
    np.testing.assert_allclose(255 * ours, 128 + soft * step / 8, rtol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"subsampling": "4:2:1"}, "4:4:4, 4:2:0, got '4:2:1'"),
        ({"rounding": "floor"}, "straight_through, cubic, got 'floor'"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(ValueError, match=message):
        jpeg(jnp.ones((8, 8, 3)), 75.0, **options)


def test_refused_shapes_and_codes():
    with pytest.raises(ValueError, match=r"got shape \(8, 8, 2\)"):
        jpeg(jnp.ones((8, 8, 2)), 75.0)
    with pytest.raises(ValueError, match="divide by 255"):
        jpeg(jnp.ones((8, 8, 3), jnp.uint8), 75.0)
    with pytest.raises(ValueError, match="whole numbers up to 200: divide the codes"):
        jpeg(jnp.full((8, 8, 3), 200.0), 75.0)
