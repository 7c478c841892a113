"""Division of the spatial variance of an average frame into parts from rows, from columns and from
single pixels, with intervals.

Let y be the average over L frames of M rows and N columns, mu the mean of y, and sigma^2 the
temporal variance of a pixel. The numbers in brackets are those of the standard's equations:

    s^2_y   = mean of (y - mu)^2 - sigma^2 / L               (36), all pixels s^2_cav = mean of
    (column mean - mu)^2 - sigma^2 / (L M)  (41) s^2_rav = mean of (row mean - mu)^2 - sigma^2 / (L
    N)     (41) s^2_y = row + col + pixel, s^2_cav = col + pixel / M, s^2_rav = row + pixel / N (42)

The variances row, col and pixel are the three parts. The high-pass filter of clause 8.1 subtracts a
smoothed frame from the frame. The smoothing is a mean over 7 x 7 pixels, then one over 11 x 11
pixels, then a binomial mean over 3 x 3 pixels. The borders of the frame, where a window is
incomplete, are not used.

The intervals are for the population of pixels, rows and columns, of which this sensor is a sample.
The average of dark frames and the average of bright frames share the dark pattern, so their
variances are drawn together. For rows, for columns and for pixels, the 2 x 2 matrix of mean squares
and products of the two averages has a Wishart distribution. Therefore 2 x 2 covariances are drawn
from the inverse Wishart distribution, and every figure is computed from each draw. The number of
degrees of freedom is reduced, because the filter correlates neighbouring rows, columns and pixels,
and because pixels may have heavier tails than a Gaussian.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import correlate1d, uniform_filter
from scipy.signal import fftconvolve

BOXES, BINOMIAL = (7, 11), np.array([1.0, 2.0, 1.0]) / 4
BORDER = 9  # width of the border that the windows reach, pixels
FEWEST_LINES = 8  # rows and columns that must be left within the borders
DRAWS = 4000


class Split(NamedTuple):
    """The spatial variance of all pixels and its parts of rows, columns and pixels, DN^2."""

    total: float
    row: float
    col: float
    pixel: float


class Loss(NamedTuple):
    """The shares of variance and of degrees of freedom that remain after the high-pass filter."""

    # share of the variance of independent rows or columns that the filter passes
    lines: float = 1.0
    pixels: float = 1.0  # share of the variance of independent pixels that the filter passes
    line_degrees: float = 1.0  # share of the degrees of freedom of rows or columns that remains
    pixel_degrees: float = 1.0  # share of the degrees of freedom of pixels that remains


@cache
def loss_of_filter() -> Loss:
    """Compute the shares of variance and degrees of freedom that the high-pass leaves."""
    smooth = BINOMIAL
    for width in BOXES:
        smooth = np.convolve(smooth, np.ones(width) / width)
    line = -smooth
    line[BORDER] += 1
    pixel = -np.outer(smooth, smooth)
    pixel[BORDER, BORDER] += 1
    alike = np.convolve(line, line[::-1]), fftconvolve(pixel, pixel[::-1, ::-1])
    left = [float(np.max(one)) for one in alike]
    degrees = [size**2 / float(np.sum(one**2)) for one, size in zip(alike, left, strict=True)]
    return Loss(*left, *degrees)


def can_filter(shape: tuple[int, ...]) -> bool:
    """Return whether 8 rows and columns remain inside the filter's borders."""
    return min(shape) >= 2 * BORDER + FEWEST_LINES


def high_pass(image: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "rows columns"]:
    """Apply the high-pass of clause 8.1, and cut off the borders of the frame."""
    smooth = np.asarray(image, float)
    for width in BOXES:
        smooth = uniform_filter(smooth, width)
    for axis in (0, 1):
        smooth = correlate1d(smooth, BINOMIAL, axis=axis)
    return (image - smooth)[BORDER:-BORDER, BORDER:-BORDER]


def split(image: Float[np.ndarray, "h w"], rest: float) -> Split:
    """Compute the standard's spatial variances, with temporal noise `rest` in the average."""
    (rows, columns), away = image.shape, image - image.mean()
    total = float(np.mean(away**2)) - rest
    col = float(np.mean(away.mean(axis=0) ** 2)) - rest / rows
    row = float(np.mean(away.mean(axis=1) ** 2)) - rest / columns
    pixel = (total - col - row) / (1 - 1 / rows - 1 / columns)
    return Split(total, row - pixel / columns, col - pixel / rows, pixel)


def simulate(
    dark: Float[np.ndarray, "h w"],
    bright: Float[np.ndarray, "h w"],
    rest: Float[np.ndarray, "2"],
    of_rest: Float[np.ndarray, "2"],
    loss: Loss,
    rng: np.random.Generator,
) -> dict[str, Float[np.ndarray, "draws 2 2"]]:
    """Draw 2 x 2 covariances of dark and bright pattern for each part, given the averages."""
    away = np.stack([dark - dark.mean(), bright - bright.mean()])
    of_rows, of_columns = away.mean(axis=2), away.mean(axis=1)
    own = away - of_rows[:, :, None] - of_columns[:, None, :]
    rows, columns = dark.shape
    lines = [
        _inverse_wishart(one @ one.T / degrees, degrees * loss.line_degrees, rng)
        for one, degrees in ((of_rows, rows - 1), (of_columns, columns - 1))
    ]
    own = own.reshape(2, -1)
    degrees = float((rows - 1) * (columns - 1))
    squares = np.maximum(np.mean(own**2, axis=1), np.finfo(float).tiny)
    tails = max(float(np.max(np.mean(own**4, axis=1) / squares**2)) - 1, 2.0)
    rest_of_pixels = _inverse_wishart(
        own @ own.T / degrees, degrees * loss.pixel_degrees * 2 / tails, rng
    )
    ratio = loss.lines / loss.pixels
    row = lines[0] - ratio * rest_of_pixels / columns
    col = lines[1] - ratio * rest_of_pixels / rows
    temporal = loss.pixels * (rest + of_rest * rng.standard_normal((len(row), 2)))
    pixel = rest_of_pixels - temporal[:, :, None] * np.eye(2)
    return {"total": row + col + pixel, "row": row, "col": col, "pixel": pixel}


def _inverse_wishart(
    square: Float[np.ndarray, "2 2"], degrees: float, rng: np.random.Generator
) -> Float[np.ndarray, "draws 2 2"]:
    """Draw covariances from the inverse Wishart distribution of a mean square."""
    values, vectors = np.linalg.eigh(square)
    root = vectors * np.sqrt(np.maximum(values, 0))
    wishart = np.zeros((DRAWS, 2, 2))
    # With one more degree of freedom, a single variance is chi-square with `degrees`.
    wishart[:, 0, 0] = np.sqrt(rng.chisquare(degrees + 1, DRAWS))
    wishart[:, 1, 1] = np.sqrt(rng.chisquare(degrees, DRAWS))
    wishart[:, 1, 0] = rng.standard_normal(DRAWS)
    inverse = root @ np.linalg.inv(wishart).transpose(0, 2, 1)
    return degrees * inverse @ inverse.transpose(0, 2, 1)
