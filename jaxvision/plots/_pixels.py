"""Images in the form for views and summaries. Values in the unit of the image."""

import numpy as np

from ..core.plain_arrays import plain_array
from ..errors import InputError


def checked(image: np.ndarray) -> np.ndarray:
    """(h, w, bands) of a numeric dtype."""
    pixels = np.asarray(plain_array("image", image))
    if pixels.ndim not in (2, 3) or 0 in pixels.shape:
        raise InputError(
            f"an image is (h, w) or (h, w, bands) with at least one pixel, got {pixels.shape}."
        )
    if pixels.dtype.kind not in "uif":
        raise InputError(f"an image holds integers or floating numbers, got {pixels.dtype}.")
    return pixels[..., None] if pixels.ndim == 2 else pixels


def white_level(pixels: np.ndarray, white: float | None) -> float:
    """The value from which a pixel counts as saturated."""
    if white is not None:
        if not 0 < white < np.inf:
            raise InputError(f"white = {white:g} must be a finite number above 0; correct it.")
        return float(white)
    return float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else 1.0


def colours_of(pixels: np.ndarray) -> np.ndarray:
    """The bands of light, without alpha."""
    return pixels[..., : {2: 1, 4: 3}.get(pixels.shape[-1], pixels.shape[-1])]
