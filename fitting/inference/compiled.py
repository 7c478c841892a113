"""Programs of calibrations, which take longer to optimise than to run."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
from jax.core import Tracer

from jaxvision.programs import briefly

P = ParamSpec("P")
R = TypeVar("R")


def compiled_briefly(function: Callable[P, R]) -> Callable[P, R]:
    """As `equinox.filter_jit`, but XLA does not optimise the program.

    A program that is part of another, or of a derivative, is compiled as that one is."""
    part = eqx.filter_jit(function)
    whole = cast(Any, eqx.filter_jit)(function, compiler_options=briefly())

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        leaves = jax.tree.leaves((args, kwargs))
        traced = any(isinstance(leaf, Tracer) for leaf in leaves)
        return (part if traced else whole)(*args, **kwargs)

    return call
