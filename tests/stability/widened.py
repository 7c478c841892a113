"""Float32 against float64 of the same function: the rounding errors of compositions whose formulas
other tests check. The calls are those of `examples/`.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from examples import ROOMS, examples_of
from public_names import traced


def calls():
    """Return {name: (arguments, options)} of every numerical public function."""
    return {name: call for room in ROOMS for name, call in examples_of(room).items()}


def in_dtype(tree, dtype):
    def cast(x):
        known = hasattr(x, "dtype") and not isinstance(x, type)
        floating = known and jnp.issubdtype(x.dtype, jnp.floating)
        return jnp.asarray(x).astype(dtype) if floating else x

    return jax.tree.map(cast, tree)


def widened(name, call):
    """Return (largest error in ULP of the largest number of its array, largest error in ULP of the
    number itself, whether float32 stayed float32)."""
    arguments, options = in_dtype(call, jnp.float32)
    arrays = {k: v for k, v in options.items() if any(map(eqx.is_array, jax.tree.leaves(v)))}
    fixed = {k: v for k, v in options.items() if k not in arrays}

    def leaves(dtype):
        static = {k: dtype if k == "dtype" else v for k, v in fixed.items()}
        program = jax.jit(lambda a, o: partial(traced()[name], **static)(*a, **o))
        return jax.tree.leaves(program(*in_dtype((arguments, arrays), dtype)))

    narrow, wide = leaves(jnp.float32), leaves(jnp.float64)
    of_largest, of_itself, kept = 0.0, 0.0, True
    for got, true in zip(narrow, wide, strict=True):
        if not jnp.issubdtype(got.dtype, jnp.floating) or not got.size:
            continue
        kept &= got.dtype == jnp.float32
        got, true = np.asarray(got, np.float64), np.asarray(true, np.float64)
        known = np.isfinite(true) & np.isfinite(got)
        error, size = np.abs(got - true)[known], np.abs(true)[known].astype(np.float32)
        if error.size and error.max() > 0:
            of_largest = max(of_largest, float(error.max() / np.spacing(size.max())))
            of_itself = max(of_itself, float((error / np.spacing(size)).max()))
    return of_largest, of_itself, kept
