"""Custom JAX primitives; this is the only module that uses undocumented parts of JAX.

The primitives make programs faster and change no value. The module `fusion` explains when each is
used.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

Loops = Callable[..., Sequence[Array]]
# for each `vmap`, innermost first: the size of the batch, and the batch axis of each value
Layers = tuple[tuple[int, tuple[int | None, ...]], ...]

# These names are used only later. They are read here, so that an unsuitable JAX fails on import.
_NEEDED = ad.Zero, ad.defbilinear, ad.primitive_transposes.get


@partial(jax.jit, static_argnums=0)
def _inlineable(function: Callable[..., Any], *arguments: Any) -> Any:
    with set_xla_metadata(inlineable="true"):
        return function(*arguments)


def not_inlined(function: Callable[..., Any], *arguments: Any) -> Any:
    """Compute `function(*arguments)` as a call that XLA does not inline. XLA would also apply the
    attribute "do not inline" to calls inside `function`, such as `jnp.where`, so these calls get
    the attribute "inline"."""
    with set_xla_metadata(inlineable="false"):
        return _inlineable(function, *arguments)


def identity(name: str, loops: Loops) -> Loops:
    """Return a function that returns its arrays unchanged. XLA compiles a call of this function as
    a call of `loops`. Tangents and cotangents, except structural zeros, are passed through `loops`
    too."""
    primitive = Primitive(name)

    def evaluate(values: Sequence[Any]) -> list[Any]:
        known = [value for value in values if type(value) is not ad.Zero]
        results = iter(primitive.bind(*known) if known else ())
        return [value if type(value) is ad.Zero else next(results) for value in values]

    def batch(values: Sequence[Array], axes: Sequence[int | None]) -> tuple[list[Array], list[int]]:
        size = _size_of_batch(values, axes)
        moved = [
            jnp.broadcast_to(v, (size, *v.shape)) if axis is None else jnp.moveaxis(v, axis, 0)
            for v, axis in zip(values, axes, strict=True)
        ]
        return primitive.bind(*moved), [0] * len(moved)

    primitive.multiple_results = True
    primitive.def_impl(lambda *values: list(values))  # eager values are already materialised
    primitive.def_abstract_eval(lambda *values: values)
    mlir.register_lowering(primitive, mlir.lower_fun(loops, multiple_results=True))
    batching.primitive_batchers[primitive] = batch
    ad.primitive_jvps[primitive] = lambda values, tangents: (
        primitive.bind(*values),
        evaluate(tangents),
    )
    ad.primitive_transposes[primitive] = lambda cotangents, *_: evaluate(cotangents)
    return primitive.bind


def bilinear(
    name: str,
    function: Callable[..., Array],
    *,
    shape: Callable[..., Any],
    transposes: tuple[Callable[..., Array], Callable[..., Array]],
    batched: Callable[..., tuple[Array, int]],
) -> Callable[..., Array]:
    """Return a function that is linear in each of two arrays, with the given transposes and
    batching rule. The function has derivatives of any order, in forward and reverse mode."""
    primitive = Primitive(name)
    primitive.def_impl(function)
    primitive.def_abstract_eval(shape)
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=False))
    ad.defbilinear(primitive, *transposes)
    batching.primitive_batchers[primitive] = batched
    return primitive.bind


def one_step(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Call `function(*arguments, **named)`, whose results are whole numbers and flags, as one
    equation of the jaxpr. `vmap` and derivatives do not trace into this equation before
    compilation."""
    inside, found = jax.make_jaxpr(function, return_shape=True)(*arguments, **named)
    results = _step.bind(*jax.tree.leaves((arguments, named)), inside=inside, layers=())
    return jax.tree.unflatten(jax.tree.structure(found), results)


def _run(*values: Any, inside: ClosedJaxpr, layers: Layers) -> Any:
    function = jaxpr_as_fun(inside)
    for _, axes in layers:
        function = jax.vmap(function, in_axes=axes)
    return function(*values)


def _types(*values: Any, inside: ClosedJaxpr, layers: Layers) -> list[ShapedArray]:
    del values
    sizes = tuple(size for size, _ in reversed(layers))
    return [ShapedArray((*sizes, *aval.shape), aval.dtype) for aval in inside.out_avals]


def _one_layer_more(
    values: Sequence[Any], axes: Sequence[int | None], *, inside: ClosedJaxpr, layers: Layers
) -> tuple[list[Array], list[int]]:
    size = _size_of_batch(values, axes)
    results = _step.bind(*values, inside=inside, layers=(*layers, (size, tuple(axes))))
    return results, [0] * len(results)


def _drop_tangents(
    values: Sequence[Any], tangents: Sequence[Any], **parameters: Any
) -> tuple[list[Array], list[Any]]:
    del tangents
    results = _step.bind(*values, **parameters)
    return results, [ad.Zero(jax.typeof(result).to_tangent_aval()) for result in results]


_step = Primitive("one_step")
_step.multiple_results = True
_step.def_impl(_run)
_step.def_abstract_eval(_types)
mlir.register_lowering(_step, mlir.lower_fun(_run, multiple_results=True))
batching.primitive_batchers[_step] = _one_layer_more
ad.primitive_jvps[_step] = _drop_tangents


def _size_of_batch(values: Sequence[Any], axes: Sequence[int | None]) -> int:
    (size,) = {v.shape[axis] for v, axis in zip(values, axes, strict=True) if axis is not None}
    return size
