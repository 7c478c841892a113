"""The uncertainty of a joint fit, from the disagreement of its images and from the uncertainty of
the fitted scales of errors.

The misfit of a model is correlated within an image, so cells are not independent. The independent
data are therefore the images, or groups of images with neighbouring lights if these have similar
errors. The score of an image is the gradient of its log likelihood. The sandwich covariance
(`inference.clustering`) of the scores replaces the inverse information of surface and encoding. The
information from priors, flats and darks is unchanged. If a pixel has the same error in several
images, the scores of these images are rescaled to the information of all images together.

Chi-square does not reveal the misfit. Fitted gain and read noise absorb the misfit as photon noise,
and cells of single pixels have no scatter to separate misfit and noise. The scores of the images do
reveal a misfit. The sum of the scores is zero at the best fit, and the scores are as large as the
noise implies if cells have independent errors. With few images no test detects errors as large as
the noise. The sandwich covariance is therefore always used, as in `from_images.fit`, unless the rig
states errors of images and these explain the scores.

With a wrong model, the best shape of the lobe may differ between lights, which the curvature at one
optimum does not reveal. The images are therefore also fitted in two halves. The estimates from two
independent halves differ by about twice the standard error of the fit to all images. If the
estimates differ by far more, half of their difference is used as the standard error (the
random-groups estimate for two groups).

With few lights, the scale s of the lights' errors is poorly known, and so are intervals that depend
on s. If ln s has the standard error t, the variance s^2 has 1 / (2 t^2) degrees of freedom, and the
interval is that of Student's t. If s contributes only the part

    a = d ln variance / d ln s^2

of a parameter's variance, the number of degrees of freedom is 1 / (2 a^2 t^2) by Satterthwaite's
rule. For several scales, the inverses of these numbers of degrees of freedom add.

The scatter of pixels may exceed photon and read noise because of unequal pixel gains or a texture.
The sample variance s^2 of n pixels of a cell scatters about the model's variance v with the
variance 2 v^2 / (n - 1). Unequal gains with a relative standard deviation p add p^2 R^2 to v, where
R is the response of a pixel to a relative change of the light. The estimate of p^2 is the slope of
a regression of s^2 - v on R^2, after projection of R^2 on the part that gain and read noise cannot
explain (score test: Rao, Proc. Cambridge Phil. Soc. 44, 1948). Insignificant unequal gains may
still bias the parameters, above all system gain and read noise, by the vector p^2 C J. Here C is
the posterior's covariance and J = dv^T W R^2, with dv the derivatives of v and W the weights n / (2
v^2) of variances.

Source:
    Satterthwaite, "An Approximate Distribution of Estimates of Variance Components", Biometrics
    Bulletin 2, 1946.
"""

from dataclasses import dataclass, replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import chdtri, ndtri

from jaxvision.core.parallel_loops import map_
from jaxvision.core.side_by_side import side_by_side

from ..inference.clustering import Robustness, cluster_robust
from ..inference.importance import FAR, gaussian_miss
from ..inference.neighbours import regions
from ..inference.newton import minimise, second_derivatives
from ..inference.parameters import names, to_natural
from ..reflectance.from_images.lights import ROUNDING, no_more_than
from ..reflectance.from_images.read import Photographs
from ..reflectance.from_images.signal import Matrix, Vector
from .fit import MISFIT, JointFit, fit_turned
from .model import (
    BY_IMAGE,
    SCATTERS,
    JointData,
    cost,
    log_likelihood,
    log_likelihood_by_image,
    log_posterior,
    predicted,
    surface_mask,
    values_at,
)

CHANCE = 1e-3  # probability of a false finding that images disagree
FEWEST_IMAGES = 12  # images needed so that halves still determine a surface
APART = 3.0  # standard deviations between halves from which they disagree
STEP = 0.1  # step of ln s for the slopes of the variances
NOISE = ("system_gain", "read_noise")  # parameters that absorb unequal pixels
TYPICAL = 0.01  # rms of relative pixel gains that few cameras exceed
TOLERATED = 0.5  # accepted bias of gain or read noise, standard errors
BEYOND_CHANCE = 5.0  # standard errors from 0 at which pixel gains are significant
ONE_SIDED = float(ndtri(0.95))
ALONE = 1e-9  # share of R^2 left by gain and read noise below which it is rounding


