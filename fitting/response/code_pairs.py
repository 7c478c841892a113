"""The sufficient statistics of a response: how often, and how surely, codes occur in pairs.

Each pixel has an unknown irradiance. With residuals r_ij = g(z_ij) - s_j - ln E_i of weight w_ij,
eliminating ln E_i leaves the energy

    chi^2 = sum_ij w_ij (g(z_ij) - s_j)^2 - sum_i (sum_j w_ij (g(z_ij) - s_j))^2 / sum_j w_ij
          = theta^T A theta,    theta = (g, s),

g being the curve's mean over each bin of codes and s the log exposure times: A holds all that the
pixels say about any curve. Its expected gradient at the true curve, the score b, is not zero:

- noise in a code moves its own g along: E[w r h(z)] = (1 - w / sum w) (noise share) h' / g' ;
- noise before the curve lowers a logarithm, on average by half its variance;
- a weight that changes across an interval of codes favours one of its ends.

Weights come from a noise model,  var(ln X) = relative + shot / X + read / X^2 + (width of the
interval)^2 / 12,  at the PREDICTED exposure X = E_i t_j, and observations are chosen by it:
weights and choices that follow the noisy code would bias the curve.

Codes are DN; log exposures are relative.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Integer
from scipy.optimize import nnls

MAX_BINS = 512  # 8- and 9-bit codes have a bin each
CHUNK = 1 << 16  # pixels held in floating point at a time
LOOSEST = 0.3  # log standard deviation up to which noise is near enough Gaussian
HAT_DEVIATION = 0.1  # log standard deviation taken at mid-scale before anything is known
HAT_BRIM = 0.08  # below this height the noise of a logarithm is anyone's guess
OUTLIER = 5.0  # standard deviations beyond which a residual cannot be noise: the pixel is left out
MARGIN = 3.0  # standard deviations that a predicted exposure stays clear of clipping
NOISE_CELLS = 48
FEWEST_IN_CELL = 10
WINSOR = 9 / 0.4549  # three standard deviations, squared, over a squared normal's median


@dataclass(frozen=True)
class CodeBins:
    """Intervals of codes.

    Attributes:
        edges: DN, ascending, half-integers.
        lookup: (codes,) bin of every code; -1 where it is at or below black or clipped.
        black: DN without light.
    """

    edges: Float[np.ndarray, " edges"]
    lookup: Int[np.ndarray, " codes"]
    black: float

    @property
    def full_scale(self) -> int:
        return len(self.lookup) - 1

    @property
    def centres(self) -> Float[np.ndarray, " bins"]:
        return (self.edges[1:] + self.edges[:-1]) / 2


@dataclass(frozen=True)
class NoiseModel:
    """Variance of ln X at relative exposure X: relative + shot / X + read / X^2.

    Attributes:
        relative: of the pixels' own gains.
        shot: at mid-scale.
        read: at mid-scale.
    """

    relative: float
    shot: float
    read: float


@dataclass(frozen=True)
class WeightRule:
    """How observations are weighted: tables over a uniform grid of log exposure, with an empty cell
    at either end.

    Attributes:
        by_bin: (bins,) weight to start from, by observed code.
        start: log exposure of the first cell.
        step: between cells.
        weight: (cells,); None where `by_bin` is the only weight.
        share: (cells,) share of the variance that is noise.
        bias: (cells,) mean of weight times residual.
    """

    by_bin: Float[np.ndarray, " bins"]
    start: float = 0.0
    step: float = 1.0
    weight: Float[np.ndarray, " cells"] | None = None
    share: Float[np.ndarray, " cells"] | None = None
    bias: Float[np.ndarray, " cells"] | None = None


@dataclass(frozen=True)
class Observations:
    """Linked pixels: those with two weights at least.

    Attributes:
        binned: (exposures, pixels) bins.
        weights: (exposures, pixels).
        cells: (exposures, pixels) of the rule's tables.
        residuals: (exposures, pixels) in ln X.
        total: (pixels,) sums of weights.
        log_irradiance: (pixels,).
    """

    binned: Int[np.ndarray, "exposures pixels"]
    weights: Float[np.ndarray, "exposures pixels"]
    cells: Int[np.ndarray, "exposures pixels"]
    residuals: Float[np.ndarray, "exposures pixels"]
    total: Float[np.ndarray, " pixels"]
    log_irradiance: Float[np.ndarray, " pixels"]


@dataclass(frozen=True)
class PairStatistics:
    """All that the pixels say about a curve: A and b over (bins, exposures).

    Attributes:
        matrix: A.
        score: b.
        pixels: that went in.
        observations: (exposures,) that went in.
        chi_square: the energy at the curve they were weighted by.
    """

    matrix: Float[np.ndarray, "unknowns unknowns"]
    score: Float[np.ndarray, " unknowns"]
    pixels: int
    observations: Int[np.ndarray, " exposures"]
    chi_square: float


def code_bins(bits: int, black: float, clip: float, *, count: int = MAX_BINS) -> CodeBins:
    """Bins of codes: one per code up to a number; beyond, bins of equal width in sqrt(DN - black),
    which follow shot noise.

    Args:
        bits: of the codes.
        black: DN without light.
        clip: DN from which a code is saturated.
        count: most bins.

    Returns:
        The bins.
    """
    first, last = int(np.floor(black)) + 1, min(int(np.ceil(clip)), 2**bits - 1) - 1
    if last - first + 1 <= count:
        starts = np.arange(first, last + 2)
    else:
        even = np.linspace(0, np.sqrt(last + 1 - first), count + 1)
        starts = np.unique(np.round(first + even**2).astype(int))
    lookup = np.searchsorted(starts, np.arange(2**bits), side="right") - 1
    lookup[starts[-1] :] = -1
    return CodeBins(starts - 0.5, lookup.astype(np.int32), black)


def noise_variance(
    noise: NoiseModel, log_exposure: Float[np.ndarray, " points"]
) -> Float[np.ndarray, " points"]:
    """Variance that noise gives the logarithm of an exposure.

    Args:
        noise: of the pixels.
        log_exposure: (points,).

    Returns:
        (points,).
    """
    inverse = np.exp(-log_exposure)
    return noise.relative + noise.shot * inverse + noise.read * inverse**2


def interval_variance(means: Float[np.ndarray, " bins"]) -> Float[np.ndarray, " bins"]:
    """Variance of ln X within each bin, its light being log-uniform."""
    return np.gradient(means) ** 2 / 12


def hat_rule(bins: CodeBins) -> WeightRule:
    """Weights by the observed code, highest at mid-scale and falling to both ends (Debevec &
    Malik's hat, squared)."""
    height = np.minimum(bins.centres - bins.black, bins.edges[-1] - bins.centres)
    hat = height / height.max()
    return WeightRule(np.where(hat > HAT_BRIM, (hat / HAT_DEVIATION) ** 2, 0))


def noise_rule(noise: NoiseModel, means: Float[np.ndarray, " bins"]) -> WeightRule:
    """Weights by the predicted exposure under a curve and a noise model.

    Args:
        noise: of the pixels.
        means: (bins,) of the curve, rising.

    Returns:
        The rule.
    """
    grid = np.linspace(means[0], means[-1], 4 * len(means))
    interval = np.interp(grid, means, interval_variance(means))
    variance = noise_variance(noise, grid) + interval
    reach = MARGIN * np.sqrt(variance)
    sharp = variance < LOOSEST**2
    lowest = grid[np.argmax(sharp)]
    inside = sharp & (grid - reach >= lowest) & (grid + reach <= grid[-1])
    share = 1 - interval / variance
    bias = interval * np.gradient(variance, grid) / variance**2 - share / 2
    weight, share, bias = (
        np.pad(np.where(inside, column, 0), 1) for column in (1 / variance, share, bias)
    )
    of_bins = noise_variance(noise, means) + interval_variance(means)
    by_bin = np.where(of_bins < LOOSEST**2, 1 / of_bins, 0)
    return WeightRule(by_bin, grid[0], grid[1] - grid[0], weight, share, bias)


def observe(
    binned: Int[np.ndarray, "exposures pixels"],
    log_t: Float[np.ndarray, " exposures"],
    means: Float[np.ndarray, " bins"],
    rule: WeightRule,
    *,
    screened: bool = True,
) -> Observations:
    """Weights and residuals of the linked among some pixels.

    Args:
        binned: (exposures, pixels) bins; -1 is unusable.
        log_t: (exposures,) log exposure times.
        means: (bins,) of the curve.
        rule: of the weights.
        screened: leave out pixels with a residual beyond five standard deviations, once a curve is
            known.

    Returns:
        The observations.
    """
    by_each = means[binned] - log_t[:, None]
    weights = np.where(binned >= 0, rule.by_bin[binned], 0)
    cells = np.zeros_like(binned)
    if rule.weight is not None:
        predicted = weighted_mean(weights, by_each) + log_t[:, None]
        cells = cells_of(rule, predicted)
        weights = np.where(weights > 0, rule.weight[cells], 0)
    linked = np.count_nonzero(weights, axis=0) >= 2
    weights, by_each = weights[:, linked], by_each[:, linked]
    log_irradiance = weighted_mean(weights, by_each)
    residuals = by_each - log_irradiance
    known = rule.weight is not None  # before a curve is known, residuals tell nothing
    steady = (weights * residuals**2 < (OUTLIER**2 if known and screened else np.inf)).all(axis=0)
    return Observations(
        binned=np.maximum(binned[:, linked][:, steady], 0),
        weights=weights[:, steady],
        cells=cells[:, linked][:, steady],
        residuals=residuals[:, steady],
        total=weights[:, steady].sum(axis=0),
        log_irradiance=log_irradiance[steady],
    )


def cells_of(
    rule: WeightRule, log_exposure: Float[np.ndarray, "*points"]
) -> Int[np.ndarray, "*points"]:
    """Cells of a rule's tables that hold given log exposures.

    Args:
        rule: with tables.
        log_exposure: any shape.

    Returns:
        Of the same shape.
    """
    assert rule.weight is not None
    position = (log_exposure - rule.start) / rule.step + 1.5
    return np.clip(position, 0, len(rule.weight) - 1).astype(np.int32)


def weighted_mean(
    weights: Float[np.ndarray, "exposures pixels"], values: Float[np.ndarray, "exposures pixels"]
) -> Float[np.ndarray, " pixels"]:
    """Mean over exposures.

    Args:
        weights: (exposures, pixels).
        values: (exposures, pixels).

    Returns:
        (pixels,); 0 where all weights are.
    """
    total = weights.sum(axis=0)
    return (weights * values).sum(axis=0) / np.where(total > 0, total, 1)


def pair_statistics(
    codes: Integer[np.ndarray, "exposures pixels"],
    log_t: Float[np.ndarray, " exposures"],
    bins: CodeBins,
    rule: WeightRule,
    means: Float[np.ndarray, " bins"],
) -> PairStatistics:
    """A and b from all pixels, a chunk at a time.

    Args:
        codes: (exposures, pixels) DN.
        log_t: (exposures,) log exposure times.
        bins: of codes.
        rule: of the weights.
        means: (bins,) of the curve at which the rule weighs.

    Returns:
        The statistics.
    """
    sums = _Sums(len(means), len(log_t))
    for start in range(0, codes.shape[1], CHUNK):
        binned = bins.lookup[codes[:, start : start + CHUNK]]
        seen = observe(binned, log_t, means, rule)
        _count_pairs(sums, seen)
        if rule.weight is not None:
            _count_score(sums, seen, rule)
    curve = (sums.curve + sums.curve.T) / 2
    score = np.concatenate([_pull_of_noise(sums.noisy, means) + sums.bias, sums.time_bias])
    # The noise model may be off in scale; the score is measured in the variance that is there.
    score *= sums.chi_square / max(int(sums.observations.sum()) - sums.pixels, 1)
    return PairStatistics(
        matrix=np.block([[curve, sums.mixed], [sums.mixed.T, sums.times]]),
        score=score,
        pixels=sums.pixels,
        observations=sums.observations,
        chi_square=sums.chi_square,
    )


class _Sums:
    def __init__(self, bins: int, exposures: int) -> None:
        self.curve = np.zeros((bins, bins))
        self.mixed = np.zeros((bins, exposures))
        self.times = np.zeros((exposures, exposures))
        self.noisy = np.zeros(bins)
        self.bias = np.zeros(bins)
        self.time_bias = np.zeros(exposures)
        self.observations = np.zeros(exposures, int)
        self.pixels = 0
        self.chi_square = 0.0


def _count_pairs(sums: _Sums, seen: Observations) -> None:
    bins, exposures = sums.mixed.shape
    sums.pixels += len(seen.total)
    sums.observations += np.count_nonzero(seen.weights, axis=1)
    sums.chi_square += float(np.sum(seen.weights * seen.residuals**2))
    shares = seen.weights / np.sqrt(seen.total)
    for j in range(exposures):
        own = np.bincount(seen.binned[j], seen.weights[j] - shares[j] ** 2, bins)
        sums.curve[np.diag_indices(bins)] += own
        sums.mixed[:, j] -= own
        sums.times[j, j] += own.sum()
        for k in range(j + 1, exposures):
            places = seen.binned[j] * bins + seen.binned[k]
            pairs = np.bincount(places, shares[j] * shares[k], bins**2).reshape(bins, bins)
            sums.curve -= 2 * pairs
            sums.mixed[:, k] += pairs.sum(axis=1)
            sums.mixed[:, j] += pairs.sum(axis=0)
            sums.times[[j, k], [k, j]] -= pairs.sum()


def _count_score(sums: _Sums, seen: Observations, rule: WeightRule) -> None:
    assert rule.share is not None
    assert rule.bias is not None
    used = seen.weights > 0
    leverage = seen.weights / seen.total
    noisy = np.where(used, rule.share[seen.cells] * (1 - leverage), 0)
    bias = np.where(used, rule.bias[seen.cells], 0)
    bias -= leverage * bias.sum(axis=0)
    sums.time_bias -= bias.sum(axis=1)
    places = seen.binned.ravel()
    sums.noisy += np.bincount(places, noisy.ravel(), len(sums.noisy))
    sums.bias += np.bincount(places, bias.ravel(), len(sums.bias))


def _pull_of_noise(noisy: np.ndarray, means: np.ndarray) -> np.ndarray:
    """sum (noise share) h' / g' as a vector over h, h' being taken between neighbouring bins that
    both hold observations."""
    below, above = noisy[:-1], noisy[1:]
    both = below + above
    between = 2 * below * above / np.where(both > 0, both, 1) / np.diff(means)
    return -np.diff(between, prepend=0, append=0)


def fit_noise(
    seen: Observations, log_t: Float[np.ndarray, " exposures"], means: Float[np.ndarray, " bins"]
) -> NoiseModel:
    """The three variances of the noise model.

    Squared residuals in cells of predicted log exposure, cut at three standard deviations of their
    cell, are fitted by non-negative least squares, the known variance of the intervals of codes
    subtracted.

    Args:
        seen: observations under a curve.
        log_t: (exposures,) log exposure times.
        means: (bins,) of the curve.

    Returns:
        The model.
    """
    used = seen.weights > 0
    predicted = (seen.log_irradiance + log_t[:, None])[used]
    free = (1 - seen.weights / seen.total)[used]
    edges = np.linspace(predicted.min(), predicted.max() + 1e-9, NOISE_CELLS + 1)
    cells = np.digitize(predicted, edges) - 1
    count = np.bincount(cells, free, NOISE_CELLS)
    filled = count > FEWEST_IN_CELL
    square = seen.residuals[used] ** 2 / np.maximum(free, 1e-3)
    limit = _cell_medians(cells, square)
    square = np.minimum(square, WINSOR * limit[cells])
    measured = np.bincount(cells, square * free, NOISE_CELLS)[filled] / count[filled]
    centre = ((edges[1:] + edges[:-1]) / 2)[filled]
    interval = np.interp(centre, means, interval_variance(means))
    terms = np.exp(-centre[:, None] * np.arange(3))
    # Relative errors count: a few cells full of misfit must not set the noise of all others.
    precision = np.sqrt(count[filled]) / np.maximum(measured, 1e-12)
    found, _ = nnls(terms * precision[:, None], (measured - interval) * precision)
    return NoiseModel(*(float(x) for x in found))


def _cell_medians(cells: np.ndarray, values: np.ndarray) -> np.ndarray:
    order = np.argsort(cells, kind="stable")
    parts = np.split(values[order], np.cumsum(np.bincount(cells, minlength=NOISE_CELLS))[:-1])
    return np.array([np.median(part) if len(part) else 0.0 for part in parts])
