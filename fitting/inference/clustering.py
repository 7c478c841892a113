"""Compute the covariance of a fit whose model errors are correlated within clusters of data.

All pixels of an image share a model error if, for example, the intensity of its light is wrong. One
pixel has the same error under all lights if, for example, its gain is wrong or the surface is
stained there. Then N pixels are not N independent observations. The gradient of the log likelihood,
summed within such clusters, has a covariance J that exceeds the Fisher information I. I^-1 J I^-1
is the sandwich covariance (Liang & Zeger, Biometrika 73, 1986; for two kinds of clusters together:
Cameron, Gelbach & Miller, J. Bus. Econ. Stat. 29, 2011). With P parameters, trace(I^-1 J) / P is
the design effect, the factor by which the number of independent observations is reduced.

The residuals of a cluster are smaller than its errors, because the fit partly follows them, in
proportion to the cluster's share A_g of the information. Let the parameters have units in which I =
1. The summed scores s_g of cluster g are therefore increased by a matrix B_g (CR2: Bell &
McCaffrey, Survey Methodology 28, 2002),

    V = sum_g B_g s_g s_g^T B_g,    B_g = (1 - A_g)^(-1/2),

If the residuals are independent, the expectation of V is then sum_g A_g, as it should be. With few
clusters V is itself uncertain. The variance c^T V c of a linear combination c of the parameters is
a quadratic form of the residuals with the matrix G,

    G_gh = delta_gh b_g.a_g - a_g.a_h,    b_g = B_g c,    a_g = A_g b_g,

The variance is approximately chi-square distributed with (tr G)^2 / tr G^2 degrees of freedom
(Satterthwaite). The interval of the combination uses Student's t with these degrees of freedom
(Imbens & Kolesar, Rev. Econ. Stat. 98, 2016).
"""

import warnings
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular
from scipy.special import chdtri, ndtri, stdtrit

CHANCE = 0.01  # probability of calling independent residuals clustered
WHOLE = 1e-9  # eigenvalue of 1 - A_g below which one cluster alone determines the direction
THINNEST = 1e-3  # smallest variance of a direction, relative to independent data, so draws exist
LEVEL = 0.975  # quantile at which a Gaussian replaces Student's t


@dataclass(frozen=True)
class Robustness:
    """The covariance of a fit, and the correlation of its residuals within clusters.

    Attributes:
        covariance: (parameters, parameters) the sandwich estimate; the inverse information where
            there are too few lights for it.
        freedom: (parameters,) degrees of freedom of each variance; infinite where the variance
            counts as known.
        effects: measured design effect of the clusters of each level; NaN where there are too few
            clusters.
        design_effect: design effect of the covariance; 1 where chance explains all measured
            effects.
    """

    covariance: Float[np.ndarray, "parameters parameters"]
    freedom: Float[np.ndarray, " parameters"]
    effects: tuple[float, ...]
    design_effect: float

    @property
    def light_design_effect(self) -> float:
        """Return the design effect of the first level of clusters, such as lights."""
        return self.effects[0]

    @property
    def pixel_design_effect(self) -> float:
        """Return the design effect of the second level of clusters, such as pixels; NaN if there is
        only one level.
        """
        return self.effects[1] if len(self.effects) > 1 else np.nan

    @property
    def by_light(self) -> float:
        """Former name of `light_design_effect`."""
        warnings.warn("by_light is now light_design_effect.", DeprecationWarning, stacklevel=2)
        return self.light_design_effect

    @property
    def by_pixel(self) -> float:
        """Former name of `pixel_design_effect`."""
        warnings.warn("by_pixel is now pixel_design_effect.", DeprecationWarning, stacklevel=2)
        return self.pixel_design_effect

    @property
    def gaussian_covariance(self) -> Float[np.ndarray, "parameters parameters"]:
        """Return the covariance of the Gaussian whose 95 % intervals equal those of Student's t."""
        return gaussian_equivalent(self.covariance, self.freedom)


def gaussian_equivalent(
    covariance: Float[np.ndarray, "parameters parameters"],
    freedom: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, "parameters parameters"]:
    """Return the covariance of the Gaussian whose 95 % intervals equal those of Student's t."""
    wider = stdtrit(freedom, LEVEL) / ndtri(LEVEL)
    return covariance * np.outer(wider, wider)


