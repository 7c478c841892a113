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


MANY = 50_000  # numbers in all arguments, with which a program takes longer to run than to optimise


def compiled_briefly(function: Callable[P, R], *, always: bool = True) -> Callable[P, R]:
    """As `equinox.filter_jit`, but XLA does not optimise the program.

    A program that is part of another, or of a derivative, is compiled as that one is. `always`:
    whatever the size of the arguments; else XLA optimises the program for large ones."""
    part = eqx.filter_jit(function)
    whole = cast(Any, eqx.filter_jit)(function, compiler_options=briefly())

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        leaves = jax.tree.leaves((args, kwargs))
        traced = any(isinstance(leaf, Tracer) for leaf in leaves)
        large = not (always or sum(getattr(leaf, "size", 1) for leaf in leaves) < MANY)
        return (part if traced or large else whole)(*args, **kwargs)

    return call
