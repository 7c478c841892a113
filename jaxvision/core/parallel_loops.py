"""Loops whose steps run on all cores of a CPU. `scan`, `map_`, `fori_loop` and `while_loop` have
the arguments and the results of the functions of `jax.lax`.

XLA compiles a loop that touches less than a kilobyte into a function for one core, because starting
several threads takes longer than such a loop. jaxlib 0.12 compiles every loop in this way, whatever
the size of its arrays: the Cornell box then takes 1.6 times the processor time, on one core instead
of all. Loops that sort are the exception, because a function for one core cannot sort. Each step
therefore sorts two equal numbers, which takes less than a microsecond, and keeps its values if the
two are still equal.
"""

from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..programs import targets_cpu

Carry = TypeVar("Carry")

_ON_ONE_CORE = ("0.12.",)  # versions of jaxlib


def scan(
    step: Callable[[Any, Any], tuple[Any, Any]],
    start: Any,
    items: Any,
    *,
    length: int | None = None,
    reverse: bool = False,
) -> tuple[Any, Any]:
    """Return `jax.lax.scan(step, start, items, length, reverse)`."""
    if not _is_needed():
        return jax.lax.scan(step, start, items, length, reverse)
    count = len(jax.tree.leaves(items)[0]) if length is None else length

    def numbered(carry: Any, item: tuple[Array, Any]) -> tuple[Any, Any]:
        number, own = item
        if any(map(_is_numeric, jax.tree.leaves(carry))):
            return step(_attach_sort(number, carry), own)
        return step(carry, _attach_sort(number, own))

    items = jnp.arange(count, dtype=jnp.int32), items
    return jax.lax.scan(numbered, start, items, reverse=reverse)


def map_(function: Callable[[Any], Any], items: Any, *, batch_size: int | None = None) -> Any:
    """Return `jax.lax.map(function, items, batch_size=batch_size)`."""
    if not _is_needed():
        return jax.lax.map(function, items, batch_size=batch_size)
    numbered = jnp.arange(len(jax.tree.leaves(items)[0]), dtype=jnp.int32), items
    return jax.lax.map(lambda item: function(_attach_sort(*item)), numbered, batch_size=batch_size)


def fori_loop(
    first: int | Array, end: int | Array, step: Callable[[Array, Carry], Carry], start: Carry
) -> Carry:
    """Return `jax.lax.fori_loop(first, end, step, start)`."""
    if not _is_needed():
        return jax.lax.fori_loop(first, end, step, start)
    return jax.lax.fori_loop(first, end, lambda k, carry: step(k, _attach_sort(k, carry)), start)


def while_loop(
    goes_on: Callable[[Carry], Array], step: Callable[[Carry], Carry], start: Carry
) -> Carry:
    """Return `jax.lax.while_loop(goes_on, step, start)`."""
    if not _is_needed():
        return jax.lax.while_loop(goes_on, step, start)

    def numbered(state: tuple[Array, Carry]) -> tuple[Array, Carry]:
        number, carry = state
        return number + 1, step(_attach_sort(number, carry))

    zero = jnp.zeros((), jnp.int32)
    return jax.lax.while_loop(lambda state: goes_on(state[1]), numbered, (zero, start))[1]


@cache
def _runs_on_one_core() -> bool:
    return version("jaxlib").startswith(_ON_ONE_CORE)


def _is_needed() -> bool:
    return _runs_on_one_core() and targets_cpu()


def _attach_sort(number: Array, values: Any) -> Any:
    """Return the values. One array is replaced by 0 if two equal numbers differ after sorting,
    which never occurs, but XLA does not know this."""
    leaves, tree = jax.tree.flatten(values)
    arrays = [i for i, leaf in enumerate(leaves) if _is_numeric(leaf)]
    if arrays:
        at = min(arrays, key=lambda i: jnp.size(leaves[i]))
        low, high = jax.lax.sort(jnp.stack([number, number]))
        leaves[at] = jnp.where(low == high, leaves[at], jnp.zeros_like(leaves[at]))
    return jax.tree.unflatten(tree, leaves)


def _is_numeric(leaf: Any) -> bool:
    dtype = jnp.result_type(leaf)
    return jnp.issubdtype(dtype, jnp.number) or jnp.issubdtype(dtype, jnp.bool_)
