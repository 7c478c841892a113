"""Filters by a Gaussian and by its derivatives.

`sigma`, in pixels, may be traced. The caller must then give the size of the kernel, because it is
the shape of an array. A sigma below 0.01 pixel is replaced by 0.01, for which the sampled Gaussian
is an impulse in float32 and in float64. `sampling` defines the weights. "sampled" is the function
at the pixel's centre, as in scipy and OpenCV. "integrated" is its mean over the pixel. For a narrow
Gaussian of sigma 0.5 the variance of the sampled kernel is 0.035 square pixels too small. The
variance of the integrated kernel exceeds sigma^2 by the variance of a pixel, 1/12, within 0.01. The
kernel is cut off at `truncate` sigmas and rescaled to sum 1. `truncate` sets the accuracy.

Derivatives need a sigma of at least 0.7, because narrower kernels are not resolved by the pixels.
For a ramp of slope 1, the first order gives 0.085, 0.860 and 0.998 at sigma 0.3, 0.5 and 0.7 with
"sampled", and 0.663, 0.986 and 0.9999 with "integrated"; at sigma 0 it gives 0. For a flat picture
of 1 and sigma 0.5, the second order gives -0.56 with "sampled" and rounding errors with
"integrated". `derivatives.derivative` and `laplacian` of the blurred picture are exact for
parabolas at any sigma.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from numpy.polynomial.legendre import leggauss

from ..core._arguments import takes_numbers, warn_caller, warn_of_idle_fill
from ..core._types import Scalar, as_float, check_choice, check_count, print_by_name
from ._terms import Fill
from .convolution import _check_weighs, correlate_separable
from .kernels import gaussian_size
from .padding import Filtered, Picture

Sigma = Float[Array, ""] | Float[Array, "2"] | float
print_by_name(globals(), "Sigma")

_SMALLEST_SIGMA = 0.01
_SAMPLINGS = ("sampled", "integrated")


@takes_numbers
def gaussian(
    picture: Picture,
    sigma: Sigma,
    *,
    size: int | None = None,
    truncate: float = 4.0,
    order: tuple[int, int] = (0, 0),
    sampling: str = "sampled",
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Convolve a picture with a Gaussian or with a derivative of it.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        sigma: () or (2,), down and across, in pixels, at least 0.
        size: taps of the kernel along both axes; None for `gaussian_size` of the largest sigma.
        truncate: sigmas at which the kernel is cut off, if `size` is None; no unit.
        order: order of the derivative down and across; (0, 0) is the Gaussian itself. Below a sigma
            of 0.7 pixels derivatives are inaccurate: at 0.5 a slope of 1 gives 0.86, and 0.99 with
            "integrated".
        sampling: "sampled" or "integrated".
        border: a key of `padding.BORDERS`. The default, "mirror", is OpenCV's BORDER_REFLECT;
            OpenCV's own default, BORDER_REFLECT_101, is "reflect_101".
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate_separable`.

    Returns:
        The picture's shape; its unit per pixel to the power of the total order.

    Raises:
        ValueError: for a traced sigma without a size; for an unknown sampling; for the border
            "normalised_zero" with a derivative, whose weights have sum 0; and as for
            `correlate_separable`.

    Example:
        >>> impulse = jnp.zeros((9, 9)).at[4, 4].set(1.0)
        >>> blurred = jv.filters.gaussian(impulse, 1.0)
        >>> print(f"{blurred[4, 4]:.4f} {blurred.sum():.4f}")
        0.1592 1.0000
    """
    if any(order):
        _check_weighs(border, of="a derivative")
    if size is None:
        if isinstance(sigma, Tracer):
            raise ValueError("a traced sigma needs a size: pass size=gaussian_size(largest sigma).")
        size = gaussian_size(float(np.max(np.asarray(sigma))), truncate=truncate)
    elif truncate != 4.0:
        warn_caller("truncate has no effect beside a size; leave one of them out.")
    warn_of_idle_fill(fill, border)
    return _gaussian(picture, sigma, fill, (size, order, sampling), border, method)


