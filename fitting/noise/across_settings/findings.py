"""The findings on a camera at several settings, each with the condition under which it is reported.
Findings on assumptions that failed, so that settings have separate values, come first."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from ...inference.formatting import format_p, format_with_error
from ...inference.trust import convergence_in_words
from ...report.sentences import Finding, Numbers, evaluate_findings, quoted
from ..levels import Levels
from ..regressions import MISFIT
from .calibration import CameraCalibration
from .statement import Axis, Law, OwnDeviation, Quantity, proportional_gain

HALF_GAP, GAP = 0.56, 1.12  # eV, of silicon at room temperature
DISAGREEMENT_SIGMAS = 3.0  # standard errors
NAMES: dict[Quantity, str] = {
    "system_gain": "the conversion gain",
    "quantum_efficiency": "the quantum efficiency",
    "read_noise": "read noise",
    "dark_current": "dark current",
}


def findings(calibration: CameraCalibration) -> tuple[str, ...]:
    """Return all findings, the most consequential first."""
    return evaluate_findings(FINDINGS, calibration)


def _claim(law: Law, calibration: CameraCalibration, *, rivals: bool = False) -> Numbers | None:
    """Return the largest deviations from an assumption that failed, and its test; else None."""
    claim = next((one for one in calibration.fit.claims if one.law == law), None)
    if claim is None or claim.holds:
        return None
    # with one degree of freedom all are equally significant, except for rounding
    most = sorted(claim.own, key=lambda one: -round(abs(one.value) / one.error, 3))[:3]
    shown = most if law[0] == "dark_current" else [_relative(one) for one in most]
    scale, unit = (1, "e⁻/s") if law == ("dark_current", "temperature") else (100, "%")
    # Assumptions that failed with this one, but passed after it was dropped.
    others = [NAMES[rival[0]] for rival in claim.rivals if rival not in calibration.fit.freed]
    if rivals and not others:
        return None
    return {
        "own": ", ".join(f"{one.label}: {_signed_text(one, scale)} {unit}" for one in shown),
        "chi_square": claim.chi_square,
        "degrees": claim.degrees,
        "p": format_p(claim.p_value),
        "rivals": " and ".join(dict.fromkeys(others)),
    }


def _dropped_law_findings(quantity: Quantity, axis: Axis, sentence: str) -> tuple[Finding, Finding]:
    law: Law = quantity, axis
    key = f"{quantity} over {axis}"
    return (
        Finding(
            key,
            partial(_claim, law),
            sentence + " Chi-square {chi_square:.4g} over {degrees} ({p}).",
        ),
        Finding(
            f"{key}: rivals",
            partial(_claim, law, rivals=True),
            "Before that, {rivals} seemed to differ between settings too. Now the frames no longer "
            "contradict a common law there, but they can hardly distinguish these cases.",
        ),
    )


def _relative(one: OwnDeviation) -> OwnDeviation:
    """Convert a deviation from a difference of logarithms to a relative difference."""
    return replace(one, value=np.expm1(one.value), error=np.exp(one.value) * one.error)


def _signed_text(one: OwnDeviation, scale: float = 100) -> str:
    return format_with_error(scale * one.value, scale * one.error, signed=True)


def _misfit(beyond: bool, calibration: CameraCalibration) -> Numbers | None:
    """Return the chi-square of the joint fit if its misfit is significant (`beyond`), or is not."""
    fit = calibration.fit
    if (fit.fit.noise > 1) != beyond:
        return None
    return {
        "who": "With that, the" if fit.freed else "All",
        "ratio": fit.fit.misfit.chi_square / max(fit.degrees, 1),
        "degrees": fit.degrees,
        "p": format_p(fit.p_value),
        "factor": fit.fit.noise,
    }


def _proportion(holds: bool, calibration: CameraCalibration) -> Numbers | None:
    """Return the test whether measured gains are proportional to stated ones, if it `holds`."""
    found = proportional_gain(calibration.fit)
    if found is None or (found[1] >= MISFIT) != holds:
        return None
    stated = "unit of ISO speed" if calibration.settings[0].gain_unit == "ISO" else "factor of gain"
    return {
        "scale": found[0],
        "unit": stated,
        "p": format_p(found[1]),
        "off": ", ".join(f"{one.label} by {_signed_text(one)} %" for one in found[2]),
    }


def _unknown_dark_law(determined: bool, calibration: CameraCalibration) -> bool:
    """Whether dark current has no law, although none was rejected, and is `determined` or not."""
    fit = calibration.fit
    free = {parameter.name for parameter in fit.fit.problem.free}
    several = len({setting.temperature for setting in fit.settings}) > 1
    given_up = any(quantity == "dark_current" for quantity, _ in fit.freed)
    lawless = several and "activation_energy" not in free and not given_up
    return lawless and ("dark_current" in free) == determined


def _energy(calibration: CameraCalibration) -> Numbers | None:
    """Return an activation energy that is implausible for silicon; else None."""
    labels = [parameter.name for parameter in calibration.fit.fit.problem.space]
    if "activation_energy" not in labels:
        return None
    place = labels.index("activation_energy")
    energy = float(calibration.fit.vector[place])
    error = float(np.sqrt(calibration.fit.covariance[place, place]))
    if max(HALF_GAP - energy, energy - GAP) <= DISAGREEMENT_SIGMAS * error:
        return None
    return {"energy": format_with_error(energy, error), "low": HALF_GAP, "high": GAP}


def _differs(name: str, calibration: CameraCalibration) -> Numbers | None:
    """Return the test of an average over settings that disagree; None if they agree."""
    pooled = getattr(calibration, name)
    if pooled is None or pooled.holds:
        return None
    given = "they differ by little, and the error of the shared value includes this difference"
    return {
        "p": format_p(pooled.p_value),
        "given": given if pooled.serves else "no shared value is given",
    }


def _labels(chosen: Iterable[bool], calibration: CameraCalibration) -> Numbers | None:
    several = zip(calibration.settings, chosen, strict=True)
    labels = "; ".join(setting.label for setting, is_so in several if is_so)
    return {"labels": labels} if labels else None


_LEFT = "chi-square per degree of freedom {ratio:.2f} over {degrees} ({p})"

FINDINGS = (
    quoted("left out", lambda c: c.left_out),
    Finding(
        "impossible",
        lambda c: c.is_impossible,
        "The quantum efficiency is above 100 %, which is impossible: state photons per pixel "
        "and exposure, and use images that were not smoothed. No sensor file is written.",
    ),
    Finding(
        "processed",
        lambda c: {"labels": "; ".join(c.processed)} if c.processed else None,
        "Frames of {labels} are not raw (compressed or denoised), as the findings of each say. No "
        "sensor file is written, because it would describe this processing instead of the camera.",
    ),
    *_dropped_law_findings(
        *("system_gain", "temperature"),
        "The conversion gain changes with temperature ({own}), as amplifiers and voltage "
        "references do; each setting has its own gain.",
    ),
    *_dropped_law_findings(
        *("quantum_efficiency", "gain"),
        "The quantum efficiency is not the same at every gain ({own}). An amplifier cannot change "
        "it, so either photons are stated wrongly at some gain, or images there were smoothed or "
        "denoised, which lowers the variance and with it the estimated conversion gain. Each gain "
        "has its own quantum efficiency.",
    ),
    *_dropped_law_findings(
        *("quantum_efficiency", "temperature"),
        "The quantum efficiency is not the same at every temperature ({own}): the lamp drifted "
        "from its stated photons, or the band edge of the sensor shifts at this wavelength. Each "
        "temperature has its own quantum efficiency.",
    ),
    *_dropped_law_findings(
        *("read_noise", "gain"),
        "Read noise over gain is not the sum of a part before and a part after one amplifier "
        "({own}). This happens if a camera switches its conversion gain between two ranges, or "
        "filters images of high gain. Each gain has its own read noise.",
    ),
    *_dropped_law_findings(
        *("read_noise", "temperature"),
        "Read noise changes with temperature ({own}); each setting has its own read noise, and the "
        "law over gain is not used.",
    ),
    *_dropped_law_findings(
        *("dark_current", "gain"),
        "Dark current in electrons is not the same at every gain ({own}), as if the camera "
        "subtracts a part of it from its black level; each setting has its own dark current.",
    ),
    *_dropped_law_findings(
        *("dark_current", "temperature"),
        "Dark current does not follow Arrhenius' law ({own}). Causes are two mechanisms, glow or "
        "stray light, a black level that compensates dark current, or stated temperatures that "
        "are not the sensor's. Each temperature has its own dark current.",
    ),
    Finding(
        "misfit",
        partial(_misfit, True),
        f"The remaining misfit is significant: {_LEFT}. All errors are multiplied by "
        "{factor:.2f}.",
    ),
    Finding(
        "agreement", partial(_misfit, False), f"{{who}} settings agree with one camera: {_LEFT}."
    ),
    Finding(
        "proportional",
        partial(_proportion, True),
        "The conversion gain is proportional to the stated gain: {scale:.4g} DN/e⁻ per {unit} "
        "({p}).",
    ),
    Finding(
        "not proportional",
        partial(_proportion, False),
        "The conversion gain is not proportional to the stated gain ({p}); it differs from the "
        "other settings at {off}. There the stated gain is nominal, or belongs to other frames; "
        "use the measured K.",
    ),
    Finding(
        "dark current unknown",
        partial(_unknown_dark_law, False),
        "No setting has darks of three different exposures, so dark current over temperature is "
        "unknown.",
    ),
    Finding(
        "dark current unseen",
        partial(_unknown_dark_law, True),
        "Dark current at the warmest temperature is not significant, so its temperature law is "
        "not determined; take darks of longer exposure.",
    ),
    Finding(
        "activation energy",
        _energy,
        "The activation energy of {energy} eV is outside {low} to {high} eV, the range of silicon "
        "from generation in the depletion region to diffusion. The stated temperatures are not "
        "the sensor's, or stray light or glow adds to the dark current.",
    ),
    Finding(
        "PRNU",
        partial(_differs, "prnu"),
        "PRNU is not the same at every setting ({p}), because uneven light moved or the pixels are "
        "non-linear; {given}.",
    ),
    Finding(
        "DSNU",
        partial(_differs, "dsnu"),
        "DSNU in electrons is not the same at every setting ({p}): a pattern from after the "
        "amplifier decreases with gain, and that of dark current increases with temperature; "
        "{given}.",
    ),
    Finding(
        "full well",
        partial(_differs, "full_well"),
        "The settings at which pixels fill disagree on the full well ({p}); {given}.",
    ),
    Finding(
        "no full well",
        lambda c: c.full_well is None,
        "At no setting do pixels fill before the ADC's range ends, so the full well is not "
        "determined; add brighter flats at the lowest gain.",
    ),
    Finding(
        "darks alone",
        lambda c: _labels((isinstance(one.frames, Levels) for one in c.frames), c),
        "These settings have darks but no flats: {labels}.",
    ),
    Finding(
        "not linear",
        lambda c: _labels(
            (one is not None and "compression" in one.chosen.values for one in c.calibrations), c
        ),
        "The camera is not linear at {labels}: gain and quantum efficiency are those at zero "
        "signal.",
    ),
    Finding(
        "not converged",
        lambda c: not c.fit.fit.optimum.stationary,
        "The fit did not converge. Do not use its figures.",
    ),
    quoted("posterior", lambda c: [convergence_in_words(c.posterior)]),
)
