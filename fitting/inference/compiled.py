"""Compile without optimisation, for programs that take longer to optimise than to run."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
from jax.core import Tracer

from jaxvision.programs import short_run_options

P = ParamSpec("P")
R = TypeVar("R")


FEW_ELEMENTS = 50_000  # array elements from which a program takes longer to run than to optimise


def compiled_briefly(function: Callable[P, R], *, always: bool = True) -> Callable[P, R]:
    """Compile a function like `equinox.filter_jit`, but without XLA's optimisation.

    If the function is called inside another compiled function or a derivative, it becomes part of
    that program. If `always` is false, XLA optimises the program for large arguments."""
    part = eqx.filter_jit(function)
    whole = cast(Any, eqx.filter_jit)(function, compiler_options=short_run_options())

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        leaves = jax.tree.leaves((args, kwargs))
        traced = any(isinstance(leaf, Tracer) for leaf in leaves)
        large = not (always or sum(getattr(leaf, "size", 1) for leaf in leaves) < FEW_ELEMENTS)
        return (part if traced or large else whole)(*args, **kwargs)

    return call
