"""What a reader of a joint calibration must be told, in sentences and as tables."""

import jax.numpy as jnp
import numpy as np

from ..inference.diagnostics import listed
from ..inference.formatting import format_percent
from ..inference.parameters import names, prior_gaussian
from ..inference.posterior import Posterior
from ..inference.trust import convergence_in_words
from ..reflectance.from_images.read import ASSUMED_BLACK, Photographs
from ..reflectance.from_images.shading_check import contradictions
from ..reflectance.names import SHOWS
from ..report.section import Table
from .calibration import JointCalibration
from .fit import JointFit, image_errors
from .halves import APART
from .model import MISFIT_AT
from .prediction import Score
from .unequal_pixels import NOISE, unequal_pixels

PRIOR_ALONE = 0.7  # posterior over prior standard deviation from which the prior is what is seen
UNLIT, FEWEST_UNLIT = 0.0, 30  # cosine of incidence of pixels in attached shadow; so many tell
BELOW_DARKS, GAINS_APART = 5.0, 5.0  # standard errors by which darks, or gains, are another's
UNLIKE_GAIN = 0.15  # relative difference of gains worth a word
ROUNDS = 5  # of reweighting
NOTABLE = 2.5  # standard deviations of an image's error worth a word


def findings(calibration: JointCalibration) -> tuple[str, ...]:
    """Assumptions, misfit, identifiability, what the priors alone tell, and convergence."""
    gamma = calibration.fits[0].values.get("gamma")
    encoding = None if gamma is None else float(gamma)
    return (
        *contradictions(calibration.observation, gamma=encoding),
        *(
            sentence
            for sentence in calibration.observation.findings
            if sentence != ASSUMED_BLACK or "black_level" in calibration.fits[0].data.known
        ),
        *darker_than_darks(calibration.observation),
        *(s for fit in calibration.fits for s in _channel_findings(calibration, fit)),
    )


def _channel_findings(calibration: JointCalibration, fit: JointFit) -> list[str]:
    one = len(calibration.fits) == 1
    name = "" if one else f"{fit.channel}: "
    found = []
    if not fit.converged:
        found.append("The fit did not converge; do not use its numbers.")
    if fit.data.form.model != calibration.model:
        found.append("No highlight is seen: the best fit has a specular amplitude of zero.")
    if fit.unexplained is not None:
        found.append(
            f"The cells scatter more than noise and the errors that the rig names allow "
            f"(chi-square per cell {fit.unexplained:.2f}); a misfit of {_misfit_in_words(fit)} "
            "explains them: a surface that is not the model's, "
            "an intensity_sd, direction_sd, stray_sd or prnu_sd that the rig does not give, or a "
            "black level, gain or read noise that is not the images'."
        )
    posterior = calibration.posteriors.get(fit.channel)
    if "prnu" not in fit.values and posterior is not None:
        stated = calibration.observation.camera.prnu_sd is not None
        found += [] if misses_as_noise(calibration, fit) else _gain_findings(fit, stated=stated)
    if "gamma" not in fit.values:
        found += gains_disagree(fit, calibration.observation.camera.gain)
    found += fit.identifiability.sentences
    if posterior is None:
        found.append("The data and the rig leave a direction open, so there are no intervals.")
        return [f"{name}{sentence}" for sentence in found]
    robust = calibration.robust.get(fit.channel)
    if robust is not None and robust.design_effect > 1:
        wider = robust.gaussian_covariance.diagonal() / np.linalg.inv(fit.information).diagonal()
        found.append(
            "The images do not agree within their noise (their scores are "
            f"{np.sqrt(robust.design_effect):.1f} times as large as independent cells make them): "
            "what the model misses goes together within an image. The intervals take images, "
            f"not cells, for independent data: {np.sqrt(np.median(wider)):.1f} times wider in the "
            "median over the parameters."
        )
        if misses_as_noise(calibration, fit):
            found.append(
                "Gain and read noise are free and take what the model misses for noise, so neither "
                "is printed. Give the rig camera.gain and camera.read_noise, or flats and darks, "
                "to see how large the misfit is."
            )
        found += _halves_findings(calibration, fit)
    found += _prior_alone(posterior, of_frames=calibration.observation.levels is not None)
    found += _image_findings(calibration, fit)
    found.append(convergence_in_words(posterior))
    return [f"{name}{sentence}" for sentence in found]


