"""Standard errors of normals from shading that include noise and departures from Lambert's law.

The few residuals of a pixel determine its noise poorly: from them alone, with eight lights, the 95
% cones contained the true normal in 83 % of the pixels. The variance of a pixel is therefore
estimated with the distribution over all pixels as its prior (Laird, J. Am. Stat. Assoc. 73, 1978),
a mixture of inverse gamma distributions.

For rough and glossy surfaces, and for files that are not linear, readings depart from m = E rho n.l
by an amount that changes slowly with the direction of the light. The errors of neighbouring lights
are then correlated, and a part of them rotates the normal instead of appearing in the residuals.
The departure of a pixel is modelled as a Gaussian process over the directions of the lights,

    m_k = E_k (rho n.l_k + f(l_k)) + noise,    cov f(l), f(l') = tau^2 exp(-|l - l'|^2 / 2 w^2),

where m_k is the reading under light k, with irradiance E_k and direction l_k, rho is the albedo, n
the normal, and f the departure, with standard deviation tau and correlation length w. The residuals
give a restricted likelihood of the ratio tau^2 / sigma^2, with sigma^2 the variance of the noise
(Harville, J. Am. Stat. Assoc. 72, 1977). The prior of the ratio and of sigma^2 is their
distribution over the pixels. The covariance of the least-squares estimates follows from both
variances. This covariance is scaled so that, in the posterior of both variances, errors exceed
2.448 standard errors, the 95 % radius of a two-dimensional Gaussian, with a probability of 5 %.

The residuals of a pixel under six lights hardly distinguish noise from departures. A comparison of
neighbouring pixels distinguishes them, because the noise of neighbours is independent and their
departures are similar. If residuals of neighbours correlate, the noise variance is limited to twice
the part that neighbours do not share.

Cameras count photons, so the variance of a reading grows with the reading. If lamps flicker, the
variance grows with the square of the reading. If readings were multiplied by the intensity of the
light, the variance grows with the square of that intensity. The share of the variance that grows in
this way is estimated by maximum restricted likelihood. If the variance were taken as constant under
lights of unequal intensities, the noise under the stronger lights would be mistaken for departures.
Only pixels whose mean reading is well above the noise are used. In a dark background, only readings
that noise makes positive are used, and such readings are not Gaussian.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import gammaln

from .lights import (
    Images,
    Matrices,
    OfPixels,
    Readings,
    Rows,
    directions_of,
    predicted,
    solved,
    strengths_of,
)

REACH = 0.8  # w: scale on which n.l and the shading of rough surfaces change with the light
RATIOS = np.concatenate([[0.0], np.geomspace(1e-2, 1e8, 21)])  # tau^2 / sigma^2
THINNEST = 1e-4  # of the largest eigenvalue: smaller features of the process are left out
WHOLE = 1e-9  # of the largest eigenvalue: below it is rounding
EVIDENCE = 10.0  # logarithm of the likelihood ratio from which departures are significant
FEW_LIGHTS = 16  # lights below which residuals beyond noise count as slow departures
CLEAR = 3.0  # standard deviations of a reading: smallest mean of pixels that estimate departures
SEEN = 5.0  # standard errors at which neighbouring pixels are correlated
ROUNDS = 30  # updates of the distribution over the pixels
MATT = 0.95  # share of pixels without departures at the start of the search
ALIKE = 0.05  # weight of a uniform distribution added to that over the pixels
FINEST, LEVELS = 0.22, 64  # step of ln sigma^2, and most steps
QUIETEST = 1e-9  # of the largest variance: smaller noise is rounding
LOUDEST = 2.0  # largest noise, relative to the part that neighbours do not share
INSIDE, NEWTON = 0.95, 8  # probability of a cone; rounds of the search for its radius
MOST, AT_ONCE = 2_000, 1_000  # most pixels of the estimate; pixels computed together
OF_PHOTONS = (0.0, 0.5, 0.8, 0.93, 0.98, 0.995, 0.999, 0.9999)  # of a reading's variance
OF_LAMPS = (0.5, 0.8, 0.95, 0.99)  # the same for noise that grows with the square of the reading


@dataclass(frozen=True)
class Departures:
    """The contributions of noise and of departures from Lambert's law to the readings of each
    pixel."""

    # of the readings in least squares; 0 for unused readings
    weights: Readings
    # inverse of the normal matrices; NaN where g is unknown
    inverse: Matrices
    covariance: Matrices  # of g
    # variance of a reading of weight 1; NaN where no residual is left
    noise: OfPixels
    # tau, standard deviation of the departures, readings over irradiance
    size: OfPixels
    significant: bool  # whether departures are significant; if not, all residuals count as noise


@dataclass(frozen=True)
class _Reduced:
    """The residuals of pixels along the eigenvectors of their covariance, if departures are a
    Gaussian process.
    """

    # of the residuals' covariance, per tau^2
    eigenvalues: Float[np.ndarray, "pixels features"]
    # squared residuals along their eigenvectors
    squares: Float[np.ndarray, "pixels features"]
    rest: OfPixels  # squares of the remaining residuals
    freedom: Int[np.ndarray, " pixels"]  # degrees of freedom
    # change of g by each feature
    turning: Float[np.ndarray, "pixels 3 features"]
    # log determinants of the weights and of g in the restricted likelihood
    volume: OfPixels


def departures(
    rows: Rows,
    readings: Images,
    counts: Bool[np.ndarray, "lights h w"],
    linear: Rows,
) -> Departures:
    """Compute the covariance of g, including departures from a linear model with the given slopes,
    which are equal to `rows` for Lambert's law.
    """
    flat, counted = readings.reshape(len(rows), -1), counts.reshape(len(rows), -1)
    used = counted.sum(axis=0)
    g, inverse = solved(linear, flat, counted.astype(float))
    known = (used > 3) & np.isfinite(inverse[:, 0, 0])
    noise, size = np.full(len(used), np.nan), np.zeros(len(used))
    covariance = np.full_like(inverse, np.nan)
    places = np.flatnonzero(known)
    if not places.size:
        return Departures(
            counted.astype(float), inverse, covariance, noise, size, significant=False
        )
    features, strengths = _features(directions_of(rows)), strengths_of(rows)
    expected = np.maximum(np.nan_to_num(predicted(linear, g)), 0)
    typical = float(np.median(expected[counted & known])) or 1.0

    left = np.where(counted, flat - predicted(linear, g), 0)
    clear = np.where(counted, flat, 0).sum(axis=0) ** 2 * (used - 3) > (
        CLEAR**2 * used**2 * (left**2).sum(axis=0)
    )
    voters = known & clear if clear[known].any() else known
    voting = counts & voters.reshape(counts.shape[1:])
    some, fits = np.flatnonzero(voters), []
    some = some[:: -(-len(some) // MOST)]
    squares = [(expected / typical) ** 2]
    squares += [strengths**2 / np.median(strengths**2)] * bool(np.ptp(strengths))
    growths = [(share, expected / typical) for share in OF_PHOTONS]
    growths += [(share, square) for square in squares for share in OF_LAMPS]
    for share, growth in growths:
        weights = counted / (1 - share + share * growth)
        g, inverse = solved(linear, flat, weights)
        of = _Fit(
            *(linear, features, strengths, np.where(counted, flat - predicted(linear, g), 0)),
            *(weights, inverse),
        )
        scaled = of.residuals * np.sqrt(weights)
        shared = shared_squares(scaled.reshape(readings.shape), voting)
        scatter = (scaled[:, voters] ** 2).sum(axis=0) / (used[voters] - 3)
        unshared = (1 - shared) * float(scatter.mean()) if shared else np.inf
        fits.append((of, _prior(of.reduced(some), unshared, RATIOS[:1])))
    best = max(fits, key=lambda fit: fit[1].likelihood)
    if best[1].likelihood - fits[0][1].likelihood < EVIDENCE:
        best = fits[0]
    slow = [
        (of, _prior(of.reduced(some), alone.unshared, RATIOS), alone)
        for of, alone in ([best] if best is fits[0] else [fits[0], best])
    ]
    significant = all(
        prior.likelihood - alone.likelihood > EVIDENCE or prior.unshared < np.inf
        for _, prior, alone in slow
    )
    of, prior = slow[0][:2] if significant else best
    for start in range(0, len(places), AT_ONCE):
        part = places[start : start + AT_ONCE]
        noise[part], size[part], covariance[part] = _posterior(
            of.reduced(part), of.inverse[part], prior
        )
    return Departures(of.weights, of.inverse, covariance, noise, size, significant=significant)


@dataclass(frozen=True)
class _Fit:
    """The weighted least-squares fit of all pixels."""

    rows: Rows
    features: Float[np.ndarray, "lights features"]  # of the departures
    # irradiance on a surface that faces the light; 1 column if all pixels have the same
    strengths: Float[np.ndarray, "lights pixels"]
    residuals: Readings  # (lights, pixels); 0 for unused readings
    weights: Readings
    inverse: Matrices  # inverse of the normal matrices

    def reduced(self, some: Int[np.ndarray, " some"]) -> _Reduced:
        """Return the residuals of some pixels along the eigenvectors of their covariance, if
        departures are a Gaussian process.
        """
        residuals, weights, inverse = (
            self.residuals[:, some],
            self.weights[:, some],
            self.inverse[some],
        )
        count = self.features.shape[1]
        strengths = np.broadcast_to(self.strengths, self.weights.shape)[:, some]
        if self.rows.ndim == 2:
            both = np.concatenate([self.features * self.strengths, self.rows], axis=1)
            products = (both[:, :, None] * both[:, None, :]).reshape(len(both), -1)
            table = (weights.T @ products).reshape(-1, count + 3, count + 3)
        else:
            alike = self.features[:, None] * strengths[:, :, None]
            both = np.concatenate([alike, self.rows[:, some]], axis=2)
            table = np.einsum("lp,lpi,lpj->pij", weights, both, both, optimize=True)
        across = table[:, count:, :count]
        turning = inverse @ across
        left = table[:, :count, :count] - np.swapaxes(across, 1, 2) @ turning
        values, vectors = np.linalg.eigh(left)
        known = values > WHOLE * np.maximum(values[:, -1:], 1e-300)
        along = np.einsum(
            "pf,pfe->pe", (weights * strengths * residuals).T @ self.features, vectors
        )
        squares = np.where(known, along**2 / np.where(known, values, 1), 0)
        rest = np.maximum((weights * residuals**2).sum(axis=0) - squares.sum(axis=1), 0)
        counts = weights > 0
        volume = np.log(np.where(counts, weights, 1)).sum(axis=0) / 2
        volume += np.linalg.slogdet(inverse)[1] / 2
        eigenvalues = np.where(known, values, 0)
        return _Reduced(eigenvalues, squares, rest, counts.sum(axis=0) - 3, turning, volume)


def _features(directions: np.ndarray) -> Float[np.ndarray, "lights features"]:
    """Return columns whose outer products sum to the covariance of f / tau."""
    apart = ((directions[:, None] - directions) ** 2).sum(axis=-1)
    values, vectors = np.linalg.eigh(np.exp(-apart / (2 * REACH**2)))
    kept = values > THINNEST * values.max()
    return vectors[:, kept] * np.sqrt(values[kept])


@dataclass(frozen=True)
class _Prior:
    """The distribution of sigma^2 and tau^2 / sigma^2 over the pixels, which is their prior."""

    # scales of inverse gamma distributions of sigma^2
    levels: Float[np.ndarray, " levels"]
    freedom: float  # their degrees of freedom
    # of tau^2 / sigma^2; only 0 where no departures are significant
    ratios: Float[np.ndarray, " ratios"]
    shares: Float[np.ndarray, "levels ratios"]  # probabilities, whose sum is 1
    # variance that neighbouring pixels do not share; infinite where they share none
    unshared: float
    likelihood: float  # its logarithm


def _prior(of: _Reduced, unshared: float, ratios: Float[np.ndarray, " ratios"]) -> _Prior:
    """Estimate the prior by maximum likelihood."""
    squares, volume = _squares(of, RATIOS)
    most = max(min(float((squares[0] / of.freedom).max()), LOUDEST * unshared), 1e-300)
    least = max(float(np.quantile(squares[-1] / of.freedom, 0.01)), QUIETEST * most)
    span = max(float(np.log(most / least)), 0.0)
    count = int(min(LEVELS, np.ceil(span / FINEST) + 2))
    step = max(span / (count - 1), FINEST)
    levels, freedom = most * np.exp(-step * np.arange(count)), 2 / step**2
    several = len(ratios)
    logs = _likelihoods(squares[:several], volume[:several], of.freedom, levels, freedom)
    start = np.full(logs.shape[:2], (1 - MATT) / max(several - 1, 1) / count)
    start[:, 0] = (MATT if several > 1 else 1) / count
    shares, likelihood = _shares(logs, start)
    likelihood += float(of.volume.sum())
    return _Prior(levels, freedom, ratios, shares, unshared, likelihood)


def _squares(of: _Reduced, ratios: Float[np.ndarray, " ratios"]) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (ratios, pixels): the squared residuals in units of sigma^2, and half the
    log determinant of the covariance of the residuals over sigma^2.
    """
    squares, volume = [], []
    for ratio in ratios:
        widening = 1 + ratio * of.eigenvalues
        squares.append((of.squares / widening).sum(axis=1) + of.rest)
        volume.append(np.log(widening).sum(axis=1) / 2)
    return np.array(squares), np.array(volume)


