"""The whole response curve: log exposure of every code, from all pixels of an exposure stack.

Debevec & Malik (SIGGRAPH 1997) write  g(z_ij) = ln E_i + s_j + noise  for the code z of pixel i in
image j. The shutter has an error of its own, s_j = ln t_j + delta_j, delta_j ~ N(0, tau^2), shared
by all pixels of an image. With weights w = 1 / variance the irradiances drop out in closed form
(`code_pairs.py`), leaving normal equations of the size of the curve, whatever the number of pixels:

    A (g, s) = b,    precision of the posterior = A + prior.

A pure least-squares fit would shrink the curve, because g multiplies noisy codes; the score b is
what its gradient amounts to at the true curve (the corrected score of Nakamura, Biometrika 77,
1990). Errors of all shutters in common, delta ~ 1 or delta ~ ln t, are indistinguishable from
another curve: they are left out of the fit, and the second one's variance, g g^T tau^2 /
sum (ln t - mean)^2, is added to the posterior. So is, code by code, an error as large as the terms
of second order that logarithms of noisy codes leave out, the variance of ln X itself.

Prior: the local exponent dg / d ln(z - black) is a random walk in the clock of `roughness`, in
which the 201 measured curves of Grossberg & Nayar (2003) are about equally rough all along; a pure
gamma is free of cost. Its strength and tau maximise the marginal likelihood (MacKay's fixed point,
Neural Computation 4, 1992).

NumPy throughout: counting code pairs is 3 to 5 times faster in `np.bincount` than in XLA's scatter
on a CPU, and nothing here is differentiated. Codes are DN; exposures are relative, g = 0 at
mid-scale.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from jaxvision.errors import InputError

from .code_pairs import (
    CodeBins,
    NoiseModel,
    PairStatistics,
    code_bins,
    fit_noise,
    hat_rule,
    noise_rule,
    noise_variance,
    observe,
    pair_statistics,
)

PILOT_PIXELS = 4096  # enough for the noise model and a first curve
PILOT_BINS = 140
PILOT_PASSES = 4
FEWEST_PIXELS, FEWEST_SHARE = 100, 0.02  # well exposed twice: fewer may all be hot pixels
KEPT = 0.3  # share of the pilot's pixels that a noise model must leave
SMOOTHEST = 1e4  # precision beyond which the exponent is constant for every purpose
FIRST_SMOOTHNESS = 300.0  # the median of the 201 measured curves
ROUGHEST = 30.0  # a tenth of it: what is rougher is misfit
STEADIEST, SHAKIEST = 1e-6, 0.2  # shutter errors between no and no usable time
SIGNIFICANCE = 0.95  # of the chi-square test for a shutter error


@dataclass(frozen=True)
class ResponseCurve:
    """g and its Gaussian posterior, for given smoothness and shutter error.

    Attributes:
        bins: intervals of codes.
        log_exposure: (bins,) g at the centres, 0 at mid-scale.
        covariance: (bins, bins) of g.
        seen: (bins,), which hold usable observations; the prior extrapolates to the others.
        bin_means: (bins,) mean of g over each bin.
        exposures: those in use, s.
        shutter_offsets: (exposures,) delta_j, beyond what any curve absorbs.
        shutter_offset_errors: (exposures,) their standard errors.
        shutter_error: tau; None where the data show none.
        smoothness: precision of the prior.
        noise: of the pixels.
        statistics: of the pairs of codes, all that the pixels say.
    """

    bins: CodeBins
    log_exposure: Float[np.ndarray, " bins"]
    covariance: Float[np.ndarray, "bins bins"]
    seen: np.ndarray
    bin_means: Float[np.ndarray, " bins"]
    exposures: Float[np.ndarray, " exposures"]
    shutter_offsets: Float[np.ndarray, " exposures"]
    shutter_offset_errors: Float[np.ndarray, " exposures"]
    shutter_error: float | None
    smoothness: float
    noise: NoiseModel
    statistics: PairStatistics

    @property
    def codes(self) -> Float[np.ndarray, " bins"]:
        return self.bins.centres

    @property
    def standard_error(self) -> Float[np.ndarray, " bins"]:
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def pixel_noise(self) -> Float[np.ndarray, " bins"]:
        """Standard deviation of one pixel's log exposure at each code."""
        return np.sqrt(noise_variance(self.noise, self.log_exposure))

    @property
    def monotone(self) -> bool:
        """Whether g rises over the codes that were seen, three standard errors aside."""
        g, covariance = self.log_exposure[self.seen], self.covariance[np.ix_(self.seen, self.seen)]
        step = np.diff(g)
        variance = np.diagonal(np.diff(np.diff(covariance, axis=0), axis=1))
        return bool((step > -3 * np.sqrt(np.maximum(variance, 0))).all())


