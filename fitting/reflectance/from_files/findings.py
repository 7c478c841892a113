"""The findings on fits to measured reflectance, each with the condition under which it is reported.
The findings state, for one material or for several, which model is best, by how much, and whether
the difference is significant.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from jaxvision import as_array

from ...inference.diagnostics import listed
from ...inference.formatting import format_percent
from ...inference.trust import convergence_in_words
from ...report.sentences import Finding, Numbers, evaluate_findings, quoted
from ..models import LABELS, REFLECTANCES, facet_sentence, has_lobe, shape_of, shape_range
from ..names import AXIS_NAMES, CLEAR, DESCRIBES, Axis, Model, Objective
from .calibration import BRDFCalibration, albedo
from .errors import (
    LIKELY,
    METRICS,
    Errors,
    Ratio,
    Side,
    best,
    best_about_axis,
    describes,
    exceeds_signal,
    format_error,
    metric,
    ratio,
    weight_by_incidence,
    winner_of,
)
from .fit import compared_quantity

MOST_WEIGHT = 0.5  # share of one incidence in a fit from which it is reported
NESTED = 1e-3  # relative excess over a contained model that limits of the shape cannot explain
NOTHING = 1e-6  # the same excess relative to the signal's RMS, for a perfect model
APART = 1.5  # ratio of two errors from which a missing significance is explained
OVERFIT = 1.5  # held-out over fitted error from which it is reported
ROUNDING = 1e-3  # rounding error of an albedo
BLACK = 0.005  # albedo of the blackest paints and velvets
OBLIQUE = np.radians(15.0)  # incidence from which forward and backward directions are separate
NEAR = np.radians(7.5)  # angle to the light within which a peak counts as toward it
BRIGHT = 3.0  # ratio to the median of its incidence from which a value is a peak
PAIRS: tuple[tuple[Model, Model], ...] = (  # same factor on the lobe, different axis
    ("phong", "blinn"),
    ("normalised-phong", "normalised-blinn"),
)
AXES: tuple[Axis, ...] = ("half", "mirror")
FRESNEL: tuple[Model, ...] = ("torrance-sparrow", "torrance-sparrow-metal", "lambert")


def findings(calibration: BRDFCalibration) -> tuple[str, ...]:
    """Return all findings about one material."""
    return evaluate_findings(FINDINGS, calibration)


def which_axis_wins(calibrations: Sequence[BRDFCalibration]) -> tuple[str, ...]:
    """Return sentences on whether, over several materials, lobes about the half vector fit better
    than lobes about the mirror direction, as in the literature, and why.
    """
    return evaluate_findings(OVER_MATERIALS, calibrations)


def readable(name: str) -> str:
    """Return a file's name as words."""
    return name.replace("_", " ")


# ---------------------------------------------------------------- one material


def no_description(calibration: BRDFCalibration) -> str:
    """Return the sentence that the reported model does not describe the file; empty if it does."""
    held_out, objective = calibration.held_out, calibration.objective
    own = held_out[calibration.model]
    if describes(own, objective):
        return ""
    winner = best(held_out, objective)
    about, missed = f"{LABELS[calibration.model]} does not describe this file", own
    error = "its error"
    if not describes(held_out[winner], objective):
        about, missed = "No model here describes this file", held_out[winner]
        error = f"the error of the best one ({LABELS[winner]})"
    return (
        f"{about}: at held-out angles of incidence, {error} is {100 * missed.relative:.1f} % of "
        f"the signal's cosine-weighted RMS, more than {format_percent(DESCRIBES)}. Its parameters "
        "are not properties of the surface."
    )


def _impossible(calibration: BRDFCalibration) -> Numbers | None:
    """Report that the fitted surface reflects more energy than it receives."""
    found = albedo(calibration.fits[calibration.model], calibration.index)
    most = int(np.argmax(found))
    if found[most] <= 1 + ROUNDING:
        return None
    bands = calibration.measured.bands
    band = f" in band {bands[most]}" if len(bands) > 1 else ""
    return {"model": LABELS[calibration.model], "albedo": found[most], "band": band}


