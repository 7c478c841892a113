"""Compute the signal of a surface under a light, and the digital number that a file stores for it.

    X   = E (k_d [n.l]+ + k_s lobe) + k_a                  linear signal, DN
    v   = K X + (K sigma)^2                                its variance: shot and read noise
    DN  = b + f(X),   f(X) = W (X / W)^(1 / gamma)         stored in the file; linear: f(X) = X
    E[DN]   = b + f + f'' v / 2
    Var[DN] = f'^2 v + f' f'' K^2 X + (f''^2 / 2 + f' f''') v^2 + 1 / 12

Mean and variance of DN are accurate to second order in the noise, which is enough if X is at least
five standard deviations. E is the irradiance on a surface facing the light, in the rig's unit, so
k_d and k_s are in DN per unit of E. n is the normal, l the light direction, K the system gain,
sigma the read noise, b the black level and W the DN of full scale above black. `lobe` is the
shading, that is, the reflected light per irradiance on a surface facing the light, of one of
`reflectance.models` with unit k_s. For Phong, Blinn and the Gaussian lobe, the shading is as
published, without a cosine. For all other models, the shading is f_r cos(theta_i). For Oren-Nayar's
model, the single term k_d times the lobe replaces the diffuse and the specular term. Terms that a
`Form` does not name are neither fitted nor computed.

Two calibrations invert this model. The table states how each of them treats the surface, the
encoding f and the sensor (b, K, sigma), and errors:

                      surface   f, b, K, sigma                    errors of lights and pixels
    reflectance       free      known, or K and sigma weights     widen the covariance
    joint             free      known, with a prior, or free      marginalised, their scale free
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import Vec, as_array, as_vec
from jaxvision.geometry.hemisphere import local_frame, to_local
from jaxvision.point_ops import gamma_encode
from jaxvision.programs import medium_run_options
from jaxvision.sensor import QUANTISATION_VARIANCE

from ...inference.parameters import Parameter, ParameterSpace
from ...inference.precision import double_precision
from ..models import amplitude, has_lobe, shape_of, surface_space, unit_shading
from ..names import INDEX, Model
from .read import VIEW

COEFFICIENT_UNIT = "DN per unit light"
BLOCK = 4096  # samples per call of a lobe, so that a model compiles once for any number of samples
DARKEST = 1.0  # DN: lower limit of signals in slopes and variances
GAMMA = Parameter("gamma", symbol="γ", unit="1", transform="log")

Values = dict[str, Array]  # natural, by the parameter's name
Vector = Float[np.ndarray, " parameters"]
Matrix = Float[np.ndarray, "parameters parameters"]
OfSamples = Float[np.ndarray, " samples"]


@dataclass(frozen=True)
class Form:
    """The terms of the model that a fit includes."""

    model: Model  # one of `reflectance.models`
    ambient: bool = False  # whether an ambient term is free
    free_gamma: bool = False  # whether the encoding exponent is free, whatever the rig states
    index: float = INDEX  # of refraction, of clear facets


def surface_parameters(form: Form) -> ParameterSpace:
    """Return the parameters of the surface."""
    return surface_space(form.model, COEFFICIENT_UNIT, COEFFICIENT_UNIT)


def parameter_space(form: Form) -> ParameterSpace:
    """Return the parameters of the surface, the ambient term and gamma, as the form requires. All
    are positive and searched as logarithms.
    """
    ambient = (amplitude("ambient", "k_a", "DN"),) if form.ambient else ()
    return (*surface_parameters(form), *ambient, *((GAMMA,) if form.free_gamma else ()))


class Geometry(eqx.Module):
    """The illumination geometry of pixels, or of cells of pixels, in their local frames."""

    wi: Vec  # components toward the light
    wo: Vec  # components toward the viewer
    irradiance: Float[Any, "..."]  # E on a facing surface
    # derivatives of `wi` by two rotations of the light, rad^-1; None if its direction is exact
    turned: tuple[Vec, Vec] | None = None
    # rad, rotations of the lights from the rig's directions; None for no rotation
    about: Float[Array, "2 images"] | None = None


@eqx.filter_jit
def local_geometry(
    normals: Float[Array | np.ndarray, "*of 3"],
    wi: Float[Array | np.ndarray, "*of 3"],
    irradiance: Float[Array | np.ndarray, "*of"],
    *,
    turns: bool = False,
    toward: Float[Array | np.ndarray, "*of 3"] | None = None,
) -> Geometry:
    """Return the directions of light and viewer in the local frames of normals. `toward` are unit
    vectors to a camera nearby; without them the camera is far away.

    With `turns`, the geometry also has the derivatives of `wi` with respect to rotations of the
    light. The normals then are (images, cells).
    """
    normals, wi = jnp.asarray(normals), jnp.asarray(wi)
    frame = local_frame(as_vec(normals))

    def local_direction(directions: Array) -> Vec:
        return as_vec(to_local(frame, as_vec(directions)))

    turned = None
    if turns:
        middle = jnp.mean(wi, axis=1)
        across = local_frame(as_vec(middle / jnp.linalg.norm(middle, axis=1, keepdims=True)))

        def derivative_along(t: Array) -> Vec:
            return local_direction(
                t[:, None] - jnp.sum(t[:, None] * wi, axis=2, keepdims=True) * wi
            )

        turned = (
            derivative_along(as_array(across.tangent)),
            derivative_along(as_array(across.bitangent)),
        )
    if toward is None:
        toward = jnp.broadcast_to(jnp.array(VIEW, normals.dtype), normals.shape)
    view = jnp.asarray(toward)
    return Geometry(local_direction(wi), local_direction(view), jnp.asarray(irradiance), turned)


def directions_from_cosines(
    cos_i: OfSamples, cos_o: OfSamples, between: OfSamples, irradiance: OfSamples
) -> Geometry:
    """Return directions with given cosines between light, normal and viewer: the viewer in the xz
    plane, the light at positive y. Any directions with these cosines may be used, because the
    models depend only on the cosines.
    """
    sin_i, sin_o = (np.sqrt(np.maximum((1 - c) * (1 + c), 0)) for c in (cos_i, cos_o))
    tilted = sin_i * sin_o > 0
    cos_phi = (between - cos_i * cos_o) / np.where(tilted, sin_i * sin_o, 1)
    cos_phi = np.clip(np.where(tilted, cos_phi, 1), -1, 1)
    sin_phi = np.sqrt((1 - cos_phi) * (1 + cos_phi))
    light: Any = sin_i * cos_phi, sin_i * sin_phi, cos_i
    view: Any = sin_o, np.zeros_like(sin_o), cos_o
    return Geometry(Vec(*light), Vec(*view), irradiance)


@eqx.filter_jit
def unit_lobe(form: Form, shape: Float[Array, ""], geometry: Geometry) -> Array:
    """Return the shading of unit amplitude, 0 in attached shadows, for any model but Lambert's."""
    wi, wo = jax.tree.map(jnp.ravel, (geometry.wi, geometry.wo))
    unit = unit_shading(form.model, shape, wi, wo, form.index).reshape(geometry.wi.z.shape)
    return jnp.where(geometry.wi.z > 0, unit, 0)


