"""The light from any source: as it arrives at a point, or as radiance along a ray."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._loops.groups import fold
from ..core._numerics import dot, unknown_at_nan
from ..core._types import Colour, Scalar, common_dtype
from ..core._vector import Direction, Vector
from ..geometry import Ray
from ..scene import Light
from ._registry import Extended, Incident, Seen, can_be_seen, extended_kind, kind_of
from ._samples import incident_sample, light_nodes
from .near_rectangles import warn_of_near_receiver
from .rules import Rule


@takes_numbers
def incident(light: Light, point: Vector) -> Incident:
    """Return the light that arrives at a point from a light without size.

    Args:
        light: a light without size, such as `PointLight`, `SmallLight` or `DirectionalLight`.
        point: (3,) m.

    Returns:
        The unit direction toward the light, the irradiance, (bands,) W m^-2, on a surface that
        faces it, and the distance, m, or None.

    Raises:
        ValueError: for an extended light; use `incident_samples`.

    Example:
        >>> lamp = jv.PointLight([0.0, 0.0, 2.0], [8.0])
        >>> print(jv.incident(lamp, jnp.zeros(3)).irradiance.round(6))
        [2.]
    """
    kind = kind_of(light)
    if isinstance(kind, Extended):
        raise ValueError(
            f"incident needs a light at one place, got {type(light).__name__}; "
            "incident_samples takes any."
        )
    return kind.incident(light, point)


@takes_numbers
def incident_samples(light: Light, point: Vector, rule: Rule) -> Incident:
    """Return samples of the light that arrives at a point from any source.

    Args:
        light: any light.
        point: (3,) m.
        rule: sampling rule for an extended light; a light without size gives one sample under any
            rule.

    Returns:
        Samples along a new leading axis: unit directions, and the irradiance, (samples, bands) W
        m^-2, of each on a surface that faces it.

    Example:
        >>> sky = jv.environment_map(np.ones((4, 8, 1)))
        >>> samples = jax.jit(jv.incident_samples)(sky, jnp.zeros(3), jv.Quadrature(4))
        >>> samples.direction.shape, round(float(samples.irradiance.sum()), 4)  # 4 pi
        ((32, 3), 12.5664)
    """
    nodes, weights = light_nodes(light, rule, common_dtype(light, point))
    return jax.vmap(lambda u, weight: incident_sample(light, rule, point, u, weight))(
        nodes, weights
    )


@takes_numbers
def irradiance(light: Light, point: Vector, normal: Direction, *, rule: Rule) -> Colour:
    """Compute the irradiance of any light on a receiver with normal n, E = sum_i E_i max(n.l_i, 0).
    The sum is over samples of the light, with irradiance E_i from the direction l_i.

    For a rectangle, `polygon.rectangle_irradiance` is exact, and `adaptive_irradiance` is faster
    for many receivers. For an environment, `harmonics` is a fast approximation.

    Args:
        light: any light.
        point: (3,) m, the receiver.
        normal: (3,) unit normal of the receiver.
        rule: sampling rule for an extended light.

    Returns:
        The irradiance, (bands,) W m^-2.

    Example:
        >>> sky = jv.environment_map(np.ones((4, 8, 1)))
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> print(jv.irradiance(sky, jnp.zeros(3), up, rule=jv.Quadrature(64)).round(2))
        [3.14]
    """
    warn_of_near_receiver(
        [light], [rule], point, normal, "lights.polygon.rectangle_irradiance is exact."
    )
    arriving = incident_samples(light, point, rule)
    cosines = jax.vmap(lambda wi: jnp.maximum(dot(normal, wi), 0))(arriving.direction)
    return (arriving.irradiance * cosines[:, None]).sum(axis=0)


def radiance_along(light: Light, ray: Ray) -> Seen:
    """Return the radiance of an extended light along a ray, and the distance to the light.

    Args:
        light: an extended light.
        ray: its origin in m.

    Returns:
        The distance, m, and the radiance, (bands,) W m^-2 sr^-1, against the ray.

    Raises:
        ValueError: for a light without size.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 3], [0, 2, 0], [2, 0, 0], [5.0])
        >>> light = jv.lights.radiance_along(lamp, jv.Ray([0, 0, 0], [0, 0, 1]))
        >>> print(light.distance, light.radiance)
        3.0 [5.]
    """
    return unknown_at_nan(extended_kind(light).seen(light, ray), ray)


def nearest_seen(lights: Sequence[Light], ray: Ray) -> Seen:
    """Find the first extended light that a ray hits.

    Args:
        lights: any lights; those without size are ignored.
        ray: its origin in m.

    Returns:
        The distance, m, and the radiance, (bands,) W m^-2 sr^-1. Environments are at infinity, and
        their radiances are added. Without extended lights the radiance is a scalar 0.

    Example:
        >>> sides = [0, 2, 0], [2, 0, 0]  # m
        >>> low, high = (jv.RectangleLight([-1, -1, z], *sides, [5.0]) for z in (3.0, 4.0))
        >>> print(jv.lights.nearest_seen([high, low], jv.Ray([0, 0, 0], [0, 0, 1])).distance)
        3.0
    """

    def nearer(before: Seen, light: Light) -> Seen:
        ahead = radiance_along(light, ray)
        both_far = jnp.isinf(before.distance) & jnp.isinf(ahead.distance)
        behind = before.radiance + jnp.where(both_far, ahead.radiance, 0)
        radiance = jnp.where(ahead.distance < before.distance, ahead.radiance, behind)
        return Seen(jnp.minimum(ahead.distance, before.distance), radiance)

    nothing = Seen(jnp.full_like(ray.origin.x, jnp.inf), jnp.zeros_like(ray.origin.x))
    found = fold(nearer, nothing, [light for light in lights if can_be_seen(light)])
    return unknown_at_nan(found, ray)


@takes_numbers
def radiance_from(light: Light, point: Vector, wi: Direction) -> Colour:
    """Return the radiance that reaches a point from one direction.

    Args:
        light: an extended light.
        point: (3,) m.
        wi: (3,) unit, from the point.

    Returns:
        The radiance, (bands,) W m^-2 sr^-1.

    Raises:
        ValueError: for a light without size.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 3], [0, 2, 0], [2, 0, 0], [5.0])
        >>> print(jv.lights.radiance_from(lamp, [0, 0, 0], [0, 0, 1]))  # W m^-2 sr^-1, straight up
        [5.]
    """
    return radiance_along(light, Ray(point, wi)).radiance


@takes_numbers
def direction_sample(light: Light, point: Vector, u: Float[Array, "2"]) -> Incident:
    """Draw a direction toward an extended light.

    Args:
        light: an extended light.
        point: (3,) m.
        u: (2,) uniform in [0, 1), no unit.

    Returns:
        A unit direction, radiance over density, (bands,) W m^-2, and the distance, m.

    Raises:
        ValueError: for a light without size.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 3], [0, 2, 0], [2, 0, 0], [5.0])
        >>> toward = jv.lights.direction_sample(lamp, [0, 0, 0], [0.5, 0.5])
        >>> print(f"{toward.distance:.2f} m")  # to its middle
        3.00 m
    """
    return extended_kind(light).sample(light, point, u)


@takes_numbers
def direction_pdf(light: Light, point: Vector, wi: Direction) -> Scalar:
    """Return the density of the directions that `direction_sample` draws.

    Args:
        light: an extended light.
        point: (3,) m.
        wi: (3,) unit, from the point.

    Returns:
        The density toward `wi`, () in sr^-1.

    Raises:
        ValueError: for a light without size.

    Example:
        >>> sky = jv.environment_map(np.ones((4, 8, 1)))
        >>> density = jv.lights.direction_pdf(sky, [0, 0, 0], [0, 0, 1])  # sr^-1
        >>> print(f"{4 * np.pi * density:.3f}")
        1.000
    """
    return unknown_at_nan(extended_kind(light).pdf(light, point, wi), (point, wi))
