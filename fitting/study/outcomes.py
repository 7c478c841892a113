"""Calibrate one folder of a study and write its report, like a single command. The result is stored
next to the report for later runs.
"""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxvision import __version__
from jaxvision.errors import InputError
from jaxvision.files.images import replaced_on_success, write_image
from jaxvision.tasks import PROGRAMS

from .. import folders
from ..inference.estimates import Estimate
from ..inference.precision import double_precision
from ..report.page import as_json, write_report
from ..report.progress import Progress
from ..report.section import Section
from ..rig import Rig, load_rig

Kind = Literal["noise", "response", "brdf", "joint"]
TITLES: dict[Kind, str] = {
    "noise": "Photon transfer",
    "response": "Camera response",
    "brdf": "Reflectance",
    "joint": "Joint calibration",
}
REMEMBERED = "outcome.json"
RESULTS = "results.json"
_LARGER = 0.25e9  # bytes more for photon transfer: 12 frames of 64 x 64 took .74 GB in all
_PART = 65536  # bytes
_COPIES = 4  # copies of the files: 50 MB of PNG (1536 x 1536 pixels) took .16 GB more


@dataclass(frozen=True)
class Outcome:
    """The results of one folder of a study.

    Attributes:
        camera: name of the folder in the study.
        estimates: estimates of its calibration; empty where it failed.
        findings: sentences of the folder's report.
        failed: why there is no calibration; "" where there is one.
        date: ISO 8601, from the rig; "" where it has none.
        temperature: K, from the rig, or None.
    """

    camera: str
    estimates: tuple[Estimate, ...] = ()
    findings: tuple[str, ...] = ()
    failed: str = ""
    date: str = ""
    temperature: float | None = None


@dataclass(frozen=True)
class Folder:
    """One folder of a study: its name, the paths of its rig and report, and the state of its
    files."""

    camera: str  # name of the folder in the study
    path: Path  # path of the rig
    out: Path  # folder for the report
    digest: str  # hash of the rig and its images at the start of the study
    changed: int  # time of the latest change of these files, ns
    memory: float  # memory that the folder's calibration needs, bytes


@dataclass(frozen=True)
class Settings:
    """The settings that all folders of a study share.

    Attributes:
        kind: kind of calibration.
        seed: seed of every draw.
        reports: whether to draw each folder's report, which takes most of the time.
    """

    kind: Kind
    seed: int = 0
    reports: bool = True

    @property
    def result_file(self) -> str:
        """Return the name of the file that shows a folder's results: the report, or the JSON
        file.
        """
        return "report.html" if self.reports else RESULTS


def digest_of(path: Path) -> str:
    """Return a hash that identifies the data of a folder. It is computed from the rig file and, for
    every image, from its name, its size, and parts at its beginning, middle and end.
    """
    rig = load_rig(path)
    found = hashlib.sha256(rig.model_dump_json(exclude={"folder"}).encode())
    for file in _images(rig):
        found.update(f"{file.name}\n".encode())
        if file.is_file():
            found.update(_excerpt(file))
    return found.hexdigest()[:16]


def frames_of(path: Path) -> frozenset[str]:
    """Return hashes of the images of a folder that do not depend on the images' names or on the
    rig, except its region.
    """
    rig = load_rig(path)
    region = repr(rig.camera.region).encode()
    files = (file for file in _images(rig) if file.is_file())
    return frozenset(hashlib.sha256(region + _excerpt(file)).hexdigest()[:16] for file in files)


