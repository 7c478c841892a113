"""Write the report of fits to measured reflectance: a section for each material, and a comparison
if there are several.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from ...inference.estimates import Estimate, gaussian_estimate, not_determined
from ...inference.formatting import format_unit, format_with_error
from ...inference.posterior import estimates
from ...report.section import Picture, Section, Table, describing_nothing
from ..models import LABELS, REFLECTANCES, has_lobe, shape_of
from ..names import AXIS_NAMES, MODELS, OBJECTIVES, Model, Objective
from . import figures
from .calibration import BRDFCalibration
from .errors import METRICS, best, metric
from .findings import findings, no_description, readable, which_axis_wins


def section(calibration: BRDFCalibration) -> Section:
    """Return the report section of one material: estimates, findings, tables and figures."""
    measured = calibration.measured
    posterior = calibration.posterior
    found = Section(
        kind=f"brdf_{measured.name}",
        title=f"{readable(measured.name)}: {LABELS[calibration.model]}",
        estimates=_estimates(calibration),
        findings=findings(calibration),
        pictures=_pictures(calibration),
        tables=(error_table(calibration), amplitude_table(calibration)),
        posteriors={} if posterior is None else {measured.name: posterior},
        settings={
            "model": calibration.model,
            "objective": calibration.objective,
            "index of refraction": calibration.index,
            "samples": len(measured.values),
            "bands": len(measured.bands),
            "incidences [degrees]": ", ".join(f"{x:.0f}" for x in np.degrees(measured.incidences)),
            "held out": "each incidence in turn",
        },
    )
    missed = no_description(calibration)
    groups = {one.group for one in found.estimates}
    return describing_nothing(found, missed, groups) if missed else found


def materials_section(calibrations: Sequence[BRDFCalibration]) -> Section:
    """Return the report section that compares several materials: held-out errors of every model,
    and which type of lobe is best.

    Args:
        calibrations: one per material.

    Returns:
        Findings, tables and a picture.
    """
    objective = calibrations[0].objective
    return Section(
        kind="brdf_materials",
        title="Which lobe describes which material",
        estimates=(),
        findings=which_axis_wins(calibrations),
        tables=tuple(materials_table(calibrations, which) for which in OBJECTIVES),
        pictures=(
            Picture(
                "materials",
                "Error by model and material",
                f"The {METRICS[objective]} at incidences that no fit has seen; the "
                "smallest of each material is framed.",
                partial(figures.materials_figure, calibrations),
            ),
        ),
    )


def materials_table(calibrations: Sequence[BRDFCalibration], which: Objective) -> Table:
    """Tabulate a held-out error: a row for each model, a column for each material."""
    factor, digits, unit = (
        (100, 1, "% of the signal's RMS") if which == "cosine" else (1, 4, "sr⁻¹ᐟ³")
    )
    winners = {c.measured.name: best(c.held_out, which) for c in calibrations}

    def cell(calibration: BRDFCalibration, model: Model) -> str:
        text = f"{factor * metric(calibration.held_out[model], which):.{digits}f}"
        return f"{text} *" if winners[calibration.measured.name] == model else text

    return Table(
        title=f"Held-out {METRICS[which]} [{unit}]",
        columns=("model", "lobe about", *(readable(c.measured.name) for c in calibrations)),
        rows=tuple(
            (LABELS[m], AXIS_NAMES[REFLECTANCES[m].axis], *(cell(c, m) for c in calibrations))
            for m in MODELS
        ),
        caption=f"Fits of the {calibrations[0].objective} objective; each incidence predicted by "
        "the fit without it; * the smallest of its material.",
    )


def error_table(calibration: BRDFCalibration) -> Table:
    """Tabulate both error metrics of every model, on fitted and on held-out samples."""
    order = sorted(
        MODELS, key=lambda model: metric(calibration.held_out[model], calibration.objective)
    )
    return Table(
        title="Comparison of models at held-out incidences",
        columns=(
            "model",
            "lobe about",
            "shape",
            "RMS [sr⁻¹]",
            "RMS [%]",
            "fitted [%]",
            "cube root",
            "fitted",
        ),
        rows=tuple(
            (
                LABELS[model],
                AXIS_NAMES[REFLECTANCES[model].axis],
                _shape_in_words(calibration, model),
                calibration.held_out[model].rms,
                f"{100 * calibration.held_out[model].relative:.1f}",
                f"{100 * calibration.fitted[model].relative:.1f}",
                calibration.held_out[model].cube_root,
                calibration.fitted[model].cube_root,
            )
            for model in order
        ),
        caption="RMS errors of f_r cos θi over all bands, in sr⁻¹ and in % of its own RMS, and of "
        "its cube root, in sr⁻¹ᐟ³: each incidence predicted by the fit without it, or, where it "
        "says fitted, by the fit to all samples. Fits minimise "
        + (
            "the RMS of f_r cos θi."
            if calibration.objective == "cosine"
            else "the RMS of the cube root."
        ),
    )


def amplitude_table(calibration: BRDFCalibration) -> Table:
    """Tabulate k_d and k_s of every band with errors; they share the lobe's shape."""
    found = calibration.amplitudes
    unit = format_unit(REFLECTANCES[calibration.model].unit)
    heads = ["k_d [sr⁻¹]"]
    columns = [(found.diffuse, found.diffuse_error)]
    if has_lobe(calibration.model):
        heads.append(f"k_s [{unit}]" if unit else "k_s")
        columns.append((found.specular, found.specular_error))
    return Table(
        title=f"Amplitudes by band, {LABELS[calibration.model]}",
        columns=("band", *heads),
        rows=tuple(
            (
                band,
                *(
                    format_with_error(values[i], errors[i]) if errors[i] else "0"
                    for values, errors in columns
                ),
            )
            for i, band in enumerate(calibration.measured.bands)
        ),
        caption="With jackknife standard errors; the estimates of the amplitudes are the means of "
        "these columns.",
    )


