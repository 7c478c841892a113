"""Many simulated fits, kept as they come, so that a check goes on where it was interrupted."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxvision.errors import InputError

BLOCK = 20  # fits between two writings

Simulate = Callable[[int], Float[np.ndarray, " parameters"]]


def simulated(
    simulate: Simulate,
    count: int,
    *,
    parameters: int,
    kept: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Float[np.ndarray, "simulations parameters"]:
    """The places of the truth in the posteriors of many fits.

    Args:
        simulate: a seed to the places, (parameters,); `InputError` from it counts as no interval.
        count: of fits, with seeds from 0.
        parameters: of each.
        kept: where places are kept between runs; None for nowhere.
        progress: called with (done, count).

    Returns:
        (simulations, parameters), NaN where a fit gave no interval.
    """
    rows = np.empty((0, parameters))
    if kept is not None and kept.exists():
        rows = np.load(kept)[:count]
    for seed in range(len(rows), count):
        try:
            row = simulate(seed)
        except InputError:
            row = np.full(parameters, np.nan)
        rows = np.vstack([rows, row])
        progress(len(rows), count)
        if kept is not None and (len(rows) % BLOCK == 0 or len(rows) == count):
            np.save(kept, rows)
    return rows
