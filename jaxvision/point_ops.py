"""Point operators: each pixel by itself, elementwise on arrays of any shape and floating dtype.

Encoded and linear values are relative, nominally in [0, 1] and continued above 1. Values and
gradients are finite everywhere, also at and below 0. Parameters broadcast with the pixels.
"""

import jax.numpy as jnp

from ._numerics import power
from ._types import Scalars


def gain_bias(x: Scalars, gain: Scalars, bias: Scalars) -> Scalars:
    """gain x + bias, `bias` in the unit of the result (Szeliski, Computer Vision, 3.1.1)."""
    return gain * x + bias


def gamma_encode(linear: Scalars, gamma: Scalars) -> Scalars:
    """linear ** (1 / gamma), gamma > 0; values below 0 count as 0, where the gradient is 0."""
    return power(linear, 1 / gamma)


def gamma_decode(encoded: Scalars, gamma: Scalars) -> Scalars:
    """encoded ** gamma, the inverse of `gamma_encode`; values below 0 count as 0."""
    return power(encoded, gamma)


def srgb_encode(linear: Scalars) -> Scalars:
    """12.92 x up to 0.0031308 (also below 0), else 1.055 x^(1/2.4) - 0.055 (IEC 61966-2-1)."""
    curved = linear > 0.0031308
    return jnp.where(
        curved, 1.055 * jnp.where(curved, linear, 1) ** (1 / 2.4) - 0.055, 12.92 * linear
    )


def srgb_decode(encoded: Scalars) -> Scalars:
    """x / 12.92 up to 0.04045 (also below 0), else ((x + 0.055) / 1.055)^2.4 (IEC 61966-2-1)."""
    curved = encoded > 0.04045
    return jnp.where(
        curved, ((jnp.where(curved, encoded, 1) + 0.055) / 1.055) ** 2.4, encoded / 12.92
    )
