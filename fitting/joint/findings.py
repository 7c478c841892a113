"""The findings of a joint calibration, each with the condition under which it is reported, and the
tables of its report."""

from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np

from ..inference.diagnostics import listed
from ..inference.formatting import format_percent
from ..inference.parameters import names, prior_gaussian
from ..inference.trust import convergence_in_words
from ..reflectance.from_images.findings import (
    CONTRADICTED,
    IDENTIFIABLE,
    NOT_CONVERGED,
    said_of_channels,
    view_findings,
)
from ..reflectance.from_images.lights import light_in_shadows
from ..reflectance.from_images.perspective import AtOptimum
from ..reflectance.from_images.read import ASSUMED_BLACK, Photographs
from ..report.section import Table
from ..report.sentences import Finding, Numbers, evaluate_findings, quoted
from .calibration import JointCalibration, fit_of_surface
from .fit import JointFit, image_errors
from .misfit import APART, NOISE, UnequalPixels, unequal_pixels
from .model import MISFIT_AT, given_black_level
from .prediction import Score

PRIOR_ALONE = 0.7  # posterior over prior standard deviation above which the prior dominates
UNLIT, FEWEST_UNLIT = 0.0, 30  # cosine of incidence in attached shadow; pixels needed
BELOW_DARKS, GAINS_APART = 5.0, 5.0  # standard errors from which darks, or gains, differ
UNLIKE_GAIN = 0.15  # relative difference of gains that is reported
ROUNDS = 5  # rounds of reweighting
LITTLE = 1.05  # factor on scores and intervals up to which nothing is reported
NOTABLE = 2.5  # standard deviations of an image's error that are reported

OfChannel = tuple[JointCalibration, JointFit]


def findings(calibration: JointCalibration) -> tuple[str, ...]:
    """Return all findings about a joint calibration."""
    return (
        *evaluate_findings(GIVEN, calibration),
        *said_of_channels(OF_CHANNEL, calibration, calibration.fits),
        *view_findings(_brightest_fit(calibration)),
    )


def _brightest_fit(calibration: JointCalibration) -> tuple[AtOptimum, ...]:
    fit = max(calibration.fits, key=lambda own: float(np.max(own.data.cells.mean)))
    found = fit_of_surface(fit) if fit.converged else None
    return () if found is None else (found,)


def darker_than_darks(observation: Photographs) -> list[Numbers]:
    """Report unlit pixels that are darker than the darks, which is impossible."""
    found: list[Numbers] = []
    unlit = observation.cosine < UNLIT
    for i, levels in enumerate(observation.levels or ()):
        if not levels.dark.any() or np.count_nonzero(unlit) < FEWEST_UNLIT:
            continue
        of_darks = float(np.mean(levels.mean[levels.dark]))
        dn = observation.dn[i][unlit]
        below = of_darks - float(np.median(dn))
        error = 1.2533 * float(np.std(dn)) / np.sqrt(len(dn))  # of the median
        if below > max(1.0, BELOW_DARKS * np.hypot(error, levels.mean_error[levels.dark].max())):
            found.append(
                {"median": np.median(dn), "count": len(dn), "below": below, "darks": of_darks}
            )
    return found


def gains_disagree(fit: JointFit, stated: float | None) -> Numbers | None:
    """Report, for linear files, a gain of the object's pixels unlike that of flats or rig."""
    cells, levels = fit.data.cells, fit.data.levels
    freedom = np.asarray(cells.count, float) - 1
    some = freedom > 0
    own, error = _slope(
        np.asarray(cells.mean)[some], np.asarray(cells.scatter)[some] / freedom[some], freedom[some]
    )
    if levels is not None:
        source = "flats and darks give"
        numbers = (np.asarray(x, float) for x in (levels.mean, levels.variance, levels.freedom))
        other, of_other = _slope(*numbers)
    elif stated is not None:
        source, other, of_other = "the rig states", stated, 0.0
    else:
        return None
    apart = abs(own - other)
    if not (apart > GAINS_APART * np.hypot(error, of_other) and apart > UNLIKE_GAIN * other):
        return None
    also = ", or a texture or unequal pixels add to the scatter" if own > other else ""
    return {"own": own, "source": source, "other": other, "also": also}


