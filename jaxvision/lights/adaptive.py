"""The irradiance of a uniform rectangle on many receivers, by Gauss-Legendre quadrature. The order
of the quadrature is selected at run time from the ratio of distance to size.

On a receiver at distance d from an edge of length s, the error of n nodes per side is K rho^(-2 n)
with rho = x + sqrt(1 + x^2) and x = 2 d / s. If positions on the edge are complex numbers, the
integrand is singular where the distance is 0. Here rho is the sum of the half-axes of the largest
ellipse, with foci at the ends of the edge scaled to [-1, 1], in which the integrand is analytic
(Trefethen, Approximation Theory and Approximation Practice, 2013, theorem 19.3). The constant K was
measured.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..core._arguments import takes_numbers
from ..core._loops.fusion import one_program
from ..core._numerics import dot, or_one
from ..core._types import Scalars
from ..core._vector import Vec, Vec3, as_vec
from .polygon import nodes_integral, rectangle_irradiance
from .rectangle import RectangleLight, _nearest_offset

_ORDERS = (2, 3, 4, 6)  # nodes per side; more nodes take as long as the closed form
_FACTOR = 100.0  # K; one in a thousand of the receivers that see the whole light has a larger error


@takes_numbers
def adaptive_irradiance(
    light: RectangleLight,
    points: Vec3,
    normals: Vec3,
    *,
    tolerance: float = 1e-4,
) -> Float[Array, " receivers bands"]:
    """Compute the irradiance of a rectangle on neighbouring receivers, within a tolerance.

    All receivers use the same number of nodes, the smallest that suffices for the receiver nearest
    to the light. All receivers use the closed form if the nearest receiver is too near the light
    for quadrature, or if the light crosses the horizon of any receiver. For a large field of
    receivers, map this function over tiles (`jax.lax.map`), so that each tile gets its own number
    of nodes. Under `vmap`, quadratures of all orders are computed, which is slow.

    Args:
        light: the rectangle.
        points: (receivers, 3) m.
        normals: (receivers, 3) unit, or (3,) for all.
        tolerance: relative, > 0; static. Rounding errors add to it, see
            `polygon.rectangle_irradiance`. For a light near the horizon, the tolerance is relative
            to the irradiance on a receiver that faces the light.

    Returns:
        The irradiance, (receivers, bands) W m^-2.

    Raises:
        ValueError: if the tolerance is not above 0, or there is no receiver.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 1], [0, 2, 0], [2, 0, 0], [1 / np.pi])
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> found = jax.jit(lambda points: jv.adaptive_irradiance(lamp, points, up, tolerance=0.01))
        >>> round(float(found(jnp.zeros((1, 3)))[0, 0]), 2)  # 4 x 0.1385, that of a corner
        0.55
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance must be above 0, got {tolerance}.")
    points, normals = as_vec(points), as_vec(normals)
    if points.x.size == 0:
        raise ValueError("adaptive_irradiance: points must hold at least one receiver, got none.")
    return _adaptive(light, points, normals, float(tolerance))


@one_program
def _adaptive(light: RectangleLight, points: Vec, normals: Vec, tolerance: float) -> Array:
    def integral_of_order(order: int):
        def integral(light: RectangleLight, points: Vec, normals: Vec) -> Array:
            # lengths in units of the longer edge, so that fourth powers stay in range
            u, v = as_vec(light.edge_u), as_vec(light.edge_v)
            square = jax.lax.stop_gradient(jnp.maximum(dot(u, u), dot(v, v)))
            scale = jax.lax.rsqrt(or_one(square))
            corner = (light.corner - points) * scale
            solid = nodes_integral(corner, u * scale, v * scale, normals, order=order)
            return solid[:, None] * light.radiance[None]

        return integral

    def closed_form(light: RectangleLight, points: Vec, normals: Vec) -> Array:
        axes = (None, 0, 0 if normals.x.ndim else None)
        return jax.vmap(rectangle_irradiance, axes)(light, points, normals)

    rule = jnp.max(jax.lax.stop_gradient(_rules(light, points, normals, tolerance)))
    branches = [*(integral_of_order(order) for order in _ORDERS), closed_form]
    return jax.lax.switch(rule, branches, light, points, normals)


def _rules(light: RectangleLight, points: Vec, normals: Vec, tolerance: float) -> Int[Array, "..."]:
    """Return the quadrature order that each receiver needs, as an index into `_ORDERS`. The index
    len(_ORDERS) stands for the closed form."""
    u, v = as_vec(light.edge_u), as_vec(light.edge_v)
    apart = points - light.corner
    nearest = _nearest_offset(light, points)
    distance, size = dot(nearest, nearest), jnp.maximum(dot(u, u), dot(v, v))
    needed = jnp.zeros(distance.shape, jnp.int32)
    for order in _ORDERS:
        enough = math.sinh(math.log(max(_FACTOR / tolerance, 1)) / (2 * order)) / 2
        needed = needed + (distance < enough * enough * size).astype(jnp.int32)
    height, along, across = -dot(normals, apart), dot(normals, u), dot(normals, v)
    heights: list[Scalars] = [height, height + along, height + across, height + along + across]
    above = [h >= 0 for h in heights]
    whole = (above[0] == above[1]) & (above[0] == above[2]) & (above[0] == above[3])
    return jnp.where(whole, needed, len(_ORDERS))
