"""Convert and check the arguments of public functions. Plain numbers and lists become arrays. If a
function takes one point, an array of several points raises `ValueError`. A direction must be a unit
vector.

Only concrete values are checked, not values that `jax.jit` or another transform traces. NaN is
accepted.
"""

from collections.abc import Callable, Collection, Iterable
from functools import cache, wraps
from inspect import Parameter, signature
from sys import maxsize
from types import UnionType
from typing import Any, NamedTuple, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from ..errors import nearest
from ._types import (
    Key,
    Range,
    axes_of,
    check_given,
    check_key,
    check_range,
    check_shape,
    is_any_axes,
    is_known,
    is_record,
    members_of,
    require_metres,
    shorten,
)
from ._warnings import one_call, warn_caller
from .plain_arrays import plain_array, warn_of_range, within_integers

P = ParamSpec("P")
R = TypeVar("R")

UNIT_WITHIN = 1e-3  # tolerance of a unit length, for components written with three digits
PLAIN = (bool, int, float, list, tuple, str)


class _Wanted(NamedTuple):
    """The requirements on one array argument of a function."""

    # the allowed shapes, in which a word stands for any length, and a leading `...` for any axes
    shapes: tuple[tuple[int | str, ...], ...]
    # Whether to check the shape here; functions that take pictures check their own shapes
    is_exact: bool
    is_picture: bool  # whether it has rows and columns
    may_be_absent: bool  # whether None is allowed
    is_direction: bool  # whether its length must be 1, or 0 where there is no surface
    is_wavelength: bool  # whether it is a wavelength of light in metres
    keeps_integers: bool  # whether integers stay integers, because they may be codes
    # Whether a Python number is not converted, because the dtype may not represent it
    keeps_numbers: bool


