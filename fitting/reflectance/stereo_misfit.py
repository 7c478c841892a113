"""The errors of normals from shading: noise that pixels share, and what is not Lambert's.

A pixel's few residuals tell its noise badly: the normals of eight lights lay in their 95 % cones in
83 % of the pixels. What the other pixels' residuals are is known as well, so that the variance of a
pixel is estimated with their distribution as prior (Laird, J. Am. Stat. Assoc. 73, 1978), a mixture
of inverse gamma distributions.

Rough and glossy surfaces, and files that are not linear, depart from m = E rho n.l by an amount
that changes slowly with the direction of the light. Neighbouring lights then err alike, and a part
of what they share rotates the normal instead of showing in the residuals. The departure of a pixel
is taken for a Gaussian process over the directions of the lights,

    m_k = E_k (rho n.l_k + f(l_k)) + noise,    cov f(l), f(l') = tau^2 exp(-|l - l'|^2 / 2 w^2),

whose ratio of variances tau^2 / sigma^2 has its restricted likelihood from the residuals (Harville,
J. Am. Stat. Assoc. 72, 1977), and its distribution over the pixels as prior, together with that of
sigma^2. The errors of least squares follow by generalised least squares. They are scaled so that
2.448 of them, the radius of a Gaussian's 95 %, is exceeded with a probability of 5 % in the
posterior of both variances.

Residuals of six lights hardly distinguish noise from departures. Neighbouring pixels do, whose
noise is independent and whose departures are alike: where residuals of neighbours correlate, noise
is at most twice what they do not share.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import gammaln

REACH = 0.8  # w: as slow as n.l and rough surfaces change with the light
RATIOS = np.concatenate([[0.0], np.geomspace(1e-2, 1e8, 21)])  # tau^2 / sigma^2
THINNEST = 1e-4  # of the largest eigenvalue: features of the process that are left out
WHOLE = 1e-9  # of the largest eigenvalue: what is no more than rounding
EVIDENCE = 10.0  # logarithm of the likelihood ratio from which departures are seen
FEW_LIGHTS = 16  # whose residuals, as far as they are no noise, are taken for slow departures
SEEN = 5.0  # standard errors of the correlation of neighbouring pixels, likewise
ROUNDS = 30  # of the distribution over the pixels
MATT = 0.95  # share of pixels without departures that the search for it starts from
ALIKE = 0.05  # weight of all variances and ratios alike, beside their distribution
FINEST, LEVELS = 0.22, 64  # step of ln sigma^2, and at most so many of them
QUIETEST = 1e-9  # of the largest variance: noise that is no more than rounding
LOUDEST = 2.0  # times what neighbours do not share
INSIDE, NEWTON = 0.95, 8  # probability of a cone; rounds of the search for its radius
MOST, AT_ONCE = 2_000, 1_000  # pixels that tell it; pixels that are computed together


@dataclass(frozen=True)
class Departures:
    """What the readings of each pixel owe to noise and to departures from Lambert's law.

    Attributes:
        covariance: (pixels, 3, 3) of g.
        noise: (pixels,) variance of a reading; NaN where no residual is left.
        size: (pixels,) tau, readings over irradiance.
        seen: whether there are departures; if not, all residuals count as noise.
    """

    covariance: Float[np.ndarray, "pixels 3 3"]
    noise: Float[np.ndarray, " pixels"]
    size: Float[np.ndarray, " pixels"]
    seen: bool


@dataclass(frozen=True)
class _Reduced:
    """Residuals of pixels along the eigenvectors of what the process leaves in them.

    Attributes:
        eigenvalues: (pixels, features) of the residuals' covariance, per tau^2.
        squares: (pixels, features) of the residuals along them.
        rest: (pixels,) the squares of what is left.
        freedom: (pixels,) degrees of freedom.
        turning: (pixels, 3, features) change of g by each feature.
    """

    eigenvalues: Float[np.ndarray, "pixels features"]
    squares: Float[np.ndarray, "pixels features"]
    rest: Float[np.ndarray, " pixels"]
    freedom: Int[np.ndarray, " pixels"]
    turning: Float[np.ndarray, "pixels 3 features"]


def departures(
    rows: Float[np.ndarray, "lights 3"],
    directions: Float[np.ndarray, "lights 3"],
    residuals: Float[np.ndarray, "lights h w"],
    counts: Bool[np.ndarray, "lights h w"],
    inverse: Float[np.ndarray, "pixels 3 3"],
) -> Departures:
    """Covariance of g that allows for departures from Lambert's law.

    Args:
        rows: (lights, 3) E l.
        directions: (lights, 3) unit.
        residuals: (lights, h, w) of least squares; 0 where a reading does not count.
        counts: (lights, h, w) the readings of the fit.
        inverse: (pixels, 3, 3) of its normal matrices; NaN where g is unknown.

    Returns:
        Covariance, noise and size.
    """
    of_pixels, weights = residuals.reshape(len(rows), -1), counts.reshape(len(rows), -1)
    used = weights.sum(axis=0)
    told = (used > 3) & np.isfinite(inverse[:, 0, 0])
    noise, size = np.full(len(used), np.nan), np.zeros(len(used))
    covariance = np.full_like(inverse, np.nan)
    places = np.flatnonzero(told)
    if not places.size:
        return Departures(covariance, noise, size, seen=False)
    features = _features(directions) * np.linalg.norm(rows, axis=1)[:, None]

    def reduced(chosen: Int[np.ndarray, " some"]) -> _Reduced:
        of_chosen, counted = of_pixels[:, chosen], weights[:, chosen]
        return _reduced(rows, features, of_chosen, counted, inverse[chosen])

    shared = _shared(residuals, counts)
    own_scatter = (of_pixels[:, told] ** 2).sum(axis=0) / (used[told] - 3)
    unshared = (1 - shared) * float(own_scatter.mean()) if shared else np.inf
    prior = _prior(reduced(places[:: -(-len(places) // MOST)]), unshared)
    for start in range(0, len(places), AT_ONCE):
        some = places[start : start + AT_ONCE]
        noise[some], size[some], covariance[some] = _posterior(reduced(some), inverse[some], prior)
    return Departures(covariance, noise, size, seen=prior.ratios.size > 1)


def _features(directions: np.ndarray) -> Float[np.ndarray, "lights features"]:
    """Columns whose outer products sum to the covariance of f / tau."""
    apart = ((directions[:, None] - directions) ** 2).sum(axis=-1)
    values, vectors = np.linalg.eigh(np.exp(-apart / (2 * REACH**2)))
    kept = values > THINNEST * values.max()
    return vectors[:, kept] * np.sqrt(values[kept])


def _reduced(
    rows: np.ndarray,
    features: np.ndarray,
    residuals: Float[np.ndarray, "lights some"],
    weights: Bool[np.ndarray, "lights some"],
    inverse: Float[np.ndarray, "some 3 3"],
) -> _Reduced:
    count = features.shape[1]
    both = np.concatenate([features, rows], axis=1)
    products = (both[:, :, None] * both[:, None, :]).reshape(len(rows), -1)
    table = (weights.T.astype(float) @ products).reshape(-1, count + 3, count + 3)
    across = table[:, count:, :count]
    turning = inverse @ across
    left = table[:, :count, :count] - np.swapaxes(across, 1, 2) @ turning
    values, vectors = np.linalg.eigh(left)
    known = values > WHOLE * np.maximum(values[:, -1:], 1e-300)
    along = np.einsum("pf,pfe->pe", residuals.T @ features, vectors)
    squares = np.where(known, along**2 / np.where(known, values, 1), 0)
    rest = np.maximum((residuals**2).sum(axis=0) - squares.sum(axis=1), 0)
    return _Reduced(np.where(known, values, 0), squares, rest, weights.sum(axis=0) - 3, turning)


@dataclass(frozen=True)
class _Prior:
    """Distribution over the pixels of sigma^2 and tau^2 / sigma^2.

    Attributes:
        levels: (levels,) scales of inverse gamma distributions of sigma^2.
        freedom: their degrees of freedom.
        ratios: (ratios,) of tau^2 / sigma^2; 0 alone where no departures are seen.
        shares: (levels, ratios), whose sum is 1.
        unshared: variance that neighbouring pixels do not share; infinite where they share none.
    """

    levels: Float[np.ndarray, " levels"]
    freedom: float
    ratios: Float[np.ndarray, " ratios"]
    shares: Float[np.ndarray, "levels ratios"]
    unshared: float


def _prior(of: _Reduced, unshared: float) -> _Prior:
    """By maximum likelihood; departures are seen in it, or in neighbours."""
    squares, volume = _squares(of, RATIOS)
    most = min(max(float((squares[0] / of.freedom).max()), 1e-300), LOUDEST * unshared)
    least = max(float(np.quantile(squares[-1] / of.freedom, 0.01)), QUIETEST * most)
    span = max(float(np.log(most / least)), 0.0)
    count = int(min(LEVELS, np.ceil(span / FINEST) + 2))
    step = max(span / (count - 1), FINEST)
    levels, freedom = most * np.exp(-step * np.arange(count)), 2 / step**2
    logs = _likelihoods(squares, volume, of.freedom, levels, freedom)
    alone, without = _shares(logs[:, :1], np.full((count, 1), 1 / count))
    start = np.full(logs.shape[:2], (1 - MATT) / (len(RATIOS) - 1) / count)
    start[:, 0] = MATT / count
    shares, with_departures = _shares(logs, start)
    if with_departures - without < EVIDENCE and unshared == np.inf:
        return _Prior(levels, freedom, RATIOS[:1], alone, unshared)
    return _Prior(levels, freedom, RATIOS, shares, unshared)


def _squares(of: _Reduced, ratios: Float[np.ndarray, " ratios"]) -> tuple[np.ndarray, np.ndarray]:
    """The residuals' squares in units of sigma^2 and half of the logarithm of the determinant of
    their covariance over it, both (ratios, pixels)."""
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
    """Restricted log likelihoods, sigma^2 marginalised over each level's inverse gamma."""
    scale, whole = known * levels[:, None, None], (known + freedom) / 2
    constant = gammaln(whole) - gammaln(known / 2) + known / 2 * np.log(scale)
    return constant - whole * np.log(scale + squares) - volume


