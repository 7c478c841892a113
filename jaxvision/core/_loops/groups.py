"""Stack records of equal structure, so that one compiled program serves all of them. The index of a
record in its stack may be a traced number."""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from .._types import Record
from ..parallel_loops import scan

Tree = TypeVar("Tree")

UNROLLED = 8  # loops over more records are not unrolled


def group_by_structure(
    records: Sequence[Record], *, largest: int | None = None
) -> list[tuple[tuple[int, ...], Record]]:
    """Group records of equal type and shapes. For each group, return the indices into `records` and
    the stacked record. Groups are in the order of their first records. A record with an array of
    more than `largest` numbers gets a separate group, because `take` would copy that array for
    every pixel."""
    members: dict[Any, list[int]] = {}
    for i, record in enumerate(records):
        leaves, structure = jax.tree.flatten(record)
        kind = structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        if largest is not None and any(leaf.size > largest for leaf in leaves):
            kind = kind, i
        members.setdefault(kind, []).append(i)
    return [
        (
            tuple(group),
            jax.tree.map(lambda *leaves: jnp.stack(leaves), *(records[i] for i in group)),
        )
        for group in members.values()
    ]


def take(
    members: tuple[int, ...], group: Record, index: Int[Array, ""]
) -> tuple[Record, Bool[Array, ""]]:
    """Return the record with this index in `members` from a stacked group, and whether the group
    contains it. If the group does not contain the record, the first record of the group is
    returned. A group of one record is not indexed."""
    if len(members) == 1:
        return jax.tree.map(lambda leaf: leaf[0], group), index == members[0]
    if members == tuple(range(members[0], members[0] + len(members))):
        slot = index - members[0]
        found = (slot >= 0) & (slot < len(members))
        slot = jnp.where(found, slot, 0)
    else:
        slots = np.full(max(members) + 2, -1)
        slots[list(members)] = np.arange(len(members))
        slot = jnp.asarray(slots)[jnp.minimum(index, len(slots) - 1)]
        found = slot >= 0
        slot = jnp.maximum(slot, 0)
    return jax.tree.map(lambda leaf: row(leaf, slot), group), found


def call_member(
    members: Sequence[tuple[int, ...]],
    groups: Sequence[Any],
    index: Int[Array, ""],
    function: Callable[[Any], Tree],
) -> Tree | None:
    """Apply `function` to record `index` of several stacked groups. Return None if there are no
    groups."""
    chosen = None
    for numbers, group in zip(members, groups, strict=True):
        record, among = take(numbers, group, index)
        here = function(record)
        chosen = here if chosen is None else jax.tree.map(partial(jnp.where, among), here, chosen)
    return chosen


def fold(step: Callable[[Tree, Record], Tree], start: Tree, records: Sequence[Record]) -> Tree:
    """Apply `step` to an accumulated result and each record in turn, and return the final result.
    With more than `UNROLLED` records, records of equal structure share one compiled loop, so that
    the compile time does not grow with the number of records."""
    if len(records) <= UNROLLED:
        return reduce(step, records, start)
    result = start
    for members, group in group_by_structure(records):
        result = step(result, records[members[0]])  # has the shape of all later results
        rest = jax.tree.map(lambda leaf: leaf[1:], group)
        result, _ = scan(lambda so_far, one: (step(so_far, one), None), result, rest)
    return result


def row(leaf: Array, slot: Int[Array, ""]) -> Array:
    """Return leaf[slot], where `slot` must be a valid index. A row of up to four numbers is read
    one number at a time. Each read is then a gather of scalars, for which CPUs have vector
    instructions. Numbers of the row that the program does not use are not read."""
    if leaf.ndim == 2 and leaf.shape[1] <= 4:
        columns = [leaf[:, k].at[slot].get(mode="promise_in_bounds") for k in range(leaf.shape[1])]
        return jnp.stack(columns)
    return leaf.at[slot].get(mode="promise_in_bounds")
