"""The findings on photographs of a surface, each with the condition under which it is reported.

The joint calibration uses the same findings on the images and the search, and adds findings on the
sensor."""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.special import stdtrit

from ...inference.diagnostics import listed
from ...inference.formatting import format_percent
from ...inference.trust import convergence_in_words
from ...report.section import Table
from ...report.sentences import Finding, Numbers, evaluate_findings, quoted
from ..models import LABELS, facet_sentence, has_lobe
from ..names import CLEAR, MODELS
from .calibration import ReflectanceCalibration, mean_residual, open_parameters, residual_of_images
from .comparison import equally_good, surpassed_by
from .fit import ChannelFit
from .lights import SHADOWED, light_in_shadows
from .perspective import AtOptimum, camera_nearness
from .pixel_area import area_share
from .shading_check import contradictions

NOTABLE_RESIDUAL = 0.02  # reported residual of a part of the object, of the mean signal
SIDES = {"upper": (0, 1), "lower": (0, -1), "left": (-1, 0), "right": (1, 0)}
SIDE_STARTS = 0.5  # component of the normal from which a pixel belongs to a side
OUTLINE = 0.4  # component of the normal toward the camera below which it belongs to the outline
GLOW = 0.002  # light in attached shadows, relative to k_d, that is reported
FEW_FREEDOM = 5.0  # with fewer, Student's 95 % intervals are over a third wider than Gaussian ones
CALM = 0.5  # chi-square per degree of freedom below which the stated noise is too large
HOPELESS = 2.0  # relative misfit from which a fit does not describe the images
FEWEST_IMAGES = 4  # images whose factors determine a scatter
TEXTURED = 0.7  # share of a pixel's own misfit that remains in the mean over all lights
NEAR, PERSPECTIVE, EXPLAINS = 5.0, 2.5, 0.1  # standard errors, degrees and share of the residuals
LITTLE = 0.02  # share of the residuals that a blur must explain
COLOURED = 3.0  # standard errors between channels from which a highlight is called coloured

OfChannel = tuple[ReflectanceCalibration, ChannelFit]


def findings(calibration: ReflectanceCalibration) -> tuple[str, ...]:
    """Return all findings about a reflectance calibration."""
    return (
        *evaluate_findings(GIVEN, calibration),
        *said_of_channels(OF_CHANNEL, calibration, calibration.chosen_fits),
        *evaluate_findings(OF_ALL, calibration),
        *view_findings(_brightest_fit(calibration)),
    )


def said_of_channels(
    table: Iterable[Finding], calibration: Any, fits: Sequence[Any]
) -> tuple[str, ...]:
    """Evaluate, for each fit, a table whose conditions take calibration and fit."""
    return tuple(
        sentence if len(fits) == 1 else f"{fit.channel}: {sentence}"
        for fit in fits
        for sentence in evaluate_findings(table, (calibration, fit))
    )


# ---------------------------------------------------------------- each channel


def _count_clipped(of: OfChannel) -> Numbers | None:
    samples = of[1].samples
    clipped = 0 if samples.saturated is None else int(np.sum(samples.saturated))
    most = {"clipped": clipped, "size": samples.dn.size, "clip": float(samples.clip)}
    return most if clipped else None


def _misfit(of: OfChannel, *, hopeless: bool) -> Numbers | None:
    """Report residuals above the sensor's noise. With `hopeless`, only channels whose residuals
    exceed the signal are reported, otherwise only channels with smaller residuals.
    """
    chi_square, relative = of[1].sensor_chi_square, of[1].spread.relative
    if chi_square is None or relative is None or (relative >= HOPELESS) != hopeless:
        return None
    return {"chi": chi_square, "error": format_percent(relative, decimals=2)}


def _calm(of: OfChannel) -> Numbers | None:
    chi_square = of[1].sensor_chi_square
    if chi_square is None or of[1].spread.relative is not None or chi_square >= CALM:
        return None
    return {"chi": chi_square}


def _lights(fit: ChannelFit) -> int:
    return len(np.unique(fit.selection.light))


