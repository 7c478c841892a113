"""Choose the settings of a scene file for a given tolerance or render time. Each knob is measured
separately. The best combination of settings is checked by runs with fresh seeds. The choice is
cached on disk."""

import hashlib
import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .. import __version__
from ..core.side_by_side import cores
from ..effects import Pruned
from ..errors import InputError
from ..files.images import replaced_on_success
from ..files.scenes import SceneFile
from ..files.scenes.schema import RenderEntry
from ..render_command import prune_scene, pruned_scene
from .curves import KEPT, LEAST, WORTH, asked_knobs, curve, measure_in_turn
from .deadlines import OutOfTime, TooLittleTime, run_within
from .knobs import KNOBS
from .norms import rms
from .records import Curve, Knob, Problem
from .scenes import SEPARATE_KNOBS, entry_of, knobs_of, scene_problem
from .session import Clock, part_seconds
from .several import Together, all_together, combine_and_check

EFFECTS_SHARE = 0.25  # share of the tolerance for dropped effects
CHECK_SHARE = 0.35  # share of the time budget for the check
COMBINATION_SHARE = 0.25  # share of the measuring time for the checks of combinations
PRUNING_SHARE = 0.5  # share of the time budget for pruning, after which the scene is rendered whole


@dataclass(frozen=True)
class Chosen:
    """The settings chosen for a scene file, and their predicted error and time.

    Attributes:
        render: settings of `[render]`.
        effects: the scene without the effects that the tolerance allows to drop, or None.
        promised: upper limit of the picture's relative root mean square error, for any seed.
        predicted_seconds: time of the whole picture with compilation, s.
        checked: whether runs with fresh seeds, compared with a finer picture, have confirmed the
            error; False if the time was too short.
        settings: chosen values of the settings that were changed, by name.
        unknown: knobs that keep their setting because the time was too short to estimate their
            errors; `promised` does not include these errors.
        curves: measured curves of each setting; empty where the choice comes from the cache.
    """

    render: RenderEntry
    effects: Pruned | None
    promised: float
    predicted_seconds: float
    checked: bool
    settings: Mapping[str, Any]
    unknown: tuple[str, ...] = ()
    curves: tuple[Curve, ...] = ()


def measured(
    source: SceneFile,
    settings: RenderEntry,
    *,
    names: tuple[str, ...] | None = None,
    seconds: float = 60.0,
    expand: np.ndarray | None = None,
    metrics: tuple[str, ...] = ("rms", "p99", "max"),
    clock: Clock | None = None,
    problem: Problem | None = None,
) -> tuple[Problem, tuple[Curve, ...]]:
    """Measure error against time for the settings of a scene file, with equal shares of the time.

    Args:
        source: the scene and its view.
        settings: settings of `[render]`.
        names: names of the settings to measure; None for all that change the picture.
        seconds: time budget, s.
        expand: as in `scene_problem`.
        metrics: as in `curve`.
        clock: function that returns seconds; None for the machine's clock.
        problem: the problem of the scene file, where it exists already; None makes it.

    Returns:
        The problem and the curves.

    Raises:
        InputError: for a knob that the scene file does not have.
    """
    known = knobs_of(source, settings)
    chosen = asked_knobs(str(source.path), names, known)
    now = clock or time.perf_counter
    until = now() + seconds
    if problem is None:
        problem = scene_problem(
            source, settings=settings, expand=expand, seconds=seconds, clock=clock
        )
    own = problem

    def measure(name: str, share: float) -> Curve:
        turned = _add_base(KNOBS[name], own.settings.get(name))
        return curve(own, turned, seconds=share, metrics=metrics, clock=clock)

    worth = WORTH if own.compiled is None else KEPT
    return own, measure_in_turn(chosen, measure, seconds=until - now(), worth=worth, clock=clock)


