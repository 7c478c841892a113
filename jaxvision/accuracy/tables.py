"""Present measured curves as a table or as JSON: for each knob, and for all knobs together, the
cheapest settings with an error below 10, 1 and 0.1 %."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ..errors import InputError
from .choice import choose
from .records import Curve, Problem, Trial
from .scene_settings import Chosen
from .several import TOLERANCES, Together, all_together

NOT_REACHED = "not reached"
WITHIN = tuple(f"{100 * tolerance:g} %" for tolerance in TOLERANCES)


def reached(curve: Curve) -> list[Trial | None]:
    """Return the cheapest setting for each of `TOLERANCES`, or None where no setting meets it."""
    found: list[Trial | None] = []
    for tolerance in TOLERANCES:
        try:
            found.append(choose(curve, tolerance=tolerance))
        except InputError:
            found.append(None)
    return found


def rows(
    problem: Problem, curves: Sequence[Curve], *, together: Sequence[Together] | None = None
) -> list[tuple[str, ...]]:
    """Return the rows of the table of measured curves, headings first.

    Args:
        problem: the problem whose settings were measured.
        curves: measured curves of its settings.
        together: combinations from `all_together`; None to compute them from the curves.

    Returns:
        Rows of text: knob, order and, for each tolerance, setting and time in s.
    """
    found: list[tuple[str, ...]] = [("knob", "order (fitted)", *WITHIN)]
    for curve in curves:
        order = "-" if curve.order is None else str(curve.order)
        found.append((curve.knob.name, order, *_cells(curve)))
    together = all_together(problem, curves) if together is None else together
    if together:
        found.append(("all together", "", *map(_combination_text, together)))
    return found


def _cells(curve: Curve) -> list[str]:
    """Return the text of one table cell for each tolerance. At the first tolerance that no setting
    meets, the cell states the smallest error bound of any setting.
    """
    found = [NOT_REACHED if trial is None else _cell(trial) for trial in reached(curve)]
    if NOT_REACHED in found:
        best = min((trial.error_high for trial in curve.trials), default=np.inf)
        known = f"at best {percent_text(best)}" if np.isfinite(best) else "no error is known"
        found[found.index(NOT_REACHED)] = f"{NOT_REACHED}: {known}"
    return found


def _cell(trial: Trial) -> str:
    inferred = "" if trial.measured else " (inferred)"
    return f"{trial.setting}{inferred} in {seconds_text(trial.seconds)}"


def _combination_text(together: Together) -> str:
    combination = together.combination
    if combination is None:
        return NOT_REACHED
    left = dict.fromkeys(combination.unknown, " (not known)")
    words = ", ".join(
        f"{n} {setting}{left.get(n, '')}" for n, setting in combination.settings.items()
    )
    said = "" if together.checked else " (not checked)"
    return f"{words} in {seconds_text(combination.seconds)}{said}"


def seconds_text(seconds: float) -> str:
    """Format a time, in s, with two significant digits and the unit ms, s, min or h."""
    if seconds < 0.1:
        return f"{1e3 * seconds:.2g} ms"
    if seconds < 600:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


def percent_text(error: float) -> str:
    """Format a relative error as a percentage with two significant digits."""
    return f"{100 * error:.0f} %" if error >= 1 else f"{100 * error:.2g} %"


def notes(curves: Sequence[Curve], *, together: Sequence[Together] = ()) -> list[str]:
    """List the sentences below the table: the references, the settings that were not run, and the
    combinations that were not checked.

    Args:
        curves: measured curves.
        together: combinations of all settings, from `all_together`.

    Returns:
        The notes as sentences; errors are relative.
    """
    found = []
    for curve in curves:
        name, own = curve.knob.name, curve.reference
        of = "" if own.setting is None else f" {own.setting}"
        error = percent_text(own.error) if np.isfinite(own.error) else "not known"
        if curve.trials:
            found.append(f"{name}: reference{of} ({own.how}), its own error {error}.")
        if curve.not_run:
            left = ", ".join(str(setting) for setting in curve.not_run)
            found.append(f"{name}: {curve.stopped}; not run: {left}.")
        elif curve.stopped:
            found.append(f"{name}: {curve.stopped}.")
        if beside := ", ".join(str(trial.setting) for trial in curve.trials if trial.beside):
            found.append(
                f"{name}: abandoned work was still running during these timings, so they are too "
                f"long: {beside}."
            )
    reached = [one for one in together if one.combination is not None]
    if any(one.checked for one in reached):
        found.append(
            "all together: run with fresh seeds, and compared with finer settings of every knob."
        )
    if not all(one.checked for one in reached):
        found.append(
            "all together: for lack of time, unchecked errors and times follow from those of "
            "single knobs."
        )
    return found


def json_sheet(
    problem: Problem,
    curves: Sequence[Curve],
    *,
    together: Sequence[Together] | None = None,
    **more: Any,
) -> dict[str, Any]:
    """Return all measurements as an object for JSON. The items of `more`, such as a description of
    the machine, are added to the object. Times are in s, errors relative. A number that is not
    finite is written as null."""
    sheet: dict[str, Any] = {
        "problem": problem.name,
        "about": problem.about,
        **more,
        "knobs": [],
        "within": {},
    }
    together = all_together(problem, curves) if together is None else together
    sheet["notes"] = notes(curves, together=together)
    for curve in curves:
        sheet["knobs"].append(
            {
                "name": curve.knob.name,
                "unit": curve.knob.unit,
                "about": curve.knob.about,
                "declared_order": curve.knob.order,
                "order": None if curve.order is None else asdict(curve.order),
                "reference": asdict(curve.reference),
                "trials": [asdict(trial) for trial in curve.trials],
                "pareto": [curve.trials[i].setting for i in curve.pareto],
                "not_run": list(curve.not_run),
                "stopped": curve.stopped,
                "seconds_taken": curve.taken,
            }
        )
    for words, one in zip(WITHIN, together or [Together(None)] * len(WITHIN), strict=True):
        best = one.combination
        sheet["within"][words] = best and {**asdict(best), "checked": one.checked}
    return _finite(sheet)


def _finite(value: Any) -> Any:
    match value:
        case Mapping():
            return {str(name): _finite(one) for name, one in value.items()}
        case list() | tuple():
            return [_finite(one) for one in value]
        case bool() | str() | int() | None:
            return value
        case float() | np.floating():
            return float(value) if np.isfinite(value) else None
    return str(value)


def choice_in_words(chosen: Chosen) -> str:
    """Describe chosen settings, with promised error in per cent and time in s."""
    words = ", ".join(f"{name} {setting}" for name, setting in chosen.settings.items())
    how = "checked with fresh seeds" if chosen.checked else "not checked, for lack of time"
    said = (
        f"Chosen: {words}: within {percent_text(chosen.promised)} ({how}), about "
        f"{seconds_text(chosen.predicted_seconds)}."
    )
    if not chosen.unknown:
        return said
    return (
        f"{said} Time was too short to measure {' and '.join(chosen.unknown)}, left as in the "
        "scene; the error of that is not included."
    )
