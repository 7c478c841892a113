"""Which readings follow the matte model: a robust choice for each pixel."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Int
from scipy.special import ndtri, stdtrit

from ...inference.formatting import format_percent
from .lights import (
    NORMAL_MAD,
    Counted,
    Matrices,
    OfPixels,
    Readings,
    Rows,
    Vectors,
    predicted,
    solved,
    take_pixels,
)
from .misfit import shared_squares

ROUNDS = 30  # reweightings toward the least sum of absolute residuals
FAR = 2.5  # standard deviations at which a reading is left out (Rousseeuw & Leroy, 1987)
CHANCE = 0.01  # probability that a pixel without wrong readings leaves one out
RETURNS = 5  # rounds that accept excluded readings again, by the scatter of the accepted ones
CLEAR = 3.0  # standard deviations of a reading between its prediction and a limit
PASSES = 8  # at most, of a fit and the readings that it predicts between the limits
APART = 8.0  # ratio to the median image's median residual from which an image deviates
AGREE, TRIPLES = 5, 250  # least readings that agree; most triples of lights that are tried
FEWEST = 30  # fewest pixels to judge an image
HALF_NORMAL = 0.8318  # interquartile range of |x| if x is a Gaussian of unit variance
SHARED = 0.5  # share of residuals' squares to be reported
RIVAL = 6  # least readings of a second set that agrees on another normal
NOISY = 0.01  # of the readings: residuals from which wrong readings in most pixels are looked for
VOTERS, LUCKY = 200, 0.1  # pixels that estimate their noise; share with enough right readings
SCATTERED = 0.25  # of the readings: residuals from which readings hardly show the normal
SPOILED = 2.0  # ratio of residuals to noise from which most pixels have wrong readings
# lowest, highest, standard deviation of readings without light, and of all readings where most
# pixels have wrong ones (infinite where they do not)
Limits = tuple[float, float, float, float]


def least_squares(
    rows: Rows, readings: Readings, near: Counted
) -> tuple[Vectors, Matrices, OfPixels, Int[np.ndarray, " pixels"]]:
    """Return g, its covariance for readings of variance 1, the variance of a reading about its
    prediction (NaN without residuals), and the number of used readings."""
    g, inverse = solved(rows, readings, near.astype(float))
    used = near.sum(axis=0)
    residuals = np.where(near, readings - predicted(rows, g), 0)
    scatter = (residuals**2).sum(axis=0) / np.where(used > 3, used - 3, np.nan)
    return g, inverse, scatter, used


def within_limits(rows: Rows, g: Vectors, scatter: OfPixels, limits: Limits) -> Counted:
    """Return a mask of the readings that a fit predicts to lie between both limits with a margin of
    several standard deviations."""
    expected, margin = predicted(rows, g), CLEAR * np.sqrt(np.nan_to_num(scatter))
    return (expected - margin > limits[0]) & (expected + margin < limits[1])


def used_readings(
    rows: Rows, readings: Readings, between: Counted, limits: Limits, *, robust: bool
) -> Counted:
    """Return a mask of the readings that the fit uses. A reading is used if the fit predicts it
    between the limits and the other readings do not contradict it. Readings within the noise of the
    lower limit are not used, because readings in attached shadow do not follow the model. A margin
    beyond this noise that would leave fewer than three lights is not applied.
    """

    near = consistent(rows, readings, between, limits[3]) if robust else between.copy()
    moving = np.arange(readings.shape[1])
    for _ in range(PASSES):
        own, own_near, own_between = readings[:, moving], near[:, moving], between[:, moving]
        own_rows = take_pixels(rows, moving)
        g, _ = solved(own_rows, own, own_near.astype(float))
        lit = ~(predicted(own_rows, g) <= limits[0] + CLEAR * limits[2])
        chosen = own_near & lit
        for spread in (0 * own[0], _usual_residual(own_rows, own, own_near, g)):
            narrower = own_between & lit & within_limits(own_rows, g, spread**2, limits)
            known = np.isfinite(solved(own_rows, own, narrower.astype(float))[1][:, 0, 0])
            chosen = np.where(known, narrower, chosen)
        if robust:
            chosen = consistent(own_rows, own, chosen, limits[3])
        changed = (chosen != own_near).any(axis=0)
        near[:, moving] = chosen
        moving = moving[changed]
        if not moving.size:
            break
    return near


def dark_noise(rows: Rows, readings: Readings, near: Counted) -> float:
    """Return the standard deviation of readings without light. It is estimated from the quartiles
    of the readings below 0 or, without such readings, as in clipped images, from the residuals of
    the dimmer half of the pixels. The lower quartile of these residuals is used, because attached
    shadows and clipped readings enlarge many of them.
    """
    below = -readings[readings < 0]
    if below.size >= FEWEST:
        return float(np.subtract(*np.quantile(below, [0.75, 0.25]))) / HALF_NORMAL
    g, _ = solved(rows, readings, near.astype(float))
    largest = np.where(near, readings, 0).max(axis=0)
    known = (near.sum(axis=0) > 3) & np.isfinite(g[:, 0])
    if known.sum() < FEWEST:
        return 0.0
    dim = known & (largest <= np.median(largest[known]))
    return float(np.quantile(_usual_residual(rows, readings, near, g)[dim], 0.25))


def _usual_residual(rows: Rows, readings: Readings, near: Counted, g: Vectors) -> OfPixels:
    """Return the standard deviation of a reading about its prediction, from the median residual,
    which shadowed readings do not increase; 0 without residuals.
    """
    used = near.sum(axis=0)
    ordered = np.sort(np.where(near, np.abs(readings - predicted(rows, g)), np.inf), axis=0)
    middle = np.take_along_axis(ordered, np.maximum(used - 1, 0)[None] // 2, axis=0)[0]
    middle = np.where((used > 3) & np.isfinite(middle), middle, 0)
    return NORMAL_MAD * middle * np.sqrt(used / np.maximum(used - 3, 1))


def consistent(rows: Rows, readings: Readings, counts: Counted, noise: float) -> Counted:
    """Return the readings near the fit of least absolute residuals, if there are at least five.
    The usual residual is at most `noise`."""
    used = counts.sum(axis=0)
    residuals, scale, least = _least_absolute(rows, readings, counts)
    near = counts & ~(residuals > FAR * np.maximum(scale, least))
    near = np.where((used >= 5) & (near.sum(axis=0) >= 4), near, counts)
    usual = float(np.median(scale[used >= AGREE])) if (used >= AGREE).any() else 0.0
    usual = min(usual, noise)
    wild = (used > AGREE) & (np.where(near, residuals, 0).max(axis=0) > APART * max(usual, 1e-300))
    wild |= (used > AGREE) & ((counts & ~near).sum(axis=0) > 1)
    if wild.any() and usual > 0:
        some = np.flatnonzero(wild)
        own_rows, own_readings = take_pixels(rows, some), readings[:, some]
        own = _agreeing(own_rows, own_readings, counts[:, some], FAR * usual)
        better = own.sum(axis=0) > np.maximum(
            (near & (residuals < FAR * usual))[:, some].sum(axis=0), AGREE - 1
        )
        near[:, some] = np.where(better, own, near[:, some])
    for _ in range(RETURNS):
        back = _explained_readings(rows, readings, counts & ~near, near)
        if not back.any():
            break
        near |= back
    return near


def _least_absolute(
    rows: Rows, readings: Readings, counts: Counted
) -> tuple[Readings, OfPixels, OfPixels]:
    """Fit each pixel by least absolute residuals. Return the absolute residuals, a standard
    deviation derived from their median, and the smallest residual that rounding allows."""
    weights = counts.astype(float)
    size = np.abs(np.where(counts, readings, 0)).max(axis=0)
    least = np.where(size > 0, 1e-6 * size, 1.0)
    residuals = np.zeros_like(readings)
    for _ in range(ROUNDS):
        g, _ = solved(rows, readings, weights)
        residuals = np.where(counts, np.abs(readings - predicted(rows, g)), np.nan)
        weights = np.where(counts, 1 / np.maximum(residuals, least), 0)
        weights = np.nan_to_num(weights / np.maximum(weights.max(axis=0), 1e-300))
    return residuals, NORMAL_MAD * _median(residuals, counts.sum(axis=0)), least


def noise_among_wrong(
    rows: Rows, readings: Readings, counts: Counted, shape: tuple[int, ...]
) -> tuple[float, tuple[str, ...]]:
    """Return the standard deviation of a reading if most pixels have wrong readings, else infinity,
    and a sentence if readings scatter so much that they hardly depend on the normal.
    Wrong readings are assumed if most pixels have large residuals that differ between neighbouring
    pixels. The noise is then estimated from the residuals of the readings nearest to an exact fit
    of three readings, in the pixels where these residuals are small. The residuals are divided by
    those of Gaussian noise of unit variance.
    """
    used, largest = counts.sum(axis=0), np.where(counts, readings, 0).max(axis=0)
    known = used > AGREE
    bright = np.flatnonzero(known & (largest >= np.median(largest[known] if known.any() else 0)))
    if bright.size < FEWEST:
        return np.inf, ()

    def sample(pixels: np.ndarray) -> tuple[Rows, Readings, Counted]:
        some = pixels[:: -(-pixels.size // VOTERS)]
        return take_pixels(rows, some), readings[:, some], counts[:, some]

    def scatter(some: tuple[Rows, Readings, Counted]) -> float:
        return float(np.median(_least_absolute(*some)[1]))

    own_rows, own, valid = brightest = sample(bright)
    least = scatter(brightest)
    usual = max(least, scatter(sample(np.flatnonzero(known))))
    relative = least / float(np.median(own[valid]))
    if usual <= NOISY * np.median(own[valid]):
        return np.inf, ()
    weights = counts.astype(float)
    residuals = np.where(counts, readings - predicted(rows, solved(rows, readings, weights)[0]), 0)
    lit = (counts & np.isfinite(residuals)).reshape(shape)
    if shared_squares(residuals.reshape(shape), lit) > SHARED:
        return np.inf, ()
    unit = np.random.default_rng(0).normal(size=own.shape)
    seen, expected = (
        np.quantile(_nearest_half(own_rows, values, valid), LUCKY) for values in (own, unit)
    )
    noise = min(float(seen / expected), least)
    said = () if relative <= SCATTERED else (_scattered_finding(relative),)
    return noise if SPOILED * noise < usual else np.inf, said


def _scattered_finding(relative: float) -> str:
    return (
        f"Readings scatter about m = E rho n.l by {format_percent(relative)} of their median, and "
        "neighbouring pixels do so independently. If this is not noise, most pixels have wrong "
        "readings, as in images of other views or damaged files, and normals and their standard "
        "deviations are wrong; look at the images."
    )


def _nearest_half(rows: Rows, readings: Readings, counts: Counted) -> OfPixels:
    """Fit each pixel exactly to each set of three readings. About half of all readings of the pixel
    lie within some distance of each fit; return the smallest such distance."""
    place = np.maximum(counts.sum(axis=0) // 2, AGREE)[None] - 1
    found = np.full(readings.shape[1], np.inf)
    for residuals in _exact_fits(rows, readings, counts):
        away = np.nan_to_num(np.where(counts, residuals, np.inf), nan=np.inf)
        found = np.minimum(found, np.take_along_axis(np.sort(away, axis=0), place, axis=0)[0])
    return found


def _exact_fits(rows: Rows, readings: Readings, counts: Counted) -> Iterator[Readings]:
    """Yield the absolute residuals of the fit to each set of three readings; NaN in pixels that
    lack one of the three."""
    triples = list(combinations(range(len(readings)), 3))
    for three in map(list, triples[:: -(-len(triples) // TRIPLES)]):
        weights = np.zeros_like(readings)
        weights[three] = counts[three].all(axis=0)
        yield np.abs(readings - predicted(rows, solved(rows, readings, weights)[0]))


def _agreeing(
    rows: Rows,
    readings: Readings,
    counts: Counted,
    tolerance: float | OfPixels,
    apart: Counted | None = None,
) -> Counted:
    """Return, for each pixel, the largest set of readings within a tolerance of the prediction from
    three of them. The set contains the valid readings even if up to half of the readings are in
    shadow. If `apart` is given, at least a third of the readings in the set are flagged in it."""
    best, most = np.zeros_like(counts), np.zeros(readings.shape[1])
    for residuals in _exact_fits(rows, readings, counts):
        with np.errstate(invalid="ignore"):
            own = counts & (residuals < tolerance)
        more = own.sum(axis=0) > most
        if apart is not None:
            more &= 3 * (own & apart).sum(axis=0) >= own.sum(axis=0)
        best[:, more], most = own[:, more], np.maximum(most, own.sum(axis=0))
    return best


def contradicted_pixels(
    rows: Rows, readings: Readings, counts: Counted, between: Counted, limits: Limits
) -> tuple[Bool[np.ndarray, " pixels"], Bool[np.ndarray, " pixels"]]:
    """Return two masks of pixels. In the first, at least as many readings contradict the fit as
    support it, or nearly as many readings agree on another normal. In the second, the
    readings scatter much more than usual."""
    g, _, variance, used = least_squares(rows, readings, counts)
    scatter = np.sqrt(variance)
    usual = np.nanmedian(scatter) if np.isfinite(scatter).any() else np.inf
    usual = min(usual, limits[3])
    expected = predicted(rows, g)
    dark = limits[0] + CLEAR * limits[2]
    off = between & ~counts & (np.abs(readings - expected) > APART * usual)
    apart = (off & (expected > dark)).sum(axis=0)
    against = apart > used - (2 if np.isinf(limits[3]) else 4)
    some = np.flatnonzero((off.sum(axis=0) > 1) & (used > 3) & ~against)
    if some.size and 0 < usual < np.inf:
        own, lit = readings[:, some], (between & (readings > dark))[:, some]
        misses = np.where(counts, np.abs(readings - expected), 0)[:, some].max(axis=0)
        as_well = np.maximum(FAR * usual, misses)  # as the accepted readings agree
        second = _agreeing(take_pixels(rows, some), own, lit, as_well, off[:, some])
        against[some] = second.sum(axis=0) >= np.maximum(used[some] - 2, RIVAL)
    return (used > 3) & against, scatter > APART * usual


def _explained_readings(rows: Rows, readings: Readings, apart: Counted, near: Counted) -> Counted:
    """Return a mask of excluded readings that agree with the prediction from the accepted readings,
    by Student's t for the largest of all prediction errors. Even if no reading is wrong, the
    accepted readings are those nearest to the fit, so their scatter is too small. The variance of
    the accepted readings is therefore corrected as for a truncated Gaussian.
    """
    some = np.flatnonzero(apart.any(axis=0))
    found = np.zeros_like(apart)
    if not some.size:
        return found
    own, own_near, own_apart = readings[:, some], near[:, some], apart[:, some]
    rows = take_pixels(rows, some)
    g, inverse, scatter, used = least_squares(rows, own, own_near)
    several = own_apart.sum(axis=0)
    share = used / (used + several)
    cut = ndtri((1 + share) / 2)
    narrower = 1 - 2 * cut * np.exp(-(cut**2) / 2) / np.sqrt(2 * np.pi) / share
    covariance = inverse * scatter[:, None, None]
    spelled = "ki,pij,kj->kp" if rows.ndim == 2 else "kpi,pij,kpj->kp"
    variance = scatter + np.einsum(spelled, rows, covariance, rows)
    error = np.sqrt(variance / narrower)
    limit = stdtrit(used - 3.0, 1 - CHANCE / 2 / (used + several))
    found[:, some] = own_apart & (np.abs(own - predicted(rows, g)) < limit * error)
    return found


def _median(residuals: Readings, used: Int[np.ndarray, " pixels"]) -> OfPixels:
    """Return the lower median of the residuals, without the three residuals that are 0 in any fit
    of three unknowns by least absolute deviations."""
    ordered = np.sort(residuals, axis=0)  # NaN last
    place = np.clip(3 + (used - 4) // 2, 0, len(ordered) - 1)
    return np.take_along_axis(ordered, place[None], axis=0)[0]
