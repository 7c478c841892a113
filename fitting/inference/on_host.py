"""Arrays whose parts lie in several processes, as NumPy's.

Where `jax.distributed` joins processes, each runs the same program and holds a part of what is
shared out. What the program then decides from it in NumPy, each decides from all of it.
"""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer


def on_host(values: Any, *, dtype: Any = None) -> np.ndarray:
    """All values, gathered from the processes where one alone does not hold them; all must call.

    Args:
        values: array of JAX or what NumPy makes one of.
        dtype: of the result; None for its own.

    Returns:
        Of the same shape.
    """
    apart = isinstance(values, jax.Array) and not isinstance(values, Tracer)
    if apart and not (values.is_fully_addressable or values.is_fully_replicated):
        from jax.experimental.multihost_utils import process_allgather

        values = process_allgather(values, tiled=True)
    return np.asarray(values, dtype)
