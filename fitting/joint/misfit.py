"""The covariance of a fit whose model misses the surface: what it misses goes together within an
image, so that cells do not count as independent, and images stand for independent data instead.

The log likelihood is a sum over images, each with its own scores and information; their sandwich
(`inference.clustering`) replaces the inverse information wherever it is larger: a misfit that is
the same under all lights moves no image against another. What priors, flats and darks add to the
information stays as it is.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..inference.clustering import Robustness, cluster_robust, curvature_stretch
from ..inference.newton import twice
from .fit import JointFit
from .model import JointData, log_likelihood, log_posterior


def over_images(fit: JointFit) -> Robustness | None:
    """The sandwich covariance of a fit that needed a misfit.

    Args:
        fit: of one channel.

    Returns:
        Covariance and its degrees of freedom; None where the model explains the images, or where
        pixels share errors between images, which ties these together.
    """
    if fit.unexplained is None or "prnu" in fit.values:
        return None
    scores, information = (
        np.asarray(x, np.float64) for x in _by_image(jnp.asarray(fit.vector), fit.data)
    )
    images, count = scores.shape
    values, axes = np.linalg.eigh(information)
    halves = axes * np.sqrt(np.maximum(values, 0))[:, None]  # columns: an image's slopes
    columns = np.zeros((count, images, count))
    columns[:, :, 0] = scores.T
    found = cluster_robust(
        columns.reshape(count, -1),
        fit.information,
        np.repeat(np.arange(images), count),
        None,
        slopes=np.moveaxis(halves, 1, 0).reshape(count, -1),
        prior=fit.information - information.sum(axis=0),
    )
    root = np.linalg.cholesky(fit.information)
    ratio, axes = np.linalg.eigh(root.T @ found.covariance @ root)
    half = np.linalg.solve(root.T, axes * np.sqrt(np.maximum(ratio, 1)))
    return replace(found, covariance=half @ half.T)


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
def _by_image(
    vector: Array, data: JointData
) -> tuple[Float[Array, "images parameters"], Float[Array, "images parameters parameters"]]:
    """Gradient of each image's log likelihood, and minus its second derivatives."""
    images = {"cells": data.cells, "relative": data.relative}

    def of(image: dict) -> tuple[Array, Array]:
        one = jax.tree.map(lambda x: x[None], image)
        alone = JointData(
            space=data.space, form=data.form, known=data.known, levels=None, white=data.white, **one
        )
        _, gradient, information = twice(lambda v, d: -log_likelihood(v, d), vector, alone)
        return -gradient, information

    return jax.lax.map(of, images)
