"""Read and write records as TOML files, with one table for each record and the record's fields as
keys.

Numbers are written with all digits, so that a record is read back with exactly the same numbers.
Posterior draws of a fitted record are stored in a `.npz` file next to the TOML file. The `.npz`
file has an array for each number that differs between draws, with the draws along the leading axis.
The name of the array is the path of the number, such as `.sensor.gain`.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields
from functools import cache
from inspect import signature
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core._shown import meanings
from ..core._types import (
    Colour,
    Range,
    axes_of,
    check_range,
    check_shape,
    is_record,
    members_of,
    shorten,
)
from ..errors import InputError, nearest
from ..scene import Map
from ..sensor.colour_filters import bayer
from .images import read_arrays, replaced_on_success

Record = TypeVar("Record", bound=eqx.Module)


def write_record(
    file: str | os.PathLike[str],
    what: str,
    tables: Mapping[str, Any],
    record: Record,
    draws: Record | None,
) -> None:
    """Write a record as a TOML file, and its draws, if any, in a second file. An error leaves no
    partial file.

    Args:
        file: path of the file, ending in .toml; missing folders are created.
        what: name of the kind of record for messages, such as `camera`.
        tables: the tables to write, from `table_of`.
        record: the record whose shapes the draws must match.
        draws: the same record with a leading axis of draws at every number; None writes none.

    Raises:
        InputError: for a file name with another ending, draws of another record, or draws without a
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
    """Return a record as a table with `kind` and the fields that are not None, for `record_of`."""
    table: dict[str, Any] = {"kind": type(record).__name__}
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, eqx.Module):
            table[field.name] = table_of(value)
        elif isinstance(value, tuple) and any(isinstance(one, eqx.Module) for one in value):
            table[field.name] = [table_of(one) for one in value]
        elif eqx.is_array(value):
            table[field.name] = np.asarray(value).tolist()
        elif value is not None:
            table[field.name] = value
    return table


def count_draws(file: Path) -> int:
    """Return the number of draws that are stored with the file of a record; 0 if there are none."""
    beside = _draws_file(file)
    if not beside.is_file():
        return 0
    return min((len(values) for values in read_arrays(beside).values() if values.ndim), default=0)


def attach_draws(file: Path, record: Record, count: int) -> Record:
    """Return a record with a leading axis of `count` draws, evenly spaced among the draws stored
    next to the record's file. Raise `InputError` if there are no draws or too few, or if the draws
    belong to another record."""
    beside = _draws_file(file)
    if not beside.is_file():
        raise InputError(f"{beside}: no draws lie beside {file.name}; save a fit with its draws.")
    try:
        stored = read_arrays(beside)
        (there,) = {len(values) if values.ndim else 0 for values in stored.values()}
    except ValueError as error:  # several lengths, or no array
        raise InputError(f"{beside}: not a file of draws; save the fit again.") from error
    if not 1 <= count <= there:
        raise InputError(f"{beside}: {count} draws were asked for, {there} are there.")
    rows = np.linspace(0, there - 1, count).astype(int)

    def draw_leaf(path: Any, leaf: Any) -> Any:
        values = stored.pop(jax.tree_util.keystr(path), None)
        if values is None:
            return jnp.broadcast_to(leaf, (count, *np.shape(leaf)))
        if values.shape[1:] != np.shape(leaf):
            raise InputError(f"{beside}: its draws do not fit {file.name}: save the fit again.")
        return jnp.asarray(values[rows], jnp.asarray(leaf).dtype)

    found = jax.tree.map_with_path(draw_leaf, record)
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
    with replaced_on_success(_draws_file(file)) as partial, partial.open("wb") as stream:
        np.savez(stream, **differing)  # type: ignore[arg-type]


def _draws_file(file: Path) -> Path:
    return file.with_suffix(".npz")


class Key(NamedTuple):
    """A key of a table: the type of its value, its default (MISSING if it must be given), and its
    description from a docstring."""

    hint: Any
    default: Any
    about: str


class Reading(NamedTuple):
    """The settings with which the tables of one file are read."""

    place: str  # name of the file, for messages
    kind: str  # name of the kind of record ("camera"), for messages
    # whether every number must be finite; otherwise the record of the number decides
    finite: bool = False
    # function that reads values of further types. `typed(hint, where, value)` returns the value, or
    # NotImplemented for an unknown type.
    typed: Callable[[Any, str, Any], Any] = lambda *_: NotImplemented

    def wrong(self, what: str) -> InputError:
        """Return the error for a value of the file."""
        return InputError(f"{self.place}: {what}")

    @contextmanager
    def placed(self, where: str = "") -> Iterator[None]:
        """Add the names of the file and key to errors in a `with` block that lack them."""
        try:
            yield
        except (TypeError, ValueError) as error:
            if str(error).startswith(f"{self.place}: "):
                raise
            raise self.wrong(f"{where}: {error}" if where else str(error)) from error


