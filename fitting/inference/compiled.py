"""Compilation without optimisation, for programs that take longer to optimise than to run."""

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

    Inside another program, or inside a derivative, it is compiled like that program."""
    part = eqx.filter_jit(function)
    whole = cast(Any, eqx.filter_jit)(function, compiler_options=briefly())

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        leaves = jax.tree.leaves((args, kwargs))
        traced = any(isinstance(leaf, Tracer) for leaf in leaves)
        return (part if traced else whole)(*args, **kwargs)

    return call
