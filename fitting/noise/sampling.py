"""Sampling errors of the mean and the variance of a few frames."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .levels import Levels
from .shared import SharedNoise


class SamplingErrors(eqx.Module):
    """Sampling (co)variances of a level's mean and temporal variance.

    Attributes:
        mean: (levels,) variance of the mean, DN^2.
        variance: (levels,) variance of the variance, DN^4.
        both: (levels,) their covariance, DN^3.
    """

    mean: Float[Array, " levels"]
    variance: Float[Array, " levels"]
    both: Float[Array, " levels"]


def sampling_errors(
    levels: Levels, shot_variance: Array, gain: Array, *, shared: SharedNoise | None = None
) -> SamplingErrors:
    """Sampling (co)variances of mean and variance over n pixels and L frames."""
    shot = jnp.maximum(shot_variance, 0)
    n, frames = levels.pixels, levels.frames
    mean = levels.variance / (n * frames)
    variance = (2 * levels.variance**2 / (frames - 1) + gain**2 * shot / frames) / n
    if levels.unsteady is not None:
        mean = mean + levels.unsteady / frames
    if shared is not None:
        mean = mean + shared.of_mean / frames
        variance = variance + shared.of_variance / (frames - 1)
    return SamplingErrors(mean=mean, variance=variance, both=gain * shot / (n * frames))
