"""Fit of a response curve: the log exposure of every code, from all pixels of an exposure stack.

Debevec & Malik (SIGGRAPH 1997) write g(z_ij) = ln E_i + s_j + noise for the code z of pixel i in
image j. Here g is the log exposure of a code, E_i is the irradiance, and s_j = ln t_j + delta_j is
the log exposure time. All pixels of image j share its shutter error delta_j ~ N(0, tau^2). With
weights w = 1 / variance, the irradiances are eliminated in closed form (`code_pairs.py`). The
remaining normal equations have one row for each bin of the curve and for each exposure, whatever
the number of pixels:

    A (g, s) = b, precision of the posterior = A / phi + prior, phi the design effect (`solve.py`).

With a score of b = 0, as in least squares, the curve would be too flat, because the codes are
noisy. Therefore the score b is set to the expected gradient at the true curve (the corrected score
of Nakamura, Biometrika 77, 1990).

The covariance of the posterior is enlarged for errors that this fit does not include:

- Shutter errors delta that are equal for all exposures, or proportional to ln t, cannot be
  distinguished from another curve, so the fit omits them. Errors proportional to ln t have the
  covariance g g^T tau^2 / sum (ln t - mean)^2, which is added, averaged over tau (`shutter.py`).
- The remaining bias of noisy logarithms is represented by an error of each code: 5 % of a pixel's
  variance of ln X.
- Misregistration and compression cause a variance of ln X that does not decrease with the light.
  This variance is not noise of single codes, so its effect on the score is unknown. Half of it is
  added as a relative error of the slope of the curve.

If parts of the picture with much detail and flat parts give different curves, the curve is
corrected to the curve of the flat parts (`flat_places.py`). If curves from different tiles of the
picture, or from different exposures of the stack, differ by more than the posterior explains, a
jackknife over tiles and exposures (`repeats.py`) gives the errors.

The module uses NumPy, because `np.bincount` counts code pairs 3 to 5 times faster than XLA's
scatter on a CPU, and no derivatives are needed. Codes are DN; exposures are relative, g = 0 at
mid-scale.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from jaxtyping import Float, Integer
from scipy.optimize import brentq
from scipy.special import chdtri, stdtrit
from threadpoolctl import threadpool_limits

from jaxvision.errors import InputError

from ..copies import Copies
from ..inference.formatting import format_percent
from .beyond import extrapolate
from .code_bins import MAX_BINS, CodeBins, code_bins, interval_variance
from .code_pairs import PairStatistics, statistics_of_parts, total
from .flat_places import correct_to_flat_places, is_registered
from .pilot import NO_CURVE, degrees_of_freedom, fit_pilot, make_rising, rebin
from .places import CLASSES, Layout, equal_classes, tiles_of
from .repeats import HeldOut, Repeats, exposure_jackknife, tile_jackknife, widen
from .shutter import MOST_FREE, UNINFORMATIVE, Shutter, tau_posterior
from .solve import (
    MOST_ROUNDS,
    SHAKIEST,
    STEADIEST,
    Solution,
    bin_centre_curve,
    solve,
    spread_of_times,
)
from .weights import (
    LARGEST_LOG_STEP,
    NoiseModel,
    cells_of,
    coarsest,
    hat_rule,
    noise_rule,
    noise_variance,
)

PILOT_PIXELS = 2048  # of a class of steepness: enough for its noise model and a first curve
PILOT_BINS = 140
FEWEST_PIXELS, FEWEST_SHARE = 100, 0.005  # needed, well exposed in two images; fewer may be hot
SIGNIFICANCE = 0.95  # of the chi-square test for a shutter error
REMAINING_BIAS = 0.05  # largest remaining bias of the score, as a share of the variance of ln X
LEAST_LOG_STEP = 1e-3  # step of ln t below which two exposures count as one
# Ripple of g, for each unit of ln t by which a step between exposures exceeds `LARGEST_LOG_STEP`
RIPPLE = 0.055
# Smoothness below which the ripple is not reduced: a third of the measured median
LEAST_SMOOTHNESS = 100.0
REFUSED_FALL = 0.5  # decrease in ln X from which a curve is refused
NEAR, BENT_BY = 4.0, 2.5  # pixel noises: distance from the last observed code; error of ln X there
SLOPE_ERROR = 0.5  # error of the slope from its correction, as a share of the relative variance


@dataclass(frozen=True)
class ResponseCurve:
    """A fitted response curve: the log exposure g of every code, with errors.

    Attributes:
        bins: of the codes.
        log_exposure: (bins,) g at the centres, 0 at mid-scale.
        covariance: (bins, bins) covariance of g at the centres.
        freedom: (bins,) degrees of freedom of the variances of g; a million where pixel noise
            determines these.
        seen: (bins,) true for bins with usable observations; the prior extrapolates to all other
            bins.
        bin_means: (bins,) mean of g over each bin.
        exposures: used exposures, s.
        shutter_offsets: (exposures,) delta_j, without the part that a change of the curve could
            absorb.
        shutter_offset_errors: (exposures,) their standard errors.
        shutter_error: tau; None where the data show no shutter errors.
        shutter_bound: upper limit of tau, 95 %.
        smoothness: precision of the smoothness prior.
        design_effect: phi, the number of pixels that contain as much information as one independent
            pixel.
        clustering: design effect of errors that neighbouring pixels share, before the limit on the
            effective number of pixels is applied.
        noise: noise model of the pixels, from the flattest places.
        statistics: sufficient statistics of the pairs of codes.
        held_out: prediction errors of each exposure from the others; None with fewer than three.
        busy_places: (bins,) change of `bin_means` if places with much detail were included; 0 if it
            is not significant.
    """

    bins: CodeBins
    log_exposure: Float[np.ndarray, " bins"]
    covariance: Float[np.ndarray, "bins bins"]
    freedom: Float[np.ndarray, " bins"]
    seen: np.ndarray
    bin_means: Float[np.ndarray, " bins"]
    exposures: Float[np.ndarray, " exposures"]
    shutter_offsets: Float[np.ndarray, " exposures"]
    shutter_offset_errors: Float[np.ndarray, " exposures"]
    shutter_error: float | None
    shutter_bound: float
    smoothness: float
    design_effect: float
    clustering: float
    noise: NoiseModel
    statistics: PairStatistics
    held_out: HeldOut | None
    busy_places: Float[np.ndarray, " bins"]

    @property
    def codes(self) -> Float[np.ndarray, " bins"]:
        return self.bins.centres

    @property
    def standard_error(self) -> Float[np.ndarray, " bins"]:
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def half_width(self) -> Float[np.ndarray, " bins"]:
        """Half the width of the 95 % band: a quantile of Student's t times the standard error."""
        return stdtrit(self.freedom, 0.975) * self.standard_error

    @property
    def pixel_noise(self) -> Float[np.ndarray, " bins"]:
        """Standard deviation of a single pixel's log exposure at each code, due to noise."""
        return np.sqrt(noise_variance(self.noise, self.log_exposure))

    @property
    def monotone(self) -> bool:
        """Whether g rises with the code, or falls by less than three standard errors."""
        g, covariance = self.log_exposure[self.seen], self.covariance[np.ix_(self.seen, self.seen)]
        step = np.diff(g)
        variance = np.diagonal(np.diff(np.diff(covariance, axis=0), axis=1))
        return bool((step > -3 * np.sqrt(np.maximum(variance, 0))).all())


