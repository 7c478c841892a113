"""The pixel aperture, a square of width sqrt(fill factor) times the pitch, over which irradiance is
averaged.

The MTF of the aperture is a sinc in each direction. A narrow aperture transmits more contrast above
the Nyquist frequency, which causes more aliasing. A microlens widens the aperture. Irradiance is in
W m^-2 or any other unit; frequencies are in cycles per pixel pitch.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import safe_sqrt, sine_cosine, smallest_divisor
from ..core._types import Image, Scalar, Scalars
from ..scene import PixelAperture


def light_share(aperture: PixelAperture) -> Scalar:
    """Return the share of the light on a pixel that reaches the pixel's active area.

    This share is the fill factor, plus the part of the remaining light that the microlens collects.

    Args:
        aperture: fill factor and microlens.

    Returns:
        () relative to all light on the pixel, in (0, 1].

    Example:
        >>> print(jv.sensor.light_share(jv.PixelAperture(0.5, microlens=0.8)))
        0.9
    """
    if aperture.microlens is None:
        return aperture.fill_factor
    return aperture.fill_factor + aperture.microlens * (1 - aperture.fill_factor)


@takes_numbers
def pixel_means(
    irradiance: Image, aperture: PixelAperture
) -> Float[Array, "*batch rows columns bands"]:
    """Return the mean irradiance over the active area of each pixel.

    Each sample of irradiance is assumed to be uniform over its cell of the pixel.

    Args:
        irradiance: (..., h oversampling, w oversampling, bands) W m^-2, sampled
            `aperture.oversampling` times along each side of a pixel.
        aperture: the pixel's aperture.

    Returns:
        (..., h, w, bands) W m^-2.

    Raises:
        ValueError: if `irradiance` is not an image of a whole number of pixels.

    Example:
        >>> fine = np.array([[1.0, 3.0], [1.0, 3.0]])[..., None]  # W m^-2 in one pixel
        >>> print(jv.sensor.pixel_means(fine, jv.PixelAperture(1.0, oversampling=2)).ravel())
        [2.]
    """
    n = aperture.oversampling
    if irradiance.ndim < 3:
        raise ValueError(f"irradiance must be (..., h, w, bands), got shape {irradiance.shape}.")
    *batch, fine_rows, fine_columns, bands = irradiance.shape
    if fine_rows % n or fine_columns % n:
        raise ValueError(
            f"irradiance must have a multiple of {n} rows and columns, PixelAperture.oversampling, "
            f"got shape {irradiance.shape}."
        )
    cells = irradiance.reshape(*batch, fine_rows // n, n, fine_columns // n, n, bands)
    weights = _cell_weights(aperture)
    return jnp.einsum("...iajbc,a,b->...ijc", cells, weights, weights)


@takes_numbers
def aperture_mtf(aperture: PixelAperture, frequency: Scalars) -> Scalars:
    """Return the contrast of a grating along rows or columns after the pixel aperture, sinc(width
    f), where f is the frequency of the grating.

    Args:
        aperture: the pixel's aperture.
        frequency: (...) cycles per pixel.

    Returns:
        (...) contrast relative to the scene; negative if the grating's contrast is reversed.

    Example:
        >>> full = jv.PixelAperture(1.0)
        >>> round(float(jv.sensor.aperture_mtf(full, jnp.array(0.5))), 4)  # 2 / pi
        0.6366
    """
    return _sinc(safe_sqrt(light_share(aperture)) * frequency)


@jax.custom_jvp
def _sinc(x: Scalars) -> Scalars:
    """Return sinc(x) = sin(pi x) / (pi x), accurate near its zeros."""
    least = smallest_divisor(x.dtype)
    away = jnp.maximum(jnp.abs(x), least / 2)
    sine, _ = sine_cosine(away / 2)
    return jnp.where(jnp.abs(x) < least, 1, sine / (jnp.pi * away))


@_sinc.defjvp
def _sinc_jvp(primals, tangents):
    """Differentiate `_sinc`. The derivative is (cos(pi x) - sinc(x)) / x. Near 0 the difference
    cancels, and the derivative is computed by the series -pi^2 x / 3 (1 - z / (2 5) (1 - z / (4 7)
    (...))) in z = (pi x)^2."""
    (x,), (change,) = primals, tangents
    size = jnp.abs(x)
    z = jnp.square(jnp.pi * jnp.minimum(size, 0.6))
    series = jnp.ones_like(z)
    for k in range(20, 0, -2):
        series = 1 - z / (k * (k + 3)) * series
    _, cosine = sine_cosine(x / 2)
    value = _sinc(x)
    far = (cosine - value) / jnp.where(size < 0.4, 1, x)
    return value, jnp.where(size < 0.5, -(jnp.pi**2) / 3 * x * series, far) * change


def _cell_weights(aperture: PixelAperture) -> Float[Array, " n"]:
    """Return the share of the aperture's width in each cell across a pixel; the shares add up to
    1."""
    n = aperture.oversampling
    width = safe_sqrt(light_share(aperture))
    edges = jnp.linspace(-0.5, 0.5, n + 1, dtype=width.dtype)
    inside = jnp.clip(edges, -width / 2, width / 2)
    return jnp.diff(inside) / width
