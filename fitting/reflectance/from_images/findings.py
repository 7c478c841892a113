"""What a reader of a reflectance calibration must be told, in sentences and as a table."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import stdtrit

from ...inference.diagnostics import listed
from ...inference.formatting import format_percent
from ...inference.parameters import names
from ...inference.trust import convergence_in_words
from ...report.section import Table
from ..models import LABELS, facet_sentence
from ..names import CLEAR, MODELS
from .calibration import ReflectanceCalibration, mean_residual, open_parameters
from .comparison import equally_good, surpassed_by
from .fit import ChannelFit
from .optimum_among_turns import TurnedLights
from .shading_check import contradictions

NOTABLE_RESIDUAL = 0.02  # of the mean signal, in one part of the object
SIDES = {"upper": (0, 1), "lower": (0, -1), "left": (-1, 0), "right": (1, 0)}
SIDE_STARTS = 0.5  # component of the normal from which a pixel belongs to a side
OUTLINE = 0.4  # component of the normal toward the camera below which it belongs to the outline
SHADOWED, GLOW = -0.05, 0.002  # n.l of a safe shadow; its light, as a part of k_d, worth a word
FEWEST_SHADOWED = 100
FEW_FREEDOM = 5.0  # below: Student's 95 % intervals are a third wider than Gaussian ones
CALM = 0.5  # chi-square per degree of freedom below which the stated noise is too large
HOPELESS = 2.0  # relative misfit from which a fit describes nothing
TEXTURED = 0.7  # of the misfit: what a mean over all lights leaves of that of a pixel's own
UNUSED_LEVELS = (
    "Flats and darks do not count here; joint.calibrate (jaxvision-fit joint) fits with them."
)
COLOURED = 3.0  # standard errors between channels from which a highlight is called coloured


def findings(calibration: ReflectanceCalibration) -> tuple[str, ...]:
    """Misfit, identifiability, saturation, convergence and structure in the residuals."""
    first = calibration.reported[0]
    requested, found = first.requested, dict(zip(names(first.space), first.natural, strict=True))
    gamma = float(found["gamma"]) if "gamma" in found else None
    return (
        *contradictions(calibration.observation, gamma=gamma),
        *calibration.observation.findings,
        *([] if calibration.observation.levels is None else [UNUSED_LEVELS]),
        *(s for fit in calibration.reported for s in _channel_findings(calibration, fit)),
        *_lights_finding(calibration),
        *([facet_sentence(requested.index)] if calibration.model in CLEAR else []),
        *(_unseen_winner(calibration) or _better_model(calibration)),
        *_not_compared(calibration),
        *_sampling_findings(calibration),
        *_colour_finding(calibration),
        *_part_findings(calibration),
        *_texture_finding(calibration),
        *_shadow_finding(calibration),
    )


def _lights_finding(calibration: ReflectanceCalibration) -> list[str]:
    """Where lights of uncertain directions were left, or how far they were turned."""
    observation = calibration.observation
    known = (observation.uncertain.get("direction_sd", np.zeros(1)) > 0) & ~observation.held_out
    if not known.any():
        return []
    found = []
    turned = {fit.channel: fit.turned for fit in calibration.reported if fit.turned is not None}
    left = {name: lights for name, lights in turned.items() if not lights.followed}
    if left:
        found.append(
            f"{listed([*left])}: to fit the images, lights would have to be turned by "
            f"{_times(left)} times direction_sd (rms): it is too small, or the model misses "
            "something else. They were left where the rig has them, and no highlight is told."
        )
    followed = {name: lights for name, lights in turned.items() if lights.followed}
    if followed:
        found.append(
            f"Lights were turned to where their images put them, by {_times(followed)} times "
            "direction_sd along either axis (rms)."
        )
    wider = {name: lights for name, lights in followed.items() if lights.widened > 1}
    if wider:
        found.append(
            f"{listed([*wider])}: turns as large are no chance: direction_sd is too small, or the "
            "model misses something that turned lights take up. Intervals take the directions for "
            "as uncertain as that; give direction_sd as large as it is, and compare models."
        )
    return found


def _times(turned: Mapping[str, TurnedLights]) -> str:
    return " / ".join(f"{lights.size:.2g}" for lights in turned.values())


def misfit_table(calibration: ReflectanceCalibration) -> Table:
    """Chi-square with and without the misfit, and the design effects, by channel."""

    def row(fit: ChannelFit) -> tuple:
        robust = fit.robustness
        return (
            fit.channel,
            fit.sensor_chi_square,
            fit.chi_square,
            fit.spread.relative,
            None if robust is None or np.isnan(robust.by_light) else robust.by_light,
            None if robust is None else robust.by_pixel,
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
        rows=tuple(row(fit) for fit in calibration.reported),
        caption="A dash stands for what is unknown or not needed; a design effect of 1 means "
        "independent residuals.",
    )


def _name(calibration: ReflectanceCalibration, fit: ChannelFit) -> str:
    return f"{fit.channel}: " if len(calibration.observation.channels) > 1 else ""


def _channel_findings(calibration: ReflectanceCalibration, fit: ChannelFit) -> list[str]:
    name, found = _name(calibration, fit), []
    if not fit.converged:
        found.append(f"{name}The fit did not converge; do not use its numbers.")
    found += [f"{name}{sentence}" for sentence in fit.identifiability.sentences]
    found += [
        f"{name}{parameter} is not determined: {why}."
        for parameter, why in calibration.open_parameters[fit.channel].items()
    ]
    if fit.samples.saturated is not None and (clipped := int(np.sum(fit.samples.saturated))):
        found.append(
            f"{name}{clipped} of {fit.samples.dn.size} samples are saturated; they count as "
            f"'at least {float(fit.samples.clip):g} DN'."
        )
    if fit.sensor_chi_square is not None and fit.spread.relative is not None:
        found.append(
            f"{name}Residuals are larger than the sensor's noise (chi-square per degree of freedom "
            f"{fit.sensor_chi_square:.2f}); "
            + (
                f"an error of {format_percent(fit.spread.relative, decimals=2)} of the signal "
                "explains them: unequal "
                "pixels (PRNU), uneven light or a surface that is not the model's."
                if fit.spread.relative < HOPELESS
                else "they are larger than the signal: the images do not show such a surface under "
                "these lights, so do not use the numbers."
            )
        )
    elif fit.sensor_chi_square is not None and fit.sensor_chi_square < CALM:
        found.append(
            f"{name}Residuals are smaller than the stated noise (chi-square per degree of freedom "
            f"{fit.sensor_chi_square:.2g}): check camera.gain and camera.read_noise."
        )
    if fit.robustness is not None and np.isnan(fit.robustness.by_light):
        found.append(
            f"{name}From so few lights as fitted ({_lights(fit)}) it cannot "
            "be judged how far the pixels of one image share an error (of its light, say); the "
            "intervals assume that they do not and may be far too narrow, so use more lights."
        )
    elif fit.robustness is not None and np.min(fit.robustness.freedom) < FEW_FREEDOM:
        found.append(
            f"{name}Errors are judged by how {_judges(fit)} agree; that leaves "
            f"{np.min(fit.robustness.freedom):.1f} degrees of freedom, so 95 % intervals reach "
            f"{stdtrit(np.min(fit.robustness.freedom), 0.975):.3g} standard errors to either side"
            + ("." if _in_regions(fit) else "; more lights narrow them.")
        )
    if fit.design_effect > 1:
        assert fit.robustness is not None
        found.append(
            f"{name}Residuals move together (design effect {fit.robustness.by_light:.3g} within "
            f"images, {fit.robustness.by_pixel:.3g} within pixels), so {fit.samples.dn.size} "
            f"samples say as much as {fit.samples.dn.size / fit.design_effect:.0f} independent "
            f"ones; the intervals allow for it, {np.sqrt(fit.design_effect):.1f} times wider on "
            "average over the parameters."
        )
    if _in_regions(fit):
        found.append(
            f"{name}Images of neighbouring lights miss the model alike, so that the intervals take "
            f"{_regions(fit)} regions of the {_lights(fit)} lights for independent, not the "
            "lights; parameters may differ under lights from elsewhere."
        )
    return found


def _lights(fit: ChannelFit) -> int:
    return len(np.unique(fit.selection.light))


def _regions(fit: ChannelFit) -> int:
    """Of lights that err alike; as many as lights where each errs on its own."""
    return len(np.unique(fit.regions[fit.selection.light]))


def _in_regions(fit: ChannelFit) -> bool:
    return _regions(fit) < _lights(fit)


def _judges(fit: ChannelFit) -> str:
    """What the errors of a fit are told by."""
    of_regions = f"{_regions(fit)} regions of the " if _in_regions(fit) else ""
    return f"{of_regions}{_lights(fit)} fitted lights"


def _unseen_winner(calibration: ReflectanceCalibration) -> list[str]:
    """That a model predicts best is no sign of a highlight where BIC sees none."""
    best = equally_good(calibration.scores)[0]
    if best == "lambert":
        return []
    pairs = zip(calibration.fits[best], calibration.fits["lambert"], strict=True)
    unseen = [fit.channel for fit, matt in pairs if open_parameters(fit, matt)]
    if not unseen:
        return []
    where = "" if len(calibration.observation.channels) == 1 else f" in {', '.join(unseen)}"
    return [
        f"{LABELS[best]} predicts best, but what it adds to Lambert's model is not determined"
        f"{where}: the lead may be chance."
    ]


def _better_model(calibration: ReflectanceCalibration) -> list[str]:
    """That the model reported in full is not the one that the comparison prefers."""
    found = surpassed_by(calibration.scores, calibration.model)
    if found is None:
        return []
    better, told = found
    return [
        f"{LABELS[calibration.model]}, which is reported here in full, is not the best: it {told} "
        f"{LABELS[better]}. --model {better} reports that one (model={better!r} in Python)."
    ]


def _not_compared(calibration: ReflectanceCalibration) -> list[str]:
    """Which models could do better, for all that the comparison says."""
    left_out = [LABELS[model] for model in MODELS if model not in calibration.fits]
    if not left_out:
        return []
    return [
        f"Not compared: {listed(left_out)}; --compare-all (compare_all=True in Python) fits these "
        "too."
    ]


def _sampling_findings(calibration: ReflectanceCalibration) -> list[str]:
    sampled = {n: p for n, p in calibration.posteriors.items() if p.sampled}
    if sampled:
        return [f"{name}: {convergence_in_words(p)}" for name, p in sampled.items()]
    return [convergence_in_words(p) for p in list(calibration.posteriors.values())[:1]]


def _colour_finding(calibration: ReflectanceCalibration) -> list[str]:
    """A clear surface reflects the light's own colour: unequal k_s under calibrated intensities is
    worth a word, if all lobes that predict equally well say it."""
    reported = _colour(calibration.reported)
    if reported is None or any(
        f.channel not in calibration.posteriors for f in calibration.reported
    ):
        return []
    logs, errors = reported
    low, high = int(np.argmin(logs)), int(np.argmax(logs))
    z = _contrast(logs, errors, low, high)
    if z < COLOURED:
        return []
    channels = [fit.channel for fit in calibration.reported]
    ratio = np.exp(logs - logs[1])
    for model in equally_good(calibration.scores):
        other = _colour(calibration.fits[model])
        if other is not None and _contrast(*other, low, high) < COLOURED:
            return [
                f"Whether the highlight is coloured depends on the lobe: k_s is larger in "
                f"{channels[high]} than in {channels[low]} by {z:.0f} standard errors with "
                f"{LABELS[calibration.model]}, not with {LABELS[model]}, which predicts unseen "
                "lights no worse; no conclusion is drawn."
            ]
    return [
        f"The highlight is coloured: k_s red : green : blue = {ratio[0]:.2f} : 1 : {ratio[2]:.2f}, "
        f"{z:.0f} standard errors from neutral; a clear coat reflects the light's own colour, so "
        "either the surface is metallic, the intensities are off, or the highlight's shape is not "
        "the model's."
    ]


def _colour(fits: Sequence[ChannelFit]) -> tuple[np.ndarray, np.ndarray] | None:
    """ln k_s of three channels and their standard errors; None where one has none."""
    known = [
        (fit.vector[1], np.sqrt(fit.robustness.covariance[1, 1]))
        for fit in fits
        if fit.robustness is not None
        and np.isfinite(fit.robustness.by_light)  # else their errors are not known
        and "specular" in [p.name for p in fit.space]
    ]
    if len(fits) != 3 or len(known) != 3:
        return None
    logs, errors = np.array(known).T
    return logs, errors


def _contrast(logs: np.ndarray, errors: np.ndarray, low: int, high: int) -> float:
    """By how many standard errors k_s of one channel lies above that of another."""
    return float((logs[high] - logs[low]) / np.hypot(errors[low], errors[high]))


def _part_findings(calibration: ReflectanceCalibration) -> list[str]:
    """The outline, and the side of the object that the model misses most, if worth a word."""
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
    assumed = _taken_for_granted(calibration)
    told = [part for part in ("outline", *worst) if abs(means.get(part, 0.0)) > NOTABLE_RESIDUAL]
    return [
        f"Averaged over all lights, the {part} of the object is "
        f"{format_percent(abs(means[part]), decimals=1)} "
        + (
            "brighter than predicted: light that the rig does not name (inter-reflection from a "
            "stand or table, stray light)"
            if means[part] > 0
            else "darker than predicted: shadow"
        )
        + f", a surface that is not the model's, or what the rig takes for granted: {assumed}."
        for part in told
    ]


def _texture_finding(calibration: ReflectanceCalibration) -> list[str]:
    """That the misfit is the pixels' own: a mean over lights lessens whatever else is missed."""
    misfits = [fit.spread.relative for fit in calibration.reported if fit.spread.relative]
    own = float(np.nanstd(mean_residual(calibration)))
    if len(misfits) < len(calibration.reported) or own < TEXTURED * np.mean(misfits):
        return []
    return [
        f"Most of what the model misses, {format_percent(own, decimals=1)} of the signal, is the "
        "same in a pixel under all lights: a surface of uneven albedo (texture, stains), or "
        "unequal pixels."
    ]


