"""What `jaxvision-fit check` runs."""

from functools import partial
from importlib.metadata import version
from pathlib import Path

from ..report.progress import Reporter
from ..report.section import Section
from . import joint, noise, reflectance, response
from .coverage import coverage
from .section import section
from .simulations import simulated

KINDS = {"brdf": reflectance, "joint": joint, "noise": noise, "response": response}


def run(kind: str, simulations: int, kept: Path | None, reporter: Reporter) -> Section:
    """Checks every case of a kind.

    Args:
        kind: of fit, "brdf", "joint", "noise" or "response".
        simulations: fits of each case.
        kept: folder in which fits are kept, so that another run goes on from them; None for none.
        reporter: told of every fit.

    Returns:
        Coverage of every case.
    """
    room, found = KINDS[kind], {}
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
    for name, case in room.CASES.items():
        with reporter.step(name) as progress:
            rows = simulated(
                partial(room.places, case),
                simulations,
                parameters=len(room.NAMES),
                kept=None if kept is None else kept / f"{kind}, {name}, {version('jaxvision')}.npy",
                progress=progress,
            )
        found[name] = coverage(rows, room.NAMES)
    return section(kind, found, simulations)