# ---------------------------------------------------------------- images


def image_sandwich(observation: Photographs, fit: JointFit) -> Robustness | None:
    """Return the sandwich covariance of a fit, for images with independent errors. Return None if
    the rig states errors of images and these explain the disagreement of the images.

    The design effect of the result measures the disagreement of images: the mean square of the
    images' scores divided by that for independent cells, or 1 if chance explains this ratio.
    """
    vector = jnp.asarray(fit.vector)
    scores, information = (np.asarray(x, np.float64) for x in _image_scores(vector, fit.data))
    prior = fit.information - np.asarray(_information_of_images(vector, fit.data), np.float64)
    own = surface_mask(fit.space)
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
    if fit.unexplained is not None:  # a misfit that is equal under all lights makes images agree
        found = replace(found, covariance=_enlarge_covariance(found.covariance, total))
    elif stated and effect <= chance and no_more_than(found, model):
        return None
    covariance, freedom = np.linalg.inv(fit.information), np.full(len(own), np.inf)
    covariance[among] += found.covariance - model
    freedom[own] = found.freedom
    disagree = fit.unexplained is not None or effect > chance
    effect = max(effect, 1 + ROUNDING) if disagree else 1.0
    return replace(found, covariance=covariance, freedom=freedom, design_effect=effect)


def _disagreement(
    total: Matrix, scores: np.ndarray, information: np.ndarray
) -> tuple[float, float]:
    """Return the images' mean squared score over its expectation, and the limit of chance."""
    root = np.linalg.inv(np.linalg.cholesky(total))
    shares = root @ information @ root.T
    expected = float(np.trace(shares.sum(axis=0)))
    freedom = expected**2 / float(np.sum(shares**2))
    square = float(np.sum((scores @ root.T) ** 2))
    return square / expected, float(chdtri(freedom, CHANCE) / freedom)


def _sandwich(
    scores: np.ndarray, information: np.ndarray, total: Matrix, prior: Matrix, alike: np.ndarray
) -> Robustness:
    """Return the sandwich covariance over groups of images; `alike` is each image's group."""
    images, count = scores.shape
    values, axes = np.linalg.eigh(information)
    halves = axes * np.sqrt(np.maximum(values, 0))[:, None]  # columns are the slopes of an image
    columns = np.zeros((count, images, count))
    columns[:, :, 0] = scores.T
    slopes = np.moveaxis(halves, 1, 0).reshape(count, -1)
    labels = np.repeat(alike, count)
    return cluster_robust(columns.reshape(count, -1), total, labels, slopes=slopes, prior=prior)


def _enlarge_covariance(covariance: Matrix, information: Matrix) -> Matrix:
    """Return the covariance, nowhere smaller than the information's inverse."""
    root = np.linalg.cholesky(information)
    ratio, axes = np.linalg.eigh(root.T @ covariance @ root)
    half = np.linalg.solve(root.T, axes * np.sqrt(np.maximum(ratio, 1)))
    return half @ half.T


@eqx.filter_jit
def _information_of_images(vector: Array, data: JointData) -> Float[Array, "parameters parameters"]:
    """Return the information from the images, without priors, flats and darks."""
    alone = replace(data, levels=None)
    return second_derivatives(lambda v, d: -log_likelihood(v, d), vector, alone)[2]


