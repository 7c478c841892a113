"""What a joint fit predicts of single pixels, with the standard deviation of their numbers."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..reflectance.from_images.read import ReflectanceObservation
from .cells import SMALLEST_COSINE, local_geometry, pixels_at
from .fit import JointFit
from .model import BY_IMAGE, Cells, JointData, predicted, values_at
from .read import JointMeasurement
from .start import scatter_scales


@dataclass(frozen=True)
class PixelPrediction:
    """One image of one channel.

    Attributes:
        mean: (pixels,) expected DN.
        deviation: (pixels,) DN, of noise, shared errors and parameters together.
        usable: (pixels,), which are lit and clear of both ends of the scale.
    """

    mean: Float[np.ndarray, " pixels"]
    deviation: Float[np.ndarray, " pixels"]
    usable: Bool[np.ndarray, " pixels"]


def predict(
    measurement: JointMeasurement,
    fit: JointFit,
    covariance: Float[np.ndarray, "parameters parameters"],
    light: int,
) -> PixelPrediction:
    """The image of one light, as if it had not been taken.

    Args:
        measurement: of the fit.
        fit: of one channel.
        covariance: (P, P) of its parameters on the unconstrained scale.
        light: index, held out or not.

    Returns:
        The prediction; nan for pixels that are not lit.
    """
    observation = measurement.observation
    channel = observation.channels.index(fit.channel)
    _, usable = pixels_at(observation, channel, light, fit.values, fit.data.form)
    usable = usable & (observation.cosine[light] > SMALLEST_COSINE)
    data = eqx.tree_at(
        lambda d: (d.cells, d.relative),
        fit.data,
        (
            _as_cells(observation, channel, light, usable, fit),
            {
                name: jnp.asarray(size[[light]])
                for name, (_, size) in scatter_scales(measurement).items()
                if name in BY_IMAGE
            },
        ),
    )
    mean, variance = _moments(jnp.asarray(fit.vector), jnp.asarray(covariance), data)
    lit = np.where(usable, 1.0, np.nan)
    return PixelPrediction(
        mean=np.asarray(mean) * lit, deviation=np.sqrt(np.asarray(variance)) * lit, usable=usable
    )


def _as_cells(
    observation: ReflectanceObservation, channel: int, light: int, usable: np.ndarray, fit: JointFit
) -> Cells:
    """Each pixel as a cell of its own."""
    irradiance = observation.intensity[channel, light] * observation.falloff[light]
    geometry = local_geometry(
        observation.normals,
        observation.wi[light][None],
        irradiance[None],
        turns=fit.grid.turns,
    )
    zero = jnp.zeros((1, len(usable)))
    return Cells(geometry, jnp.asarray(usable[None], zero.dtype), zero, zero, zero)


@eqx.filter_jit
def _moments(vector: Array, covariance: Array, data: JointData) -> tuple[Array, Array]:
    """(pixels,) mean and variance of the digital numbers of one image."""

    def mean_of(vector: Array) -> Array:
        return predicted(values_at(vector, data), data, data.cells).mean[0]

    values = values_at(vector, data)
    model = predicted(values, data, data.cells)
    slopes = jax.jacfwd(mean_of)(vector)
    variance = model.variance[0] + jnp.sum((slopes @ covariance) * slopes, axis=1)
    if model.image_errors is not None:
        variance = variance + jnp.sum(model.image_errors[0] ** 2, axis=0)
    for name in ("prnu", "misfit"):
        if name in values:
            variance = variance + (values[name] * model.relative[0]) ** 2
    return model.mean[0], variance


@dataclass(frozen=True)
class Score:
    """How well images are predicted.

    Attributes:
        channel: name.
        fitted_error: RMS of predicted less measured over the RMS signal, on the lights of the fit.
        unseen_error: on the held-out ones; None without any.
        fitted_share: of pixels within the predicted 95 % band, on the lights of the fit.
        unseen_share: on the held-out ones; None without any.
    """

    channel: str
    fitted_error: float
    unseen_error: float | None
    fitted_share: float
    unseen_share: float | None


def score(
    measurement: JointMeasurement,
    fit: JointFit,
    covariance: Float[np.ndarray, "parameters parameters"],
) -> Score:
    """Judges the predictions of one channel.

    Args:
        measurement: of the fit.
        fit: of one channel.
        covariance: (P, P) of its parameters on the unconstrained scale.

    Returns:
        The score.
    """
    observation = measurement.observation
    channel = observation.channels.index(fit.channel)
    sums = np.zeros((2, 4))  # squared errors, squared signals, within the band, pixels
    for light, held_out in enumerate(observation.held_out):
        made = predict(measurement, fit, covariance, light)
        dn = observation.dn[channel, light][made.usable]
        miss = dn - made.mean[made.usable]
        inside = np.abs(miss) < 1.96 * made.deviation[made.usable]
        signal = dn - observation.black
        sums[int(held_out)] += (miss @ miss, signal @ signal, inside.sum(), len(dn))
    error = np.sqrt(sums[:, 0] / np.maximum(sums[:, 1], 1))
    share = sums[:, 2] / np.maximum(sums[:, 3], 1)
    tested = bool(sums[1, 3] > 0)
    return Score(
        channel=fit.channel,
        fitted_error=float(error[0]),
        unseen_error=float(error[1]) if tested else None,
        fitted_share=float(share[0]),
        unseen_share=float(share[1]) if tested else None,
    )
