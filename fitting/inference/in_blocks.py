"""Sums over many samples, a block at a time. Intermediate results then stay in the processor's
cache, and the memory is independent of the number of samples. An accelerator takes more samples at
a time, because every operation has the cost of a kernel launch.

Samples are a record whose arrays hold one value per sample, with numbers that all samples share.
The last block is padded with copies of the last sample, which do not count.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxvision.programs import on_processor

BLOCK = 8192  # samples; some twenty arrays of them fit into a cache of 2 MB
_OF_KERNEL = 128  # times as many on an accelerator

Terms = TypeVar("Terms")
Counts = Bool[Array, " samples"] | None  # which samples count; None where all do


def at_a_time(of_core: int) -> int:
    """The number of entries that a loop takes at a time: `of_core` on a processor, many more
    elsewhere."""
    return of_core if on_processor() else of_core * _OF_KERNEL


def summed(
    terms: Callable[[Any, Counts], Terms], samples: Any, *, block: int | None = None
) -> Terms:
    """The sum of terms over blocks of samples.

    `block`: maximum number of samples in one; None for a number that suits the device."""
    blocks, shared, counts = _cut(samples, block)

    def of(part: tuple[Any, Counts]) -> Terms:
        own, counted = part
        return terms(eqx.combine(own, shared), counted)

    first = jax.tree.map(lambda x: x[0], (blocks, counts))
    zero = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(of, first))

    def added(total: Terms, part: tuple[Any, Counts]) -> tuple[Terms, None]:
        return jax.tree.map(jnp.add, total, of(part)), None

    return jax.lax.scan(added, zero, (blocks, counts))[0]


def mapped(values: Callable[[Any], Terms], samples: Any, *, block: int | None = None) -> Terms:
    """Values of every sample, computed in blocks.

    `block`: maximum number of samples in one; None for a number that suits the device."""
    blocks, shared, _ = _cut(samples, block)
    count = _count(samples)
    found = jax.lax.map(lambda own: values(eqx.combine(own, shared)), blocks)

    def joined(values: Array) -> Array:
        beside = jnp.moveaxis(values, 0, -2)
        return beside.reshape(*beside.shape[:-2], -1)[..., :count]

    return jax.tree.map(joined, found)


def _cut(samples: Any, block: int | None) -> tuple[Any, Any, Counts]:
    """Arrays of shape (blocks, samples of one), the shared values, and the mask of samples that
    count."""
    own, shared = eqx.partition(samples, lambda leaf: eqx.is_array(leaf) and leaf.ndim > 0)
    count = _count(samples)
    blocks = -(-count // (block or at_a_time(BLOCK)))
    size = -(-count // blocks)
    missing = blocks * size - count

    def cut(values: Array) -> Array:
        return jnp.pad(values, (0, missing), mode="edge").reshape(blocks, size)

    counts = (jnp.arange(blocks * size) < count).reshape(blocks, size) if missing else None
    return jax.tree.map(cut, own), shared, counts


def _count(samples: Any) -> int:
    """Number of samples in a record."""
    return max(leaf.shape[0] for leaf in jax.tree.leaves(samples) if jnp.ndim(leaf))