def _toward_light(calibration: BRDFCalibration) -> Numbers | None:
    """Report data with a peak toward the light, which none of the models can describe."""
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
        return None
    return {"near": np.degrees(NEAR), "toward": toward, "judged": judged}


def _verdict(calibration: BRDFCalibration) -> Numbers:
    objective, held_out = calibration.objective, calibration.held_out
    winner = best(held_out, objective)
    found: dict[Model, Ratio] = {
        m: ratio(own, held_out[winner], objective) for m, own in held_out.items()
    }
    open_size: list[Model] = [m for m in held_out if m != winner and not found[m].significant]
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
    rivals: list[Model] = [best_about_axis(held_out, axis, objective) for axis in AXES]
    others: list[Model] = [m for m in (*rivals, "lambert") if m not in (winner, *equal)]
    against = ", ".join(
        f"{format_error(held_out[m], objective)} for {_describe(m)}" for m in others
    )
    angles = np.degrees(calibration.measured.incidences)

    def compare(models: Sequence[Model], *, counted: bool = False) -> str:
        """Return, for each model, the ratio of its error to that of the best model, the range of
        this ratio if one incidence is left out, and the number of incidences.
        """
        sentences = []
        for m in models:
            one = found[m]
            least, most = (
                f"{one.without[i]:.2f} times without {angles[i]:.0f}°"
                for i in (np.argmin(one.without), np.argmax(one.without))
            )
            often = f"; more at {one.more_often} of {len(one.alone)}, p = {one.chance:.2g}"
            sentences.append(
                f"{LABELS[m]} ({format_error(held_out[m], objective)}: {one.value:.2f} times the "
                f"error, {least}, {most}{often * counted})"
            )
        return listed(sentences) if sentences else ""

    numbers = {
        "winner": LABELS[winner],
        "metric": METRICS[objective],
        "error": format_error(held_out[winner], objective),
        "unit": " of the signal's" if objective == "cosine" else "",
        "against": f", against {against}" if others else "",
        "equal": listed([f"{LABELS[m]} ({format_error(held_out[m], objective)})" for m in equal])
        if equal
        else "",
        "far": compare(far),
        "worse": compare(worse, counted=True),
        "useless": compare(useless),
        "likely": LIKELY,
    }
    return {"verdict": " ".join(evaluate_findings(VERDICT, numbers))}


def _describe(model: Model) -> str:
    where = AXIS_NAMES[REFLECTANCES[model].axis]
    return f"the best lobe about the {where} ({LABELS[model]})" if where else LABELS[model]


def _weight(calibration: BRDFCalibration) -> Numbers | None:
    """Report that a single incidence dominates the fit."""
    shares = weight_by_incidence(calibration.measured, calibration.objective)
    most = int(np.argmax(shares))
    if shares[most] <= MOST_WEIGHT:
        return None
    angle = np.degrees(calibration.measured.incidences[most])
    return {"share": format_percent(shares[most]), "angle": angle}


def _pairs(calibration: BRDFCalibration) -> Numbers:
    """Report the effect of the lobe's axis by pairs of lobes that differ in it alone."""
    objective, held_out = calibration.objective, calibration.held_out
    sentences = []
    for mirror, half in PAIRS:
        ours, theirs = held_out[half], held_out[mirror]
        relation = evaluate_findings(
            RELATIONS, (ours, theirs, ratio(ours, theirs, objective), objective)
        )[0]
        sentences.append(
            f"{LABELS[half]} {relation} {LABELS[mirror]} "
            f"({format_error(ours, objective)} against {format_error(theirs, objective)})"
        )
    return {"pairs": "; ".join(sentences)}


