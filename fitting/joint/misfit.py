"""The covariance of a fit over its images, and a posterior with that covariance.

The misfit of a model is correlated within an image, so cells are not independent. Images count as
the independent data, or regions of lights if neighbours have similar errors. Each image has its own
scores and information; their sandwich (`inference.clustering`) replaces the inverse information of
surface and encoding. The information from priors, flats and darks is unchanged. Where pixels share
errors between images, scores are scaled to the information of their sum.

Chi-square does not reveal the misfit: a free gain and read noise absorb it as photon noise, and
cells of single pixels have no scatter to separate the two. The scores of the images do reveal it.
Their sum is zero at the best fit, and their size is that of the noise if cells have independent
errors. No test with few images detects errors as large as the noise. The sandwich is therefore
always used, as in `from_images.fit`, unless the rig states errors of images and the images show no
larger ones.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtri

from ..inference.clustering import Robustness, cluster_robust
from ..inference.neighbours import regions
from ..inference.newton import twice
from ..inference.parameters import names
from ..reflectance.from_images.read import Photographs
from ..reflectance.from_images.stated import ROUNDING, no_more_than
from .candidates import MISFIT
from .fit import JointFit
from .model import (
    BY_IMAGE,
    Images,
    JointData,
    by_image,
    log_likelihood,
    log_likelihood_by_image,
    of_one_image,
    of_surface,
)

CHANCE = 1e-3  # of calling images that agree within their noise ones that do not


def over_images(observation: Photographs, fit: JointFit) -> Robustness | None:
    """Return the sandwich covariance of a fit whose images err independently, or None if the rig
    states errors of images and the images show no larger ones.

    Its design effect measures the disagreement of images: the mean square of their scores over that
    of independent cells, and 1 if that is within chance.
    """
    vector = jnp.asarray(fit.vector)
    scores, information = (np.asarray(x, np.float64) for x in _by_image(vector, fit.data))
    prior = fit.information - np.asarray(_of_images(vector, fit.data), np.float64)
    own = of_surface(fit.space)
    if fit.data.cells.products is None:
        own |= np.array([p.name == MISFIT.name for p in fit.space])
    among = np.ix_(own, own)
    total, seen, slopes = fit.information[among], scores[:, own], information[:, own][:, :, own]
    if fit.data.cells.products is not None:
        root = np.linalg.cholesky(total - prior[among])
        scale = root @ np.linalg.inv(np.linalg.cholesky(slopes.sum(axis=0)))
        seen, slopes = seen @ scale.T, scale @ slopes @ scale.T
    effect, chance = _disagreement(total, seen, slopes)
    places = observation.wi[fit.grid.lights].mean(axis=1)
    alike = regions(seen.T, np.arange(len(seen)), places)
    found = _sandwich(seen, slopes, total, prior[among], alike)
    model = np.linalg.inv(total)
    stated = not set(BY_IMAGE).isdisjoint(names(fit.space))
    if fit.unexplained is not None:
        found = replace(found, covariance=_at_least(found.covariance, total))
    elif stated and effect <= chance and no_more_than(found, model):
        return None
    covariance, freedom = np.linalg.inv(fit.information), np.full(len(own), np.inf)
    covariance[among] += found.covariance - model
    freedom[own] = found.freedom
    disagree = fit.unexplained is not None or effect > chance
    return replace(
        found,
        covariance=covariance,
        freedom=freedom,
        design_effect=max(effect, 1 + ROUNDING) if disagree else 1.0,
    )


def _disagreement(
    total: np.ndarray, scores: np.ndarray, information: np.ndarray
) -> tuple[float, float]:
    """Mean square of the images' scores relative to independent cells, and the limit that chance
    exceeds once in `CHANCE`."""
    root = np.linalg.inv(np.linalg.cholesky(total))
    shares = root @ information @ root.T
    expected = float(np.trace(shares.sum(axis=0)))
    freedom = expected**2 / float(np.sum(shares**2))
    square = float(np.sum((scores @ root.T) ** 2))
    return square / expected, float(chdtri(freedom, CHANCE) / freedom)


def _sandwich(
    scores: np.ndarray,
    information: np.ndarray,
    total: np.ndarray,
    prior: np.ndarray,
    alike: np.ndarray,
) -> Robustness:
    """The sandwich over regions of images, which `alike` numbers."""
    images, count = scores.shape
    values, axes = np.linalg.eigh(information)
    halves = axes * np.sqrt(np.maximum(values, 0))[:, None]  # columns: an image's slopes
    columns = np.zeros((count, images, count))
    columns[:, :, 0] = scores.T
    return cluster_robust(
        columns.reshape(count, -1),
        total,
        np.repeat(alike, count),
        slopes=np.moveaxis(halves, 1, 0).reshape(count, -1),
        prior=prior,
    )


def _at_least(covariance: np.ndarray, information: np.ndarray) -> np.ndarray:
    """The covariance, at least the inverse of the information: a misfit that is equal under all
    lights does not make images disagree."""
    root = np.linalg.cholesky(information)
    ratio, axes = np.linalg.eigh(root.T @ covariance @ root)
    half = np.linalg.solve(root.T, axes * np.sqrt(np.maximum(ratio, 1)))
    return half @ half.T


@eqx.filter_jit
def _of_images(vector: Array, data: JointData) -> Float[Array, "parameters parameters"]:
    """The information from the images, without priors and uniform frames."""
    alone = replace(data, levels=None)
    return twice(lambda v, d: -log_likelihood(v, d), vector, alone)[2]


@eqx.filter_jit
def _by_image(
    vector: Array, data: JointData
) -> tuple[Float[Array, "images parameters"], Float[Array, "images parameters parameters"]]:
    """Gradient of the log likelihood with respect to the parameters of each image, and minus its
    second derivatives. Without pixel errors that images share, it is a sum over images."""
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