@takes_numbers
def laplacian_of_gaussian(
    picture: Picture,
    sigma: Sigma,
    *,
    size: int | None = None,
    truncate: float = 4.0,
    sampling: str = "sampled",
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Filter a picture by the sum of both second derivatives of a Gaussian.

    Multiply the response by sigma^2 to make it independent of scale. Below a sigma of 0.7 pixels
    use "integrated", which gives 0 for a flat picture.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        sigma: () or (2,), down and across, in pixels.
        size: taps of the kernel along both axes; None for `gaussian_size` of the largest sigma.
        truncate: sigmas at which the kernel is cut off, if `size` is None; no unit.
        sampling: "sampled" or "integrated".
        border: a key of `padding.BORDERS` but "normalised_zero".
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate_separable`.

    Returns:
        The picture's shape; its unit per square pixel.

    Raises:
        ValueError: as for `gaussian`.
    """
    along = partial(
        gaussian, picture, sigma, size=size, truncate=truncate, sampling=sampling, border=border,
        fill=fill, method=method,
    )  # fmt: skip
    return along(order=(2, 0)) + along(order=(0, 2))


@takes_numbers
def gaussian_kernel(
    sigma: Scalar, *, size: int, order: int = 0, sampling: str = "sampled"
) -> Float[Array, " taps"]:
    """Return the weights of a Gaussian, or of its derivative, centred in the kernel.

    The weights of order n are those of order 0 times He_n(x / sigma) / sigma^n, with the Hermite
    polynomial He_n. The weights are a correlation kernel, so a derivative is positive where the
    picture increases.

    Args:
        sigma: () in pixels; at least 0.01.
        size: number of taps, at least 1.
        order: order of the derivative, at least 0.
        sampling: "sampled" or "integrated".

    Returns:
        (size,) in pixels to the power of -order; those of order 0 have sum 1.

    Raises:
        ValueError: for an unknown sampling, a size below 1, or an order below 0.

    Example:
        >>> print(np.asarray(jv.filters.gaussian_kernel(1.0, size=5)).round(3))
        [0.054 0.244 0.403 0.244 0.054]
    """
    check_choice("sampling", sampling, _SAMPLINGS)
    check_count("size", size, 1)
    check_count("order", order, 0)
    sigma = jnp.maximum(sigma, _SMALLEST_SIGMA)
    x = jnp.arange(size, dtype=sigma.dtype) - (size - 1) / 2
    if sampling == "integrated":
        return _integral(x, sigma, order) / _integral(x, sigma, 0).sum()
    return jax.nn.softmax(-0.5 * (x / sigma) ** 2) * _hermite(x / sigma, order) / sigma**order


@partial(jax.jit, static_argnames=("weights", "border", "method"))
def _gaussian(
    picture: Picture,
    sigma: Sigma,
    fill: Fill,
    weights: tuple[int, tuple[int, int], str],
    border: str,
    method: str,
) -> Filtered:
    """Compute the weights in one compiled program for kernels and filter. `weights`: size, order
    and sampling.
    """
    size, order, sampling = weights
    column, row = (
        gaussian_kernel(s, size=size, order=n, sampling=sampling)
        for s, n in zip(jnp.broadcast_to(as_float(sigma), (2,)), order, strict=True)
    )
    return correlate_separable(picture, column, row, border=border, fill=fill, method=method)


def _hermite(x: Float[Array, "..."], order: int) -> Float[Array, "..."]:
    """Return the Hermite polynomial He_n(x) = x He_(n-1)(x) - (n - 1) He_(n-2)(x)."""
    before, now = jnp.zeros_like(x), jnp.ones_like(x)
    for n in range(order):
        before, now = now, x * now - n * before
    return now


def _density(x: Float[Array, "..."], sigma: Scalar, order: int) -> Float[Array, "..."]:
    """Return He_n(x / sigma) / sigma^n times the normal density."""
    t = x / sigma
    return jnp.exp(-0.5 * t * t) * _hermite(t, order) / (sigma ** (order + 1) * 2.5066282746310002)


def _integral(x: Float[Array, " taps"], sigma: Scalar, order: int) -> Float[Array, " taps"]:
    """Return the integral of `_density` over the pixel at each x, by eight Gauss-Legendre nodes
    where the density is smooth, else by its antiderivative.
    """
    nodes, weights = leggauss(8)
    smooth = sigma > 1
    wide = jnp.where(smooth, sigma, 1)
    at = x[:, None] + jnp.asarray(nodes / 2, x.dtype)[None]
    quadrature = (_density(at, wide, order) * jnp.asarray(weights / 2, x.dtype)[None]).sum(-1)
    narrow = jnp.where(smooth, 1, sigma)
    if order == 0:
        # by symmetry from the side of the tail, where erfc keeps all digits
        far, root = jnp.abs(x), narrow * 1.4142135623730951
        lower, upper = (far - 0.5) / root, (far + 0.5) / root
        difference = (jax.lax.erfc(lower) - jax.lax.erfc(upper)) / 2
    else:
        difference = _density(x - 0.5, narrow, order - 1) - _density(x + 0.5, narrow, order - 1)
    return jnp.where(smooth, quadrature, difference)
