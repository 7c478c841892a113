"""What a camera over its settings has to say, in sentences: what is not shared first."""

import numpy as np

from ...inference.diagnostics import identifiability
from ...inference.formatting import format_p, format_with_error
from ...inference.parameters import names
from ...inference.trust import convergence_in_words
from ..levels import Levels
from ..misfit import MISFIT
from .calibration import CameraCalibration
from .fit import Axis, Claim, OwnDeviation, Quantity
from .pooled import Pooled
from .proportional import proportional_gain
from .sensor import is_impossible

HALF_GAP, GAP = 0.56, 1.12  # eV, of silicon at room temperature
FAR = 3.0  # standard errors
NAMES: dict[Quantity, str] = {
    "system_gain": "the conversion gain",
    "quantum_efficiency": "the quantum efficiency",
    "read_noise": "read noise",
    "dark_current": "dark current",
}
CAUSES: dict[tuple[Quantity, Axis], str] = {
    ("system_gain", "temperature"): "The conversion gain changes with temperature ({own}), as "
    "amplifiers and references do; each setting has its own.",
    ("quantum_efficiency", "gain"): "The quantum efficiency is not the same at every gain ({own}). "
    "No amplifier changes how many electrons a photon frees, so photons are stated wrongly at some "
    "gain, or its images were smoothed or denoised, which lowers the variance and the gain read "
    "off it; each gain has its own.",
    ("quantum_efficiency", "temperature"): "The quantum efficiency is not the same at every "
    "temperature ({own}): the lamp drifted from its stated photons, or the band edge of the sensor "
    "moves at this wavelength; each temperature has its own.",
    ("read_noise", "gain"): "Read noise does not follow from noise before and behind one amplifier "
    "({own}), as where a camera switches its conversion gain between two ranges, or filters images "
    "of high gain; each gain has its own.",
    ("read_noise", "temperature"): "Read noise changes with temperature ({own}); each setting has "
    "its own, and the law over gain is not used.",
    ("dark_current", "gain"): "Dark current in electrons is not the same at every gain ({own}), as "
    "where the camera subtracts a part of it from its black level; each setting has its own.",
    ("dark_current", "temperature"): "Dark current does not follow Arrhenius' law ({own}): two "
    "mechanisms, glow or stray light, a black level that compensates, or temperatures that are not "
    "the sensor's; each temperature has its own.",
}


def findings(calibration: CameraCalibration) -> tuple[str, ...]:
    """Every finding, the most consequential first."""
    return (
        *calibration.left_out,
        *_impossible(calibration),
        *_claims(calibration),
        *_misfit(calibration),
        *_stated_gain(calibration),
        *_dark_current(calibration),
        *_pooled(calibration),
        *_single(calibration),
        *_solver(calibration),
    )


def _impossible(calibration: CameraCalibration) -> list[str]:
    if not is_impossible(calibration):
        return []
    return [
        "The quantum efficiency comes out above 100 %, which no sensor has: give photons per pixel "
        "and exposure, and images that were not smoothed. No sensor is written."
    ]


def _claims(calibration: CameraCalibration) -> list[str]:
    fit = calibration.fit
    failed = [claim for claim in fit.claims if not claim.holds]
    told = []
    for claim in failed:
        told.append(
            CAUSES[claim.quantity, claim.axis].format(own=_own(claim))
            + f" Chi-square {claim.chi_square:.4g} over {claim.degrees} "
            f"({format_p(claim.p_value)})."
        )
        rivals = [NAMES[name] for name, axis in claim.rivals if (name, axis) not in fit.freed]
        if rivals:
            told.append(
                f"Before that, {' and '.join(dict.fromkeys(rivals))} seemed not to be shared "
                "either; the frames then no longer say so, but hardly tell these apart."
            )
    return told


def _own(claim: Claim) -> str:
    """The deviations beyond chance, the largest first."""
    most = sorted(claim.own, key=lambda one: -abs(one.value) / one.error)[:3]
    if (claim.quantity, claim.axis) == ("dark_current", "temperature"):
        scale, unit = 1, "e⁻/s"
    else:
        scale, unit = 100, "%"
    return ", ".join(f"{one.label}: {_signed(one, scale)} {unit}" for one in most)


def _signed(one: OwnDeviation, scale: float = 100) -> str:
    return format_with_error(scale * one.value, scale * one.error, signed=True)


def _misfit(calibration: CameraCalibration) -> list[str]:
    fit = calibration.fit
    ratio = fit.chi_square / max(fit.degrees, 1)
    words = (
        f"chi-square per degree of freedom {ratio:.2f} over {fit.degrees} ({format_p(fit.p_value)})"
    )
    if fit.inflation > 1:
        return [
            f"What is left is beyond chance: {words}, so all errors are multiplied by "
            f"{np.sqrt(fit.inflation):.2f}."
        ]
    shared = "With that, the" if fit.freed else "All"
    return [f"{shared} settings agree with one camera: {words}."]


