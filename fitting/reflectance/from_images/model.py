"""The picture that a reflectance model predicts, and the likelihood of a measured one.

    X   = E (k_d [n.l]+ + k_s lobe) + k_a                  linear signal, DN
    DN  = black + white (X / white)^(1 / gamma)            what the file holds

in each channel by itself. E is the irradiance on a surface facing the light, in the rig's unit, so
k_d and k_s are in DN per unit of E. `lobe` is the SHADING of one of `reflectance.models` with unit
k_s: of Phong, Blinn and the Gaussian lobe as published, without a cosine, of all others f_r
cos(theta_i). Oren-Nayar has k_d lobe in place of both terms. Parts that a `Form` does not name are
neither parameters nor traced.

A pixel at or above the clip level says only that its value lies there: it is censored (Tobin,
Econometrica 26, 1958), contributing log Phi((predicted - clip) / deviation).
"""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxvision import Vec
from jaxvision.brdf.gaussian_lobe import gaussian_lobe
from jaxvision.brdf.phong import phong_lobe
from jaxvision.point_ops import gamma_decode, gamma_encode

from ...inference.compiled import compiled_briefly
from ...inference.parameters import Parameter, ParameterSpace, to_natural
from ...inference.tails import log_ndtr
from ..models import REFLECTANCES, amplitude, has_lobe, shape_of, unit_shading
from ..names import INDEX, Model

COEFFICIENT_UNIT = "DN per unit light"
DARKEST = 1.0  # DN: signals are taken as at least this where a slope or a variance is needed


@dataclass(frozen=True)
class Form:
    """Which terms a fit has.

    Attributes:
        model: one of `reflectance.models`.
        ambient: whether an ambient term is free.
        free_gamma: whether the encoding exponent is.
        index: of refraction, of clear facets.
    """

    model: Model
    ambient: bool = False
    free_gamma: bool = False
    index: float = INDEX


def parameter_space(form: Form) -> ParameterSpace:
    """diffuse; specular; the lobe's shape; ambient; gamma: as far as the form has them. All
    positive, hence in logarithms."""
    space = [amplitude("diffuse", "k_d", COEFFICIENT_UNIT)]
    if has_lobe(form.model):
        space.append(amplitude("specular", "k_s", COEFFICIENT_UNIT))
    if form.model != "lambert":
        space.append(shape_of(form.model))
    if form.ambient:
        space.append(amplitude("ambient", "k_a", "DN"))
    if form.free_gamma:
        space.append(Parameter("gamma", symbol="γ", unit="1", transform="log"))
    return tuple(space)


class Invariants(eqx.Module):
    """The three numbers that an isotropic BRDF depends on.

    Unlike directions they may be averaged over like pixels.

    Attributes:
        cos_i: (samples,) cosine of the light to the normal.
        cos_o: (samples,) cosine of the viewer to the normal.
        log_cos: (samples,) log cosine of the lobe's own angle: to the mirror direction, or between
            normal and half vector.
    """

    cos_i: Float[Array, " samples"]
    cos_o: Float[Array, " samples"]
    log_cos: Float[Array, " samples"]


class Samples(eqx.Module):
    """Lit pixels of one channel, or cells of like pixels.

    Attributes:
        form: of the fit.
        cosine: (samples,) [n.l]+.
        geometry: what the lobe takes: the log cosine of the angle to the mirror direction (Phong)
            or between normal and half vector (Blinn), the mirror angle in rad (Gaussian lobe), all
            invariants (the others); None for Lambert.
        irradiance: (samples,) E on a surface that faces the light.
        dn: (samples,) DN.
        deviation: (samples,) DN; a cell of equal pixels is one sample of smaller deviation.
        saturated: (samples,); None where nothing clips.
        black: DN without light.
        white: DN of full scale above black.
        clip: DN from which a pixel is saturated.
        gamma: known encoding; None for linear files or where it is free.
        offset: (samples,) DN added to a cell's prediction: by how much the mean over its pixels
            differs from the value at their mean geometry.
    """

    form: Form = eqx.field(static=True)
    cosine: Float[Array, " samples"]
    geometry: Float[Array, " samples"] | Invariants | None
    irradiance: Float[Array, " samples"]
    dn: Float[Array, " samples"]
    deviation: Float[Array, " samples"]
    saturated: Bool[Array, " samples"] | None
    black: Float[Array, ""]
    white: Float[Array, ""]
    clip: Float[Array, ""]
    gamma: Float[Array, ""] | None
    offset: Float[Array, " samples"] | None = None


@eqx.filter_jit
def lobe(
    form: Form, geometry: Float[Array, " samples"] | Invariants, shape: Float[Array, ""]
) -> Float[Array, " samples"]:
    """The shading of unit amplitude.

    Args:
        form: of the fit.
        geometry: what the lobe takes, (samples,).
        shape: natural.

    Returns:
        (samples,).
    """
    if isinstance(geometry, Invariants):
        return unit_shading(form.model, shape, *_directions(form.model, geometry), form.index)
    if form.model == "gaussian-lobe":
        return gaussian_lobe(geometry, shape)
    return phong_lobe(geometry, shape)


