"""One radiance map from an exposure stack with a known response.

Each observation is an exposure X_ij = exp(g(z_ij)) with the variance of the noise model; the
maximum-likelihood radiance of a pixel is

    E_i = sum_j u_ij X_ij / t_j / sum_j u_ij,    u_ij = E_i^2 t_j^2 / Var(X_ij),

with u at the predicted exposure, so that noise does not choose its own weight. Clipped codes are
left out, and so are codes within three standard deviations of clipping. A pixel with no such
observation takes what its unclipped codes say, or the bound that its clipping sets: coverage 0.

Radiance is relative, per second, with g = 0 at mid-scale.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Integer

from .code_pairs import CHUNK
from .curve import ResponseCurve
from .weights import cells_of, noise_rule, weighted_mean


@dataclass(frozen=True)
class RadianceMap:
    """A merged map.

    Attributes:
        radiance: relative, per second.
        relative_error: its standard deviation over it, where the scene is flat.
        coverage: how many exposures were used (0: a bound, or codes too noisy to weigh).
    """

    radiance: Float[np.ndarray, "*pixels"]
    relative_error: Float[np.ndarray, "*pixels"]
    coverage: Int[np.ndarray, "*pixels"]


def merge(
    codes: Integer[np.ndarray, "exposures ..."],
    exposures: Float[np.ndarray, " exposures"],
    curve: ResponseCurve,
) -> RadianceMap:
    """The radiance map of codes, the exposure times being trusted as given.

    What looks like an offset of the shutter may be a slight misfit of the curve.

    Args:
        codes: (exposures, ...) DN.
        exposures: (exposures,) s, ascending.
        curve: of the response.

    Returns:
        float32 maps of the pixels' shape.
    """
    flat = codes.reshape(len(exposures), -1)
    count = flat.shape[1]
    radiance, error = np.empty(count, np.float32), np.empty(count, np.float32)
    coverage = np.empty(count, np.int32)
    log_t = np.log(exposures)
    for start in range(0, count, CHUNK):
        part = slice(start, start + CHUNK)
        radiance[part], error[part], coverage[part] = _merge(flat[:, part], log_t, curve)
    shape = codes.shape[1:]
    return RadianceMap(radiance.reshape(shape), error.reshape(shape), coverage.reshape(shape))


def _merge(
    codes: np.ndarray, log_t: np.ndarray, curve: ResponseCurve
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rising = np.maximum.accumulate(curve.bin_means)
    rule = noise_rule([curve.noise], rising + 1e-9 * np.arange(len(rising)))
    assert rule.weight is not None
    binned = curve.bins.lookup[codes]
    usable = binned >= 0
    by_each = curve.log_exposure[binned] - log_t[:, None]
    rough = np.where(usable, rule.by_bin[0][binned], 0)
    first = weighted_mean(rough, by_each)
    cells = cells_of(rule, first + log_t[:, None], np.zeros(codes.shape[1], int))
    weights = np.where(rough > 0, rule.weight[0][cells], 0)
    coverage = np.count_nonzero(weights, axis=0)

    noisy = np.where(usable, np.exp(2 * np.minimum(curve.log_exposure[binned], 0)), 0)
    weights = np.where(coverage > 0, weights, np.where(rough.any(axis=0), rough, noisy))
    total = weights.sum(axis=0)
    merged = weighted_mean(weights, np.exp(by_each))
    error = np.where(total > 0, 1 / np.sqrt(np.where(total > 0, total, 1)), np.inf)

    # Without any usable code the shortest exposure bounds from below, or the longest from above.
    clipped = codes[0] >= curve.bins.edges[-1]
    bound = np.where(
        clipped,
        np.exp(curve.log_exposure[-1] - log_t[0]),
        np.exp(curve.log_exposure[0] - log_t[-1]),
    )
    return np.where(total > 0, merged, bound), error, coverage
