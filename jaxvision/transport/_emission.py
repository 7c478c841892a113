"""Where light paths start: a ray of one of all emitters. Flux in W, lengths in m. For ONE ray; the
caller vmaps."""

from jaxtyping import Array, Float

from .. import lights
from ..geometry import Ball
from ..lights import Emitted, emitted_from_surface
from ..scene import Light
from ._emitters import Emissive, Emitters, of_drawn


def emitted(emitters: Emitters, around: Ball | None, u: Float[Array, "5"]) -> Emitted:
    """A ray of one emitter, chosen by u_4, from a place by u_0, u_1 in a direction by u_2, u_3,
    uniform in [0, 1); its flux, W, stands for all emitters. `around`: a sphere around the scene."""

    def ray(emitter: Light | Emissive) -> Emitted:
        if isinstance(emitter, Emissive):
            shape, radiance = emitter.shape, emitter.emission
            return emitted_from_surface(shape, radiance, u[:4], two_sided=emitter.two_sided)
        return lights.emitted(emitter, u[:4], around=around)

    drawn = of_drawn(emitters, u[4], ray)
    return Emitted(drawn.ray, drawn.flux * emitters.count, drawn.normal)