@cache
def keys_of(make: Callable[..., Any], *, record: type | None = None) -> dict[str, Key]:
    """Return the keys of a record's table, by name. The keys are the record's fields, or the
    keyword arguments of the function that makes the record. If that function takes `**fields`, the
    keys include the fields of `record`. A key that the function does not describe has the
    description of the field."""
    docs = (meanings(record) if record else {}) | meanings(make)
    if isinstance(make, type):
        hints = get_type_hints(make, include_extras=True)
        spectra = (*getattr(make, "spectra", ()), *getattr(make, "neutral_spectra", ()))
        return {
            f.name: Key(
                Colour if f.name in spectra and hints[f.name] is jax.Array else hints[f.name],
                f.default if f.default_factory is MISSING else None,
                docs.get(f.name, ""),
            )
            for f in fields(make)
        }
    hints, own, rest = get_type_hints(make, include_extras=True), {}, {}
    for name, parameter in signature(make).parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD and record is not None:
            rest = keys_of(record)
        elif parameter.kind is parameter.KEYWORD_ONLY:
            default = MISSING if parameter.default is parameter.empty else parameter.default
            own[name] = Key(hints[name], default, docs.get(name, ""))
    return {name: key for name, key in {**rest, **own}.items() if key.hint is not NoneType}


def record_of(
    reading: Reading, where: str, make: Callable[..., Any], table: Mapping[str, Any]
) -> Any:
    """Make a record, by its class or function, from the table at the key `where`."""
    values = values_of(reading, where, keys_of(make), table)
    with reading.placed(where):
        return make(**values)


def values_of(
    reading: Reading, where: str, keys: Mapping[str, Key], table: Mapping[str, Any]
) -> dict[str, Any]:
    """Convert the values of a table to the types of their keys."""
    check_keys(reading, where, table, keys)
    for name, key in keys.items():
        if key.default is MISSING and name not in table:
            raise reading.wrong(f"{where}.{name} is missing; add it.".lstrip("."))
    return {
        name: value_of(reading, f"{where}.{name}".lstrip("."), keys[name].hint, value)
        for name, value in table.items()
    }


