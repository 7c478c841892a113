"""Aliases of array types, conversions that keep a dtype, and checks of values. This module contains
no computations.

In the names of axes, `...` stands for any batch axes, `bands` for spectral bands (RGB has three),
`h w` for rows and columns of an image, and `3` for a Cartesian vector. `Colour` and `Scalar` are
values of one point, ray or pixel; the caller applies a function to many points, rays or pixels with
`jax.vmap`.
"""

import sys
from collections.abc import Collection
from dataclasses import Field, fields
from functools import cache
from types import UnionType
from typing import Any, NamedTuple, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.core import Tracer
from jaxtyping import Array, Float, PRNGKeyArray, Shaped

from ..errors import InputError, shorten
from ._warnings import warn_caller
from .plain_arrays import plain_array, warn_of_range, within_integers


class _OneOf(type):
    """The metaclass of a type alias that stands for a union of types."""

    kinds: tuple[type, ...]

    def __instancecheck__(cls, x: Any) -> bool:
        return any(isinstance(x, get_origin(kind) or kind) for kind in cls.kinds)


def print_by_name(aliases: dict[str, Any], *names: str) -> None:
    """Replace the named type aliases of a module by classes of the same name, so that signatures
    and type errors show the name. `aliases` is the module's `globals()`."""
    module = aliases["__name__"].partition(".")[0]
    for name in names:
        alias = aliases[name]
        kinds = members_of(alias) if get_args(alias) else ()
        members = {"__module__": module, "__doc__": f"{name} = {alias}", "kinds": kinds}
        is_one = not kinds
        aliases[name] = (type(alias) if is_one else _OneOf)(name, (alias,) * is_one, members)


def members_of(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union type, including the members of unions inside it. For any other
    type, return a tuple of the type itself."""
    alias = getattr(get_origin(hint) or hint, "__value__", None)  # of a `type` statement
    if alias is not None:
        return members_of(alias[get_args(hint)] if get_args(hint) else alias)
    named = getattr(hint, "kinds", ()) if isinstance(hint, _OneOf) else ()
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else named
    return tuple(one for part in parts for one in members_of(part)) if parts else (hint,)


LONGEST_WAVE = 1e-2  # m; larger numbers are probably in nm or um

Scalar = Float[Array, ""]
BAYER_PHASES = ("RGGB", "GRBG", "GBRG", "BGGR")

Scalars = Float[Array, "..."]
Colour = Float[Array, " bands"]
Spectrum = Float[Array, "... bands"]
Image = Float[Array, "*batch h w bands"]
Key = PRNGKeyArray | Shaped[Array, "2"]
# Everything that NumPy converts to an array. NumPy's own alias misses these types in `isinstance`.
ArrayLike = npt.ArrayLike | tuple[Any, ...] | float | int
print_by_name(globals(), "Scalar", "Scalars", "Colour", "Spectrum", "Image", "Key", "ArrayLike")

Record = TypeVar("Record")


class Varying(eqx.Module):
    """Base of `scene.Map`: values that vary over a surface, in place of a constant parameter of a
    material."""

    values: eqx.AbstractVar[Array]

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the values at one point, which is the shape of the constant parameter that
        the map replaces."""
        return self.values.shape[2:]

    @property
    def dtype(self) -> jnp.dtype:
        """The dtype of the values."""
        return self.values.dtype

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype)


def as_float(x: Any) -> Array:
    """Convert numbers to an array with a definite (not weak) floating dtype.

    JAX compiles a function again when it is called with an array of definite dtype after a weakly
    typed array.

    Args:
        x: numbers in any unit.

    Returns:
        The same numbers. A floating array keeps its dtype, and other values get JAX's default
            floating dtype.

    Example:
        >>> print(jv.as_float([1, 2]), jv.as_float(np.float32(3)).dtype)
        [1. 2.] float32
    """
    if isinstance(x, Varying):  # `check_fields` ensures that a map belongs to a material
        return cast(Array, x)
    array = _as_numbers(x)
    if jnp.issubdtype(array.dtype, jnp.floating) and not array.weak_type:
        return array
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise ValueError(f"{_field()}real numbers are wanted, got {shorten(x)}.")
    return array.astype(jnp.result_type(float))