def _directions(model: Model, seen: Invariants) -> tuple[Vec, Vec]:
    """(wi, wo) with these invariants: normal +z, viewer in the xz plane, light on the side of +y.

    The part of wi.wo across the normal follows from the angle to the mirror direction,
    cos_i cos_o - cos, or from the half vector's, as |wi + wo| = (cos_i + cos_o) / cos.
    """
    cos_i, cos_o, cos = seen.cos_i, seen.cos_o, jnp.exp(seen.log_cos)
    if REFLECTANCES[model].axis == "mirror":
        across = cos_i * cos_o - cos
    else:
        across = jnp.square((cos_i + cos_o) / cos) / 2 - 1 - cos_i * cos_o
    sin_i, sin_o = (jnp.sqrt(jnp.maximum((1 - c) * (1 + c), 0)) for c in (cos_i, cos_o))
    tilted = sin_i * sin_o > 0
    cos_phi = jnp.where(tilted, across / jnp.where(tilted, sin_i * sin_o, 1), 1)
    cos_phi = jnp.clip(cos_phi, -1, 1)
    sin_phi = jnp.sqrt(jnp.maximum((1 - cos_phi) * (1 + cos_phi), 0))
    wi = Vec(sin_i * cos_phi, sin_i * sin_phi, cos_i)
    return wi, Vec(sin_o, jnp.zeros_like(sin_o), cos_o)


@compiled_briefly
def linear_signal(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """X, as a linear camera would give it.

    Args:
        vector: (parameters,) unconstrained.
        samples: of one channel.

    Returns:
        (samples,) DN above black.
    """
    form, natural = samples.form, iter(to_natural(parameter_space(samples.form), vector))
    diffuse = next(natural)
    if form.model == "lambert":
        reflected = diffuse * samples.cosine
    else:
        specular = next(natural) if has_lobe(form.model) else None
        assert samples.geometry is not None
        # Attached shadows have no highlight either.
        unit = jnp.where(samples.cosine > 0, lobe(form, samples.geometry, next(natural)), 0)
        if specular is None:
            reflected = diffuse * unit
        else:
            reflected = diffuse * samples.cosine + specular * unit
    signal = samples.irradiance * reflected
    return signal + next(natural) if form.ambient else signal


def encoding_gamma(vector: Float[Array, " parameters"], samples: Samples) -> Array | None:
    """The free gamma, the known one, or None for linear files.

    Args:
        vector: (parameters,) unconstrained.
        samples: of one channel.

    Returns:
        No unit.
    """
    return jnp.exp(vector[-1]) if samples.form.free_gamma else samples.gamma


@compiled_briefly
def predicted_dn(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Digital numbers before clipping.

    Args:
        vector: (parameters,) unconstrained.
        samples: of one channel.

    Returns:
        (samples,) DN.
    """
    signal, gamma = linear_signal(vector, samples), encoding_gamma(vector, samples)
    if gamma is not None:
        signal = samples.white * gamma_encode(signal / samples.white, gamma)
    dn = samples.black + signal
    return dn if samples.offset is None else dn + samples.offset


def decoded(dn: Array, black: Array, white: Array, gamma: Array | None) -> Array:
    """X of stored digital numbers.

    Args:
        dn: (samples,) DN.
        black: DN without light.
        white: DN of full scale above black.
        gamma: encoding exponent; None for linear files.

    Returns:
        (samples,) DN; values below black give 0 where a gamma is undone.
    """
    if gamma is None:
        return dn - black
    return white * gamma_decode(jnp.maximum(dn - black, 0) / white, gamma)


def encoding_slope(signal: Array, white: Array, gamma: Array | None) -> Array:
    """d DN / d X at a linear signal.

    Args:
        signal: (samples,) X, DN; it counts as 1 DN at least.
        white: DN of full scale above black.
        gamma: encoding exponent; None for linear files.

    Returns:
        (samples,), no unit.
    """
    if gamma is None:
        return jnp.ones_like(signal)
    ratio = jnp.maximum(signal, DARKEST) / white
    return gamma_encode(ratio, gamma) / (gamma * ratio)


def residuals(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """(predicted - measured) / deviation, 0 for saturated pixels.

    Args:
        vector: (parameters,) unconstrained.
        samples: of one channel.

    Returns:
        (samples,).
    """
    z = (predicted_dn(vector, samples) - samples.dn) / samples.deviation
    return z if samples.saturated is None else jnp.where(samples.saturated, 0, z)


def log_likelihoods(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Log density of each measured value, log probability of each saturated one.

    Args:
        vector: (parameters,) unconstrained.
        samples: of one channel.

    Returns:
        (samples,).

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
    """What a fit with saturated pixels minimises.

    Args:
        vector: (parameters,) unconstrained.
        samples: of one channel.

    Returns:
        ().
    """
    return -jnp.sum(log_likelihoods(vector, samples))


@eqx.filter_jit
def total_log_likelihood(
    vector: Float[Array, " parameters"], cells: Samples, saturated: Samples | None
) -> Array:
    """Log likelihood of cells, and of the saturated samples that cells leave out.

    Args:
        vector: (P,) unconstrained.
        cells: of the unsaturated samples.
        saturated: the others; None if there are none.

    Returns:
        ().
    """
    total = jnp.sum(log_likelihoods(vector, cells))
    if saturated is not None:
        total = total + jnp.sum(log_likelihoods(vector, saturated))
    return total