def value_of(reading: Reading, where: str, hint: Any, value: Any) -> Any:
    """Convert the value at `where` to its type: lists to tuples, numbers to arrays."""
    kinds = tuple(kind for kind in members_of(hint) if kind is not NoneType)
    for kind in kinds:
        with reading.placed(where):
            found = reading.typed(kind, where, value)
        if found is not NotImplemented:
            return found
    if isinstance(value, Mapping) and value.get("kind") == Map.__name__:
        return record_of(reading, where, Map, {k: v for k, v in value.items() if k != "kind"})
    if isinstance(value, Mapping):
        return _make_record(reading, where, kinds, value)
    if all(map(is_record, kinds)):
        known = " or ".join(kind.__name__ for kind in kinds)
        raise reading.wrong(
            f"{where} must be the table of a {known}, got {value!r}; head it [{where}]."
        )
    words = [word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
    if words:
        return chosen(reading, where, value, words)
    for plain, noun in _PLAIN.items():
        if plain in [getattr(kind, "__origin__", kind) for kind in kinds]:
            if type(value) is not plain:
                raise _wrong(reading, where, value, f"must be {noun}")
            if plain is int:
                with reading.placed():
                    _check_ranges(where, value, kinds)
            return value
    if any(get_origin(kind) is tuple for kind in kinds):
        return _tuple(reading, where, kinds, value)
    return _number(reading, where, kinds, value)


_PLAIN = {bool: "true or false", str: "text", int: "a whole number"}


def chosen(reading: Reading, where: str, value: Any, words: Iterable[str]) -> str:
    """Return the word at `where`; for an unknown one, suggest the nearest."""
    if not isinstance(value, str) or value not in words:
        hint = nearest(str(value), words)
        raise reading.wrong(f"{where} = {shorten(value)} is unknown; {hint}.")
    return value


def _wrong(reading: Reading, where: str, value: Any, what: str) -> InputError:
    return reading.wrong(f"{where} = {shorten(value)}: {what}; correct it.")


def _make_record(
    reading: Reading, where: str, hints: tuple[Any, ...], table: Mapping[str, Any]
) -> Any:
    """Make the record of a field. The key `kind` names its type if several are possible."""
    kinds = {k.__name__: k for kind in hints if is_record(kind) for k in _kinds_of(kind)}
    if not kinds:
        what = "no table" if {bool, str} & {*hints} else "a number, not a table"
        raise reading.wrong(f"{where} is {what}; write {where} = ....")
    rest = dict(table)
    name = rest.pop("kind", next(iter(kinds)) if len(kinds) == 1 else None)
    if name is None:
        raise reading.wrong(f"{where}.kind is missing; use one of {', '.join(kinds)}.")
    return record_of(reading, where, kinds[chosen(reading, f"{where}.kind", name, kinds)], rest)


def _kinds_of(base: type) -> list[type]:
    """List the record types that a field of a base class accepts, including registered ones."""
    own = [kind for below in base.__subclasses__() for kind in _kinds_of(below)]
    return own or [base]


def _tuple(reading: Reading, where: str, hints: tuple[Any, ...], value: Any) -> Any:
    """Convert a list to a tuple, and the name of a Bayer phase, such as "RGGB", to its pattern."""
    if where.endswith(".pattern") and isinstance(value, str):
        with reading.placed(where):
            return bayer(value)
    parts = get_args(next(hint for hint in hints if get_origin(hint) is tuple))
    if not isinstance(value, list | tuple):
        raise _wrong(reading, where, value, "must be a list")
    if parts[-1] is not Ellipsis and len(value) != len(parts):
        end = "least" if len(value) < len(parts) else "most"
        raise reading.wrong(f"{where} lists {len(value)}; give at {end} {len(parts)}.")
    each = parts if parts[-1] is not Ellipsis else parts[:1] * len(value)
    return tuple(
        value_of(reading, f"{where}[{i}]", kind, one)
        for i, (kind, one) in enumerate(zip(each, value, strict=True), 1)
    )


def _number(reading: Reading, where: str, hints: tuple[Any, ...], value: Any) -> Any:
    """Convert a number or nested lists to an array in the range of the annotation."""
    array = np.asarray(value, dtype=None if not isinstance(value, list) else object)

    def place(number: int) -> str:
        return where + "".join(f"[{i + 1}]" for i in np.unravel_index(number, array.shape))

    numbers = array.ravel().tolist()
    for i, x in enumerate(numbers):
        if isinstance(x, bool) or not isinstance(x, int | float):
            lists = [hint for hint in hints if getattr(hint, "dim_str", "").strip()]
            noun = "numbers" if not array.shape and len(lists) == len(hints) else "a number"
            raise reading.wrong(f"{place(i)} = {shorten(x)} must be {noun}; correct it.")
    try:
        values = np.reshape([float(x) for x in numbers], array.shape)
    except OverflowError as error:
        raise reading.wrong(f"{where} is out of the range of numbers; correct it.") from error
    if reading.finite and not np.isfinite(values).all():
        i = int(np.argmin(np.isfinite(values.ravel())))
        raise _wrong(reading, place(i), numbers[i], "must be a finite number")
    try:
        _check_ranges(where, values, hints)
    except ValueError:
        for i, x in enumerate(values.ravel()):
            with reading.placed():
                _check_ranges(place(i), x, hints)
    plain = [getattr(hint, "__origin__", hint) for hint in hints]
    shapes = [axes_of(hint) for hint in plain if hasattr(hint, "dim_str")]
    shapes += [()] * (float in plain)
    if shapes:
        with reading.placed():
            check_shape(where, values, *shapes)
    return values


def _check_ranges(where: str, numbers: Any, hints: tuple[Any, ...]) -> None:
    """Raise `ValueError` unless the numbers lie in the range that the annotation states."""
    stated = [x for hint in hints for x in getattr(hint, "__metadata__", ())]
    for allowed in [x for x in stated if isinstance(x, Range)][:1]:
        check_range(where, numbers, **allowed._asdict())


def check_keys(reading: Reading, where: str, table: Mapping[str, Any], known: Any) -> None:
    """Refuse an unknown key in the table at `where`, and suggest the nearest."""
    for key in table:
        if key not in known:
            name, hint = f"{where}.{key}".lstrip("."), nearest(key, known)
            raise reading.wrong(f"{name} is not a key of a {reading.kind} file; {hint}.")
