"""Control of XLA fusion: which values are computed in one loop and which are materialised. It makes
programs faster, and ensures that a decision which depends on rounding is made only once. Compiled
code that computes a sum twice may contract its products differently, and the two could then
disagree on which of two crossings comes first.

Undocumented parts of JAX make programs faster on a processor; only `primitives` uses them. Without
them the same programs use public JAX. They give the same values and derivatives up to rounding, and
are up to 20 times slower. PLAIN is True if they do not work with the installed JAX, or if the
environment variable JAXVISION_PLAIN_JAX is set and not 0 when jaxvision is imported. An accelerator
always uses public JAX: with them, an H200 took 20 times as long for a path-traced box and 14 times
as long for direct light.
"""

import os
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...programs import on_processor

P = ParamSpec("P")
R = TypeVar("R")


def _found() -> Any:
    """The module `primitives`, or None."""
    if os.environ.get("JAXVISION_PLAIN_JAX", "0") not in ("", "0"):
        return None
    try:
        from . import primitives
    except Exception:  # what a JAX with other internals raises is not known beforehand
        return None
    return primitives


_primitives = _found()
PLAIN = _primitives is None

TILE = 16384  # rays at once: an array of them is 64 kB in float32, and all of a tile fit the cache

# Rays at once on an accelerator: each operation on them costs the start of a kernel, some 10 us,
# and takes no less for fewer. A gigabyte holds what the paths of so many need.
_OF_KERNEL = 2**20

# Rays to a full stretch of vector code, several times over: where it ends and leaves a rest to
# plain code, the last bit of a ray would tell how the picture was cut.
LANES = 64


def _helps() -> bool:
    """Whether `primitives` makes this program faster."""
    return not PLAIN and on_processor()


def at_a_time(of_core: int) -> int:
    """The number of rays or entries that a loop takes at a time: `of_core` on a processor, many
    more elsewhere."""
    return of_core if on_processor() else max(of_core, _OF_KERNEL)


def one_program(function: Callable[P, R]) -> Callable[P, R]:
    """`function` compiled once for each structure of its arguments, in which all but arrays is
    static. XLA recompiles an eager loop whose function is new, as a closure is."""
    compiled = cast(Any, eqx.filter_jit)(function, inline=True)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        # equinox takes NumPy's numbers for arrays, but numbers among the settings are static
        known = (x.item() if isinstance(x, np.generic) else x for x in args)
        return compiled(*known, **kwargs)

    return call


def materialise(function: Callable[..., Any], *arguments: Any) -> Any:
    """`function(*arguments)`, computed once and materialised. XLA would repeat it in every loop
    that reads it, and removes optimisation barriers before that; loops do not cross a call that is
    not inlined."""
    return _primitives.not_inlined(function, *arguments) if _helps() else function(*arguments)


def inline(function: Callable[..., Any], *arguments: Any) -> Any:
    """`function(*arguments)`, for use in place of `materialise` where materialising is not
    needed."""
    return function(*arguments)


def fuse(values: Any) -> Any:
    """The same tree of arrays of one shape, and their derivatives, computed in one loop and
    materialised. On the CPU XLA gives each array a loop of its own, except in a reduction of
    several arrays: here of an axis of two equal entries."""
    if _fuse is None or not on_processor():
        return values
    leaves, tree = jax.tree.flatten(values)
    return jax.tree.unflatten(tree, _fuse(*leaves))


def _one_loop(*values: Array) -> Sequence[Array]:
    """One loop for each floating precision among the values, because a reduction cannot mix
    them."""
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


_fuse = None if PLAIN else _primitives.identity("fuse", _one_loop)


def searched(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """`function(*arguments, **named)`, a search whose results are whole numbers and flags. `vmap`
    and derivatives see one equation instead of thousands without anything to differentiate."""
    if not _helps():
        arguments, named = jax.lax.stop_gradient((arguments, named))
        return function(*arguments, **named)
    return _primitives.one_step(function, *arguments, **named)


def bilinear(
    name: str, function: Callable[..., Array], *, opaque: Callable[..., bool], **rules: Any
) -> Callable[..., Array]:
    """A function linear in two arrays, with the `rules` of `primitives.bilinear` for transposes and
    batches. `opaque` arguments cannot be derived by JAX, so that an accelerator needs the rules
    too."""
    if PLAIN:
        return function
    ours = _primitives.bilinear(name, function, **rules)
    return lambda *arrays, **named: (ours if _helps() or opaque(**named) else function)(
        *arrays, **named
    )


def in_tiles(function: Callable[..., Any], *trees: Any, size: int) -> Any:
    """`vmap(function)(*trees)` over the leading axes of all arrays, up to `size` entries at a time,
    the last tile padded. Intermediate results stay in the cache, and a gradient recomputes them:
    half the time and a tenth of the memory."""
    count = len(jax.tree.leaves(trees)[0])
    if count <= size:
        return jax.vmap(function)(*trees)
    tiles = -(-count // size)
    each = -(-count // (tiles * LANES)) * LANES

    def cut(x: Array) -> Array:
        around = ((0, tiles * each - count), *((0, 0),) * (x.ndim - 1))
        return jnp.pad(x, around, mode="edge").reshape(tiles, each, *x.shape[1:])

    tile = jax.checkpoint(lambda entries: jax.vmap(function)(*entries))
    found = jax.lax.map(tile, jax.tree.map(cut, trees))
    return jax.tree.map(lambda x: x.reshape(tiles * each, *x.shape[2:])[:count], found)
