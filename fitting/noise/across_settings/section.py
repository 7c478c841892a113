"""The report on a camera at several settings: estimates, findings, tables and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from jaxvision.errors import InputError

from ...inference.estimates import (
    QUANTILES,
    Estimate,
    quantile_estimate,
    sampled_estimate,
)
from ...inference.parameters import Parameter, names
from ...inference.precision import double_precision
from ...report.section import Section, Table, failed_section, section_of_part, word_for_file
from ...rig import Camera
from ..calibration import NoiseCalibration
from ..pattern import Spread
from ..section import TITLE as TITLE_OF_ONE
from ..section import deviation_estimate
from ..section import section as section_of_one
from ..settings import Setting
from . import prediction
from .calibration import CameraCalibration, ends_at_full_scale
from .figures import camera_pictures
from .findings import NAMES, findings
from .sensor import write_sensor_at, write_sensor_of_sites_at
from .setting import FramesOfSetting
from .statement import BOLTZMANN_EV

KIND, TITLE = "noise", "Camera noise over gain and temperature"
EFFICIENCY = Parameter("quantum_efficiency", symbol="η", unit="%")
ROOTS = {
    "variance_before_gain": Parameter("noise_before_gain", symbol="σ₀", unit="e⁻"),
    "variance_behind_gain": Parameter("noise_behind_gain", symbol="σ₁", unit="DN"),
}
READ_NOISE = Parameter("read_noise", symbol="σ_d", unit="e⁻")
DOUBLING = Parameter("doubling_temperature", symbol="ΔT_2", unit="K")
FULL_WELL = Parameter("full_well", symbol="μ_e.sat", unit="e⁻")
DSNU = Parameter("dsnu", symbol="DSNU", unit="e⁻")
PRNU = Parameter("prnu", symbol="PRNU", unit="%")
OWN_HEADINGS = {
    "Quantum efficiency": ("quantum_efficiency",),
    "Overall system gain": ("system_gain",),
    "Read noise": ("read_noise", "noise_before_gain", "noise_behind_gain"),
    "Dark current": ("dark_current", "activation_energy", "doubling_temperature"),
    "Of the die": ("full_well", "dsnu", "prnu"),
}


@double_precision
def section(calibration: CameraCalibration) -> Section:
    """Return the report section of the joint fit, with common quantities and those of each gain."""
    gains = dict.fromkeys((s.gain, s.gain_label) for s in calibration.settings)
    writers = {
        f"sensor_{word_for_file(t)}".rstrip("_"): partial(write_sensor_at, calibration, g)
        for g, t in gains
    }
    no_sensor = calibration.is_impossible or calibration.processed
    predicted = () if no_sensor else prediction.predict_settings(calibration)
    return Section(
        kind=KIND,
        title=TITLE,
        estimates=_estimates(calibration),
        findings=(*findings(calibration), *prediction.findings(predicted)),
        pictures=camera_pictures(calibration),
        tables=(
            *(_settings_table(calibration), _claims_table(calibration)),
            *(prediction.table(predicted),) * bool(predicted),
        ),
        posteriors={"": calibration.posterior},
        records={} if no_sensor else writers,
        about=_about(calibration),
        headings=OWN_HEADINGS,
        settings={
            "settings": "; ".join(setting.label for setting in calibration.settings),
            "parameters": ", ".join(names(calibration.posterior.space)),
            "covariance inflated by": calibration.fit.fit.noise**2,
        },
    )


def sections(calibration: CameraCalibration) -> list[Section]:
    """Return the report section of the joint fit, then a section for each setting."""
    return [section(calibration), *_setting_sections(calibration.frames, calibration.calibrations)]


def records_of_sites(
    calibrations: Mapping[str, CameraCalibration], camera: Camera
) -> dict[str, Callable[[Path], None]]:
    """Return a writer of the sensor of all sites for each gain; {} if a site has no sensor."""
    each = calibrations.values()
    if len(calibrations) < len(camera.sites) or any(c.is_impossible or c.processed for c in each):
        return {}
    gains = dict.fromkeys((s.gain, s.gain_label) for one in each for s in one.settings)
    return {
        f"sensor_{word_for_file(label)}".rstrip("_"): partial(
            write_sensor_of_sites_at, calibrations, camera, gain
        )
        for gain, label in gains
    }


def sections_without_joint_fit(
    frames: Sequence[FramesOfSetting],
    calibrations: Sequence[NoiseCalibration | InputError | None],
    why: str,
) -> list[Section]:
    """Return a section that states why the joint fit failed, then a section for each setting."""
    return [failed_section(KIND, TITLE, why), *_setting_sections(frames, calibrations)]


def unread(failed: Mapping[Setting, InputError]) -> list[Section]:
    """Return a section for each setting whose frames cannot be used, with the reason."""
    return [
        section_of_part(failed_section(KIND, TITLE_OF_ONE, str(why)), setting.label)
        for setting, why in failed.items()
    ]


def _setting_sections(
    frames: Sequence[FramesOfSetting],
    calibrations: Sequence[NoiseCalibration | InputError | None],
) -> list[Section]:
    found = []
    for one, own in zip(frames, calibrations, strict=True):
        if isinstance(own, NoiseCalibration):
            alone = section_of_part(section_of_one(own), one.setting.label)
            found.append(replace(alone, pictures=alone.pictures[:1]))
    return found


def _about(calibration: CameraCalibration) -> str:
    gains = list(dict.fromkeys(s.gain_label for s in calibration.settings if s.gain_label))
    warmth = list(dict.fromkeys(s.temperature_label for s in calibration.settings))
    parts = [
        f"{len(calibration.settings)} settings",
        f"{len(gains)} gains ({', '.join(gains)})" if len(gains) > 1 else "".join(gains),
        f"{len(warmth)} temperatures ({', '.join(warmth)})" if len(warmth) > 1 else warmth[0],
    ]
    about = ", ".join(part for part in parts if part) + "."
    if "activation_energy" not in names(calibration.posterior.space):
        return about
    return (
        f"{about} Dark current is that at {calibration.fit.reference:g} K; it doubles within ΔT_2 "
        f"around {_middle(calibration):.4g} K."
    )


def _middle(calibration: CameraCalibration) -> float:
    """Return the middle of the range of temperatures, K."""
    warmth = [s.temperature for s in calibration.settings if s.temperature is not None]
    return (min(warmth) + max(warmth)) / 2


def _estimates(calibration: CameraCalibration) -> tuple[Estimate, ...]:
    space = calibration.posterior.space
    best = dict(zip(names(space), calibration.posterior.mode, strict=True))
    draws = dict(zip(names(space), calibration.posterior.samples.T, strict=True))
    errors = np.sqrt(np.diagonal(calibration.fit.covariance))
    found, read_noises = [], []
    for i, parameter in enumerate(space):
        full, (name, _, rest) = parameter.name, parameter.name.partition("[")
        group = rest.removesuffix("]")
        if name in ROOTS:
            why = "{}, hidden under the other noise; use more gains"
            spread = Spread(float(best[full]), float(errors[i]), ())
            found.append(deviation_estimate(ROOTS[name], spread, why))
            continue
        what, scale = replace(parameter, name=name, transform="identity"), 1.0
        if name == "quantum_efficiency":
            what, scale = EFFICIENCY, 100.0
        value = scale * float(best[full])
        found.append(sampled_estimate(what, scale * draws[full], value=value, group=group))
        if name == "system_gain" and "variance_before_gain" in best:
            ours, theirs = (
                x["variance_before_gain"] + x["variance_behind_gain"] / x[full] ** 2
                for x in (best, draws)
            )
            read_noise = np.sqrt(np.maximum(theirs, 0))
            value = float(np.sqrt(ours))
            read_noises.append(sampled_estimate(READ_NOISE, read_noise, value=value, group=group))
    if "activation_energy" in best:
        scale = np.log(2) * BOLTZMANN_EV * _middle(calibration) ** 2
        ours, theirs = (scale / x["activation_energy"] for x in (best, draws))
        read_noises.append(sampled_estimate(DOUBLING, theirs, value=float(ours)))
    return (*found, *read_noises, *_die_estimates(calibration))


def _die_estimates(calibration: CameraCalibration) -> list[Estimate]:
    found, well = [], calibration.full_well
    if well is not None and well.serves:
        ends = well.value * np.exp(ndtri(QUANTILES) * well.known_to / well.value)
        found.append(quantile_estimate(FULL_WELL, well.value, well.known_to, ends))
    for what, pooled, scale in ((DSNU, calibration.dsnu, 1.0), (PRNU, calibration.prnu, 100.0)):
        if pooled is not None and pooled.serves:
            why = "{}, hidden under temporal noise; take more frames"
            spread = Spread(pooled.value, pooled.known_to, pooled.parts)
            found.append(deviation_estimate(what, spread, why, scale=scale))
    return found


def _settings_table(calibration: CameraCalibration) -> Table:
    rows = []
    gains = np.exp(np.asarray(calibration.figures.log_gain))
    of_settings = zip(calibration.fit.by_setting, gains, calibration.calibrations, strict=True)
    for setting, (estimates, gain, own) in zip(calibration.settings, of_settings, strict=True):
        log_gain, responsivity, log_noise = (
            estimates.estimate(name)[0] for name in ("system_gain", "responsivity", "read_noise")
        )
        numbers = (
            np.exp(log_gain),
            100 * np.exp(responsivity - log_gain),
            np.exp(log_noise),
            estimates.dark_current(gain)[0],
        )
        saturation, ends_at = None, None
        if own is not None and own.within.saturation is not None:
            sheet = {one.name: one.value for one in own.sheet}
            saturation = sheet.get("saturation_electrons")
            ends_at = "full scale" if ends_at_full_scale(own) else "full well"
        shown = (None if np.isnan(number) else float(number) for number in numbers)
        rows.append((setting.label, *shown, saturation, ends_at))
    return Table(
        "Each setting separately",
        (
            *("setting", "K [DN/e⁻]", "η [%]", "σ_d [e⁻]", "μ_I [e⁻/s]"),
            *("saturation [e⁻]", "range ends at"),
        ),
        tuple(rows),
        "The input of the fit of all settings. Settings with darks alone give the dark current "
        "in DN, divided here by the K of their gain.",
    )


def _claims_table(calibration: CameraCalibration) -> Table:
    judged = [
        (f"{NAMES[one.quantity].removeprefix('the ')} over {one.axis}", one, one.degrees)
        for one in calibration.fit.claims
    ]
    judged += [
        (f"{name} over settings", one, len(one.settings) - 1)
        for name, one in (
            *(("full well", calibration.full_well), ("DSNU", calibration.dsnu)),
            ("PRNU", calibration.prnu),
        )
        if one is not None and len(one.settings) > 1
    ]
    return Table(
        "What the settings share",
        ("claim", "χ²", "degrees", "p-value", "verdict"),
        tuple(
            (name, one.chi_square, degrees, one.p_value, "holds" if one.holds else "given up")
            for name, one, degrees in judged
        ),
        "Score tests: the decrease of chi-square if each gain, or each temperature, had its own "
        "value. An assumption is dropped if p is below 0.1 %, the most significant first.",
    )
