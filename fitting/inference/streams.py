"""Read data larger than memory in chunks: the rows of an array, of a memory-mapped file, or from a
generator function. Every pass over the data reads them again and divides them into chunks of one
shape.

The last chunk is padded with copies of its last row, which count as missing, so that one compiled
program serves all chunks. A sample of the size of one chunk, drawn evenly from all rows, represents
the data where an approximation is enough: at the beginning of a search, and in figures.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxvision.core.plain_arrays import plain_array, widen_short
from jaxvision.errors import InputError

from .given import plain_numbers, require_whole
from .likelihoods import Clustered, check_data
from .on_host import require_here

Advance = Callable[[int, int], None]  # called with chunks read and chunks in all
SEED = 0  # seed of the sample


@dataclass(frozen=True)
class Rows:
    """Some rows of the data, with their inputs and likelihood fields."""

    data: np.ndarray  # (rows, ...) the data of the rows
    # the arrays of inputs and likelihood with one row per row of data, each (rows, ...)
    own: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Stream:
    """The source of a problem's data, which are read in chunks.

    All streams compare equal, so that problems with different streams share a compiled program. No
    compiled program reads from a stream."""

    data: Any = field(repr=False)  # (rows, ...) array, or a function that yields blocks of rows
    inputs: Any = field(repr=False)  # as the user passed them
    likelihood: Any = field(repr=False)  # as the user passed it
    # inputs and likelihood. If a function yields the inputs, those of its first piece.
    beside: tuple[Any, Any] = field(repr=False)
    # for each array of `beside`, whether it has one row per row of data; other arrays are the same
    # for all rows
    by_row: tuple[bool, ...]
    size: int  # number of rows of a chunk
    count: int = 0  # number of all rows, known after the first pass
    # checksum of all numbers that a function yields, independent of their order; None for an array
    mark: int | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Stream)

    def __hash__(self) -> int:
        return hash(Stream)


def open_stream(
    data: Any, inputs: Any, likelihood: Any, size: int
) -> tuple[Stream, np.ndarray, Any, Any]:
    """Read all data once to count, check and sample them. Return the stream, and a sample of `size`
    rows in their order (NaN in rows that are missing) with their inputs and their likelihood.
    """
    if isinstance(likelihood, Clustered):
        raise InputError(
            "Clustered: errors that groups share are estimated with all data in memory; leave "
            "chunk out."
        )
    require_whole("chunk", size, of="rows to be read at a time")
    if hasattr(data, "__next__"):
        raise InputError(
            "data: an iterator ends after one reading, and a fit reads its data many times: give "
            "the function that makes it."
        )
    if not callable(data):
        data = plain_numbers("data", data)
    for name, values in (("data", data), ("inputs", inputs), ("likelihood", likelihood)):
        require_here(name, values)
    source: Iterator[Any] | None = None
    first = data
    if callable(data):  # a function that counts its calls is called once for one reading
        pieces: Iterator[Any] = iter(cast(Iterable[Any], data()))
        first = next(pieces, None)
        source = iter(()) if first is None else chain([first], pieces)
    beside, by_row = _row_leaves(first, inputs, likelihood, yielded=source is not None)
    stream = Stream(data, inputs, likelihood, beside, by_row, size)
    rng = np.random.default_rng(SEED)
    count, mark, kept, keys = 0, None if source is None else 0, None, np.empty(0)
    for piece in _pieces(stream, source):
        _check(piece, kept)
        check_data(likelihood, piece.data)
        count += len(piece.data)
        mark = None if mark is None else _update_checksum(mark, piece)
        own = rng.random(len(piece.data))
        chosen = own < (keys.max() if len(keys) == size else 1)
        some = _take_rows(piece, np.flatnonzero(chosen))
        kept, keys = _add(kept, some), np.concatenate([keys, own[chosen]])
        if len(keys) > size:
            lowest = np.sort(np.argpartition(keys, size)[:size])
            kept, keys = _take_rows(kept, lowest), keys[lowest]
    if kept is None or not count:
        raise InputError("data: there are none to read.")
    filled, there = _pad(kept, size)
    blank = there.reshape(-1, *[1] * (filled.data.ndim - 1))
    sample = np.where(blank, filled.data, np.nan)
    return (
        replace(stream, count=count, mark=mark),
        sample,
        *_insert_rows(stream, stream.beside, filled),
    )


def chunks(problem: Any, *, advance: Advance | None = None) -> Iterator[Any]:
    """Yield the problem with each chunk of its data in turn, all of one shape."""
    stream = problem.stream
    if stream is None:
        yield problem
        return
    done, whole, mark = 0, -(-stream.count // stream.size), 0
    for rows, there in _chunks(stream):
        if stream.mark is not None:
            mark = _update_checksum(mark, rows if there.all() else _take_rows(rows, there))
        known = there.reshape(-1, *[1] * (rows.data.ndim - 1)) & ~np.isnan(rows.data)
        beside = jax.tree.map(
            lambda x: jnp.asarray(x, jnp.result_type(float)) if eqx.is_inexact_array_like(x) else x,
            _insert_rows(stream, (problem.inputs, problem.likelihood), rows),
        )
        yield eqx.tree_at(
            lambda p: (p.data, p.present, p.inputs, p.likelihood),
            problem,
            (jnp.asarray(np.where(known, rows.data, 0)), jnp.asarray(known), *beside),
            is_leaf=lambda x: x is None,
        )
        done += int(there.sum())
        if advance is not None:
            advance(-(-done // stream.size), whole)
    if done != stream.count:
        raise InputError(
            f"data: {done} rows were read, and {stream.count} at first: the function must yield "
            "the same data each time."
        )
    if stream.mark is not None and mark != stream.mark:
        raise InputError(
            f"data: {done} rows were read as at first, but with other numbers: the function must "
            "yield the same data each time."
        )


def _row_leaves(
    first: Any, inputs: Any, likelihood: Any, *, yielded: bool
) -> tuple[tuple[Any, Any], tuple[bool, ...]]:
    """Return the inputs and the likelihood, and for each of their arrays whether it has one row for
    each row of data. If a function yields the inputs with the data, the inputs of the first piece
    are returned.
    """
    if not yielded:
        beside, known = (inputs, likelihood), len(first)
        return beside, tuple(_holds_rows(leaf, known) for leaf in jax.tree.leaves(beside))
    if not isinstance(first, tuple):
        return (inputs, likelihood), (False,) * len(jax.tree.leaves((inputs, likelihood)))
    rows, its_inputs = first
    count = np.shape(rows)[0] if np.ndim(rows) else 0
    own = [_holds_rows(leaf, count) for leaf in jax.tree.leaves(its_inputs)]
    return (its_inputs, likelihood), (*own, *[False] * len(jax.tree.leaves(likelihood)))


def _pieces(stream: Stream, source: Iterable[Any] | None = None) -> Iterator[Rows]:
    """Yield the pieces of the data in order. A pass that has begun is continued; otherwise a new
    pass begins."""
    data, dtype = stream.data, jnp.result_type(float)
    if not callable(data):
        own = _rowwise_arrays(stream, stream.beside)
        for begin in range(0, len(data), stream.size):
            part = slice(begin, begin + stream.size)
            beside = tuple(
                widen_short(plain_array("inputs", np.asarray(leaf[part]))) for leaf in own
            )
            yield Rows(np.asarray(data[part], dtype), beside)
        return
    for piece in cast(Iterable[Any], data()) if source is None else source:
        rows, inputs = piece if isinstance(piece, tuple) else (piece, stream.beside[0])
        rows = np.asarray(plain_numbers("data", rows), dtype)
        beside = inputs, stream.likelihood
        _check_inputs(stream, beside, len(rows) if rows.ndim else 0)
        own = (
            widen_short(plain_array("inputs", np.asarray(leaf)))
            for leaf in _rowwise_arrays(stream, beside)
        )
        yield Rows(rows, tuple(own))


def _update_checksum(mark: int, rows: Rows) -> int:
    """Add some rows to a checksum, which is the sum of the bits of all numbers modulo 2^64."""
    for leaf in (rows.data, *rows.own):
        bits = np.ascontiguousarray(leaf).view(f"u{min(leaf.itemsize, 8)}")
        mark += int(bits.sum(dtype=np.uint64))
    return mark % 2**64


def _check_inputs(stream: Stream, beside: tuple[Any, Any], count: int) -> None:
    """Refuse inputs whose structure differs from the first piece that the function yielded."""
    alike = jax.tree.structure(beside) == jax.tree.structure(stream.beside)
    if alike:
        pairs = zip(jax.tree.leaves(beside), jax.tree.leaves(stream.beside), strict=True)
        alike = all(
            _holds_rows(leaf, count) if own else leaf is first or np.array_equal(leaf, first)
            for (leaf, first), own in zip(pairs, stream.by_row, strict=True)
        )
    if not alike:
        raise InputError(
            "inputs: each chunk must come with input arrays of as many rows as its data, the same "
            "ones in every chunk, and with all other inputs unchanged."
        )


def _chunks(stream: Stream) -> Iterator[tuple[Rows, np.ndarray]]:
    """Yield chunks of equal length, each with a mask that is false for padding."""
    rest = None
    every = np.ones(stream.size, bool)
    for piece in _pieces(stream):
        rows = _add(rest, piece)
        begin = 0
        while len(rows.data) - begin >= stream.size:
            yield _take_rows(rows, slice(begin, begin + stream.size)), every
            begin += stream.size
        rest = _take_rows(rows, slice(begin, None)) if begin < len(rows.data) else None
    if rest is not None:
        yield _pad(rest, stream.size)


def _check(piece: Rows, first: Rows | None) -> None:
    if not piece.data.ndim:
        raise InputError("data: a single number cannot be cut into chunks.")
    if first is not None and piece.data.shape[1:] != first.data.shape[1:]:
        raise InputError(
            f"data: a row has the shape {piece.data.shape[1:]}, and {first.data.shape[1:]} before."
        )
    if np.isinf(piece.data).any():
        raise InputError("Some of the data are infinite: mark missing ones by NaN.")


def _rowwise_arrays(stream: Stream, beside: tuple[Any, Any]) -> tuple[Any, ...]:
    """Return the arrays of inputs and likelihood that have one row for each row of data."""
    leaves = jax.tree.leaves(beside)
    return tuple(leaf for leaf, own in zip(leaves, stream.by_row, strict=True) if own)


def _insert_rows(stream: Stream, beside: tuple[Any, Any], rows: Rows) -> tuple[Any, Any]:
    """Return inputs and likelihood with the arrays that belong to these rows."""
    leaves, form = jax.tree.flatten(beside)
    own = iter(rows.own)
    return jax.tree.unflatten(
        form,
        [next(own) if mine else leaf for leaf, mine in zip(leaves, stream.by_row, strict=True)],
    )


def _take_rows(rows: Rows, index: Any) -> Rows:
    return Rows(rows.data[index], tuple(leaf[index] for leaf in rows.own))


def _add(first: Rows | None, second: Rows) -> Rows:
    if first is None:
        return second
    return Rows(
        np.concatenate([first.data, second.data]),
        tuple(np.concatenate(pair) for pair in zip(first.own, second.own, strict=True)),
    )


def _pad(rows: Rows, size: int) -> tuple[Rows, np.ndarray]:
    """Pad rows to a size, with a mask that is false for padding."""
    place = np.arange(size)
    return _take_rows(rows, np.minimum(place, len(rows.data) - 1)), place < len(rows.data)


def _holds_rows(leaf: Any, count: int) -> bool:
    return np.ndim(leaf) > 0 and np.shape(leaf)[0] == count