_ANY = "an argument"


def _as_numbers(x: Any) -> Array:
    try:
        x = plain_array(_ANY, x)
    except InputError as error:
        place = _field().removesuffix(": ") or _ANY
        raise InputError(str(error).replace(_ANY, place, 1)) from None
    x = within_integers(x)
    if isinstance(x, np.ndarray) or type(x) in (list, tuple):
        warn_of_range(_field().removesuffix(": ") or "an argument", x)
    try:
        return jnp.asarray(x)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{_field()}numbers are wanted, got {shorten(x)}.") from error


def _field() -> str:
    """Return "record.field: " while Equinox converts the value of this field; otherwise "". Equinox
    passes only the value to a converter, so the names are read from the calling stack frames."""
    frame = sys._getframe(1)
    while frame and frame.f_globals.get("__name__") in (__name__, "jaxvision.core._vector"):
        frame = frame.f_back
    local = frame.f_locals if frame else {}
    record, field = local.get("self"), local.get("f")
    if isinstance(record, eqx.Module) and isinstance(field, Field):
        return f"{type(record).__name__}.{field.name}: "
    return ""


def is_record(kind: Any) -> bool:
    """Return whether a type is a record, that is, an Equinox module."""
    return isinstance(kind, type) and issubclass(kind, eqx.Module)


def common_dtype(*records: object) -> jnp.dtype:
    """Return the common floating dtype of all numbers in the records."""
    leaves = jax.tree.leaves(records)
    return jnp.result_type(*(x for x in leaves if jnp.issubdtype(x.dtype, jnp.floating)))


def as_optional_float(x: Any) -> Array | None:
    """Apply `as_float` to a value that may be None.

    Args:
        x: numbers in any unit, or None for an absent effect.

    Returns:
        The same numbers in a strong floating dtype, or None.

    Example:
        >>> print(jv.as_optional_float(2), jv.as_optional_float(None))
        2.0 None
    """
    return None if x is None else as_float(x)


def as_relative(x: Any) -> Array:
    """Convert colours or coverage to an array. A floating dtype is not changed. Raise `ValueError`
    for complex numbers and for integer codes, whose products with fractions would wrap or round to
    0."""
    array = _as_numbers(x)
    if not jnp.issubdtype(array.dtype, jnp.floating):
        codes = jnp.issubdtype(array.dtype, jnp.unsignedinteger)
        largest = jnp.iinfo(array.dtype).max if codes else "the largest value"
        raise ValueError(
            f"colours are floating and relative, got {array.dtype}; divide by {largest}."
        )
    return array


def map_beside(values: Any, picture: Array) -> Any:
    """Reshape a map from (..., h, w) to (..., h, w, 1) if this is needed to broadcast it with an
    image that has bands; return anything else unchanged."""
    shape = np.shape(values)
    sides = zip(shape[::-1], picture.shape[::-1], strict=False)
    fits = all(a == b or 1 in (a, b) for a, b in sides)
    is_map = len(shape) >= 2 and shape == picture.shape[-1 - len(shape) : -1]
    return values if fits or not is_map else jnp.asarray(values)[..., None]


def refuse_codes(values: Any) -> None:
    """Raise `ValueError` for an image whose concrete floating-point values are probably codes such
    as 0 to 255: at least 16 values, all whole, with the largest above 100. Light is not a whole
    number in every pixel, so such values are codes."""
    if not is_known(values) or np.size(values) < 16:
        return
    known = np.asarray(values)
    largest = known.max()
    if 100 < largest <= 65535 and (known == np.round(known)).all():
        raise ValueError(
            f"colours are relative to 1, got whole numbers up to {largest:g}: divide the codes by "
            f"the largest that the file can hold, such as {255 if largest <= 255 else 65535}."
        )