def _likelihoods(
    squares: Float[np.ndarray, "ratios pixels"],
    volume: Float[np.ndarray, "ratios pixels"],
    freedom: Int[np.ndarray, " pixels"],
    levels: Float[np.ndarray, " levels"],
    known: float,
) -> Float[np.ndarray, "levels ratios pixels"]:
    """Return the restricted log likelihoods, with sigma^2 marginalised over each level's inverse
    gamma distribution.
    """
    scale, whole = known * levels[:, None, None], (known + freedom) / 2
    constant = gammaln(whole) - gammaln(known / 2) + known / 2 * np.log(scale)
    return constant - whole * np.log(scale + squares) - volume


def _shares(
    logs: Float[np.ndarray, "levels ratios pixels"], start: Float[np.ndarray, "levels ratios"]
) -> tuple[Float[np.ndarray, "levels ratios"], float]:
    """Estimate the distribution over the pixels by expectation maximisation. Return the
    distribution and its log likelihood.
    """
    flat = logs.reshape(-1, logs.shape[-1])
    most = flat.max(axis=0)
    likelihood, share = np.exp(flat - most), start.ravel()
    for _ in range(ROUNDS):
        share = share * (likelihood @ (1 / (share @ likelihood))) / flat.shape[1]
    found = float((np.log(share @ likelihood) + most).sum())
    share = (1 - ALIKE) * share + ALIKE / len(share)
    return share.reshape(start.shape), found