def _shares(
    logs: Float[np.ndarray, "levels ratios pixels"], start: Float[np.ndarray, "levels ratios"]
) -> tuple[Float[np.ndarray, "levels ratios"], float]:
    """The distribution over the pixels, and its log likelihood, by expectation maximisation."""
    flat = logs.reshape(-1, logs.shape[-1])
    most = flat.max(axis=0)
    likelihood, share = np.exp(flat - most), start.ravel()
    for _ in range(ROUNDS):
        share = share * (likelihood @ (1 / (share @ likelihood))) / flat.shape[1]
    found = float((np.log(share @ likelihood) + most).sum())
    share = (1 - ALIKE) * share + ALIKE / len(share)
    return share.reshape(start.shape), found


def _posterior(
    of: _Reduced, inverse: Float[np.ndarray, "pixels 3 3"], prior: _Prior
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sigma^2, tau and the covariance of g of each pixel."""
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
) -> Float[np.ndarray, " pixels"]:
    """The variance whose Gaussian, of two numbers, has the 95 % circle of a mixture: by Newton's
    method in the logarithm of what lies outside, which falls convexly."""
    sizes, gaussian = np.maximum(sizes, 1e-300), -2 * np.log(1 - INSIDE)
    found = gaussian * sizes.min(axis=(0, 1))
    for _ in range(NEWTON):
        outside = weight * np.exp(-found / 2 / sizes)
        whole = outside.sum(axis=(0, 1))
        slope = (outside / sizes).sum(axis=(0, 1)) / 2 / whole
        found = found + np.log(whole / (1 - INSIDE)) / slope
    return found / gaussian


def _shared(residuals: np.ndarray, counts: np.ndarray) -> float:
    """Share of the residuals' squares that neighbouring pixels have in common; 0 within chance."""
    product = square = pairs = freedom = 0.0
    for axis in (1, 2):
        one, other = (np.moveaxis(a, axis, 0) for a in (residuals, counts))
        both = other[:-1] & other[1:]
        first, second = np.where(both, one[:-1], 0), np.where(both, one[1:], 0)
        product += float((first * second).sum())
        square += float((first**2 + second**2).sum()) / 2
        used = both.sum(axis=1)
        pairs += float(used.sum())
        freedom += float(np.maximum(used - 3, 0).sum())
    if square == 0 or freedom == 0:
        return 0.0
    correlation = product / square
    return correlation if correlation * np.sqrt(freedom) > SEEN else 0.0
