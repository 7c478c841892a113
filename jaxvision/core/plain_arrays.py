"""Convert arrays that contain more than numbers, such as a mask, a unit, coordinates or an index,
or refuse them.

Converting such an array to plain numbers would lose the mask or unit without a message. Masked
numbers become NaN, which marks a missing number everywhere in this library. An array with a unit,
coordinates or an index raises `InputError`.
"""

import datetime
from numbers import Number
from typing import Any

import numpy as np

from ..errors import InputError
from ._warnings import warn_caller

# For each package: what its arrays contain beside numbers, and the call that returns the numbers.
_CARRIED = {
    "xarray": ("dimensions and coordinates", ".to_numpy()"),
    "pandas": ("an index", ".to_numpy()"),
    "polars": ("names of columns", ".to_numpy()"),
    "pyarrow": ("a schema", ".to_numpy()"),
    "astropy": ("a unit", ".to_value(UNIT)"),
    "pint": ("a unit", ".m_as(UNIT)"),
    "unyt": ("a unit", ".to_value(UNIT)"),
    "unxt": ("a unit", ".to_value(UNIT)"),
    "dask": ("parts that are still to be computed", ".compute()"),
    "h5py": ("attributes such as a scale", "[...]"),
    "zarr": ("attributes such as a scale", "[...]"),
    "scipy": ("zeros that are not stored", ".toarray()"),
    "torch": ("a device and gradients", ".numpy(force=True)"),
    "tensorflow": ("a device and gradients", ".numpy()"),
}

# names of contents that are not numbers, by the kind of the dtype
_NO_NUMBERS = {"V": "fields by name", "M": "dates", "S": "text", "U": "text"}
_WIDEST = {"f": np.float64, "c": np.complex128}  # widest dtype in JAX, by the kind of a dtype


def plain_array(name: str, value: Any) -> Any:
    """Return an argument as an array of plain numbers, if that loses no information. Masked
    floating-point numbers become NaN. Arrays of another byte order, wider numbers, and subclasses
    of arrays become native arrays of at most 64 bits, also inside lists. `InputError`, which names
    the argument, is raised for masked integers, units, coordinates, an index, time spans, and
    anything that is not a number."""
    if type(value) in (list, tuple):
        if all(type(part) in (float, int) for part in value):
            return value
        parts = [plain_array(name, part) for part in value]
        same = all(new is old for new, old in zip(parts, value, strict=True))
        return value if same else parts
    if isinstance(value, int | float | str) or value is None:
        return value
    _refuse_spans(name, value)
    if type(value) is np.longdouble or type(value) is np.clongdouble:
        return np.asarray(value).astype(_WIDEST[value.dtype.kind])[()]
    if type(value) is np.ndarray:
        if value.dtype == object:
            for part in value.flat:
                plain_array(f"a number of {name}", part)
                if not isinstance(part, Number):
                    raise InputError(f"{name} holds {part!r:.40}, which is no number; take it out.")
            return value.astype(complex if np.iscomplexobj(value.tolist()) else float)
        if _is_short_float(value.dtype):
            return value.astype(np.float64)
        if held := _NO_NUMBERS.get(value.dtype.kind):
            raise InputError(
                f"{name} holds {held} ({value.dtype!s:.99}), not numbers; give numbers."
            )
        if value.dtype.char in "gG":
            return value.astype(_WIDEST[value.dtype.kind])
        return value if value.dtype.isnative else value.astype(value.dtype.newbyteorder("="))
    for base in type(value).__mro__:
        package = base.__module__.partition(".")[0]
        if package in _CARRIED and hasattr(value, "shape"):
            carried, numbers = _CARRIED[package]
            if package == "astropy" and getattr(value, "unit", None) is None:
                break  # a column of a table, or an array with a mask
            raise InputError(
                f"{name} is a {type(value).__name__} with {carried}, which would be lost; give "
                f"its numbers in the documented unit and order of axes, as {numbers} does."
            )
    if hasattr(value, "unmasked"):  # an array from astropy
        value = np.ma.array(value.unmasked, mask=value.mask)
    if isinstance(value, np.ma.MaskedArray):
        return plain_array(name, _unmask(name, value))
    # subclasses: records, matrices, memory maps
    return plain_array(name, value.view(np.ndarray)) if isinstance(value, np.ndarray) else value


