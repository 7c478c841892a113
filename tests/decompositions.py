"""Find the batched decompositions in a program that may run at the same time.

XLA's CPU pool distributes the matrices of a batch over its own threads, and waits for them in one
of them. If as many decompositions as there are threads wait at the same time, they wait for ever
(jaxlib 0.10; seen on two cores)."""

from typing import Any

import jax
from jax.extend.core import Literal

PARALLEL = {"cholesky", "eig", "eigh", "geqrf", "householder_product", "lu", "svd"} | {
    "triangular_solve",
    "tridiagonal_solve",
    "qr",
}


def beside_each_other(function: Any, *arguments: Any) -> list[tuple[str, str]]:
    """Return pairs of batched decompositions where neither waits for the other."""
    return _pairs(jax.make_jaxpr(function)(*arguments).jaxpr)


def _inner(equation: Any) -> list[Any]:
    leaves = jax.tree.leaves(list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns"))
    found = [getattr(leaf, "jaxpr", leaf) for leaf in leaves]
    return [leaf for leaf in found if hasattr(leaf, "eqns")]


def _decomposes(equation: Any) -> str:
    """Return the name of the decomposition, or of the first one inside the equation, or ""."""
    if equation.primitive.name in PARALLEL:
        batch = equation.invars[0].aval.shape[:-2]
        return equation.primitive.name if any(size > 1 for size in batch) else ""
    within = (_decomposes(one) for jaxpr in _inner(equation) for one in jaxpr.eqns)
    return next(filter(None, within), "")


def _pairs(jaxpr: Any) -> list[tuple[str, str]]:
    behind: dict[Any, set[int]] = {}  # the decompositions that each value waits for
    known: dict[int, str] = {}
    pairs = []
    for number, equation in enumerate(jaxpr.eqns):
        before: set[int] = set()
        for value in equation.invars:
            if not isinstance(value, Literal):
                before |= behind.get(value, set())
        if name := _decomposes(equation):
            pairs += [(other, name) for n, other in known.items() if n not in before]
            known[number] = name
            before = before | {number}
        for value in equation.outvars:
            behind[value] = before
        for inner in _inner(equation):
            pairs += _pairs(inner)
    return pairs
