"""Arrays that carry more than numbers: a mask, a unit, coordinates, an index.

What reads only their numbers would lose the rest without a word. A mask becomes NaN, which marks a
missing number everywhere here; the others are refused.
"""

from typing import Any

import numpy as np

from .errors import InputError

# What the arrays of a package carry, and what gives their numbers.
_CARRIED = {
    "xarray": ("dimensions and coordinates", ".to_numpy()"),
    "pandas": ("an index", ".to_numpy()"),
    "polars": ("names of columns", ".to_numpy()"),
    "pyarrow": ("a schema", ".to_numpy()"),
    "astropy": ("a unit", ".to_value(UNIT)"),
    "pint": ("a unit", ".m_as(UNIT)"),
    "unyt": ("a unit", ".to_value(UNIT)"),
    "unxt": ("a unit", ".to_value(UNIT)"),
}


def plain_array(name: str, value: Any) -> Any:
    """The argument as numbers alone, if nothing is lost by that.

    Args:
        name: of the argument, for the message.
        value: what the caller gave; lists are looked through.

    Returns:
        The same, but a masked array as its numbers, NaN where a floating number is masked.

    Raises:
        InputError: for masked whole numbers, which cannot be NaN, and for arrays with units,
            coordinates or an index.

    Example:
        >>> jv.plain_arrays.plain_array("data", np.ma.masked_greater([1.0, 9.0], 5))
        array([ 1., nan])
    """
    if isinstance(value, np.ma.MaskedArray):
        return _without_mask(name, value)
    if type(value) in (list, tuple):
        if all(type(part) in (float, int) for part in value):
            return value
        parts = [plain_array(name, part) for part in value]
        same = all(new is old for new, old in zip(parts, value, strict=True))
        return value if same else parts
    if isinstance(value, int | float | str) or type(value) is np.ndarray or value is None:
        return value
    for base in type(value).__mro__:
        package = base.__module__.partition(".")[0]
        if package in _CARRIED and hasattr(value, "shape"):
            carried, numbers = _CARRIED[package]
            raise InputError(
                f"{name} is a {type(value).__name__} with {carried}, which would be lost; give "
                f"its numbers in the documented unit and order of axes, as {numbers} does."
            )
    return value


def _without_mask(name: str, value: np.ma.MaskedArray) -> np.ndarray:
    count = int(np.ma.count_masked(value))
    if count == 0:
        return np.asarray(value)
    if value.dtype.kind in "fc":
        return value.filled(np.nan)
    raise InputError(
        f"{name} is a masked array of {value.dtype}, {count} of its {value.size} numbers masked; "
        "give it as .astype(float).filled(numpy.nan) where missing numbers may be NaN, or fill or "
        "crop it."
    )
