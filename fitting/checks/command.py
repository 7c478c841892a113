"""The implementation of `jaxvision-fit check`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from jaxvision import __version__

from ..report.progress import Reporter
from ..report.section import Section
from . import emva1288, joint, noise, reflectance, response
from .coverage import coverage
from .section import section
from .simulations import simulated

SEEDS = 1_000_000  # seeds between two cases: most simulations of a seed
KINDS = {
    "brdf": reflectance,
    "emva1288": emva1288,
    "joint": joint,
    "noise": noise,
    "response": response,
}


def run(
    kind: str, simulations: int, kept: Path | None, reporter: Reporter, *, seed: int = 0
) -> Section:
    """Check the coverage of the intervals in all simulated cases of one kind of fit, such as
    "noise"."""
    room, found = KINDS[kind], {}
    file = f"{kind}, {{}}, seed {seed}, {__version__}.npy"
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
    for name, case in room.CASES.items():
        with reporter.step(name) as progress:
            rows = simulated(
                partial(_places, room.places, case, seed),
                simulations,
                parameters=len(room.NAMES),
                kept=None if kept is None else kept / file.format(name),
                progress=progress,
            )
        found[name] = coverage(rows, room.NAMES)
    return section(kind, found, simulations)


def _places(places: Callable[..., np.ndarray], case: object, seed: int, number: int) -> np.ndarray:
    return places(case, seed * SEEDS + number)
