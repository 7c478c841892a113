"""Records as TOML files: one table for each record, its keys the record's fields.

Numbers are written to the last digit, so that a record comes back bit-equal. Draws of a fitted
record lie beside its file as `.npz`: under each number's path (`.sensor.gain`) an array with a
leading axis, of those numbers that differ from draw to draw.
"""

import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._types import members_of
from .colour_filters import bayer
from .errors import InputError, nearest
from .io import read_arrays, replaced_on_success

Record = TypeVar("Record", bound=eqx.Module)


def write_record(
    file: str | os.PathLike[str],
    what: str,
    tables: Mapping[str, Any],
    record: Record,
    draws: Record | None,
) -> None:
    """Writes a record as TOML, whole or not at all, and its draws beside it.

    Args:
        file: ending in .toml; missing folders are made.
        what: the record is, for messages: `camera`, say.
        tables: of `table_of`.
        record: one, whose shapes count.
        draws: the same with a leading axis at every number; None writes none.

    Raises:
        InputError: for a file of another ending, draws of another record, or draws without a
            leading axis.
    """
    import tomli_w

    path = Path(file)
    if path.suffix != ".toml":
        raise InputError(f"{path}: a {what} file ends in .toml.")
    with replaced_on_success(path) as partial:
        partial.write_text(tomli_w.dumps(tables))
    if draws is not None:
        _write_draws(path, record, draws)


def table_of(record: eqx.Module) -> dict[str, Any]:
    """The table from which `record_of` makes the same record.

    Args:
        record: of numbers, records and static values.

    Returns:
        Values by the names of its fields, its `kind` among them; what is None is left out.
    """
    table: dict[str, Any] = {"kind": type(record).__name__}
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, eqx.Module):
            table[field.name] = table_of(value)
        elif eqx.is_array(value):
            table[field.name] = np.asarray(value).tolist()
        elif value is not None:
            table[field.name] = value
    return table


def with_draws(file: Path, record: Record, count: int) -> Record:
    """A record with a leading axis of draws, those that lie beside its file.

    Args:
        file: of the record.
        record: as it was read.
        count: of draws, spread evenly over those that are there.

    Returns:
        The record, every number of it with a leading axis of that length, for `jax.vmap`.

    Raises:
        InputError: without draws, with fewer, and with draws of another record.
    """
    beside = _beside(file)
    if not beside.is_file():
        raise InputError(f"{beside}: no draws lie beside {file.name}; save a fit with its draws.")
    try:
        stored = read_arrays(beside)
        (there,) = {len(values) if values.ndim else 0 for values in stored.values()}
    except ValueError as error:  # several lengths, or none
        raise InputError(f"{beside}: not a file of draws; save the fit again.") from error
    if not 1 <= count <= there:
        raise InputError(f"{beside}: {count} draws were asked for, {there} are there.")
    rows = np.linspace(0, there - 1, count).astype(int)

    def drawn(path: Any, leaf: Any) -> Any:
        values = stored.pop(jax.tree_util.keystr(path), None)
        if values is None:
            return jnp.broadcast_to(leaf, (count, *np.shape(leaf)))
        if values.shape[1:] != np.shape(leaf):
            raise InputError(f"{beside}: its draws do not fit {file.name}: save the fit again.")
        return jnp.asarray(values[rows], jnp.asarray(leaf).dtype)

    found = jax.tree.map_with_path(drawn, record)
    if stored:
        raise InputError(f"{beside}: {file.name} has no {next(iter(stored))}: save the fit again.")
    return found


def _write_draws(file: Path, record: eqx.Module, draws: eqx.Module) -> None:
    differing = {}
    known = jax.tree.leaves_with_path(record)
    drawn = jax.tree.leaves(draws)
    if jax.tree.structure(record) != jax.tree.structure(draws):
        raise InputError(f"{file}: the draws are of another kind of record.")
    for (path, leaf), values in zip(known, drawn, strict=True):
        if np.shape(values)[1:] != np.shape(leaf) or not np.ndim(values):
            name = jax.tree_util.keystr(path)
            raise InputError(f"{file}: the draws of {name} need one leading axis.")
        values = np.asarray(values)
        if (values != values[:1]).any():
            differing[jax.tree_util.keystr(path)] = values
    if not differing:
        raise InputError(f"{file}: no number differs between the draws.")
    with replaced_on_success(_beside(file)) as partial, partial.open("wb") as stream:
        np.savez(stream, **differing)  # type: ignore[arg-type]


