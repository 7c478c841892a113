"""The samples of a fit: lights and pixels chosen from an observation, with what a lobe takes."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxvision import Vec, as_vec
from jaxvision.brdf.blinn import log_cos_half
from jaxvision.hemisphere import local_frame, to_local

from ..models import REFLECTANCES
from ..names import Model
from .model import Form, Invariants, Samples
from .read import VIEW, ReflectanceObservation


def lobe_geometry(
    observation: ReflectanceObservation,
    model: Model,
    light: Int[np.ndarray, " samples"],
    pixel: Int[np.ndarray, " samples"],
) -> Array | Invariants | None:
    """What the lobe of a model takes.

    Args:
        observation: of the object.
        model: whose lobe it is.
        light: (samples,) indices.
        pixel: (samples,) indices.

    Returns:
        The log cosine of the lobe's own angle (Phong, Blinn), the mirror angle in rad (Gaussian
        lobe), all invariants (the others); None for Lambert.
    """
    match model:
        case "lambert":
            return None
        case "phong":
            return jnp.asarray(observation.log_cos_mirror[light, pixel])
        case "gaussian-lobe":
            return jnp.asarray(observation.mirror_angle[light, pixel])
    if REFLECTANCES[model].axis == "mirror":
        log_cos = jnp.asarray(observation.log_cos_mirror[light, pixel])
    else:
        log_cos = _log_cos_half(
            jnp.asarray(observation.normals[pixel]), jnp.asarray(observation.wi[light, pixel])
        )
    if model == "blinn":
        return log_cos
    return Invariants(
        cos_i=jnp.asarray(observation.cosine[light, pixel]),
        cos_o=jnp.asarray(observation.normals[pixel, 2]),
        log_cos=log_cos,
    )


@jax.jit
def _log_cos_half(normals: jax.Array, wi: jax.Array) -> jax.Array:
    view = Vec(*(jnp.full(normals.shape[:1], x, normals.dtype) for x in VIEW))
    frame = local_frame(as_vec(normals))
    return log_cos_half(as_vec(to_local(frame, as_vec(wi))), as_vec(to_local(frame, view)))


@dataclass(frozen=True)
class Selection:
    """Which samples a fit sees.

    Attributes:
        light: (samples,) indices, lights in order.
        pixel: (samples,) indices.
    """

    light: Int[np.ndarray, " samples"]
    pixel: Int[np.ndarray, " samples"]


def select(
    observation: ReflectanceObservation, *, held_out: bool, form: Form, minimum_cosine: float = 0.0
) -> Selection:
    """Samples of the lights kept for testing, or of the others.

    Attached shadows (n.l <= 0) are predicted to be black and say nothing about the surface, so they
    are left out, unless an ambient term is to be read off them.

    Args:
        observation: of the object.
        held_out: whether to take the lights kept for testing.
        form: whose ambient term counts.
        minimum_cosine: n.l must be above it.

    Returns:
        Their indices.
    """
    seen = observation.cosine > minimum_cosine
    if form.ambient:
        seen = seen | (observation.cosine <= 0)
    light, pixel = np.nonzero(seen & (observation.held_out == held_out)[:, None])
    return Selection(light, pixel)


def make_samples(
    observation: ReflectanceObservation, channel: int, form: Form, selection: Selection
) -> Samples:
    """The selected samples of one channel, their deviation still 1 DN.

    Args:
        observation: of the object.
        channel: index.
        form: of the fit.
        selection: indices of light and pixel.

    Returns:
        The samples.
    """
    light, pixel = selection.light, selection.pixel
    dn = observation.dn[channel, light, pixel]
    clips = bool(observation.saturated[:, light, pixel].any())
    irradiance = observation.intensity[channel, light] * observation.falloff[light, pixel]
    gamma = None if form.free_gamma else observation.gamma
    return Samples(
        form=form,
        cosine=jnp.asarray(np.maximum(observation.cosine[light, pixel], 0)),
        geometry=lobe_geometry(observation, form.model, light, pixel),
        irradiance=jnp.asarray(irradiance),
        dn=jnp.asarray(dn),
        deviation=jnp.ones(len(dn)),
        saturated=jnp.asarray(dn >= observation.clip) if clips else None,
        black=jnp.asarray(observation.black, float),
        white=jnp.asarray(observation.white, float),
        clip=jnp.asarray(observation.clip, float),
        gamma=None if gamma is None else jnp.asarray(gamma, float),
    )