def name_above(what: str, values: Any, most: float, remedy: str) -> None:
    """Warn if known numbers that should be relative to 1 are far above 1, like means of codes from
    0 to 255, or per cent. There is no warning for values above 65535."""
    if is_known(values) and np.size(values):
        known = np.asarray(values)
        largest = float(np.max(known, initial=0, where=np.isfinite(known)))
        if most < largest <= 65535:
            warn_caller(f"{what} goes up to {largest:g}, where 1 is white: {remedy}.")


def as_dtype(record: Record, dtype: Any) -> Record:
    """Convert all floating-point numbers of a record to one dtype.

    With this function, the caller chooses the precision, float32 or float64, at each call.

    Args:
        record: any tree of arrays, in any units.
        dtype: a floating dtype, or its name.

    Returns:
        The same tree in that dtype; integers, flags and random keys keep theirs.

    Example:
        >>> sphere = jv.as_dtype(jv.Sphere(centre=(0.0, 0.0, 0.0), radius=1.0), "float32")
        >>> print(sphere.radius.dtype)
        float32
    """
    return jax.tree.map(
        lambda leaf: leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf,
        record,
    )


def axes_of(alias: Any) -> tuple[int | str, ...]:
    """Return the axes of an array alias: an integer for an axis of fixed length, and the name of
    any other axis."""
    return tuple(int(axis) if axis.isdigit() else axis for axis in alias.dim_str.split())


def check_shape(name: str, x: Any, *expected: tuple[int | str, ...], advice: str = "") -> None:
    """Raise `ValueError` unless `x` is None or has one of the expected shapes; the message ends
    with `advice`. In an expected shape, a word allows any length of an axis, and a leading `...` or
    `*word` allows any number of axes."""
    if x is None:
        return
    shape = jnp.shape(x)
    if any(_fits(shape, wanted) for wanted in expected):
        return
    allowed = " or ".join(f"({', '.join(map(str, e))}{',' * (len(e) == 1)})" for e in expected)
    raise ValueError(f"{name} must have shape {allowed}, got {shape}{advice}.")


def is_any_axes(axis: int | str) -> bool:
    """Return whether an entry of an expected shape allows any number of axes."""
    return isinstance(axis, str) and (axis == "..." or axis.startswith("*"))


def _fits(shape: tuple[int, ...], wanted: tuple[int | str, ...]) -> bool:
    if wanted and is_any_axes(wanted[0]):
        wanted = wanted[1:]
        shape = shape[len(shape) - len(wanted) :] if len(shape) >= len(wanted) else ()
    return len(wanted) == len(shape) and all(
        isinstance(size, str) or size == got for size, got in zip(wanted, shape, strict=True)
    )


def check_kind(name: str, value: Any, *kinds: type | UnionType) -> None:
    """Raise `ValueError` unless `value` is a record of one of the given types. None is accepted,
    because it stands for an absent effect."""
    if value is not None:
        check_given(name, value, *kinds)


def check_given(name: str, value: Any, *kinds: type | UnionType) -> None:
    """Raise `ValueError` unless `value` is a record of one of the given types. None raises
    `ValueError` too."""
    known: tuple[Any, ...] = tuple(kind for union in kinds for kind in members_of(union))
    if isinstance(value, known):
        return
    wanted = " or ".join(kind.__name__ for kind in known)
    noun = type(value).__name__
    kind = f"{'an' if noun[0] in 'AEIOaeio' else 'a'} {noun}"
    if isinstance(value, type):
        kind = f"the class {value.__name__}"
    if isinstance(value, jax.Array | np.ndarray):
        kind = "an array"
    got = repr(value) if value is None or np.isscalar(value) else kind
    raise ValueError(f"{name} must be a record, {wanted}, got {got}.")