def _beside(file: Path) -> Path:
    return file.with_suffix(".npz")


def record_of(place: str, where: str, kind: type, table: Mapping[str, Any]) -> Any:
    """A record from its table; tables within it become records too.

    Args:
        place: the file, for messages.
        where: the table in it.
        kind: of the record.
        table: values by the names of its fields.

    Returns:
        The record.

    Raises:
        InputError: for an unknown or a missing key, and a value out of range.
    """
    hints = get_type_hints(kind)
    known = {field.name: field for field in fields(kind)}
    check_keys(place, where, table, known)
    values = {}
    for name, value in table.items():
        inside = f"{where}.{name}".lstrip(".")
        if isinstance(value, Mapping):
            values[name] = _chosen_record(place, inside, hints[name], value)
        elif _holds_records_only(hints[name]):
            kinds = " or ".join(kind.__name__ for kind in _records(hints[name]))
            raise InputError(
                f"{place}: {inside} must be the table of a {kinds}, got {value!r}; head it "
                f"[{inside}]."
            )
        elif known[name].metadata.get("static"):
            values[name] = _static(place, inside, value)
        else:
            values[name] = _number(place, inside, value)
    for name, field in known.items():
        required = field.default is MISSING and field.default_factory is MISSING
        if required and name not in values:
            raise InputError(f"{place}: {where}.{name} is missing; add it.")
    try:
        return kind(**values)
    except (TypeError, ValueError) as error:
        raise InputError(f"{place}: {error}") from error


def _chosen_record(place: str, where: str, annotation: Any, table: Mapping[str, Any]) -> Any:
    """The record of a field: the only kind possible, or the one that the key `kind` names."""
    kinds = {kind.__name__: kind for kind in _records(annotation)}
    if not kinds:
        raise InputError(f"{place}: {where} is a number, not a table; write {where} = ....")
    rest = dict(table)
    name = rest.pop("kind", next(iter(kinds)) if len(kinds) == 1 else None)
    if name is None:
        raise InputError(f"{place}: {where}.kind is missing; use one of {', '.join(kinds)}.")
    if not isinstance(name, str) or name not in kinds:
        hint = nearest(str(name), kinds)
        raise InputError(f"{place}: {where}.kind = {name!r} is unknown; {hint}.")
    return record_of(place, where, kinds[name], rest)


def _records(annotation: Any) -> tuple[type, ...]:
    """The records in an annotation, which may be a union."""
    return tuple(
        kind
        for kind in members_of(annotation)
        if isinstance(kind, type) and issubclass(kind, eqx.Module)
    )


def _holds_records_only(annotation: Any) -> bool:
    """Whether a field, apart from None, holds nothing but records."""
    return all(part is type(None) or _records(part) for part in members_of(annotation))


def _number(place: str, where: str, value: Any) -> Any:
    array = np.asarray(value, dtype=None if not isinstance(value, list) else object)
    numbers = array.ravel().tolist()
    if any(isinstance(x, bool) or not isinstance(x, int | float) for x in numbers):
        raise InputError(f"{place}: {where} = {value!r} must be a number or numbers; correct it.")
    try:
        return np.reshape([float(x) for x in numbers], array.shape)
    except OverflowError as error:
        raise InputError(f"{place}: {where} is out of the range of numbers; correct it.") from error


def _static(place: str, where: str, value: Any) -> Any:
    """A static value as its record has it: lists become tuples, and "RGGB" its pattern."""
    if where.endswith(".pattern") and isinstance(value, str):
        try:
            return bayer(value)
        except ValueError as error:
            raise InputError(f"{place}: {where}: {error}") from error
    if isinstance(value, list):
        return tuple(_static(place, where, part) for part in value)
    return value


def check_keys(place: str, where: str, table: Mapping[str, Any], known: Any) -> None:
    """Refuses keys that a table does not have.

    Args:
        place: the file, for messages.
        where: the table in it.
        table: what was read.
        known: the names of all keys.

    Raises:
        InputError: with the nearest known one.
    """
    for key in table:
        if key not in known:
            name = f"{where}.{key}".lstrip(".")
            hint = nearest(key, known)
            raise InputError(f"{place}: {name} is not a key here; {hint}.")
