"""What a reader of fitted measured reflectance must be told: who wins, by how much, how sure."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from jaxvision import as_array

from ...inference.diagnostics import listed
from ...inference.formatting import format_percent
from ...inference.trust import convergence_in_words
from ..models import (
    LABELS,
    REFLECTANCES,
    facet_sentence,
    has_lobe,
    shape_of,
    shape_range,
)
from ..names import CLEAR, DESCRIBES, Axis, Model, Objective
from .calibration import BRDFCalibration, albedo
from .errors import (
    LIKELY,
    Errors,
    Ratio,
    best,
    describes,
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
ROUNDING = 1e-3  # of an albedo
OBLIQUE = np.radians(15.0)  # incidence from which back and forth lie apart
NEAR = np.radians(7.5)  # of the light: where a peak counts as toward it
BRIGHT = 3.0  # times the median of its incidence, from which a value is a peak
PAIRS: tuple[tuple[Model, Model], ...] = (  # same factor before the lobe, other axis
    ("phong", "blinn"),
    ("normalised-phong", "normalised-blinn"),
)
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
        *_no_description(calibration),
        _verdict(calibration),
        *_impossible(calibration),
        *_toward_light(calibration),
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


def _no_description(calibration: BRDFCalibration) -> list[str]:
    """That the best model is no good, where it is none."""
    winner = best(calibration.held_out, calibration.objective)
    found = calibration.held_out[winner]
    if describes(found, calibration.objective):
        return []
    return [
        "No model here describes this file: at angles of incidence that no fit has seen, the best "
        f"one ({LABELS[winner]}) misses {100 * found.relative:.1f} % of the signal's "
        f"cosine-weighted RMS, more than {format_percent(DESCRIBES)}. Its parameters are no "
        "properties of the surface."
    ]


def _impossible(calibration: BRDFCalibration) -> list[str]:
    """Energy that the reported surface would add."""
    fit = calibration.fits[calibration.model]
    found = albedo(fit, calibration.index)
    most = int(np.argmax(found))
    if found[most] <= 1 + ROUNDING:
        return []
    bands = calibration.measured.bands
    band = f" in band {bands[most]}" if len(bands) > 1 else ""
    return [
        f"{LABELS[calibration.model]} as fitted is impossible: it reflects {found[most]:.2g} times "
        f"the light that falls on it along the normal{band} (its albedo), and no surface reflects "
        "more than all of it."
    ]


def _toward_light(calibration: BRDFCalibration) -> list[str]:
    """Data that peak toward the light, as those of no model here do."""
    measured = calibration.measured
    wi, wo = (np.asarray(as_array(v)) for v in (measured.wi, measured.wo))
    values, toward, judged = measured.values.mean(axis=1), 0, 0
    for i, incidence in enumerate(measured.incidences):
        own = np.flatnonzero(measured.incidence == i)
        if incidence < OBLIQUE:
            continue
        judged += 1
        peak = own[np.argmax(values[own])]
        mirrored = wi[peak] * np.array([-1, -1, 1])
        apart = (np.linalg.norm(wo[peak] - v) for v in (wi[peak], mirrored))
        back, forth = (2 * np.arcsin(np.minimum(chord / 2, 1)) for chord in apart)
        bright = values[peak] > BRIGHT * np.median(values[own])
        toward += bool(back < NEAR and back < forth and bright)
    if judged == 0 or 2 * toward <= judged:
        return []
    return [
        f"The data peak within {np.degrees(NEAR):.3g}° of the direction toward the light at "
        f"{toward} of {judged} oblique incidences: the surface is retro-reflective, which no model "
        "here is."
    ]


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
            "Of these some err far more here, but by how much hangs on single incidences: "
            f"{_compared(calibration, found, far)}."
        )
    if worse:
        told.append(
            f"Worse than it at more incidences than is likely by chance (p up to {LIKELY:g}), "
            "though by how much on the whole hangs on single ones: "
            f"{_compared(calibration, found, worse, counted=True)}."
        )
    if useless:
        told.append(
            "Missing more than the whole signal, hence no description of it, though how it "
            "compares with the best depends on the incidence that is left out: "
            f"{_compared(calibration, found, useless)}."
        )
    return " ".join(told)


def _compared(
    calibration: BRDFCalibration,
    found: Mapping[Model, Ratio],
    models: Sequence[Model],
    *,
    counted: bool = False,
) -> str:
    """How much more models err than the best one, between which bounds with an incidence left out,
    and at how many."""
    angles = np.degrees(calibration.measured.incidences)

    def often(model: Model) -> str:
        one = found[model]
        told = f"; more at {one.more_often} of {len(one.alone)}, p = {one.chance:.2g}"
        return told if counted else ""

    def bound(model: Model, i: np.intp) -> str:
        return f"{found[model].without[i]:.2f} times without {angles[i]:.0f}°"

    return listed(
        [
            f"{LABELS[m]} ({in_words(calibration.held_out[m], calibration.objective)}: "
            f"{found[m].value:.2f} times as much, {bound(m, np.argmin(found[m].without))}, "
            f"{bound(m, np.argmax(found[m].without))}{often(m)})"
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
    winner = winner_of(half, mirror, objective)
    if winner != "neither":
        return "beats" if winner == "half" else "loses to"
    found = ratio(half, mirror, objective)
    if found.ordered:
        more = "more" if found.value > 1 else "less"
        at = f"{found.more_often} of {len(found.alone)} incidences"
        return f"errs {more} at {at} (p = {found.chance:.2g}) than"
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


def winner_of(half: Errors, mirror: Errors, objective: Objective) -> Side:
    """Which axis errs less by more than chance.

    Args:
        half: errors of a lobe about the half vector.
        mirror: of one about the mirror direction.
        objective: whose metric counts.

    Returns:
        The axis; neither where both lobes describe nothing.
    """
    useless = exceeds_signal(half, objective) and exceeds_signal(mirror, objective)
    if useless or not distinguished(half, mirror, objective):
        return "neither"
    return "half" if metric(half, objective) < metric(mirror, objective) else "mirror"