def darker_than_darks(observation: Photographs) -> list[str]:
    """Report pixels that no light reaches and that are darker than the darks, since light only
    adds."""
    found = []
    unlit = observation.cosine < UNLIT
    for i, levels in enumerate(observation.levels or ()):
        if not levels.dark.any() or np.count_nonzero(unlit) < FEWEST_UNLIT:
            continue
        of_darks = float(np.mean(levels.mean[levels.dark]))
        dn = observation.dn[i][unlit]
        below = of_darks - float(np.median(dn))
        error = 1.2533 * float(np.std(dn)) / np.sqrt(len(dn))  # of the median of a Gaussian
        if below > max(1.0, BELOW_DARKS * np.hypot(error, levels.mean_error[levels.dark].max())):
            found.append(
                f"Pixels that face away from the light lie at {np.median(dn):.1f} DN (median of "
                f"{len(dn)}), {below:.1f} DN below the darks ({of_darks:.1f} DN), although light "
                "can only add: the darks are of another temperature, exposure or setting, and move "
                "the surface's estimates. Leave them out, or take darks beside the images."
            )
    return found


def gains_disagree(fit: JointFit, stated: float | None) -> list[str]:
    """Report pixels of the object that scatter with another gain than flats and darks show or the
    rig states (DN/e-)."""
    cells, levels = fit.data.cells, fit.data.levels
    freedom = np.asarray(cells.count, float) - 1
    some = freedom > 0
    own, error = _slope(
        np.asarray(cells.mean)[some], np.asarray(cells.scatter)[some] / freedom[some], freedom[some]
    )
    if levels is not None:
        source = "flats and darks tell"
        numbers = (np.asarray(x, float) for x in (levels.mean, levels.variance, levels.freedom))
        other, of_other = _slope(*numbers)
    elif stated is not None:
        source, other, of_other = "the rig states", stated, 0.0
    else:
        return []
    apart = abs(own - other)
    if not (apart > GAINS_APART * np.hypot(error, of_other) and apart > UNLIKE_GAIN * other):
        return []
    also = ", or a texture or unequal pixels add to the scatter" if own > other else ""
    return [
        f"The scatter of the object's pixels rises by {own:.3g} DN^2/DN with their signal, where "
        f"{source} a gain of {other:.3g} DN/e-: they are of another gain than the images{also}. "
        "Do not use the gain and the read noise."
    ]


def _slope(mean: np.ndarray, variance: np.ndarray, freedom: np.ndarray) -> tuple[float, float]:
    """Slope of variances over means with its standard error, by weights of their own fit."""
    if len(mean) < 3 or np.ptp(mean) == 0:
        return np.nan, np.inf
    columns, expected = (
        np.stack([np.ones_like(mean), mean], axis=1),
        np.full(len(mean), variance.mean()),
    )
    coefficients, covariance = np.zeros(2), np.eye(2)
    for _ in range(ROUNDS):
        weight = freedom / (2 * expected**2)
        covariance = np.linalg.inv((columns.T * weight) @ columns)
        coefficients = covariance @ (columns.T @ (weight * variance))
        expected = np.maximum(columns @ coefficients, 0.05 * variance.mean())
    return float(coefficients[1]), float(np.sqrt(covariance[1, 1]))


def misses_as_noise(calibration: JointCalibration, fit: JointFit) -> bool:
    """Whether a free gain and read noise stand for the misfit: images disagree, but their cells
    scatter no more than that noise."""
    free = not {*NOISE} <= set(fit.data.known) and fit.data.levels is None
    robust = calibration.robust.get(fit.channel)
    disagree = robust is not None and robust.design_effect > 1
    return free and fit.unexplained is None and disagree


def _halves_findings(calibration: JointCalibration, fit: JointFit) -> list[str]:
    """Whether halves of the images tell the same."""
    halves = calibration.halves.get(fit.channel)
    if halves is None:
        return ["The images are too few, or too unlike, to check this by fits of their halves."]
    if halves.agree:
        return ["The even and the odd images, fitted alone, agree within these intervals."]
    even, odd = halves.values
    worst = int(np.argmax(np.abs(halves.deviations)))
    apart = np.flatnonzero(np.abs(halves.deviations) >= APART)
    told = listed([f"{halves.names[i]} ({even[i]:.3g} and {odd[i]:.3g})" for i in apart])
    return [
        f"The even and the odd images, fitted alone, differ in {told}, by up to "
        f"{abs(halves.deviations[worst]):.0f} standard deviations: which images there are decides "
        "the answer, for the model misses the surface. The intervals hold half of the difference; "
        "try another model."
    ]


