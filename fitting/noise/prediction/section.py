"""The report of a prediction: chi-squares, missing effects, and residuals."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...inference.diagnostics import listed
from ...inference.formatting import format_number, format_p
from ...report.figures import BLUE, ORANGE, empty_panels
from ...report.section import Picture, Section, Table
from .comparison import PARTS, Agreement
from .missing import SCATTERS
from .predict import Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KIND, TITLE = "prediction", "What the camera predicts of its frames"
NOTHING_KNOWN = "No effect that is known here explains it."
REST_UNKNOWN = "No effect that is known here explains the rest."
BAND = 2  # standard errors


def section(prediction: Prediction) -> Section:
    """Return the report section on a prediction."""
    name = prediction.camera.rstrip(",")
    return Section(
        kind=KIND,
        title=TITLE,
        estimates=(),
        findings=findings(prediction),
        pictures=(picture(prediction),),
        tables=(table(prediction), levels_table(prediction)),
        about=f"{name} and {len(prediction.main_comparison.lit.lit)} levels of light and dark.",
    )


def findings(prediction: Prediction) -> tuple[str, ...]:
    """Return sentences on how well the camera predicts the frames."""
    judged = prediction.main_comparison
    lit = int(np.sum(np.asarray(judged.lit.lit)))
    dark = judged.lit.lit.size - lit
    levels = f"{lit} levels of light" + (f" and {dark} of dark" if dark else "")
    kept = ""
    if len(prediction.comparisons) > 1:
        kept = ", which were held out in a second fit of the camera,"
    elif prediction.labels[0] == "the levels of its fit":
        kept = ", which are those of its fit, because there are too few to hold some out,"
    predicts = f"{prediction.camera} alone predicts {levels}{kept} with chi-squares per degree of "
    if _scatter_alone(prediction):
        clauses = listed([one.clause for one in prediction.missing])
        falls = listed([f"{one.strength**2:.0f}" for one in prediction.missing])
        sentences = [
            f"The frames show {clauses}, which is not part of a camera file. Including it lowers "
            f"-2 log likelihood by {falls}. With it {predicts[0].lower()}{predicts[1:]}"
            f"freedom of {_ratios(prediction.missing[-1].after)}; without it they are "
            f"{_ratios(judged.agreement)}."
        ]
    else:
        sentences = [f"{predicts}freedom of {_ratios(judged.agreement)}."]
    if prediction.unscaled:
        sentences.append(
            "The camera or the frames state no photons, so the rate of the light was fitted to the "
            "means."
        )
    errors = [
        f"{what} by {format_number(100 * size, 3)} %"
        for what, size in (
            ("light is off", prediction.light_error),
            ("variances scatter", prediction.variance_error),
        )
        if size
    ]
    if errors:
        sentences.append(
            "The chi-squares include errors that are not part of a camera file: from level to "
            f"level {' and '.join(errors)} rms."
        )
    if not judged.missed and not _scatter_alone(prediction):
        least = min(one.p_value for one in judged.agreement.values())
        sentences.append(
            f"The frames agree with it within their errors (the smallest p-value is {least:.2g})."
        )
    return (*sentences, *prediction.remarks, *explanations(prediction))


def explanations(prediction: Prediction) -> list[str]:
    """Return sentences on quantities that disagree and on the most likely cause."""
    agreement = prediction.main_comparison.agreement
    sentences = []
    far = {name: agreement[name] for name in prediction.main_comparison.missed}
    less = {name: one for name, one in far.items() if one.ratio < 1}
    more = {name: one for name, one in far.items() if one.ratio > 1}
    if less:
        sentences.append(
            f"The {listed([*less])} scatter less about the prediction than independent frames do "
            f"({_chances(less)}): frames of a level may be copies or averages of each other, or a "
            "stated error of the light is too large."
        )
    if not more or _scatter_alone(prediction):
        return sentences
    sentences.append(f"The {listed([*more])} differ significantly ({_chances(more)}).")
    if prediction.cause:
        return [*sentences, prediction.cause]
    for one in prediction.missing:
        first = one is prediction.missing[0]
        sentences.append(
            f"{'The most likely cause is' if first else 'Added to that:'} {one.clause}. "
            f"Including it lowers -2 log likelihood by {one.strength**2:.0f}. "
            f"With it the chi-squares are {_ratios(one.after)}."
        )
    left = prediction.missing[-1].after if prediction.missing else agreement
    if any(one.is_missed and one.ratio > 1 for one in left.values()):
        sentences.append(NOTHING_KNOWN if not prediction.missing else REST_UNKNOWN)
    return sentences


def _scatter_alone(prediction: Prediction) -> bool:
    """Return whether scatter between levels explains the whole misfit."""
    scatters = {one.key for one in SCATTERS}
    if not prediction.missing or any(one.key not in scatters for one in prediction.missing):
        return False
    left = prediction.missing[-1].after.values()
    return not any(one.is_missed and one.ratio > 1 for one in left)


def _ratios(agreement: dict[str, Agreement]) -> str:
    return listed([f"{one.ratio:.3g} for {name}" for name, one in agreement.items()])


def _chances(agreement: dict[str, Agreement]) -> str:
    return ", ".join(format_p(one.p_value) for one in agreement.values())


def table(prediction: Prediction) -> Table:
    """Return the table of chi-squares, a row for each quantity."""
    rows = [
        (name, label, one.degrees, one.ratio, one.p_value)
        for comparison, label in zip(prediction.comparisons, prediction.labels, strict=True)
        for name, one in comparison.agreement.items()
    ]
    return Table(
        f"Prediction of {prediction.camera[:1].lower()}{prediction.camera[1:].rstrip(',')}",
        ("quantity", "levels", "degrees of freedom", "χ² per degree", "p-value"),
        tuple(rows),
        "The camera alone predicts each level by the moments of its sensor; errors are those of "
        "the frames and of the camera's draws. χ² per degree is near 1 if the prediction is right.",
    )


def levels_table(prediction: Prediction) -> Table:
    """Return the table of observed and predicted mean and variance at each level."""
    judged = prediction.main_comparison
    lit, values, missed = judged.lit, judged.found.values, judged.residuals
    several = range(2 if len(judged.agreement) > 1 else 1)
    light = "light (its rate fitted)" if prediction.unscaled else "light [photons]"
    rows = [
        (
            float(lit.light[i]) if lit.lit[i] else "dark",
            1e3 * float(lit.exposure[i]),
            *(
                x
                for one in several
                for x in (judged.measured[one, i], values[one, i], missed[one, i])
            ),
        )
        for i in range(len(lit.lit))
    ]
    heads = [light, "exposure [ms]", "mean [DN]", "predicted", "apart [σ]"]
    heads += ["variance [DN²]", "predicted", "apart [σ]"][: 3 * (len(several) - 1)]
    return Table(
        "Levels",
        tuple(heads),
        tuple(rows),
        "Apart: measured minus predicted, in standard errors of the frames and of the camera's "
        "draws.",
    )


def picture(prediction: Prediction) -> Picture:
    """Return the figure of residuals, drawn when it is requested."""
    return Picture(
        "prediction",
        "Residuals of the prediction",
        "Measured less predicted (by the camera alone), in standard errors, over the mean "
        "signal; squares are levels without light. The band is two standard errors.",
        partial(residual_figure, prediction),
    )


def residual_figure(prediction: Prediction) -> "Figure":
    """Draw the residuals over the signal, with a panel for each quantity."""
    judged = prediction.main_comparison
    count = len(judged.agreement)
    figure, panels = empty_panels((5.4, 1.5 + 1.3 * count), rows=count, sharex=True, squeeze=False)
    panels = panels[:, 0]
    signal, lit = judged.found.signal, np.asarray(judged.lit.lit) > 0
    colours = (BLUE, ORANGE)
    for panel, name in zip(panels, judged.agreement, strict=True):
        panel.axhspan(-BAND, BAND, color="0.93", zorder=0)
        panel.axhline(0, color="k", lw=0.8)
        words = ("along rows", "along columns") if len(PARTS[name]) > 1 else (None,)
        for row, colour, word in zip(PARTS[name], colours, words, strict=False):
            left = judged.residuals[row]
            panel.plot(signal[lit], left[lit], ".", color=colour, ms=6, label=word)
            panel.plot(signal[~lit], left[~lit], "s", color=colour, ms=3.5, mfc="none")
        if words[0]:
            above = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.2}
            panel.legend(fontsize=8, ncols=2, frameon=False, **above)
        panel.set_ylabel(name.replace(" of ", "\nof "), fontsize=9)
    panels[-1].set_xlabel("mean signal above black [DN]")
    figure.supylabel("measured less predicted [standard errors]", fontsize=9)
    return figure