def slope_error(noise: NoiseModel) -> float:
    """Return the relative error of a curve's slope due to variance of unknown cause."""
    return SLOPE_ERROR * noise.relative


def ripple(exposures: Float[np.ndarray, " exposures"], smoothness: float) -> float:
    """Return the deviation, in ln X, of a ripple between exposures that no image reveals."""
    # From the errors of simulated stacks with S-shaped and sRGB responses: .01 at 2 1/4 stops, .038
    # at three; smaller for a smoother curve, in proportion to the prior's 1 / sqrt(smoothness).
    steps = np.diff(np.unique(np.log(exposures)))
    steps = steps[steps > LEAST_LOG_STEP]
    if not steps.size:
        return 0.0
    return RIPPLE * max(float(steps.min()) - LARGEST_LOG_STEP, 0.0) * _room(smoothness)


def _room(smoothness: float) -> float:
    """Return a factor, 0 to 1, on the errors for a rough curve; it falls with smoothness."""
    return min(1.0, float(np.sqrt(LEAST_SMOOTHNESS / smoothness)))


def fit_response_curve(
    codes: Integer[np.ndarray, "exposures pixels"],
    exposures: Float[np.ndarray, " exposures"],
    *,
    bits: int,
    black: float = 0.0,
    clip: float | None = None,
    layout: Layout | None = None,
    least_error: float = STEADIEST,
    most_bins: int = MAX_BINS,
    rounds: int = MOST_ROUNDS,
    step: int = 1,
    origin: int = 0,
    black_sd: float = 0.0,
    dim: bool = False,
) -> ResponseCurve:
    """Fit the response curve of one channel.

    Args:
        codes: (exposures, pixels) DN.
        exposures: (exposures,) s, ascending, at least two different.
        bits: of the codes.
        black: DN without light.
        clip: DN from which a code is saturated; None for full scale.
        layout: positions of the pixels; None for pixels without neighbours, which count as
            independent.
        least_error: smallest assumed error of ln t by the shutter.
        most_bins: largest number of bins of codes.
        rounds: largest number of iterations. Each iteration solves for the curve, then updates
            smoothness and shutter error.
        step: DN between neighbouring codes.
        origin: DN of one code, less than a step.
        black_sd: standard deviation of the black level, DN; 0 where exact. A wrong black level
            bends a pure gamma.
        dim: whether to accept a stack in which too few pixels exceed mid-scale. For such a stack, g
            = 0 in the middle of the observed codes.

    Returns:
        The curve.

    Raises:
        InputError: when fewer than 100 pixels are neither black nor clipped in two exposures, when
            two exposures are equal, when the exposures fall into sets that share no such pixel, and
            when no rising curve fits.
    """
    copies = Copies()
    for i, seen in enumerate(codes):
        copies.add(f"exposure {i}", seen)
    for first, second, *_ in copies.equal_groups:
        raise InputError(
            f"{first} and {second} are equal at every pixel, so one is a copy of the other; give "
            "each exposure its own image."
        )
    clip = 2.0**bits - 1 if clip is None else clip
    bins, coarse = (
        code_bins(bits, black, clip, count=count, step=step, origin=origin, black_sd=black_sd)
        for count in (most_bins, PILOT_BINS)
    )
    linked, bright = _well_exposed(codes, bins)
    reached = (linked & bright).sum() >= max(FEWEST_PIXELS, FEWEST_SHARE * codes.shape[1])
    if reached or not dim:
        linked &= bright
    elif linked.any():  # mid-scale is not observed: g = 0 in the middle of the observed codes
        anchor = float(np.median(codes[:, linked][bins.lookup[codes[:, linked]] >= 0]))
        bins, coarse = replace(bins, anchor=anchor), replace(coarse, anchor=anchor)
    if linked.sum() < max(FEWEST_PIXELS, FEWEST_SHARE * codes.shape[1]):
        reach = "" if dim else " and beyond mid-scale in one"
        raise InputError(
            f"too few pixels ({linked.sum()}) are well exposed in two images{reach}; add exposures "
            "between the present ones, or longer or shorter ones."
        )
    classes = np.zeros(codes.shape[1], np.int32)
    if layout is not None:
        classes = equal_classes(layout.steepness, linked)
    sample = _sample(classes, linked)
    in_use = _exposures_in_use(codes[:, sample], bins)
    codes, log_t = codes[in_use], np.log(exposures[in_use])
    with threadpool_limits(1, user_api="blas"):  # systems are too small for threads
        few, of_few = codes[:, sample], classes[sample]
        pilot = fit_pilot(few, of_few, log_t, coarse, least_error=least_error)
        means = make_rising(rebin(pilot.means, coarse, bins), bins)
        offset_t = log_t + pilot.solution.delta
        rule = noise_rule(pilot.noises, means, coarsest=coarsest(log_t))
        parts, activity = _parts(codes, bins, layout, linked)
        of_parts = statistics_of_parts(codes, classes, parts, offset_t, bins, rule, means)
        cells = [of_parts[i : i + CLASSES] for i in range(0, len(of_parts), CLASSES)]
        tiles = [total(tile) for tile in cells]
        pairs = total(tiles)
        degrees_of_freedom(pairs)
        if pairs.pixels < max(FEWEST_PIXELS, FEWEST_SHARE * linked.sum()):
            raise InputError(NO_CURVE)  # the pilot explained the images as noise
        start = pilot.solution.suggested
        whole = solve(tiles, log_t, bins, start, least_error=least_error, rounds=rounds)
        rounding = float(interval_variance(whole.means)[bins.middle])
        flat = is_registered(pilot.noises, rounding)
        found = correct_to_flat_places(whole, cells, activity, log_t, bins) if flat else whole
        fraction = min(1.0, len(sample) / max(int(linked.sum()), 1))
        left_out = exposure_jackknife(few, of_few, log_t, coarse, pilot, found.used, bins, fraction)
        tau = _shutter_error(found)
        if tau is not None and tau >= max(SHAKIEST, 2 * least_error):
            raise InputError(
                f"the images contradict their exposure times by {format_percent(SHAKIEST)} or "
                "more; check the times and the black level."
            )
        noise = next(noise for noise in pilot.noises if noise is not None)
        cells = cells_of(rule, found.means, np.zeros(len(found.means), int))
        assert rule.weight is not None
        # The other bins contain only pixels scattered in by noise.
        seen = np.any(rule.weight[:, cells] > 0, axis=0)
        times = exposures[in_use]
        curve = _curve(found, whole, pairs, bins, noise, times, tau, left_out, seen, least_error)
    _require_rising(curve)
    return curve


