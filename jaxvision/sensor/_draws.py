"""Random numbers for pixels, as a hash of the random key, the pixel and the purpose of the number.

`jax.random` stores its random bits in memory before they are used, because XLA cannot fuse its loop
over the rounds of Threefry with other operations. The hash in this file is unrolled and fused, and
draws Gaussian numbers for 12 megapixels in half the time. The random bits are those of
Threefry-2x32-20 (Salmon et al., "Parallel Random Numbers: As Easy as 1, 2, 3", SC 2011). The number
for a pixel depends on the key, the pixel's position and the purpose, and not on the other effects
of the sensor.
"""

from enum import IntEnum

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, UInt32

from ..core._numerics import polynomial
from ..core._random import seed_of
from ..core._types import Key, Scalars

Words = UInt32[Array, "..."]
Shape = tuple[int, ...]

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = 0x1BD11BDA


class Frame(IntEnum):
    """Purposes of random numbers that are drawn anew in each frame."""

    SHOT = 0
    READ = 1
    READ_TAIL = 2
    TELEGRAPH = 3
    ROW = 4
    BANDING = 5
    TRANSFER = 6
    COLUMN = 7
    OFFSET = 16  # the offset of the whole frame


class Die(IntEnum):
    """Purposes of random numbers that are fixed for a camera. These numbers differ from those of a
    frame even under the same key."""

    PRNU = 8
    DSNU = 9
    DEFECT = 10
    TRAP = 11
    COLUMN_OFFSET = 12
    ROW_OFFSET = 13
    COLUMN_GAIN = 14
    CONVERSION = 15


def subkey(key: Key | None, use: Frame | Die) -> Key:
    """Return the key for one purpose, derived from `key`. Raise `ValueError` if `key` is None."""
    return jax.random.fold_in(needed(key, use), int(use))


def needed(key: Key | None, use: Frame | Die) -> Key:
    """Return the key, or raise `ValueError` if it is None, because a sensor effect needs random
    numbers."""
    if key is None:
        name = "key" if isinstance(use, Frame) else "die_key"
        raise ValueError(f"{name} must be a random key, got None: this sensor draws from it.")
    return key


def gaussian(key: Key | None, use: Frame | Die, shape: Shape, dtype: DTypeLike) -> Scalars:
    """Return standard Gaussian random numbers of this shape, no unit."""
    return upper_quantile(words(key, use, shape), counting_dtype(dtype)).astype(dtype)


def uniform(key: Key | None, use: Frame | Die, shape: Shape, dtype: DTypeLike) -> Scalars:
    """Return random numbers that are uniform in (0, 1] with full relative precision near 0, no
    unit. For a dtype narrower than float32 the result is float32, because the narrow dtype would
    round it to 0 or 1."""
    return tail_probability(words(key, use, shape), counting_dtype(dtype))


def counting_dtype(dtype: DTypeLike) -> jnp.dtype:
    """Return the dtype in which random bits are converted to numbers: `dtype`, or float32 if
    `dtype` cannot represent 2^32."""
    return jnp.dtype(dtype if jnp.dtype(dtype).itemsize >= 4 else jnp.float32)


def draw_per_column(key: Key | None, use: Frame | Die, shape: Shape, dtype: DTypeLike) -> Scalars:
    """Return a standard Gaussian random number for each column and band, (1, w, bands), no unit.
    All frames of a batch have the same numbers."""
    check_image(f"Noise by {use.name.lower()}", shape)
    ones = (1,) * (len(shape) - 2)
    return gaussian(key, use, shape[-2:], dtype).reshape(*ones, *shape[-2:])


def draw_per_row(key: Key | None, use: Frame | Die, shape: Shape, dtype: DTypeLike) -> Scalars:
    """Return a standard Gaussian random number for each row and band, (h, 1, bands), no unit. All
    frames of a batch have the same numbers."""
    check_image(f"Noise by {use.name.lower()}", shape)
    *batch, height, _, bands = shape
    ones = (1,) * len(batch)
    return gaussian(key, use, (height, bands), dtype).reshape(*ones, height, 1, bands)


