"""Release 4 *General*: figures of a camera that need no linear model, only its measured response.

With mu_y - mu_y.dark the response, R its slope at the light mu_p, and sigma_y the temporal noise,

    output    SNR_y = (mu_y - mu_y.dark) / sigma_y
    input     sigma_p = sigma_y / R,    SNR_p = mu_p / sigma_p
    total     sigma_y^2 + s_y^2 in place of sigma_y^2, s_y^2 being the spatial variance
    efficiency    eta >= SNR_p^2 / mu_p, since no SNR_p exceeds the square root of the electrons
    threshold     the light of SNR_p = 1;   dynamic range   saturation / threshold

A nonlinear response (gamma, several slopes, companding) affects SNR_y but not SNR_p. The slope R at
a level is the slope of a parabola fitted to the five levels nearest in light; zero light counts as
a level. Below the faintest level with SNR_y >= 1, response and variance are interpolated linearly
between the dark and that level.

Intervals come from random draws of means and variances with their sampling errors.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..emva1288 import Ranges
from ..levels import Levels, linear_levels
from ..regressions import sampling_errors
from ..shared import SharedNoise
from .saturation import WIDTH_OF_ERROR
from .stacks import Stacks

NEAREST = 5
DRAWS = 2000


@dataclass(frozen=True)
class General:
    """The signal-to-noise ratios of a measured response at each level, and the figures that
    follow."""

    # light of the levels below saturation, photons per pixel, or s where photons are unknown
    light: Float[np.ndarray, " levels"]
    slope: Float[np.ndarray, " levels"]  # R, DN per unit of light
    output: Float[np.ndarray, " levels"]  # SNR_y
    input: Float[np.ndarray, " levels"]  # SNR_p
    # SNR_p with the spatial variance; None without images
    total: Float[np.ndarray, " levels"] | None
    input_errors: Float[np.ndarray, " levels"]  # standard errors of SNR_p
    # s_y / (R mu_p), per cent; None without images
    nonuniformity: Float[np.ndarray, " levels"] | None
    draws: dict[str, Float[np.ndarray, " draws"]]  # random draws of the figures, by name
    values: dict[str, float]  # the figures, by name


def slopes(light: Float[np.ndarray, " levels"]) -> Float[np.ndarray, "levels levels"]:
    """Return the matrix that gives the response's slopes from the signals of all levels."""
    points = np.concatenate([[0.0], light])
    found = np.zeros((len(light), len(points)))
    for i, at in enumerate(light):
        near = np.sort(np.argsort(np.abs(points - at), kind="stable")[:NEAREST])
        scale = max(float(np.max(np.abs(points[near] - at))), np.finfo(float).tiny)
        away = (points[near] - at) / scale
        degree = min(2, len(np.unique(away)) - 1)
        found[i, near] = np.linalg.pinv(np.vander(away, degree + 1, increasing=True))[1] / scale
    return found[:, 1:]


def general(
    stacks: Stacks, within: Ranges, shared: SharedNoise | None, rng: np.random.Generator
) -> General:
    """Compute the signal-to-noise ratios of the measured response, and the figures that follow."""
    measurement = stacks.measurement
    bright, dark = measurement.bright, measurement.dark
    lights, variances = np.asarray(bright.light), np.asarray(bright.variance)
    if within.saturation is None:
        used = linear_levels(measurement)
        used = used[lights[used] > 0]
    else:
        used = np.flatnonzero((lights <= float(within.saturation)) & (lights > 0) & (variances > 0))
    matched = np.asarray(measurement.dark_of)[used]
    lit = _draw_moments(bright, shared, rng)
    unlit = _draw_moments(dark, shared, rng)
    signal = lit[0][:, used] - unlit[0][:, matched]
    variance, dark_variance = lit[1][:, used], unlit[1][:, matched]
    light = lights[used]
    slope = signal @ slopes(light).T
    noise = np.sqrt(variance)
    output, of_input = signal / noise, light * slope / noise
    best = int(np.argmax(of_input[0]))
    drawn = {
        "output_snr_max": output[:, int(np.argmax(output[0]))],
        "input_snr_max": of_input[:, best],
    }
    drawn["input_snr_max_db"] = 20 * np.log10(np.maximum(drawn["input_snr_max"], 1e-300))
    if measurement.photons_known:
        most = int(np.argmax(of_input[0] ** 2 / light))
        drawn["efficiency_bound"] = 100 * of_input[:, most] ** 2 / light[most]
    seen = np.flatnonzero(output[0] >= 1)
    if len(seen):
        k = int(seen[0])
        rate, growth = signal[:, k] / light[k], (variance - dark_variance)[:, k] / light[k]
        least = growth + np.sqrt(growth**2 + 4 * rate**2 * dark_variance[:, k])
        drawn["threshold_photons"] = least / (2 * rate**2)
    if within.saturation is not None and within.saturation_width is not None:
        error = float(within.saturation_width) / WIDTH_OF_ERROR
        top = float(within.saturation) + error * rng.standard_normal(DRAWS + 1)
        top[0] = float(within.saturation)
        drawn["saturation_photons"] = top
        if "threshold_photons" in drawn:
            drawn["dynamic_range"] = np.maximum(top, 0) / drawn["threshold_photons"]
            drawn["dynamic_range_db"] = 20 * np.log10(np.maximum(drawn["dynamic_range"], 1e-300))
    if not measurement.photons_known:
        for name in ("threshold_photons", "saturation_photons"):
            drawn.pop(name, None)
    spatial = None
    if stacks.bright:
        spatial = np.maximum([stacks.bright[i].total for i in used], 0.0)
    return General(
        light,
        slope[0],
        output[0],
        of_input[0],
        None if spatial is None else light * slope[0] / np.sqrt(variance[0] + spatial),
        of_input[1:].std(axis=0),
        None if spatial is None else 100 * np.sqrt(spatial) / (slope[0] * light),
        {name: one[1:] for name, one in drawn.items()},
        {name: float(one[0]) for name, one in drawn.items()},
    )


def _draw_moments(
    levels: Levels, shared: SharedNoise | None, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw (draws, levels) means and variances; the first row is the measured one."""
    errors = sampling_errors(levels, shared=shared)
    found = []
    for value, error in ((levels.mean, errors.mean), (levels.variance, errors.variance)):
        steps = rng.standard_normal((DRAWS + 1, value.size))
        steps[0] = 0
        found.append(np.asarray(value) + np.sqrt(np.asarray(error)) * steps)
    return found[0], np.maximum(found[1], np.finfo(float).tiny)
