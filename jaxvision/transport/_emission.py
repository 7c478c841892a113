"""Where light paths start: a ray of one of all emitters. Flux in W, lengths in m. For ONE ray; the
caller vmaps."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import lights
from .._groups import take
from .._numerics import select
from ..geometry import Ball
from ..lights import Emitted, emitted_from_surface
from ._emitters import Emissive, Emitters


def emitted(emitters: Emitters, around: Ball | None, u: Float[Array, "5"]) -> Emitted:
    """A ray of one emitter, chosen by u_4, from a place by u_0, u_1 in a direction by u_2, u_3,
    uniform in [0, 1); its flux, W, stands for all emitters. `around`: a sphere around the scene."""
    count = emitters.count
    index = jnp.minimum((u[4] * count).astype(jnp.int32), count - 1)
    chosen = None
    for members, group in zip(emitters.members, emitters.groups, strict=True):
        emitter, among = take(members, group, index)
        if isinstance(emitter, Emissive):
            two_sided = emitter.two_sided
            ray = emitted_from_surface(emitter.shape, emitter.emission, u[:4], two_sided=two_sided)
        else:
            ray = lights.emitted(emitter, u[:4], around=around)
        chosen = ray if chosen is None else select(among, ray, chosen)
    if chosen is None:
        raise ValueError("light tracing needs a scene with something that shines.")
    return Emitted(chosen.ray, chosen.flux * count, chosen.normal)
