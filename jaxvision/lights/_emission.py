"""Random rays that leave a light, each with its flux, for light tracing.

If a quantity is computed for each random ray and multiplied by the ray's `flux`, the expectation is
the value of that quantity for the whole light. Flux is in W, lengths are in m. All functions are
for one ray; use `jax.vmap` for many.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..core._arguments import takes_numbers
from ..core._numerics import safe_sqrt
from ..core._types import Colour
from ..core._vector import Vec, as_vec
from ..geometry import Ball, Ray, point_on, surface_area
from ..geometry.hemisphere import cosine_direction, direction_at, local_frame, to_world
from ..scene import Light, Shape
from ._registry import Discrete, Emitted, Incident, kind_of


@takes_numbers
def emitted(light: Light, u: Float[Array, "4"], *, around: Ball | None) -> Emitted:
    """Draw a ray that leaves a light.

    Args:
        light: any light.
        u: (4,) uniform in [0, 1), no unit: u_0, u_1 for the position, u_2, u_3 for the direction.
        around: a sphere around the scene, m, through which light from infinity is emitted; None for
            an unbounded scene.

    Returns:
        The ray and its flux, (bands,) W.

    Raises:
        ValueError: for light from infinity in an unbounded scene, and for an extended light that
            has registered no `emitted`.
    """
    kind = kind_of(light)
    if kind.emitted is not None:
        return kind.emitted(light, u)
    centre = as_vec(jnp.zeros(3, u.dtype)) if around is None else as_vec(around.centre)
    if isinstance(kind, Discrete):
        arriving = kind.incident(light, centre)
        if arriving.distance is not None:
            position = centre + arriving.distance * as_vec(arriving.direction)
            direction = direction_at(2 * u[2], 2 * jnp.pi * u[3])
            intensity = kind.incident(light, position + direction).irradiance  # at 1 m
            return emitted_from_point(position, direction, 4 * jnp.pi * intensity)
    else:
        arriving = kind.sample(light, centre, u[2:])
        if arriving.distance is not None:
            raise ValueError(
                f"light tracing needs {type(light).__name__} to be registered with `emitted`, "
                "which draws rays that leave it."
            )
    if around is None:
        raise ValueError(
            "light from infinitely far away can be traced into a scene that ends, got a Plane; a "
            "large Quad or Disc serves."
        )
    return _emit_from_afar(around, arriving, u)


@takes_numbers
def emitted_from_point(position: Vec, direction: Vec, flux: Colour) -> Emitted:
    """Return a ray that leaves a point light, with its flux.

    Args:
        position: m, of the light.
        direction: unit, of the ray.
        flux: (bands,) W.

    Returns:
        The ray and its flux, (bands,) W.
    """
    return Emitted(Ray(position, direction), flux, as_vec(jnp.zeros(3, direction.x.dtype)))


@takes_numbers
def emitted_from_surface(
    shape: Shape,
    radiance: Colour,
    u: Float[Array, "4"],
    *,
    two_sided: Bool[Array, ""] | bool = False,
) -> Emitted:
    """Draw a ray from a surface of area A and uniform radiance L, uniform by area and
    cosine-distributed about the normal. The flux of the ray is pi A L. A two-sided surface emits
    the same light from its back: the flux is doubled, and half of the rays leave from each side.

    Args:
        shape: the surface, bounded.
        radiance: (bands,) W m^-2 sr^-1.
        u: (4,) uniform in [0, 1), no unit.
        two_sided: () whether the back emits too.

    Returns:
        The ray and its flux, (bands,) W.
    """
    place = point_on(shape, u[:2])
    sides = jnp.where(two_sided, 2, 1).astype(u.dtype)
    turned = two_sided & (u[2] >= 0.5)
    within = jnp.where(two_sided, (2 * u[2]) % 1, u[2])
    normal = place.normal * jnp.where(turned, -1, 1).astype(u.dtype)
    local = cosine_direction(jnp.stack([within, u[3]]))
    direction = as_vec(to_world(local_frame(normal), local))
    flux = jnp.pi * surface_area(shape) * sides * radiance
    return Emitted(Ray(place.point, direction), flux, normal)


def _emit_from_afar(around: Ball, arriving: Incident, u: Float[Array, "4"]) -> Emitted:
    """Draw a ray from a light at infinity, uniformly through a disc of radius R that covers the
    scene and is perpendicular to the light's direction. The flux of the ray is E pi R^2, where E is
    the irradiance."""
    toward = as_vec(arriving.direction)
    radius, phi = around.radius * safe_sqrt(u[0]), 2 * jnp.pi * u[1]
    aside = Vec(radius * jnp.cos(phi), radius * jnp.sin(phi), around.radius)
    origin = around.centre + as_vec(to_world(local_frame(toward), aside))
    flux = arriving.irradiance * (jnp.pi * around.radius**2)
    return Emitted(Ray(origin, -toward), flux, toward * jnp.zeros_like(phi))