def fit_response_curve(
    codes: Integer[np.ndarray, "exposures pixels"],
    exposures: Float[np.ndarray, " exposures"],
    *,
    bits: int,
    black: float = 0.0,
    clip: float | None = None,
) -> ResponseCurve:
    """The response curve of one channel.

    Args:
        codes: (exposures, pixels) DN.
        exposures: (exposures,) s, ascending, at least two different.
        bits: of the codes.
        black: DN without light.
        clip: DN from which a code is saturated; None for full scale.

    Returns:
        The curve.

    Raises:
        InputError: when fewer than 100 pixels are neither black nor clipped in two exposures, or
            when the exposures fall into sets that share no such pixel.
    """
    clip = 2.0**bits - 1 if clip is None else clip
    bins = code_bins(bits, black, clip)
    linked = _well_exposed(codes, bins)
    if len(linked) < max(FEWEST_PIXELS, FEWEST_SHARE * codes.shape[1]):
        raise InputError(
            f"only {len(linked)} pixels are well exposed in two images and beyond mid-scale "
            "in one; add exposures between the present ones, or longer or shorter ones."
        )
    pilot = codes[:, linked[:: max(1, len(linked) // PILOT_PIXELS)]]
    in_use = _exposures_in_use(pilot, bins)
    codes, pilot, log_t = codes[in_use], pilot[in_use], np.log(exposures[in_use])
    with threadpool_limits(1, user_api="blas"):  # threads cost more than systems this small
        means, noise, start = _pilot(
            pilot, log_t, bins, code_bins(bits, black, clip, count=PILOT_BINS)
        )
    offset_t = log_t + start.delta
    statistics = pair_statistics(codes, offset_t, bins, noise_rule(noise, means), means)
    if statistics.pixels < KEPT * len(linked):
        raise InputError(
            "the images agree on no response curve; check the exposure times, the black level, and "
            "that neither scene nor camera moved."
        )
    with threadpool_limits(1, user_api="blas"):
        found = _solve(statistics, log_t, bins, start.smoothness, start.shutter_error, rounds=3)
    tau = _shutter_error(found, log_t)
    if tau is not None and tau >= SHAKIEST:
        raise InputError(
            f"the images contradict their exposure times by {SHAKIEST:.0%} or more; check the "
            "times and the black level."
        )
    return _curve(found, statistics, bins, noise, exposures[in_use], tau)


def roughness(bins: CodeBins) -> Float[np.ndarray, "bins bins"]:
    """R of the prior energy smoothness g^T R g.

    It sums squared increments of the local exponent dg / d ln(z - black), per tick of a clock that
    runs as dz / z + sqrt(F) dz / (F - z)^1.5, F being full scale (z counted from black).

    Args:
        bins: of codes.

    Returns:
        (bins, bins).
    """
    z = bins.centres - bins.black
    full = bins.edges[-1] - bins.black + 0.5
    step = 1 / np.diff(np.log(z))
    clock = (z[2:] - z[:-2]) / 2 * (1 / z[1:-1] + np.sqrt(full) / (full - z[1:-1]) ** 1.5)
    increments = np.stack([step[:-1], -step[:-1] - step[1:], step[1:]]) / np.sqrt(clock)
    energy = np.zeros((len(z), len(z)))
    rows = np.arange(len(z) - 2)
    for p in range(3):
        for q in range(3):
            energy[rows + p, rows + q] += increments[p] * increments[q]
    return energy


def shutter_basis(log_t: Float[np.ndarray, " exposures"]) -> Float[np.ndarray, "exposures free"]:
    """Orthonormal basis of the shutter errors that the data can show: those orthogonal to a common
    factor and to a common exponent.

    Args:
        log_t: (exposures,) log exposure times.

    Returns:
        (exposures, exposures - 2).
    """
    absorbed = np.stack([np.ones_like(log_t), log_t], axis=1)
    return np.linalg.svd(absorbed)[0][:, 2:]


@dataclass(frozen=True)
class _Solution:
    """Posterior of (bin means of g, free shutter errors) and the hyperparameters it suggests."""

    means: np.ndarray
    covariance: np.ndarray
    free: np.ndarray
    free_covariance: np.ndarray
    delta: np.ndarray
    delta_errors: np.ndarray
    used_shutter_error: float
    smoothness: float
    shutter_error: float


def _solve(
    statistics: PairStatistics,
    log_t: np.ndarray,
    bins: CodeBins,
    smoothness: float,
    shutter_error: float,
    *,
    rounds: int,
) -> _Solution:
    """MacKay's fixed point: each hyperparameter becomes (well determined parameters) / (energy)."""
    prior, basis = roughness(bins), shutter_basis(log_t)
    size, free = len(prior), basis.shape[1]
    curve, errors = slice(0, size), slice(size, None)
    mixed = statistics.matrix[curve, errors]
    times = statistics.matrix[errors, errors]
    matrix = np.block(
        [
            [statistics.matrix[curve, curve], mixed @ basis],
            [basis.T @ mixed.T, basis.T @ times @ basis],
        ]
    )
    score = statistics.score
    right = np.concatenate(
        [score[curve] - mixed @ log_t, basis.T @ (score[errors] - times @ log_t)]
    )
    middle = _mid_scale(bins)
    matrix[middle, middle] += matrix.trace() / size  # g = 0 at mid-scale
    while True:
        normal = matrix.copy()
        normal[curve, curve] += smoothness * prior
        normal[errors, errors] += np.eye(free) / shutter_error**2
        try:
            covariance = cho_solve(cho_factor(normal, lower=True), np.eye(size + free))
        except np.linalg.LinAlgError as error:
            raise InputError(
                "the images determine no curve; check that each is an exposure of its own, as "
                "different from the others as its time."
            ) from error
        mean = covariance @ right
        g, d = mean[curve], mean[errors]
        determined = max(size - 2 - smoothness * np.sum(prior * covariance[curve, curve]), 1.0)
        known = max(free - covariance[errors, errors].trace() / shutter_error**2, 1e-3)
        used = shutter_error
        smoothness = max(determined / (g @ prior @ g + determined / SMOOTHEST), ROUGHEST)
        shutter_error = float(np.clip(np.sqrt(d @ d / known), STEADIEST, SHAKIEST))
        rounds -= 1
        if rounds == 0:
            break
    spread = basis @ covariance[errors, errors] @ basis.T
    return _Solution(
        means=g,
        covariance=covariance[curve, curve],
        free=d,
        free_covariance=covariance[errors, errors],
        delta=basis @ d,
        delta_errors=np.sqrt(np.maximum(np.diagonal(spread), 0)),
        used_shutter_error=used,
        smoothness=smoothness,
        shutter_error=shutter_error,
    )


def _mid_scale(bins: CodeBins) -> int:
    return int(np.searchsorted(bins.centres, (bins.black + bins.edges[-1]) / 2))


def _pilot(
    codes: np.ndarray, log_t: np.ndarray, bins: CodeBins, coarse: CodeBins
) -> tuple[np.ndarray, NoiseModel, _Solution]:
    """Bin means of a first curve, the noise model, and hyperparameters, from few pixels and bins;
    the first pass, which knows no curve yet, weights as Debevec & Malik do."""
    x = np.log(coarse.centres - coarse.black)
    means = x - x[_mid_scale(coarse)]
    rule, noise = hat_rule(coarse), None
    found, smoothness, tau, offset_t = None, FIRST_SMOOTHNESS, STEADIEST, log_t
    for turn in range(PILOT_PASSES):
        statistics = pair_statistics(codes, offset_t, coarse, rule, means)
        if found is not None and statistics.pixels < KEPT * codes.shape[1]:
            break  # the noise model has run away: what the last pass found stands
        found = _solve(statistics, log_t, coarse, smoothness, tau, rounds=1)
        means = _rising(found.means, coarse)
        offset_t = log_t + found.delta
        smoothness, tau = (found.smoothness, found.shutter_error) if turn else (smoothness, 0.01)
        seen = observe(coarse.lookup[codes], offset_t, means, rule, screened=False)
        if len(seen.total) < KEPT * codes.shape[1]:
            break
        noise = fit_noise(seen, offset_t, means)
        rule = noise_rule(noise, means)
    assert found is not None
    assert noise is not None
    fine = CubicSpline(x, means)(np.log(bins.centres - bins.black))
    return _rising(fine, bins), noise, found


def _rising(means: np.ndarray, bins: CodeBins) -> np.ndarray:
    """Bin means made rising, at least a third as fast as a linear response would."""
    floor = np.log(bins.centres - bins.black) / 3
    return np.maximum.accumulate(means - floor) + floor


def _well_exposed(codes: np.ndarray, bins: CodeBins) -> np.ndarray:
    """Pixels neither dark nor clipped in two images, and beyond mid-scale in one of them."""
    usable = np.where(bins.lookup >= 0, hat_rule(bins).by_bin[bins.lookup], 0) > 0
    bright = usable & (np.arange(len(usable)) > bins.centres[_mid_scale(bins)])
    return np.flatnonzero((usable[codes].sum(axis=0) >= 2) & bright[codes].any(axis=0))


def _exposures_in_use(codes: np.ndarray, bins: CodeBins) -> np.ndarray:
    """Exposures that share enough pixels with another; they must hang together."""
    usable = (bins.lookup[codes] >= 0).astype(int)
    shared = usable @ usable.T
    np.fill_diagonal(shared, 0)
    linked = shared >= min(10, FEWEST_PIXELS // 10)
    in_use = np.flatnonzero(linked.any(axis=1))
    if len(in_use) < 2:
        raise InputError("no two exposures share unclipped pixels; add exposures between them.")
    reached = np.linalg.matrix_power(linked[np.ix_(in_use, in_use)] + np.eye(len(in_use)), 32)[0]
    if not (reached > 0).all():
        raise InputError(
            "the exposures fall into sets that share no unclipped pixel; add exposures in between."
        )
    return in_use


def _shutter_error(found: _Solution, log_t: np.ndarray) -> float | None:
    """tau, or None where the errors are within what the pixels' noise explains."""
    free = len(found.free)
    if free == 0:
        return None
    precision = np.linalg.inv(found.free_covariance)
    from_data = precision - np.eye(free) / found.used_shutter_error**2
    pull = precision @ found.free
    explained = pull @ np.linalg.solve(from_data, pull)
    return found.shutter_error if explained > chi2.ppf(SIGNIFICANCE, free) else None


def _curve(
    found: _Solution,
    statistics: PairStatistics,
    bins: CodeBins,
    noise: NoiseModel,
    exposures: np.ndarray,
    tau: float | None,
) -> ResponseCurve:
    middle = _mid_scale(bins)
    g = _at_centres(found.means, middle)
    covariance = _at_centres(_at_centres(found.covariance, middle).T, middle).T
    unmodelled = noise_variance(noise, g)
    covariance = covariance + np.diag(unmodelled**2)
    if tau is not None:
        covariance = covariance + np.outer(g, g) * tau**2 / spread_of_times(exposures)
    return ResponseCurve(
        bins=bins,
        log_exposure=g,
        covariance=covariance,
        seen=np.diagonal(statistics.matrix)[: len(g)] > 0,
        bin_means=found.means,
        exposures=exposures,
        shutter_offsets=found.delta,
        shutter_offset_errors=found.delta_errors,
        shutter_error=tau,
        smoothness=found.smoothness,
        noise=noise,
        statistics=statistics,
    )


def _at_centres(means: np.ndarray, middle: int) -> np.ndarray:
    """g at the centres of bins, 0 at mid-scale, from its means over them (first axis): light being
    log-uniform across a bin, the mean is that of the two ends, an eighth of the second difference
    above the centre."""
    g = means.copy()
    g[1:-1] -= np.diff(means, n=2, axis=0) / 8
    return g - g[middle]


def spread_of_times(exposures: Float[np.ndarray, " exposures"]) -> float:
    """sum (ln t - mean)^2: what a common exponent is measured by."""
    log_t = np.log(exposures)
    return float(np.sum((log_t - log_t.mean()) ** 2))
