"""Measure the size of the program of a picture by its number of equations, which does not depend on
the load of the machine."""

from typing import Any

import jax

from ..rendering import render
from ..scene import Scene, View


def equations(scene: Scene, view: View) -> int:
    """Count the equations of the program of `render` before XLA compiles it. An equation inside a
    loop counts once.

    Args:
        scene: surfaces and lights.
        view: any view; the program uses one ray for each pixel. The numbers of a lens are traced,
            so that the program includes defocus.

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
