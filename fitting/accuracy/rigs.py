"""State the calibrations of a rig as problems of accuracy, whose settings can be varied."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec

import numpy as np

from jaxvision.accuracy import Curve, Problem, curve
from jaxvision.accuracy.curves import LEAST, asked_knobs, measure_in_turn
from jaxvision.accuracy.deadlines import OutOfTime, run_within
from jaxvision.accuracy.session import Clock
from jaxvision.errors import InputError
from jaxvision.files.images import read_image

from ..observation import Load
from ..rig import NEEDED, Purpose, Rig, require_images
from .chains import Turn
from .knobs import KNOBS, RIG_KNOBS

ABOUT = (
    "Errors are root mean squares over the results in units of their standard errors: 10 % is a "
    "tenth of a standard error."
)
FITS: Mapping[str, Purpose] = {
    "noise": "photon transfer",
    "response": "a response calibration",
    "brdf": "a reflectance calibration",
}


def fits_of(rig: Rig) -> tuple[str, ...]:
    """Return the names of the fits for which a rig has all entries."""
    found = tuple(
        fit
        for fit, purpose in FITS.items()
        if all(getattr(rig, section) for section in NEEDED[purpose])
    )
    if not found:
        raise InputError(
            f"{rig.folder}: the rig has nothing to fit; give it flats and darks, exposures, or "
            "lights and a geometry."
        )
    return found


def problems(
    rig: Rig, *, load: Load = read_image, seconds: float = np.inf
) -> dict[str, tuple[Problem, tuple[str, ...]]]:
    """State the calibrations of a rig as problems of accuracy, whose settings can be varied.

    Args:
        rig: from `load_rig`.
        load: function that reads an image from its path; needed for images in memory.
        seconds: longest time in s that the reference calibration of each fit may take.

    Returns:
        For each fit, by its name, the problem and the names of the settings to vary. Results are in
        standard errors.

    Raises:
        InputError: for a rig with nothing to fit, and for a rig that cannot be calibrated, or not
            within `seconds`.
    """
    fits, now = fits_of(rig), time.perf_counter
    until = now() + seconds * len(fits)
    try:
        return run_within(lambda: _calibrate(rig, fits, load), lambda: until - now())
    except OutOfTime:
        raise InputError(
            f"{rig.folder}: the reference calibration takes longer than {seconds:.3g} s; allow "
            "more."
        ) from None


def _calibrate(
    rig: Rig, fits: tuple[str, ...], load: Load
) -> dict[str, tuple[Problem, tuple[str, ...]]]:
    found = {}
    for fit in fits:
        if load is read_image:
            require_images(rig, FITS[fit])
        make: Callable[[Rig, Load], Mapping[str, Turn]] = getattr(
            import_module(f"{__package__}.{fit}"), f"{fit}_knobs"
        )
        name = rig.folder.name
        found[fit] = _problem(fit if name == fit else f"{name}, {fit}", make(rig, load))
    return found


def _problem(name: str, turns: Mapping[str, Turn]) -> tuple[Problem, tuple[str, ...]]:
    def prepare(settings: Mapping[str, object]) -> Callable[[int], object]:
        ((knob, setting),) = settings.items()
        return turns[knob](setting)

    known = tuple(
        n
        for n in KNOBS
        if n in turns and n in RIG_KNOBS and (n != "NUTS draws" or find_spec("blackjax"))
    )
    asked = {"level": 1.0, "about": ABOUT, "error_axis": "rms error [% of a standard error]"}
    return Problem(name, prepare, **asked), known


def measured(
    problem: Problem,
    known: tuple[str, ...],
    *,
    names: tuple[str, ...] | None = None,
    seconds: float = 60.0,
    clock: Clock | None = None,
) -> tuple[Curve, ...]:
    """Measure error against time for each setting of a fit; the settings share the time equally.

    Args:
        problem: from `problems`.
        known: names of the settings that the problem has.
        names: settings to vary; None for all.
        seconds: time for all settings together, s.
        clock: function that returns seconds; None for the machine's clock.

    Returns:
        The curves of error, in standard errors, against time.

    Raises:
        InputError: for a setting that the fit does not have.
    """

    def measure(name: str, share: float) -> Curve:
        knob, begun, whole = KNOBS[name], now(), None
        if name == "pixels":
            every = problem.prepare({"pixels": 1.0})
            with suppress(OutOfTime):  # then `curve` has no time left, too
                whole = run_within(lambda: every(0), lambda: share + begun - now())
        settings = knob.settings
        if name == "posterior" and not find_spec("blackjax"):
            settings = tuple(setting for setting in settings if setting != "nuts")
        left = max(share - (now() - begun), LEAST)
        return curve(problem, knob, settings=settings, reference=whole, seconds=left, clock=clock)

    now = clock or time.perf_counter
    chosen = asked_knobs(problem.name, names, known)
    return measure_in_turn(chosen, measure, seconds=seconds, clock=clock)
