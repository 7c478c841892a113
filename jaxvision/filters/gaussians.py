"""The Gaussian and its derivatives.

`sigma` in pixels may be traced; the size of the kernel is then the caller's, since it is the shape
of an array. A sigma below 0.01 pixel counts as 0.01, where the sampled Gaussian is an impulse in
either precision. `sampling` is what a weight means: "sampled" is the function at the pixel's
centre, as in scipy and OpenCV; "integrated" its mean over the pixel. Of a narrow one, sigma = 0.5,
the first has 0.035 square pixels too little variance, the second the pixel's own 1/12 more, to
0.01. Cut off at `truncate` sigmas and rescaled to sum 1: the knob of accuracy.

Derivatives want a sigma of 0.7 or more. Narrower ones fall between the pixels: of a ramp of slope 1
the first order gives, at sigma 0.3, 0.5 and 0.7, 0.085, 0.860 and 0.998 "sampled", 0.663, 0.986 and
0.9999 "integrated", and at 0 nothing; of a flat 1 the second order at 0.5 makes -0.56 "sampled",
rounding "integrated". `derivatives.derivative` and `laplacian` of the blurred picture are exact for
parabolas at any sigma.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from numpy.polynomial.legendre import leggauss

from .._types import Scalar, as_float, print_by_name
from ..padding import Filtered, Picture
from ._terms import Fill
from .convolution import _check_weighs, correlate_separable
from .kernels import gaussian_size

Sigma = Float[Array, ""] | Float[Array, "2"] | float
print_by_name(globals(), "Sigma")

_SMALLEST_SIGMA = 0.01
_SAMPLINGS = ("sampled", "integrated")


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
    """The picture under a Gaussian: `sigma` in pixels, () or (2,) down and across.

    `size`: of the kernel both ways, by default from `truncate`. `order`: of the derivative down
    and across, per pixel ** order. The other arguments as for `correlate`. `ValueError` for a
    traced sigma without a size, an unknown sampling, or the border "normalised_zero" of a
    derivative, whose weights have sum 0.
    """
    if any(order):
        _check_weighs(border, of="a derivative")
    if size is None:
        if isinstance(sigma, Tracer):
            raise ValueError("a traced sigma needs a size: pass size=gaussian_size(largest sigma).")
        size = gaussian_size(float(np.max(np.asarray(sigma))), truncate=truncate)
    column, row = _kernels(sigma, size, order, sampling)
    return correlate_separable(picture, column, row, border=border, fill=fill, method=method)


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
    """The sum of both second derivatives of the picture under a Gaussian, per square pixel; times
    sigma^2 it does not depend on scale. Arguments, and what a narrow one loses, as for `gaussian`:
    below a sigma of 0.7 take "integrated", whose answer to a flat picture is 0."""
    along = partial(
        gaussian, picture, sigma, size=size, truncate=truncate, sampling=sampling, border=border,
        fill=fill, method=method,
    )  # fmt: skip
    return along(order=(2, 0)) + along(order=(0, 2))


def gaussian_kernel(
    sigma: Scalar, *, size: int, order: int = 0, sampling: str = "sampled"
) -> Float[Array, " taps"]:
    """(size,) weights of the Gaussian, or of its derivative, about the middle of the kernel.

    sigma: () pixels. The weights of order 0 have sum 1; those of order n are them times
    He_n(x / sigma) / sigma^n, the derivative as a kernel of correlation, per pixel ** n.
    """
    if sampling not in _SAMPLINGS:
        raise ValueError(f"sampling must be one of {', '.join(_SAMPLINGS)}, got {sampling!r}.")
    if size < 1 or order < 0:
        raise ValueError(f"size must be >= 1 and order >= 0, got {size} and {order}.")
    sigma = jnp.maximum(sigma, _SMALLEST_SIGMA)
    x = jnp.arange(size, dtype=sigma.dtype) - (size - 1) / 2
    if sampling == "integrated":
        return _integral(x, sigma, order) / _integral(x, sigma, 0).sum()
    return jax.nn.softmax(-0.5 * (x / sigma) ** 2) * _hermite(x / sigma, order) / sigma**order


@partial(jax.jit, static_argnames=("size", "order", "sampling"))
def _kernels(
    sigma: Sigma, size: int, order: tuple[int, int], sampling: str
) -> tuple[Float[Array, " taps"], Float[Array, " taps"]]:
    """The kernels down and across."""
    down, across = jnp.broadcast_to(as_float(sigma), (2,))
    return (
        gaussian_kernel(down, size=size, order=order[0], sampling=sampling),
        gaussian_kernel(across, size=size, order=order[1], sampling=sampling),
    )


def _hermite(x: Float[Array, "..."], order: int) -> Float[Array, "..."]:
    """He_n(x) = x He_(n-1)(x) - (n - 1) He_(n-2)(x)."""
    before, now = jnp.zeros_like(x), jnp.ones_like(x)
    for n in range(order):
        before, now = now, x * now - n * before
    return now


def _density(x: Float[Array, "..."], sigma: Scalar, order: int) -> Float[Array, "..."]:
    """He_n(x / sigma) / sigma^n times the normal density."""
    t = x / sigma
    return jnp.exp(-0.5 * t * t) * _hermite(t, order) / (sigma ** (order + 1) * 2.5066282746310002)


def _integral(x: Float[Array, " taps"], sigma: Scalar, order: int) -> Float[Array, " taps"]:
    """The density's integral over the pixel at each x: eight Gauss-Legendre nodes where it is
    smooth in a pixel (17 digits), else the difference of its primitive, which loses no digits
    there."""
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
