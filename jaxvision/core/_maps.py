"""Find the maps (parameters that vary over a surface) in a record, and replace them by numbers."""

from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any, TypeVar

import equinox as eqx
import jax
from jaxtyping import Array

from ._types import Varying

Record = TypeVar("Record")

# Functions that return the smallest and the largest number or spectrum of a map.
ENDS = (lambda own: own.values.min(axis=(0, 1))), (lambda own: own.values.max(axis=(0, 1)))


def is_map(x: Any) -> bool:
    """Return whether `x` is a `Map`, or a map that was prepared for a renderer."""
    return isinstance(x, Varying)


def maps_of(record: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each map in a record with its path, such as ("material.diffuse", Map)."""
    if isinstance(record, Varying):
        yield place, record
    elif isinstance(record, eqx.Module):
        for field in fields(record):
            inside = f"{place}.{field.name}".lstrip(".")
            yield from maps_of(getattr(record, field.name), inside)


def replace_maps(record: Record, number: Callable[[Any], Any]) -> Record:
    """Replace each map of a record, or of a tuple of records, by a number or spectrum."""
    return jax.tree.map(lambda x: number(x) if is_map(x) else x, record, is_leaf=is_map)


def mean_of(values: Any) -> Array:
    """Return the mean of a map over its pixels, in the unit of its values."""
    return values.values.mean(axis=(0, 1))
