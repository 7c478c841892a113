"""Comparison of frames with their prediction by a camera.

`jaxvision` computes the predicted means and variances from the camera alone. If photons are
unknown, the rate of the light is fitted to the means of the compared frames; nothing else is fitted
to these frames. Let r be the residuals of one quantity over n levels, N their covariance by the
noise of the frames, and P their covariance by the uncertainty of the camera (its posterior draws):

    chi-square = r (N + P)^-1 r      levels that the camera was not fitted to
    chi-square = r N^-1 r            levels that it was fitted to, with n - tr min(P N^-1, 1)
                                     degrees of freedom

A calibration fits the sum of the covariances with all neighbours, in which the nearest neighbours
have little weight. Covariances of nearest neighbours are therefore compared as if the calibration
had not used them.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import eigh
from scipy.special import chdtr, chdtrc

from jaxvision import Sensor
from jaxvision.errors import InputError
from jaxvision.sensor import dark_rate

from ..levels import CLEAR_OF_CLIPPING, PhotonTransfer
from .moments import (
    QUANTITIES,
    Expected,
    Frames,
    Lit,
    charge_and_step,
    clipped,
    expected,
    levels_of,
    noise,
    number_of,
    select_levels,
    touched_by_ends,
)

REFINEMENTS = 3  # updates of the rate of the light; the signal is nearly linear in it
CLOSE = (0.9, 1.1)  # chi-square per degree of freedom at which no missing effect is searched
FALSE_ALARM_PROBABILITY = 1e-3  # probability of such a chi-square without a missing effect
NEIGHBOURS = "covariances of neighbours"
IN_ONE = 1e-4  # codes from an end of the scale, and variance, within which all values have one code
UNKNOWN = 1e9  # relative variance of a quantity that a camera does not predict
PARTS = {"means": (0,), "variances": (1,), NEIGHBOURS: (2, 3)}


@dataclass(frozen=True)
class Agreement:
    """The agreement of one quantity (means, variances or covariances) with its prediction.

    Attributes:
        chi_square: of the quantity's residuals over the levels.
        degrees: of freedom.
    """

    chi_square: float
    degrees: float

    @property
    def ratio(self) -> float:
        return self.chi_square / self.degrees

    @property
    def p_value(self) -> float:
        """The two-sided p-value of the chi-square, which may be too large or too small."""
        ends = (tail(self.degrees, self.chi_square) for tail in (chdtr, chdtrc))
        return min(2 * float(min(ends)), 1.0)

    @property
    def is_missed(self) -> bool:
        """Whether chi-square per degree of freedom differs from 1 significantly and by over a
        tenth."""
        return not CLOSE[0] <= self.ratio <= CLOSE[1] and self.p_value < FALSE_ALARM_PROBABILITY


@dataclass(frozen=True)
class Comparison:
    """Observed and predicted means, variances and covariances of some levels.

    Attributes:
        lit: light and exposure of the levels.
        levels: statistics of the frames of these levels.
        found: prediction of the best estimate of the camera, DN and DN^2.
        noise: (quantities, levels) sampling variance by the frames' own noise.
        camera: (quantities x levels, quantities x levels) covariance from the draws of the camera;
            0 for the data to which the camera was fitted.
        agreement: of each quantity with its prediction, by the names of `PARTS`; of means alone if
            the camera states no noise.
        unscaled: whether the rate of the light was fitted to the means, because the camera or the
            frames state no photons.
        ended: levels left out because the camera predicts the first or the last code for all their
            pixels.
    """

    lit: Lit
    levels: Frames
    found: Expected
    noise: Float[np.ndarray, "quantities levels"]
    camera: Float[np.ndarray, "values values"]
    agreement: dict[str, Agreement]
    unscaled: bool
    ended: int

    @property
    def measured(self) -> Float[np.ndarray, "quantities levels"]:
        """The observed means, DN, and variances and covariances, DN^2."""
        return self.levels.measured

    @property
    def errors(self) -> Float[np.ndarray, "quantities levels"]:
        """Standard deviations of observed minus predicted quantities, DN and DN^2."""
        own = np.diagonal(self.camera).reshape(self.noise.shape)
        return np.sqrt(self.noise + own)

    @property
    def residuals(self) -> Float[np.ndarray, "quantities levels"]:
        """Observed minus predicted quantities, in standard errors."""
        return (self.measured - self.found.values) / self.errors

    @property
    def missed(self) -> list[str]:
        """Names of the quantities that disagree with the prediction."""
        return [name for name, one in self.agreement.items() if one.is_missed]


def compare(
    best: Sensor,
    draws: Sensor | None,
    measurement: PhotonTransfer,
    usable: np.ndarray,
    *,
    shown: Bool[np.ndarray, " levels"] | None = None,
    fitted: bool = False,
    noise_known: bool = True,
    dies: int = 0,
    light_error: float = 0.0,
    variance_error: float = 0.0,
) -> Comparison:
    """Compare a measurement with its prediction by a camera. If `noise_known` is false, only means
    are compared, with errors from the variances of the frames. `dies` counts the samples of
    unequal pixels (of the frames, and of the calibration) by which the means may differ; 0 if both
    are the same pixels."""
    errors = {"light_error": light_error, "variance_error": variance_error}
    lit, levels = levels_of(measurement, usable, **errors)
    shown = np.ones(lit.lit.size, bool) if shown is None else shown
    seen = levels.measured
    unscaled = best.quantum_efficiency is None or not measurement.photons_known
    every = jax.tree.map(lambda x: np.asarray(x)[None], best)
    if draws is not None:
        every = jax.tree.map(lambda x, own: np.concatenate([x, own]), every, draws)
    if unscaled:
        lit = _scale_light(best, every, measurement, lit, seen, shown)
    found, drawn, die = _predict(best, every, measurement, lit, len(seen) == len(QUANTITIES))
    ended = np.zeros(shown.size, bool)
    if not fitted:
        ended = shown & _end_codes(best, found.values, measurement)
        shown = shown & ~ended
    if not noise_known:
        found = replace(found, values=np.concatenate([found.values[:1], seen[1:]]))
    if np.isinf(drawn).any():
        raise InputError("a parameter is too uncertain, and predicts infinite variances.")
    own = noise(levels, found)
    spread = drawn - drawn.mean(axis=0)
    if unscaled:  # the means determine a rate of the light for each draw
        weight = shown * found.by_light[0] / own[0]
        moved = spread[:, 0] @ weight / float(np.sum(weight * found.by_light[0]))
        spread = spread - moved[:, None, None] * found.by_light
    spread = spread[..., shown]
    levels, found = select_levels(levels, shown), select_levels(found, shown)
    lit = select_levels(lit, shown)
    seen, own = levels.measured, own[:, shown]
    flat = spread.reshape(len(spread), -1)
    die = die[np.ix_(*2 * (np.tile(shown, len(seen)),))] / levels.pixels
    own_means = slice(found.signal.size)
    die[own_means, own_means] += dies * _pixel_sampling_covariance(best, found, levels)
    camera = flat.T @ flat / len(flat)
    if not noise_known:
        unknown = UNKNOWN * np.concatenate([0 * own[:1], own[1:]]).ravel()
        camera = np.where(np.outer(unknown, unknown) > 0, 0.0, camera) + np.diag(unknown)
    agreement = {}
    for name, rows in PARTS.items():
        if rows[-1] < (len(seen) if noise_known else 1):
            free = int(unscaled and name == "means")
            place = np.ravel([np.arange(seen.shape[1]) + row * seen.shape[1] for row in rows])
            missed = (seen - found.values).ravel()[place]
            taken = fitted and name != NEIGHBOURS
            block = np.ix_(place, place)
            scatter = np.diag(own.ravel()[place]) + die[block]
            agreement[name] = _agreement(missed, scatter, camera[block], taken, free)
            if taken:
                camera[place] = camera[:, place] = 0.0
    count = int(ended.sum())
    return Comparison(lit, levels, found, own, camera + die, agreement, unscaled, count)


def _end_codes(sensor: Sensor, values: np.ndarray, measurement: PhotonTransfer) -> np.ndarray:
    """Return a mask of levels at which the camera predicts an end code for every pixel."""
    if sensor.bits is None:
        return np.zeros(values.shape[1], bool)
    step, origin = measurement.converter.step or 1.0, measurement.converter.origin
    codes = (values[0] - origin) / step
    end = (codes < IN_ONE) | (codes > 2.0 ** float(sensor.bits) - 1 - IN_ONE)
    return end & (values[1] < IN_ONE * step**2)


def _agreement(
    missed: np.ndarray, scatter: np.ndarray, camera: np.ndarray, fitted: bool, free: int
) -> Agreement:
    if fitted:
        # A fit to data with this scatter is at least as certain as the data in every direction.
        taken = float(np.sum(np.minimum(eigh(camera, scatter, eigvals_only=True), 1.0)))
        chi_square = float(missed @ np.linalg.solve(scatter, missed))
        degrees = len(missed) - free - min(taken, len(missed) - 1.0 - free)
        return Agreement(chi_square, degrees)
    chi_square = float(missed @ np.linalg.solve(scatter + camera, missed))
    return Agreement(chi_square, float(max(len(missed) - free, 1)))


def _predict(
    sensor: Sensor, every: Sensor, measurement: PhotonTransfer, lit: Lit, neighbours: bool
) -> tuple[
    Expected, Float[np.ndarray, "draws quantities levels"], Float[np.ndarray, "values values"]
]:
    """Return predictions by best estimate and draws, and the covariance due to offsets."""
    step, origin = measurement.converter.step or 1.0, measurement.converter.origin
    of_every = np.asarray(expected(every, lit, neighbours=neighbours))
    values = of_every[0].copy()
    electrons, slope, by_light = (np.asarray(x) for x in charge_and_step(sensor, lit))
    cut = (measurement.converter.lowest - origin) / step
    near = touched_by_ends(sensor, values, electrons, lowest=cut)
    die = np.zeros((values.size, values.size))
    dim = near & (cut > 0) & (values[0] - cut < CLEAR_OF_CLIPPING * np.sqrt(values[1]))
    for some, lowest in ((near & ~dim, 0.0), (dim, cut)):
        places = np.flatnonzero(some)
        if not places.size:
            continue
        moments, own = clipped(sensor, select_levels(lit, some), lowest=lowest)
        values[:2, places] = moments
        unit = np.repeat([step, step**2], len(places))
        at = np.concatenate([places, places + values.shape[1]])
        die[np.ix_(at, at)] = own * np.outer(unit, unit)
    unit = step * number_of(sensor, "gain", absent=1.0)
    shared = ("row_noise", "column_noise", "frame_noise")
    rows, columns, frames = ((unit * number_of(sensor, field)) ** 2 for field in shared)
    over_light = np.zeros_like(values)
    over_light[:2] = step * by_light, step**2 * slope * by_light
    values = _file_numbers(values, step, origin)
    rounding = 0.0 if sensor.bits is None else step**2 / 12
    current = 0.0 if sensor.dark_current is None else float(dark_rate(sensor.dark_current))
    found = Expected(
        *(values, over_light, electrons, step * slope),
        *(rows, columns, frames, rounding, current),
    )
    return found, _file_numbers(of_every[min(len(of_every) - 1, 1) :], step, origin), die


def _pixel_sampling_covariance(
    sensor: Sensor, found: Expected, levels: Frames
) -> Float[np.ndarray, "levels levels"]:
    """Return the covariance of level means by the sampling of pixels, DN^2."""
    rows, columns = levels.shape or 2 * (levels.pixels**0.5,)
    covariance = np.zeros(2 * found.signal.shape)
    for field, count, by in (
        ("dsnu", levels.pixels, found.step),
        ("row_dsnu", rows, found.step),
        ("column_dsnu", columns, found.step),
        ("prnu", levels.pixels, found.by_light[0]),
        ("conversion_prnu", levels.pixels, found.signal),
        ("column_prnu", columns, found.signal),
    ):
        covariance += np.outer(by, by) * number_of(sensor, field) ** 2 / count
    return covariance


def _file_numbers(values: np.ndarray, step: float, origin: float) -> np.ndarray:
    """Convert means in codes and variances in squared codes to the numbers in the file."""
    scaled = values * step**2
    scaled[..., 0, :] = origin + step * values[..., 0, :]
    return scaled


def _scale_light(
    sensor: Sensor,
    every: Sensor,
    measurement: PhotonTransfer,
    lit: Lit,
    seen: np.ndarray,
    shown: np.ndarray,
) -> Lit:
    """Fit the scale of the light to the frames' means; return the scaled levels."""
    step, origin = measurement.converter.step or 1.0, measurement.converter.origin
    signal = (seen[0] - origin) / step - number_of(sensor, "offset")
    rate = number_of(sensor, "gain", absent=1.0) * number_of(
        sensor, "quantum_efficiency", absent=1.0
    )
    light = np.asarray(lit.light)
    bright = shown & (light > 0)
    factor = float(np.median(signal[bright] / (rate * light[bright])))
    for _ in range(REFINEMENTS):
        now = replace(lit, light=light * max(factor, 1e-300))
        found, *_ = _predict(sensor, every, measurement, now, len(seen) == len(QUANTITIES))
        weight = 1 / np.maximum(found.values[1][bright], 1e-300)
        slope, missed = found.by_light[0][bright], (seen[0] - found.values[0])[bright]
        factor *= float(np.exp(np.sum(weight * slope * missed) / np.sum(weight * slope**2)))
    return replace(lit, light=light * factor)
