"""The steepness and the activity of the scene around each pixel, by which pixels are divided into
classes, and the division of the picture into tiles.

If an image is misregistered by half a pixel, the log irradiance ln E has an error of half its local
slope per pixel. JPEG edges and moving leaves cause similar errors. Errors of this kind are far
larger where the slope of ln E is steep, and they are not pixel noise. Therefore pixels are divided
into classes by steepness, the squared local slope, and each class has its own noise model.
Sharpening causes errors where the picture has detail, which is measured by the activity, the local
variance (`flat_places.py`). Errors of neighbouring pixels are correlated, so large tiles of the
picture, not pixels, are treated as independent.
"""

import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy.ndimage import uniform_filter

CLASSES = 6  # of steepness and of activity, equally full
WINDOW_SIDE = 5  # side, in pixels, of the neighbourhood of a pixel
TILES = 16  # a power of two


@dataclass(frozen=True)
class Layout:
    """The steepness, activity and position of the pixels that a mask selects, in the order of
    `codes[:, mask]`.

    Attributes:
        steepness: (pixels,) squared slope of ln(code - black), per pixel squared.
        activity: (pixels,) variance of ln(code - black) over the 24 surrounding pixels, from which
            the variance by noise is subtracted. The estimate may be negative.
        rows: (pixels,) row of each pixel.
        columns: (pixels,) column of each pixel.
    """

    steepness: Float[np.ndarray, " pixels"]
    activity: Float[np.ndarray, " pixels"]
    rows: Int[np.ndarray, " pixels"]
    columns: Int[np.ndarray, " pixels"]

    def select(self, chosen: Integer[np.ndarray, " some"] | slice) -> "Layout":
        """Return the layout of some of the pixels."""
        every = self.steepness, self.activity, self.rows, self.columns
        return Layout(*(column[chosen] for column in every))

    def at(self, chosen: Integer[np.ndarray, " some"] | slice) -> "Layout":
        """Former name of `select`."""
        warnings.warn("at is now select.", DeprecationWarning, stacklevel=2)
        return self.select(chosen)


def layout_of(
    codes: Integer[np.ndarray, "exposures h w"],
    mask: Bool[np.ndarray, "h w"],
    *,
    black: float,
    clip: float,
) -> Layout:
    """Compute steepness, activity and position of a plane's pixels.

    The slope at a pixel is the difference between its neighbours, so that the pixel's own noise
    does not affect its class. The squared slope is averaged over exposures, with the squared hat
    function of Debevec & Malik as the weight. The activity is the covariance of ln(code - black)
    between successive exposures over the 24 surrounding pixels. Noise does not contribute to this
    covariance, which is averaged over exposures in the same way as the squared slope.

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
    logarithm -= logarithm[-1] / 2  # squares lose fewer digits
    height = np.maximum(np.minimum(z - np.float32(black), np.float32(clip) - z), 0)
    hat = height / max(float(height.max()), 1.0)
    square, activity, total, twice = np.zeros((4, *codes.shape[1:]), np.float32)
    for frame in codes:
        padded = np.pad(logarithm[frame], 1, mode="edge")
        down, across = padded[2:, 1:-1] - padded[:-2, 1:-1], padded[1:-1, 2:] - padded[1:-1, :-2]
        weight = hat[frame] ** 2
        square += weight * (down**2 + across**2) / 4
        total += weight
    for shorter, longer in pairwise(codes):
        one, other = logarithm[shorter], logarithm[longer]
        weight = hat[shorter] * hat[longer]
        activity += weight * (
            _mean_of_neighbours(one * other) - _mean_of_neighbours(one) * _mean_of_neighbours(other)
        )
        twice += weight
    square /= np.where(total > 0, total, 1)
    activity /= np.where(twice > 0, twice, 1)
    rows, columns = np.nonzero(mask)
    return Layout(square[mask], activity[mask], rows, columns)


def _mean_of_neighbours(image: np.ndarray) -> np.ndarray:
    """Return the mean of the 24 pixels around each pixel."""
    return (WINDOW_SIDE**2 * uniform_filter(image, WINDOW_SIDE) - image) / (WINDOW_SIDE**2 - 1)


def equal_classes(
    values: Float[np.ndarray, " pixels"], counted: Bool[np.ndarray, " pixels"]
) -> Int[np.ndarray, " pixels"]:
    """Return the class of each pixel by `values`; all classes have as many `counted` pixels."""
    edges = np.quantile(values[counted], np.arange(1, CLASSES) / CLASSES)
    return np.digitize(values, edges).astype(np.int32)


def tiles_of(
    rows: Int[np.ndarray, " pixels"], columns: Int[np.ndarray, " pixels"]
) -> list[Int[np.ndarray, " tile"]]:
    """Divide the pixels of a picture into 16 tiles, by repeated halving along the longer side."""
    tiles = [np.arange(len(rows))]
    while len(tiles) < TILES:
        tiles = [half for tile in tiles for half in _halves(tile, rows, columns)]
    return tiles


def _halves(tile: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> list[np.ndarray]:
    along = max((rows[tile], columns[tile]), key=lambda at: np.ptp(at) if len(at) else 0)
    order = np.argsort(along, kind="stable")
    middle = len(tile) // 2
    return [np.sort(tile[order[:middle]]), np.sort(tile[order[middle:]])]
