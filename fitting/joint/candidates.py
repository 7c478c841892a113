"""Optional terms of a fit: errors that the rig states, and a misfit.

An error that all pixels of an image share is not averaged over them, so it is compared with the
combined noise of all (`inference.left_out`). Its scale is taken at the upper end of its prior, so
that the bound is valid for every fitted scale. A misfit is needed if the cells scatter more than
noise and the stated errors allow.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..inference.left_out import LeftOut, distance, negligible
from ..inference.parameters import Parameter, to_natural, to_unconstrained
from .model import SCATTERS, JointData, predicted_parts

WIDEST = 3.0  # standard deviations of the prior of an error's size
MISFIT = Parameter("misfit", symbol="ρ", unit="1", lower=0.0, upper=1.0)
MOST_AT_FIRST = 0.5


def without_small_errors(
    data: JointData, vector: Array
) -> tuple[JointData, Array, tuple[LeftOut, ...]]:
    """Return data and unconstrained vector without the errors that are negligible in total, and
    those errors in standard deviations of the noise of all data. The dropped errors are not
    traced."""
    scatters = [parameter for parameter in data.space if parameter.name in SCATTERS]
    if not scatters:
        return data, vector, ()
    natural = to_natural(data.space, vector)
    for i, parameter in enumerate(data.space):
        if parameter.name in SCATTERS:
            most = parameter.prior.median * np.exp(WIDEST * parameter.prior.log_sd)
            natural = natural.at[i].set(most)
    model, weight, of_cells = predicted_parts(to_unconstrained(data.space, natural), data)
    found, at = [], 0
    for parameter in scatters:
        name = parameter.name
        if name == "prnu":
            squares = (np.asarray(weight) * np.asarray(of_cells) ** 2).sum(0)
            count = np.asarray(data.cells.count).max(0)  # pixels of a cell, each of its own
        else:
            rows = 2 if name == "direction_scatter" else 1
            errors = np.asarray(model.image_errors)[:, at : at + rows]
            squares, count = (np.asarray(weight)[:, None] * errors**2).sum((1, 2)), 1.0
            at += rows
        found.append(LeftOut(name, parameter.prior.median, distance(squares, parts=count)))
    gone = negligible(found)
    named = {own.name for own in gone}
    left = [i for i, parameter in enumerate(data.space) if parameter.name not in named]
    cells = replace(data.cells, products=None) if "prnu" in named else data.cells
    relative = {name: size for name, size in data.relative.items() if name not in named}
    space = tuple(data.space[i] for i in left)
    data = replace(data, space=space, cells=cells, relative=relative)
    return data, vector[np.array(left)], gone


def with_misfit(data: JointData, vector: Array) -> tuple[JointData, Array]:
    """Return the data and start of a model with a misfit, whose size the cells' residuals give.

    The cells must be about the start. About the best model without a misfit, its gain and read
    noise have already taken up part of the misfit."""
    data = replace(data, space=(*data.space, MISFIT))

    def starting(size: float) -> Array:
        return jnp.concatenate([vector, to_unconstrained((MISFIT,), jnp.asarray([size]))])

    model, weight, _ = predicted_parts(starting(MOST_AT_FIRST), data)
    unit = np.asarray(model.misfit) / MOST_AT_FIRST
    seen = np.asarray(weight) > 0
    squares = np.asarray(data.cells.mean - model.mean)[seen] ** 2
    size = float(np.sqrt(squares.mean() / np.mean(unit[seen] ** 2)))
    return data, starting(min(size, MOST_AT_FIRST))