def check_key(name: str, value: Any, *, several: bool = True, absent: bool = True) -> None:
    """Raise `ValueError` unless `value` is a JAX random key. With `several`, an array of keys is
    accepted too, and with `absent`, None."""
    if value is None:
        if absent:
            return
        raise ValueError(f"{name} must be a random key, got None; write jax.random.key(0).")
    got = shorten(value)
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        typed = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        many = tuple(value.shape) if typed else tuple(value.shape[:-1])
        if typed or _is_raw_key(value):
            if several or not many:
                return
            raise ValueError(
                f"{name} must be one random key, got an array {many} of keys; take one of them, or "
                "jax.vmap of the function."
            )
        got = f"{value.dtype} numbers of shape {tuple(value.shape)}" if np.ndim(value) else got
    seed = int(value) if isinstance(value, int | np.integer) else 0
    raise ValueError(f"{name} must be a random key, got {got}; write jax.random.key({seed}).")


def _is_raw_key(value: Any) -> bool:
    """Return whether `value` may be one or more untyped keys: uint32 words of JAX's default random
    generator."""
    if isinstance(value, np.ndarray) and value.dtype == np.uint64:
        value = value.astype(jax.dtypes.canonicalize_dtype(np.uint64))
    words = _key_shape(getattr(jax.config, "jax_default_prng_impl", "threefry2x32"))
    return value.dtype == np.uint32 and tuple(value.shape[-1:]) == words


@cache
def _key_shape(generator: str) -> tuple[int, ...]:
    """Return the shape of an untyped key of the named random generator."""
    return jax.eval_shape(lambda: jax.random.key_data(jax.random.key(0, impl=generator))).shape


def check_count(name: str, value: Any, least: int, *, odd: bool = False) -> None:
    """Raise `ValueError` unless `value` is a whole number of at least `least`, and odd if `odd`.
    Arrays are refused."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least or (odd and value % 2 == 0):
        kind = "an odd" if odd else "a whole"
        raise ValueError(f"{name} must be {kind} number of at least {least}, got {value!r}.")


def check_choice(name: str, value: Any, choices: Collection[str]) -> None:
    """Raise `ValueError` unless `value` is one of the choices."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}.")


def as_tile(pattern: Any) -> Any:
    """Return the rows of a mosaic pattern. The name of a Bayer mosaic, such as "RGGB", is converted
    to rows."""
    if not isinstance(pattern, str):
        return pattern
    check_choice("phase", pattern.upper(), BAYER_PHASES)
    first, second, third, fourth = ("RGB".index(letter) for letter in pattern.upper())
    return (first, second), (third, fourth)


def check_tile(
    name: str, pattern: Any, *, bands: int | None = None, holder: str = "the picture"
) -> None:
    """Raise `ValueError` unless `pattern` has rows of equal length that contain every band from 0
    to the largest. If `bands` is given, the pattern must contain this number of bands. The error
    message says that `holder` has this number."""
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
    """Return whether the numbers of `x` are concrete, that is, not traced by JAX."""
    return not isinstance(getattr(x, "values", x) if isinstance(x, Varying) else x, Tracer)


def require_metres(
    name: str, wavelengths: np.ndarray | np.floating, *, longest: float = LONGEST_WAVE
) -> None:
    """Raise `ValueError` for wavelengths above `longest` m, which are probably in nm or um."""
    largest = np.max(wavelengths, initial=0)
    if largest > longest:
        raise ValueError(f"{name} is in metres, got {largest:.6g}; 550 nm are 550e-9.")


def check_range(
    name: str,
    value: Any,
    low: float | int,
    high: float | int = np.inf,
    *,
    above: bool = False,
    finite: bool = True,
    nan: bool = False,
) -> None:
    """Raise `ValueError` unless every number of `value` lies in [low, high], or in (low, high] if
    `above`. With `nan`, NaN is accepted. Traced numbers are accepted, and so is None, which stands
    for an absent effect."""
    if value is None or not is_known(value):
        return
    numbers = np.asarray(value)
    inside = (numbers > low if above else numbers >= low) & (numbers <= high)
    if finite:
        inside &= np.isfinite(numbers)
    if nan:
        inside |= np.isnan(numbers)
    if not inside.all():
        wrong = numbers[~inside].flat[0]
        least = "" if low == -np.inf else f"{'above' if above else 'at least'} {low:g}"
        # A limit just below a round number is printed as "below" that number
        below = np.nextafter(high, np.inf)
        word, shown = ("below", below) if float(f"{high:g}") == below else ("at most", high)
        most = "" if high == np.inf else f"{word} {shown:g}"
        ends = " and ".join(filter(None, (least, most)))
        wanted = ", ".join(filter(None, ("finite" if finite else "", ends)))
        raise ValueError(f"{name} must be {wanted}, got {wrong}.")


