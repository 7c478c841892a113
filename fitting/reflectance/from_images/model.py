"""Samples of photographs, their prediction by a surface and an encoding, and their likelihood.

A pixel at or above the clip level states only that its value is at least that large. It is censored
(Tobin, Econometrica 26, 1958) and contributes log Phi((predicted - clip) / deviation).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...inference.compiled import compiled_briefly
from ...inference.parameters import ParameterSpace, names, to_natural
from ...inference.tails import log_ndtr
from ..models import amplitude
from .signal import GAMMA, Form, Geometry, encoded, signal, surface_parameters


def parameter_space(form: Form) -> ParameterSpace:
    """Parameters of the surface, the ambient term and gamma, as the form requires. All are positive
    and searched as logarithms."""
    ambient = (amplitude("ambient", "k_a", "DN"),) if form.ambient else ()
    return (*surface_parameters(form), *ambient, *((GAMMA,) if form.free_gamma else ()))


class Samples(eqx.Module):
    """Lit pixels of one channel, or cells of similar pixels."""

    form: Form = eqx.field(static=True)
    geometry: Geometry
    dn: Float[Array, " samples"]  # DN
    # DN; a cell of equal pixels is one sample of smaller deviation
    deviation: Float[Array, " samples"]
    saturated: Bool[Array, " samples"] | None  # None where nothing clips
    black: Float[Array, ""]  # DN without light
    white: Float[Array, ""]  # DN of full scale above black
    clip: Float[Array, ""]  # DN from which a pixel is saturated
    gamma: Float[Array, ""] | None  # known encoding; None for linear files or where it is free
    # DN added to a cell's prediction: by how much the mean over its pixels differs from the value
    # at their mean geometry
    offset: Float[Array, " samples"] | None = None


@compiled_briefly
def linear_signal(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """X of the samples at an unconstrained vector, DN above black."""
    space = parameter_space(samples.form)
    natural = to_natural(space, vector)
    values = {name: natural[i] for i, name in enumerate(names(space))}
    return signal(values, samples.form, samples.geometry)


def encoding_gamma(vector: Float[Array, " parameters"], samples: Samples) -> Array | None:
    """The free gamma, the known one, or None for linear files."""
    return jnp.exp(vector[-1]) if samples.form.free_gamma else samples.gamma


@compiled_briefly
def predicted_dn(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """(samples,) DN before clipping, at an unconstrained vector."""
    gamma = encoding_gamma(vector, samples)
    dn = samples.black + encoded(linear_signal(vector, samples), samples.white, gamma)
    return dn if samples.offset is None else dn + samples.offset


def residuals(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """(predicted - measured) / deviation of each sample, 0 for saturated pixels."""
    z = (predicted_dn(vector, samples) - samples.dn) / samples.deviation
    return z if samples.saturated is None else jnp.where(samples.saturated, 0, z)


def log_likelihoods(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Log density of each measured value, or log probability of a saturated one.

    Source:
        Tobin, Econometrica 26, 1958.
    """
    predicted = predicted_dn(vector, samples)
    z = (predicted - samples.dn) / samples.deviation
    gaussian = -z * z / 2 - jnp.log(samples.deviation) - float(np.log(2 * np.pi)) / 2
    if samples.saturated is None:
        return gaussian
    above = jnp.where(samples.saturated, (predicted - samples.clip) / samples.deviation, 0)
    return jnp.where(samples.saturated, log_ndtr(above), gaussian)


def negative_log_likelihood(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Objective of a fit with saturated pixels."""
    return -jnp.sum(log_likelihoods(vector, samples))


def total_log_likelihood(
    vector: Float[Array, " parameters"], data: tuple[Samples, Samples | None]
) -> Array:
    """Log likelihood of cells, and of the saturated samples, which belong to no cell."""
    each = [jnp.sum(log_likelihoods(vector, own)) for own in data if own is not None]
    return jnp.sum(jnp.stack(each))