def check_image(effect: str, shape: Shape) -> None:
    """Raise `ValueError` if `shape` is not that of an image, which an effect between pixels, rows
    or columns needs."""
    if len(shape) < 3:
        raise ValueError(f"{effect} needs an image (..., h, w, bands), got shape {shape}.")


def tail_probability(bits: Words, dtype: DTypeLike) -> Scalars:
    """Return the probability (bits + 1/2) / 2^32 for random bits, which is never 0."""
    return (bits.astype(dtype) + jnp.asarray(0.5, dtype)) * jnp.asarray(2.0**-32, dtype)


# Coefficients of erfinv(x) / x in w = -log(1 - x^2), single precision: Giles, "Approximating the
# erfinv function", GPU Computing Gems (2011).
_CENTRE = (
    2.81022636e-08,
    3.43273939e-07,
    -3.5233877e-06,
    -4.39150654e-06,
    0.00021858087,
    -0.00125372503,
    -0.00417768164,
    0.246640727,
    1.50140941,
)
_TAIL = (
    -0.000200214257,
    0.000100950558,
    0.00134934322,
    -0.00367342844,
    0.00573950773,
    -0.0076224613,
    0.00943887047,
    1.00167406,
    2.83297682,
)


def upper_quantile(bits: Words, dtype: DTypeLike) -> Scalars:
    """Return the z that a standard Gaussian exceeds with probability `tail_probability(bits)`. The
    error of z is 5e-7 up to |z| = 5.3 and 4e-4 up to 6.3, in every dtype."""
    centred, probability = centred_probability(bits, dtype)
    w = -jnp.log(4 * probability * (1 - probability))
    centre = polynomial(_CENTRE, w - 2.5)
    tail = polynomial(_TAIL, jnp.sqrt(jnp.maximum(w, 5)) - 3)
    return 2**1.5 * centred * jnp.where(w < 5, centre, tail)


def centred_probability(bits: Words, dtype: DTypeLike) -> tuple[Scalars, Scalars]:
    """Return 1/2 - `tail_probability(bits)`, and the distance of the probability from the nearer of
    0 and 1. The two numbers are computed without cancellation.
    """
    above = bits < jnp.uint32(2**31)
    nearer = jnp.where(above, bits, ~bits)
    from_median = (jnp.uint32(2**31) - nearer).astype(dtype) - jnp.asarray(0.5, dtype)
    centred = from_median * jnp.asarray(2.0**-32, dtype)
    return jnp.where(above, centred, -centred), tail_probability(nearer, dtype)


def words(key: Key | None, use: Frame | Die, shape: Shape) -> Words:
    """Return 32 random bits for each entry of `shape`. One hash yields two words, which serve two
    purposes."""
    seed = seed_of(needed(key, use))
    place = jax.lax.iota(jnp.uint32, int(np.prod(shape))).reshape(shape)
    return threefry(seed, place, jnp.uint32(use // 2))[use % 2]


@jax.jit
def threefry(seed: UInt32[Array, "2"], first: Words, second: Words) -> tuple[Words, Words]:
    """Encrypt the counter (first, second) with the key `seed` by the block cipher Threefry-2x32
    with 20 rounds."""
    keys = seed[0], seed[1], seed[0] ^ seed[1] ^ jnp.uint32(_PARITY)
    x, y = first + keys[0], jnp.broadcast_to(second + keys[1], first.shape)
    for i in range(5):
        for rotation in _ROTATIONS[i % 2]:
            x = x + y
            y = x ^ ((y << jnp.uint32(rotation)) | (y >> jnp.uint32(32 - rotation)))
        x = x + keys[(i + 1) % 3]
        y = y + keys[(i + 2) % 3] + jnp.uint32(i + 1)
    return x, y
