"""Choose the setting of an approximation: the cheapest within a tolerance, or the most accurate
within a time. The choice compares upper bounds on the error of a run with another seed, because the
measured seeds may be lucky."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError
from .fitted import order_holds
from .records import Curve, Trial

REACH = 2**14  # factor on the finest setting, up to which the declared order is extrapolated
STEP = 2**0.5  # ratio of successive inferred settings


def candidates(curve: Curve) -> tuple[Trial, ...]:
    """List the measured settings of a curve, cheapest first, with times in s. If the errors
    decrease at least as fast as the order declared in the knob, the list also has settings that
    were not measured. The errors of these settings are inferred from the order."""
    run = tuple(t for t in curve.trials if np.isfinite(t.error))
    if (
        not curve.knob.whole
        or curve.knob.law != "power"
        or not order_holds(curve.knob, curve.order)
    ):
        return run
    solid = [trial for trial in run if not trial.hollow]
    known, found = {trial.setting for trial in run}, list(run)
    setting, most = float(solid[0].setting), REACH * solid[-1].setting
    if not curve.knob.random:  # a bias may not follow the law beyond the measured settings
        most = max(curve.knob.settings + curve.knob.reference)
    while (setting := setting * STEP) <= most:
        if (whole := round(setting)) not in known:
            known.add(whole)
            found.append(_infer_trial(curve, solid, whole))
    return tuple(sorted(found, key=lambda trial: trial.setting))


def _infer_trial(curve: Curve, solid: Sequence[Trial], setting: int) -> Trial:
    declared, fitted = curve.knob.order, curve.order
    assert declared is not None
    assert fitted is not None
    order = max(declared, fitted.exponent)  # the slower of the two
    near = max((t for t in solid if t.setting < setting), key=lambda t: t.setting)
    falls = (setting / near.setting) ** order
    first, last = curve.trials[0], curve.trials[-1]
    settings, times = zip(*((t.setting, t.seconds) for t in curve.trials), strict=True)
    if setting < last.setting:
        seconds = float(np.interp(setting, settings, times))
    else:  # largest cost of one more unit, from the cheapest and the finest run
        more = max(last.seconds_high - first.seconds_low, 0.0)
        each = more / max(last.setting - first.setting, 1)
        seconds = last.seconds + each * (setting - last.setting)
    spread = near.seconds_high / near.seconds if near.seconds > 0 else 1.0
    return replace(
        near,
        setting=setting,
        error=near.error * falls,
        error_low=near.error_low * falls,
        error_high=near.error_high * falls,
        seconds=seconds,
        seconds_low=seconds / spread,
        seconds_high=seconds * spread,
        norms={},
        measured=False,
    )


def choose(
    curve: Curve | Sequence[Trial],
    *,
    tolerance: float | None = None,
    seconds: float | None = None,
) -> Trial:
    """Choose the cheapest setting whose error is within a tolerance, or the most accurate setting
    whose time is within a limit. Among settings with indistinguishable times, the most accurate is
    chosen.

    For a random approximation, the error bound comes from the scatter over a few seeds. If the
    result depends on rare events, such as bright paths of low probability, these seeds may have
    missed them. In that case more than one run in twenty has an error above the bound. The bound is
    also too low if the reference has the same bias as all settings, for example if an integrator
    cannot find some of the light (`transport.light_findings`).

    Args:
        curve: from `curve`, or the trials of `error_against_time`.
        tolerance: the largest relative error of a run with any seed.
        seconds: the longest time of a warm call, s.

    Returns:
        The trial of the chosen setting. Its `measured` is False if its error was inferred from
            other settings.

    Raises:
        InputError: unless exactly one of tolerance and time is given, and if no setting meets the
            given limit.

    Example:
        >>> from jaxvision.accuracy import choose, error_against_time
        >>> calls = {n: lambda n=n: np.mean(((np.arange(n) + 0.5) / n) ** 2) for n in (1, 10, 100)}
        >>> print(choose(error_against_time(calls, 1 / 3), tolerance=1e-3).error < 1e-3)
        True
    """
    if (tolerance is None) == (seconds is None):
        raise InputError("choose needs either a tolerance or a time; give one of the two.")
    limit = tolerance if seconds is None else seconds
    assert limit is not None
    if not limit >= 0:
        raise InputError(f"choose by {limit:g}: give a tolerance or a time of at least 0.")
    found = candidates(curve) if isinstance(curve, Curve) else tuple(curve)
    floor = curve.reference.error if isinstance(curve, Curve) else 0.0
    if seconds is None:
        enough = [trial for trial in found if trial.error_high <= limit]
        if not enough:
            raise InputError(_refuse_unreached(found, floor, limit))
        fastest = min(enough, key=lambda trial: trial.seconds)
        as_fast = [t for t in enough if t.measured and t.seconds <= fastest.seconds_high]
        return min(as_fast or [fastest], key=lambda trial: (trial.error_high, trial.seconds))
    if not found:
        raise InputError(f"No setting takes at most {seconds:g} s: none was run; allow more time.")
    quick = [trial for trial in found if trial.seconds <= seconds]
    if not quick:
        fastest = min(found, key=lambda trial: trial.seconds)
        raise InputError(
            f"No setting takes at most {seconds:g} s; the fastest, {fastest.setting}, takes "
            f"{fastest.seconds:.3g} s."
        )
    return min(quick, key=lambda trial: trial.error_high)


def _refuse_unreached(found: Sequence[Trial], floor: float, tolerance: float) -> str:
    known = [trial for trial in found if np.isfinite(trial.error_high)]
    if not known:
        return f"No setting reaches {tolerance:g}: no error is known."
    best = min(known, key=lambda trial: trial.error_high)
    words = (
        f"No setting reaches {tolerance:g}; the most accurate, {best.setting}, is only known to be "
        f"within {best.error_high:.3g}"
    )
    if tolerance < 3 * floor:
        return f"{words}, and the reference itself within {floor:.3g}: allow more time for it."
    return f"{words}: refine the knob or allow more."