def takes_numbers(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function of arrays so that it also accepts numbers, lists and NumPy arrays. Such
    arguments are converted to the floating dtype of the other arguments. The decorated function
    raises `ValueError` for wrong shapes, directions and random keys. The decorated function raises
    `TypeError` for unknown argument names, and for optional arguments that are given by position.
    """

    @wraps(function)
    def converting(*args: P.args, **kwargs: P.kwargs) -> R:
        wanted, keys, records, placed = _read_annotations(function)
        if len(args) > placed:
            raise _unnamed_error(function, placed, args)
        if not kwargs.keys() <= wanted.keys():
            raise _unknown_error(function, kwargs, wanted)
        values = dict(zip(wanted, args, strict=False)) | kwargs
        arrays = {n: w for n, w in wanted.items() if w is not None and n in values}
        given = values
        values = {n: plain_array(_place(function, n), value) for n, value in values.items()}
        values |= {n: within_integers(values[n]) for n in arrays}
        plain = [n for n, want in arrays.items() if _is_plain(values[n], want)]
        if plain:
            dtype = _common_dtype(values)
            for name in plain:
                values[name] = _as_array(function, name, values[name], arrays[name], dtype)
        if any(values[name] is not given[name] for name in values):
            args = tuple(values.get(n, x) for n, x in zip(wanted, args, strict=False))  # type: ignore[assignment]
            kwargs = {name: values[name] for name in kwargs}  # type: ignore[assignment]
        for name, want in arrays.items():
            value = values[name]
            if isinstance(value, jax.Array | np.ndarray):
                _check(function, name, value, want)
            numeric = isinstance(value, int | float | eqx.Module) or hasattr(value, "dtype")
            if not numeric and (value is not None or not want.may_be_absent):
                raise _no_numbers(function, name, value)
        for name, absent in keys.items():
            if name in values:
                check_key(_place(function, name), values[name], several=False, absent=absent)
        for name, (kinds, absent) in records.items():
            if name in values and not (values[name] is None and absent):
                check_given(_place(function, name), values[name], *kinds)
        with one_call():
            for name in arrays:
                warn_of_range(_place(function, name), given[name])
            return function(*args, **kwargs)

    return converting


def warn_of_idle_fill(fill: Any, border: str) -> None:
    """Warn if a fill value other than 0 is given with a border mode that does not use it."""
    if border != "constant" and is_known(fill) and np.any(np.asarray(fill) != 0):
        warn_caller(f'fill has no effect with border "{border}"; set border = "constant".')


def takes_range(**ranges: Range) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function so that it raises `ValueError` for a concrete argument outside its
    allowed range. Apply this decorator before `takes_numbers`, on the line below."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        names = list(signature(function).parameters)

        @wraps(function)
        def checking(*args: P.args, **kwargs: P.kwargs) -> R:
            values = dict(zip(names, args, strict=False)) | kwargs
            for name, allowed in ranges.items():
                check_range(_place(function, name), values.get(name), **allowed._asdict())
            return function(*args, **kwargs)

        return checking

    return decorate


def _is_plain(value: Any, want: _Wanted) -> bool:
    """Return whether an argument must be converted to a floating-point array. Unsigned integers may
    be image codes, which image and colour functions convert themselves."""
    if isinstance(value, int | float) and want.keeps_numbers:
        return False
    if isinstance(value, PLAIN) or want.keeps_integers:
        return isinstance(value, PLAIN)
    no_codes = want.is_exact and not any("rows" in shape for shape in want.shapes)
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.kind != "u" or no_codes
    return isinstance(value, jax.Array) and value.dtype.kind in ("ibu" if no_codes else "ib")


class _Expected(NamedTuple):
    """The requirements on all parameters of one function."""

    # requirements on each parameter, in order; None if it takes no array of numbers
    contents: dict[str, _Wanted | None]
    keys: dict[str, bool]  # the parameters that are random keys, and whether they may be None
    # The types of the parameters that are records, and whether these may be None
    records: dict[str, tuple[tuple[type, ...], bool]]
    positional: int  # number of arguments that may be given by position


@cache
def _read_annotations(function: Callable[..., Any]) -> _Expected:
    hints, parameters = get_type_hints(function), signature(function).parameters
    contents = {name: _wanted_by_hint(name, hints.get(name)) for name in parameters}
    parts = {name: _parts(hints.get(name)) for name in parameters}
    keys = {name: type(None) in part for name, part in parts.items() if Key in part}
    records = {}
    for name in parameters:
        members = members_of(hints.get(name))
        kinds = tuple(kind for kind in members if kind is not type(None))
        if kinds and all(map(is_record, kinds)):
            records[name] = kinds, type(None) in members
    ways = [parameter.kind for parameter in parameters.values()]
    by_place = sum(way is not Parameter.KEYWORD_ONLY for way in ways)
    positional = maxsize if Parameter.VAR_POSITIONAL in ways else by_place
    return _Expected(contents, keys, records, positional)


def _parts(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the hint itself, without resolving aliases."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _wanted_by_hint(name: str, hint: Any) -> _Wanted | None:
    parts = [kind for part in _parts(hint) for kind in _kinds(part)]
    numbers = {float, int} & set(parts)
    others = {np.ndarray, *numbers}
    arrays = [part for part in parts if part not in others and not is_record(part)]
    if not arrays or not all(hasattr(part, "dim_str") for part in arrays):
        return None
    if not all(_dtypes(part) in (_dtypes(Float), _dtypes(Shaped)) for part in arrays):
        return None
    floating = all(_dtypes(part) == _dtypes(Float) for part in arrays)
    shapes = tuple(axes_of(part) for part in arrays)
    is_picture = any("h" in shape for shape in shapes)
    many = any(is_any_axes(axis) for shape in shapes for axis in shape)
    is_vector = any(is_record(part) for part in parts)
    return _Wanted(
        shapes,
        is_picture=is_picture,
        is_exact=is_vector or not (many or is_picture),
        may_be_absent=type(None) in get_args(hint),
        is_direction=getattr(hint, "__name__", "") in ("Direction", "Directions"),
        is_wavelength=name == "wavelength",
        keeps_integers=not floating or is_picture,
        keeps_numbers=bool(numbers),
    )


def _kinds(part: Any) -> tuple[Any, ...]:
    return () if part is type(None) else getattr(part, "kinds", ()) or (part,)


def _dtypes(part: Any) -> Any:
    return part.dtypes


def _common_dtype(values: dict[str, Any]) -> Any:
    """Return the widest dtype of the floating arrays among the arguments, including arrays in
    records; JAX's default floating dtype if no argument is a floating array."""
    leaves = [x for x in jax.tree.leaves(list(values.values())) if isinstance(x, jax.Array)]
    floating = [x.dtype for x in leaves if jnp.issubdtype(x.dtype, jnp.floating)]
    return max(floating, key=lambda dtype: dtype.itemsize, default=jnp.result_type(float))


def _as_array(
    function: Callable[..., Any], name: str, value: Any, want: _Wanted, dtype: Any
) -> Array:
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError) as error:
        raise _no_numbers(function, name, value) from error
    if array.dtype.kind == "c" and isinstance(value, PLAIN):
        raise ValueError(f"{_place(function, name)} must be real, got {shorten(value)}.")
    given = isinstance(value, np.ndarray | np.generic) and array.dtype.kind in "fc"
    whole = array.dtype.kind != "f" and want.keeps_integers
    return array if given or whole else array.astype(dtype)