def _generalisation(calibration: BRDFCalibration) -> Numbers | None:
    model, objective = calibration.model, calibration.objective
    unseen = metric(calibration.held_out[model], objective)
    seen = metric(calibration.fitted[model], objective)
    if unseen < OVERFIT * seen:
        return None
    worst = int(np.argmax(calibration.held_out[model].by_incidence))
    angle = np.degrees(calibration.measured.incidences[worst])
    return {"model": LABELS[model], "times": unseen / seen, "angle": angle}


def _listing(parts: Iterable[str]) -> Numbers | None:
    """Return the values of a finding that lists several items; None if there are no items."""
    listing = ", ".join(parts)
    return {"listing": listing} if listing else None


def _ends(calibration: BRDFCalibration) -> tuple[list[Model], list[Model]]:
    """Return the models, other than the reported one, whose shape is at an end of its range: first
    rough diffuse models of vanishing roughness, then all others.
    """
    smooth: list[Model] = []
    stuck: list[Model] = []
    for model, fit in calibration.fits.items():
        if fit.whole.shape is None or model == calibration.model:
            continue
        low, high = shape_range(model)
        if not has_lobe(model) and fit.whole.shape <= 1.001 * low:
            smooth.append(model)
        elif not 1.001 * low < fit.whole.shape < high / 1.001:
            stuck.append(model)
    return smooth, stuck


def _failures(calibration: BRDFCalibration) -> Iterable[Numbers]:
    """Report searches that did not converge, or fit worse than their Lambertian case."""
    measured = calibration.measured
    signal = compared_quantity(measured, calibration.objective, measured.values)
    nothing = NOTHING**2 * float(np.sum(measured.weights[:, None] * signal**2))
    lambert = calibration.fits["lambert"]
    for model, fit in calibration.fits.items():
        pairs = zip((fit.whole, *fit.without), (lambert.whole, *lambert.without), strict=True)
        failed = [
            not own.converged or own.cost > (1 + NESTED) * matt.cost + nothing
            for own, matt in pairs
        ]
        if any(failed):
            yield {"model": LABELS[model], "failed": sum(failed), "fits": len(failed)}


# ---------------------------------------------------------------- several materials


def _compare_best_lobes(calibration: BRDFCalibration) -> tuple[Model, Model, Side]:
    """Return the best lobes about half vector and mirror, and the better axis."""
    held_out, objective = calibration.held_out, calibration.objective
    half = best_about_axis(held_out, "half", objective)
    mirror = best_about_axis(held_out, "mirror", objective)
    return half, mirror, winner_of(held_out[half], held_out[mirror], objective)


def _best_lobes(calibrations: Sequence[BRDFCalibration]) -> Numbers:
    """Report the best lobe about each axis, and the materials on which it is better."""
    wins: dict[Side, list[str]] = {"half": [], "mirror": [], "neither": []}
    confounded = []
    for calibration in calibrations:
        name = readable(calibration.measured.name)
        half, mirror, side = _compare_best_lobes(calibration)
        wins[side].append(name)
        if side != "neither" and (mirror, half) not in PAIRS:
            confounded.append(f"{LABELS[half]} against {LABELS[mirror]} on {name}")
    sides: dict[Side, str] = {
        "half": "the best lobe about the half vector is better",
        "mirror": "the best lobe about the mirror direction is better",
        "neither": "the difference is not significant",
    }
    materials = "; ".join(
        f"{words} on {len(wins[side])} of {len(calibrations)} ({', '.join(wins[side])})"
        for side, words in sides.items()
        if wins[side]
    )
    if confounded:
        materials += (
            ". Where lobes differ in more than their axis, this alone says nothing about the axis: "
            f"{listed(confounded)}"
        )
    return {"metric": METRICS[calibrations[0].objective], "listing": materials}


