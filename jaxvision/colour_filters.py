"""Colour filter arrays: the one band that each pixel of a mosaic sensor sees.

A pattern is rows of band indices, ((0, 1), (1, 2)) for red-green over green-blue: static and
hashable. Its tile is repeated from the first pixel of the picture down and to the right, and the
last tiles may be cut. Bands are 0, 1, ... without a gap, each somewhere in the tile. Pictures are
in any unit, relative, electrons or DN, which they keep. `ValueError` for any other pattern.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Shaped

from ._types import check_tile

Pattern = tuple[tuple[int, ...], ...]
Picture = Shaped[Array | np.ndarray, "*picture"]
Mosaic = Shaped[Array, "*batch h w"]

BAYER_PHASES = ("RGGB", "GRBG", "GBRG", "BGGR")


def bayer(phase: str) -> Pattern:
    """The 2 x 2 tile of Bayer's mosaic (US patent 3971065) that starts with those four letters,
    read like text; bands 0, 1, 2 are R, G, B. `phase`: one of `BAYER_PHASES`."""
    if phase not in BAYER_PHASES:
        known = ", ".join(BAYER_PHASES)
        raise ValueError(f"phase must be one of {known}, got {phase!r}.")
    first, second, third, fourth = ("RGB".index(letter) for letter in phase)
    return (first, second), (third, fourth)


def check_pattern(pattern: Pattern, *, bands: int | None = None, name: str = "pattern") -> None:
    """Raises `ValueError` unless the tile is a rectangle (else it does not tile the plane) of bands
    0 to its largest, all of them there; `bands`: how many a picture has, which must be as many."""
    check_tile(name, pattern, bands=bands)


def band_at(pattern: Pattern, height: int, width: int) -> Int[np.ndarray, "h w"]:
    """The band (h, w) that each pixel of a picture of that size sees, no unit."""
    check_pattern(pattern)
    tile = np.asarray(pattern)
    rows, columns = np.arange(height) % len(tile), np.arange(width) % tile.shape[1]
    return tile[rows[:, None], columns]


def sites(pattern: Pattern, height: int, width: int) -> tuple[Bool[Array, "h w"], ...]:
    """For each band of the pattern, which pixels of a picture of that size see it; no unit.

    Put together from rows and columns, so that a compiled program holds no mask of every pixel.
    """
    check_pattern(pattern)
    tile = np.asarray(pattern)
    at_row = np.arange(height)[:, None] % len(tile)
    at_column = np.arange(width) % tile.shape[1]

    def of_band(band: int) -> Bool[Array, "h w"]:
        seen = jnp.zeros((height, width), bool)
        for i, row in enumerate(tile):
            columns = jnp.asarray((row == band)[at_column][None])
            seen |= jnp.asarray(at_row == i) & columns
        return seen

    return tuple(of_band(band) for band in range(tile.max() + 1))


def mosaic(image: Picture, pattern: Pattern) -> Mosaic:
    """What a sensor behind that filter array sees of (..., h, w, bands): the one value of each
    pixel, (..., h, w), in the unit of the image.

    `ValueError` for a pattern that does not tile or has other bands than the image.
    """
    if image.ndim < 3:
        raise ValueError(f"image must be (..., h, w, bands), got shape {image.shape}.")
    *_, height, width, bands = image.shape
    check_pattern(pattern, bands=bands)
    seen = jnp.zeros(image.shape[:-1], image.dtype)
    for band, here in enumerate(sites(pattern, height, width)):
        here = jnp.broadcast_to(here, seen.shape)
        seen = jnp.where(here, image[..., band], seen)
    return seen
