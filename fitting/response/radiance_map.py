"""Merging of an exposure stack with a known response to one radiance map.

The code z_ij of pixel i in image j gives the exposure X_ij = exp(g(z_ij)), whose variance follows
from the noise model. The maximum-likelihood radiance of a pixel is

    E_i = sum_j u_ij X_ij / t_j / sum_j u_ij,    u_ij = E_i^2 t_j^2 / Var(X_ij),

where the weight u_ij is computed at the predicted exposure, so that it does not depend on the noise
of X_ij. Codes that are clipped or within three standard deviations of clipping are not used. Noisy
codes are used only if there is no better exposure.

If all observations of a pixel are clipped or noisy, its radiance comes from all of its unclipped
codes together, and its coverage is 0. Noise may reduce the code of a dark pixel to black or below.
A code d below black counts as a negative exposure, X(black - d) = -X(black + d), because the mean
of the codes above black alone would be biased. The code 0, at which a camera clips noise, gives
only a bound, like a code clipped at white.

Radiance is relative, per second, with g = 0 at mid-scale.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Integer

from .code_pairs import CHUNK
from .curve import ResponseCurve
from .weights import noise_rule, noise_variance, predicted_weights, weighted_mean, weights_by_code

REWEIGHTED = 3  # iterations that weight a mostly noisy pixel by its own estimate


@dataclass(frozen=True)
class RadianceMap:
    """A radiance map merged from several exposures.

    Attributes:
        radiance: relative, per second; noise can make it negative in dark pixels.
        relative_error: relative standard deviation of the radiance, where the scene is flat.
        coverage: number of exposures that were used; 0 where the radiance is only a bound, or the
            codes are mostly noise.
    """

    radiance: Float[np.ndarray, "*pixels"]
    relative_error: Float[np.ndarray, "*pixels"]
    coverage: Int[np.ndarray, "*pixels"]


def merge(
    codes: Integer[np.ndarray, "exposures ..."],
    exposures: Float[np.ndarray, " exposures"],
    curve: ResponseCurve,
    *,
    signed: bool = True,
) -> RadianceMap:
    """Merge codes to a radiance map, without shutter offsets, which may be misfit."""
    flat = codes.reshape(len(exposures), -1)
    count = flat.shape[1]
    radiance, error = np.empty(count, np.float32), np.empty(count, np.float32)
    coverage = np.empty(count, np.int32)
    log_t = np.log(exposures)
    for start in range(0, count, CHUNK):
        part = slice(start, start + CHUNK)
        radiance[part], error[part], coverage[part] = _merge(flat[:, part], log_t, curve)
    shape = codes.shape[1:]
    if not signed:
        radiance = np.maximum(radiance, np.exp(curve.log_exposure[0] - log_t[-1]))
    return RadianceMap(radiance.reshape(shape), error.reshape(shape), coverage.reshape(shape))


def _merge(
    codes: np.ndarray, log_t: np.ndarray, curve: ResponseCurve
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rising = np.maximum.accumulate(curve.bin_means)
    rule = noise_rule([curve.noise], rising + 1e-9 * np.arange(len(rising)))
    binned, classes = curve.bins.lookup[codes], np.zeros(codes.shape[1], int)
    by_each = curve.log_exposure[binned] - log_t[:, None]
    rough = weights_by_code(rule, binned, classes)
    weights, _ = predicted_weights(rule, rule.weight, rough, by_each, log_t, classes)
    coverage = np.count_nonzero(weights, axis=0)
    total = weights.sum(axis=0)
    merged = weighted_mean(weights, np.exp(by_each))
    error = np.where(total > 0, 1 / np.sqrt(np.where(total > 0, total, 1)), np.inf)

    faint = np.flatnonzero(coverage == 0)
    merged[faint], error[faint] = _noise_radiance(codes[:, faint], np.exp(log_t), curve)
    return merged, error, coverage


def exposure_of_codes(curve: ResponseCurve) -> Float[np.ndarray, " codes"]:
    """Return the exposure X of every code, 0 at black and negative below it."""
    bins = curve.bins
    away = np.arange(bins.full_scale + 1) - bins.black
    near, log_z = np.abs(away) > 0, np.log(bins.centres - bins.black)
    log_away = np.log(np.where(near, np.abs(away), 1))
    size = np.exp(np.interp(log_away, log_z, curve.log_exposure))
    exponent = (curve.log_exposure[1] - curve.log_exposure[0]) / (log_z[1] - log_z[0])
    below = log_away < log_z[0]
    size = np.where(below, np.exp(curve.log_exposure[0] + exponent * (log_away - log_z[0])), size)
    return np.where(near, np.sign(away) * size, 0)


def _noise_radiance(
    codes: np.ndarray, times: np.ndarray, curve: ResponseCurve
) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance and relative error of pixels that are clipped or near black only."""
    table, t = exposure_of_codes(curve), times[:, None]
    x = table[codes]
    used = (codes > 0) & (codes < curve.bins.edges[-1])
    above = np.exp(curve.log_exposure)
    steps = np.gradient(above) / np.gradient(curve.codes)  # change of X per code
    merged, total = _mean_radiance(used * t, t, x)
    for _ in range(REWEIGHTED):
        expected = np.maximum(merged * t, above[0])
        noise = noise_variance(curve.noise, np.log(expected)) * expected**2
        variance = noise + np.interp(expected, above, steps) ** 2 / 12
        merged, total = _mean_radiance(used * t / variance, t, x)
    known = total > 0
    size = np.abs(np.where(known, merged, 1))
    error = np.where(
        known & (size > 0),
        1 / np.sqrt(np.where(known, total, 1)) / np.where(size > 0, size, 1),
        np.inf,
    )
    # Without any usable code the shortest exposure bounds from below, or the longest from above.
    clipped = codes[0] >= curve.bins.edges[-1]
    bound = np.where(clipped, above[-1] / times[0], above[0] / times[-1])
    return np.where(known, merged, bound), error


def _mean_radiance(
    weights: np.ndarray, times: np.ndarray, exposures: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted mean of X / t, and the sum of its weights."""
    total = (weights * times).sum(axis=0)
    return (weights * exposures).sum(axis=0) / np.where(total > 0, total, 1), total
