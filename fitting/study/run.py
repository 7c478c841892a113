"""Run a study: from the paths of many folders to their reports, one table and one page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import xarray as xr

from jaxvision.errors import InputError
from jaxvision.files.images import replaced_on_success
from jaxvision.tasks import map_ordered

from ..report.progress import Progress
from .compare import Compared, Drift, compared, drifts
from .outcomes import (
    TITLES,
    Folder,
    Outcome,
    Settings,
    calibrated,
    changed_at,
    digest_of,
    frames_of,
    memory_of,
    remembered,
)
from .page import page
from .table import table, write_table

SHARED = 0.5  # share of common images above which two folders count as one camera


@dataclass(frozen=True)
class Study:
    """The results of calibrating many folders with the same settings.

    Attributes:
        outcomes: one for each folder, in the given order.
        found: table of all results, as in `study.nc`.
        quantities: comparison of each quantity between the cameras, in its unit.
        drifts: drifts of quantities with date or temperature.
    """

    outcomes: tuple[Outcome, ...]
    found: xr.Dataset
    quantities: tuple[Compared, ...]
    drifts: tuple[Drift, ...]


def study(
    paths: Sequence[Path],
    out: Path,
    settings: Settings,
    *,
    progress: Progress = lambda done, total: None,
) -> Study:
    """Calibrate many folders, on the workers of `jaxvision.cluster` if there are any. Results of an
    earlier run by the same version on the same data are reused.

    Args:
        paths: paths of the rigs; workers use the same paths.
        out: folder for the reports, one for each rig, and for `study.nc` and `study.html`.
        settings: settings of all calibrations.
        progress: called with (folders done, all folders).

    Returns:
        The study. A folder that cannot be calibrated, or that repeats the images of another one, is
        listed with the reason, and the others continue.

    Raises:
        InputError: for an empty list, for two folders of one name, and for a worker whose software
            or data differ from this process.
    """
    asked = _name_folders(paths, out)
    outcomes = {folder.camera: remembered(settings, folder) for folder in asked}
    outcomes |= _copies(asked)
    left = [folder for folder in asked if outcomes[folder.camera] is None]
    done = len(asked) - len(left)
    progress(done, len(asked))
    largest = max((folder.memory for folder in left), default=0.0)
    for outcome in map_ordered(calibrated, settings, left, memory=largest):
        outcomes[outcome.camera] = outcome
        done += 1
        progress(done, len(asked))
    every = tuple(outcome for outcome in outcomes.values() if outcome is not None)
    found = table(every)
    result = Study(every, found, compared(found), drifts(found))
    write_table(out / "study.nc", found)
    title = f"{TITLES[settings.kind]} of {len(every)} folders"
    with replaced_on_success(out / "study.html") as whole:
        parts = result.outcomes, found, result.quantities, result.drifts
        text = page(title, *parts, shown=settings.result_file)
        whole.write_text(text, encoding="utf-8")
    return result


def _copies(folders: Sequence[Folder]) -> dict[str, Outcome]:
    """Return a failed outcome for each folder that shares more than half of its images with an
    earlier folder: they show the same camera, which must not count twice.
    """
    before: dict[str, frozenset[str]] = {}
    found = {}
    for folder in folders:
        try:
            own = frames_of(folder.path)
        except InputError:  # reported when the folder is calibrated
            continue
        for name, others in before.items():
            shared = len(own & others)
            if shared and shared > SHARED * min(len(own), len(others)):
                why = (
                    f"{shared} of its {len(own)} images are those of {name}, so that the two are "
                    "one camera; give it its own, or leave it out."
                )
                found[folder.camera] = Outcome(folder.camera, failed=why)
                break
        before[folder.camera] = own
    return found


def _name_folders(paths: Sequence[Path], out: Path) -> list[Folder]:
    """Return the folders with their names. A folder that cannot be read is reported when it is
    calibrated.
    """
    if not paths:
        raise InputError("a study needs folders; name at least one.")
    if not any(path.exists() for path in paths):
        raise InputError(f"{paths[0]}: no such folder{', nor the others' * (len(paths) > 1)}.")
    names = [path.resolve().name if path.is_dir() else path.stem for path in paths]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name}: two folders have this name; rename one of them.")
    found = []
    for name, path in zip(names, paths, strict=True):
        try:
            digest, changed, memory = digest_of(path), changed_at(path), memory_of(path)
        except InputError:
            digest, changed, memory = "", 0, 0.0
        found.append(Folder(name, path.resolve(), out.resolve() / name, digest, changed, memory))
    return found
