"""From raw data to a picture: black level, scale, tone curve; and to the integers of a file."""

import jax.numpy as jnp
from jaxtyping import Array, UInt

from ._types import Scalars
from .point_ops import gamma_encode, srgb_encode
from .scene import SRGB, Development, Gamma


def develop(raw: Scalars, development: Development) -> Scalars:
    """(raw - black) / (white - black), then the tone curve; elementwise, any shape.

    `raw`: DN. Returns relative values, 1 being the white level (DN where there is none). Nothing
    is clipped: noise below black stays negative, except that a gamma curve makes it 0.
    """
    picture, span = raw, development.white_level
    if development.black_level is not None:
        picture = picture - development.black_level
        span = None if span is None else span - development.black_level
    if span is not None:
        picture = picture / span
    match development.tone:
        case None:
            return picture
        case Gamma(gamma=gamma):
            return gamma_encode(picture, gamma)
        case SRGB():
            return srgb_encode(picture)


def to_integers(picture: Scalars, *, bits: int = 8) -> UInt[Array, "..."]:
    """The codes of an integer file: round((2^bits - 1) x) of relative x, clipped to [0, 1].

    8 bits give uint8, 16 uint16, anything else `ValueError`. NaN becomes 0.
    """
    dtypes = {8: jnp.uint8, 16: jnp.uint16}
    if bits not in dtypes:
        raise ValueError(f"bits must be 8 or 16, got {bits}.")
    clipped = jnp.clip(jnp.where(jnp.isnan(picture), 0, picture), 0, 1)
    return jnp.round(clipped * (2**bits - 1)).astype(dtypes[bits])
