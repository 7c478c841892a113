"""Combine several channels into one problem in which they share some parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from inspect import Parameter as Argument
from inspect import Signature
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxvision.errors import InputError, nearest

from .likelihoods import Clustered, names_within
from .on_host import to_host
from .problem import Problem, start_of_data
from .records import is_path


def stack_channels(
    problem: Problem, data: Any, *, shared: Sequence[str] = (), inputs: Any = None
) -> Problem:
    """Turn the problem of one channel into one problem for several channels, which compiles to one
    program.

    A parameter that is not shared becomes an array with a leading axis of channels. Numbers of the
    likelihood and labels of groups are the same for every channel. A parameter that the likelihood
    names must be shared.

    Args:
        problem: the problem of one channel, whose data give the shape.
        data: (..., channels): the shape of the problem's data, followed by an axis of channels; NaN
            where a datum is missing.
        shared: names of the parameters that have one value for all channels.
        inputs: inputs in the structure of the problem's inputs. An array with the problem's shape
            and a trailing axis of channels differs between channels; any other array is used for
            all. None uses the problem's inputs.

    Returns:
        The problem, for `fit`.

    Raises:
        InputError: for data or inputs of another shape, for an unknown parameter, for a tied
            parameter, and if a path into a record or a name in the likelihood is not shared.

    Example:
        Two channels that share one decay rate.

        >>> from fitting import Gaussian, Parameter, Problem, fit, stack_channels
        >>> time = np.linspace(0.0, 2.0, 20)
        >>> one = Problem(
        ...     {"height": Parameter(linear=True), "rate": Parameter(lower=0, upper=9)},
        ...     predict=lambda height, rate, inputs: height * jnp.exp(-rate * inputs),
        ...     likelihood=Gaussian(sd=0.01),
        ...     data=np.zeros(20),
        ...     inputs=time,
        ... )
        >>> data = np.exp(-time)[:, None] * np.array([2.0, 5.0])
        >>> both = stack_channels(one, data, shared=["rate"])
        >>> found = fit(both)
        >>> found.values["height"].round(4).tolist(), round(float(found.values["rate"]), 4)
        ([2.0, 5.0], 1.0)
    """
    own = problem.data.shape
    if problem.stream is not None or np.ndim(data) != len(own) + 1 or np.shape(data)[:-1] != own:
        raise InputError(
            f"stack_channels: data of shape {np.shape(data)} do not fit: the problem's own "
            f"shape, {own}, comes first, the channels behind it."
        )
    count = np.shape(data)[-1]
    free = [parameter.name for parameter in problem.free]
    for name in shared:
        if name not in free:
            raise InputError(f"stack_channels: shared names {name!r}; {nearest(name, free)}.")
    several = tuple(name for name in free if name not in shared)
    if paths := [name for name in several if is_path(name)]:
        raise InputError(f"stack_channels: {paths[0]} is a path into a record: add it to shared.")
    if named := sorted(names_within(problem.likelihood) & {*several}):
        raise InputError(f"stack_channels: the likelihood names {named[0]}: add it to shared.")
    if problem.tied:
        raise InputError(
            f"stack_channels: {', '.join(problem.tied)} is tied to others: compute it within "
            "predict."
        )
    parameters: dict[str, Any] = dict(problem.fixed)
    candidates = {candidate.name: candidate for candidate in problem.candidates}
    for parameter in problem.free:
        one = parameter
        if parameter.name in several:
            one = replace(parameter, shape=(count, *(parameter.shape or ())))
        known = candidates.get(parameter.name)
        parameters[parameter.name] = one if known is None else replace(known, parameter=one)
    every, axes = _inputs(problem.inputs, inputs, count)
    return Problem(
        {name: parameters[name] for name in [*free, *problem.fixed]},
        _Channels(problem.predict, problem.asks, several, axes),
        _likelihood(problem.likelihood, (*own, count)),
        data,
        records=problem.records,
        inputs=every,
        start=None if problem.start is None else _start(problem, several, axes),
        left_out=problem.left_out,
    )


class _Channels:
    """A function that calls `predict` for every channel, with the same named arguments."""

    def __init__(self, predict: Any, asks: Any, several: Any, axes: Any) -> None:
        self.key = predict, asks, several, tuple(jax.tree.leaves(axes, is_leaf=_is_none))
        self.axes = axes
        kind = Argument.POSITIONAL_OR_KEYWORD
        self.__signature__ = Signature([Argument(name, kind) for name in asks])

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Channels) and self.key == other.key

    def __call__(self, *given: Any) -> Any:
        predict, asks, several, _ = self.key
        axes = []
        for name, value in zip(asks, given, strict=True):
            if name == "values":
                axes.append({one: 0 if one in several else None for one in value})
            elif name == "inputs":
                axes.append(self.axes)
            else:
                axes.append(0 if name in several else None)

        def predict_channel(arguments: list[Any]) -> Any:
            return predict(**dict(zip(asks, arguments, strict=True)))

        return jax.vmap(predict_channel, in_axes=(axes,), out_axes=-1)([*given])


def _is_none(x: Any) -> bool:
    return x is None


def _inputs(own: Any, given: Any, count: int) -> tuple[Any, Any]:
    """Return the inputs of all channels, and the axis of the channels in each leaf."""
    if given is None:
        return own, jax.tree.map(lambda x: None, own) if own is not None else None
    leaves, form = jax.tree.flatten(own)
    others, other_form = jax.tree.flatten(given)
    if form != other_form:
        raise InputError("stack_channels: inputs: give them in the structure of the problem's own.")
    axes: list[int | None] = []
    for whole, leaf in zip(leaves, others, strict=True):
        shape = np.shape(leaf)
        if shape not in (np.shape(whole), (*np.shape(whole), count)):
            raise InputError(
                f"stack_channels: inputs: an array of shape {shape} is neither of the problem's "
                f"own shape, {np.shape(whole)}, nor of {(*np.shape(whole), count)}."
            )
        axes.append(None if shape == np.shape(whole) else -1)
    return jax.tree.unflatten(form, others), jax.tree.unflatten(form, axes)


def _likelihood(likelihood: Any, shape: tuple[int, ...]) -> Any:
    """Return the likelihood of all channels, with the same fields for each."""
    if isinstance(likelihood, Clustered):
        labels = jax.tree.map(
            lambda x: np.broadcast_to(to_host(x)[..., None], shape), likelihood.labels
        )
        return Clustered(_likelihood(likelihood.likelihood, shape), labels)
    return jax.tree.map(
        lambda x: x[..., None] if np.shape(x) == shape[:-1] and np.ndim(x) else x, likelihood
    )


def _start(problem: Problem, several: tuple[str, ...], axes: Any) -> Any:
    """Compute starts of every channel from its data; the start of a shared parameter is the median
    over channels."""

    def start(data: Any, inputs: Any) -> Mapping[str, Any]:
        def start_channel(data: Any, inputs: Any) -> Mapping[str, Any]:
            present = ~jnp.isnan(data)
            here = eqx.tree_at(
                lambda p: (p.data, p.present, p.inputs),
                problem,
                (jnp.where(present, data, 0), present, inputs),
                is_leaf=_is_none,
            )
            return start_of_data(here)

        found = jax.vmap(start_channel, in_axes=(-1, axes))(data, inputs)
        return {k: x if k in several else jnp.nanmedian(x, axis=0) for k, x in found.items()}

    return start