def _regions(fit: ChannelFit) -> int:
    """Return the number of groups of lights with correlated errors."""
    return len(np.unique(fit.regions[fit.selection.light]))


def _too_few_lights(of: OfChannel) -> bool:
    """Return whether the lights are too few to measure how much they disagree."""
    return of[1].robustness is not None and bool(np.isnan(of[1].robustness.light_design_effect))


def _few_freedom(of: OfChannel) -> Numbers | None:
    fit = of[1]
    if fit.robustness is None or _too_few_lights(of):
        return None
    freedom = np.min(fit.robustness.freedom)
    if freedom >= FEW_FREEDOM:
        return None
    in_regions = _regions(fit) < _lights(fit)
    judges = f"{_regions(fit)} regions of the " if in_regions else ""
    return {
        "judges": f"{judges}{_lights(fit)} fitted lights",
        "freedom": freedom,
        "reach": stdtrit(freedom, 0.975),
        "end": "." if in_regions else "; more lights make them narrower.",
    }


def _design_effect(of: OfChannel) -> Numbers | None:
    fit = of[1]
    if fit.design_effect <= 1 or fit.robustness is None:
        return None
    return {
        "by_light": fit.robustness.light_design_effect,
        "by_pixel": fit.robustness.pixel_design_effect,
        "size": fit.samples.dn.size,
        "worth": fit.samples.dn.size / fit.design_effect,
        "wider": np.sqrt(fit.design_effect),
    }


def _region_numbers(of: OfChannel) -> Numbers | None:
    regions, lights = _regions(of[1]), _lights(of[1])
    return {"regions": regions, "lights": lights} if regions < lights else None


# ---------------------------------------------------------------- all channels


def _report_rotations(
    calibration: ReflectanceCalibration, *, followed: bool, wider: bool = False
) -> Numbers | None:
    """Report estimated rotations of lights, in standard deviations, by channel."""
    sizes = {
        fit.channel: f"{fit.turned.size:.2g}"
        for fit in calibration.chosen_fits
        if fit.turned is not None
        and fit.turned.followed == followed
        and (fit.turned.widened > 1 or not wider)
    }
    return {"channels": listed([*sizes]), "sizes": " / ".join(sizes.values())} if sizes else None


def _unseen_winner(calibration: ReflectanceCalibration) -> Numbers | None:
    """Report that a glossy model predicts best although BIC finds no evidence of a highlight."""
    best = equally_good(calibration.scores)[0]
    pairs = zip(calibration.fits[best], calibration.fits["lambert"], strict=True)
    unseen = [fit.channel for fit, matt in pairs if open_parameters(fit, matt)]
    if best == "lambert" or not unseen:
        return None
    where = "" if len(calibration.observation.channels) == 1 else f" in {', '.join(unseen)}"
    return {"model": LABELS[best], "where": where}


def _better_model(calibration: ReflectanceCalibration) -> Numbers | None:
    """Report that another model is better than the reported model in the comparison."""
    found = surpassed_by(calibration.scores, calibration.model)
    if found is None or _unseen_winner(calibration) is not None:
        return None
    better, how = found
    model = LABELS[calibration.model]
    return {"model": model, "how": how, "better": LABELS[better], "name": better}


def _list_uncompared(calibration: ReflectanceCalibration) -> Numbers | None:
    left_out = [LABELS[model] for model in MODELS if model not in calibration.fits]
    return {"models": listed(left_out)} if left_out else None


def _sampling(calibration: ReflectanceCalibration) -> list[str]:
    sampled = {n: p for n, p in calibration.posteriors.items() if p.sampled}
    if sampled:
        return [f"{name}: {convergence_in_words(p)}" for name, p in sampled.items()]
    return [convergence_in_words(p) for p in list(calibration.posteriors.values())[:1]]


