"""Checks for frames that do not come from one camera in one state, over all light levels of a
series. Each check looks for one of these signs:

- Flats are as skewed as those of an EMCCD, whose ratio of variance to signal is not the gain
  (`multiplied`).
- The darks alone, or the flats alone, have fractional values. Such frames are averages, which have
  too little noise.
- Darks get darker in the order in which they were taken, in proportion to the flats of their level.
  The cause is an afterglow (persistence) of the flats, not dark current.
- The ratio of variance to signal is constant up to one level, and has another constant value from
  the next level on. The frames were taken at two gains.
- The variance of the darks alone jumps in the same way. The cause is another gain of the darks, or
  an exposure from which the camera subtracts a dark frame.
- The signal of flats drifts in one direction from frame to frame, for example while a lamp or a
  camera warms up. Such a drift between levels resembles a curved response (`drifting`).
- The light seems to scatter because a camera rounded exposure times for display
  (`printed_times`).

Without electron multiplication, a signal of x DN at the gain K has variance K x and third cumulant
K^2 x. The multiplication register of an EMCCD turns each electron into an exponentially distributed
number with mean g. The ratio of variance to signal is then K' = 2 g K (an excess noise factor of
2), and the third cumulant is 3 / 2 K'^2 x.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import stdtr, stdtrit

from ..frame_checks.dialled import LESS, exact_times, worst_in_words
from ..frame_checks.frame import FrameSample
from ..inference.formatting import format_with_error
from .emva1288 import least_dark_variance
from .levels import Doubt, PhotonTransfer, linear_levels, shot_of, signal_of
from .pattern import pattern_variance
from .quantities import ON_GAIN
from .regressions import least_squares

SKEWED, NEAR = 1.5, 0.15  # ratio to the third cumulant of light alone, and tolerance
SURE_OF_SKEW = 6.0  # standard errors
LARGEST_CUMULANT_SHARE = 0.1  # share of the third cumulant that unequal pixels may add
FEWEST_SKEWED = 3


def multiplied(
    measurement: PhotonTransfer,
    flats: Sequence[Sequence[FrameSample]],
    darks: Sequence[Sequence[FrameSample]],
) -> Doubt | None:
    """Return a doubt if dim flats are as skewed as after electron multiplication."""
    bright, dark = measurement.bright, measurement.dark
    if bright.spatial_variance is None or dark.spatial_variance is None:
        return None
    matched = np.asarray(measurement.dark_of)
    uneven = pattern_variance(bright)[0] - pattern_variance(dark)[0][matched]
    of_darks = {i: _third_cumulant(darks[i], float(dark.variance[i])) for i in {*matched.tolist()}}
    signals, shots = signal_of(measurement), shot_of(measurement)
    ratios, errors, gains = [], [], []
    for level in linear_levels(measurement):
        own = int(matched[level])
        gain = float(shots[level]) / max(float(signals[level]), 1e-9)
        of_light = gain**2 * float(signals[level])
        clipped = any(frame.at_bottom > 0 for frame in (*flats[level], *darks[own]))
        if (
            clipped
            or gain <= 0
            or max(uneven[level], 0.0) ** 1.5 > LARGEST_CUMULANT_SHARE * of_light
        ):
            continue
        found, error = _third_cumulant(flats[level], float(bright.variance[level]))
        unlit, unlit_error = of_darks[own]
        ratios.append((found - unlit) / of_light)
        errors.append(float(np.hypot(error, unlit_error)) / of_light)
        gains.append(gain)
    if len(ratios) < FEWEST_SKEWED:
        return None
    weights = np.array(errors) ** -2
    ratio = float(np.average(ratios, weights=weights))
    scatter = float(np.average((np.array(ratios) - ratio) ** 2 / np.square(errors)))
    error = float(np.sqrt(max(scatter, 1.0) / weights.sum()))
    if ratio - 1 < SURE_OF_SKEW * error or abs(ratio - SKEWED) > NEAR:
        return None
    gain = float(np.average(gains, weights=weights))
    return Doubt(
        ON_GAIN,
        "the electrons were multiplied, as the findings say",
        f"Dim flats are {format_with_error(ratio, error)} times as skewed as light alone makes "
        "them, as where a register multiplies electrons (EMCCD): the excess noise factor is 2 and "
        f"variance over signal, {gain:.4g} DN, is twice the gain from an electron of a pixel to "
        f"the codes, which is {gain / 2:.4g} DN. Figures that depend on the gain are not given.",
    )


def _third_cumulant(frames: Sequence[FrameSample], variance: float) -> tuple[float, float]:
    """Return the third cumulant over a frame's pixels, DN^3, and its standard error."""
    apart = [frame.sample - frame.sample.mean(dtype=float) for frame in frames]
    found = float(np.mean([np.vdot(one * one, one) / one.size for one in apart]))
    return found, float(np.sqrt(6 * variance**3 / sum(one.size for one in apart)))