@eqx.filter_jit
def _image_scores(
    vector: Array, data: JointData
) -> tuple[Float[Array, "images parameters"], Float[Array, "images parameters parameters"]]:
    """Return, for each image, the gradient of its log likelihood with respect to the parameters,
    and the negative second derivatives. The log likelihoods of images without common errors add up.
    Therefore a single derivative of the sum, with separate parameters for each image, gives the
    scores of all images.
    """
    count = data.cells.count.shape[0]
    alike = jnp.broadcast_to(vector, (count, vector.size))
    slope = jax.grad(lambda vectors: -log_likelihood_by_image(vectors, data))
    units = jnp.eye(vector.size, dtype=vector.dtype)

    def bend(moved: Array) -> Array:
        return jax.jvp(slope, (alike,), (moved,))[1]

    def image_information(image: Array) -> Array:
        nothing = jnp.zeros_like(alike)
        return jax.vmap(lambda unit: bend(nothing.at[image].set(unit))[image])(units)

    if data.cells.products is None and data.turn_precision is None:
        every = map_(lambda unit: bend(jnp.broadcast_to(unit, alike.shape)), units)
        information = jnp.swapaxes(every, 0, 1)
    else:
        information = map_(image_information, jnp.arange(count))
    return -slope(alike), information


# ---------------------------------------------------------------- halves


