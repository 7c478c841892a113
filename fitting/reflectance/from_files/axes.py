"""Over several materials: which axis of a lobe wins, by itself and with all else that lobes differ
in, and what Fresnel reflectance does."""

from collections.abc import Sequence

from ...inference.diagnostics import listed
from ...inference.formatting import format_percent
from ..models import LABELS
from ..names import CLEAR, Model
from .calibration import BRDFCalibration
from .errors import best, metric
from .findings import METRICS, PAIRS, Side, in_words, of_axis, winner_of

FRESNEL: tuple[Model, ...] = ("torrance-sparrow", "torrance-sparrow-metal", "lambert")


def which_axis_wins(calibrations: Sequence[BRDFCalibration]) -> tuple[str, ...]:
    """Over several materials: does the half vector win, as the literature has it, and why?"""
    return (
        _best_lobes(calibrations),
        f"{_axis_alone(calibrations)} {_against_the_literature(calibrations)}",
        *_what_fresnel_does(calibrations),
    )


def _of_best_lobes(calibration: BRDFCalibration) -> tuple[Model, Model, Side]:
    """The best lobe about the half vector, that about the mirror direction, and which wins."""
    held_out, objective = calibration.held_out, calibration.objective
    half = of_axis(held_out, "half", objective)
    mirror = of_axis(held_out, "mirror", objective)
    return half, mirror, winner_of(held_out[half], held_out[mirror], objective)


def _best_lobes(calibrations: Sequence[BRDFCalibration]) -> str:
    """The best lobe of each axis, whatever else it differs in, and where it does."""
    objective = calibrations[0].objective
    wins: dict[Side, list[str]] = {"half": [], "mirror": [], "neither": []}
    confounded = []
    for calibration in calibrations:
        name = readable(calibration.measured.name)
        half, mirror, side = _of_best_lobes(calibration)
        wins[side].append(name)
        if side != "neither" and (mirror, half) not in PAIRS:
            confounded.append(f"{LABELS[half]} against {LABELS[mirror]} on {name}")
    sides: dict[Side, str] = {
        "half": "the best lobe about the half vector wins",
        "mirror": "the best about the mirror direction",
        "neither": "neither by more than chance",
    }
    told = "; ".join(
        f"{words} on {len(wins[side])} of {len(calibrations)} ({', '.join(wins[side])})"
        for side, words in sides.items()
        if wins[side]
    )
    told = f"By {METRICS[objective]} at incidences that no fit has seen, {told}."
    if not confounded:
        return told
    return (
        f"{told} By itself this says nothing about the axis where the lobes differ in more than "
        f"the axis: {listed(confounded)}."
    )


def _of_axis_alone(calibrations: Sequence[BRDFCalibration]) -> list[Side]:
    """Which axis wins each comparison of lobes that differ in nothing else."""
    return [
        winner_of(c.held_out[half], c.held_out[mirror], c.objective)
        for c in calibrations
        for mirror, half in PAIRS
    ]


def _axis_alone(calibrations: Sequence[BRDFCalibration]) -> str:
    results = _of_axis_alone(calibrations)
    return (
        "Between lobes that differ in the axis alone (Phong and Blinn, with and without "
        f"normalisation), the half vector wins {results.count('half')} of {len(results)} "
        f"comparisons, the mirror direction {results.count('mirror')}; the others leave it open."
    )


def _against_the_literature(calibrations: Sequence[BRDFCalibration]) -> str:
    """A conclusion about the axis where comparisons of it alone tell, and the best lobes, which
    differ in more than that, do not disagree."""
    results = _of_axis_alone(calibrations)
    alone, overall = set(results), {_of_best_lobes(c)[-1] for c in calibrations}
    if {"half", "mirror"} <= alone:
        judgement = "confirm only in part"
    elif "half" in alone and "mirror" not in overall:
        judgement = "confirm"
    elif "mirror" in alone and "half" not in overall:
        judgement = "contradict"
    else:
        judgement = "neither confirm nor contradict"
    if "neither" in alone and not judgement.startswith("neither"):
        judgement += ", where they tell,"
    return (
        f"Together these comparisons {judgement} the finding of Ngan, Durand & Matusik (2005) on "
        "100 materials that lobes about the half vector fit better."
    )


def _what_fresnel_does(calibrations: Sequence[BRDFCalibration]) -> list[str]:
    """Where clear facets win, how much of its lead GGX loses without Fresnel reflectance."""
    objective = calibrations[0].objective
    told = []
    for calibration in calibrations:
        held_out = calibration.held_out
        clear, metal, matt = (held_out[model] for model in FRESNEL)
        lead = metric(matt, objective) - metric(clear, objective)
        if best(held_out, objective) not in CLEAR or lead <= 0:
            continue
        rise = max(metric(metal, objective) - metric(clear, objective), 0.0)
        told.append(
            f"{readable(calibration.measured.name)} {in_words(metal, objective)} instead of "
            f"{in_words(clear, objective)}, which is {format_percent(rise / lead)} of their lead "
            f"over Lambert's {in_words(matt, objective)}"
        )
    if not told:
        return []
    return [
        "Where Torrance-Sparrow with clear facets wins, GGX facets without the rise of Fresnel "
        f"reflectance toward grazing angles (metal) err on {'; '.join(told)}."
    ]


def readable(name: str) -> str:
    """A file's name as words."""
    return name.replace("_", " ")
