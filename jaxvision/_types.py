"""Array aliases, the dtype-keeping conversions, shape checks and grouping. Nothing here computes.

Axis names: `...` any batch, `bands` spectral bands (RGB is three bands), `h w` image rows and
columns, `3` a Cartesian vector. `Colour` and `Scalar` belong to ONE point, ray or pixel: the caller
vmaps.
"""

from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, Shaped

Scalar = Float[Array, ""]
Scalars = Float[Array, "..."]
Colour = Float[Array, " bands"]
Spectrum = Float[Array, "... bands"]
Image = Float[Array, "*batch h w bands"]
Key = PRNGKeyArray | Shaped[Array, "2"]

Record = TypeVar("Record")


def as_float(x: Any) -> Array:
    """An array of strong floating dtype: floating input keeps its own, anything else gets JAX's
    default.

    Strong, because a weakly typed leaf traces a second time when a strong one follows.
    """
    array = jnp.asarray(x)
    if jnp.issubdtype(array.dtype, jnp.floating) and not array.weak_type:
        return array
    return array.astype(jnp.result_type(float))


def as_optional_float(x: Any) -> Array | None:
    """`as_float`, with None (an absent effect) staying None."""
    return None if x is None else as_float(x)


def as_relative(x: Any) -> Array:
    """An array of colours or coverage in the dtype it has, which must be floating: relative values
    are fractions, and as codes they would wrap around or round to 0.

    `ValueError` for any other, codes and complex numbers alike.
    """
    array = jnp.asarray(x)
    if not jnp.issubdtype(array.dtype, jnp.floating):
        codes = jnp.issubdtype(array.dtype, jnp.unsignedinteger)
        largest = jnp.iinfo(array.dtype).max if codes else "the largest value"
        raise ValueError(
            f"colours are floating and relative, got {array.dtype}; divide by {largest}."
        )
    return array


def as_dtype(record: Record, dtype: Any) -> Record:
    """The record with every floating leaf in `dtype`: float32 against float64 is the caller's
    choice, made per call."""
    return jax.tree.map(
        lambda leaf: leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf,
        record,
    )


def check_shape(name: str, x: Any, *expected: tuple[int | str, ...]) -> None:
    """Raises `ValueError` unless `x` has one of the expected shapes; a word stands for any length.

    None, an absent effect, has no shape to check.
    """
    if x is None:
        return
    shape = jnp.shape(x)
    for wanted in expected:
        if len(wanted) == len(shape) and all(
            isinstance(size, str) or size == got for size, got in zip(wanted, shape, strict=True)
        ):
            return
    allowed = " or ".join("(" + ", ".join(map(str, e)) + ")" for e in expected)
    raise ValueError(f"{name} must have shape {allowed}, got {shape}.")


def group_by_structure(
    records: Sequence[Record], *, largest: int | None = None
) -> list[tuple[tuple[int, ...], Record]]:
    """Records of equal kind and leaf shapes, stacked along a new leading axis.

    Each group is (indices into `records`, stacked record); groups and members keep their order.
    Structure is what `jit` compiles for, so one group is one piece of compiled code. A record with
    an array of more than `largest` numbers is a group of its own: `take` by a pixel's index would
    copy its tables for every pixel.
    """
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
    """The record of that index from a stacked group, and whether it is a member (if not, the
    record is the group's first). A group of one is not gathered from."""
    if len(members) == 1:
        return jax.tree.map(lambda leaf: leaf[0], group), index == members[0]
    slots = np.full(max(members) + 2, -1)
    slots[list(members)] = np.arange(len(members))
    slot = jnp.asarray(slots)[jnp.minimum(index, len(slots) - 1)]
    return jax.tree.map(lambda leaf: leaf[jnp.maximum(slot, 0)], group), slot >= 0