def _posterior(
    of: _Reduced, inverse: Matrices, prior: _Prior
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sigma^2, tau and the covariance of g of each pixel."""
    squares, volume = _squares(of, prior.ratios)
    logs = _likelihoods(squares, volume, of.freedom, prior.levels, prior.freedom)
    weight = prior.shares[:, :, None] * np.exp(logs - logs.max(axis=(0, 1)))
    weight /= weight.sum(axis=(0, 1))
    scale = prior.freedom * prior.levels[:, None, None]
    variance = (scale + squares) / (prior.freedom + of.freedom - 2)
    noise = (weight * variance).sum(axis=(0, 1))
    square = (weight * variance * prior.ratios[:, None]).sum(axis=(0, 1))
    excess = np.maximum(
        of.squares.sum(axis=1) + of.rest - np.minimum(noise, prior.unshared) * of.freedom, 0
    )
    slow = excess / np.maximum(of.eigenvalues.sum(axis=1), WHOLE)
    few = (of.freedom + 3 < FEW_LIGHTS) & (prior.ratios.size > 1)
    least = np.where(few, np.maximum(slow - square, 0), 0)
    rotating = of.turning @ np.swapaxes(of.turning, 1, 2)
    covariance = noise[:, None, None] * inverse + square[:, None, None] * rotating
    by_noise, by_departure = (np.trace(matrix, axis1=1, axis2=2) for matrix in (inverse, rotating))
    sizes = variance * (by_noise + prior.ratios[:, None] * by_departure)
    wider = _radius(weight, sizes) / np.maximum((weight * sizes).sum(axis=(0, 1)), 1e-300)
    covariance = covariance * wider[:, None, None] + least[:, None, None] * rotating
    return noise, np.sqrt(square + least), covariance


def _radius(
    weight: Float[np.ndarray, "levels ratios pixels"],
    sizes: Float[np.ndarray, "levels ratios pixels"],
) -> OfPixels:
    """Return the variance of a two-dimensional Gaussian with the same 95 % circle as a mixture.
    The logarithm of the probability outside a circle is a convex, decreasing function of its
    squared radius, so Newton's method finds the squared radius."""
    sizes, gaussian = np.maximum(sizes, 1e-300), -2 * np.log(1 - INSIDE)
    found = gaussian * sizes.min(axis=(0, 1))
    for _ in range(NEWTON):
        outside = weight * np.exp(-found / 2 / sizes)
        whole = outside.sum(axis=(0, 1))
        slope = (outside / sizes).sum(axis=(0, 1)) / 2 / whole
        found = found + np.log(whole / (1 - INSIDE)) / slope
    return found / gaussian


def shared_squares(residuals: np.ndarray, counts: np.ndarray) -> float:
    """Return the share of the residuals' squares that neighbouring pixels have in common; 0 if
    chance explains it.
    """
    product = square = spread = 0.0
    for axis in (1, 2):
        one, other = (np.moveaxis(a, axis, 0) for a in (residuals, counts))
        both = other[:-1] & other[1:]
        first, second = np.where(both, one[:-1], 0), np.where(both, one[1:], 0)
        product += float((first * second).sum())
        square += float((first**2 + second**2).sum()) / 2
        spread += float((first**2 * second**2).sum())
    return product / square if product > SEEN * np.sqrt(spread) else 0.0