def _coloured_highlight(calibration: ReflectanceCalibration, *, by_all: bool) -> Numbers | None:
    """Report unequal k_s under calibrated intensities, which is unexpected because a clear surface
    reflects the colour of the light. All lobes that predict equally well must agree.
    """
    reported, fits = _colour(calibration.chosen_fits), calibration.chosen_fits
    if reported is None or any(f.channel not in calibration.posteriors for f in fits):
        return None
    logs, errors = reported
    low, high = int(np.argmin(logs)), int(np.argmax(logs))
    z = _contrast(logs, errors, low, high)
    if z < COLOURED:
        return None
    neutral = [
        LABELS[model]
        for model in equally_good(calibration.scores)
        if (other := _colour(calibration.fits[model])) is not None
        and _contrast(*other, low, high) < COLOURED
    ]
    if by_all != (not neutral):
        return None
    ratio = np.exp(logs - logs[1])
    return {
        "high": fits[high].channel,
        "low": fits[low].channel,
        "z": z,
        "model": LABELS[calibration.model],
        "other": neutral[0] if neutral else "",
        "red": ratio[0],
        "blue": ratio[2],
    }


def _colour(fits: Sequence[ChannelFit]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return ln k_s of three channels and their standard errors; None if a channel has none."""
    known = [
        (fit.vector[1], np.sqrt(fit.robustness.covariance[1, 1]))
        for fit in fits
        if fit.robustness is not None
        and np.isfinite(fit.robustness.light_design_effect)  # otherwise errors are unknown
        and "specular" in [p.name for p in fit.space]
    ]
    if len(fits) != 3 or len(known) != 3:
        return None
    logs, errors = np.array(known).T
    return logs, errors


def _contrast(logs: np.ndarray, errors: np.ndarray, low: int, high: int) -> float:
    """Return the difference of ln k_s between two channels, in standard errors."""
    return float((logs[high] - logs[low]) / np.hypot(errors[low], errors[high]))


def _parts(calibration: ReflectanceCalibration) -> list[Numbers]:
    """Report the misfit at the object's outline, and the misfit on the side of the object with the
    largest misfit, each only if it is large enough.
    """
    residual, normals = mean_residual(calibration), calibration.observation.normals
    seen = np.isfinite(residual)
    parts = {"outline": normals[:, 2] < OUTLINE}
    for side, (x, y) in SIDES.items():
        toward = normals[:, 0] * x + normals[:, 1] * y > SIDE_STARTS
        parts[f"{side} part"] = toward & ~parts["outline"]
    means = {
        part: float(np.mean(residual[chosen & seen]))
        for part, chosen in parts.items()
        if (chosen & seen).any()
    }
    sides = [part for part in means if part != "outline"]
    worst = [max(sides, key=lambda part: abs(means[part]))] if sides else []
    return [
        {
            "part": part,
            "share": format_percent(abs(means[part]), decimals=1),
            "why": "brighter than predicted. Causes are light that the rig does not state "
            "(interreflection from a stand or table, stray light)"
            if means[part] > 0
            else "darker than predicted. Causes are a shadow",
            "assumed": _taken_for_granted(calibration),
        }
        for part in ("outline", *worst)
        if abs(means.get(part, 0.0)) > NOTABLE_RESIDUAL
    ]


def _texture(calibration: ReflectanceCalibration) -> Numbers | None:
    """Report a misfit that is the same under all lights, such as that of a textured surface. Other
    misfits decrease in the average over lights.
    """
    misfits = [fit.spread.relative for fit in calibration.chosen_fits if fit.spread.relative]
    own = float(np.nanstd(mean_residual(calibration)))
    if len(misfits) < len(calibration.chosen_fits) or own < TEXTURED * np.mean(misfits):
        return None
    return {"share": format_percent(own, decimals=1)}


def _brightness(calibration: ReflectanceCalibration) -> Numbers | None:
    """Report a misfit that a factor on each image's brightness explains."""
    misfits = [fit.spread.relative for fit in calibration.chosen_fits if fit.spread.relative]
    factors = residual_of_images(calibration)
    factors = factors[np.isfinite(factors)]
    if len(misfits) < len(calibration.chosen_fits) or factors.size < FEWEST_IMAGES:
        return None
    own = float(np.std(factors))
    if own < max(TEXTURED * np.mean(misfits), NOTABLE_RESIDUAL):
        return None
    return {
        "share": format_percent(own, decimals=1),
        "low": format_percent(float(factors.min()), decimals=1),
        "high": format_percent(float(factors.max()), decimals=1),
    }


def _taken_for_granted(calibration: ReflectanceCalibration) -> str:
    """Return sentences on a fit's assumptions, and how to change them."""
    observation = calibration.observation
    granted = []
    if observation.gamma is None and not calibration.chosen_fits[0].form.free_gamma:
        granted.append("linear files (give camera.gamma, or --fit-gamma, for sRGB pictures)")
    if (np.ptp(observation.falloff, axis=1) == 0).all():
        granted.append("lamps at infinity (give a near lamp's position in place of its direction)")
    granted.append("the stated geometry (the sphere's centre and radius, the normals)")
    granted.append(
        "equal amplifiers (camera.taps states others, with black_level and gain of each)"
    )
    granted.append("an orthographic camera, far from the object and in focus")
    return listed(granted)


def _brightest_fit(calibration: ReflectanceCalibration) -> tuple[AtOptimum, ...]:
    """Return the fit of the most likely model to the brightest channel, if it converged."""
    means = [float(np.mean(fit.samples.dn)) for fit in calibration.chosen_fits]
    fits = (of_model[int(np.argmax(means))] for of_model in calibration.fits.values())
    fit = max(fits, key=lambda own: own.log_likelihood)
    if not fit.converged:
        return ()
    return (AtOptimum(calibration.observation, fit.vector, fit.samples, calibration.fitted),)


def view_findings(fits: Iterable[AtOptimum]) -> tuple[str, ...]:
    """Return the findings on the camera's distance and focus, from fits of one channel."""
    lobes = (fit for fit in fits if has_lobe(fit.samples.form.model))
    return tuple(sentence for fit in lobes for sentence in evaluate_findings(OF_VIEW, fit))


def _perspective(fit: AtOptimum) -> Numbers | None:
    """Report highlights that lie where a camera nearby would see them."""
    near = camera_nearness(*fit)
    angle, sigmas = np.degrees(near.angle), abs(near.inverse) / near.error
    if not (sigmas > NEAR and angle > PERSPECTIVE and near.explained > EXPLAINS):
        return None
    return {"angle": angle, "share": format_percent(near.explained), "sigmas": sigmas}


def _blur(fit: AtOptimum) -> Numbers | None:
    """Report highlights that are wider or narrower than those of sharp photographs."""
    found = area_share(fit.vector, fit.samples, fit.selection.light)
    sigmas = abs(found.share - 1) / found.error
    if not (sigmas > NEAR and found.explained > LITTLE):
        return None
    blurred = found.blur > 0
    return {
        "how": "a blur" if blurred else "sharpening",
        "size": abs(found.blur),
        "sigmas": sigmas,
        "share": format_percent(found.explained),
        "causes": "defocus, motion, demosaicing or resizing" if blurred else "a filter",
        "wide": "wide and low" if blurred else "narrow and high",
    }


def _shadows(calibration: ReflectanceCalibration) -> Numbers | None:
    """Report light in attached shadows, which no source of the rig reaches."""
    observation = calibration.observation
    light, pixel = np.nonzero(observation.cosine < SHADOWED)
    glow = []
    for i, fit in enumerate(calibration.chosen_fits):
        dark = light_in_shadows(observation, i)
        if dark is None or fit.form.ambient:
            return None
        irradiance = observation.intensity[i, light] * observation.falloff[light, pixel]
        glow.append(dark / np.mean(irradiance) / fit.natural[0])
    if max(glow) < GLOW:
        return None
    return {"shares": " / ".join(f"{100 * part:.2g}" for part in glow)}


CONTRADICTED = quoted("contradicted", lambda c: contradictions(c.observation, gamma=c.gamma))
GIVEN = (
    CONTRADICTED,
    quoted("assumed", lambda c: c.observation.findings),
    Finding(
        "unused levels",
        lambda c: c.observation.levels is not None,
        "Flats and darks are not used here; joint.calibrate (jaxvision-fit joint) fits with them.",
    ),
)

NOT_CONVERGED = Finding(
    "not converged",
    lambda of: not of[1].converged,
    "The fit did not converge; do not use its numbers.",
)
IDENTIFIABLE = quoted(
    "identifiability",
    lambda of: of[1].identifiability.sentences,
)
OF_CHANNEL = (
    NOT_CONVERGED,
    IDENTIFIABLE,
    Finding(
        "not determined",
        lambda of: [
            {"parameter": parameter, "why": why}
            for parameter, why in of[0].open_parameters[of[1].channel].items()
        ],
        "{parameter} is not determined: {why}.",
    ),
    Finding(
        "saturated",
        _count_clipped,
        "{clipped} of {size} samples are saturated; they count as 'at least {clip:g} DN'.",
    ),
    Finding(
        "misfit",
        partial(_misfit, hopeless=False),
        "Residuals are larger than the sensor's noise (chi-square per degree of freedom {chi:.2f});"
        " an error of {error} of the signal would explain them, by unequal pixels (PRNU), uneven"
        " light or a surface that differs from the model.",
    ),
    Finding(
        "no description",
        partial(_misfit, hopeless=True),
        "Residuals are larger than the sensor's noise (chi-square per degree of freedom {chi:.2f});"
        " they are larger than the signal, so the images do not show such a surface under these"
        " lights. Do not use the numbers.",
    ),
    Finding(
        "calm",
        _calm,
        "Residuals are smaller than the stated noise (chi-square per degree of freedom {chi:.2g}):"
        " check camera.gain and camera.read_noise.",
    ),
    Finding(
        "unjudged",
        lambda of: {"lights": _lights(of[1])} if _too_few_lights(of) else None,
        "With so few fitted lights ({lights}), an error that the pixels of one image share (that of"
        " its light, say) cannot be estimated. The intervals assume that there is none and may"
        " be far too narrow; use more lights.",
    ),
    Finding(
        "few degrees of freedom",
        _few_freedom,
        "Errors are estimated from the agreement of {judges}, with {freedom:.1f} degrees of"
        " freedom, so 95 % intervals extend {reach:.3g} standard errors to either side{end}",
    ),
    Finding(
        "design effect",
        _design_effect,
        "Residuals are correlated (design effect {by_light:.3g} within images, {by_pixel:.3g}"
        " within pixels), so {size} samples hold as much information as {worth:.0f} independent"
        " ones. The intervals include this; they are {wider:.1f} times wider on average over the"
        " parameters.",
    ),
    Finding(
        "regions of lights",
        _region_numbers,
        "The misfit of images under neighbouring lights is similar, so the intervals count"
        " {regions} regions of the {lights} lights as independent, not each light. Parameters may"
        " differ under lights from other directions.",
    ),
)

OF_ALL = (
    Finding(
        "lights astray",
        partial(_report_rotations, followed=False),
        "{channels}: to fit the images, lights would have to be rotated by {sizes} times"
        " direction_sd (rms): it is too small, or the model has another misfit. The directions of"
        " the rig were kept, and no statement on the highlight is made.",
    ),
    Finding(
        "lights turned",
        partial(_report_rotations, followed=True),
        "The directions of the lights were fitted, with intensities and distances that have a joint"
        " covariance: they changed by {sizes} standard deviations (rms).",
    ),
    Finding(
        "directions wider",
        partial(_report_rotations, followed=True, wider=True),
        "{channels}: changes of this size are significant: direction_sd is too small, or the"
        " directions absorb a misfit of the model. The intervals use an error of the directions as"
        " large as the changes; state a larger direction_sd, and compare models.",
    ),
    quoted(
        "clear facets",
        lambda c: [facet_sentence(c.chosen_fits[0].requested.index)] * (c.model in CLEAR),
    ),
    Finding(
        "unseen winner",
        _unseen_winner,
        "{model} predicts best, but its terms beyond Lambert's model are not determined{where}: the"
        " difference may be chance.",
    ),
    Finding(
        "better model",
        _better_model,
        "The reported model, {model}, is not the best: it {how} {better}. --model"
        " {name} reports that one (model={name!r} in Python).",
    ),
    Finding(
        "not compared",
        _list_uncompared,
        "Not compared: {models}; --compare-all (compare_all=True in Python) fits these too.",
    ),
    quoted("sampling", _sampling),
    Finding(
        "colour of one lobe",
        partial(_coloured_highlight, by_all=False),
        "Whether the highlight is coloured depends on the lobe: k_s is larger in {high} than in"
        " {low} by {z:.0f} standard errors with {model}, but not with {other}, which predicts"
        " unseen lights as well. No conclusion is drawn.",
    ),
    Finding(
        "coloured",
        partial(_coloured_highlight, by_all=True),
        "The highlight is coloured: k_s red : green : blue = {red:.2f} : 1 : {blue:.2f}, {z:.0f}"
        " standard errors from neutral. A clear coat reflects the colour of the light, so either"
        " the surface is metallic, the intensities are wrong, or the highlight's shape differs from"
        " the model.",
    ),
    Finding(
        "part of the object",
        _parts,
        "Averaged over all lights, the {part} of the object is {share} {why}, a surface that"
        " differs from the model, or a wrong assumption of the rig: {assumed}.",
    ),
    Finding(
        "brightness",
        _brightness,
        "Most of the misfit is one factor for each image: whole images differ from the prediction"
        " by {low} to {high} ({share} rms). Causes are lamps of another brightness than the rig"
        " states, or automatic exposure; correct the intensities, or state intensity_sd.",
    ),
    Finding(
        "texture",
        _texture,
        "Most of the misfit, {share} of the signal, is the same in a pixel under all"
        " lights: a surface of varying albedo (texture, stains), or unequal pixels.",
    ),
    Finding(
        "glowing shadows",
        _shadows,
        "Attached shadows are not black: on average they have {shares} % of the diffuse term in"
        " full light. Causes are interreflection, stray light, or a black level that is set too"
        " low. The fit leaves shadows out, and intervals include the effect of an equal amount"
        " of light on all pixels.",
    ),
)

OF_VIEW = (
    Finding(
        "perspective",
        _perspective,
        "The highlights lie as if the directions to the camera differed by up to {angle:.2g}"
        " degrees from its axis ({sigmas:.0f} standard errors), which explains {share} of the"
        " squared residuals. The fit assumes a distant camera. If it is near, or the radius or"
        " the normals are wrong, the parameters of the highlight are wrong by more than their"
        " intervals; photograph from farther away.",
    ),
    Finding(
        "blur",
        _blur,
        "The images look as after {how} of {size:.2g} pixels (standard deviation; {sigmas:.0f}"
        " standard errors), which explains {share} of the squared residuals. The fit assumes that"
        " each pixel is the mean over its own area. If the cause is {causes}, and not a highlight"
        " that differs from the model, the fitted highlights are too {wide} by more than their"
        " intervals; give sharp photographs, or average blocks of pixels wider than the blur.",
    ),
)


def misfit_table(calibration: ReflectanceCalibration) -> Table:
    """Tabulate, by channel, chi-square with and without the misfit, and the design effects."""

    def row(fit: ChannelFit) -> tuple:
        robust = fit.robustness
        return (
            fit.channel,
            fit.sensor_chi_square,
            fit.chi_square,
            fit.spread.relative,
            None
            if robust is None or np.isnan(robust.light_design_effect)
            else robust.light_design_effect,
            None if robust is None else robust.pixel_design_effect,
            round(fit.samples.dn.size / fit.design_effect),
        )

    return Table(
        title="Noise and misfit",
        columns=(
            "channel",
            "χ²/dof, sensor alone",
            "χ²/dof, with misfit",
            "relative misfit",
            "design effect in images",
            "design effect in pixels",
            "effective samples",
        ),
        rows=tuple(row(fit) for fit in calibration.chosen_fits),
        caption="A dash stands for what is unknown or not needed; a design effect of 1 means "
        "independent residuals.",
    )
