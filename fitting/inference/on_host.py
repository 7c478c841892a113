"""Convert JAX arrays, also those distributed over processes, to NumPy.

With `jax.distributed`, each process runs the same program and holds a part of each distributed
array. Decisions in NumPy need the whole array in every process.
"""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from jaxvision.errors import InputError


def to_host(values: Any, *, dtype: Any = None) -> np.ndarray:
    """Return all values as a NumPy array; with several processes, each must call this."""
    if _fetch(values):
        from jax.experimental.multihost_utils import process_allgather

        values = process_allgather(values, tiled=True)
    return np.asarray(values, dtype)


def require_here(name: str, values: Any) -> None:
    """Refuse arrays that lie on several hosts, because parts are read in one process."""
    if any(_fetch(leaf) for leaf in jax.tree.leaves(values)):
        raise InputError(
            f"{name}: an array lies on several hosts, and what is read in parts must lie on one; "
            "fit it whole (without chunk), or give each host's own part to a task."
        )


def _fetch(values: Any) -> bool:
    return (
        isinstance(values, jax.Array)
        and not isinstance(values, Tracer)
        and not (values.is_fully_addressable or values.is_fully_replicated)
    )
