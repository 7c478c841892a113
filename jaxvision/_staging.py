"""What is computed at once and what is stored in between: for speed, no value depends on it."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

TILE = 16384  # rays at once: an array of them is 64 kB in float32, and all of a tile fit the cache

# Rays to a full stretch of vector code, several times over: where it ends and leaves a rest to
# plain code, the last bit of a ray would tell how the picture was cut.
LANES = 64


@partial(jax.jit, static_argnums=0)
def _stage(function: Callable[..., Any], *arguments: Any) -> Any:
    with set_xla_metadata(inlineable="true"):
        return function(*arguments)


def stored(function: Callable[..., Any], *arguments: Any) -> Any:
    """`function(*arguments)`, computed once and stored.

    XLA fuses a value into every loop that reads it, and so repeats a ray's hit for each band of
    each light (a render takes twice as long); an optimisation barrier is gone before it fuses. A
    call that is not inlined is a border that loops do not cross. The attribute would reach all
    calls inside, each `jnp.where` among them, hence its opposite there.
    """
    with set_xla_metadata(inlineable="false"):
        return _stage(function, *arguments)


def together(values: Any) -> Any:
    """The same tree of arrays, of one shape, computed in one loop and stored; their derivatives
    alike.

    XLA gives each array a loop of its own on the CPU, and repeats in it what they share. Only the
    reduction of several arrays is one loop with several results: here over an axis of two equal
    entries, of which the last one stays.
    """
    leaves, tree = jax.tree.flatten(values)
    return jax.tree.unflatten(tree, _together.bind(*leaves))


def _in_one_loop(*values: Array) -> Sequence[Array]:
    """One loop for each floating precision among the values, which a reduction may not mix."""
    is_float = [jnp.issubdtype(value.dtype, jnp.floating) for value in values]
    precisions = dict.fromkeys(v.dtype for v, own in zip(values, is_float, strict=True) if own)
    first = next(iter(precisions), None)
    results = list(values)
    for precision in precisions or [None]:
        members = [
            i
            for i, value in enumerate(values)
            if value.dtype == precision or (not is_float[i] and precision == first)
        ]
        if len(members) > 1:
            twice = [jax.lax.broadcast(values[i], (2,)) for i in members]
            starts = [np.zeros((), values[i].dtype) for i in members]
            joined = jax.lax.reduce(twice, starts, lambda _, last: last, (0,))
            for i, result in zip(members, joined, strict=True):
                results[i] = result
    return results


def _batched(
    primitive: Primitive, values: Sequence[Array], axes: Sequence[int | None]
) -> tuple[list[Array], list[int]]:
    (size,) = {v.shape[axis] for v, axis in zip(values, axes, strict=True) if axis is not None}
    moved = [
        jnp.broadcast_to(v, (size, *v.shape)) if axis is None else jnp.moveaxis(v, axis, 0)
        for v, axis in zip(values, axes, strict=True)
    ]
    return primitive.bind(*moved), [0] * len(moved)


def _of_known(primitive: Primitive, values: Sequence[Any]) -> list[Any]:
    """The primitive of tangents or cotangents, those that are zero by their structure left
    alone."""
    known = [value for value in values if type(value) is not ad.Zero]
    results = iter(primitive.bind(*known) if known else ())
    return [value if type(value) is ad.Zero else next(results) for value in values]


_together = Primitive("together")
_together.multiple_results = True
_together.def_impl(lambda *values: list(values))  # eager values are stored already
_together.def_abstract_eval(lambda *values: values)
mlir.register_lowering(_together, mlir.lower_fun(_in_one_loop, multiple_results=True))
batching.primitive_batchers[_together] = partial(_batched, _together)
ad.primitive_jvps[_together] = lambda values, tangents: (
    _together.bind(*values),
    _of_known(_together, tangents),
)
ad.primitive_transposes[_together] = lambda cotangents, *_: _of_known(_together, cotangents)


def derived_together(values: Any) -> Any:
    """The same tree of numbers, as it is; only their cotangents are computed in one loop and
    stored. For parameters that many rays share: the sums over the rays that follow would else
    each repeat what the cotangents share."""
    leaves, tree = jax.tree.flatten(values)
    return jax.tree.unflatten(tree, _derived.bind(*leaves))


_derived = Primitive("derived_together")
_derived.multiple_results = True
_derived.def_impl(lambda *values: list(values))
_derived.def_abstract_eval(lambda *values: values)
mlir.register_lowering(_derived, lambda context, *values: list(values))
batching.primitive_batchers[_derived] = partial(_batched, _derived)
ad.primitive_jvps[_derived] = lambda values, tangents: (
    list(values),
    _of_known(_derived, tangents),
)
ad.primitive_transposes[_derived] = lambda cotangents, *_: _of_known(_together, cotangents)


def reordered(values: Array, order: Array, back: Array) -> Array:
    """values[order] along the first axis, 0 where `order` points past the end; `back` undoes it:
    order[back[i]] = i, or past the end for what `order` leaves out.

    Its cotangents are read by `back` as the values are by `order`; those of a plain index are added
    up one by one, which takes the CPU seven times as long.
    """
    return _reordered.bind(values, order, back)


def _read(values: Array, order: Array, back: Array) -> Array:
    del back
    return values.at[order].get(mode="fill", fill_value=0)


def _batched_order(arguments: Sequence[Array], axes: Sequence[int | None]) -> tuple[Array, int]:
    """Of many values in one order one reading; of an order for each, a plain index of each."""
    values, order, back = arguments
    axis, *of_orders = axes
    if axis is None or of_orders != [None, None]:
        return jax.vmap(_read, in_axes=tuple(axes))(*arguments), 0
    last = values.ndim - 1
    return _reordered.bind(jnp.moveaxis(values, axis, last), order, back), last


_reordered = Primitive("reordered")
_reordered.def_impl(_read)
_reordered.def_abstract_eval(
    lambda values, order, back: values.update(shape=(*order.shape, *values.shape[1:]))
)
mlir.register_lowering(_reordered, mlir.lower_fun(_read, multiple_results=False))
batching.primitive_batchers[_reordered] = _batched_order
ad.primitive_jvps[_reordered] = lambda arguments, tangents: (
    _reordered.bind(*arguments),
    tangents[0] if type(tangents[0]) is ad.Zero else _reordered.bind(tangents[0], *arguments[1:]),
)
ad.primitive_transposes[_reordered] = lambda cotangent, values, order, back: [
    cotangent if type(cotangent) is ad.Zero else _reordered.bind(cotangent, back, order),
    None,
    None,
]


def in_tiles(function: Callable[..., Any], *trees: Any, size: int, keep: Sequence[str] = ()) -> Any:
    """`vmap(function)(*trees)` over the leading axes of all arrays, `size` entries at a time.

    What lies between the stages of one tile stays in the cache, and a gradient computes a tile
    again rather than keep it, all but what `checkpoint_name` gave the names `keep`: both take half
    the time and a tenth of the memory.
    """
    if len(jax.tree.leaves(trees)[0]) <= size:
        return jax.vmap(function)(*trees)
    policy = jax.checkpoint_policies.save_only_these_names(*keep) if keep else None
    tile = jax.checkpoint(lambda entry: function(*entry), policy=policy)
    return jax.lax.map(tile, trees, batch_size=size)
