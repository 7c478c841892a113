"""All that decides a chain, as one hash: a checkpoint of another run is known by it."""

import hashlib
import re
from collections.abc import Callable, Hashable
from importlib.metadata import version
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .on_host import on_host

ADDRESS = re.compile(r"0x[0-9a-f]+")  # of an object in this process
PACKAGES = ("jax", "numpy", "scipy")


def fingerprint(
    log_density: Callable[[Float[Array, " parameters"], Any], Float[Array, ""]],
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    *settings: Hashable,
    package: str,
) -> str:
    """Hash of a density with its data, of where a sampler starts, and of how it runs.

    The density counts by its name and by what it computes: the text of its jaxpr and the constants
    it closes over, so that the same name with another formula is another run.

    Args:
        log_density: function of (vector, args).
        mode: (P,) unconstrained.
        covariance: (P, P).
        args: data of `log_density`.
        *settings: parameters, seed, walkers: what decides the draws besides.
        package: the sampler's, whose version counts beside JAX's, NumPy's and SciPy's.

    Returns:
        64 hexadecimal digits, the same in every process.
    """
    closed = eqx.filter_make_jaxpr(log_density)(mode, args)[0]
    name = getattr(log_density, "__module__", ""), getattr(log_density, "__qualname__", "")
    packages = [f"{known} {version(known)}" for known in (package, *PACKAGES)]
    digest = hashlib.sha256()
    digest.update(ADDRESS.sub("", repr((settings, packages, name, str(closed)))).encode())
    for leaf in jax.tree.leaves((mode, covariance, args, closed.consts)):
        digest.update(on_host(leaf).tobytes() if eqx.is_array_like(leaf) else b"static")
    return digest.hexdigest()
