"""What a problem's user states, checked and completed before anything is computed."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxvision.errors import InputError, nearest
from jaxvision.plain_arrays import plain_array

from .likelihoods import names_within
from .on_host import on_host
from .parameters import Parameter
from .records import is_path, reach, read

if TYPE_CHECKING:
    from .problem import Problem

GIVEN = ("values", "inputs")
PARTS = ("least_squares", "surrogate", "log_density", "residuals", "draw")  # of a likelihood


def as_arrays(tree: Any) -> Any:
    """Floating-point leaves as arrays: data, which are no part of a compile key.

    Args:
        tree: any PyTree.

    Returns:
        The same tree.
    """
    plain = jax.tree.map(lambda x: plain_array("inputs", x), tree)
    return jax.tree.map(lambda x: jnp.asarray(x) if eqx.is_inexact_array_like(x) else x, plain)


def placed(name: str, parameter: Parameter, records: Mapping[str, Any]) -> Parameter:
    """A parameter with its name, and the shape and start of what it replaces.

    Args:
        name: a word, or a path into a record.
        parameter: as its user states it.
        records: by name.

    Returns:
        The parameter.

    Raises:
        InputError: for a path that leads nowhere, and a shape that is not the record's.
    """
    known = None
    if is_path(name):
        known = np.asarray(read(records, name))
        if parameter.shape is not None and parameter.shape != known.shape:
            raise InputError(
                f"{name}: shape {parameter.shape} does not fit, the record's is {known.shape}."
            )
    parameter = replace(parameter, name=name)
    if known is not None:
        start = parameter.start
        if start is None and np.isfinite(known).all():
            start = _within(parameter, known)
        return replace(parameter, shape=known.shape, start=start)
    start = parameter.start
    shape = parameter.shape
    if shape is None:
        shape = np.shape(start) if start is not None else np.shape(parameter.lower)
    return replace(parameter, shape=tuple(shape))


def _within(parameter: Parameter, known: np.ndarray) -> np.ndarray | None:
    """A record's own value as a start, moved into the bounds; None where it cannot be one."""
    if parameter.transform == "log" and not (known > 0).all():
        return None
    try:
        return np.clip(known, parameter.lower, parameter.upper)
    except ValueError:  # bounds of another shape, which are refused in words elsewhere
        return None


def arguments(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Arguments of a function by name.

    Args:
        function: a user's own.

    Returns:
        In their order.

    Raises:
        InputError: for what is no function.
    """
    if not callable(function):
        raise InputError(
            f"{function!r} is no function; give one whose arguments are named after what they are "
            "given."
        )
    return inspect.signature(function).parameters


def named_and_rest(
    function: Callable[..., Any],
) -> tuple[tuple[inspect.Parameter, ...], bool]:
    """Arguments of a function that derives something.

    Args:
        function: a user's own.

    Returns:
        Those with a name of their own, and whether it takes all others by name (`**`) as well.

    Raises:
        InputError: for one that takes any number by their place, and for what is no function.
    """
    found = arguments(function).values()
    for argument in found:
        if argument.kind is argument.VAR_POSITIONAL:
            raise InputError(
                f"A function takes *{argument.name}: name each argument after what it is given, or "
                "take all by name, as **given."
            )
    several = any(argument.kind is argument.VAR_KEYWORD for argument in found)
    return tuple(a for a in found if a.kind is not a.VAR_KEYWORD), several


def argument_names(predict: Callable[..., Any]) -> tuple[str, ...]:
    """What a function asks for.

    Args:
        predict: whose arguments are named after what they are given.

    Returns:
        Their names.

    Raises:
        InputError: for one that takes any number of them, and for what is no function.
    """
    found = arguments(predict)
    for name, argument in found.items():
        if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            raise InputError(f"predict takes *{name}: name each argument after what it is given.")
    return tuple(found)


def placed_like(given: Any, values: np.ndarray) -> Array:
    """An array on the devices of another, so that data shared out among several stay so.

    Args:
        given: data as the user gave them.
        values: of their shape.

    Returns:
        `values`, on the devices of `given` if that is an array of JAX.
    """
    if not isinstance(given, jax.Array):
        return jnp.asarray(values)
    # Not `device_put`, which compares the values of all processes.
    return jax.make_array_from_callback(values.shape, given.sharding, lambda part: values[part])


def finite_data(data: Any) -> np.ndarray:
    """Data as an array.

    Args:
        data: of any shape; NaN where a datum is missing.

    Returns:
        The array, floating.

    Raises:
        InputError: for an infinite one.
    """
    data = on_host(plain_array("data", data), dtype=jnp.result_type(float))
    if np.isinf(data).any():
        raise InputError(
            f"{int(np.isinf(data).sum())} of the data are infinite: mark missing ones by NaN."
        )
    return data


def check_names(problem: "Problem", parameters: Mapping[str, Any]) -> None:
    """Refuses names that clash, and arguments and likelihoods that name nothing.

    Args:
        problem: its parameters, records and likelihood in place.
        parameters: as its user states them, by name.

    Raises:
        InputError: with the nearest known name.
    """
    if not problem.free:
        raise InputError("Nothing to fit: give at least one Parameter.")
    for name in (*problem.fixed, *problem.tied):
        if is_path(name):
            read(problem.records, name)
    paths = [name for name in parameters if is_path(name)]
    for outer in paths:
        for inner in paths:
            if inner.startswith((f"{outer}.", f"{outer}[")):
                raise InputError(f"{inner} is part of {outer}, a parameter too: name one of them.")
    clash = {*GIVEN} & {*parameters, *problem.records} or problem.records.keys() & parameters.keys()
    if clash:
        raise InputError(f"{sorted(clash)[0]!r} is taken: choose another name.")
    known = {*GIVEN, *problem.records, *(name for name in parameters if not is_path(name))}
    for argument in problem.asks:
        if argument not in known:
            raise InputError(
                f"predict asks for {argument!r}: its arguments are named after what they are "
                f"given, {', '.join(sorted(known))}."
            )
    free = {parameter.name for parameter in problem.free}
    terms = {candidate.name for candidate in problem.candidates}
    for candidate in problem.candidates:
        for name in candidate.requires:
            if name not in terms:
                why = "stays anyhow" if name in free else "is no candidate"
                raise InputError(f"{candidate.name}: requires {name!r}, which {why}.")
    if free == terms:
        raise InputError("Nothing but candidates: give at least one Parameter that stays.")
    lacking = [part for part in PARTS if not hasattr(problem.likelihood, part)]
    if lacking:
        raise InputError(
            f"{type(problem.likelihood).__name__} is no likelihood: it lacks {', '.join(lacking)}."
        )
    for name in names_within(problem.likelihood) - parameters.keys():
        if is_path(name) or name in problem.records:
            reach(problem.records, name)
            continue
        raise InputError(
            f"The likelihood names {name!r}: no such parameter; {nearest(name, parameters)}."
        )
