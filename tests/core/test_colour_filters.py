"""Tests the mosaic of a colour filter array pixel by pixel, and the refusal of patterns that are
not tiles."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.sensor.colour_filters import BAYER_PHASES, bayer, check_pattern, mosaic, sites

XTRANS = tuple(
    tuple("RGB".index(letter) for letter in row)
    for row in ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")
)
PATTERNS = [bayer(phase) for phase in BAYER_PHASES] + [XTRANS, ((0,),), ((0, 1, 2),), ((1,), (0,))]
RNG = np.random.default_rng(2)


def test_bayer_reads_like_text():
    assert bayer("RGGB") == ((0, 1), (1, 2))
    assert bayer("GBRG") == ((1, 2), (0, 1))
    with pytest.raises(ValueError, match="RGGB, GRBG, GBRG, BGGR, got 'RGB'"):
        bayer("RGB")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_pixel_sees_the_band_of_its_place_in_the_tile(pattern):
    bands = 1 + max(max(row) for row in pattern)
    image = RNG.uniform(size=(2, 7, 9, bands))
    seen = np.asarray(mosaic(jnp.asarray(image), pattern))
    masks = [np.asarray(mask) for mask in sites(pattern, 7, 9)]
    for y in range(7):
        for x in range(9):
            band = pattern[y % len(pattern)][x % len(pattern[0])]
            assert [bool(mask[y, x]) for mask in masks] == [i == band for i in range(bands)]
            np.testing.assert_array_equal(seen[:, y, x], image[:, y, x, band])


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        (((0, 1), (1,)), "rows of one length"),
        ((), "rows of one length"),
        (((), ()), "rows of one length"),
        (((0, 2), (2, 3)), "without a gap"),
        (((1, 2), (2, 3)), "without a gap"),
        (((-1, 0), (0, 1)), "without a gap"),
    ],
)
def test_patterns_that_do_not_tile_are_refused(pattern, message):
    with pytest.raises(ValueError, match=message):
        check_pattern(pattern)
    with pytest.raises(ValueError, match=r"Demosaicing\.pattern must"):
        check_pattern(pattern, name="Demosaicing.pattern")


def test_bands_of_picture_and_pattern_agree():
    with pytest.raises(ValueError, match=r"has the 3 bands .* the picture has 4"):
        mosaic(jnp.ones((4, 4, 4)), bayer("RGGB"))
    with pytest.raises(ValueError, match=r"\(\.\.\., h, w, bands\), got shape \(4, 4\)"):
        mosaic(jnp.ones((4, 4)), ((0,),))
