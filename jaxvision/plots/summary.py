"""Compute statistics of the channels of an image, in DN for integer images and relative for
floating-point images."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.plain_arrays import plain_array
from ..errors import InputError


@dataclass(frozen=True)
class BandSummary:
    """Statistics of one channel over its finite values. The moments are NaN if no value is finite.

    Attributes:
        name: name of the channel.
        minimum: the smallest value, DN or relative, as all values in this record.
        maximum: the largest value, in the same unit.
        mean: the mean, in the same unit.
        standard_deviation: the standard deviation, in the same unit.
        median: the median, in the same unit.
        black: number of values <= 0.
        saturated: number of values >= white.
        nan: number of NaN.
        infinite: number of infinite values.
    """

    name: str
    minimum: float
    maximum: float
    mean: float
    standard_deviation: float
    median: float
    black: int
    saturated: int
    nan: int
    infinite: int


def band_names(bands: int) -> tuple[str, ...]:
    """Return the names of an image's channels.

    Args:
        bands: number of bands.

    Returns:
        grey; grey, alpha; red, green, blue; red, green, blue, alpha; for any other number band 0,
        band 1, ...
    """
    known = {
        1: ("grey",),
        2: ("grey", "alpha"),
        3: ("red", "green", "blue"),
        4: ("red", "green", "blue", "alpha"),
    }
    return known.get(bands) or tuple(f"band {i}" for i in range(bands))


def summarise(
    image: np.ndarray, *, white: float | None = None, names: Sequence[str] = ()
) -> tuple[BandSummary, ...]:
    """Compute the range, the moments, and the numbers of black, saturated and undefined values of
    each channel.

    Args:
        image: (h, w) or (h, w, bands), DN or relative.
        white: the value from which a pixel counts as saturated, in the image's unit. None takes the
            largest code of the integer type, or 1 for floating images.
        names: names of the channels; empty for those of `band_names`.

    Returns:
        One summary for each channel.

    Raises:
        InputError: for an array that is no image, and if the number of names is not the number of
            channels.
    """
    pixels = checked(image)
    limit = white_level(pixels, white)
    names = tuple(names) or band_names(pixels.shape[-1])
    if len(names) != pixels.shape[-1]:
        raise InputError(f"{len(names)} names for {pixels.shape[-1]} channels; give one for each.")
    return tuple(_summary(name, pixels[..., i], limit) for i, name in enumerate(names))


def _summary(name: str, band: np.ndarray, white: float) -> BandSummary:
    finite = band[np.isfinite(band)].astype(float)
    known = finite if finite.size else np.array([np.nan])
    return BandSummary(
        name=name,
        minimum=float(known.min()),
        maximum=float(known.max()),
        mean=float(known.mean()),
        standard_deviation=float(known.std()),
        median=float(np.median(known)),
        black=int((band <= 0).sum()),
        saturated=int((band >= white).sum()),
        nan=int(np.isnan(band).sum()),
        infinite=int(np.isinf(band).sum()),
    )


def checked(image: np.ndarray) -> np.ndarray:
    """Convert an image to (h, w, bands) of a numeric dtype, or raise `InputError`."""
    pixels = np.asarray(plain_array("image", image))
    if pixels.ndim not in (2, 3) or 0 in pixels.shape:
        raise InputError(
            f"an image is (h, w) or (h, w, bands) with at least one pixel, got {pixels.shape}."
        )
    if pixels.dtype.kind not in "uif":
        raise InputError(f"an image holds integers or floating numbers, got {pixels.dtype}.")
    return pixels[..., None] if pixels.ndim == 2 else pixels


def white_level(pixels: np.ndarray, white: float | None) -> float:
    """Return the value from which a pixel counts as saturated."""
    if white is not None:
        if not 0 < white < np.inf:
            raise InputError(f"white = {white:g} must be a finite number above 0; correct it.")
        return float(white)
    return float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else 1.0


def colours_of(pixels: np.ndarray) -> np.ndarray:
    """Return the bands of an image that are light, without alpha."""
    return pixels[..., : {2: 1, 4: 3}.get(pixels.shape[-1], pixels.shape[-1])]