def _slope(mean: np.ndarray, variance: np.ndarray, freedom: np.ndarray) -> tuple[float, float]:
    """Fit variances linearly over means, reweighted; return the slope and its error."""
    if len(mean) < 3 or np.ptp(mean) == 0:
        return np.nan, np.inf
    expected, line, covariance = np.full(len(mean), variance.mean()), np.zeros(2), np.eye(2)
    for _ in range(ROUNDS):
        weights = np.sqrt(freedom / 2) / expected
        line, covariance = np.polyfit(mean, variance, 1, w=weights, cov="unscaled")
        expected = np.maximum(np.polyval(line, mean), 0.05 * variance.mean())
    return float(line[0]), float(np.sqrt(covariance[0, 0]))


def misses_as_noise(calibration: JointCalibration, fit: JointFit) -> bool:
    """Return whether the fitted gain and read noise absorb the model's misfit. The sign is that
    images disagree although the scatter within their cells is not larger than the fitted noise.
    """
    free = not {*NOISE} <= set(fit.data.known) and fit.data.levels is None
    robust = calibration.robust.get(fit.channel)
    disagree = robust is not None and robust.design_effect > 1
    return free and fit.unexplained is None and disagree


# ---------------------------------------------------------------- conditions


def _posterior(of: OfChannel):
    return of[0].posteriors.get(of[1].channel)


def _misfit(of: OfChannel) -> Numbers | None:
    """Report the misfit relative to the signal, in dark and in bright pixels."""
    fit = of[1]
    if fit.unexplained is None:
        return None
    cells, white = fit.data.cells, float(fit.data.white)
    digital = np.asarray(cells.mean)[np.asarray(cells.count) > 0] - float(fit.values["black_level"])
    dark, bright = (
        format_percent(float(fit.values["misfit"]) * np.sqrt(MISFIT_AT * white / level), decimals=1)
        for level in np.quantile(digital, (0.1, 0.9))
    )
    return {"chi": fit.unexplained, "dark": dark, "bright": bright}


def hiding_pixels(of: OfChannel) -> tuple[UnequalPixels, bool] | None:
    """Estimate unequal gains of pixels from the scatter of pixels within cells. Return the
    estimate, and whether unequal gains make system gain and read noise unidentifiable. Return None
    if the scatter does not determine unequal gains.
    """
    calibration, fit = of
    if "prnu" in fit.values or _posterior(of) is None or misses_as_noise(calibration, fit):
        return None
    seen = unequal_pixels(fit)
    return seen, seen.hide_noise(calibration.observation.camera.prnu_sd is not None)


def _shadows(of: OfChannel) -> Numbers | None:
    """Report light in attached shadows, which the error of the black level includes."""
    observation, fit = of[0].observation, of[1]
    channel = observation.channels.index(fit.channel)
    black, sd = given_black_level(observation, channel)
    glow = light_in_shadows(replace(observation, black=black), channel)
    if not glow or abs(glow) <= NOTABLE * (sd or 0.0):
        return None
    return {"size": abs(glow), "word": "above" if glow > 0 else "below", "black": black}


def _unequal(of: OfChannel, *, found: bool) -> Numbers | None:
    """Report significant unequal gains (`found`), or hidden ones that could bias the noise."""
    judged = hiding_pixels(of)
    if judged is None or not judged[1] or judged[0].are_significant != found:
        return None
    seen = judged[0]
    remedy = ", or flats and darks"
    if of[1].data.levels is not None:
        remedy = "; `noise` measures gain and read noise from the flats and darks alone"
    size, most = (format_percent(x, decimals=2) for x in (seen.size, seen.most))
    numbers = {"deviations": seen.deviations, "prnu": seen.size, "moved": seen.moved}
    return numbers | {"size": size, "most": most, "remedy": remedy}


def _gain_of_scatter(of: OfChannel) -> Numbers | None:
    """Report that only the scatter of the object's pixels determines the gain."""
    calibration, fit = of
    known = "system_gain" in fit.data.known or fit.data.levels is not None
    seen = hiding_pixels(of)
    if known or seen is None or seen[1]:
        return None
    stated = calibration.observation.camera.prnu_sd is not None
    return {"why": "which the rig says are equal" if stated else "which shows no unequal pixels"}


