"""Where light paths start: a ray of one of all emitters. Flux in W, lengths in m. For ONE ray; the
caller vmaps."""

from jaxtyping import Array, Float

from .. import lights
from ..geometry import Ball
from ..lights import Emitted, emitted_from_surface
from ..scene import Light
from ._emitters import Emissive, Emitters, of_drawn


def emitted(emitters: Emitters, around: Ball | None, u: Float[Array, "5"]) -> Emitted:
    """Draw a ray from one emitter, selected by u_4. u_0 and u_1 give its point, and u_2 and u_3 its
    direction, all uniform in [0, 1). Its flux, W, is an estimate for all emitters. `around`: a
    sphere around the scene."""

    def ray(emitter: Light | Emissive) -> Emitted:
        if isinstance(emitter, Emissive):
            shape, radiance = emitter.shape, emitter.emission
            return emitted_from_surface(shape, radiance, u[:4], two_sided=emitter.two_sided)
        return lights.emitted(emitter, u[:4], around=around)

    drawn = of_drawn(emitters, u[4], ray)
    return Emitted(drawn.ray, drawn.flux * emitters.count, drawn.normal)
