"""Warn before a search if the gradient of the prediction neglects moving edges of shadows and
outlines.
"""

import warnings
from collections.abc import Callable, Iterator
from weakref import WeakSet

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxvision.core.parallel_loops import map_

from ..inference.differences import MISSED_SHARE
from ..inference.on_host import to_host
from ..inference.problem import Problem, Values, prediction, values_at
from ..inference.records import head, is_path

_STEP = 0.02  # step, relative to the distance from the origin or to the number itself
_BLOCKS, _LEAST = 16, 4  # blocks of a picture along each side, and pixels along each side of one
_MOST = 6  # largest number of parameters that are tested
_warned: WeakSet[Callable] = WeakSet()


def warn_of_moving_edges(problem: Problem) -> None:
    """Warn if free positions and shapes move edges in the picture, and state what share of the
    picture's change the gradient misses near the starts. The warning appears once for each
    `predict`.
    """
    names = list(_geometric(problem))
    if not names or problem.predict in _warned:
        return
    _warned.add(problem.predict)
    values = values_at(problem, jnp.zeros(len(problem.space)))
    every = [(name, i) for name in names for i in range(values[name].size)]
    shares = {}
    for name, i in every[:: -(-len(every) // _MOST)]:
        way = jnp.zeros(values[name].size).at[i].set(1.0).reshape(values[name].shape)
        size = max(float(np.linalg.norm(to_host(values[name]))), 1e-3)
        whole, missed, unsure = to_host(
            _compare_derivatives(problem, values, {name: _STEP * size * way})
        )
        if missed - unsure > MISSED_SHARE * whole:
            shares[name] = max(shares.get(name, 0.0), float(missed / whole))
    if shares:
        most = max(shares, key=lambda name: shares[name])
        warnings.warn(
            f"The gradient neglects moving edges of shadows and outlines: by {most} it misses "
            f"{shares[most]:.0%} of the change of the picture at the start, averaged over blocks "
            "of pixels. fit uses finite differences at the optimum where this counts; the searches "
            "that lead there, and NUTS, follow the gradient. jaxvision.render and capture "
            "include the edges of spheres, discs, quads and boxes by edges=jaxvision.Edges().",
            stacklevel=3,
        )


def _geometric(problem: Problem) -> Iterator[str]:
    """Yield the free paths whose change may move an edge in the picture."""
    paths = [parameter.name for parameter in problem.free if is_path(parameter.name)]
    if not paths:
        return
    # here: most problems have no scene, and this takes a third of the import of `fit`
    from jaxvision.rendering.direct import can_shade
    from jaxvision.scene import Camera, Scene, View

    for name in paths:
        record = problem.records.get(head(name))
        within = name[len(head(name)) + 1 :]
        if isinstance(record, View) or (isinstance(record, Camera) and within.startswith("view.")):
            yield name
        if not isinstance(record, Scene):
            continue
        if within.startswith("surfaces[") and ".shape." in within:
            yield name
        shaded = can_shade(record.surfaces) if record.occluders is None else record.occluders
        if within.startswith("lights[") and shaded:
            light, field = within[7:].partition("]")[::2]
            if field[1:].partition("[")[0] not in record.lights[int(light)].spectra:
                yield name


@eqx.filter_jit
def _compare_derivatives(problem: Problem, values: Values, step: Values) -> Array:
    """Compare the derivative of the prediction with finite differences. Let D be the change of the
    picture by a central difference over half of `step`. Return three norms over blocks of pixels:
    of D, of D minus the derivative, and of D minus the difference over the whole `step`.
    """

    def picture(share: Array) -> Array:
        moved = values | {name: values[name] + share * by for name, by in step.items()}
        return _block_means(prediction(problem, moved))

    shares = jnp.array([1.0, -1.0, 0.5, -0.5, 0.0])  # evaluated by one compiled program
    there, along = map_(lambda x: jax.jvp(picture, (x,), (jnp.ones_like(x),)), shares)
    full, half = (there[0] - there[1]) / 2, there[2] - there[3]
    return jnp.stack([jnp.sqrt(jnp.sum(x**2)) for x in (half, half - along[4], full - half)])


def _block_means(picture: Array) -> Array:
    """Return the picture's means over blocks of pixels. Single pixels would miss edges, because an
    edge crosses few pixels in a small step.
    """
    if picture.ndim < 2:
        return picture
    sides = [max(_LEAST, -(-size // _BLOCKS)) for size in picture.shape[:2]]
    rows, columns = (size // side for size, side in zip(picture.shape[:2], sides, strict=True))
    if not rows * columns:
        return picture
    whole = picture[: rows * sides[0], : columns * sides[1]]
    return whole.reshape(rows, sides[0], columns, sides[1], *picture.shape[2:]).mean((1, 3))