def _taken_for_granted(calibration: ReflectanceCalibration) -> str:
    """What a fit assumes of files, lights and camera, and what would change it."""
    observation = calibration.observation
    granted = []
    if observation.gamma is None and not calibration.reported[0].form.free_gamma:
        granted.append("linear files (give camera.gamma, or --fit-gamma, for sRGB pictures)")
    if (np.ptp(observation.falloff, axis=1) == 0).all():
        granted.append("lamps at infinity (give a near lamp's position in place of its direction)")
    granted.append("the object where geometry has it (the sphere's centre and radius, the normals)")
    granted.append("an orthographic camera, far from the object")
    return listed(granted)


def _shadow_finding(calibration: ReflectanceCalibration) -> list[str]:
    """Light in attached shadows, which no source of the rig reaches."""
    observation = calibration.observation
    if calibration.reported[0].form.ambient or observation.gamma is not None:
        return []
    light, pixel = np.nonzero(observation.cosine < SHADOWED)
    if len(light) < FEWEST_SHADOWED:
        return []
    glow = [
        np.mean(observation.dn[i, light, pixel] - observation.black)
        / np.mean(observation.intensity[i, light] * observation.falloff[light, pixel])
        / fit.natural[0]
        for i, fit in enumerate(calibration.reported)
    ]
    if max(glow) < GLOW:
        return []
    return [
        "Attached shadows are not black: on average they hold "
        f"{' / '.join(f'{100 * part:.2g}' for part in glow)} % of what the diffuse term gives in "
        "full light, which reaches them by another way (inter-reflection, stray light, a black "
        "level set too low); the fit leaves shadows out."
    ]
