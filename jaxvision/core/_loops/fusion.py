"""Control XLA fusion: which values are computed in one loop and which are materialised. This
control makes programs faster. It also ensures that a materialised value is computed only once.
Otherwise compiled code may compute a sum twice with different rounding, and then, for example,
decide differently which of two ray intersections is nearer.

On a CPU, undocumented parts of JAX make programs faster. Only the module `primitives` uses these
parts. With public JAX alone, the programs give the same values and derivatives up to rounding, but
take up to 20 times as long. PLAIN is True if the undocumented parts do not work with the installed
JAX, or if the environment variable JAXVISION_PLAIN_JAX is set and not 0 when jaxvision is imported.
An accelerator always uses public JAX: with the undocumented parts, an H200 took 20 times as long
for a path-traced box and 14 times as long for direct light.
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

from ...programs import targets_cpu
from ..parallel_loops import map_

P = ParamSpec("P")
R = TypeVar("R")


def _load_primitives() -> Any:
    """Return the module `primitives`, or None if it does not work or is switched off."""
    if os.environ.get("JAXVISION_PLAIN_JAX", "0") not in ("", "0"):
        return None
    try:
        from . import primitives
    except Exception:  # a JAX with other internals may raise any exception
        return None
    return primitives


_primitives = _load_primitives()
PLAIN = _primitives is None

# Number of rays in a tile: one number per ray takes 64 kB in float32, so all arrays of a tile fit
# into the cache.
TILE = 16384

# Number of rays in a tile on an accelerator. Each operation starts a kernel, which takes some 10 us
# for any number of rays. The paths of this number of rays need a gigabyte.
_KERNEL_FACTOR = 2**20

# Blocks are multiples of this number of rays, which is several widths of vector code. Remaining
# rays would be computed by scalar code, and the last bit of a result would depend on the division
# of the picture.
LANES = 64


def _helps() -> bool:
    """Return whether `primitives` makes programs on the current device faster."""
    return not PLAIN and targets_cpu()


def entries_per_step(of_core: int) -> int:
    """Return the number of rays or entries in one step of a loop: `of_core` on a CPU, 2^20 on an
    accelerator."""
    return of_core if targets_cpu() else max(of_core, _KERNEL_FACTOR)


def one_program(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` once for each structure of its arguments. Everything except arrays is
    static. Otherwise XLA would recompile an eager loop at each call, because the loop's body is a
    new function each time."""
    compiled = cast(Any, eqx.filter_jit)(function, inline=True)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        # equinox treats NumPy numbers as arrays, but numbers among the settings are static
        known = [x.item() if isinstance(x, np.generic) else x for x in (*args, *kwargs.values())]
        return compiled(*known[: len(args)], **dict(zip(kwargs, known[len(args) :], strict=True)))

    return call


def materialise(function: Callable[..., Any], *arguments: Any) -> Any:
    """Compute `function(*arguments)` once and materialise it. Otherwise XLA would repeat the
    computation in every loop that uses the result. An optimisation barrier does not help, because
    XLA removes it too early. XLA never fuses loops across a call that is not inlined."""
    return _primitives.not_inlined(function, *arguments) if _helps() else function(*arguments)


def inline(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return `function(*arguments)`. Use this function in place of `materialise` if the result need
    not be materialised."""
    return function(*arguments)


def fuse(values: Any) -> Any:
    """Compute several arrays of one shape, and their derivatives, in one loop, and materialise
    them. On the CPU, XLA computes each array in a separate loop, except in a reduction of several
    arrays. The arrays are therefore computed in a reduction over an axis of two equal entries."""
    if _fuse is None or not targets_cpu():
        return values
    leaves, tree = jax.tree.flatten(values)
    return jax.tree.unflatten(tree, _fuse(*leaves))


def _one_loop(*values: Array) -> Sequence[Array]:
    """Compute values of one precision in one loop; a reduction cannot mix precisions."""
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


def run_search(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Call `function(*arguments, **named)`, a search whose results are whole numbers and flags. For
    `vmap` and derivatives, the search is a single equation without a derivative."""
    if not _helps():
        arguments, named = jax.lax.stop_gradient((arguments, named))
        return function(*arguments, **named)
    return _primitives.one_step(function, *arguments, **named)


def bilinear(
    name: str, function: Callable[..., Array], *, opaque: Callable[..., bool], **rules: Any
) -> Callable[..., Array]:
    """Return a function that is linear in each of two arrays. The transposes and the batching of
    the returned function follow the `rules` of `primitives.bilinear`. On an accelerator, these
    rules are used only if `opaque(**named)`, which means that JAX cannot derive the rules itself.
    """
    if PLAIN:
        return function
    ours = _primitives.bilinear(name, function, **rules)
    return lambda *arrays, **named: (ours if _helps() or opaque(**named) else function)(
        *arrays, **named
    )


def vmap_in_tiles(function: Callable[..., Any], *trees: Any, size: int) -> Any:
    """Compute `vmap(function)(*trees)` over the leading axes of all arrays, in tiles of at most
    `size` entries. The last tile is padded. Intermediate results of a tile stay in the cache. A
    gradient recomputes them, which halves its time and takes a tenth of the memory."""
    count = len(jax.tree.leaves(trees)[0])
    if count <= size:
        return jax.vmap(function)(*trees)
    tiles = -(-count // size)
    each = -(-count // (tiles * LANES)) * LANES

    def cut(x: Array) -> Array:
        around = ((0, tiles * each - count), *((0, 0),) * (x.ndim - 1))
        return jnp.pad(x, around, mode="edge").reshape(tiles, each, *x.shape[1:])

    tile = jax.checkpoint(lambda entries: jax.vmap(function)(*entries))
    found = map_(tile, jax.tree.map(cut, trees))
    return jax.tree.map(lambda x: x.reshape(tiles * each, *x.shape[2:])[:count], found)
