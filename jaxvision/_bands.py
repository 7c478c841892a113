"""A spectrum as one number a band, for hot paths: a loop over rays with an array of three in it
does not use the vector units."""

from ._types import Colour, Scalar

Bands = tuple[Scalar, ...]


def apart(spectrum: Colour, bands: int) -> Bands:
    """The bands of a spectrum, a neutral one's repeated; in its unit."""
    return tuple(spectrum[min(k, spectrum.shape[0] - 1)] for k in range(bands))
