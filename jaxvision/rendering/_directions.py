"""Multiple importance sampling of one light, by directions drawn from the light and from the
material.

Directions in the local frame of a surface are `Vec`s. A `Place` contains the shapes that may block
light. It is None if no shape blocks light.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .. import brdf
from ..core._numerics import reciprocal
from ..core._types import Colour
from ..core._vector import Direction, Vec, Vector, as_array, as_vec
from ..geometry import Ray
from ..geometry.hemisphere import Frame, local_frame, to_local, to_world
from ..lights import direction_pdf, direction_sample, radiance_along
from ..scene import Light, Material
from .shadows import Place, clear


def local_viewer(normal: Direction, wo: Direction, tangent: Vector | None) -> tuple[Frame, Vec]:
    """Return the local frame of a surface point, and the direction to the viewer in this frame."""
    frame = local_frame(normal, tangent=tangent)
    return frame, as_vec(to_local(frame, wo))


def world_direction(frame: Frame, wi: Vec, like: Vector) -> Vector:
    """Convert a local direction to world coordinates, as an array or a `Vec`, whichever `like`
    is."""
    world = to_world(frame, wi)
    return as_array(world) if isinstance(like, Array) else world


def balanced(
    material: Material,
    light: Light,
    point: Vector,
    frame: Frame,
    viewer: Vec,
    of_light: Float[Array, "2"],
    of_material: Float[Array, "3"],
    place: Place | None,
) -> Colour:
    """Draw one direction from the light and one from the material, and divide the light from each
    by the sum of both densities. The expectation of the result is the reflected radiance, W m^-2
    sr^-1."""

    def weigh(wi: Vec) -> Colour:
        world = world_direction(frame, wi, point)
        density = direction_pdf(light, point, world) + brdf.pdf(material, wi, viewer)
        arriving = arriving_from(light, point, world, place)
        return arriving * brdf.shading(material, wi, viewer) * reciprocal(density)

    from_light = to_local(frame, direction_sample(light, point, of_light).direction)
    from_material = brdf.sample(material, viewer, of_material)
    return weigh(as_vec(from_light)) + weigh(as_vec(from_material))


def arriving_from(light: Light, point: Vector, wi: Direction, place: Place | None) -> Colour:
    """Return the radiance, W m^-2 sr^-1, that arrives at the point from the direction `wi`; 0 if a
    shape blocks this direction."""
    ahead = radiance_along(light, Ray(point, wi))
    passes = None if place is None else clear(place, wi, ahead.distance)
    return where_clear(passes, ahead.radiance)


def where_clear(condition: Bool[Array, ""] | None, value: Array) -> Array:
    """Return `value` where the condition is true, else 0. A condition of None counts as true."""
    return value if condition is None else jnp.where(condition, value, 0)