def _stated_gain(calibration: CameraCalibration) -> list[str]:
    found = proportional_gain(calibration)
    if found is None:
        return []
    scale, p_value, own = found
    unit = "unit of ISO speed" if calibration.settings[0].gain_unit == "ISO" else "factor of gain"
    if p_value >= MISFIT:
        return [
            f"The conversion gain is proportional to the stated one: {scale:.4g} DN/e⁻ a {unit} "
            f"({format_p(p_value)})."
        ]
    worst = max(own, key=lambda one: abs(one.value) / one.error)
    return [
        "The conversion gain is not proportional to the stated one: at "
        f"{worst.label} it is {_signed(worst)} % off the others "
        f"({format_p(p_value)}), so the stated gain is a label there; use the measured K."
    ]


def _dark_current(calibration: CameraCalibration) -> list[str]:
    fit = calibration.fit
    warmth = {setting.temperature for setting in fit.settings}
    if not fit.model.dark_current_law:
        if len(warmth) > 1 and not fit.model.sizes[3]:
            return [
                "No setting has darks of three different exposures, so nothing is known of dark "
                "current over temperature."
            ]
        law = {("dark_current", "gain"), ("dark_current", "temperature")} & fit.freed
        if len(warmth) > 1 and not law:
            return [
                "Dark current is within its error at the warmest temperature, so that its law is "
                "not determined; take darks of longer exposure."
            ]
        return []
    place = names(fit.space).index("activation_energy")
    energy = float(fit.solution.vector[place])
    error = float(np.sqrt(fit.covariance[place, place]))
    below, above = (HALF_GAP - energy) / error, (energy - GAP) / error
    if max(below, above) > FAR:
        return [
            f"The activation energy of {format_with_error(energy, error)} eV is outside of "
            f"{HALF_GAP} to {GAP} eV, between generation in silicon's depletion region and "
            "diffusion: the stated temperatures are not the sensor's, or stray light or glow adds "
            "to the dark current."
        ]
    return []


def _given(pooled: Pooled) -> str:
    """What becomes of a value on which the settings do not agree."""
    if not pooled.serves:
        return "no shared value is given"
    return "they differ by little, by which the error of the shared value is widened"


def _pooled(calibration: CameraCalibration) -> list[str]:
    told = []
    if calibration.prnu is not None and not calibration.prnu.holds:
        told.append(
            f"PRNU is not the same at every setting ({format_p(calibration.prnu.p_value)}): uneven "
            f"light that moved, or a non-linearity of the pixels; {_given(calibration.prnu)}."
        )
    if calibration.dsnu is not None and not calibration.dsnu.holds:
        told.append(
            "DSNU in electrons is not the same at every setting "
            f"({format_p(calibration.dsnu.p_value)}): a pattern behind the amplifier shrinks with "
            "gain, and dark current of unequal pixels grows with temperature; "
            f"{_given(calibration.dsnu)}."
        )
    if calibration.full_well is not None and not calibration.full_well.holds:
        told.append(
            "The settings whose wells fill do not agree on how many electrons they hold "
            f"({format_p(calibration.full_well.p_value)}); {_given(calibration.full_well)}."
        )
    if calibration.full_well is None:
        told.append(
            "At no setting does a well fill before the converter's range ends, so full well is not "
            "determined; add brighter flats at the lowest gain."
        )
    return told


def _single(calibration: CameraCalibration) -> list[str]:
    """What the settings say by themselves that a reader of the whole has to know."""
    told = []
    darks = [one.setting.label for one in calibration.frames if isinstance(one.frames, Levels)]
    if darks:
        told.append(f"Darks alone: {'; '.join(darks)}.")
    curved = [
        one.setting.label
        for one, own in zip(calibration.frames, calibration.calibrations, strict=True)
        if own is not None and "compression" in own.chosen.values
    ]
    if curved:
        told.append(
            f"The camera is not linear at {'; '.join(curved)}: gain and efficiency are those at "
            "zero signal."
        )
    return told


def _solver(calibration: CameraCalibration) -> list[str]:
    solution = calibration.fit.solution
    judged = identifiability(calibration.fit.space, np.asarray(solution.information))
    # Means know ratios of gains far better than variances know each gain: no confusion, by design.
    told = [] if judged.determined else list(judged.sentences)
    if not bool(solution.converged):
        told.insert(0, "The fit did not converge; its figures are not to be used.")
    return [*told, convergence_in_words(calibration.posterior)]
