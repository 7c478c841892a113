"""What a reader of fitted measured reflectance must be told: who wins, by how much, how sure."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from ...inference.diagnostics import listed
from ...inference.formatting import format_percent
from ...inference.trust import convergence_in_words
from ..models import (
    CLEAR,
    LABELS,
    REFLECTANCES,
    facet_sentence,
    has_lobe,
    shape_of,
    shape_range,
)
from ..names import Axis, Model, Objective
from .calibration import BRDFCalibration
from .errors import (
    Errors,
    Ratio,
    best,
    distinguished,
    exceeds_signal,
    metric,
    ratio,
    weight_by_incidence,
)
from .fit import compressed, reflected

Side = Literal["half", "mirror", "neither"]  # which axis wins a comparison
MOST_WEIGHT = 0.5  # of a fit, at one incidence, from which a reader is told
NESTED = 1e-3  # relative excess over a contained model: the ends of the shapes' ranges cost less
NOTHING = 1e-6  # of the signal's RMS: what those ends miss beside a model that misses nothing
APART = 1.5  # ratio of two errors from which a reader is told why they are not told apart
OVERFIT = 1.5  # held-out over fitted error from which a reader is told
PAIRS: tuple[tuple[Model, Model], ...] = (  # same factor before the lobe, other axis
    ("phong", "blinn"),
    ("normalised-phong", "normalised-blinn"),
)
FRESNEL: tuple[Model, ...] = ("torrance-sparrow", "torrance-sparrow-metal", "lambert")
AXES: tuple[Axis, ...] = ("half", "mirror")
METRICS: dict[Objective, str] = {"cosine": "cosine-weighted RMS", "cube-root": "cube-root error"}


def in_words(errors: Errors, objective: Objective) -> str:
    """An error as a report says it: percent of the signal, or sr^(-1/3) of the cube roots."""
    value = metric(errors, objective)
    return f"{100 * value:.3g} %" if objective == "cosine" else f"{value:.3g} sr⁻¹ᐟ³"


def of_axis(scores: Mapping[Model, Errors], axis: Axis, objective: Objective) -> Model:
    """The best model with a lobe about one axis.

    Args:
        scores: errors by model.
        axis: of the lobe.
        objective: whose metric counts.

    Returns:
        Its name.
    """
    own: dict[Model, Errors] = {
        model: e for model, e in scores.items() if REFLECTANCES[model].axis == axis
    }
    return best(own, objective)


def findings(calibration: BRDFCalibration) -> tuple[str, ...]:
    """All sentences about one material."""
    return (
        _verdict(calibration),
        _pairs(calibration),
        *_weight(calibration),
        *_generalisation(calibration),
        *([facet_sentence(calibration.index)] if calibration.model in CLEAR else []),
        *(
            f"{name} of {LABELS[calibration.model]} is not determined: {why}."
            for name, why in calibration.open_parameters.items()
        ),
        *_ends(calibration),
        *_failures(calibration),
        _intervals(calibration),
        *calibration.measured.findings,
    )


def _verdict(calibration: BRDFCalibration) -> str:
    objective, held_out = calibration.objective, calibration.held_out
    winner = best(held_out, objective)
    found: dict[Model, Ratio] = {
        m: ratio(own, held_out[winner], objective) for m, own in held_out.items()
    }
    open_size: list[Model] = [m for m in held_out if m != winner and not found[m].told]
    worse: list[Model] = [m for m in open_size if found[m].ordered]
    useless: list[Model] = [
        m
        for m in open_size
        if m not in worse
        and exceeds_signal(held_out[m], objective)
        and not exceeds_signal(held_out[winner], objective)
    ]
    equal: list[Model] = [m for m in open_size if m not in (*worse, *useless)]
    far: list[Model] = [m for m in equal if found[m].value >= APART]

    rivals: list[Model] = [of_axis(held_out, axis, objective) for axis in AXES]
    others: list[Model] = [m for m in (*rivals, "lambert") if m not in (winner, *equal)]
    against = ", ".join(f"{in_words(held_out[m], objective)} for {_described(m)}" for m in others)
    against = f", against {against}" if others else ""
    unit = " of the signal's" if objective == "cosine" else ""
    told = [
        f"At angles of incidence that no fit has seen, {LABELS[winner]} predicts best: "
        f"{METRICS[objective]} {in_words(held_out[winner], objective)}{unit}{against}."
    ]
    if equal:
        alike = [f"{LABELS[m]} ({in_words(held_out[m], objective)})" for m in equal]
        told.append(f"Not told apart from it, leaving out incidence by incidence: {listed(alike)}.")
    if far:
        told.append(
            "Of these some err far more here, but whether they do hangs on a single incidence: "
            f"{_compared(calibration, found, far)}."
        )
    if worse:
        told.append(
            "Worse than it whichever incidence is left out, though by how much depends on which: "
            f"{_compared(calibration, found, worse)}."
        )
    if useless:
        told.append(
            "Missing more than the whole signal, hence no description of it, though how it "
            "compares with the best depends on the incidence that is left out: "
            f"{_compared(calibration, found, useless)}."
        )
    return " ".join(told)


def _compared(
    calibration: BRDFCalibration, found: Mapping[Model, Ratio], models: Sequence[Model]
) -> str:
    """How much more models err than the best one, and between which bounds with an incidence left
    out."""
    angles = np.degrees(calibration.measured.incidences)

    def bound(model: Model, i: np.intp) -> str:
        return f"{found[model].without[i]:.2f} times without {angles[i]:.0f}°"

    return listed(
        [
            f"{LABELS[m]} ({in_words(calibration.held_out[m], calibration.objective)}: "
            f"{found[m].value:.2f} times as much, {bound(m, np.argmin(found[m].without))}, "
            f"{bound(m, np.argmax(found[m].without))})"
            for m in models
        ]
    )


def _weight(calibration: BRDFCalibration) -> list[str]:
    """That a single incidence decides the fit, where one does."""
    shares = weight_by_incidence(calibration.measured, calibration.objective)
    most = int(np.argmax(shares))
    if shares[most] <= MOST_WEIGHT:
        return []
    return [
        f"{format_percent(shares[most])} of the weight of the fit lies at one incidence, "
        f"{np.degrees(calibration.measured.incidences[most]):.0f}°: what it says is about that one."
    ]


def _described(model: Model) -> str:
    match REFLECTANCES[model].axis:
        case "mirror":
            return f"the best lobe about the mirror direction ({LABELS[model]})"
        case "half":
            return f"the best lobe about the half vector ({LABELS[model]})"
    return LABELS[model]


def _pairs(calibration: BRDFCalibration) -> str:
    """The axis by itself: pairs of lobes that differ in nothing else."""
    objective, held_out = calibration.objective, calibration.held_out
    told = []
    for mirror, half in PAIRS:
        ours, theirs = held_out[half], held_out[mirror]
        told.append(
            f"{LABELS[half]} {_relation(ours, theirs, objective)} {LABELS[mirror]} "
            f"({in_words(ours, objective)} against {in_words(theirs, objective)})"
        )
    return f"Half vector against mirror direction, all else equal: {'; '.join(told)}."


def _relation(half: Errors, mirror: Errors, objective: Objective) -> str:
    """How a lobe about the half vector stands to one about the mirror direction, as a verb."""
    useless = exceeds_signal(half, objective), exceeds_signal(mirror, objective)
    if all(useless):
        return "errs by more than the whole signal, and so does"
    winner = _winner(half, mirror, objective)
    if winner != "neither":
        return "beats" if winner == "half" else "loses to"
    found = ratio(half, mirror, objective)
    if found.ordered:
        more = "more" if found.value > 1 else "less"
        return f"errs {more}, whichever incidence is left out, than"
    if any(useless):
        return f"errs by {'more' if useless[0] else 'less'} than the whole signal, unlike"
    return "is not told apart from"


def _generalisation(calibration: BRDFCalibration) -> list[str]:
    model, objective = calibration.model, calibration.objective
    unseen = metric(calibration.held_out[model], objective)
    seen = metric(calibration.fitted[model], objective)
    if unseen < OVERFIT * seen:
        return []
    worst = int(np.argmax(calibration.held_out[model].by_incidence))
    return [
        f"{LABELS[model]} errs {unseen / seen:.1f} times more at incidences it has not seen than "
        f"at those of its fit, most at {np.degrees(calibration.measured.incidences[worst]):.0f}°: "
        "what it says there depends on having been measured there."
    ]


def _ends(calibration: BRDFCalibration) -> list[str]:
    """Other models with a shape at an end of its range."""
    stuck, smooth = [], []
    for model, fit in calibration.fits.items():
        if fit.whole.shape is None or model == calibration.model:
            continue
        shape = shape_of(model)
        low, high = shape_range(model)
        if not has_lobe(model) and fit.whole.shape <= 1.001 * low:
            smooth.append(f"{LABELS[model]} fits best without {shape.name}, as Lambert's model.")
        elif not 1.001 * low < fit.whole.shape < high / 1.001:
            stuck.append(f"{LABELS[model]} ({shape.name} {fit.whole.shape:.3g})")
    if not stuck:
        return smooth
    return [
        *smooth,
        f"At an end of the range of their shape, hence no good description: {', '.join(stuck)}.",
    ]


def _failures(calibration: BRDFCalibration) -> list[str]:
    """Searches that did not settle, or ended above Lambert's model, which all others contain."""
    told, measured = [], calibration.measured
    in_metric = reflected if calibration.objective == "cosine" else compressed
    squares = measured.weights[:, None] * in_metric(measured, measured.values) ** 2
    nothing = NOTHING**2 * float(squares.sum())
    lambert = calibration.fits["lambert"]
    for model, fit in calibration.fits.items():
        pairs = zip((fit.whole, *fit.without), (lambert.whole, *lambert.without), strict=True)
        settled = [
            own.settled and own.cost <= (1 + NESTED) * matt.cost + nothing for own, matt in pairs
        ]
        if not all(settled):
            told.append(
                f"{LABELS[model]}: {settled.count(False)} of {len(settled)} fits did not reach a "
                "minimum; do not use its numbers."
            )
    return told


def _intervals(calibration: BRDFCalibration) -> str:
    count = len(calibration.measured.incidences)
    first = (
        f"Standard errors come from leaving out each of the {count} incidences in turn, so they "
        "hold what the model misses, not only noise."
    )
    if calibration.posterior is None:
        return first
    return f"{first} {convergence_in_words(calibration.posterior)}"


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
    return half, mirror, _winner(held_out[half], held_out[mirror], objective)


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
        _winner(c.held_out[half], c.held_out[mirror], c.objective)
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


def _winner(half: Errors, mirror: Errors, objective: Objective) -> Side:
    """Which axis errs less by more than chance; neither where both lobes describe nothing."""
    useless = exceeds_signal(half, objective) and exceeds_signal(mirror, objective)
    if useless or not distinguished(half, mirror, objective):
        return "neither"
    return "half" if metric(half, objective) < metric(mirror, objective) else "mirror"


def readable(name: str) -> str:
    """A file's name as words."""
    return name.replace("_", " ")
