"""Where pixels lie: how steep the scene is around them, and which of them err together.

A picture that is registered to half a pixel is off by half the local slope of ln E; so are edges
that JPEG smears, and leaves that move. Such errors are no noise of the pixel, and steep places have
far more of them than flat ones: pixels are put into classes of steepness, each with a noise model
of its own. And they are shared by neighbours: tiles of the picture, not pixels, are independent.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

CLASSES = 6  # of steepness, equally full
TILES = 16  # a power of two


@dataclass(frozen=True)
class Layout:
    """The pixels of a scene's mask, in the order of `codes[:, mask]`.

    Attributes:
        steepness: (pixels,) squared slope of ln(code - black), per pixel squared.
        rows: (pixels,).
        columns: (pixels,).
    """

    steepness: Float[np.ndarray, " pixels"]
    rows: Int[np.ndarray, " pixels"]
    columns: Int[np.ndarray, " pixels"]


def layout_of(
    codes: Integer[np.ndarray, "exposures h w"],
    mask: Bool[np.ndarray, "h w"],
    *,
    black: float,
    clip: float,
) -> Layout:
    """Steepness and place of a plane's pixels.

    The slope is a mean over exposures, weighted by Debevec & Malik's hat, squared; it is taken
    between the neighbours of a pixel, so that its own noise does not choose its class.

    Args:
        codes: (exposures, h, w) DN.
        mask: (h, w), true where the scene may be used.
        black: DN without light.
        clip: DN from which a code is saturated.

    Returns:
        The layout.
    """
    z = np.arange(int(codes.max()) + 1, dtype=np.float32)
    logarithm = np.log(np.maximum(z - np.float32(black), 0.5))
    height = np.maximum(np.minimum(z - np.float32(black), np.float32(clip) - z), 0)
    hat = (height / max(float(height.max()), 1.0)) ** 2
    square, total = np.zeros((2, *codes.shape[1:]), np.float32)
    for frame in codes:
        padded = np.pad(logarithm[frame], 1, mode="edge")
        down, across = padded[2:, 1:-1] - padded[:-2, 1:-1], padded[1:-1, 2:] - padded[1:-1, :-2]
        weight = hat[frame]
        square += weight * (down**2 + across**2) / 4
        total += weight
    rows, columns = np.nonzero(mask)
    return Layout((square / np.where(total > 0, total, 1))[mask], rows, columns)


def steepness_classes(
    steepness: Float[np.ndarray, " pixels"], counted: Bool[np.ndarray, " pixels"]
) -> Int[np.ndarray, " pixels"]:
    """Classes of steepness, equally full of the pixels that count.

    Args:
        steepness: (pixels,).
        counted: (pixels,).

    Returns:
        (pixels,) 0 (flattest) to `CLASSES` - 1.
    """
    edges = np.quantile(steepness[counted], np.arange(1, CLASSES) / CLASSES)
    return np.digitize(steepness, edges).astype(np.int32)


def tiles_of(
    rows: Int[np.ndarray, " pixels"], columns: Int[np.ndarray, " pixels"]
) -> list[Int[np.ndarray, " tile"]]:
    """Tiles of a picture: its pixels halved again and again along the longer side.

    Args:
        rows: (pixels,).
        columns: (pixels,).

    Returns:
        Places of each tile's pixels, equally many to one.
    """
    tiles = [np.arange(len(rows))]
    while len(tiles) < TILES:
        tiles = [half for tile in tiles for half in _halves(tile, rows, columns)]
    return tiles


def _halves(tile: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> list[np.ndarray]:
    along = max((rows[tile], columns[tile]), key=lambda at: np.ptp(at) if len(at) else 0)
    order = np.argsort(along, kind="stable")
    middle = len(tile) // 2
    return [np.sort(tile[order[:middle]]), np.sort(tile[order[middle:]])]
