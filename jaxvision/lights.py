"""What arrives at a point from one light. For one point; the caller vmaps."""

import equinox as eqx
import jax.numpy as jnp

from ._numerics import norm, normalize, smallest_divisor
from ._types import Colour
from ._vector import Vector
from .scene import DirectionalLight, Light, PointLight


class Incident(eqx.Module):
    """`direction`: (3,) unit, from the point toward the light. `irradiance`: (bands,) W m^-2 on a
    surface facing it; the receiver applies its own cosine."""

    direction: Vector
    irradiance: Colour


def from_point_light(light: PointLight, point: Vector) -> Incident:
    """E = I / d^2, `point` (3,) in m.

    Nearer than `smallest_divisor` (3e-10 m in float32) the point is the light itself: direction,
    irradiance and gradients are 0.
    """
    toward = light.position - point
    distance = norm(toward)
    apart = distance > smallest_divisor(distance.dtype)
    nearness = jnp.where(apart, 1 / jnp.where(apart, distance, 1), 0)
    return Incident(toward * nearness, light.intensity * nearness * nearness)


def from_directional_light(light: DirectionalLight, point: Vector) -> Incident:
    """The same direction and irradiance at every `point`, (3,) in m."""
    del point
    return Incident(normalize(light.direction), light.irradiance)


def incident(light: Light, point: Vector) -> Incident:
    """What any light sends to `point`, (3,) in m."""
    match light:
        case PointLight():
            return from_point_light(light, point)
        case DirectionalLight():
            return from_directional_light(light, point)