FEWEST_DRIFTING = 5
SURE_OF_WARMING = 8.0  # standard errors of the first change
MOST_CHI_SQUARE = 2.5  # per degree of freedom
DECAYS = 0.05, 1.0  # of the number of frames, after which a change has decayed to 1/e
CHANCE_OF_DRIFT = 1e-6  # probability of a false drift for a steady or flickering lamp


class Drifting(NamedTuple):
    """A steady drift of the flats' signal from frame to frame."""

    share: float  # relative change from one frame of a level to the next
    error: float  # its standard error
    frames: int  # number of flats

    @property
    def total(self) -> float:
        """Relative change of the signal over all flats, if they were taken one after another."""
        return self.share * (self.frames - 1)


def drifting(measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]) -> Drifting | None:
    """Return the drift of the flats' signal; None if it is not significant."""
    found = trend_of(measurement, usable)
    warming = _warming(measurement, usable)
    if warming is not None:
        return warming
    if found is None or abs(found.share) < found.error * stdtrit(
        len(usable) - 1, 1 - CHANCE_OF_DRIFT / 2
    ):
        return None
    return found


def _warming(measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]) -> Drifting | None:
    """Return the mean drift if the changes within levels decay exponentially, as in warming up."""
    shares = _shares_of(measurement, usable)
    if shares is None:
        return None
    share, noise, frames = shares
    place = np.cumsum(frames) - frames / 2
    best, least = None, MOST_CHI_SQUARE * (len(share) - 2)
    for decay in place[-1] * np.geomspace(*DECAYS, 60):
        falls = np.exp(-place / decay)
        square = float(np.sum(falls**2 / noise))
        size = float(np.sum(falls * share / noise)) / square
        chi_square = float(np.sum((share - size * falls) ** 2 / noise))
        if chi_square < least and abs(size) * square**0.5 > SURE_OF_WARMING:
            least, mean = chi_square, float(np.average(falls, weights=frames))
            best = Drifting(size * mean, mean / square**0.5, int(frames.sum()))
    return best


def _shares_of(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return each level's relative change between frames, its variance, and the frames."""
    bright = measurement.bright
    if bright.trend is None or len(usable) < FEWEST_DRIFTING:
        return None
    signal = signal_of(measurement)[usable]
    if not (signal > 0).all():
        return None
    frames = np.asarray(bright.frames)[usable]
    squares = frames * (frames**2 - 1) / 12  # sum of squares of the frame order about its mean
    shares = np.asarray(bright.trend)[usable] / signal
    noise = np.asarray(bright.variance)[usable] / float(bright.pixels) / squares / signal**2
    return shares, noise, frames


def trend_of(measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]) -> Drifting | None:
    """Return the mean change of the signal from frame to frame; None where it is unknown."""
    found = _shares_of(measurement, usable)
    if found is None:
        return None
    shares, noise, frames = found
    mean = least_squares((1.0,), shares, errors=np.sqrt(noise))
    return Drifting(float(mean.values[0]), float(mean.errors[0]), int(frames.sum()))


FEWEST_TIMES = 6


