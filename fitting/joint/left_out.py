"""Which of the errors that a rig names its likelihood calls for.

An error shared by all pixels of an image is not averaged over them: it is compared with the noise
of all of them together (`inference.left_out`). It is taken at the upper end of what its prior
allows, so that the bound holds wherever a fit may go.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Array

from ..inference.left_out import LeftOut, distance, negligible
from ..inference.parameters import ParameterSpace, to_natural, to_unconstrained
from .model import JointData, Prediction, Table
from .start import SCATTERS

WIDEST = 3.0  # standard deviations of the prior of an error's size


def widest(vector: Array, space: ParameterSpace) -> Array:
    """Return an unconstrained vector with every error as large as its prior allows."""
    natural = to_natural(space, vector)
    for i, parameter in enumerate(space):
        if parameter.name in SCATTERS:
            most = parameter.prior.median * np.exp(WIDEST * parameter.prior.log_sd)
            natural = natural.at[i].set(most)
    return to_unconstrained(space, natural)


def small(
    data: JointData, model: Prediction, weight: Table, of_cells: Table | None
) -> tuple[LeftOut, ...]:
    """Return the errors that are negligible all together, the smallest first, in standard
    deviations of the noise of all data. `model`, `weight` (DN^-2, noise alone) and `of_cells` (DN)
    are at `widest`."""
    found = []
    at = 0
    for parameter in data.space:
        name = parameter.name
        if name not in SCATTERS:
            continue
        if name == "prnu":
            squares = (np.asarray(weight) * np.asarray(of_cells) ** 2).sum(0)
            count = np.asarray(data.cells.count).max(0)  # pixels of a cell, each of its own
        else:
            rows = 2 if name == "direction_scatter" else 1
            errors = np.asarray(model.image_errors)[:, at : at + rows]
            squares, count = (np.asarray(weight)[:, None] * errors**2).sum((1, 2)), 1.0
            at += rows
        found.append(LeftOut(name, parameter.prior.median, distance(squares, parts=count)))
    return negligible(found)


def without(data: JointData, vector: Array, gone: tuple[LeftOut, ...]) -> tuple[JointData, Array]:
    """Return data and unconstrained vector without some errors, which are then not traced."""
    named = {own.name for own in gone}
    if not named:
        return data, vector
    left = [i for i, parameter in enumerate(data.space) if parameter.name not in named]
    cells = replace(data.cells, products=None) if "prnu" in named else data.cells
    relative = {name: size for name, size in data.relative.items() if name not in named}
    space = tuple(data.space[i] for i in left)
    return replace(data, space=space, cells=cells, relative=relative), vector[np.array(left)]
