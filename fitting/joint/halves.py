"""Comparison of the surface from two halves of the images, if the model does not describe it.

A wrong model may fit one shape under some lights and another under others, which the curvature at
one optimum does not show. Two halves of independent images differ by twice the standard deviation
of the whole. If they differ by far more, half of their difference is used as the standard deviation
(the random-groups estimate for two groups).
"""

from dataclasses import dataclass, replace
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxvision.core.side_by_side import side_by_side

from ..inference.clustering import Robustness
from ..inference.parameters import names, to_natural
from ..reflectance.from_images.read import Photographs
from .fit import JointFit, fit_turned
from .model import of_surface

FEWEST_IMAGES = 12  # whose halves still determine a surface
APART = 3.0  # standard deviations between halves from which they do not agree


@dataclass(frozen=True)
class Halves:
    """The same fit to the even and to the odd images.

    Source:
        Wolter, Introduction to Variance Estimation, 2nd ed. 2007, chapter 2.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, "halves parameters"]  # in their units
    difference: Float[np.ndarray, " parameters"]  # of the two, unconstrained
    # the same in standard deviations of such a difference; 0 for all but surface and encoding, as
    # noise and misfit may differ between them
    deviations: Float[np.ndarray, " parameters"]

    @property
    def agree(self) -> bool:
        return bool((np.abs(self.deviations) < APART).all())


def by_halves(
    observation: Photographs, channel: int, fit: JointFit, robust: Robustness
) -> Halves | None:
    """Fit the halves of one channel's images, where the fit of all images has the covariance
    `robust`. Returns None for fewer than `FEWEST_IMAGES` images, and if a half does not determine
    the model."""
    images = np.flatnonzero(~observation.held_out)
    if len(images) < FEWEST_IMAGES:
        return None
    fits = side_by_side(
        [partial(_of_images, observation, channel, fit, images[half::2]) for half in (0, 1)]
    )
    if not all(half.converged and half.space == fit.space for half in fits):
        return None
    vectors = np.stack([half.vector for half in fits])
    difference = vectors[0] - vectors[1]
    return Halves(
        names(fit.space),
        np.asarray(to_natural(fit.space, jnp.asarray(vectors))),
        difference,
        of_surface(fit.space) * difference / (2 * np.sqrt(robust.gaussian_covariance.diagonal())),
    )


def widened(robust: Robustness, halves: Halves) -> Robustness:
    """Widen a covariance over images to include the difference of halves that disagree."""
    if halves.agree:
        return robust
    told = halves.difference * (halves.deviations != 0)
    shown = np.outer(told, told) / 4
    return replace(robust, covariance=robust.covariance + shown)


def _of_images(
    observation: Photographs, channel: int, fit: JointFit, images: np.ndarray
) -> JointFit:
    others = np.ones(len(observation.held_out), bool)
    others[images] = False
    return fit_turned(
        replace(observation, held_out=others),
        channel,
        fit.data.form,
    )