def printed_times(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> dict[str, str | float] | None:
    """Return the numbers for the finding on rounded exposure times; None if they are exact."""
    times = np.asarray(measurement.bright.exposure)[usable]
    signal = signal_of(measurement)[usable]
    if measurement.photons_known or len(times) < FEWEST_TIMES or np.any(times * signal <= 0):
        return None
    stated = _scatter(signal, times)
    for exact in exact_times(times):
        left = _scatter(signal, exact)
        if left < LESS * stated:
            worst = worst_in_words(times, exact)
            return {"worst": worst, "left": 100 * left, "stated": 100 * stated}
    return None


def _scatter(signal: Float[np.ndarray, " levels"], times: Float[np.ndarray, " levels"]) -> float:
    """Return the rms deviation of ln(signal / time) from a smooth curve over time."""
    return least_squares((1.0, times, 1 / times), np.log(signal / times)).misfit ** 0.5


FALSE_ALARM_PROBABILITY = 1e-4  # probability that darks of a faultless camera seem to fade
FEWEST_LEVELS = 5
CONSTANT = 1 / 3  # share of the decrease at the brightest level that may be common to all levels
STEP = np.log(1.25)  # least step of ln gain, or of ln dark variance
SIGNIFICANCE_SIGMAS = 6.0  # standard errors of the difference of two groups
ALIKE, SUDDEN = 0.25, 0.6  # of a step: largest scatter in a group, least between neighbours
DITHERED = 1.0  # variance, in squared steps, below which rounding distorts it
LARGEST_VARIANCE_ERROR = 0.05  # relative error of a level's variance up to which it is used
OF_DARK_NOISE = (
    *("temporal_dark_noise", "read_noise", "threshold_photons", "threshold_electrons"),
    *("dynamic_range", "dynamic_range_db", "usable_bits", "dark_current_variance"),
)


class _Step(NamedTuple):
    """A level at which a quantity changes from one constant to another."""

    low: float  # geometric mean before the step
    high: float  # geometric mean from the step on
    before: int  # index of the last level before the step
    after: int  # index of the first level after it


def doubts(
    measurement: PhotonTransfer,
    flats: Sequence[Sequence[FrameSample]],
    darks: Sequence[Sequence[FrameSample]],
) -> tuple[Doubt, ...]:
    """Run the checks and return the doubts, each with the figures not to be reported."""
    found = (
        _fading(measurement, darks),
        multiplied(measurement, flats, darks),
        _find_averaging(measurement),
        _two_gains(measurement, flats) or _two_modes(measurement, darks),
    )
    return tuple(one for one in found if one is not None)


def _fading(measurement: PhotonTransfer, darks: Sequence[Sequence[FrameSample]]) -> Doubt | None:
    """Return a doubt if darks fade from frame to frame in proportion to their flats' signal."""
    dark, matched = measurement.dark, np.asarray(measurement.dark_of)
    signal = signal_of(measurement)
    there = [i for i in range(len(darks)) if (matched == i).any()]
    if len(there) < FEWEST_LEVELS:
        return None
    falls, lights, errors = [], [], []
    for i in there:
        means = np.array([frame.mean for frame in darks[i]])
        order = np.arange(len(means)) - (len(means) - 1) / 2
        squares = float(np.sum(order**2))
        falls.append(-float(order @ means) / squares)
        lights.append(float(signal[matched == i].mean()))
        errors.append(np.sqrt(float(dark.variance[i]) / float(dark.pixels) / squares))
    if max(lights) <= 0:
        return None
    x, y = np.array(lights) / max(lights), np.array(falls)
    design = np.stack([np.ones_like(x), x], axis=1)
    (constant, share), *_ = np.linalg.lstsq(design, y)
    left, degrees = y - design @ [constant, share], len(y) - 2
    scatter = max(float(np.sum(left**2) / degrees), float(np.mean(np.square(errors))))
    if not scatter > 0:
        return None
    error = np.sqrt(scatter * np.linalg.inv(design.T @ design)[1, 1])
    if stdtr(degrees, -share / error) > FALSE_ALARM_PROBABILITY or abs(constant) > CONSTANT * share:
        return None
    top = there[int(np.argmax(x))]
    means = [frame.mean for frame in darks[top]]
    listed = ", ".join(f"{mean:.5g}" for mean in means[:6])
    excess = (np.mean(means) - means[-1]) / max(lights)
    return Doubt(
        ("dark_current_mean", "dark_current_variance", "dark_current"),
        "the darks fade from frame to frame in proportion to the flats of their exposure",
        "The darks of a level fade from frame to frame, in proportion to the signal of its flats "
        f"({darks[top][0].name} and the next have means of {listed} DN), as with the afterglow "
        "(persistence) of a flat or a sensor that cools. Dark current is therefore not determined, "
        f"and the signals of the flats are too small by at least {100 * excess:.2g} %. Take the "
        "darks before the flats, or wait.",
    )


def _find_averaging(measurement: PhotonTransfer) -> Doubt | None:
    """Return a doubt if only the flats, or only the darks, have fractional values."""
    bright, dark = (levels.converter.step for levels in (measurement.bright, measurement.dark))
    if bright == dark:
        return None
    finer, names, whole, of, lost = (
        (dark, "darks", "flats", OF_DARK_NOISE, "dark noise")
        if dark < bright
        else (bright, "flats", "darks", ON_GAIN, "gain")
    )
    parts = f"multiples of 1/{1 / finer:.6g}" if finer else "on no grid"
    averages = f" (averages of {1 / finer:.6g} frames, say)" if finer else ""
    return Doubt(
        of,
        f"the {names} were averaged or corrected, as the findings say",
        f"The values of the {names} are {parts}, those of the {whole} are whole: the {names} were "
        f"averaged, divided or corrected{averages}, and their noise is not that of a frame. The "
        f"{lost} and the figures that depend on it are not determined. Give single {names}.",
    )


def _step(
    values: Float[np.ndarray, " levels"],
    errors: Float[np.ndarray, " levels"],
    levels: Int[np.ndarray, " levels"],
) -> _Step | None:
    """Find a level at which a quantity jumps between two nearly constant values, or None."""
    best, place, logs = np.inf, None, np.log(values)
    for i in range(2, len(logs) - 1):
        left = float(sum(np.sum((part - part.mean()) ** 2) for part in (logs[:i], logs[i:])))
        if left < best:
            best, place = left, i
    if len(logs) < FEWEST_LEVELS or place is None:
        return None
    low, high = logs[:place], logs[place:]
    size = float(high.mean() - low.mean())
    scatter = np.sqrt(best / (len(logs) - 2) + np.mean(errors**2))
    within = max(np.abs(part - part.mean()).max() for part in (low, high))
    sudden = np.sign(size) * (logs[place] - logs[place - 1])
    if (
        abs(size) < max(STEP, SIGNIFICANCE_SIGMAS * scatter * np.sqrt(1 / len(low) + 1 / len(high)))
        or within > ALIKE * abs(size)
        or sudden < SUDDEN * abs(size)
    ):
        return None
    before, after = (int(level) for level in levels[place - 1 : place + 1])
    return _Step(float(np.exp(low.mean())), float(np.exp(high.mean())), before, after)


def _two_gains(measurement: PhotonTransfer, flats: Sequence[Sequence[FrameSample]]) -> Doubt | None:
    bright, usable = measurement.bright, linear_levels(measurement)
    signal, shot = signal_of(measurement)[usable], shot_of(measurement)[usable]
    errors = bright.variance_error[usable] / np.maximum(shot, 1e-9)
    dithered = np.asarray(bright.variance)[usable] > DITHERED * measurement.converter.width**2
    known = (signal > 0) & (shot > 0) & (errors < LARGEST_VARIANCE_ERROR) & dithered
    found = _step(shot[known] / signal[known], errors[known], usable[known])
    if found is None:
        return None
    return Doubt(
        ON_GAIN,
        "the flats have two gains, as the findings say",
        f"Variance over signal is {found.low:.3g} DN in the levels up to that of "
        f"{flats[found.before][0].name}, and {found.high:.3g} DN from that of "
        f"{flats[found.after][0].name} on, as if the gain was changed or some frames were "
        "averaged or denoised. The gain and the figures that depend on it are not determined. "
        "Calibrate the two ranges separately, or state iso or gain_db of every flat and dark.",
    )


def _two_modes(measurement: PhotonTransfer, darks: Sequence[Sequence[FrameSample]]) -> Doubt | None:
    dark = measurement.dark
    order = np.argsort(np.asarray(dark.exposure), kind="stable")
    variance = np.asarray(dark.variance)[order]
    if not (variance > least_dark_variance(measurement)).all():
        return None
    found = _step(variance, dark.variance_error[order] / variance, order)
    if found is None:
        return None
    return Doubt(
        OF_DARK_NOISE,
        "the darks have two read-out modes, as the findings say",
        f"The variance of the darks is {found.low:.3g} DN² up to the level of "
        f"{darks[found.before][0].name}, and {found.high:.3g} DN² from that of "
        f"{darks[found.after][0].name} ({float(dark.exposure[found.after]):.3g} s) on: the camera "
        "changes its read-out there, for example its gain, or it subtracts a dark frame at long "
        "exposures (noise reduction, which doubles the variance). Dark noise is not determined; "
        "calibrate the two ranges separately.",
    )