def _axis_alone(calibrations: Sequence[BRDFCalibration]) -> Numbers:
    """Report which axis is better among pairs of lobes that differ only in their axis, and a
    conclusion. A conclusion requires that the differences of these pairs are significant and that
    the best lobes about each axis do not contradict them.
    """
    results = [
        winner_of(c.held_out[half], c.held_out[mirror], c.objective)
        for c in calibrations
        for mirror, half in PAIRS
    ]
    alone, overall = set(results), {_compare_best_lobes(c)[-1] for c in calibrations}
    if {"half", "mirror"} <= alone:
        judgement = "confirm only in part"
    elif "half" in alone and "mirror" not in overall:
        judgement = "confirm"
    elif "mirror" in alone and "half" not in overall:
        judgement = "contradict"
    else:
        judgement = "neither confirm nor contradict"
    if "neither" in alone and not judgement.startswith("neither"):
        judgement += ", where they are significant,"
    return {
        "half": results.count("half"),
        "mirror": results.count("mirror"),
        "every": len(results),
        "judgement": judgement,
    }


def _fresnel(calibrations: Sequence[BRDFCalibration]) -> Numbers | None:
    """Report, if a model with clear facets is best, how much larger the error of GGX facets becomes
    without Fresnel reflectance, as a share of their lead over Lambert's model.
    """
    objective = calibrations[0].objective
    sentences = []
    for calibration in calibrations:
        held_out = calibration.held_out
        clear, metal, matt = (held_out[model] for model in FRESNEL)
        lead = metric(matt, objective) - metric(clear, objective)
        if best(held_out, objective) not in CLEAR or lead <= 0:
            continue
        rise = max(metric(metal, objective) - metric(clear, objective), 0.0)
        sentences.append(
            f"{readable(calibration.measured.name)} {format_error(metal, objective)} instead of "
            f"{format_error(clear, objective)}; this is {format_percent(rise / lead)} of the "
            f"improvement over Lambert's {format_error(matt, objective)}"
        )
    return {"listing": "; ".join(sentences)} if sentences else None


# ---------------------------------------------------------------- the sentences

Pair = tuple[Errors, Errors, Ratio, Objective]  # of half-vector and mirror lobe


def _useless(pair: Pair) -> tuple[bool, bool]:
    """Return which of two models have errors larger than the signal."""
    half, mirror, _, objective = pair
    return exceeds_signal(half, objective), exceeds_signal(mirror, objective)


def _order(pair: Pair) -> Numbers | None:
    """Report which model is better, for a certain sign of an uncertain difference."""
    found = pair[2]
    if not found.ordered:
        return None
    more = "more" if found.value > 1 else "less"
    times, of = found.more_often, len(found.alone)
    return {"more": more, "times": times, "of": of, "chance": found.chance}


