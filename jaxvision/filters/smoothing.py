"""Averages, and what sharpens by undoing them.

Pictures, borders and methods as in `convolution`; sizes in pixels.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._numerics import smallest_divisor
from .._types import Scalar, as_float
from ..padding import Filtered, Picture
from ._terms import Fill
from .convolution import correlate_separable
from .gaussians import Sigma, gaussian
from .kernels import _both_ways, binomial_kernel, box_kernel


def box(
    picture: Picture,
    *,
    size: int | np.integer | Sequence[int],
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """The mean over `size` pixels, both ways or (down, across); an even size reaches one pixel
    further up and left."""
    down, across = _both_ways(size)
    return correlate_separable(
        picture, box_kernel(down), box_kernel(across), border=border, fill=fill, method=method
    )


def binomial(
    picture: Picture,
    *,
    size: int,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """The mean with binomial weights, variance (size - 1) / 4 pixels^2 each way."""
    taps = binomial_kernel(size)
    return correlate_separable(picture, taps, taps, border=border, fill=fill, method=method)


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
    """f + amount (f - gaussian(f)): `amount` times the detail below `sigma` pixels on top. No limit
    is put on the overshoot. Source: Szeliski, Computer Vision, section 3.2."""
    blurred = gaussian(picture, sigma, size=size, truncate=truncate, border=border, fill=fill)
    sharp = as_float(picture)
    return sharp + jnp.asarray(amount, sharp.dtype) * (sharp - blurred)


def blur_straight(
    picture: Float[Array, "... h w channels"], *, blur: Callable[[Filtered], Filtered]
) -> Float[Array, "... h w channels"]:
    """Any blur of a picture with transparency: its last channel is the coverage alpha, the others
    straight (not premultiplied) light; any unit.

    Light counts in proportion to its coverage: blur(alpha light) / blur(alpha), and blur(alpha), so
    that the colour of what is wholly transparent never shows. Where nothing is covered the light is
    0. An alpha beyond [0, 1] continues the formula. A premultiplied layer needs none of this: blur
    all its channels alike. Source: Porter and Duff, SIGGRAPH 1984.
    """
    light, alpha = picture[..., :-1], picture[..., -1:]
    layer = blur(jnp.concatenate([light * alpha, alpha], axis=-1))
    covered = jnp.abs(layer[..., -1:]) > smallest_divisor(layer.dtype)
    straight = layer[..., :-1] / jnp.where(covered, layer[..., -1:], 1)
    return jnp.concatenate([jnp.where(covered, straight, 0), layer[..., -1:]], axis=-1)
