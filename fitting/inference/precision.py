"""Run fits in float64, because sums over many samples in float32 have at most 7 digits."""

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, signature
from typing import ParamSpec, TypeVar

import jax
import numpy as np

P = ParamSpec("P")
T = TypeVar("T")


def double_precision(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that runs in double precision, whatever JAX's setting is."""
    parameters = signature(function).parameters.values()
    by_name = [one.name for one in parameters if one.kind is Parameter.KEYWORD_ONLY]
    placed = len(parameters) - len(by_name)

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        if by_name and len(args) > placed:
            given = zip(by_name, args[placed:], strict=False)
            named = ", ".join(f"{name}={value!r:.60}" for name, value in given)
            raise TypeError(
                f"{getattr(function, '__name__', 'function')} takes {placed} of its arguments by "
                f"their place; write {named}."
            )
        if "mcmc" in kwargs and "mcmc" not in signature(function).parameters:
            raise TypeError(
                f"{getattr(function, '__name__', 'function')} has no argument mcmc, which the "
                "command has; give sampling=Emcee(), from fitting, for a chain."
            )
        if jax.dtypes.canonicalize_dtype(np.float64) == np.float64:
            return function(*args, **kwargs)  # a context that changes nothing would compile anew
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return run