def measured_together(
    source: SceneFile,
    *,
    names: Sequence[str] | None = None,
    seconds: float = 60.0,
    metrics: tuple[str, ...] = ("rms", "p99", "max"),
    clock: Clock | None = None,
) -> tuple[Problem, tuple[Curve, ...], tuple[Together, ...]]:
    """Measure error against time for the settings of a scene file; then, in the last quarter of the
    time, check the best combinations by fresh runs.

    Args:
        source: the scene and its view, with its settings of `[render]`.
        names: names of the settings to measure; None for all that change the picture.
        seconds: time budget, s.
        metrics: as in `curve`.
        clock: function that returns seconds; None for the machine's clock.

    Returns:
        The problem, the curves, and the settings for each of `TOLERANCES`.

    Raises:
        InputError: for a knob that the scene file does not have.
    """
    now = clock or time.perf_counter
    until = now() + seconds
    asked = asked_knobs(str(source.path), names, knobs_of(source, source.render))
    several = len(set(asked) - set(SEPARATE_KNOBS)) > 1
    problem, curves = measured(
        source,
        source.render,
        names=asked,
        seconds=(1 - COMBINATION_SHARE) * seconds if several else seconds,
        metrics=metrics,
        clock=clock,
    )
    ended = any(curve.stopped == "interrupted" for curve in curves)
    left = 0.0 if ended else until - now()
    return problem, curves, all_together(problem, curves, seconds=left, clock=clock)


def _add_base(knob: Knob, base: Any) -> Knob:
    """Add the value in the scene file to the values of a knob that are measured."""
    if base is None or isinstance(base, str) or base in knob.settings:
        return knob
    if base >= max(knob.reference):
        return knob
    return replace(knob, settings=tuple(sorted({*knob.settings, base})))


def settings(
    scene_file: SceneFile,
    *,
    tolerance: float | None = None,
    render_seconds: float | None = None,
    seconds: float = 240.0,
    cache: bool = True,
    clock: Clock | None = None,
) -> Chosen:
    """Choose the cheapest settings of a scene file whose error is within a tolerance, or the most
    accurate ones whose render time is within a limit.

    Up to a quarter of the tolerance is spent on dropping effects whose contribution has a proved
    bound (`effects.prune`). The rest of the tolerance is spent on the settings. If a render time is
    given, only effects that provably change nothing are dropped.

    Args:
        scene_file: the scene file, from `read_scene`.
        tolerance: relative root mean square error over the pixels, above 0.
        render_seconds: time limit of the whole render, s.
        seconds: time budget of the measurement, s.
        cache: whether to store the settings for this scene, machine and version, and to use stored
            ones.
        clock: function that returns seconds; None for the machine's clock.

    Returns:
        The settings.

    Raises:
        InputError: unless exactly one of tolerance and time is given, above 0, and where no setting
            meets it; `deadlines.TooLittleTime` where the measurement ran out of time before.
    """
    goal = tolerance if render_seconds is None else render_seconds
    if goal is None or (tolerance is not None and render_seconds is not None) or not goal > 0:
        raise InputError("give either a tolerance or a time to render, above 0.")
    file = _cache_path(scene_file, tolerance, render_seconds)
    known = _read(file, seconds) if cache else None
    if known is not None:
        return _make_choice(scene_file, known, _prune(scene_file, tolerance, known["level"]))
    now = clock or time.perf_counter
    until, own = now() + seconds, scene_file.render
    problem, level = None, None
    if tolerance is not None:
        problem = scene_problem(scene_file, settings=own, seconds=seconds, clock=clock)
        picture = np.asarray(problem.prepare(problem.settings)(0), np.float64)
        picture = picture if problem.compared is None else problem.compared(picture)
        level = rms(picture)
    pruned, prunable = None, until - (1 - PRUNING_SHARE) * seconds
    with suppress(OutOfTime):
        pruned = run_within(lambda: _prune(scene_file, tolerance, level), lambda: prunable - now())
    if pruned is not None and pruned.certificate.dropped:
        problem = None
    left, _ = pruned_scene(scene_file, own, pruned)
    remains = until - now()
    if remains < LEAST:
        raise _insufficient_time(scene_file, seconds)
    names = tuple(name for name in knobs_of(left, own) if name not in SEPARATE_KNOBS)
    problem, curves = measured(
        left,
        own,
        names=names,
        seconds=(1 - CHECK_SHARE) * remains,
        expand=None if pruned is None else pruned.expand,
        clock=clock,
        problem=problem,
    )
    if any(one.stopped == "interrupted" for one in curves):
        raise KeyboardInterrupt
    compiling = _compile_seconds(problem, curves)
    gone = 0.0 if pruned is None or tolerance is None else pruned.certificate.total
    wanted = None if tolerance is None else tolerance - gone
    allowed = None if render_seconds is None else render_seconds - compiling
    if allowed is not None and allowed <= 0:
        raise InputError(
            f"{scene_file.path}: compiling takes about {compiling:.2g} s before the first pixel; "
            f"allow more than {render_seconds:g} s, or render with the settings of the scene."
        )
    if not any(np.isfinite(trial.error) for curve in curves for trial in curve.trials):
        raise _insufficient_time(scene_file, seconds)
    try:
        best, checked = combine_and_check(
            problem, curves, wanted, allowed, seconds=until - now(), clock=clock
        )
    except InputError as error:
        if any(one.stopped.startswith("out of time") for one in curves):
            raise TooLittleTime(str(error)) from error
        raise
    known = {
        "settings": dict(best.settings),
        "promised": best.error + gone,
        "predicted_seconds": _compile_seconds(problem, curves, chosen=best.settings) + best.seconds,
        "checked": checked,
        "unknown": list(best.unknown),
        "level": level,
        "measured_in": seconds,
    }
    if cache:
        _write(file, known)
    return replace(_make_choice(scene_file, known, pruned), curves=curves)


