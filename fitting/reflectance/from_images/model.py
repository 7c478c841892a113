"""Samples of photographs, their prediction by a surface and an encoding, and their likelihood.

A pixel at or above the clip level states only that its value is at least that large. It is censored
(Tobin, Econometrica 26, 1958) and contributes log Phi((predicted - clip) / deviation). JAX can
trace this density, for chains. `derivatives` has the same density and its slopes in NumPy, for
searches.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

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
    """Lit pixels of one channel, or cells of similar pixels: arrays of NumPy or of JAX."""

    form: Form = eqx.field(static=True)
    geometry: Geometry
    dn: Float[Any, " samples"]  # DN
    # DN; a cell of equal pixels is one sample of smaller deviation
    deviation: Float[Any, " samples"]
    saturated: Bool[Any, " samples"] | None  # None where nothing clips
    black: Float[Any, ""]  # DN without light
    white: Float[Any, ""]  # DN of full scale above black
    clip: Float[Any, ""]  # DN from which a pixel is saturated
    gamma: Float[Any, ""] | None  # known encoding; None for linear files or where it is free
    # DN added to a cell's prediction: by how much the mean over its pixels differs from the value
    # at their mean geometry
    offset: Float[Any, " samples"] | None = None


def log_likelihoods(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Log density of each measured value at an unconstrained vector, or log probability of a
    saturated one.

    Source:
        Tobin, Econometrica 26, 1958.
    """
    space = parameter_space(samples.form)
    values = dict(zip(names(space), to_natural(space, vector), strict=True))
    gamma = values["gamma"] if samples.form.free_gamma else samples.gamma
    x = signal(values, samples.form, samples.geometry)
    predicted = samples.black + encoded(x, samples.white, gamma)
    if samples.offset is not None:
        predicted = predicted + samples.offset
    z = (predicted - samples.dn) / samples.deviation
    gaussian = -z * z / 2 - jnp.log(samples.deviation) - float(np.log(2 * np.pi)) / 2
    if samples.saturated is None:
        return gaussian
    above = jnp.where(samples.saturated, (predicted - samples.clip) / samples.deviation, 0)
    return jnp.where(samples.saturated, log_ndtr(above), gaussian)


def total_log_likelihood(
    vector: Float[Array, " parameters"], data: tuple[Samples, Samples | None]
) -> Array:
    """Log likelihood of cells, and of the saturated samples, which belong to no cell."""
    each = [jnp.sum(log_likelihoods(vector, own)) for own in data if own is not None]
    return jnp.sum(jnp.stack(each))
