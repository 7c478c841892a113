"""Tests demosaicing against colour-demosaicing, naive loops, and pictures that must be recovered
exactly."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.development import (
    demosaic,
    demosaic_bilinear,
    demosaic_malvar,
    demosaic_menon,
    demosaic_normalised,
)
from jaxvision.sensor.colour_filters import BAYER_PHASES, bayer, mosaic

peers = pytest.importorskip("colour_demosaicing")

RNG = np.random.default_rng(8)
# integers, whose sums are exact, so that Menon's decisions do not depend on rounding
CODES = RNG.integers(0, 1024, size=(15, 18)).astype(float)
XTRANS = tuple(
    tuple("RGB".index(letter) for letter in row)
    for row in ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")
)
INSIDE = np.s_[1:-1, 1:-1]


@pytest.mark.parametrize("phase", BAYER_PHASES)
def test_bilinear_is_colour_demosaicings_inside(phase):
    """At the border colour-demosaicing darkens, because it divides by the weights of missing
    pixels."""
    peer = peers.demosaicing_CFA_Bayer_bilinear(CODES, phase)
    ours = demosaic_bilinear(CODES, bayer(phase))
    np.testing.assert_array_equal(np.asarray(ours)[INSIDE], peer[INSIDE])


def test_a_band_axis_of_length_one_as_from_a_sensor():
    np.testing.assert_array_equal(demosaic(CODES[..., None], "RGGB"), demosaic(CODES, "RGGB"))


@pytest.mark.parametrize("phase", BAYER_PHASES)
def test_malvar_is_colour_demosaicings(phase):
    peer = peers.demosaicing_CFA_Bayer_Malvar2004(CODES, phase)
    np.testing.assert_allclose(
        demosaic_malvar(CODES, bayer(phase), border="mirror"), peer, rtol=0, atol=1e-12 * 1024
    )


@pytest.mark.parametrize(
    ("phase", "refine"), [("RGGB", True), ("GRBG", True), ("GBRG", False), ("BGGR", True)]
)
def test_menon_is_colour_demosaicings(phase, refine):
    peer = peers.demosaicing_CFA_Bayer_Menon2007(CODES, phase, refine)
    ours = jax.jit(partial(demosaic_menon, pattern=bayer(phase), refine=refine))(CODES)
    np.testing.assert_allclose(ours, peer, rtol=0, atol=1e-12 * 1024)


@pytest.mark.parametrize(
    ("border", "how"),
    [
        ("in_phase", {"mode": "reflect"}),
        ("clamp", {"mode": "edge"}),
        ("wrap", {"mode": "wrap"}),
        ("zero", {"mode": "constant"}),
        ("extend", {"mode": "reflect", "reflect_type": "odd"}),
    ],
)
def test_borders_are_those_of_numpy(border, how):
    """The reference pads the mosaic by a tile on each side, demosaics it by colour-demosaicing, and
    crops it."""
    peer = peers.demosaicing_CFA_Bayer_Malvar2004(np.pad(CODES, 2, **how), "GRBG")
    ours = demosaic(CODES, bayer("GRBG"), border=border)
    np.testing.assert_allclose(ours, peer[2:-2, 2:-2], atol=1e-9)


def natural_images():
    data = pytest.importorskip("skimage.data")
    # all three are in the installed package
    return {
        "astronaut": data.astronaut()[:256, 128:384],
        "chelsea": data.chelsea()[20:276, 100:356],
        "coffee": data.coffee()[60:316, 150:406],
    }


def psnr(got, truth):
    inner = np.s_[4:-4, 4:-4]
    error = np.clip(np.asarray(got), 0, 255)[inner] - truth[inner]
    return float(10 * np.log10(255**2 / np.mean(error**2)))


@pytest.mark.slow
def test_psnr_on_natural_images():
    """The PSNR equals colour-demosaicing's, and each method gains a few dB over the one before, as
    published (Malvar 2004: 5.5 dB over bilinear on the Kodak set; Menon 2007: 2 to 4 dB over linear
    filters)."""
    algorithms = {
        "bilinear": peers.demosaicing_CFA_Bayer_bilinear,
        "malvar": peers.demosaicing_CFA_Bayer_Malvar2004,
        "menon": peers.demosaicing_CFA_Bayer_Menon2007,
    }
    for name, image in natural_images().items():
        truth = image.astype(float)
        raw = mosaic(truth, bayer("RGGB"))
        found = {m: psnr(demosaic(raw, "RGGB", method=m), truth) for m in algorithms}
        print(name, {method: round(value, 2) for method, value in found.items()})
        for method, peer in algorithms.items():
            assert abs(found[method] - psnr(peer(np.asarray(raw), "RGGB"), truth)) < 1e-6
        assert found["malvar"] > found["bilinear"] + 3
        assert found["menon"] > found["malvar"] + 1


@pytest.mark.parametrize("method", ["bilinear", "malvar", "menon", "normalised"])
def test_a_uniform_colour_is_recovered(method):
    colour = np.array([0.7, 0.2, 0.4])
    raw = mosaic(jnp.broadcast_to(jnp.asarray(colour), (7, 9, 3)), bayer("GBRG"))
    picture = demosaic(raw, bayer("GBRG"), method=method)
    np.testing.assert_allclose(picture, np.broadcast_to(colour, (7, 9, 3)), rtol=1e-14)


@pytest.mark.parametrize("method", ["bilinear", "malvar", "menon"])
def test_a_grey_ramp_is_recovered_inside(method):
    y, x = np.mgrid[:20, :21]
    ramp = 0.1 + 0.03 * x - 0.02 * y
    raw = mosaic(jnp.asarray(np.repeat(ramp[..., None], 3, -1)), bayer("RGGB"))
    inner = np.s_[8:-8, 8:-8]  # beyond the reach of the border
    picture = np.asarray(demosaic(raw, bayer("RGGB"), method=method))
    np.testing.assert_allclose(picture[inner], np.repeat(ramp[inner][..., None], 3, -1), rtol=1e-13)


def test_measured_values_are_unchanged():
    for method in ("bilinear", "malvar", "normalised"):
        picture = demosaic(CODES, bayer("BGGR"), method=method)
        np.testing.assert_array_equal(mosaic(picture, bayer("BGGR")), CODES)


def by_loops(raw, pattern):
    """Return means of the pixels that measure each band, weighted by a tent as wide as the tile."""
    rows, columns = np.shape(pattern)
    height, width = raw.shape
    seen = np.tile(pattern, (height // rows + 1, width // columns + 1))[:height, :width]
    picture = np.zeros((*raw.shape, seen.max() + 1))
    for y, x, band in np.ndindex(*picture.shape):
        if seen[y, x] == band:
            picture[y, x, band] = raw[y, x]
            continue
        light = weights = 0.0
        for v, u in np.ndindex(*raw.shape):
            if seen[v, u] == band and abs(v - y) < rows and abs(u - x) < columns:
                weight = (rows - abs(v - y)) * (columns - abs(u - x))
                light, weights = light + weight * raw[v, u], weights + weight
        picture[y, x, band] = light / weights
    return picture


@pytest.mark.parametrize("pattern", [XTRANS, ((0, 1, 2), (2, 0, 1)), ((3, 1), (0, 2)), ((0,),)])
def test_any_pattern_by_normalised_means(pattern):
    raw = CODES[:8, :10]
    np.testing.assert_allclose(
        demosaic_normalised(raw, pattern), by_loops(raw, pattern), rtol=1e-13
    )


def test_normalised_means_of_bayer_are_bilinear_inside():
    ours = np.asarray(demosaic_normalised(CODES, bayer("GRBG")))
    bilinear = np.asarray(demosaic_bilinear(CODES, bayer("GRBG")))
    np.testing.assert_allclose(ours[INSIDE], bilinear[INSIDE], rtol=1e-14)


def test_the_names_of_the_bands_do_not_matter():
    usual = np.asarray(demosaic(CODES, ((0, 1), (1, 2))))
    np.testing.assert_array_equal(demosaic(CODES, ((2, 0), (0, 1))), usual[..., [1, 2, 0]])


@pytest.mark.parametrize("method", ["bilinear", "malvar", "menon", "normalised"])
def test_no_pictures_are_none(method):
    for shape in ((0, 6, 8), (2, 0, 6, 8)):
        assert demosaic(np.zeros(shape, np.float32), bayer("RGGB"), method=method).shape == (
            *shape,
            3,
        )


@pytest.mark.sweep
@pytest.mark.parametrize("method", ["malvar", "menon", "normalised"])
def test_a_batch_is_a_loop_in_any_precision(method):
    batch = jnp.asarray(RNG.integers(0, 256, size=(2, 1, 6, 8)), jnp.float32)
    whole = demosaic(batch, bayer("RGGB"), method=method)
    assert whole.shape == (2, 1, 6, 8, 3)
    assert whole.dtype == jnp.float32
    for i in range(2):
        single = demosaic(batch[i, 0], bayer("RGGB"), method=method)
        np.testing.assert_allclose(whole[i, 0], single, rtol=3e-7, atol=2e-5)


def test_codes_are_taken_as_numbers():
    codes = CODES.astype(np.uint16)
    np.testing.assert_array_equal(demosaic(codes, bayer("RGGB")), demosaic(CODES, bayer("RGGB")))


@pytest.mark.parametrize("method", ["bilinear", "malvar", "menon", "normalised"])
def test_sums_of_codes_in_half_precision_do_not_overflow(method):
    raw = np.full((6, 8), 30000, np.float16)  # the sum of four exceeds 65504
    found = demosaic(raw, "RGGB", method=method)
    assert found.dtype == np.float16
    np.testing.assert_array_equal(found, np.float16(30000))


def test_nan_stays_within_its_window():
    holed = CODES.copy()
    holed[7, 9] = np.nan
    wrong = np.isnan(np.asarray(demosaic_malvar(holed, bayer("RGGB")))).any(-1)
    assert wrong[7, 9]
    wrong[5:10, 7:12] = False
    assert not wrong.any()


@pytest.mark.parametrize("at", [(7, 9), (8, 8), (0, 0), (8, 11), (5, 1)])
def test_nan_is_in_all_pixels_that_depend_on_it(at):
    """All output pixels that depend on the value become NaN, including those that depend on Menon's
    choice of direction."""
    holed, known = CODES.copy(), [demosaic_menon(CODES, bayer("RGGB"))]
    for value in (0.0, 30.0, 300.0, 4000.0):
        holed[at] = value
        known.append(demosaic_menon(holed, bayer("RGGB")))
    holed[at] = np.nan
    found = np.isnan(demosaic_menon(holed, bayer("RGGB")))
    assert found[np.ptp(known, axis=0) > 1e-9].all()
    assert not found.all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: demosaic(CODES, bayer("RGGB"), method="best"), "bilinear, malvar, menon"),
        (lambda: demosaic(CODES, bayer("RGGB"), border="cut"), "border must be one of"),
        (lambda: demosaic(CODES, bayer("RGGB"), method="menon", border="zero"), "of its own"),
        (lambda: demosaic_malvar(CODES, XTRANS), 'take method "normalised"'),
        (lambda: demosaic_malvar(CODES, ((0, 1), (2, 3))), 'take method "normalised"'),
        (lambda: demosaic_malvar(CODES, ((0, 0), (1, 2))), 'take method "normalised"'),
        (lambda: demosaic_normalised(CODES, ((0, 1), (1,))), "rows of one length"),
        (lambda: demosaic_normalised(CODES[:5], XTRANS), r"at least a tile of \(6, 6\)"),
        (lambda: demosaic_malvar(CODES[0], bayer("RGGB")), r"got shape \(18,\)"),
        (lambda: demosaic(np.ones((4, 6, 3)), "RGGB"), r"\(4, 6, 3\) has three bands a pixel"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
