"""Searches for an optimum take 16 digits, of which a sum over many samples leaves 7 at best."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import jax
import numpy as np

P = ParamSpec("P")
T = TypeVar("T")


def in_double(function: Callable[P, T]) -> Callable[P, T]:
    """The function in double precision, whatever the caller has set.

    Args:
        function: takes no traced numbers.

    Returns:
        The same function of the same numbers.
    """

    @wraps(function)
    def done(*args: P.args, **kwargs: P.kwargs) -> T:
        if jax.dtypes.canonicalize_dtype(np.float64) == np.float64:
            return function(*args, **kwargs)  # a context that changes nothing would compile anew
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return done
