"""Colour filter arrays, which define the band that each pixel of a mosaic sensor measures.

A pattern is a tuple of rows of band indices, such as ((0, 1), (1, 2)) for red-green over
green-blue. A pattern is static and hashable. The pattern is one tile, which is repeated from the
first pixel of the picture down and to the right. The last tiles may be incomplete. The bands 0, 1,
... must all occur in the tile, without a gap; any other pattern raises `ValueError`. Pictures may
have any unit.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Shaped

from ..core._arguments import takes_numbers
from ..core._types import BAYER_PHASES, as_tile, check_choice, check_tile, print_by_name

Pattern = tuple[tuple[int, ...], ...]
Picture = Shaped[Array | np.ndarray, "*picture"]
Mosaic = Shaped[Array, "*batch h w"]
print_by_name(globals(), "Picture", "Mosaic")


def bayer(phase: str) -> Pattern:
    """Return the 2 x 2 tile of a Bayer mosaic (US patent 3971065).

    Args:
        phase: the four colours of the tile, read like text: one of `BAYER_PHASES`.

    Returns:
        The pattern, with bands 0, 1, 2 for R, G, B.

    Raises:
        ValueError: an unknown phase.

    Example:
        >>> jv.bayer("RGGB")
        ((0, 1), (1, 2))
    """
    check_choice("phase", phase, BAYER_PHASES)
    return as_tile(phase)


def as_pattern(pattern: Pattern | str) -> Pattern:
    """Return a pattern from its rows or from the name of a Bayer phase."""
    return as_tile(pattern)


def check_pattern(pattern: Pattern, *, bands: int | None = None, name: str = "pattern") -> None:
    """Raise `ValueError` unless a pattern tiles the plane and contains all bands from 0 to its
    largest."""
    check_tile(name, pattern, bands=bands)


def sites(pattern: Pattern | str, height: int, width: int) -> tuple[Bool[Array, "h w"], ...]:
    """Return, for each band, the mask of the pixels that measure it. A mask is a combination of
    masks of rows and of columns, so that a compiled program need not contain a constant for every
    pixel."""
    pattern = as_pattern(pattern)
    check_pattern(pattern)
    tile = np.asarray(pattern)
    at_row = np.arange(height)[:, None] % len(tile)
    at_column = np.arange(width) % tile.shape[1]

    def mask(band: int) -> Bool[Array, "h w"]:
        seen = jnp.zeros((height, width), bool)
        for i, row in enumerate(tile):
            columns = jnp.asarray((row == band)[at_column][None])
            seen |= jnp.asarray(at_row == i) & columns
        return seen

    return tuple(mask(band) for band in range(tile.max() + 1))


@takes_numbers
def mosaic(image: Picture, pattern: Pattern | str) -> Mosaic:
    """Return the picture that a sensor with a colour filter array measures, one value per pixel.

    Args:
        image: (..., h, w, bands) in any unit.
        pattern: rows of band indices, or one of `BAYER_PHASES`, in capitals or not.

    Returns:
        (..., h, w) in the unit of the image.

    Raises:
        ValueError: the pattern does not tile the plane or has other bands than the image.

    Example:
        >>> red, green, blue = (jnp.full((2, 2), x) for x in (1.0, 2.0, 3.0))
        >>> jv.mosaic(jnp.stack([red, green, blue], axis=-1), "RGGB").tolist()
        [[1.0, 2.0], [2.0, 3.0]]
    """
    if image.ndim < 3:
        raise ValueError(f"image must be (..., h, w, bands), got shape {image.shape}.")
    *_, height, width, bands = image.shape
    pattern = as_pattern(pattern)
    check_pattern(pattern, bands=bands)
    seen = jnp.zeros(image.shape[:-1], image.dtype)
    for band, here in enumerate(sites(pattern, height, width)):
        here = jnp.broadcast_to(here, seen.shape)
        seen = jnp.where(here, image[..., band], seen)
    return seen