def _require_rising(curve: ResponseCurve) -> None:
    """Refuse a curve that decreases strongly, as at a wrong optimum."""
    g, codes = curve.log_exposure[curve.seen], curve.codes[curve.seen]
    falls = np.maximum.accumulate(g) - g
    if falls.size and falls.max() > REFUSED_FALL:
        at = int(np.argmax(falls))
        raise InputError(
            f"from code {codes[np.argmax(g[: at + 1])]:g} to {codes[at]:g} the exposure falls "
            f"by {falls[at]:.1f} in ln X: exposures far apart do not determine the curve, and "
            "moving or misaligned images contradict it; add exposures a stop from these, or align "
            "them."
        )


def _sample(classes: np.ndarray, linked: np.ndarray) -> np.ndarray:
    """Select pixels of the pilot fit among `linked` ones, evenly over the classes."""
    picked = []
    for kind in range(int(classes.max()) + 1):
        own = np.flatnonzero(linked & (classes == kind))
        picked.append(own[:: max(1, len(own) // PILOT_PIXELS)])
    return np.concatenate(picked)


def _parts(
    codes: np.ndarray, bins: CodeBins, layout: Layout | None, linked: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return usable pixels by tile and class of activity, and each class's activity."""
    usable = np.flatnonzero(np.count_nonzero(bins.lookup[codes] >= 0, axis=0) >= 2)
    if layout is None:
        return [usable], np.zeros(1)
    kinds = equal_classes(layout.activity, linked)
    tiles = [usable[tile] for tile in tiles_of(layout.rows[usable], layout.columns[usable])]
    of_kinds = [layout.activity[linked & (kinds == kind)] for kind in range(CLASSES)]
    medians = np.array([np.median(own) if len(own) else 0.0 for own in of_kinds])
    return [tile[kinds[tile] == kind] for tile in tiles for kind in range(CLASSES)], medians


def _well_exposed(codes: np.ndarray, bins: CodeBins) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels well exposed in two images, and those beyond mid-scale in one."""
    usable = np.where(bins.lookup >= 0, hat_rule(bins).by_bin[0][bins.lookup], 0) > 0
    bright = usable & (np.arange(len(usable)) > bins.centres[bins.middle])
    return usable[codes].sum(axis=0) >= 2, bright[codes].any(axis=0)


def _exposures_in_use(codes: np.ndarray, bins: CodeBins) -> np.ndarray:
    """Return exposures with well exposed pixels in common; refuse separate sets."""
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


def _shutter_error(found: Solution) -> float | None:
    """Estimate tau from the images alone (Paule & Mandel 1982); None if noise explains all."""
    if not len(found.free):
        return None
    pull, information = _image_information(found)
    known, axes = np.linalg.eigh(information)
    informed = known > UNINFORMATIVE * known.max()
    known, square = known[informed], ((pull @ axes)[informed] / known[informed]) ** 2

    def chi_square_excess(tau: float) -> float:
        return float(np.sum(square / (1 / known + tau**2))) - len(known)

    if chi_square_excess(0.0) <= chdtri(len(known), 1 - SIGNIFICANCE) - len(known):
        return None
    return cast(float, brentq(chi_square_excess, 0.0, np.sqrt(square.sum())))


def _image_information(found: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return score and information about visible shutter errors, without their prior."""
    precision, size = np.linalg.inv(found.free_covariance), len(found.means)
    information = precision - found.prior[size:, size:]
    return precision @ found.free, information


def _end_errors(
    density: np.ndarray, g: np.ndarray, noise: np.ndarray, seen: np.ndarray
) -> Float[np.ndarray, "2 bins"]:
    """Return the error of g that a rough curve may have near the first and the last observed code,
    and at codes beyond them. The error is above 0 at an end of the observed codes where the density
    of pixels over ln X is less than half of that further inside. Most codes at such an end belong
    to pixels that noise moved to these codes, which bends the curve."""
    bent = np.zeros((2, len(g)))
    places = np.flatnonzero(seen)
    for row, end in zip(bent, places[[0, -1]] if len(places) else (), strict=False):
        if noise[end] == 0:
            continue
        off = np.abs(g - g[end]) / noise[end]
        further = seen & (off >= NEAR) & (off < 2 * NEAR)
        if further.any() and density[end] < np.median(density[further]) / 2:
            outward = np.arange(len(g)) <= end if end == places[0] else np.arange(len(g)) >= end
            row[outward | (seen & (off < NEAR))] = BENT_BY * noise[end]
    return bent


def _curve(
    found: Solution,
    whole: Solution,
    statistics: PairStatistics,
    bins: CodeBins,
    noise: NoiseModel,
    exposures: np.ndarray,
    tau: float | None,
    left_out: tuple[Repeats | None, HeldOut | None],
    expected: np.ndarray,
    least_error: float,
) -> ResponseCurve:
    size = len(found.means)
    g = bin_centre_curve(found.means, bins)
    covariance = bin_centre_curve(found.covariance[:size, :size], bins)
    covariance = bin_centre_curve(covariance.T, bins).T
    hidden = ripple(exposures, found.used.smoothness)
    covariance += np.diag(((REMAINING_BIAS * noise_variance(noise, g)) ** 2 + hidden**2) * (g != 0))
    covariance += np.outer(g, g) * slope_error(noise) ** 2
    free = len(found.free)
    likely = found.suggested.shutter_error if free else 0.0
    tau_k, weights = tau_posterior(*_image_information(found), least_error)
    shutter = Shutter(g**2 / spread_of_times(exposures), likely, tau_k, weights)
    by_exposures, held_out = left_out
    covariance, freedom = widen(covariance, shutter, tile_jackknife(whole, bins), by_exposures)
    spread = found.basis @ found.free_covariance @ found.basis.T
    seen = (np.diagonal(statistics.matrix)[:size] > 0) & expected
    own = np.sqrt(noise_variance(noise, g))
    density = np.diagonal(statistics.matrix)[:size] * own**2 / np.gradient(g)
    bent = _end_errors(density, g, own, seen)
    observed = np.diagonal(covariance)
    g, covariance = extrapolate(bins, g, covariance, seen & ~np.any(bent, axis=0))
    bent *= _room(found.used.smoothness)
    covariance += bent.T @ bent
    # Satterthwaite's: the variance of an extrapolation is known, unlike that of the shutter
    whole_variance = np.diagonal(covariance)
    uncertain = np.minimum(observed, whole_variance)
    grown = whole_variance / np.where(uncertain > 0, uncertain, 1)
    freedom = np.minimum(freedom * np.maximum(grown, 1) ** 2, MOST_FREE)
    return ResponseCurve(
        bins=bins,
        log_exposure=g,
        covariance=covariance,
        freedom=freedom,
        seen=seen,
        bin_means=found.means,
        exposures=exposures,
        shutter_offsets=found.delta,
        shutter_offset_errors=np.sqrt(np.maximum(np.diagonal(spread), 0)),
        shutter_error=tau,
        shutter_bound=likely * np.sqrt(free / chdtri(free, SIGNIFICANCE)) if free else np.inf,
        smoothness=found.used.smoothness,
        design_effect=found.used.design_effect,
        clustering=whole.clustering,
        noise=noise,
        statistics=statistics,
        held_out=held_out,
        busy_places=whole.means - found.means,
    )