def _disagree(of: OfChannel) -> Numbers | None:
    """Report images whose likelihoods have larger gradients than independent cells explain."""
    calibration, fit = of
    robust = calibration.robust.get(fit.channel)
    if _posterior(of) is None or robust is None or robust.design_effect <= 1:
        return None
    wider = robust.gaussian_covariance.diagonal() / np.linalg.inv(fit.information).diagonal()
    sizes = {"larger": np.sqrt(robust.design_effect), "wider": np.sqrt(np.median(wider))}
    return None if max(sizes.values()) < LITTLE else sizes


def _halves(of: OfChannel, *, agree: bool | None) -> Numbers | None:
    """Report whether separate fits to two halves of the images differ by more than their noise."""
    halves = of[0].halves.get(of[1].channel)
    if _disagree(of) is None or agree != (None if halves is None else halves.agree):
        return None
    if halves is None or halves.agree:
        return {}
    even, odd = halves.values
    apart = np.flatnonzero(np.abs(halves.deviations) >= APART)
    shown = listed([f"{halves.names[i]} ({even[i]:.3g} and {odd[i]:.3g})" for i in apart])
    return {"shown": shown, "worst": np.abs(halves.deviations).max()}


def _prior_alone(of: OfChannel) -> Numbers | None:
    posterior = _posterior(of)
    if posterior is None:
        return None
    share = np.sqrt(np.diagonal(posterior.covariance)) / prior_gaussian(posterior.space)[1]
    given = [n for n, s in zip(names(posterior.space), share, strict=True) if s > PRIOR_ALONE]
    frames = " or its flats and darks give" * (of[0].observation.levels is not None)
    return {"given": listed(given), "frames": frames} if given else None


def _odd_light(of: OfChannel) -> Numbers | None:
    """Report the image whose light deviates most, if the deviation is notable."""
    calibration, fit = of
    found = image_errors(fit)
    if _posterior(of) is None or found is None or "light_scatter" not in fit.values:
        return None
    mean = found[0][:, 0]
    relative = mean * np.asarray(fit.data.relative["light_scatter"] * fit.values["light_scatter"])
    worst = int(np.argmax(np.abs(mean)))
    if abs(mean[worst]) < NOTABLE:
        return None
    return {
        "file": np.array(calibration.observation.files)[fit.grid.lights][worst],
        "share": format_percent(abs(relative[worst]), decimals=1),
        "word": "brighter" if relative[worst] > 0 else "darker",
        "times": abs(mean[worst]),
    }


# ---------------------------------------------------------------- sentences