@dataclass(frozen=True)
class _Clustering:
    """The matrices of one level of clusters, with parameters in units in which the information I is
    1."""

    # (clusters, P, P) A_g, the shares of the clusters in the information
    shares: Float[np.ndarray, "clusters parameters parameters"]
    # (clusters, P, P) B_g, which corrects the scores
    widening: Float[np.ndarray, "clusters parameters parameters"]
    variance: Float[np.ndarray, "parameters parameters"]  # (P, P) V, the covariance of the scores
    # (P, P) V if every sample were its own cluster
    unclustered: Float[np.ndarray, "parameters parameters"]
    effect: float  # ratio of V to the variance of independent residuals of the same size


def cluster_robust(
    scores: Float[np.ndarray, "parameters samples"],
    information: Float[np.ndarray, "parameters parameters"],
    *levels: Int[np.ndarray, " samples"] | None,
    slopes: Float[np.ndarray, "parameters samples"] | None = None,
    prior: Float[np.ndarray, "parameters parameters"] | None = None,
) -> Robustness:
    """Compute the covariance of a fit whose residuals are correlated within clusters, of one or
    several levels.

    The first level (lights, say) always enters, because a test with few clusters overlooks errors
    that matter. The other level (pixels, say) has many clusters and enters only if its test is
    significant. Levels may be crossed, as rows and columns are, or nested. The intersections of the
    clusters of two levels are counted once.

    Args:
        scores: (parameters, samples), gradient of each sample's log likelihood.
        information: (parameters, parameters), the Fisher information if all samples were
            independent.
        levels: (samples,) cluster of each sample, by level; None leaves a level out.
        slopes: (parameters, samples), gradient of each sample's prediction over its standard
            deviation; their outer products sum to the information. None takes the scores, whose
            outer products sum to the information on average.
        prior: (parameters, parameters), the part of the information that comes from priors.

    Returns:
        Covariance, its degrees of freedom and design effects.

    Source:
        Bell & McCaffrey, Survey Methodology 28, 2002; Cameron, Gelbach & Miller, J. Bus. Econ.
        Stat. 29, 2011.
    """
    count = len(information)
    root = np.linalg.cholesky(information)
    whitened = solve_triangular(root, scores, lower=True)
    leverage = whitened if slopes is None else solve_triangular(root, slopes, lower=True)
    contrasts = solve_triangular(root, np.eye(count), lower=True).T  # coefficients as c
    from_data = np.eye(count)
    if prior is not None:
        from_data -= contrasts.T @ prior @ contrasts
    total, entered = np.eye(count), []
    effects, clustered, inside = [], False, []
    for level, cluster in enumerate(levels):
        always = level == 0
        if cluster is None:
            effects.append(np.nan)
            continue
        found = _clustering(whitened, leverage, cluster, from_data)
        freedom = _freedom(found, contrasts)
        if np.isnan(freedom).any():
            effects.append(np.nan)
            continue
        beyond = found.effect > _chance_effect(found)
        effects.append(found.effect)
        clustered |= beyond
        if always or beyond:
            total = total + found.variance
            if always:
                total = total - from_data
            sizes = range(1, len(inside) + 1)
            for others in (some for size in sizes for some in combinations(inside, size)):
                both = _common(cluster, *others)
                if both.max() + 1 == len(cluster):
                    common = found.unclustered
                else:
                    common = _clustering(whitened, leverage, both, from_data).variance
                total = total - (-1) ** (len(others) + 1) * common
            if not always and not inside:
                total = total - found.unclustered
            inside.append(cluster)
            own = np.einsum("ki,ij,kj->k", contrasts, found.variance, contrasts)
            entered.append((own, freedom))
    values, directions = np.linalg.eigh(total)
    axes, lifted = contrasts @ directions, np.maximum(values, THINNEST)
    covariance = axes * lifted @ axes.T
    added = axes**2 @ (lifted - values)  # as uncertain as the measured one
    uncertainty = sum(((own + added) ** 2 / freedom for own, freedom in entered), np.zeros(count))
    with np.errstate(divide="ignore"):
        freedom = np.diagonal(covariance) ** 2 / uncertainty
    effect = max(float(np.trace(total)) / count, 1.0) if clustered else 1.0
    return Robustness(covariance, freedom, tuple(effects), effect)