def _gain_findings(fit: JointFit, *, stated: bool) -> list[str]:
    """Whether gain and read noise explain how pixels scatter."""
    seen = unequal_pixels(fit)
    remedy = ", or flats and darks"
    if fit.data.levels is not None:
        remedy = "; the flats and darks alone tell gain and read noise by `noise`"
    if seen.found:
        return [
            "The variance of pixels grows with the square of their signal, which neither photons "
            "nor read-out make: unequal pixels, or a texture, of about "
            f"{format_percent(seen.size, decimals=2)} "
            f"({seen.deviations:.0f} standard errors from none). They hide the gain and the "
            f"read noise; give the rig camera.prnu_sd = {seen.size:.2g}{remedy}."
        ]
    if seen.hide_noise(stated):
        return [
            f"Unequal pixels of {format_percent(seen.most, decimals=2)}, which these images "
            "cannot tell from photons and "
            f"read-out, would move the gain or the read noise by {seen.moved:.1f} standard errors: "
            "neither is printed. Give the rig camera.prnu_sd (0 if pixels are alike and the "
            f"surface is smooth){remedy}."
        ]
    if "system_gain" in fit.data.known or fit.data.levels is not None:
        return []
    why = "which the rig says are equal" if stated else "which shows no unequal pixels"
    return [f"The gain is read off the scatter of the object's pixels, {why}, and no texture."]


def _misfit_in_words(fit: JointFit) -> str:
    """How large it is beside the signal, in dark pixels and in bright ones."""
    cells, white = fit.data.cells, float(fit.data.white)
    digital = np.asarray(cells.mean)[np.asarray(cells.count) > 0] - float(fit.values["black_level"])
    dark, bright = (
        float(fit.values["misfit"]) * np.sqrt(MISFIT_AT * white / level)
        for level in np.quantile(digital, (0.1, 0.9))
    )
    return (
        f"{format_percent(dark, decimals=1)} of the signal where it is dark and "
        f"{format_percent(bright, decimals=1)} where it is bright"
    )


def _prior_alone(posterior: Posterior, *, of_frames: bool) -> list[str]:
    before = prior_gaussian(posterior.space)[1]
    share = np.sqrt(np.diagonal(posterior.covariance)) / before
    told = [name for name, s in zip(names(posterior.space), share, strict=True) if s > PRIOR_ALONE]
    if not told:
        return []
    source = "the rig states or its flats and darks tell" if of_frames else "the rig states"
    return [f"The estimates of {listed(told)} are those that {source}; the images add little."]


def _image_findings(calibration: JointCalibration, fit: JointFit) -> list[str]:
    """Images whose light is notably off."""
    found = image_errors(fit)
    if found is None or "light_scatter" not in fit.values:
        return []
    scale = float(fit.values["light_scatter"])
    files = np.array(calibration.observation.files)[fit.grid.lights]
    mean = found[0][:, 0]
    relative = mean * np.asarray(fit.data.relative["light_scatter"]) * scale
    worst = int(np.argmax(np.abs(mean)))
    if abs(mean[worst]) < NOTABLE:
        return []
    word = "brighter" if relative[worst] > 0 else "darker"
    return [
        f"{files[worst]} is {format_percent(abs(relative[worst]), decimals=1)} {word} than its "
        "intensity says, "
        f"{abs(mean[worst]):.1f} times the usual error of a light."
    ]


def no_description(scores: tuple[Score, ...]) -> list[str]:
    """Report, for each channel, a model that misses most of the images."""
    errors = {
        s.channel: s.fitted_error if s.unseen_error is None else s.unseen_error for s in scores
    }
    return [
        f"{channel}: the model does not describe the images: it misses {format_percent(error)} of "
        f"the signal, where more than {format_percent(SHOWS)} is no description."
        for channel, error in errors.items()
        if error > SHOWS
    ]


def score_table(scores: tuple[Score, ...]) -> Table:
    """Errors of the predicted images, and how many pixels lie within the predicted bands."""
    return Table(
        title="Predicted images",
        columns=(
            "channel",
            "error, fitted lights [%]",
            "error, unseen lights [%]",
            "95 % band [deviations]",
            "within it, fitted [%]",
            "within it, unseen [%]",
        ),
        rows=tuple(
            (
                s.channel,
                *(_percent(x) for x in (s.fitted_error, s.unseen_error)),
                s.band,
                *(_percent(x) for x in (s.fitted_share, s.unseen_share)),
            )
            for s in scores
        ),
        caption="RMS of predicted less measured over the RMS of the signal above black. The band "
        "is that of one pixel: noise, parameters, misfit and the errors that lights share. It is "
        "1.96 standard deviations, or with a misfit, which is not Gaussian, as many as hold 95 % "
        "of the pixels under the lights of the fit.",
    )


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def misfit_table(calibration: JointCalibration) -> Table:
    """Chi-square of the cells, by channel."""
    return Table(
        title="Fit",
        columns=("channel", "χ² per cell", "cells", "pixels in them", "misfit"),
        rows=tuple(
            (
                fit.channel,
                fit.chi_square,
                fit.cells,
                int(jnp.sum(fit.data.cells.count)),
                float(fit.values["misfit"]) if "misfit" in fit.values else None,
            )
            for fit in calibration.fits
        ),
        caption="A cell is a set of pixels of like normals in one image. A dash under misfit means "
        "that cells alone ask for none, as where a free gain and read noise take for noise what "
        "the model misses; the findings say whether the images agree.",
    )
