"""A check for light that is trapped between surfaces without absorption, for which the radiosity
equation has no solution."""

import numpy as np
from jaxtyping import Float

from ._grid import Plan, parents_of, surfaces_of
from .solve import CLOSED

_BESIDE = 0.5  # an element with a smaller sum of form factors counts as outside any room


def trapping_surface(
    table: Float[np.ndarray, "elements patches"],
    albedo: Float[np.ndarray, "surfaces bands"],
    plan: Plan,
) -> int | None:
    """Return the first surface that traps light in some band. A surface traps light if it and all
    surfaces with which it exchanges light are white, and less than 2e-3 of the light escapes from
    them.

    Args:
        table: (elements, patches) form factors, no unit.
        albedo: (surfaces, bands), no unit.
        plan: of the patches.

    Returns:
        The index of the surface, no unit; None if there is none.
    """
    own, surface = parents_of(plan), surfaces_of(plan)
    inside = table.sum(axis=1) > _BESIDE
    count = table.shape[1]
    for band in albedo[surface].T:
        loses = band < 1 - 16 * np.finfo(band.dtype).eps
        while True:  # an element that sees a patch with losses loses light too
            meets = (table @ loses.astype(table.dtype) > 0) & inside
            more = loses | (np.bincount(own[meets], minlength=count) > 0)
            if (more == loses).all():
                break
            loses = more
        kept = ~loses[own] & inside
        if kept.any() and table[kept].sum(axis=1).mean() > 1 - CLOSED:
            return int(surface[own[kept][0]])
    return None
