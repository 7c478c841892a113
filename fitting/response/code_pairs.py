"""The sufficient statistics of a response curve: weighted counts of the pairs of codes that a pixel
has in two exposures.

Each pixel i has an unknown irradiance E_i. Pixel i with the code z_ij in exposure j has the
residual r_ij = g(z_ij) - s_j - ln E_i, with weight w_ij. The weighted sum of squares, minimised
over ln E_i, is

    chi^2 = sum_ij w_ij (g(z_ij) - s_j)^2 - sum_i (sum_j w_ij (g(z_ij) - s_j))^2 / sum_j w_ij
          = theta^T A theta,    theta = (g, s),

where g is the curve's mean over each bin of codes and s the log exposure times. Thus the matrix A
contains all information of the pixels about the curve. The expected gradient of chi^2 at the true
curve, the score b, is not zero. Four effects contribute to b, given here for a change h(z) of the
curve g, the weights w and residuals r of a pixel, and the share of noise in the variance of ln X:

- Noise in a code shifts the g of that code: E[w r h(z)] = (1 - w / sum w) share h' / g', where
  `share` is the share of the variance that is independent of the light.
- A rounding error without noise is a function of the light, and shifts the g of the pixel's codes
  in other exposures: E[w r h(z)] = (w / sum w) h' / g' times the sum of (1 - share) over these
  exposures.
- Noise before the response curve lowers the mean of ln X by half the variance of ln X.
- A weight that changes across an interval of codes favours one end of the interval.

Codes are DN; log exposures are relative.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Integer

from .code_bins import CodeBins
from .weights import Observations, WeightRule, observe

CHUNK = 1 << 16  # pixels held in floating point at a time
LEAST_ARGUMENT = 1e-3  # x below which sinh(x) / x is 1
SMOOTHING = 0.3  # smoothing of the exponent, as a share of a code or, near white, of the rest


@dataclass(frozen=True)
class PairStatistics:
    """The information of the pixels about a curve: the matrix A and score b for the unknowns, which
    are the log exposure g in each bin of codes and the log time s of each exposure."""

    matrix: Float[np.ndarray, "unknowns unknowns"]  # the matrix A
    score: Float[np.ndarray, " unknowns"]  # the score b
    pixels: int  # number of pixels
    # number of pixels with a positive weight in each exposure
    observations: Int[np.ndarray, " exposures"]
    chi_square: float  # of the residuals at the curve from which the weights were computed


def pair_statistics(
    codes: Integer[np.ndarray, "exposures pixels"],
    classes: Int[np.ndarray, " pixels"],
    log_t: Float[np.ndarray, " exposures"],
    bins: CodeBins,
    rule: WeightRule,
    means: Float[np.ndarray, " bins"],
) -> PairStatistics:
    """Compute A and b from all pixels, a chunk at a time."""
    (every,) = statistics_of_parts(codes, classes, [slice(None)], log_t, bins, rule, means)
    return every


def statistics_of_parts(
    codes: Integer[np.ndarray, "exposures pixels"],
    classes: Int[np.ndarray, " pixels"],
    parts: Sequence[Int[np.ndarray, " part"] | slice],
    log_t: Float[np.ndarray, " exposures"],
    bins: CodeBins,
    rule: WeightRule,
    means: Float[np.ndarray, " bins"],
) -> list[PairStatistics]:
    """Compute A and b of several sets of pixels, which sum to those of all pixels."""
    every = []
    for part in parts:
        sums = _Sums(len(rule.by_bin), len(means), len(log_t))
        own, of_own = codes[:, part], classes[part]
        for start in range(0, own.shape[1], CHUNK):
            chunk = slice(start, start + CHUNK)
            seen = observe(bins.lookup[own[:, chunk]], of_own[chunk], log_t, means, rule)
            _count_pairs(sums, seen)
            if rule.weight is not None:
                _count_score(sums, seen, rule)
        every.append(sums)
    # A noise model may be wrong by a factor; the score uses the measured variance.
    chi_square = np.sum([sums.chi_square for sums in every], axis=0)
    scale = chi_square / np.maximum(np.sum([sums.free for sums in every], axis=0), 1)
    noisy = scale @ np.sum([sums.noisy for sums in every], axis=0)
    pull = _pull_of_noise(noisy, bins, means)
    return [_statistics(sums, scale, pull) for sums in every]


def _statistics(
    sums: "_Sums", scale: np.ndarray, pull: tuple[np.ndarray, np.ndarray]
) -> PairStatistics:
    curve = (sums.curve + sums.curve.T) / 2
    noisy, (below, above) = scale @ sums.noisy, pull
    at_ends = below * noisy[:-1] + above * noisy[1:]
    of_noise = -np.diff(at_ends, prepend=0, append=0)
    return PairStatistics(
        matrix=np.block([[curve, sums.mixed], [sums.mixed.T, sums.times]]),
        score=np.concatenate([of_noise + scale @ sums.bias, scale @ sums.time_bias]),
        pixels=sums.pixels,
        observations=sums.observations,
        chi_square=float(sums.chi_square.sum()),
    )


def total(parts: Sequence[PairStatistics]) -> PairStatistics:
    """Add the statistics of several sets of pixels."""
    return PairStatistics(
        matrix=np.sum([part.matrix for part in parts], axis=0),
        score=np.sum([part.score for part in parts], axis=0),
        pixels=sum(part.pixels for part in parts),
        observations=np.sum([part.observations for part in parts], axis=0),
        chi_square=sum(part.chi_square for part in parts),
    )


class _Sums:
    def __init__(self, classes: int, bins: int, exposures: int) -> None:
        self.curve = np.zeros((bins, bins))
        self.mixed = np.zeros((bins, exposures))
        self.times = np.zeros((exposures, exposures))
        self.noisy = np.zeros((classes, bins))
        self.bias = np.zeros((classes, bins))
        self.time_bias = np.zeros((classes, exposures))
        self.chi_square = np.zeros(classes)
        self.free = np.zeros(classes)  # observations less pixels
        self.observations = np.zeros(exposures, int)
        self.pixels = 0


def _count_pairs(sums: _Sums, seen: Observations) -> None:
    bins, exposures = sums.mixed.shape
    classes, used = len(sums.free), seen.weights > 0
    sums.pixels += len(seen.total)
    sums.observations += np.count_nonzero(used, axis=1)
    square = np.sum(seen.weights * seen.residuals**2, axis=0)
    sums.chi_square += np.bincount(seen.classes, square, classes)
    sums.free += np.bincount(seen.classes, np.count_nonzero(used, axis=0) - 1.0, classes)
    shares = seen.weights / np.sqrt(seen.total)
    for j in range(exposures):
        own = np.bincount(seen.binned[j], seen.weights[j] - shares[j] ** 2, bins)
        sums.curve[np.diag_indices(bins)] += own
        sums.mixed[:, j] -= own
        sums.times[j, j] += own.sum()
        later = slice(j + 1, None)
        products = shares[j] * shares[later]
        image, pixel = np.nonzero(products)  # most pixels are well exposed in few images only
        products, code = products[image, pixel], seen.binned[j][pixel]
        other = seen.binned[later][image, pixel]
        pairs = np.bincount(code * bins + other, products, bins**2).reshape(bins, bins)
        sums.curve -= 2 * pairs
        sums.mixed[:, j] += pairs.sum(axis=0)
        count = exposures - 1 - j
        by_image = np.bincount(code + image * bins, products, count * bins).reshape(count, bins)
        sums.mixed[:, later] += by_image.T
        sums.times[j, later] -= by_image.sum(axis=1)
        sums.times[later, j] -= by_image.sum(axis=1)


def _count_score(sums: _Sums, seen: Observations, rule: WeightRule) -> None:
    assert rule.share is not None
    assert rule.bias is not None
    used = seen.weights > 0
    leverage = seen.weights / seen.total
    share = np.where(used, rule.share.ravel()[seen.cells], 0)
    rounded = np.where(used, 1 - share, 0)
    noisy = share * (1 - leverage) + leverage * (rounded.sum(axis=0) - rounded)
    bias = np.where(used, rule.bias.ravel()[seen.cells], 0)
    bias -= leverage * bias.sum(axis=0)
    classes, bins = sums.noisy.shape
    for j in range(len(bias)):
        sums.time_bias[:, j] -= np.bincount(seen.classes, bias[j], classes)
    places = (seen.binned + seen.classes * bins).ravel()
    sums.noisy += np.bincount(places, noisy.ravel(), classes * bins).reshape(classes, bins)
    sums.bias += np.bincount(places, bias.ravel(), classes * bins).reshape(classes, bins)


def _pull_of_noise(
    of_all: np.ndarray, bins: CodeBins, means: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return two factors for each edge between bins: the contributions of the bin below and of the
    bin above to sum (noise share) h' / g'. Noise moves codes across the edge, where the function h,
    constant in each bin, has a step. The factors are exact if the density of observations is
    exponential over both bins. Each of the two bins contributes half of the effect, so that sets of
    pixels can be added."""
    width = np.diff(bins.edges)
    near, far = width[:-1], width[1:]
    below, above = of_all[:-1] / near, of_all[1:] / far
    both = (below > 0) & (above > 0)
    below, above = np.where(both, below, 1), np.where(both, above, 1)
    rate = 2 * np.log(above / below) / (near + far)
    left = np.log(below / _mean_over_centre(rate * near / 2))
    right = np.log(above / _mean_over_centre(rate * far / 2))
    density = np.exp((far * left + near * right) / (near + far))
    at_ends = np.where(both, density / _slope_at_ends(means, bins) / 2, 0)
    return at_ends / (below * near), at_ends / (above * far)


def _mean_over_centre(x: np.ndarray) -> np.ndarray:
    """Return sinh(x) / x, the mean of an exponential over its value in the middle."""
    far = np.abs(x) > LEAST_ARGUMENT
    return np.where(far, np.sinh(x) / np.where(far, x, 1), 1)


def _slope_at_ends(means: np.ndarray, bins: CodeBins) -> np.ndarray:
    """Return dg / dcode at bin edges by a smoothed exponent, which noise hardly moves."""
    apart, step = np.diff(bins.centres), np.diff(bins.log_codes)
    clock = np.cumsum(apart * bins.pace(bins.edges[1:-1]))
    near = step * np.exp(-(((clock[:, None] - clock) / SMOOTHING) ** 2) / 2)
    exponent = near @ (np.diff(means) / step) / near.sum(axis=1)
    return exponent / (bins.edges[1:-1] - bins.black)
