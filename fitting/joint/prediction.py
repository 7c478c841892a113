"""Prediction of single pixels by a joint fit, with standard deviations."""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..reflectance.from_images.read import Photographs
from .cells import DARKEST, image_geometry, pixels_at
from .fit import JointFit
from .model import BY_IMAGE, Cells, JointData, predicted, scatter_scales, values_at

GAUSSIAN_BAND = 1.96  # half-width of a 95 % band, standard deviations


@dataclass(frozen=True)
class PixelPrediction:
    """The prediction of one image in one channel.

    Attributes:
        mean: (pixels,) expected DN.
        deviation: (pixels,) standard deviation due to noise, shared errors and parameters together,
            DN.
        usable: (pixels,) whether a pixel is lit and far enough from both ends of the scale.
    """

    mean: Float[np.ndarray, " pixels"]
    deviation: Float[np.ndarray, " pixels"]
    usable: Bool[np.ndarray, " pixels"]


def predict(
    measurement: Photographs,
    fit: JointFit,
    covariance: Float[np.ndarray, "parameters parameters"],
    light: int,
) -> PixelPrediction:
    """Predict the image under one light as if it had not been taken.

    Args:
        measurement: the photographs of the fit.
        fit: fit of one channel.
        covariance: (P, P) covariance of the fit's parameters on the unconstrained scale.
        light: index of the light, held out or not.

    Returns:
        The prediction; NaN for pixels that are not lit.
    """
    channel = measurement.channels.index(fit.channel)
    expected, usable = pixels_at(measurement, channel, light, fit.values, fit.form)
    points = replace(measurement, within=None)
    more = expected - pixels_at(points, channel, light, fit.values, fit.form)[0]
    zero = jnp.zeros((1, len(usable)))
    above = (expected - float(fit.values["black_level"])) / measurement.white
    pixels = Cells(  # each pixel is a cell
        image_geometry(measurement, channel, light, turns=fit.grid.turns),
        *(jnp.asarray(usable[None], zero.dtype), zero, zero, jnp.asarray(more[None])),
        jnp.asarray(np.maximum(above, DARKEST)[None]),
    )
    scales = scatter_scales(measurement)
    relative = {n: jnp.asarray(scales[n][1][[light]]) for n in BY_IMAGE if n in scales}
    data = eqx.tree_at(lambda d: (d.cells, d.relative), fit.data, (pixels, relative))
    mean, variance = _moments(jnp.asarray(fit.vector), jnp.asarray(covariance), data)
    lit = np.where(usable, 1.0, np.nan)
    return PixelPrediction(
        mean=np.asarray(mean) * lit, deviation=np.sqrt(np.asarray(variance)) * lit, usable=usable
    )


@eqx.filter_jit
def _moments(vector: Array, covariance: Array, data: JointData) -> tuple[Array, Array]:
    """Return the mean and the variance (pixels,) of the digital numbers of one image."""

    def mean_of(vector: Array) -> Array:
        return predicted(values_at(vector, data), data, data.cells).mean[0]

    model = predicted(values_at(vector, data), data, data.cells)
    slopes = jax.jacfwd(mean_of)(vector)
    variance = model.pixel_variance[0] + jnp.sum((slopes @ covariance) * slopes, axis=1)
    if model.image_errors is not None:
        variance = variance + jnp.sum(model.image_errors[0] ** 2, axis=0)
    return model.mean[0], variance


@dataclass(frozen=True)
class Score:
    """The accuracy of the images that the fit of one channel predicts."""

    channel: str
    # RMS of predicted minus measured over the RMS signal, on the fitted lights
    fitted_error: float
    predicted_error: float | None  # on the held-out ones; None without any
    band: float  # half-width, in predicted standard deviations of a pixel
    fitted_share: float  # of pixels within the predicted 95 % band, on the lights of the fit
    unseen_share: float | None  # on the held-out ones; None without any


def score(
    observation: Photographs, fit: JointFit, covariance: Float[np.ndarray, "parameters parameters"]
) -> Score:
    """Compare the predictions of one channel with its images."""
    channel = observation.channels.index(fit.channel)
    sums = np.zeros((2, 2))  # squared errors, squared signals
    distances: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])  # standard deviations
    for light, held_out in enumerate(observation.held_out):
        made = predict(observation, fit, covariance, light)
        dn = observation.dn[channel, light][made.usable]
        miss = dn - made.mean[made.usable]
        signal = dn - observation.black
        sums[int(held_out)] += (miss @ miss, signal @ signal)
        distances[int(held_out)].append(np.abs(miss) / made.deviation[made.usable])
    error = np.sqrt(sums[:, 0] / np.maximum(sums[:, 1], 1))
    fitted, unseen = (np.concatenate(d) if d else np.zeros(0) for d in distances)
    band = GAUSSIAN_BAND if fit.unexplained is None else float(np.quantile(fitted, 0.95))
    tested = unseen.size > 0
    return Score(
        channel=fit.channel,
        fitted_error=float(error[0]),
        predicted_error=float(error[1]) if tested else None,
        band=band,
        fitted_share=float(np.mean(fitted < band)),
        unseen_share=float(np.mean(unseen < band)) if tested else None,
    )
