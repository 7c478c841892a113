"""A spectrum as one number per band, for hot paths: a loop over rays with a three-element array
inside does not use the vector units."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Colour, Scalar

Bands = tuple[Scalar, ...]

FEW = 8  # arrays of at most so many numbers are split; for more, the code would only grow


def split_bands(spectrum: Colour | Bands, bands: int) -> Bands:
    """Return the bands of a spectrum, in its unit; a neutral spectrum is repeated. `lax.split` is
    used because its gradient is a concatenation, whereas indexing would pad and add one array for
    each band."""
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
    """Apply an elementwise `function` to spectra, (bands,). Intermediate values without bands stay
    one number per ray."""
    bands = max(spectrum.shape[0] for spectrum in spectra)
    if bands > FEW:
        return function(*spectra)
    each = zip(*(split_bands(spectrum, bands) for spectrum in spectra), strict=True)
    return jnp.stack([function(*band) for band in each])
