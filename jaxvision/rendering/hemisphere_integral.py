"""The rendering equation at one surface point as an integral over directions, with an error
estimate.

    L(wo) = integral over the hemisphere of L_i(wi) S(wi, wo) dwi

L_i is the radiance that arrives from a direction, and S the material's shading, as in `shading`.
Radiance is in W m^-2 sr^-1, lengths are in m. All functions are for one point; use `jax.vmap` for
many.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import brdf
from ..core._arguments import takes_numbers
from ..core._numerics import reciprocal, safe_sqrt
from ..core._shown import Shown
from ..core._types import Colour, Key, check_count
from ..core._vector import Direction, Vec, Vector, as_vec
from ..geometry import Shapes, sorted_shapes
from ..geometry.hemisphere import product_nodes
from ..scene import Light, Material
from ._directions import arriving_from, balanced, local_viewer, world_direction
from .shadows import Leaving, Place


class Estimate(Shown):
    """An integral and an estimate of its error.

    Attributes:
        value: (bands,) W m^-2 sr^-1.
        error: (bands,) W m^-2 sr^-1; the function that returns the estimate describes what kind of
            error this is.

    Example:
        >>> up, grey = jnp.array([0.0, 0.0, 1.0]), jv.Lambert([0.5 / np.pi])
        >>> key, even = jax.random.key(0), lambda wi: jnp.ones(1)
        >>> found = jv.sampled_radiance(key, grey, even, up, up, samples=4)
        >>> round(float(found.value[0]), 4), round(float(found.error[0]), 4)
        (0.5, 0.0)
    """

    value: Colour
    error: Colour


@takes_numbers
def hemisphere_radiance(
    material: Material,
    incident_radiance: Callable[[Vector], Colour],
    normal: Direction,
    wo: Direction,
    *,
    tangent: Vector | None = None,
    polar: int = 32,
    azimuths: int = 64,
) -> Estimate:
    """Compute the radiance of a surface point by quadrature over the hemisphere: Gauss-Legendre
    nodes in cos(theta) times the trapezium rule in the azimuth phi.

    Args:
        material: of the surface.
        incident_radiance: from a unit direction wi, (3,), to the radiance that arrives from it,
            (bands,) W m^-2 sr^-1.
        normal: (3,) unit length.
        wo: (3,) unit length, toward the viewer.
        tangent: (3,) of any length, for an anisotropic material; None: any tangent.
        polar: static, nodes in cos(theta), >= 2.
        azimuths: static, nodes in phi, >= 2.

    Returns:
        The integral. The error is the difference from the result with half as many nodes along each
        axis. This difference is far above the true error for smooth light and surfaces, and close
        to the true error for light with edges. Both results miss a lobe or a light that lies
        between all nodes, such as the lobe of a mirror.

    Raises:
        ValueError: for fewer than 2 nodes along an axis.

    Example:
        A Lambert surface of albedo 0.5 under radiance 1 from everywhere reflects 0.5.

        >>> up, grey = jnp.array([0.0, 0.0, 1.0]), jv.Lambert([0.5 / np.pi])
        >>> found = jv.hemisphere_radiance(grey, lambda wi: jnp.ones(1), up, up)
        >>> print(found.value.round(6))
        [0.5]
    """
    check_count("polar", polar, 2)
    check_count("azimuths", azimuths, 2)
    frame, viewer = local_viewer(normal, wo, tangent)

    def integral(polar: int, azimuths: int) -> Colour:
        directions, weights = (
            jnp.asarray(x, viewer.z.dtype) for x in product_nodes(polar, azimuths)
        )

        def integrand(wi: Vec) -> Colour:
            return incident_radiance(world_direction(frame, wi, wo)) * brdf.shading(
                material, wi, viewer
            )

        return (weights[:, None] * jax.vmap(integrand)(as_vec(directions))).sum(axis=0)

    value = integral(polar, azimuths)
    return Estimate(value, jnp.abs(value - integral(polar // 2, azimuths // 2)))


@takes_numbers
def sampled_radiance(
    key: Key,
    material: Material,
    incident_radiance: Callable[[Vector], Colour],
    normal: Direction,
    wo: Direction,
    *,
    samples: int,
    tangent: Vector | None = None,
) -> Estimate:
    """Estimate the radiance of a surface point by random directions from the material's sampler.

    Args:
        key: random key.
        material, incident_radiance, normal, wo, tangent: as in `hemisphere_radiance`.
        samples: static, >= 2.

    Returns:
        The mean, which is unbiased, and its standard error, W m^-2 sr^-1. The standard error is too
        low if no sample meets a small bright light, and 0 for a mirror, which has a single
        direction.

    Raises:
        ValueError: for fewer than 2 samples.

    Example:
        For directions drawn in proportion to the cosine, uniform light gives samples without
        scatter.

        >>> up, grey = jnp.array([0.0, 0.0, 1.0]), jv.Lambert([0.5 / np.pi])
        >>> key, even = jax.random.key(0), lambda wi: jnp.ones(1)
        >>> found = jv.sampled_radiance(key, grey, even, up, up, samples=4)
        >>> round(float(found.value[0]), 4), round(float(found.error[0]), 4)
        (0.5, 0.0)
    """
    check_count("samples", samples, 2)
    frame, viewer = local_viewer(normal, wo, tangent)
    if (mirror := brdf.seen_in_mirror(material, viewer)) is not None:
        toward, reflectance = mirror
        arriving = incident_radiance(world_direction(frame, toward, wo))
        return Estimate(reflectance * arriving, jnp.zeros_like(arriving))

    def draw(u: Float[Array, "3"]) -> Colour:
        wi = as_vec(brdf.sample(material, viewer, u))
        density = brdf.pdf(material, wi, viewer)
        arriving = incident_radiance(world_direction(frame, wi, wo))
        return arriving * brdf.shading(material, wi, viewer) * reciprocal(density)

    return _mean(jax.vmap(draw)(jax.random.uniform(key, (samples, 3), viewer.z.dtype)))


@takes_numbers
def lit_radiance(
    key: Key,
    material: Material,
    light: Light,
    point: Vector,
    normal: Direction,
    wo: Direction,
    *,
    samples: int,
    tangent: Vector | None = None,
    occluders: Shapes | None = None,
) -> Estimate:
    """Estimate the radiance from a point under one extended light by multiple importance sampling.

    Each sample is a direction drawn from the light and one drawn from the material, combined by the
    balance heuristic. The error is close to that of the better of the two samplers, whether the
    lobe or the light is smaller. For several lights, and in `render`, use the sampling rule
    `Balanced`, which applies the same method.

    Args:
        key: random key.
        material, normal, wo, tangent: as in `hemisphere_radiance`.
        light: an extended light.
        point: (3,) m.
        samples: static, >= 2.
        occluders: the shapes that block light, as in `outgoing_radiance`.

    Returns:
        The mean and its standard error. The error is 0 for a mirror, which needs only one ray.

    Raises:
        ValueError: for fewer than 2 samples, or for a light without size.

    Source:
        Veach and Guibas, "Optimally Combining Sampling Techniques for Monte Carlo Rendering",
        SIGGRAPH 1995.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 1], [0, 2, 0], [2, 0, 0], [1.0])
        >>> up, white = jnp.array([0.0, 0.0, 1.0]), jv.Lambert([1 / np.pi])
        >>> args = white, lamp, jnp.zeros(3), up, up
        >>> seen = jax.jit(lambda key: jv.lit_radiance(key, *args, samples=1024))
        >>> found = seen(jax.random.key(0))
        >>> bool(abs(found.value[0] - 0.5541) < 3 * found.error[0])  # the form factor of the lamp
        True
    """
    check_count("samples", samples, 2)
    frame, viewer = local_viewer(normal, wo, tangent)
    place = None if occluders is None else Place(point, Leaving(normal), sorted_shapes(occluders))
    if (mirror := brdf.seen_in_mirror(material, viewer)) is not None:
        toward, reflectance = mirror
        arriving = arriving_from(light, point, world_direction(frame, toward, point), place)
        return Estimate(reflectance * arriving, jnp.zeros_like(arriving))

    def draw(u: Float[Array, "5"]) -> Colour:
        return balanced(material, light, point, frame, viewer, u[:2], u[2:], place)

    return _mean(jax.vmap(draw)(jax.random.uniform(key, (samples, 5), viewer.z.dtype)))


def _mean(values: Float[Array, "samples bands"]) -> Estimate:
    count = values.shape[0]
    return Estimate(values.mean(axis=0), safe_sqrt(values.var(axis=0, ddof=1) / count))