RELATIONS = (  # of a lobe about the half vector to that about the mirror direction: the first holds
    Finding(
        "useless",
        lambda pair: all(_useless(pair)),
        "has errors larger than the signal, and so has",
    ),
    Finding("wins", lambda pair: winner_of(pair[0], pair[1], pair[3]) == "half", "beats"),
    Finding("loses", lambda pair: winner_of(pair[0], pair[1], pair[3]) == "mirror", "loses to"),
    Finding(
        "ordered",
        _order,
        "has {more} error at {times} of {of} incidences (p = {chance:.2g}) than",
    ),
    Finding(
        "more than the signal",
        lambda pair: _useless(pair)[0],
        "has errors larger than the signal, unlike",
    ),
    Finding(
        "less than the signal",
        lambda pair: _useless(pair)[1],
        "has errors smaller than the signal, unlike",
    ),
    Finding("open", lambda pair: True, "does not differ significantly from"),
)
VERDICT = tuple(
    Finding(key, lambda numbers, key=key: numbers if numbers[key] else None, sentence)
    for key, sentence in {
        "winner": "At held-out angles of incidence, {winner} predicts best: {metric} "
        "{error}{unit}{against}.",
        "equal": "Not significantly worse, by leaving out each incidence in turn: {equal}.",
        "far": "Some of these have a far larger error here, but its size depends on single "
        "incidences: {far}.",
        "worse": "Worse at significantly more incidences (p up to {likely:g}), although the size "
        "of the difference depends on single incidences: {worse}.",
        "useless": "With errors larger than the signal, and thus no description of it, although "
        "the ratio to the best model depends on which incidence is left out: {useless}.",
    }.items()
)
FINDINGS = (
    Finding("verdict", _verdict, "{verdict}"),
    Finding(
        "impossible",
        _impossible,
        "{model} as fitted is impossible: its albedo along the normal{band} is {albedo:.2g}, and "
        "no albedo exceeds 1.",
    ),
    Finding(
        "black",
        lambda c: (
            {"albedo": 100 * most}
            if (most := float(albedo(c.fits[c.model], c.index).max())) < BLACK
            else None
        ),
        "The fitted albedo along the normal is {albedo:.2g} %, less than that of black velvet: the "
        "values may lack a factor, as in a MERL file that was already divided by its scales.",
    ),
    Finding(
        "toward the light",
        _toward_light,
        "The data peak within {near:.3g}° of the direction toward the light at {toward} of "
        "{judged} oblique incidences: the surface is retro-reflective, and no model here is.",
    ),
    Finding("axis", _pairs, "Half vector or mirror direction, all else equal: {pairs}."),
    Finding(
        "weight",
        _weight,
        "{share} of the weight of the fit is at one incidence, {angle:.0f}°, so the fit describes "
        "mainly that one.",
    ),
    Finding(
        "unseen incidences",
        _generalisation,
        "The error of {model} is {times:.1f} times larger at held-out incidences than at those of "
        "its fit, most at {angle:.0f}°: its predictions there need measurements there.",
    ),
    quoted("facets", lambda c: [facet_sentence(c.index)] * (c.model in CLEAR)),
    Finding(
        "not determined",
        lambda c: [
            {"name": name, "model": LABELS[c.model], "why": why}
            for name, why in c.open_parameters.items()
        ],
        "{name} of {model} is not determined: {why}.",
    ),
    Finding(
        "smooth",
        lambda c: [{"model": LABELS[m], "shape": shape_of(m).name} for m in _ends(c)[0]],
        "{model} fits best without {shape}, as Lambert's model.",
    ),
    Finding(
        "end of range",
        lambda c: _listing(
            f"{LABELS[m]} ({shape_of(m).name} {c.fits[m].whole.shape:.3g})" for m in _ends(c)[1]
        ),
        "The shape parameter is at the end of its range, so the description is poor: {listing}.",
    ),
    Finding(
        "no minimum",
        _failures,
        "{model}: {failed} of {fits} fits did not reach a minimum; do not use its numbers.",
    ),
    Finding(
        "standard errors",
        lambda c: {
            "count": len(c.measured.incidences),
            "drawn": "" if c.posterior is None else f" {convergence_in_words(c.posterior)}",
        },
        "Standard errors come from leaving out each of the {count} incidences in turn, so they "
        "include the misfit of the model, not only noise.{drawn}",
    ),
    quoted("data", lambda c: c.measured.findings),
)
OVER_MATERIALS = (
    Finding("best lobes", _best_lobes, "By {metric} at held-out incidences, {listing}."),
    Finding(
        "axis alone",
        _axis_alone,
        "Between lobes that differ in the axis alone (Phong and Blinn, with and without "
        "normalisation), the half vector wins {half} of {every} comparisons, the mirror direction "
        "{mirror}; the others are not significant. Together they {judgement} the finding of "
        "Ngan, Durand & Matusik (2005) on 100 materials that lobes about the half vector fit "
        "better.",
    ),
    Finding(
        "Fresnel",
        _fresnel,
        "Where Torrance-Sparrow with clear facets predicts best, the errors of GGX facets without "
        "the rise of Fresnel reflectance toward grazing angles (metal) are, on {listing}.",
    ),
)
