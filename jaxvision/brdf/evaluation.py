"""The BRDF of any material, with its sampler and its albedo, in the local frame unless stated."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._types import Colour, Scalar, check_range, check_shape
from ..core._vector import Direction, Vec, Vector, as_array, as_vec
from ..geometry.hemisphere import direction_at, local_frame, to_local
from ..scene import Material
from ._lobe import where_above
from ._registry import family


@takes_numbers
def evaluate(material: Material, wi: Direction, wo: Direction) -> Colour:
    """Evaluate the BRDF of any material for a direction to the light and one to the viewer.

    Args:
        material: any material.
        wi: (3,) unit, local, toward the light.
        wo: (3,) unit, local, toward the viewer.

    Returns:
        f_r, (bands,) in sr^-1; 0 where wi.z <= 0 or wo.z <= 0.

    Raises:
        ValueError: for a direction whose shape is not (3,). The other functions that take
            directions raise it too.

    Example:
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> print(jv.brdf.evaluate(jv.Lambert([0.25]), up, up))
        [0.25]
    """
    return family(material).evaluate(material, _direction("wi", wi), _direction("wo", wo))


@takes_numbers
def at_angles(
    material: Material, theta_i: Scalar, phi_i: Scalar, theta_o: Scalar, phi_o: Scalar
) -> Colour:
    """Evaluate the BRDF as a function of four angles, f_r(theta_i, phi_i; theta_o, phi_o).

    Args:
        material: any material.
        theta_i: () rad, between the light and the normal, in [0, pi].
        phi_i: () rad, the light's azimuth, from x towards y.
        theta_o: () rad, between the viewer and the normal, in [0, pi].
        phi_o: () rad, the viewer's azimuth.

    Returns:
        f_r, (bands,) in sr^-1; 0 where an angle to the normal is pi / 2 or more.

    Raises:
        ValueError: for angles so large that they are probably in degrees.

    Example:
        The mirror direction is at the same angle, on the other side.

        >>> material = jv.PhongBRDF([0.0], [0.5], 20.0)
        >>> print(jv.brdf.at_angles(material, 0.7, 0.0, 0.7, np.pi).round(6))
        [0.5]
    """
    for name, angle in (("theta_i", theta_i), ("theta_o", theta_o)):
        check_range(f"at_angles: {name}, in rad,", angle, 0, float(np.pi) + 1e-6, nan=True)
    light = direction_at(2 * jnp.sin(theta_i / 2) ** 2, phi_i)  # 1 - cos, without cancellation
    viewer = direction_at(2 * jnp.sin(theta_o / 2) ** 2, phi_o)
    return family(material).evaluate(material, light, viewer)


@takes_numbers
def sample(material: Material, wo: Direction, u: Float[Array, "3"]) -> Vector:
    """Draw a direction toward the light, with a density that is large where the BRDF f_r is large.

    Args:
        material: any material.
        wo: (3,) unit, local, toward the viewer, wo.z > 0.
        u: (3,) uniform in [0, 1), no unit.

    Returns:
        A unit direction, distributed with the density `pdf`; an array or a `Vec`, as `wo` is.

    Example:
        >>> wi = jv.brdf.sample(jv.Lambert([0.1]), jnp.array([0.0, 0.0, 1.0]), [0.25, 0.5, 0.5])
        >>> print(f"{jv.norm(wi):.2f}", wi[2] > 0)
        1.00 True
    """
    wi = family(material).sample(material, _direction("wo", wo), u)
    return wi if isinstance(wo, Vec) else as_array(wi)


@takes_numbers
def pdf(material: Material, wi: Direction, wo: Direction) -> Scalar:
    """Return the density of the directions that `sample` draws.

    Args:
        material: any material.
        wi: (3,) unit, local, toward the light.
        wo: (3,) unit, local, toward the viewer.

    Returns:
        The density at `wi`, () in sr^-1 over the whole sphere.

    Example:
        >>> density = jv.brdf.pdf(jv.Lambert([0.1]), [0.6, 0, 0.8], [0, 0, 1])
        >>> print(f"{np.pi * density:.2f}")  # cos(theta_i) / pi
        0.80
    """
    return family(material).pdf(material, _direction("wi", wi), _direction("wo", wo))


@takes_numbers
def albedo(material: Material, wo: Direction) -> Colour:
    """Compute the directional albedo, the integral of f_r(wi, wo) cos(theta_i) over wi.

    The albedo is the radiance toward the viewer under uniform light of radiance 1 from all
    directions. For a reciprocal BRDF it is also the share of the light from `wo` that is reflected.

    Args:
        material: any material.
        wo: (3,) unit, local, toward the viewer.

    Returns:
        The albedo, (bands,), no unit; 0 where wo.z <= 0.

    Example:
        >>> print(jv.brdf.albedo(jv.Lambert([0.5 / np.pi]), [0, 0, 1]).round(3))
        [0.5]
    """
    viewer = _direction("wo", wo)
    return where_above(viewer.z, family(material).albedo(material, viewer))


@takes_numbers
def shading(material: Material, wi: Direction, wo: Direction) -> Colour:
    """Return the radiance toward the viewer per unit of irradiance on a surface facing the light.

    The shading is f_r cos(theta_i), so the cosine of incidence is included.

    Args:
        material: any material.
        wi: (3,) unit, local, toward the light.
        wo: (3,) unit, local, toward the viewer.

    Returns:
        The shading, (bands,) in sr^-1.

    Example:
        >>> material = jv.Lambert([0.5 / np.pi])  # sr^-1
        >>> print(round(float(np.pi * jv.brdf.shading(material, [0.6, 0, 0.8], [0, 0, 1])[0]), 3))
        0.4
    """
    return family(material).shading(material, _direction("wi", wi), _direction("wo", wo))


def _direction(name: str, w: Vector) -> Vec:
    """Return a direction as a `Vec`. Raise `ValueError` for an array whose shape is not (3,)."""
    if not isinstance(w, Vec):
        check_shape(name, w, (3,))
    return as_vec(w)


@takes_numbers
def reflect(
    material: Material,
    normal: Direction,
    wi: Direction,
    wo: Direction,
    *,
    tangent: Vector | None = None,
) -> Colour:
    """Compute the shading f_r cos(theta_i) of a material for directions in world coordinates.

    Args:
        material: any material.
        normal: (3,) unit, away from the surface.
        wi: (3,) unit, toward the light; light from below the surface (n.wi <= 0) gives 0.
        wo: (3,) unit, toward the viewer.
        tangent: (3,), the direction of the first axis of an anisotropic material; without it that
            axis is arbitrary.

    Returns:
        The shading, (bands,) in sr^-1.

    Example:
        >>> up, aside = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> print(jv.reflect(jv.Lambert([0.25]), up, aside, up).round(6))
        [0.2]
    """
    frame = local_frame(normal, tangent=tangent)
    return shading(material, to_local(frame, wi), to_local(frame, wo))
