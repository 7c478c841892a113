"""Where light starts: rays drawn from what shines, each with the flux it stands for.

The mean over the uniform numbers of anything that a ray does, times its flux, is what the emitter
does. Flux in W, lengths in m. For ONE ray; the caller vmaps.
"""

from collections.abc import Sequence
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._groups import take
from .._numerics import dot, norm, normalize, reciprocal, safe_sqrt, select
from .._types import Colour, Scalar
from .._vector import Vec, as_vec
from ..geometry import Ray
from ..hemisphere import cosine_direction, cross, direction_at, local_frame, to_world
from ..lights import (
    DirectionalLight,
    EnvironmentMap,
    LightFieldLight,
    PointLight,
    RectangleLight,
    direction_sample,
)
from ..lights.light_field import light_field_radiance
from ..lights.window import Window
from ..scene import Box, Disc, Light, Plane, Quad, Shape, Sphere, TriangleMesh
from ._emitters import Emissive, Emitters
from ._places import area, place_on


class Emitted(eqx.Module):
    """`ray`: as it leaves. `flux`: (bands,) W. `normal`: unit, of the surface it left, 0 where it
    left none."""

    ray: Ray
    flux: Colour
    normal: Vec


class Ball(eqx.Module):
    """A sphere around a scene: `centre`: (3,) m. `radius`: () m."""

    centre: Float[Array, "3"]
    radius: Scalar


def emitted(emitters: Emitters, ball: Ball | None, u: Float[Array, "5"]) -> Emitted:
    """A ray of one emitter, chosen by u_4, from a place by u_0, u_1 in a direction by u_2, u_3,
    uniform in [0, 1); its flux, W, stands for all emitters."""
    count = emitters.count
    index = jnp.minimum((u[4] * count).astype(jnp.int32), count - 1)
    chosen = None
    for members, group in zip(emitters.members, emitters.groups, strict=True):
        emitter, among = take(members, group, index)
        ray = _emitted(emitter, ball, u)
        chosen = ray if chosen is None else select(among, ray, chosen)
    if chosen is None:
        raise ValueError("light tracing needs a scene with something that shines.")
    return Emitted(chosen.ray, chosen.flux * count, chosen.normal)


def _emitted(emitter: Light | Emissive, ball: Ball | None, u: Float[Array, "5"]) -> Emitted:
    nothing = Vec(*jnp.zeros((3, 1), u.dtype)[:, 0])
    match emitter:
        case PointLight():
            direction = direction_at(2 * u[2], 2 * jnp.pi * u[3])
            ray = Ray(emitter.position, direction)
            return Emitted(ray, 4 * jnp.pi * emitter.intensity, nothing)
        case RectangleLight():
            shape = Quad(emitter.corner, emitter.edge_u, emitter.edge_v)
            return _from_surface(shape, emitter.radiance, u, jnp.zeros((), bool))
        case Emissive():
            return _from_surface(emitter.shape, emitter.emission, u, emitter.two_sided)
        case LightFieldLight():
            return _from_light_field(emitter, u)
        case DirectionalLight():
            toward = as_vec(normalize(emitter.direction))
            return _from_afar(_known(ball), toward, emitter.irradiance, u)
        case EnvironmentMap():
            arriving = direction_sample(emitter, nothing, u[2:4])
            return _from_afar(_known(ball), as_vec(arriving.direction), arriving.irradiance, u)
    raise ValueError(f"light tracing knows no rays of {type(emitter).__name__}.")


def _from_surface(
    shape: Shape, radiance: Colour, u: Float[Array, "5"], two_sided: Array
) -> Emitted:
    """pi A L: evenly from the area, by the cosine from the normal, of both sides half each."""
    place = place_on(shape, u[:2])
    sides = jnp.where(two_sided, 2, 1).astype(u.dtype)
    turned = two_sided & (u[2] >= 0.5)
    within = jnp.where(two_sided, (2 * u[2]) % 1, u[2])
    normal = place.normal * jnp.where(turned, -1, 1).astype(u.dtype)
    local = cosine_direction(jnp.stack([within, u[3]]))
    direction = as_vec(to_world(local_frame(normal), local))
    return Emitted(Ray(place.point, direction), jnp.pi * area(shape) * sides * radiance, normal)


def _from_light_field(light: LightFieldLight, u: Float[Array, "5"]) -> Emitted:
    """From a place of the aperture, on the line through a place of the focal window, away from the
    scene behind."""
    start, target = _point(light.aperture, u[:2]), _point(light.focal, u[2:4])
    span = cross(light.aperture.edge_u, light.aperture.edge_v)
    normal, whole = as_vec(normalize(span)), norm(span)
    line = start - target
    distance = norm(line)
    inverse = reciprocal(distance)
    away = line * (inverse * jnp.where(dot(normal, line) < 0, -1, 1).astype(u.dtype))
    cosine = dot(normal, away)
    focal = norm(cross(light.focal.edge_u, light.focal.edge_v))
    solid_angle = focal * cosine * inverse * inverse
    radiance = light_field_radiance(light, Ray(start + away, -away))
    return Emitted(Ray(start, away), radiance * (whole * cosine * solid_angle), normal)


def _from_afar(ball: Ball, toward: Vec, irradiance: Colour, u: Float[Array, "5"]) -> Emitted:
    """E pi R^2: evenly through the disc, across the direction, that covers the scene."""
    radius, phi = ball.radius * safe_sqrt(u[0]), 2 * jnp.pi * u[1]
    aside = Vec(radius * jnp.cos(phi), radius * jnp.sin(phi), ball.radius)
    origin = ball.centre + as_vec(to_world(local_frame(toward), aside))
    flux = irradiance * (jnp.pi * ball.radius**2)
    return Emitted(Ray(origin, -toward), flux, toward * jnp.zeros_like(phi))


def _point(window: Window, place: Float[Array, "2"]) -> Vec:
    corner, u, v = as_vec(window.corner), as_vec(window.edge_u), as_vec(window.edge_v)
    return corner + place[0] * u + place[1] * v


def _known(ball: Ball | None) -> Ball:
    if ball is None:
        raise ValueError(
            "light from infinitely far away can be traced into a scene that ends, got a Plane; a "
            "large Quad or Disc serves."
        )
    return ball


def ball_around(shapes: Sequence[Shape]) -> Ball | None:
    """A sphere that holds all shapes, m; None where one has no end. A constant to gradients."""
    shapes = jax.lax.stop_gradient(list(shapes))
    balls = [_ball(shape) for shape in shapes if not isinstance(shape, Plane)]
    if len(balls) < len(shapes):
        return None
    low = reduce(jnp.minimum, (ball.centre - ball.radius for ball in balls))
    high = reduce(jnp.maximum, (ball.centre + ball.radius for ball in balls))
    centre = (low + high) / 2
    radius = reduce(jnp.maximum, (norm(ball.centre - centre) + ball.radius for ball in balls))
    return Ball(centre, radius)


def _ball(shape: Shape) -> Ball:
    match shape:
        case Sphere() | Disc():
            return Ball(shape.centre, shape.radius)
        case Box():
            return Ball(shape.centre, norm(shape.half_extents))
        case Quad():
            u, v = shape.edge_u, shape.edge_v
            half = jnp.maximum(norm(u + v), norm(u - v)) / 2
            return Ball(shape.corner + (u + v) / 2, half)
        case TriangleMesh():
            low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
            centre = (low + high) / 2
            return Ball(centre, norm(shape.vertices - centre[None]).max())
        case Plane():
            return Ball(shape.point, jnp.full_like(shape.point[0], jnp.inf))