def _shape_in_words(calibration: BRDFCalibration, model: Model) -> str | None:
    value = calibration.fits[model].whole.shape
    if value is None:
        return None
    shape = shape_of(model)
    number = f"{value:.0f}" if value >= 100 else f"{value:.3g}"
    return f"{shape.symbol} = {number} {format_unit(shape.unit)}".rstrip()


def _estimates(calibration: BRDFCalibration) -> tuple[Estimate, ...]:
    if calibration.posterior is not None:
        return estimates(calibration.posterior)
    rows = []
    for i, parameter in enumerate(calibration.space):
        if parameter.name in calibration.open_parameters:
            rows.append(not_determined(parameter, calibration.open_parameters[parameter.name]))
            continue
        value, deviation = calibration.mean[i], np.sqrt(calibration.covariance[i, i])
        rows.append(
            gaussian_estimate(
                parameter, value, value * deviation, method="jackknife", log_scale=True
            )
        )
    return tuple(rows)


def _pictures(calibration: BRDFCalibration) -> tuple[Picture, ...]:
    return (
        Picture(
            "slices",
            "Measured and fitted in the plane of incidence",
            "f_r cos θi, mean of the bands, by the viewer's angle from the normal, positive on "
            "the far side from the light; dotted: the mirror direction. Dots: measured. Lines: the "
            "best lobe of each kind and Lambert, each fitted WITHOUT the incidence it is drawn at. "
            "The scale is linear below the tick nearest to zero.",
            partial(figures.slices_figure, calibration),
        ),
        Picture(
            "errors",
            "Error by model",
            "Bars: incidences that no fit has seen; black lines: the samples of the fit. Lower is "
            "better.",
            partial(figures.errors_figure, calibration),
        ),
        Picture(
            "incidences",
            "Where the models miss",
            "Held-out RMS of f_r cos θi at each incidence, in per cent of the RMS measured there.",
            partial(figures.incidences_figure, calibration),
        ),
        Picture(
            "amplitudes",
            "Amplitudes of the bands",
            f"k_d and k_s of {LABELS[calibration.model]} with jackknife standard errors.",
            partial(figures.amplitudes_figure, calibration),
        ),
    )
