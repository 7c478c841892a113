"""Averages, and sharpening.

Pictures, borders and methods are those of `convolution`; sizes are in pixels.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide, smallest_divisor
from ..core._types import Scalar, as_float
from ._terms import Fill
from .convolution import correlate_separable
from .gaussians import Sigma, gaussian
from .kernels import _size_pair, binomial_kernel, box_kernel
from .padding import Filtered, Picture, check_picture


@takes_numbers
def box(
    picture: Picture,
    *,
    size: int | np.integer | Sequence[int],
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Replace each pixel by the mean over a rectangle about it.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        size: pixels along both axes, or (down, across); an even size reaches one pixel further up
            and left.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate_separable`.

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: for a size of another form or below 1, and as for `correlate_separable`.

    Example:
        >>> print(jv.filters.box([[0.0, 9.0, 0.0]], size=(1, 3)))
        [[3. 3. 3.]]
    """
    down, across = _size_pair(size)
    return correlate_separable(
        picture, box_kernel(down), box_kernel(across), border=border, fill=fill, method=method
    )


@takes_numbers
def binomial(
    picture: Picture,
    *,
    size: int,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Blur with binomial weights, of variance (size - 1) / 4 pixels^2 in each direction.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        size: taps along both axes, at least 1.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate_separable`.

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: for a size below 1, and as for `correlate_separable`.

    Example:
        >>> step = [[0.0, 0.0, 4.0, 4.0]] * 3
        >>> print(jv.filters.binomial(step, size=3)[1])
        [0. 1. 3. 4.]
    """
    taps = binomial_kernel(size)
    return correlate_separable(picture, taps, taps, border=border, fill=fill, method=method)


@takes_numbers
def unsharp_mask(
    picture: Picture,
    sigma: Sigma,
    amount: Scalar | float,
    *,
    size: int | None = None,
    truncate: float = 4.0,
    border: str = "mirror",
    fill: Fill = 0.0,
) -> Filtered:
    """Sharpen a picture: f + amount (f - gaussian(f)), which adds `amount` times the detail finer
    than `sigma`.

    Overshoot at edges is not limited.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        sigma: () or (2,) in pixels, of the Gaussian.
        amount: () no unit; 0 changes nothing.
        size: taps of the kernel along both axes; None for `gaussian_size` of the largest sigma.
        truncate: sigmas at which the kernel is cut off, if `size` is None; no unit.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: as for `gaussian`.

    Source: Szeliski, Computer Vision, section 3.2.

    Example:
        >>> step = np.array([[0.2, 0.2, 0.8, 0.8]] * 3)
        >>> print(np.asarray(jv.filters.unsharp_mask(step, 0.5, 1.0))[1].round(2))
        [0.2  0.14 0.86 0.8 ]
    """
    blurred = gaussian(picture, sigma, size=size, truncate=truncate, border=border, fill=fill)
    sharp = as_float(picture)
    return sharp + jnp.asarray(amount, sharp.dtype) * (sharp - blurred)


@takes_numbers
def blur_straight(
    picture: Float[Array, "... h w channels"], *, blur: Callable[[Filtered], Filtered]
) -> Float[Array, "... h w channels"]:
    """Blur a picture with transparency and straight (not premultiplied) colours, by any linear
    filter.

    Light is weighted by its coverage alpha: the result is blur(alpha light) / blur(alpha), with the
    coverage blur(alpha). The colour of fully transparent pixels thus has no effect. This function
    is not for premultiplied layers: blur all their channels with the same filter.

    Args:
        picture: (..., h, w, channels): straight light in any unit, then the coverage alpha. An
            alpha outside [0, 1] continues the formula.
        blur: the blur, from a picture to one of the same shape.

    Returns:
        (..., h, w, channels): straight light and coverage; the light is 0 where the coverage is 0.

    Source: Porter and Duff, SIGGRAPH 1984.
    """
    check_picture(picture)
    light, alpha = picture[..., :-1], picture[..., -1:]
    layer = blur(jnp.concatenate([light * alpha, alpha], axis=-1))
    covered = ~(jnp.abs(layer[..., -1:]) <= smallest_divisor(layer.dtype))
    straight = divide(layer[..., :-1], layer[..., -1:], covered)
    return jnp.concatenate([straight, layer[..., -1:]], axis=-1)
