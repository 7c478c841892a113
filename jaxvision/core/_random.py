"""Uniform random numbers, computed as a function of the pixel, the sample and the dimension that
use them.

The seed and the three indices (pixel, sample, dimension) identify a random number. The number is a
hash of the seed and the indices, so any pixel can be computed alone, again, or in any order, with
the same bits. The hash costs three multiplications per number. JAX's threefry, which is designed to
resist prediction, takes 14 times as long inside a loop over rays.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, UInt32

from ._types import Key, Scalar

Word = UInt32[Array, ""]


class Stream(eqx.Module):
    """The source of random numbers for one sample of one pixel."""

    pixel: UInt32[Array, "*pixels"]  # the number of the pixel
    # the index of the sample in its pixel; None if a pixel has one ray and no random numbers
    sample: Word | None
    seed: UInt32[Array, "2"] | None  # two words, from `seed_of`; None if `sample` is None


def seed_of(key: Key) -> UInt32[Array, "2"]:
    """Return the seed, two random words, of a random key."""
    return jax.random.bits(key, (2,), jnp.uint32)


def uniforms(stream: Stream, block: Word | int, dtype: DTypeLike) -> Float[Array, "4"]:
    """Return four independent random numbers, (4,), uniform in [0, 1), for the dimensions 4 `block`
    to 4 `block` + 3. The numbers are multiples of 2^-24 in float32 and of 2^-32 in float64."""
    words = _words(stream, stream.sample, block)
    return jnp.stack([_unit(word, dtype) for word in words])


def lattice_point(stream: Stream, dimensions: int, dtype: DTypeLike) -> Float[Array, " n"]:
    """Return numbers of a sample, (dimensions,), uniform in [0, 1): 2 for its position in the
    pixel and, of 4, 2 for its position on the lens. Sample k uses point k of a Kronecker
    sequence, with the coordinates (k alpha_i + shift_i) mod 1. In d dimensions, alpha_i =
    phi^-i with phi^(d+1) = phi + 1 (Roberts, 2018), rounded to a multiple of 2^-32. Each pixel
    has a random shift (Cranley and Patterson, SIAM J. Numerical Analysis 13 (1976))."""
    shifts = _words(stream, jnp.uint32(0), _LATTICE_BLOCK)
    steps = _steps(dimensions)
    sample = jnp.uint32(0) if stream.sample is None else stream.sample
    words = [shift + sample * step for shift, step in zip(shifts, steps, strict=False)]
    return jnp.stack([_unit(word, dtype) for word in words])


# Block of random numbers for the shifts of the lattice; no path uses it
_LATTICE_BLOCK = 0xFFFFFFFF


def _steps(dimensions: int) -> list[np.uint32]:
    """Return 2^32 phi^-i for i = 1 .. d, with phi the positive root of phi^(d+1) = phi + 1."""
    root = 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (dimensions + 1))
    return [np.uint32(2**32 * root**-i) for i in range(1, dimensions + 1)]


def _words(stream: Stream, sample: Word | None, block: Word | int) -> tuple[Word, ...]:
    if sample is None or stream.seed is None:
        raise ValueError("a pixel of one ray has no random numbers; give it samples.")
    return _hash(
        stream.pixel ^ stream.seed[0], sample, jnp.asarray(block, jnp.uint32), stream.seed[1]
    )


def _unit(word: Word, dtype: DTypeLike) -> Scalar:
    """Convert a 32-bit word to word / 2^32, a number in [0, 1), from as many leading bits as
    `dtype` can represent."""
    bits = min(jnp.finfo(dtype).nmant + 1, 32)
    # through int32, for which CPUs have vector conversions
    leading = (word >> (32 - bits)) if bits < 32 else word
    number = leading.astype(jnp.int32) if bits < 32 else leading
    return number.astype(dtype) * jnp.asarray(2.0**-bits, dtype)


def _hash(x: Word, y: Word, z: Word, w: Word) -> tuple[Word, Word, Word, Word]:
    """Hash four words by the function pcg4d of Jarzynski and Olano, "Hash Functions for GPU
    Rendering", JCGT 9(3) (2020)."""
    x, y, z, w = (v * jnp.uint32(1664525) + jnp.uint32(1013904223) for v in (x, y, z, w))
    x, y, z, w = _mix(x, y, z, w)
    x, y, z, w = (v ^ (v >> 16) for v in (x, y, z, w))
    return _mix(x, y, z, w)


def _mix(x: Word, y: Word, z: Word, w: Word) -> tuple[Word, Word, Word, Word]:
    x = x + y * w
    y = y + z * x
    z = z + x * y
    w = w + y * z
    return x, y, z, w
