"""What a surface that is not Lambert's does to normals from its shading.

Rough and glossy surfaces, and files that are not linear, depart from m = E rho n.l by an amount
that changes slowly with the direction of the light. Neighbouring lights then err alike, and a part
of what they share turns the normal instead of showing in the residuals. The departure of a pixel
is taken for a Gaussian process over the directions of the lights,

    m_k = E_k (rho n.l_k + f(l_k)) + noise,    cov f(l), f(l') = tau^2 exp(-|l - l'|^2 / 2 w^2),

whose ratio of variances tau^2 / sigma^2 has its restricted likelihood from the residuals (Harville,
J. Am. Stat. Assoc. 72, 1977), with the distribution of the ratio over the pixels as prior
(Laird, J. Am. Stat. Assoc. 73, 1978) and, with half of the weight, a flat one: a few lights may
not show what misleads them. The errors of least squares follow by generalised least squares.

Of fewer than 16 lights the residuals can hardly tell noise from departures. There neighbouring
pixels do, whose noise is independent and whose departures are alike: all of that part is taken for
a slow one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

REACH = 0.8  # w: as slow as n.l and rough surfaces change with the light
RATIOS = np.concatenate([[0.0], np.geomspace(1e-4, 1e8, 49)])  # tau^2 / sigma^2
THINNEST = 1e-4  # of the largest eigenvalue: features of the process that are left out
WHOLE = 1e-9  # of the largest eigenvalue: what is no more than rounding
EVIDENCE = 10.0  # logarithm of the likelihood ratio from which departures are seen
SEEN = 5.0  # standard errors of the correlation of neighbouring pixels, likewise
ROUNDS = 30  # of the distribution over the pixels
MOST, AT_ONCE = 4_000, 20_000  # pixels that tell it; pixels that are computed together
FEW_LIGHTS = 16


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
    features = _features(directions) * np.linalg.norm(rows, axis=1)[:, None]
    of_pixels, weights = residuals.reshape(len(rows), -1), counts.reshape(len(rows), -1)
    used = weights.sum(axis=0)
    told = (used > 3) & np.isfinite(inverse[:, 0, 0])
    noise, size = np.full(len(used), np.nan), np.zeros(len(used))
    noise[told] = (of_pixels[:, told] ** 2).sum(axis=0) / (used[told] - 3)
    alone = Departures(inverse * noise[:, None, None], noise, size, seen=False)
    places = np.flatnonzero(told)
    if not places.size:
        return alone

    def reduced(chosen: Int[np.ndarray, " some"]) -> _Reduced:
        of_chosen, counted = of_pixels[:, chosen], weights[:, chosen]
        return _reduced(rows, features, of_chosen, counted, inverse[chosen])

    prior, evidence = _prior(reduced(places[:: -(-len(places) // MOST)]))
    shared = _shared(residuals, counts)
    if evidence < EVIDENCE and shared == 0:
        return alone
    covariance = alone.covariance.copy()
    for start in range(0, len(places), AT_ONCE):
        some = places[start : start + AT_ONCE]
        of_some = reduced(some)
        own, square = _variances(of_some, prior, shared)
        noise[some], size[some] = own, np.sqrt(square)
        turned = of_some.turning @ np.swapaxes(of_some.turning, 1, 2)
        covariance[some] = own[:, None, None] * inverse[some] + square[:, None, None] * turned
    return Departures(covariance, noise, size, seen=True)


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


def _likelihoods(of: _Reduced) -> tuple[np.ndarray, np.ndarray]:
    """Restricted log likelihood of each ratio less that of none, and the noise variance that goes
    with it, both (ratios, pixels)."""
    logs, noise = [], []
    for ratio in RATIOS:
        widening = 1 + ratio * of.eigenvalues
        noise.append(((of.squares / widening).sum(axis=1) + of.rest) / of.freedom)
        volume = np.log(widening).sum(axis=1)
        logs.append(-(of.freedom * np.log(np.maximum(noise[-1], 1e-300)) + volume) / 2)
    return np.array(logs) - logs[0], np.array(noise)


def _prior(of: _Reduced) -> tuple[Float[np.ndarray, " ratios"], float]:
    """Distribution of the ratio over pixels, and the log likelihood ratio by which they show it."""
    logs, _ = _likelihoods(of)
    most = logs.max(axis=0)
    likelihood = np.exp(logs - most)
    share = np.full(len(RATIOS), 1 / len(RATIOS))
    for _ in range(ROUNDS):
        posterior = share[:, None] * likelihood
        share = (posterior / posterior.sum(axis=0)).mean(axis=1)
    evidence = float((np.log(share @ likelihood) + most).sum())
    return (share + 1 / len(RATIOS)) / 2, evidence


def _variances(of: _Reduced, prior: np.ndarray, shared: float) -> tuple[np.ndarray, np.ndarray]:
    """sigma^2 and tau^2 of each pixel."""
    logs, noise = _likelihoods(of)
    posterior = prior[:, None] * np.exp(logs - logs.max(axis=0))
    posterior /= posterior.sum(axis=0)
    own, square = (posterior * noise).sum(axis=0), (posterior * noise * RATIOS[:, None]).sum(axis=0)
    slow = (
        shared * (of.squares.sum(axis=1) + of.rest) / np.maximum(of.eigenvalues.sum(axis=1), WHOLE)
    )
    few = of.freedom + 3 < FEW_LIGHTS
    return own, np.where(few, np.maximum(square, slow), square)


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
