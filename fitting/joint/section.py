"""The report of surface, response and sensor in one posterior."""

from functools import partial

from ..inference.estimates import Estimate, not_determined
from ..inference.posterior import estimates
from ..reflectance.from_images.comparison import only_if_described
from ..reflectance.material import material_files
from ..reflectance.models import LABELS
from ..report.left_out import left_out_tables
from ..report.section import Picture, Section
from . import figures
from .calibration import JointCalibration
from .findings import findings, misfit_table, misses_as_noise, score_table
from .misfit import NOISE, unequal_pixels
from .prediction import score


def section(calibration: JointCalibration) -> Section:
    """Report a joint calibration: estimates, findings, tables and pictures."""
    observation = calibration.observation
    scores = tuple(
        score(observation, fit, calibration.posteriors[fit.channel].covariance)
        for fit in calibration.fits
        if fit.channel in calibration.posteriors
    )
    known = calibration.fits[0].data.known
    gone = left_out_tables((fit.channel, fit.left_out) for fit in calibration.fits)
    found = Section(
        kind="joint",
        title=f"Surface, response and sensor: {LABELS[calibration.model]}",
        estimates=_estimates(calibration),
        findings=findings(calibration),
        pictures=_pictures(calibration),
        tables=(score_table(scores), misfit_table(calibration), *gone),
        posteriors=calibration.posteriors,
        settings={
            "model": calibration.model,
            "lights fitted": int((~observation.held_out).sum()),
            "lights held out": int(observation.held_out.sum()),
            "pixels of the object": observation.cosine.shape[1],
            "clip level [DN]": observation.clip,
            **{f"{name}, taken as exact": float(value) for name, value in known.items()},
        },
        records=material_files(
            {
                fit.channel: (fit.data.form.model, fit.data.form.index, posterior)
                for fit in calibration.fits
                if (posterior := calibration.posteriors.get(fit.channel)) is not None
            }
        ),
    )
    errors = {
        one.channel: one.fitted_error if one.unseen_error is None else one.unseen_error
        for one in scores
    }
    return only_if_described(found, LABELS[calibration.model], errors)


def _estimates(calibration: JointCalibration) -> tuple[Estimate, ...]:
    rows: list[Estimate] = []
    for fit in calibration.fits:
        if fit.channel in calibration.posteriors:
            found = estimates(calibration.posteriors[fit.channel], group=fit.channel)
            stated = calibration.observation.camera.prnu_sd is not None
            hidden = "prnu" not in fit.values and unequal_pixels(fit).hide_noise(stated)
            why = "pixels may be unequal (see the findings)"
            if misses_as_noise(calibration, fit):
                hidden, why = True, "the model misses the surface (see the findings)"
            endless = calibration.posteriors[fit.channel].endless
            reasons: dict[str, str] = dict.fromkeys(NOISE, why) if hidden else {}
            if endless:
                reasons[endless] = "the data bound it on one side only (see the findings)"
            rows += [
                not_determined(e, reasons[e.name], group=fit.channel) if e.name in reasons else e
                for e in found
            ]
        else:
            why = "the data leave a direction open (see the findings)"
            rows += [not_determined(parameter, why, group=fit.channel) for parameter in fit.space]
    return tuple(rows)


def _pictures(calibration: JointCalibration) -> tuple[Picture, ...]:
    if len(calibration.posteriors) < len(calibration.fits):
        return ()
    pictures = [
        Picture(
            "images",
            "Measured, predicted, and what is left",
            "Lights of the fit and held-out ones. Last row: measured less predicted in standard "
            "deviations of one pixel, the errors that a light may have included; grey pixels are "
            "unlit, saturated or near black.",
            partial(figures.images_figure, calibration),
        ),
        Picture(
            "noise",
            "Noise of the pixels against their signal",
            "Dots: mean squared residual of a pixel, the error of its light taken off, with "
            "standard errors. Line: what gain, read noise and encoding of the fit predict.",
            partial(figures.noise_figure, calibration),
        ),
    ]
    if "light_scatter" in calibration.fits[0].values:
        pictures.append(
            Picture(
                "lights",
                "How far each light is from what the rig says",
                "Means and standard deviations given the fitted surface and the scale of the "
                "errors; the lights' common error is that of k_d and k_s.",
                partial(figures.lights_figure, calibration),
            )
        )
    return tuple(pictures)
