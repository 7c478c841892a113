"""The report section of a reflectance calibration from images: the parameters of one of
`reflectance.models` in each channel.

Several models are fitted to the same lights and compared on the held-out lights. The requested
model is reported in full, with findings on its weaknesses.
"""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ...inference.estimates import Estimate, gaussian_estimate, not_determined
from ...inference.posterior import Posterior, estimates
from ...report.left_out import left_out_tables
from ...report.section import Picture, Section
from ..material import material_files
from ..models import LABELS
from ..names import CLEAR
from . import figures
from .calibration import ReflectanceCalibration
from .comparison import comparison_table, only_if_described, verdict
from .findings import findings, misfit_table
from .fit import ChannelFit, robust_covariance
from .signal import parameter_space


def section(calibration: ReflectanceCalibration) -> Section:
    """Report a calibrated reflectance: estimates, findings, tables and pictures."""
    observation = calibration.observation
    held_out, index = int(observation.held_out.sum()), calibration.chosen_fits[0].requested.index
    return section_of_photographs(
        calibration,
        calibration.chosen_fits,
        [score for score in calibration.scores if score.model == calibration.model],
        kind="brdf",
        title="Reflectance",
        estimates=_estimates(calibration),
        findings=(verdict(calibration.scores, held_out), *findings(calibration)),
        pictures=_pictures(calibration),
        tables=(
            comparison_table(calibration.scores, held_out),
            misfit_table(calibration),
            *left_out_tables((fit.channel, fit.stated.left_out) for fit in calibration.chosen_fits),
        ),
        settings={
            "samples per channel": len(calibration.fitted.light),
            "smallest n.l": calibration.minimum_cosine,
            "black level [DN]": observation.black,
            "gamma": observation.gamma or 1.0,
        }
        | ({"index of refraction": index} if calibration.model in CLEAR else {}),
    )


def section_of_photographs(
    calibration: Any,
    fits: Sequence[Any],
    scores: Iterable[Any],
    *,
    title: str,
    settings: dict[str, Any],
    **parts: Any,
) -> Section:
    """Return the report section of a calibration from photographs, with the fits of its reported
    model. The section has no numbers for channels that the model does not predict.
    """
    observation, posteriors = calibration.observation, calibration.posteriors
    label = LABELS[calibration.model]
    common = {
        "model": calibration.model,
        "lights fitted": int((~observation.held_out).sum()),
        "lights held out": int(observation.held_out.sum()),
        "pixels of the object": observation.cosine.shape[1],
        "clip level [DN]": observation.clip,
    }
    materials = {
        fit.channel: (fit.form.model, fit.form.index, posteriors[fit.channel])
        for fit in fits
        if fit.channel in posteriors
    }
    found = Section(
        title=f"{title}: {label}",
        posteriors=posteriors,
        settings=common | settings,
        records=material_files(materials),
        **parts,
    )
    errors = {
        one.channel: one.fitted_error if one.predicted_error is None else one.predicted_error
        for one in scores
    }
    return only_if_described(found, label, errors)


def _estimates(calibration: ReflectanceCalibration) -> tuple[Estimate, ...]:
    rows: list[Estimate] = []
    for fit in calibration.chosen_fits:
        if fit.channel in calibration.posteriors:
            rows += determined_estimates(calibration.posteriors[fit.channel], fit.channel, {})
            continue
        rows += _partial_estimates(fit, calibration.open_parameters[fit.channel])
    return tuple(rows)


def determined_estimates(
    posterior: Posterior, channel: str, reasons: dict[str, str]
) -> list[Estimate]:
    """Return the estimates of one channel. A parameter has no number if `reasons` states why, or if
    the data bound the parameter on one side only.
    """
    if posterior.endless:
        one_sided = "the data bound it on one side only (see the findings)"
        reasons = reasons | {posterior.endless: one_sided}
    return [
        not_determined(e, reasons[e.name], group=channel) if e.name in reasons else e
        for e in estimates(posterior, group=channel)
    ]


def _partial_estimates(fit: ChannelFit, reasons: dict[str, str]) -> list[Estimate]:
    """Estimate the parameters that the data determine, with all others fixed at their best values.
    For these others, state why the data do not determine them.
    """
    known = [i for i, parameter in enumerate(fit.space) if parameter.name not in reasons]
    errors, freedom = np.zeros(len(fit.space)), np.full(len(fit.space), np.inf)
    if known:
        robust = robust_covariance(fit, np.array(known))
        errors[known] = np.sqrt(np.diagonal(robust.covariance))
        freedom[known] = robust.freedom
    rows = [
        gaussian_estimate(
            fit.space[i],
            fit.natural[i],
            fit.natural[i] * errors[i],
            method="Laplace",
            group=fit.channel,
            log_scale=True,
            freedom=freedom[i],
        )
        for i in known
    ]
    wanted = {parameter.name: parameter for parameter in parameter_space(fit.requested)}
    rows += [not_determined(wanted[x], why, group=fit.channel) for x, why in reasons.items()]
    return rows


def _pictures(calibration: ReflectanceCalibration) -> tuple[Picture, ...]:
    model = LABELS[calibration.model]
    return (
        Picture(
            "images",
            "Measured, predicted, and their difference",
            f"Two lights of the fit and two held-out ones, {model}. Last row: measured less "
            "predicted in per cent of the brightest predicted pixel (red: the photograph is "
            "brighter); saturated pixels are grey.",
            partial(figures.images_figure, calibration),
        ),
        Picture(
            "lobes",
            "The two terms of the model against their angle",
            "Away from the highlight, signal per unit of light against n.l: the diffuse term is a "
            "straight line. The highlight, after subtraction of the diffuse term, against the "
            "angle to the mirror direction. Dots: medians of the fitted lights, bars: middle 68 % "
            "of the pixels; lines: the fit (medians of it where it does not depend on that angle "
            "alone).",
            partial(figures.lobes_figure, calibration),
        ),
        Picture(
            "comparison",
            "Error of the prediction, by model",
            "Relative RMS of the predicted images: dots for held-out lights, strokes for "
            "the fitted lights. Further left is better; a dot far to the right of its stroke would "
            "mean over-fitting.",
            partial(figures.comparison_figure, calibration),
        ),
        Picture(
            "residual_map",
            "Misfit of the model, averaged over all lights",
            "Measured less predicted, in per cent of the predicted signal of each pixel over "
            "all images and channels. Structure here is not noise but light or shape that the "
            "model lacks.",
            partial(figures.residual_map_figure, calibration),
        ),
    )
