"""Measure the size of the program of a picture by its number of equations, which does not depend on
the load of the machine."""

from typing import Any

import jax

from ..rendering import render
from ..scene import Scene, View


def equations(scene: Scene, view: View) -> int:
    """Count the equations of `render` before XLA compiles it; equations inside loops count once.

    Args:
        scene: surfaces and lights.
        view: any view, with one ray for each pixel; the numbers of a lens are traced, so that
            defocus is included.

    Returns:
        The number of equations, no unit.
    """
    return _count(jax.make_jaxpr(render)(scene, view).jaxpr)


def _count(jaxpr: Any) -> int:
    total = len(jaxpr.eqns)
    for equation in jaxpr.eqns:
        inner = jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
        )
        for found in inner:
            found = getattr(found, "jaxpr", found)
            total += _count(found) if hasattr(found, "eqns") else 0
    return total
