"""Represent a spectrum as a tuple of one number per band, for loops over rays. A loop that contains
an array of three numbers per ray cannot use the vector units of a CPU."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Colour, Scalar

Bands = tuple[Scalar, ...]

MAX_NUMBERS = 8  # larger arrays are not split, because the code would only grow


def split_bands(spectrum: Colour | Bands, bands: int) -> Bands:
    """Split a spectrum into a tuple of one number per band, in its unit; a neutral spectrum is
    repeated. The gradient of `lax.split` is a concatenation, whereas the gradient of indexing would
    pad and add one array for each band."""
    if not isinstance(spectrum, tuple):
        parts = jax.lax.split(spectrum, (1,) * spectrum.shape[0])
        spectrum = tuple(part.reshape(()) for part in parts)
    return tuple(spectrum[min(k, len(spectrum) - 1)] for k in range(bands))


def times(a: Bands, b: Bands) -> Bands:
    """Multiply two spectra band by band."""
    return tuple(x * y for x, y in zip(a, b, strict=True))


def plus(a: Bands, b: Bands) -> Bands:
    """Add two spectra band by band."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def map_bands(function: Callable[..., Scalar], *spectra: Float[Array, " _"]) -> Colour:
    """Apply an elementwise function to spectra band by band; a neutral number stays one."""
    bands = max(spectrum.shape[0] for spectrum in spectra)
    if bands > MAX_NUMBERS:
        return function(*spectra)
    each = zip(*(split_bands(spectrum, bands) for spectrum in spectra), strict=True)
    return jnp.stack([function(*band) for band in each])
