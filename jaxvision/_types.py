"""Array aliases, the dtype-keeping conversions, shape checks and grouping. Nothing here computes.

Axis names: `...` any batch, `bands` spectral bands (RGB is three bands), `h w` image rows and
columns, `3` a Cartesian vector. `Colour` and `Scalar` belong to ONE point, ray or pixel: the caller
vmaps.
"""

from collections.abc import Sequence
from types import UnionType
from typing import Any, TypeVar, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
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


def common_dtype(*records: object) -> jnp.dtype:
    """The floating dtype that all numbers of the records share."""
    leaves = jax.tree.leaves(records)
    return jnp.result_type(*(x for x in leaves if jnp.issubdtype(x.dtype, jnp.floating)))


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
    allowed = " or ".join(f"({', '.join(map(str, e))}{',' * (len(e) == 1)})" for e in expected)
    raise ValueError(f"{name} must have shape {allowed}, got {shape}.")


def check_kind(name: str, value: Any, *kinds: type | UnionType) -> None:
    """Raises `ValueError` unless `value` is a record of one of the kinds. None, an absent effect,
    passes."""
    known: tuple[Any, ...] = tuple(kind for union in kinds for kind in get_args(union) or (union,))
    if value is None or isinstance(value, known):
        return
    wanted = " or ".join(kind.__name__ for kind in known)
    is_class = isinstance(value, type)
    kind = f"the class {value.__name__}" if is_class else f"a {type(value).__name__}"
    got = repr(value) if np.isscalar(value) else kind
    raise ValueError(f"{name} must be a record, {wanted}, got {got}.")


def check_count(name: str, value: Any, least: int, *, odd: bool = False) -> None:
    """Raises `ValueError` unless `value` is a whole number, not an array of one, of at least
    `least`, and odd where that is asked for."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least or (odd and value % 2 == 0):
        kind = "an odd" if odd else "a whole"
        raise ValueError(f"{name} must be {kind} number of at least {least}, got {value!r}.")


def check_choice(name: str, value: Any, choices: Sequence[str]) -> None:
    """Raises `ValueError` unless `value` is one of those words."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}.")


def check_tile(
    name: str, pattern: Any, *, bands: int | None = None, holder: str = "the picture"
) -> None:
    """Raises `ValueError` unless `pattern` is rows of one length (else it does not tile the plane)
    of the bands 0 to its largest, all of them there; `bands`: how many `holder` has, which must be
    as many."""
    if not isinstance(pattern, tuple) or not all(
        isinstance(row, tuple) and all(isinstance(cell, int | np.integer) for cell in row)
        for row in pattern
    ):
        raise ValueError(
            f"{name} must be a tuple of rows, each a tuple of whole numbers, as in "
            f"((0, 1), (1, 2)), got {pattern!r}."
        )
    widths = sorted({len(row) for row in pattern})
    if len(widths) != 1 or widths == [0]:
        raise ValueError(
            f"{name} must be rows of one length, at least 1, to tile the picture, got {pattern}."
        )
    cells = [cell for row in pattern for cell in row]
    if sorted(set(cells)) != list(range(len(set(cells)))):
        raise ValueError(f"{name} must hold the bands 0, 1, ... without a gap, got {pattern}.")
    if bands is not None and len(set(cells)) != bands:
        raise ValueError(
            f"{name} has the {len(set(cells))} bands of {pattern}, {holder} has {bands}."
        )


def is_known(x: Any) -> bool:
    """Whether the numbers of `x` are there to be looked at: they are not while it is traced."""
    return not isinstance(x, Tracer)


def check_range(
    name: str,
    value: Any,
    low: float | int,
    high: float | int = np.inf,
    *,
    above: bool = False,
    finite: bool = True,
) -> None:
    """Raises `ValueError` unless every number of `value` lies in [low, high], or in (low, high]
    where `above`. None is absent, and what is traced is not known yet: both pass."""
    if value is None or not is_known(value):
        return
    numbers = np.asarray(value)
    inside = (numbers > low if above else numbers >= low) & (numbers <= high)
    if finite:
        inside &= np.isfinite(numbers)
    if not inside.all():
        wrong = numbers[~inside].flat[0]
        least = "above" if above else "at least"
        most = "" if high == np.inf else f" and at most {high:g}"
        kind = "finite, " if finite else ""
        raise ValueError(f"{name} must be {kind}{least} {low:g}{most}, got {wrong}.")


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


def row(leaf: Array, slot: Int[Array, ""]) -> Array:
    """leaf[slot] for a slot that exists, of a few numbers one by one: each is then a gather of
    scalars, which vector units have, and only those that are used are read."""
    if leaf.ndim == 2 and leaf.shape[1] <= 4:
        columns = [leaf[:, k].at[slot].get(mode="promise_in_bounds") for k in range(leaf.shape[1])]
        return jnp.stack(columns)
    return leaf.at[slot].get(mode="promise_in_bounds")
