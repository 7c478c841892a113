"""A search as one step of a program: what it finds are whole numbers and flags, which no derivative
reaches."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.core import ShapedArray
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

Layers = tuple[tuple[int, tuple[int | None, ...]], ...]


def searched(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """`function(*arguments, **named)`, whose results are whole numbers and flags.

    What batches, differentiates or divides a program meets one step in place of the thousand of a
    search among all shapes. The gradient of a loop in a loop would go through each of them a dozen
    times, only to find that there is nothing to differentiate: half of its time to compile.
    """
    inside, found = jax.make_jaxpr(function, return_shape=True)(*arguments, **named)
    results = _search.bind(*jax.tree.leaves((arguments, named)), inside=inside, layers=())
    return jax.tree.unflatten(jax.tree.structure(found), results)


def _run(*values: Any, inside: ClosedJaxpr, layers: Layers) -> Any:
    """What is `inside`, for all that was batched: of each layer, the innermost first, how many, and
    along which axis of each value."""
    function = jaxpr_as_fun(inside)
    for _, axes in layers:
        function = jax.vmap(function, in_axes=axes)
    return function(*values)


def _types(*values: Any, inside: ClosedJaxpr, layers: Layers) -> list[ShapedArray]:
    del values
    sizes = tuple(size for size, _ in reversed(layers))
    return [ShapedArray((*sizes, *aval.shape), aval.dtype) for aval in inside.out_avals]


def _batched(
    values: Sequence[Any], axes: Sequence[int | None], *, inside: ClosedJaxpr, layers: Layers
) -> tuple[list[Array], list[int]]:
    (size,) = {v.shape[axis] for v, axis in zip(values, axes, strict=True) if axis is not None}
    results = _search.bind(*values, inside=inside, layers=(*layers, (size, tuple(axes))))
    return results, [0] * len(results)


def _derived(
    values: Sequence[Any], tangents: Sequence[Any], **parameters: Any
) -> tuple[list[Array], list[Any]]:
    del tangents
    results = _search.bind(*values, **parameters)
    return results, [ad.Zero(jax.typeof(result).to_tangent_aval()) for result in results]


_search = Primitive("search")
_search.multiple_results = True
_search.def_impl(_run)
_search.def_abstract_eval(_types)
mlir.register_lowering(_search, mlir.lower_fun(_run, multiple_results=True))
batching.primitive_batchers[_search] = _batched
ad.primitive_jvps[_search] = _derived
