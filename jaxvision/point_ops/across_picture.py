"""Gains that vary across a picture: a graded filter and vignetting. Values are relative."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, takes_range
from ..core._numerics import divide, smallest_divisor
from ..core._types import AMOUNT, Scalar, as_relative, print_by_name

Picture = Float[Array, "..."]
print_by_name(globals(), "Picture")

_LN_10 = 2.302585092994046


@takes_numbers
@takes_range(width=AMOUNT)
def graded_filter(
    image: Picture,
    density: Scalar | float,
    angle: Scalar | float,
    centre: Scalar | float,
    width: Scalar | float,
) -> Picture:
    """Apply a graded neutral density filter in front of the lens: multiply linear light by
    10^(-density s).

    s rises smoothly, as 3 t^2 - 2 t^3, from 0 on the clear side to 1 on the dark side.

    Args:
        image: (h, w) or (..., h, w, bands) relative, linear.
        density: () optical density of the dark side, no unit; 0.3 is one stop.
        angle: () rad, the direction in which the filter darkens: 0 to the right, pi/2 up.
        centre: () position of half the density, relative to the picture's height, from its centre.
        width: () of the transition, relative to the picture's height; 0 is a step.

    Returns:
        The image's shape, relative.

    Raises:
        ValueError: for fewer than two axes, and a width below 0.
    """
    image, rows, columns = _check_size(image)
    right, up = _centred_places(rows, columns, image.dtype, unit=rows)
    along = jnp.cos(angle) * right + jnp.sin(angle) * up
    t = jnp.clip((along - centre) / jnp.maximum(width, smallest_divisor(image.dtype)) + 0.5, 0, 1)
    return image * _broadcast_map(jnp.exp(-_LN_10 * density * t * t * (3 - 2 * t)), image)


@takes_numbers
def vignette(image: Picture, coefficients: Float[Array, " terms"]) -> Picture:
    """Multiply linear light by the falloff 1 + k_1 r^2 + k_2 r^4 + ...

    r is the distance from the picture's centre, divided by the distance of a corner. For the cos^4
    law of an ideal lens use `optics`.

    Args:
        image: (h, w) or (..., h, w, bands) relative, linear.
        coefficients: (terms,) k_1, k_2, ..., no unit. A negative falloff is set to 0.

    Returns:
        The image's shape, relative.

    Raises:
        ValueError: for fewer than two axes.

    Source: the "pa" model of lens tables.
    """
    image, rows, columns = _check_size(image)
    return image * _broadcast_map(_falloff(rows, columns, image.dtype, coefficients), image)


@takes_numbers
def correct_vignetting(image: Picture, coefficients: Float[Array, " terms"]) -> Picture:
    """Divide by the falloff, the inverse of `vignette`. Pixels where the falloff is 0 stay 0.

    Args:
        image: (h, w) or (..., h, w, bands) relative, linear.
        coefficients: (terms,) k_1, k_2, ..., no unit, as for `vignette`.

    Returns:
        The image's shape, relative.

    Raises:
        ValueError: for fewer than two axes.
    """
    image, rows, columns = _check_size(image)
    falloff = _falloff(rows, columns, image.dtype, coefficients)
    inverse = divide(1, falloff, ~(falloff <= smallest_divisor(image.dtype)))
    return image * _broadcast_map(inverse, image)


def _falloff(
    rows: int, columns: int, dtype: np.dtype, coefficients: Float[Array, " terms"]
) -> Float[Array, "h w"]:
    half_diagonal = ((rows - 1) ** 2 + (columns - 1) ** 2) ** 0.5 / 2
    right, up = _centred_places(rows, columns, dtype, unit=half_diagonal or 1)
    r2 = right * right + up * up
    total = jnp.zeros_like(r2)
    for k in coefficients[::-1]:
        total = (total + k) * r2
    return jnp.maximum(1 + total, 0)


def _check_size(image: Picture) -> tuple[Picture, int, int]:
    """Return the picture and its numbers of rows and columns. Raise `ValueError` for an array that
    is not a picture.
    """
    image = as_relative(image)
    if image.ndim < 2:
        raise ValueError(f"image must be (h, w) or (..., h, w, bands), got shape {image.shape}.")
    rows, columns = image.shape if image.ndim == 2 else image.shape[-3:-1]
    return image, rows, columns


def _centred_places(
    rows: int, columns: int, dtype: np.dtype, *, unit: float | int
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """Return (right, up), the position of each pixel's centre relative to the picture's centre, in
    multiples of `unit` pixels.
    """
    right = (jnp.arange(columns, dtype=dtype) - (columns - 1) / 2) / unit
    up = ((rows - 1) / 2 - jnp.arange(rows, dtype=dtype)) / unit
    return jnp.broadcast_to(right, (rows, columns)), jnp.broadcast_to(up[:, None], (rows, columns))


def _broadcast_map(values: Float[Array, "h w"], image: Picture) -> Float[Array, "..."]:
    """Reshape a map (h, w) to broadcast over a batch of images."""
    if image.ndim == 2:
        return values
    return values.reshape((1,) * (image.ndim - 3) + values.shape + (1,))