GIVEN = (
    CONTRADICTED,
    quoted(
        "assumed",
        lambda c: [
            sentence
            for sentence in c.observation.findings
            if sentence != ASSUMED_BLACK or "black_level" in c.fits[0].data.known
        ],
    ),
    Finding(
        "darker than darks",
        lambda c: darker_than_darks(c.observation),
        "Pixels that face away from the light have {median:.1f} DN (median of {count}),"
        " {below:.1f} DN less than the darks ({darks:.1f} DN), although light can only add. The"
        " darks have another temperature, exposure or setting, and bias gain and read noise. Leave"
        " them out, or take darks together with the images.",
    ),
)
OF_CHANNEL = (
    NOT_CONVERGED,
    Finding(
        "no highlight",
        lambda of: of[1].form.model != of[0].model,
        "No highlight is detected: the best fit has a specular amplitude of zero.",
    ),
    Finding(
        "misfit",
        _misfit,
        "The cells scatter more than noise and the errors that the rig states explain (chi-square"
        " per cell {chi:.2f}). A misfit of {dark} of the signal in dark pixels and {bright} in"
        " bright ones would explain it. Causes are a surface that differs from the model, an"
        " intensity_sd, direction_sd, stray_sd or prnu_sd that the rig does not state, or a wrong"
        " black level, gain or read noise.",
    ),
    Finding(
        "glowing shadows",
        _shadows,
        "Pixels that face away from a light read {size:.1f} DN {word} the black level of"
        " {black:.1f} DN. Causes are a wrong black level, stray light or interreflection. The fit"
        " takes that black level as uncertain by as much and estimates it from the images.",
    ),
    Finding(
        "unequal pixels",
        partial(_unequal, found=True),
        "The variance of pixels grows with the square of their signal, unlike shot and read noise:"
        " PRNU or a texture of about {size} ({deviations:.0f} standard errors above 0). It hides"
        " the gain and the read noise; give the rig camera.prnu_sd = {prnu:.2g}{remedy}.",
    ),
    Finding(
        "unseen unequal pixels",
        partial(_unequal, found=False),
        "PRNU of {most}, which these images cannot distinguish from shot and read noise, would"
        " change the gain or the read noise by {moved:.1f} standard errors: neither is printed."
        " Give the rig camera.prnu_sd (0 if pixels are equal and the surface is smooth){remedy}.",
    ),
    Finding(
        "gain of scatter",
        _gain_of_scatter,
        "The gain is estimated from the scatter of the object's pixels, {why}; this assumes a"
        " surface without texture.",
    ),
    Finding(
        "gains disagree",
        lambda of: (
            None
            if "gamma" in of[1].values
            else gains_disagree(of[1], of[0].observation.camera.gain)
        ),
        "The scatter of the object's pixels implies a gain of {own:.3g} DN/e-, but"
        " {source} {other:.3g} DN/e-: that gain is not the gain of the images{also}. Do"
        " not use the gain and the read noise.",
    ),
    IDENTIFIABLE,
    Finding(
        "not identifiable",
        lambda of: _posterior(of) is None,
        "The data and the rig do not determine all parameters, so there are no intervals.",
    ),
    Finding(
        "images disagree",
        _disagree,
        "The images do not agree within their noise (their scores are {larger:.1f} times as large"
        " as with independent cells): the misfit of the model is correlated within an image. The"
        " intervals therefore count images, not cells, as independent data, and are {wider:.1f}"
        " times wider in the median over the parameters.",
    ),
    Finding(
        "misfit as noise",
        lambda of: _disagree(of) is not None and misses_as_noise(*of),
        "Gain and read noise are free and absorb the misfit of the model, so neither is"
        " printed. Give the rig camera.gain and camera.read_noise, or flats and darks, to measure"
        " the misfit.",
    ),
    Finding(
        "no halves",
        partial(_halves, agree=None),
        "The images are too few, or too different, to check this by separate fits to two halves.",
    ),
    Finding(
        "halves agree",
        partial(_halves, agree=True),
        "Separate fits to the even and to the odd images agree within these intervals.",
    ),
    Finding(
        "halves differ",
        partial(_halves, agree=False),
        "Separate fits to the even and to the odd images differ in {shown}, by up to {worst:.0f}"
        " standard deviations: the result depends on the choice of images, because the model does"
        " not describe the surface. The intervals include half of the difference; try another"
        " model.",
    ),
    Finding(
        "prior alone",
        _prior_alone,
        "The estimates of {given} are those that the rig states{frames}; the images add little.",
    ),
    Finding(
        "odd light",
        _odd_light,
        "{file} is {share} {word} than its intensity says, {times:.1f} times the usual error of a"
        " light.",
    ),
    quoted(
        "convergence",
        lambda of: [convergence_in_words(p) for p in [_posterior(of)] if p is not None],
    ),
)


def score_table(scores: tuple[Score, ...]) -> Table:
    """Tabulate errors of predicted images and shares of pixels within the bands."""
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
                *(_percent(x) for x in (s.fitted_error, s.predicted_error)),
                s.band,
                *(_percent(x) for x in (s.fitted_share, s.unseen_share)),
            )
            for s in scores
        ),
        caption="RMS of predicted minus measured over the RMS of the signal above black. The "
        "band is for one pixel: noise, parameters, misfit and the errors that lights share. It is "
        "1.96 standard deviations. With a misfit, which is not Gaussian, it is wide enough to "
        "cover 95 % of the pixels under the fitted lights.",
    )


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def misfit_table(calibration: JointCalibration) -> Table:
    """Tabulate the chi-square of the cells, by channel."""
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
        caption="A cell is a set of pixels of similar normals in one image. A dash under misfit "
        "means that cells alone require none, for example because a free gain and read noise "
        "absorb the misfit of the model; the findings say whether the images agree.",
    )