def _common(*levels: np.ndarray) -> np.ndarray:
    """Number the intersections of several levels' clusters, (samples,)."""
    return np.unique(np.stack(levels), axis=1, return_inverse=True)[1].ravel()


def _clustering(
    whitened: np.ndarray, leverage: np.ndarray, cluster: np.ndarray, from_data: np.ndarray
) -> _Clustering:
    """Return the shares A_g, the corrections B_g and V of the clusters that occur."""
    count = len(whitened)
    present = np.bincount(cluster) > 0

    def sum_by_cluster(values: np.ndarray) -> np.ndarray:
        return np.bincount(cluster, values)[present]

    sums = np.stack([sum_by_cluster(row) for row in whitened], axis=-1)
    products = np.empty((len(sums), count, count))
    for i in range(count):
        for j in range(i + 1):
            products[:, i, j] = products[:, j, i] = sum_by_cluster(leverage[i] * leverage[j])
    root = _power(from_data, 0.5)
    scale = root @ _power(products.sum(axis=0), -0.5)
    shares = scale @ products @ scale.T
    unclustered = whitened @ whitened.T
    scale = root @ _power(unclustered, -0.5)
    widening = _power(np.eye(count) - shares, -0.5)
    taken = np.einsum("gij,gj->gi", widening, sums)
    to_size = np.einsum("gij,gj->gi", widening, sums @ scale.T)
    effect = float(np.sum(to_size**2) / np.trace(from_data))
    return _Clustering(shares, widening, taken.T @ taken, unclustered, effect)


def _power(matrices: np.ndarray, power: float) -> np.ndarray:
    """Raise symmetric matrices (..., P, P) to a power; zero eigenvalues stay 0."""
    values, directions = np.linalg.eigh((matrices + np.swapaxes(matrices, -1, -2)) / 2)
    extended = values > WHOLE
    powers = np.where(extended, np.where(extended, values, 1) ** power, 0)
    return (directions * powers[..., None, :]) @ np.swapaxes(directions, -1, -2)


def _freedom(found: _Clustering, contrasts: np.ndarray) -> Float[np.ndarray, " parameters"]:
    """Return the degrees of freedom (tr G)^2 / tr G^2 of each coefficient; NaN if clusters leave no
    residual. A single cluster with a prior also gives NaN, because its residual shows only how far
    the prior's mean is from the truth.
    """
    if len(found.shares) < 2:
        return np.full(len(contrasts), np.nan)
    b = np.einsum("gij,kj->kgi", found.widening, contrasts)
    a = np.einsum("gij,kgj->kgi", found.shares, b)
    own, taken = np.sum(b * a, axis=-1), np.sum(a * a, axis=-1)
    across = np.einsum("kgi,kgj->kij", a, a)
    trace = np.sum(own - taken, axis=-1)
    squares = np.sum(own**2 - 2 * own * taken, axis=-1) + np.sum(across**2, axis=(-1, -2))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(squares > WHOLE * trace**2, trace**2 / squares, np.nan)


def _chance_effect(found: _Clustering) -> float:
    """Return the design effect that independent residuals exceed with probability `CHANCE`. tr V is
    a quadratic form of the residuals with the matrix delta_gh C_g - D_g D_h^T, where C_g = B_g A_g
    B_g and D_g = B_g A_g.
    """
    d = found.widening @ found.shares
    c = d @ found.widening
    outer = np.einsum("gij,gik->jk", d, d)
    mixed = np.einsum("gij,gik,gjk->", c, d, d)
    squares = np.sum(c**2) - 2 * mixed + np.sum(outer * outer)
    freedom = float(np.trace(found.shares.sum(axis=0))) ** 2 / squares
    return float(chdtri(freedom, CHANCE) / freedom)


def curvature_stretch(
    information: Float[np.ndarray, "parameters parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
) -> Float[np.ndarray, "parameters parameters"]:
    """Return C with C^T information C = covariance^-1, which stretches a density to this
    curvature."""
    own = np.linalg.cholesky(information)
    wanted = np.linalg.cholesky(np.linalg.inv(covariance))
    return np.linalg.solve(own.T, wanted.T)
