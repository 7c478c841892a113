"""A point: the same intensity in every direction, falling with the square of the distance."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._bands import by_band
from .._numerics import dot, smallest_divisor
from .._types import Colour, as_float, check_shape
from .._vector import Vector
from ..scene import Light
from ._registry import Incident, register


class PointLight(Light):
    """An isotropic point source.

    `position`: (3,) m. `intensity`: (bands,) W sr^-1.
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    intensity: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("PointLight.position", self.position, (3,))
        check_shape("PointLight.intensity", self.intensity, ("bands",))


def from_point_light(light: PointLight, point: Vector) -> Incident:
    """E = I / d^2, `point` (3,) in m.

    Nearer than `smallest_divisor` (3e-10 m in float32) the point is the light itself: direction,
    irradiance and gradients are 0. Farther than 1e19 m in float32 there is nothing left of it.
    """
    toward = light.position - point
    square = dot(toward, toward)
    apart = square > smallest_divisor(square.dtype) ** 2
    nearness = jnp.where(apart, jax.lax.rsqrt(jnp.where(apart, square, 1)), 0)
    irradiance = by_band(lambda band: band * (nearness * nearness), light.intensity)
    return Incident(toward * nearness, irradiance, square * nearness)


register(PointLight, incident=from_point_light)