def check_unit(name: str, vectors: Array | np.ndarray) -> None:
    """Raise `ValueError` if a concrete vector, (..., 3), has a length other than 1 or 0."""
    lengths = np.linalg.norm(np.asarray(vectors, np.float64), axis=-1)
    rounding = 4 * float(jnp.finfo(vectors.dtype).eps)
    wrong = (lengths != 0) & (np.abs(lengths - 1) > max(UNIT_WITHIN, rounding))
    if wrong.any():
        raise ValueError(
            f"{name} must be a unit vector, got one of length {lengths[wrong].flat[0]:.6g}; "
            "divide it by its length (jaxvision.normalize)."
        )


def _check(
    function: Callable[..., Any], name: str, value: Array | np.ndarray, want: _Wanted
) -> None:
    if value.dtype.kind == "c" and want.is_exact:
        raise ValueError(f"{_place(function, name)} must be real, got {value.dtype}.")
    fixed = [sum(not is_any_axes(axis) for axis in shape) for shape in want.shapes]
    if want.is_exact or (value.ndim < min(fixed) and not want.is_picture):
        several = fixed == [*map(len, want.shapes)] and value.ndim > max(fixed)
        advice = "; for many at once take jax.vmap of the function" if several else ""
        check_shape(_place(function, name), value, *want.shapes, advice=advice)
    if want.is_direction and is_known(value):
        check_unit(_place(function, name), value)
    if want.is_wavelength and is_known(value):
        require_metres(_place(function, name), np.asarray(value))


def _no_numbers(function: Callable[..., Any], name: str, value: Any) -> ValueError:
    return ValueError(f"{_place(function, name)} must be numbers, got {shorten(value)}.")


def _unnamed_error(function: Callable[..., Any], placed: int, args: tuple[Any, ...]) -> TypeError:
    """Return the error for too many positional arguments."""
    by_name = list(signature(function).parameters)[placed:]
    extra = zip(by_name, args[placed:], strict=False)
    given = ", ".join(f"{name}={shorten(value)}" for name, value in extra)
    who = getattr(function, "__name__", "function")
    advice = f"write {given}" if given else "leave out the others"
    return TypeError(f"{who} takes {placed} of its arguments by their place; {advice}.")


def _unknown_error(
    function: Callable[..., Any], given: Iterable[str], known: Collection[str]
) -> TypeError:
    """Return the error for an unknown argument name."""
    word = next(name for name in given if name not in known)
    who = getattr(function, "__name__", "function")
    return TypeError(f"{who} has no argument {word!r}; {nearest(word, known)}.")


def _place(function: Callable[..., Any], name: str) -> str:
    return f"{getattr(function, '__name__', 'function')}: {name}"