@double_precision
def lobe_with_slopes(
    form: Form, log_shape: Float[np.ndarray, " samples"] | float, geometry: Geometry
) -> Float[np.ndarray, "3 samples"]:
    """Return `unit_lobe` and its first two derivatives with respect to the logarithm of its
    shape.
    """
    count = geometry.wi.z.size
    given = [np.broadcast_to(log_shape, count), *geometry.wi, *geometry.wo]
    found = np.empty((3, -(-count // BLOCK) * BLOCK))
    for begin in range(0, count, BLOCK):
        part = slice(begin, begin + BLOCK)
        own = [values[part] for values in given]
        if begin + BLOCK > count:
            own = [np.pad(values, (0, begin + BLOCK - count), mode="edge") for values in own]
        found[:, part] = _block(form.model, form.index, *own)
    return found[:, :count]


def _lobe_of_block(
    model: Model, index: float, log_shape: Array, *components: Array
) -> tuple[Array, ...]:
    """Return the unit lobe u of a block of samples, du/ds and d2u/ds2 at log shapes s."""
    wi, wo = Vec(*components[:3]), Vec(*components[3:])

    def unit(s: Array) -> Array:
        return jnp.where(wi.z > 0, unit_shading(model, jnp.exp(s), wi, wo, index), 0)

    def with_slope(s: Array) -> tuple[Array, Array]:
        return jax.jvp(unit, (s,), (jnp.ones_like(s),))

    (value, slope), (_, bend) = jax.jvp(with_slope, (log_shape,), (jnp.ones_like(log_shape),))
    return value, slope, bend


_block = jax.jit(_lobe_of_block, static_argnums=(0, 1), compiler_options=medium_run_options())


def signal(values: Values, form: Form, geometry: Geometry) -> Array:
    """Return X, the signal of a linear camera in DN above black."""
    reflected = 0.0
    if form.model == "lambert" or has_lobe(form.model):
        reflected = values["diffuse"] * jnp.maximum(geometry.wi.z, 0)
    if form.model != "lambert":
        factor = values["specular" if has_lobe(form.model) else "diffuse"]
        reflected += factor * unit_lobe(form, values[shape_of(form.model).name], geometry)
    x = geometry.irradiance * reflected
    return x + values["ambient"] if form.ambient else x


def decoded(
    dn: Float[np.ndarray, "..."], black: float, white: float, gamma: float | None
) -> Float[np.ndarray, "..."]:
    """Return X from stored digital numbers; with a gamma, values below black give 0.

    `white` is the DN of full scale above black."""
    if gamma is None:
        return dn - black
    return white * (np.maximum(dn - black, 0) / white) ** gamma


def encoded(x: Array, white: Array | float, gamma: Array | float | None) -> Array:
    """Return f(X) in DN above black."""
    return x if gamma is None else white * gamma_encode(x / white, gamma)


def encoding_slope(
    x: Float[np.ndarray, "..."], white: float, gamma: float | None
) -> Float[np.ndarray, "..."]:
    """Return f'(X), no unit. X counts as at least 1 DN."""
    if gamma is None:
        return np.ones_like(x)
    ratio = np.maximum(x, DARKEST) / white
    return ratio ** (1 / gamma) / (gamma * ratio)


def stored(values: Values, x: Array, white: Array) -> tuple[Array, Array, Array]:
    """Return E[DN] in DN, Var[DN] in DN^2 and d DN / d X for a signal X of known noise.

    `x` is X in DN, which must be positive if there is a gamma. `white` is W in DN.
    """
    gain, black = values["system_gain"], values["black_level"]
    v = gain * x + (gain * values["read_noise"]) ** 2
    if "gamma" not in values:
        return black + x, v + QUANTISATION_VARIANCE, jnp.ones_like(x)
    power = 1 / values["gamma"]
    f = white * (x / white) ** power
    slope = power * f / x
    second = (power - 1) * slope / x
    third = (power - 2) * second / x
    skew = slope * second * gain**2 * x
    variance = slope**2 * v + skew + (second**2 / 2 + slope * third) * v**2
    return black + f + second * v / 2, variance + QUANTISATION_VARIANCE, slope
