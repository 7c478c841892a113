"""The covariance of a fit whose model misses the surface: what it misses goes together within an
image, so that cells do not count as independent, and images stand for independent data instead.

Each image has its own scores and information; their sandwich (`inference.clustering`) replaces the
inverse information wherever it is larger: a misfit that is the same under all lights moves no image
against another. What priors, flats and darks add to the information stays as it is.
Where pixels share errors between images, scores are scaled to the information of their sum.

Chi-square does not tell whether the model misses: a free gain and read noise take what it misses
for photons, and cells of single pixels leave nothing to tell these apart by. The scores of the
images do, whose sum is zero at the best fit and whose size is that of the noise where cells err on
their own.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtri

from ..inference.clustering import Robustness, cluster_robust, curvature_stretch
from ..inference.newton import twice
from .fit import MISFIT, JointFit
from .model import (
    Images,
    JointData,
    by_image,
    log_likelihood,
    log_likelihood_by_image,
    log_posterior,
    of_one_image,
)
from .start import SCATTERS

CHANCE = 1e-3  # of calling images that agree within their noise ones that do not


def over_images(fit: JointFit) -> Robustness | None:
    """The sandwich covariance of a fit whose images do not agree within their noise.

    Args:
        fit: of one channel.

    Returns:
        Covariance and its degrees of freedom; its design effect is by how much the images disagree:
        the mean square of their scores over that of independent cells. None where the model
        explains the images.
    """
    vector = jnp.asarray(fit.vector)
    scores, information = (np.asarray(x, np.float64) for x in _by_image(vector, fit.data))
    effect, chance = _disagreement(fit, scores, information)
    if fit.unexplained is None and effect <= chance:
        return None
    prior = fit.information - np.asarray(_of_images(vector, fit.data), np.float64)
    if fit.data.cells.products is None:
        found = _sandwich(scores, information, fit.information, prior)
        return replace(found, design_effect=max(effect, 1.0))
    kept = _own(fit)
    among = np.ix_(kept, kept)
    own, total = fit.information[among], information[:, kept][:, :, kept]
    scale = np.linalg.cholesky(own - prior[among]) @ np.linalg.inv(
        np.linalg.cholesky(total.sum(axis=0))
    )
    scaled = np.einsum("ab,ibc,dc->iad", scale, total, scale)
    part = _sandwich(scores[:, kept] @ scale.T, scaled, own, prior[among])
    covariance, freedom = np.linalg.inv(fit.information), np.full(len(kept), np.inf)
    covariance[among] += part.covariance - np.linalg.inv(own)
    freedom[kept] = part.freedom
    return replace(part, covariance=covariance, freedom=freedom, design_effect=max(effect, 1.0))


def _sandwich(
    scores: np.ndarray, information: np.ndarray, total: np.ndarray, prior: np.ndarray
) -> Robustness:
    """Over images, nowhere below the inverse of the total information."""
    images, count = scores.shape
    values, axes = np.linalg.eigh(information)
    halves = axes * np.sqrt(np.maximum(values, 0))[:, None]  # columns: an image's slopes
    columns = np.zeros((count, images, count))
    columns[:, :, 0] = scores.T
    found = cluster_robust(
        columns.reshape(count, -1),
        total,
        np.repeat(np.arange(images), count),
        None,
        slopes=np.moveaxis(halves, 1, 0).reshape(count, -1),
        prior=prior,
    )
    root = np.linalg.cholesky(total)
    ratio, axes = np.linalg.eigh(root.T @ found.covariance @ root)
    half = np.linalg.solve(root.T, axes * np.sqrt(np.maximum(ratio, 1)))
    return replace(found, covariance=half @ half.T)


def _own(fit: JointFit) -> np.ndarray:
    """(P,) which parameters are those of surface and sensor, no scales of shared errors."""
    return np.array([p.name not in (*SCATTERS, MISFIT.name) for p in fit.space])


def _disagreement(
    fit: JointFit, scores: np.ndarray, information: np.ndarray
) -> tuple[float, float]:
    """Mean square of the images' scores of surface and sensor, in units of what independent cells
    make it, and what chance exceeds once in `CHANCE`. The scales of shared errors, whose scores are
    no Gaussian, do not count."""
    kept = _own(fit)
    root = np.linalg.inv(np.linalg.cholesky(fit.information[np.ix_(kept, kept)]))
    shares = root @ information[:, kept][:, :, kept] @ root.T
    expected = float(np.trace(shares.sum(axis=0)))
    freedom = expected**2 / float(np.sum(shares**2))
    square = float(np.sum((scores[:, kept] @ root.T) ** 2))
    return square / expected, float(chdtri(freedom, CHANCE) / freedom)


class Stretched(eqx.Module):
    """Data of `stretched_log_density`.

    Attributes:
        data: of the fit.
        mode: (P,) unconstrained.
        stretch: (P, P), the matrix C of mode + C (vector - mode).
    """

    data: JointData
    mode: Float[Array, " parameters"]
    stretch: Float[Array, "parameters parameters"]


def stretched(fit: JointFit, covariance: Float[np.ndarray, "parameters parameters"]) -> Stretched:
    """A fit whose posterior is to have another covariance.

    Args:
        fit: of one channel.
        covariance: (P, P) on the unconstrained scale.

    Returns:
        Data of `stretched_log_density`.
    """
    stretch = curvature_stretch(fit.information, covariance)
    return Stretched(fit.data, jnp.asarray(fit.vector), jnp.asarray(stretch))


def stretched_log_density(vector: Float[Array, " parameters"], data: Stretched) -> Array:
    """Log posterior density, its argument stretched about the mode.

    Args:
        vector: (P,) unconstrained.
        data: of the fit, with the stretch.

    Returns:
        (), up to a constant.

    Source:
        Ribatet, Cooley & Davison, Statistica Sinica 22, 2012.
    """
    return log_posterior(data.mode + data.stretch @ (vector - data.mode), data.data)


@eqx.filter_jit
def _of_images(vector: Array, data: JointData) -> Float[Array, "parameters parameters"]:
    """The information of the images, without priors and uniform frames."""
    alone = replace(data, levels=None)
    return twice(lambda v, d: -log_likelihood(v, d), vector, alone)[2]


@eqx.filter_jit
def _by_image(
    vector: Array, data: JointData
) -> tuple[Float[Array, "images parameters"], Float[Array, "images parameters parameters"]]:
    """Gradient of the log likelihood by the parameters as they enter each image, and minus its
    second derivatives. Without errors that pixels share between images it is a sum over images."""
    if data.cells.products is None:

        def of(image: Images) -> tuple[Array, Array]:
            alone = of_one_image(data, image)
            _, gradient, information = twice(lambda v, d: -log_likelihood(v, d), vector, alone)
            return -gradient, information

        return jax.lax.map(of, by_image(data))
    count = data.cells.count.shape[0]
    alike = jnp.broadcast_to(vector, (count, vector.size))

    def minus(vectors: Array) -> Array:
        return -log_likelihood_by_image(vectors, data)

    slope = jax.grad(minus)

    def information(image: Array) -> Array:
        return jax.vmap(
            lambda unit: jax.jvp(slope, (alike,), (jnp.zeros_like(alike).at[image].set(unit),))[1][
                image
            ]
        )(jnp.eye(vector.size, dtype=vector.dtype))

    return -slope(alike), jax.lax.map(information, jnp.arange(count))
