"""The picture that a reflectance model predicts, and the likelihood of a measured one.

    X   = E (k_d [n.l]+ + k_s lobe) + k_a                  linear signal, DN
    DN  = black + white (X / white)^(1 / gamma)            what the file holds

in each channel by itself: Phong SHADING in the textbook sense, without a cosine on the specular
term and without 1 / pi in k_d. E is the irradiance on a surface facing the light, in the rig's
unit, so k_d and k_s are in DN per unit of E. `lobe` is Phong's or the Gaussian one of
`jaxvision.brdf`. Parts that a `Form` does not name are neither parameters nor traced.

A pixel at or above the clip level says only that its value lies there: it is censored (Tobin,
Econometrica 26, 1958), contributing log Phi((predicted - clip) / deviation).
"""

from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxvision.brdf.gaussian_lobe import gaussian_lobe
from jaxvision.brdf.phong import phong_lobe
from jaxvision.point_ops import gamma_decode, gamma_encode

from .parameters import Parameter, ParameterSpace, to_natural

Model = Literal["lambert", "phong", "gaussian-lobe"]
MODELS: tuple[Model, ...] = ("lambert", "phong", "gaussian-lobe")

COEFFICIENT_UNIT = "DN per unit light"
DARKEST = 1.0  # DN: signals are taken as at least this where a slope or a variance is needed


@dataclass(frozen=True)
class Form:
    """Which terms a fit has: the model, and whether an ambient term and gamma are free."""

    model: Model
    ambient: bool = False
    free_gamma: bool = False


SHAPE = {
    "phong": Parameter(
        "exponent", symbol="n", unit="1", transform="log", lower=0.5, upper=20_000.0
    ),
    "gaussian-lobe": Parameter(
        "concentration", symbol="c", unit="1/rad", transform="log", lower=0.5, upper=100.0
    ),
}


def parameter_space(form: Form) -> ParameterSpace:
    """diffuse; specular and exponent or concentration; ambient; gamma: as far as the form has
    them. All positive, hence in logarithms."""

    def amplitude(name: str, symbol: str, unit: str) -> Parameter:
        return Parameter(name, symbol=symbol, unit=unit, transform="log", lower=0.0)

    space = [amplitude("diffuse", "k_d", COEFFICIENT_UNIT)]
    if form.model != "lambert":
        space += [amplitude("specular", "k_s", COEFFICIENT_UNIT), SHAPE[form.model]]
    if form.ambient:
        space.append(amplitude("ambient", "k_a", "DN"))
    if form.free_gamma:
        space.append(
            Parameter("gamma", symbol="γ", unit="1", transform="log", lower=0.5, upper=4.0)
        )
    return tuple(space)


class Samples(eqx.Module):
    """Lit pixels of one channel, or cells of like pixels.

    cosine: [n.l]+. mirror: what the lobe takes, the log cosine of the mirror angle (Phong) or the
    angle in rad (Gaussian); None for Lambert. irradiance: E. dn, deviation: DN; a cell of equal
    pixels is one sample of smaller deviation. saturated: None where nothing clips. gamma: known
    encoding, None for linear files or where it is free. offset: DN added to a cell's prediction,
    what its pixels' mean differs from their mean geometry's.
    """

    form: Form = eqx.field(static=True)
    cosine: Float[Array, " samples"]
    mirror: Float[Array, " samples"] | None
    irradiance: Float[Array, " samples"]
    dn: Float[Array, " samples"]
    deviation: Float[Array, " samples"]
    saturated: Bool[Array, " samples"] | None
    black: Float[Array, ""]
    white: Float[Array, ""]
    clip: Float[Array, ""]
    gamma: Float[Array, ""] | None
    offset: Float[Array, " samples"] | None = None


def lobe(model: Model, mirror: Float[Array, "..."], shape: Float[Array, "..."]) -> Array:
    """The unit lobe of the model; `shape`: Phong's exponent or the Gaussian's concentration."""
    return phong_lobe(mirror, shape) if model == "phong" else gaussian_lobe(mirror, shape)


def linear_signal(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """X, DN above black as a linear camera would give them: (samples,)."""
    form, natural = samples.form, iter(to_natural(parameter_space(samples.form), vector))
    reflected = next(natural) * samples.cosine
    if form.model != "lambert":
        specular, shape = next(natural), next(natural)
        assert samples.mirror is not None
        # Attached shadows have no highlight either.
        reflected = reflected + jnp.where(
            samples.cosine > 0, specular * lobe(form.model, samples.mirror, shape), 0
        )
    signal = samples.irradiance * reflected
    return signal + next(natural) if form.ambient else signal


def encoding_gamma(vector: Float[Array, " parameters"], samples: Samples) -> Array | None:
    """The free gamma, the known one, or None for linear files."""
    return jnp.exp(vector[-1]) if samples.form.free_gamma else samples.gamma


def predicted_dn(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Digital numbers before clipping: (samples,)."""
    signal, gamma = linear_signal(vector, samples), encoding_gamma(vector, samples)
    if gamma is not None:
        signal = samples.white * gamma_encode(signal / samples.white, gamma)
    dn = samples.black + signal
    return dn if samples.offset is None else dn + samples.offset


def decoded(dn: Array, black: Array, white: Array, gamma: Array | None) -> Array:
    """X of stored digital numbers; values below black give 0 where a gamma is undone."""
    if gamma is None:
        return dn - black
    return white * gamma_decode(jnp.maximum(dn - black, 0) / white, gamma)


def encoding_slope(signal: Array, white: Array, gamma: Array | None) -> Array:
    """d DN / d X at a linear signal, which counts as `DARKEST` at least."""
    if gamma is None:
        return jnp.ones_like(signal)
    ratio = jnp.maximum(signal, DARKEST) / white
    return gamma_encode(ratio, gamma) / (gamma * ratio)


def residuals(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """(predicted - measured) / deviation, 0 for saturated pixels: (samples,)."""
    z = (predicted_dn(vector, samples) - samples.dn) / samples.deviation
    return z if samples.saturated is None else jnp.where(samples.saturated, 0, z)


def log_likelihoods(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Log density of each measured value, log probability of each saturated one: (samples,)."""
    predicted = predicted_dn(vector, samples)
    z = (predicted - samples.dn) / samples.deviation
    gaussian = -z * z / 2 - jnp.log(samples.deviation) - float(np.log(2 * np.pi)) / 2
    if samples.saturated is None:
        return gaussian
    above = jnp.where(samples.saturated, (predicted - samples.clip) / samples.deviation, 0)
    return jnp.where(samples.saturated, jax.scipy.special.log_ndtr(above), gaussian)


def negative_log_likelihood(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """What a fit with saturated pixels minimises: ()."""
    return -jnp.sum(log_likelihoods(vector, samples))


@eqx.filter_jit
def scores(
    vector: Float[Array, " parameters"], samples: Samples
) -> Float[Array, "parameters samples"]:
    """Gradient of each sample's log likelihood."""
    _, along = jax.linearize(lambda v: log_likelihoods(v, samples), vector)
    return jax.vmap(along)(jnp.eye(vector.size, dtype=vector.dtype))
