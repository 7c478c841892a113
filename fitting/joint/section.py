"""Write the report section of a joint calibration."""

from functools import partial

from ..inference.estimates import Estimate, not_determined
from ..reflectance.from_images.section import determined_estimates, section_of_photographs
from ..report.left_out import left_out_tables
from ..report.section import Picture, Section
from . import figures
from .calibration import JointCalibration
from .findings import findings, hiding_pixels, misfit_table, misses_as_noise, score_table
from .misfit import NOISE
from .prediction import score


def section(calibration: JointCalibration) -> Section:
    """Report a joint calibration: estimates, findings, tables and pictures."""
    scores = tuple(
        score(calibration.observation, fit, calibration.posteriors[fit.channel].covariance)
        for fit in calibration.fits
        if fit.channel in calibration.posteriors
    )
    known = calibration.fits[0].data.known
    gone = left_out_tables((fit.channel, fit.left_out) for fit in calibration.fits)
    return section_of_photographs(
        calibration,
        calibration.fits,
        scores,
        kind="joint",
        title="Surface, response and sensor",
        estimates=_estimates(calibration),
        findings=findings(calibration),
        pictures=_pictures(calibration),
        tables=(score_table(scores), misfit_table(calibration), *gone),
        settings={f"{name}, taken as exact": float(value) for name, value in known.items()},
    )


def _estimates(calibration: JointCalibration) -> tuple[Estimate, ...]:
    rows: list[Estimate] = []
    for fit in calibration.fits:
        posterior, group = calibration.posteriors.get(fit.channel), fit.channel
        reasons: dict[str, str] = {}
        if posterior is None:
            why = "the data do not determine every parameter (see the findings)"
            rows += [not_determined(parameter, why, group=group) for parameter in fit.space]
            continue
        if misses_as_noise(calibration, fit):
            reasons = dict.fromkeys(NOISE, "the model misses the surface (see the findings)")
        elif (judged := hiding_pixels((calibration, fit))) is not None and judged[1]:
            reasons = dict.fromkeys(NOISE, "pixels may be unequal (see the findings)")
        rows += determined_estimates(posterior, group, reasons)
    return tuple(rows)


def _pictures(calibration: JointCalibration) -> tuple[Picture, ...]:
    if len(calibration.posteriors) < len(calibration.fits):
        return ()
    pictures = [
        Picture(
            "images",
            "Measured, predicted, and their difference",
            "Fitted and held-out lights. Last row: measured minus predicted, in standard "
            "deviations of one pixel that include the stated errors of the light; grey pixels are "
            "unlit, saturated or near black.",
            partial(figures.images_figure, calibration),
        ),
        Picture(
            "noise",
            "Noise of the pixels against their signal",
            "Dots: mean squared residual of a pixel without the error of its light, with "
            "standard errors. Line: what gain, read noise and encoding of the fit predict.",
            partial(figures.noise_figure, calibration),
        ),
    ]
    if "light_scatter" in calibration.fits[0].values:
        pictures.append(
            Picture(
                "lights",
                "How far each light is from its stated strength",
                "Means and standard deviations given the fitted surface and the scale of the "
                "errors. An error that all lights share is part of the errors of k_d and k_s.",
                partial(figures.lights_figure, calibration),
            )
        )
    return tuple(pictures)
