"""Prediction of held-out light levels by the joint fit to all settings of a camera.

Each setting is fitted again with every second level left out, and the joint fit is repeated with
these estimates. For each setting, the sensor of this joint fit is written to a file, read back, and
used to predict the levels left out.
"""

from dataclasses import replace

from ...inference.diagnostics import listed
from ...inference.formatting import format_p
from ...inference.precision import double_precision
from ...report.section import Table
from ..prediction.comparison import Agreement
from ..prediction.missing import missing_effects
from ..prediction.predict import Prediction, compared, levels_kept_out, reread, scatters
from ..prediction.section import explanations
from .calibration import CameraCalibration
from .sensor import sensor_without
from .setting import estimates_from_calibration
from .statement import fit_settings

SHOWN = 3  # most settings whose missing effects are named


@double_precision
def predict_settings(calibration: CameraCalibration) -> tuple[Prediction, ...]:
    """Predict the held-out levels of each setting by a joint fit to the other levels."""
    lit = {
        setting: own
        for setting, own in zip(calibration.settings, calibration.calibrations, strict=True)
        if own is not None
    }
    if not lit:
        return ()
    left_out = {setting: levels_kept_out(own) for setting, own in lit.items()}
    every = zip(calibration.settings, calibration.fit.by_setting, strict=True)
    estimates = [
        estimates_from_calibration(lit[setting], left_out=left_out[setting])
        if setting in lit
        else own
        for setting, own in every
    ]
    shared = fit_settings(calibration.settings, estimates, seed=calibration.posterior.seed)
    camera, found = replace(calibration, fit=shared), []
    for setting, own in lit.items():
        at = {"gain": setting.gain, "temperature": setting.temperature}
        sensor = reread(*sensor_without(camera, left_out, **at))
        kept_out = left_out[setting]
        label = "levels of its fit" if kept_out is None else "levels kept out of its fit"
        comparison = compared(own, sensor, kept_out)
        missing = missing_effects(comparison)
        errors = scatters(own)
        one = Prediction(setting.label, (comparison,), (label,), missing=missing, **errors)
        found.append(one)
    return tuple(found)


def findings(predictions: tuple[Prediction, ...]) -> tuple[str, ...]:
    """Return findings on predictions of held-out levels, with the missing effects if they fail."""
    if not predictions:
        return ()
    sums: dict[str, Agreement] = {}
    for one in predictions:
        for name, own in one.main_comparison.agreement.items():
            before = sums.get(name, Agreement(0.0, 0.0))
            sums[name] = Agreement(before.chi_square + own.chi_square, before.degrees + own.degrees)
    ratios = listed(
        [f"{one.ratio:.3g} ({format_p(one.p_value)}) for {name}" for name, one in sums.items()]
    )
    levels = sum(one.main_comparison.lit.lit.size for one in predictions)
    kept = all(one.labels == ("levels kept out of its fit",) for one in predictions)
    which = "which were held out in a second fit,"
    if not kept:
        which = "some of which were fitted, because there are too few to hold some out,"
    words = [
        f"The camera over all settings alone predicts {levels} levels of {len(predictions)} "
        f"settings, {which} with chi-squares per degree of freedom of {ratios}."
    ]
    missed = [one for one in predictions if one.main_comparison.missed]
    missed.sort(key=lambda one: -max(part.ratio for part in one.main_comparison.agreement.values()))
    words += [f"At {one.camera}: {' '.join(explanations(one))}" for one in missed[:SHOWN]]
    if len(missed) > SHOWN:
        others = ", ".join(one.camera for one in missed[SHOWN:])
        words.append(f"The levels of {others} differ significantly, too.")
    return tuple(words)


def table(predictions: tuple[Prediction, ...]) -> Table:
    """Return the table of prediction tests, with a row for each setting and predicted quantity."""
    rows = tuple(
        (one.camera, one.labels[0], name, own.degrees, own.ratio, own.p_value)
        for one in predictions
        for name, own in one.main_comparison.agreement.items()
    )
    return Table(
        "What the camera over its settings predicts",
        ("setting", "levels", "quantity", "degrees of freedom", "χ² per degree", "p-value"),
        rows,
        "By the sensor of all settings alone; errors are those of the frames and of the camera's "
        "draws. χ² per degree is near 1 if the prediction is right.",
    )
