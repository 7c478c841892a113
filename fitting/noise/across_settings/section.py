"""A camera over its settings as its reader sees it: estimates, findings, tables and pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from jaxvision.errors import InputError

from ...inference.estimates import QUANTILES, Estimate, not_determined, quantile_estimate
from ...inference.parameters import Parameter, names
from ...report.section import Section, Table
from ..calibration import NoiseCalibration
from ..parts import Part, deviation_quantiles, sampling_variance
from ..pattern import SEEN
from ..section import TITLE as TITLE_OF_ONE
from ..section import section as section_of_one
from ..settings import Setting
from .calibration import CameraCalibration
from .figures import camera_pictures
from .findings import NAMES, findings
from .model import BOLTZMANN_EV
from .pooled import Pooled, ends_at_full_scale
from .sensor import is_impossible, write_sensor_at
from .setting import FramesOfSetting

KIND, TITLE = "noise", "Camera noise over gain and temperature"
EFFICIENCY = Parameter("quantum_efficiency", symbol="η", unit="%")
BEFORE = Parameter("noise_before_gain", symbol="σ₀", unit="e⁻")
BEHIND = Parameter("noise_behind_gain", symbol="σ₁", unit="DN")
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


def section(calibration: CameraCalibration) -> Section:
    """A camera over its settings.

    Args:
        calibration: of the camera.

    Returns:
        Estimates of what the settings share and of each gain, findings, tables and pictures.
    """
    fit = calibration.fit
    gains = dict.fromkeys((s.gain, s.gain_label) for s in calibration.settings)
    writers = {
        "_".join(["sensor", *label.lower().replace("-", "minus_").split()]): partial(
            write_sensor_at, calibration, gain
        )
        for gain, label in gains
    }
    return Section(
        kind=KIND,
        title=TITLE,
        estimates=_estimates(calibration),
        findings=findings(calibration),
        pictures=camera_pictures(calibration),
        tables=(_settings_table(calibration), _claims_table(calibration)),
        posteriors={"": calibration.posterior},
        records={} if is_impossible(calibration) else writers,
        about=_about(calibration),
        headings=OWN_HEADINGS,
        settings={
            "settings": "; ".join(setting.label for setting in calibration.settings),
            "parameters": ", ".join(names(fit.space)),
            "covariance inflated by": fit.inflation,
        },
    )


def sections(calibration: CameraCalibration) -> list[Section]:
    """The camera, and after it each of its settings by itself.

    Args:
        calibration: of the camera.

    Returns:
        The sections of a report.
    """
    return [section(calibration), *_of_settings(calibration.frames, calibration.calibrations)]


def without_whole(
    frames: Sequence[FramesOfSetting],
    calibrations: Sequence[NoiseCalibration | InputError | None],
    why: str,
) -> list[Section]:
    """The settings by themselves, where the camera over them could not be fitted.

    Args:
        frames: of each setting.
        calibrations: of each by itself; None of darks alone, and the error where it failed.
        why: the camera has no results, as a sentence.

    Returns:
        The sections of a report.
    """
    whole = Section(kind=KIND, title=TITLE, estimates=(), findings=(why,), failure=why)
    return [whole, *_of_settings(frames, calibrations)]


def unread(failed: Mapping[Setting, InputError]) -> list[Section]:
    """Settings whose frames cannot be used.

    Args:
        failed: why, of each.

    Returns:
        A section each, that says so.
    """
    return [
        Section(_kind(s.label), f"{TITLE_OF_ONE}: {s.label}", (), (str(why),), failure=str(why))
        for s, why in failed.items()
    ]


def _kind(label: str) -> str:
    return "_".join([KIND, *label.lower().replace(",", "").replace("-", "minus_").split()])


def _of_settings(
    frames: Sequence[FramesOfSetting],
    calibrations: Sequence[NoiseCalibration | InputError | None],
) -> list[Section]:
    return [
        _of_setting(own, one.setting.label)
        for one, own in zip(frames, calibrations, strict=True)
        if isinstance(own, NoiseCalibration)
    ]


def _of_setting(calibration: NoiseCalibration, label: str) -> Section:
    alone = section_of_one(calibration)
    return replace(
        alone,
        kind=_kind(label),
        title=f"{alone.title}: {label}",
        pictures=alone.pictures[:1],
        estimates=tuple(replace(one, group=label) for one in alone.estimates),
        records={},
    )


def _about(calibration: CameraCalibration) -> str:
    gains = list(dict.fromkeys(s.gain_label for s in calibration.settings if s.gain_label))
    warmth = list(dict.fromkeys(s.temperature_label for s in calibration.settings))
    parts = [
        f"{len(calibration.settings)} settings",
        f"{len(gains)} gains ({', '.join(gains)})" if len(gains) > 1 else "".join(gains),
        f"{len(warmth)} temperatures ({', '.join(warmth)})" if len(warmth) > 1 else warmth[0],
    ]
    told = ", ".join(part for part in parts if part) + "."
    if not calibration.fit.model.dark_current_law:
        return told
    return (
        f"{told} Dark current is that at {calibration.fit.reference:g} K; it doubles within ΔT_2 "
        f"around {_middle(calibration):.4g} K."
    )


def _middle(calibration: CameraCalibration) -> float:
    """Of the range of temperatures, K."""
    warmth = [s.temperature for s in calibration.settings if s.temperature is not None]
    return (min(warmth) + max(warmth)) / 2


def _estimates(calibration: CameraCalibration) -> tuple[Estimate, ...]:
    fit, draws = calibration.fit, calibration.posterior.samples
    labels, best = names(fit.space), calibration.posterior.mode
    found: list[Estimate] = []
    for i, label in enumerate(labels):
        name, _, rest = label.partition("[")
        group = rest.removesuffix("]")
        if name == "quantum_efficiency":
            found.append(_drawn(EFFICIENCY, 100 * best[i], 100 * draws[:, i], group))
        elif name in ("variance_before_gain", "variance_behind_gain"):
            what = BEFORE if name.startswith("variance_before") else BEHIND
            error = float(np.sqrt(fit.covariance[i, i]))
            found.append(_root(what, float(best[i]), error, "the other noise; use more gains"))
        else:
            what = _plain(fit.space[i], name)
            found.append(_drawn(what, best[i], draws[:, i], group))
    if fit.model.read_noise_law:
        found += _read_noises(calibration, best, draws)
    if fit.model.dark_current_law:
        i = labels.index("activation_energy")
        scale = np.log(2) * BOLTZMANN_EV * _middle(calibration) ** 2
        found.append(_drawn(DOUBLING, scale / best[i], scale / draws[:, i], ""))
    return (*found, *_of_die(calibration))


def _plain(parameter: Parameter, name: str) -> Parameter:
    """A parameter without what tells it from others of its kind."""
    return Parameter(name, symbol=parameter.symbol, unit=parameter.unit)


def _drawn(
    what: Parameter, value: float, draws: Float[np.ndarray, " draws"], group: str
) -> Estimate:
    return quantile_estimate(what, value, np.std(draws), np.quantile(draws, QUANTILES), group=group)


def _root(
    what: Parameter,
    square: float,
    error: float,
    under: str,
    scale: float = 1.0,
    parts: tuple[Part, ...] = (),
) -> Estimate:
    """The root of a variance that may come out negative, beside parts known from samples."""
    if square < SEEN * error:
        bound = scale * np.sqrt(max(square, 0) + SEEN * error)
        return not_determined(what, f"below {bound:.3g} {what.unit}, hidden under {under}")
    value = np.sqrt(square)
    total = np.sqrt(error**2 + sampling_variance(parts))
    ends = scale * deviation_quantiles(square, error, parts)
    return quantile_estimate(what, scale * value, scale * total / (2 * value), ends)


def _read_noises(
    calibration: CameraCalibration, best: np.ndarray, draws: np.ndarray
) -> list[Estimate]:
    """By the law, at each gain."""
    labels = names(calibration.fit.space)
    place = labels.index("variance_before_gain")
    found = []
    for i, label in enumerate(labels):
        if label.startswith("system_gain"):
            group = label.partition("[")[2].removesuffix("]")
            drawn = np.sqrt(np.maximum(draws[:, place] + draws[:, place + 1] / draws[:, i] ** 2, 0))
            value = float(np.sqrt(best[place] + best[place + 1] / best[i] ** 2))
            found.append(_drawn(READ_NOISE, value, drawn, group))
    return found


def _of_die(calibration: CameraCalibration) -> list[Estimate]:
    found = []
    well = calibration.full_well
    if well is not None and well.serves:
        steps = ndtri(QUANTILES)
        ends = well.value * np.exp(steps * well.known_to / well.value)
        found.append(quantile_estimate(FULL_WELL, well.value, well.known_to, ends))
    for what, pooled, scale in (
        (DSNU, calibration.dsnu, 1.0),
        (PRNU, calibration.prnu, 100.0),
    ):
        if pooled is not None and pooled.serves:
            under = "temporal noise; take more frames"
            found.append(_root(what, pooled.value, pooled.known_to, under, scale, pooled.parts))
    return found


def _settings_table(calibration: CameraCalibration) -> Table:
    fit = calibration.fit
    rows = []
    for i, (one, own) in enumerate(zip(calibration.frames, calibration.calibrations, strict=True)):
        told = dict(zip(fit.told[i].names, fit.told[i].values, strict=True))
        log_gain = told.get("system_gain")
        responsivity = told.get("responsivity")
        efficiency = None
        if log_gain is not None and responsivity is not None:
            efficiency = 100 * float(np.exp(responsivity - log_gain))
        read = told.get("read_noise")
        dark = told.get("dark_current")
        if "dark_signal_rate" in told:
            dark = told["dark_signal_rate"] / np.exp(float(calibration.figures.log_gain[i]))
        rows.append(
            (
                one.setting.label,
                None if log_gain is None else float(np.exp(log_gain)),
                efficiency,
                None if read is None else float(np.exp(read)),
                None if dark is None else float(dark),
                *_saturation(own),
            )
        )
    return Table(
        "Each setting by itself",
        (
            *("setting", "K [DN/e⁻]", "η [%]", "σ_d [e⁻]", "μ_I [e⁻/s]"),
            *("saturation [e⁻]", "range ends at"),
        ),
        tuple(rows),
        "What the fit of all settings was made from; settings of darks alone tell the dark current "
        "in DN, here over the K of their gain.",
    )


def _saturation(own: NoiseCalibration | None) -> tuple[float | None, str | None]:
    if own is None or own.within.saturation is None:
        return None, None
    found = [one.value for one in own.sheet if one.name == "saturation_electrons"]
    return (found or [None])[0], "full scale" if ends_at_full_scale(own) else "full well"


def _claims_table(calibration: CameraCalibration) -> Table:
    rows = [
        (
            f"{NAMES[claim.quantity].removeprefix('the ')} over {claim.axis}",
            claim.chi_square,
            claim.degrees,
            claim.p_value,
            "holds" if claim.holds else "given up",
        )
        for claim in calibration.fit.claims
    ]
    pooled: dict[str, Pooled | None] = {
        "full well": calibration.full_well,
        "DSNU": calibration.dsnu,
        "PRNU": calibration.prnu,
    }
    rows += [
        (
            f"{name} over settings",
            one.chi_square,
            len(one.settings) - 1,
            one.p_value,
            "holds" if one.holds else "given up",
        )
        for name, one in pooled.items()
        if one is not None and len(one.settings) > 1
    ]
    return Table(
        "What the settings share",
        ("claim", "χ²", "degrees", "p-value", "verdict"),
        tuple(rows),
        "Score tests: what chi-square would fall by if each gain, or each temperature, had a value "
        "of its own. A claim is given up below p = 0.1 %, the worst first.",
    )