def check_direction(name: str, value: Any) -> None:
    """Raise `ValueError` for a concrete vector of length 0; traced vectors are accepted."""
    if is_known(value) and not np.asarray(value).any():
        raise ValueError(f"{name} must have a direction, got a vector of length 0.")


# Tolerance for unit axes at right angles, because rotations in files may have three digits.
ASKEW = 2e-3


def check_rotation(name: str, rotation: Any, axes: str) -> None:
    """Raise `ValueError` unless the rows of a concrete matrix are the unit vectors of a
    right-handed frame, with names such as "x, y and z"; traced matrices are accepted."""
    if not is_known(rotation):
        return
    rows = np.asarray(rotation, float)
    if not (np.abs(rows @ rows.T - np.eye(3)).max() <= ASKEW and np.linalg.det(rows) > 0):
        first, second, third = axes.replace(" and", ",").split(", ")
        raise ValueError(
            f"{name} must be a rotation, rows of unit axes {axes} at right angles, {first} x "
            f"{second} = {third}, got {rows.tolist()}."
        )


class Range(NamedTuple):
    """The allowed range of a field: [low, high], or (low, high] if `above`."""

    low: float
    high: float = np.inf
    above: bool = False
    finite: bool = True
    nan: bool = False


FINITE = Range(-np.inf)
NOT_NEGATIVE = Range(0)
POSITIVE = Range(0, above=True)
FRACTION = Range(0, 1)
# For light, size, roughness; NaN is allowed, because it is visible in the picture
AMOUNT = Range(0, finite=False, nan=True)
DIVISOR = Range(0, above=True, finite=False, nan=True)
SHARE = Range(0, 1, nan=True)


def check_fields(record: Any, **ranges: Range) -> None:
    """Raise `ValueError` unless the fields of a record have their annotated shapes and types, and
    their numbers lie in the given ranges. Axes of equal name must have equal length."""
    sizes: dict[int | str, int] = {}
    kind = type(record).__name__
    for name, (shapes, kinds, optional) in _field_shapes(type(record)).items():
        place, value = f"{kind}.{name}", getattr(record, name)
        if kinds and (isinstance(value, eqx.Module) or not shapes):
            (check_kind if optional else check_given)(place, value, *kinds)
        elif isinstance(value, Varying) and not getattr(record, "takes_maps", False):
            raise ValueError(f"{place} must be plain numbers, got a {type(value).__name__}.")
        elif value is not None:
            known = [tuple(sizes.get(axis, axis) for axis in axes) for axes in shapes]
            check_shape(place, value, *known)
            shape = jnp.shape(cast(Any, value))
            fitting = [axes for axes, own in zip(shapes, known, strict=True) if _fits(shape, own)]
            sizes |= zip(fitting[0], shape, strict=True)
            if sizes.get("bands") == 0:
                raise ValueError(f"{place} must have at least one band, got shape {shape}.")
    for name, allowed in ranges.items():
        value = getattr(record, name)
        value = getattr(value, "values", value) if isinstance(value, Varying) else value
        if not isinstance(value, eqx.Module):
            check_range(f"{kind}.{name}", value, **allowed._asdict())


@cache
def _field_shapes(
    record: type,
) -> dict[str, tuple[tuple[tuple[int | str, ...], ...], tuple[type, ...], bool]]:
    """Return the allowed shapes and the record types of each field, and whether it may be None."""
    hints, found = get_type_hints(record), {}
    for field in fields(record):
        hint = hints[field.name]
        parts = members_of(hint)
        shapes = tuple(axes_of(part) for part in parts if hasattr(part, "dim_str"))
        kinds = tuple(part for part in parts if is_record(part))
        if shapes or kinds:
            found[field.name] = shapes, kinds, type(None) in parts
    return found