def within_integers(x: Any) -> Any:
    """Convert integers to floating-point numbers if they do not fit into JAX's integers, which have
    32 bits by default; return other values unchanged. JAX would drop the upper bits of an array, or
    refuse a Python integer with an unclear message."""
    if type(x) in (list, tuple):
        if all(type(part) is float for part in x):
            return x
        parts = [within_integers(part) for part in x]
        return x if all(new is old for new, old in zip(parts, x, strict=True)) else parts
    if type(x) is int:
        held = _hold_numbers(np.int64)
        return x if held.min <= x <= held.max else float(x)
    if isinstance(x, np.ndarray | np.generic) and x.dtype.kind in "iu" and x.dtype.itemsize == 8:
        held = _hold_numbers(x.dtype)
        if x.size and not (held.min <= x.min() and x.max() <= held.max):
            return x.astype(np.float64)
    return x


def widen_short(x: Any) -> Any:
    """Convert arrays of 8 or 16 bits, such as codes and half-precision numbers, to 64 bits, so that
    squares and products do not overflow. Return other values unchanged."""
    dtype = getattr(x, "dtype", None)
    if not isinstance(dtype, np.dtype) or dtype.itemsize > 2:
        return x
    wide = np.int64 if dtype.kind in "iu" else np.float64
    return np.asarray(x, wide) if dtype.kind in "iuf" or _is_short_float(dtype) else x


def _is_short_float(dtype: np.dtype) -> bool:
    """Return whether a dtype is bfloat16, or another number that NumPy itself does not know."""
    return dtype.kind == "V" and not issubclass(dtype.type, np.void)


def warn_of_range(name: str, x: Any) -> None:
    """Warn if JAX's conversion to 32 bits would turn all numbers of a 64-bit array to 0, or some to
    infinity, which is not checked for a single number; and of wavelengths and other numbers that
    are below the normal range of float16."""
    if getattr(x, "dtype", None) == np.float16 and np.size(x):
        from ._types import is_known

        if not is_known(x):
            return
        largest = float(np.abs(np.asarray(x, np.float32)).max())
        if 0 < largest < np.finfo(np.float16).tiny:
            warn_caller(
                f"{name} holds numbers up to {largest:.4g}, of which float16 keeps few digits; "
                "give float32."
            )
        return
    if type(x) in (list, tuple) and x and all(type(part) is float for part in x):
        x = np.asarray(x)
    if not (isinstance(x, np.ndarray) and x.dtype == np.float64 and x.size > 1):
        return
    import jax

    kept = np.finfo(jax.dtypes.canonicalize_dtype(x.dtype))
    if kept.dtype == x.dtype:
        return
    largest = max(np.fmax.reduce(x, axis=None), -np.fmin.reduce(x, axis=None))
    if 0 < largest < kept.tiny:
        becomes = "which becomes 0 or loses its digits"
    elif kept.max < largest < np.inf:
        becomes = "which becomes infinite"
    else:
        return
    warn_caller(
        f"{name} holds numbers up to {largest:.4g}, {becomes} in {kept.dtype}; multiply them by a "
        "constant, or set jax_enable_x64."
    )


def _hold_numbers(dtype: Any) -> np.iinfo:
    """Return the range of the JAX integer dtype to which JAX converts a NumPy integer dtype."""
    import jax

    return np.iinfo(jax.dtypes.canonicalize_dtype(dtype))


def _refuse_spans(name: str, value: Any) -> None:
    """Raise `InputError` for time spans, because NumPy would read them as plain numbers and drop
    their unit."""
    is_array = isinstance(value, np.ndarray | np.generic) and value.dtype.kind == "m"
    if is_array or isinstance(value, datetime.timedelta):
        kind = getattr(value, "dtype", type(value).__name__)
        raise InputError(
            f"{name} holds times with a unit ({kind}), which would be lost; give "
            "numbers, of seconds by x / numpy.timedelta64(1, 's')."
        )


def _unmask(name: str, value: np.ma.MaskedArray) -> np.ndarray:
    count = 0 if value.dtype.names else int(np.ma.count_masked(value))
    if count == 0:
        return np.asarray(value)
    if value.dtype.kind in "fc":
        return value.filled(np.nan)
    raise InputError(
        f"{name} is a masked array of {value.dtype}, {count} of its {value.size} numbers masked; "
        "give it as .astype(float).filled(numpy.nan) where missing numbers may be NaN, or fill or "
        "crop it."
    )