def _excerpt(file: Path) -> bytes:
    """Return the size of a file and three excerpts of it. Because of noise, no two images have
    equal excerpts.
    """
    size = file.stat().st_size
    parts = [f"{size}\n".encode()]
    try:
        with file.open("rb") as stream:
            for start in (0, (size - _PART) // 2, size - _PART):
                stream.seek(max(start, 0))
                parts.append(stream.read(_PART))
    except OSError:  # its calibration reports it
        pass
    return b"".join(parts)


def changed_at(path: Path) -> int:
    """Return the modification time of the newest image of a folder."""
    return max(
        (file.stat().st_mtime_ns for file in _images(load_rig(path)) if file.exists()), default=0
    )


def memory_of(path: Path) -> float:
    """Estimate the memory for calibrating a folder, in bytes: its programs and several copies of
    its images.
    """
    files = [file for file in _images(load_rig(path)) if file.exists()]
    return PROGRAMS + _LARGER + _COPIES * sum(file.stat().st_size for file in files)


def _images(rig: Rig) -> list[Path]:
    several = [name for entry in (*rig.flat, *rig.dark) for name in entry.files]
    single = [entry.file for entry in (*rig.exposure, *rig.light)]
    return [rig.path(name) for name in (*several, *single)]


def key_of(settings: Settings, folder: Folder) -> dict[str, Any]:
    """Return everything that an outcome depends on."""
    return {
        **asdict(settings),
        "digest": folder.digest,
        "changed": folder.changed,
        "jaxvision": __version__,
    }


def remembered(settings: Settings, folder: Folder) -> Outcome | None:
    """Return the result of an earlier run on the same data, or None. For a folder that failed the
    result is None, so that it is tried again.
    """
    try:
        found = json.loads((folder.out / REMEMBERED).read_text())
        outcome = _read(found["outcome"]) if found["key"] == key_of(settings, folder) else None
    except (OSError, ValueError, LookupError, TypeError):  # none, or a damaged one
        return None
    return None if outcome is None or outcome.failed else outcome


@double_precision
def calibrated(settings: Settings, folder: Folder) -> Outcome:
    """Calibrate a folder, write its report, and store the outcome. If a folder cannot be
    calibrated, the outcome gives the reason."""
    try:
        digest, rig = digest_of(folder.path), load_rig(folder.path)
    except InputError as error:
        found = Outcome(folder.camera, failed=str(error))
        _remember(settings, folder, found)
        return found
    if digest != folder.digest:
        raise InputError(
            f"{folder.path}: this worker sees other files than the study did; give all machines "
            "the same data under the same path."
        )
    known = Outcome(
        folder.camera,
        date="" if rig.camera.date is None else rig.camera.date.isoformat(),
        temperature=rig.camera.temperature,
    )
    calibrate = getattr(folders, settings.kind)
    more = {"model": "phong", "index": 1.5} if settings.kind in ("brdf", "joint") else {}
    laplace = {"sampling": None, "seed": settings.seed}
    try:
        sections, images = calibrate(folder.path, _silent, lambda *_: laplace, **more)
        if sections and all(section.failure for section in sections):
            raise InputError(sections[0].failure)
        folder.out.mkdir(parents=True, exist_ok=True)
        for name, pixels in images.items():
            write_image(folder.out / name, pixels)
        _report(settings, folder, sections)
    except InputError as error:
        found = replace(known, failed=str(error))
    except OSError as error:  # concerns one folder: the study continues
        found = replace(known, failed=f"{error.filename or folder.out}: {error.strerror or error}")
    else:
        found = replace(
            known,
            estimates=tuple(one for section in sections for one in section.estimates),
            findings=tuple(words for section in sections for words in section.findings),
        )
    _remember(settings, folder, found)
    return found


def _report(settings: Settings, folder: Folder, sections: list[Section]) -> None:
    own = {"input": folder.path.name, **asdict(settings)}
    if settings.reports:
        title = f"{TITLES[settings.kind]}: {folder.camera}"
        write_report(folder.out, sections, title=title, seed=settings.seed, settings=own)
        return
    with replaced_on_success(folder.out / RESULTS) as whole:
        text = as_json(sections, seed=settings.seed, settings=own)
        whole.write_text(text, encoding="utf-8")


@contextmanager
def _silent(description: str) -> Iterator[Progress]:
    """Provide a step that prints nothing. For many folders only the finished ones are reported."""
    yield lambda done, total: None


def _remember(settings: Settings, folder: Folder, found: Outcome) -> None:
    content = {"key": key_of(settings, folder), "outcome": asdict(found)}
    try:
        with replaced_on_success(folder.out / REMEMBERED) as whole:
            whole.write_text(json.dumps(content, indent=1, default=_python_numbers))
    except InputError:
        if not found.failed:  # an unwritable folder may have caused the failure
            raise


def _python_numbers(value: Any) -> Any:
    return np.asarray(value).tolist()


def _read(found: dict[str, Any]) -> Outcome:
    def interval(one: list[float] | None) -> tuple[float, float] | None:
        return None if one is None else (one[0], one[1])

    estimates = tuple(
        Estimate(
            **{
                **entry,
                "interval_68": interval(entry["interval_68"]),
                "interval_95": interval(entry["interval_95"]),
            }
        )
        for entry in found["estimates"]
    )
    return Outcome(**{**found, "estimates": estimates, "findings": tuple(found["findings"])})
