"""What is computed at once and what is stored in between: for speed, no value depends on it."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
from jax.experimental.xla_metadata import set_xla_metadata
from jaxtyping import Array

TILE = 16384  # rays at once: an array of them is 64 kB in float32, and all of a tile fit the cache


@partial(jax.jit, static_argnums=0)
def _stage(function: Callable[..., Any], *arguments: Any) -> Any:
    with set_xla_metadata(inlineable="true"):
        return function(*arguments)


def stored(function: Callable[..., Any], *arguments: Any) -> Any:
    """`function(*arguments)`, computed once and stored.

    XLA fuses a value into every loop that reads it, and so repeats a ray's hit for each band of
    each light (a render takes twice as long); an optimisation barrier is gone before it fuses. A
    call that is not inlined is a border that loops do not cross. The attribute would reach all
    calls inside, each `jnp.where` among them, hence its opposite there.
    """
    with set_xla_metadata(inlineable="false"):
        return _stage(function, *arguments)


def in_tiles(function: Callable[..., Array], *arrays: Array, size: int) -> Array:
    """`vmap(function)(*arrays)` over the leading axes, `size` entries at a time.

    What lies between the stages of one tile stays in the cache, and a gradient computes a tile
    again rather than keep it: both take half the time and a tenth of the memory.
    """
    if len(arrays[0]) <= size:
        return jax.vmap(function)(*arrays)
    return jax.lax.map(jax.checkpoint(lambda entry: function(*entry)), arrays, batch_size=size)