@dataclass(frozen=True)
class Halves:
    """The fits of the same model to the even and to the odd images.

    Source:
        Wolter, Introduction to Variance Estimation, 2nd ed. 2007, chapter 2.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, "halves parameters"]  # in the parameters' units
    difference: Vector  # of the two, unconstrained
    # the difference in its standard deviations; 0 for parameters other than surface and encoding,
    # because noise and misfit may differ between halves
    deviations: Vector

    @property
    def agree(self) -> bool:
        return bool((np.abs(self.deviations) < APART).all())


def fit_halves(
    observation: Photographs, channel: int, fit: JointFit, robust: Robustness
) -> Halves | None:
    """Fit the even and the odd images of one channel separately. `robust` is the covariance of the
    fit to all images. Return None for fewer than `FEWEST_IMAGES` images, and if a half does not
    determine the model.
    """
    images = np.flatnonzero(~observation.held_out)
    if len(images) < FEWEST_IMAGES:
        return None
    others = [~np.isin(np.arange(len(observation.held_out)), images[half::2]) for half in (0, 1)]
    fits = side_by_side(
        [
            partial(fit_turned, replace(observation, held_out=left), channel, fit.form)
            for left in others
        ]
    )
    if not all(half.converged and half.space == fit.space for half in fits):
        return None
    vectors = np.stack([half.vector for half in fits])
    difference = vectors[0] - vectors[1]
    return Halves(
        names(fit.space),
        np.asarray(to_natural(fit.space, jnp.asarray(vectors))),
        difference,
        surface_mask(fit.space) * difference / (2 * np.sqrt(robust.gaussian_covariance.diagonal())),
    )


def widened(robust: Robustness, halves: Halves) -> Robustness:
    """Widen a covariance over images to include the difference of halves that disagree."""
    if halves.agree:
        return robust
    difference = halves.difference * (halves.deviations != 0)
    return replace(robust, covariance=robust.covariance + np.outer(difference, difference) / 4)


# ---------------------------------------------------------------- scales


def degrees_of_freedom(fit: JointFit, covariance: Matrix) -> Vector | None:
    """Return the degrees of freedom (P,) of the parameters' variances, which are uncertain because
    the scales of errors are fitted. For the variances of the scales themselves, these numbers are
    infinite. Return None if no scale is fitted.
    """
    labels = names(fit.space)
    scales = [i for i, name in enumerate(labels) if name in SCATTERS]
    if not scales:
        return None
    others = np.array([i for i in range(len(labels)) if i not in scales])
    inverse = np.zeros(len(labels))
    for i in scales:
        step = STEP * np.eye(len(labels))[i]
        low, high = (
            np.diagonal(np.linalg.inv(_information(fit, fit.vector + side * step, others)))
            for side in (-1, 1)
        )
        inverse[others] += 2 * (np.log(high / low) / (4 * STEP)) ** 2 * covariance[i, i]
    return 1 / np.maximum(inverse, 1e-12)


def laplace_miss(fit: JointFit, covariance: Matrix) -> Vector:
    """Return, for each of P parameters, the difference between the log density and that of
    Laplace's Gaussian approximation at two standard deviations from the mode.

    `gaussian_miss` evaluates the density along a line. For the scale of a shared error, the density
    after marginalising over the other parameters is used instead, because their posterior volume
    grows with the scale.
    """
    missed = gaussian_miss(log_posterior, jnp.asarray(fit.vector), covariance, fit.data)
    labels = names(fit.space)
    for i in (labels.index(name) for name in labels if name in SCATTERS):
        others = np.delete(np.arange(len(labels)), i)
        step = FAR * covariance[i] / np.sqrt(covariance[i, i])
        volumes = [
            np.linalg.slogdet(_information(fit, fit.vector + side * step, others))[1] / 2
            for side in (-1, 0, 1)
        ]
        missed[i] += np.max(np.abs(np.array(volumes) - volumes[1]))
    return missed


def _information(fit: JointFit, vector: Vector, kept: Int[np.ndarray, " kept"]) -> Matrix:
    """Return the information on some parameters at any point, with the others fixed."""
    there = minimise(cost, jnp.asarray(vector), fit.data, max_steps=1)
    return np.asarray(there.information, np.float64)[np.ix_(kept, kept)]


# ---------------------------------------------------------------- pixels


@dataclass(frozen=True)
class UnequalPixels:
    """Unequal pixel gains, estimated from the scatter of pixels."""

    size: float  # relative, rms; 0 if the scatter rises less than photon noise
    deviations: float  # distance of the squared size from 0, in standard errors
    # largest relative size, rms, that is compatible with the data: the upper 95 % limit, at most
    # `TYPICAL`
    most: float
    moved: float  # standard errors by which `most` would move the gain or the read noise

    @property
    def are_significant(self) -> bool:
        """Return whether unequal pixels are significant and so part of the fitted noise."""
        return self.deviations > BEYOND_CHANCE

    def hide_noise(self, stated: bool) -> bool:
        """Return whether unequal pixel gains make system gain and read noise unidentifiable.
        `stated` is whether the rig states the size of the differences between pixel gains.
        """
        return self.are_significant or (not stated and self.moved > TOLERATED)


def unequal_pixels(fit: JointFit) -> UnequalPixels:
    """Estimate the relative rms of pixel gains by a score test of equal ones."""
    cells = fit.data.cells
    count = np.asarray(cells.count, np.float64)
    freedom = count - 1
    used = freedom > 0
    variance, relative, slopes = (
        np.asarray(x, np.float64) for x in _pixel_variance(jnp.asarray(fit.vector), fit.data)
    )
    weight = np.sqrt(freedom[used] / 2) / variance[used]
    beyond = (np.asarray(cells.scatter, np.float64)[used] / freedom[used] - variance[used]) * weight
    column = relative[used] ** 2 * weight
    known = slopes[:, used].T * weight[:, None]
    left = column - known @ np.linalg.lstsq(known, column)[0]
    # the larger shift of gain or read noise for p^2 = 1, in standard errors
    covariance = np.linalg.pinv(fit.information)
    weighted = np.where(count > 0, count / (2 * variance**2), 0) * relative**2
    shift = covariance @ np.sum(slopes * weighted, axis=(1, 2)) / np.sqrt(covariance.diagonal())
    noise = [i for i, parameter in enumerate(fit.space) if parameter.name in NOISE]
    moved = float(np.max(np.abs(shift[noise]), initial=0.0))
    if left @ left <= ALONE * (column @ column):  # too few cells of several pixels
        return UnequalPixels(0.0, 0.0, TYPICAL, TYPICAL**2 * moved)
    square, error = float(left @ beyond / (left @ left)), 1 / float(np.linalg.norm(left))
    most = min((max(square, 0.0) + ONE_SIDED * error) ** 0.5, TYPICAL)
    return UnequalPixels(max(square, 0.0) ** 0.5, square / error, most, most**2 * moved)


@eqx.filter_jit
def _pixel_variance(vector: Array, data: JointData) -> tuple[Array, Array, Array]:
    """Return a pixel's variance, its response R to light, and the variance's derivatives."""

    def variance(v: Array) -> Array:
        return predicted(values_at(v, data), data, data.cells).variance

    model = predicted(values_at(vector, data), data, data.cells)
    slopes = jax.vmap(lambda e: jax.jvp(variance, (vector,), (e,))[1])(jnp.eye(vector.size))
    return model.variance, model.relative, slopes