def _insufficient_time(scene_file: SceneFile, seconds: float) -> TooLittleTime:
    return TooLittleTime(
        f"{scene_file.path}: no error was measured within {seconds:.3g} s; allow more time to "
        "measure."
    )


def _compile_seconds(
    problem: Problem, curves: Sequence[Curve], *, chosen: Mapping[str, Any] | None = None
) -> float:
    """Return the longest compile time, s, over chosen settings, or all if None."""
    compiled = [
        trial.first_seconds - part_seconds(problem, trial.seconds)
        for one in curves
        for trial in one.trials
        if chosen is None or trial.setting == chosen.get(one.knob.name)
    ]
    return max([problem.compiling, *compiled])


def _make_choice(scene_file: SceneFile, known: Mapping[str, Any], pruned: Pruned | None) -> Chosen:
    return Chosen(
        entry_of(scene_file.render, known["settings"]),
        pruned,
        known["promised"],
        known["predicted_seconds"],
        known["checked"],
        known["settings"],
        tuple(known["unknown"]),
    )


def _prune(source: SceneFile, tolerance: float | None, level: float | None) -> Pruned | None:
    """Drop the negligible effects for paths of up to the largest measured depth."""
    own, deepest = source.render, KNOBS["depth"].reference[-1]
    deep = own.model_copy(update={"depth": max(own.depth, deepest)})
    share = "0" if tolerance is None else f"{EFFECTS_SHARE * tolerance:.6e}"
    try:
        return prune_scene(source, deep, share, level=level)
    except InputError:  # a scene without any bound is rendered whole
        return None


def _cache_path(source: SceneFile, tolerance: float | None, render_seconds: float | None) -> Path:
    """Return the path of the cache file for the settings of this scene, machine and version."""
    key = {
        "scene": source.digest,
        "resolution": list(source.view.resolution),
        "render": source.render.model_dump(),
        "tolerance": tolerance,
        "render_seconds": render_seconds,
        "machine": machine(),
        "jaxvision": __version__,
        "jax": jax.__version__,
    }
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "jaxvision" / "accuracy" / f"{digest[:32]}.json"


def machine() -> str:
    """Describe cores, processor, accelerators and JAX's version in one line."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        pass
    devices = jax.devices()
    kind = "" if devices[0].platform == "cpu" else f", {len(devices)} x {devices[0].device_kind}"
    return f"{cores()} x {name}{kind}, jax {jax.__version__}"


def _read(file: Path, seconds: float) -> dict[str, Any] | None:
    """Read cached settings, if they were measured for at least `seconds` s, or None."""
    keys = {"settings", "promised", "predicted_seconds", "checked", "unknown", "level"}
    try:
        found = json.loads(file.read_text())
        known = keys <= found.keys() and found["measured_in"] >= seconds
    except (OSError, ValueError, TypeError, AttributeError, KeyError):
        return None
    return found if known else None


def _write(file: Path, found: Mapping[str, Any]) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with replaced_on_success(file) as partial:
            partial.write_text(json.dumps(found, indent=2))
    except OSError:
        pass  # the picture is rendered even if the choice cannot be stored
