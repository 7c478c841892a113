"""Choose the order of a quadrature over a rectangular light so that a tolerance is met at given
points."""

import math

import jax.numpy as jnp

from ..core._numerics import norm
from ..core._vector import Vec3, as_vec
from ..errors import InputError
from .rectangle import RectangleLight, _nearest_offset

ORDERS = (2, 3, 4, 6, 8, 12, 16, 24, 32)


def order_for(light: RectangleLight, points: Vec3, *, tolerance: float = 1e-4) -> int:
    """Return the order of `Quadrature` that meets a tolerance on DIFFUSE receivers at given points.

    The order is static, so call this function outside `jit`. For a glossy lobe use `Balanced`
    instead. The order n depends on the ratio of the distance d to the light's longer side s. The
    samples lie at x = d sinh(t), with t up to q = asinh(s / 2 d) on either side of the foot of the
    perpendicular from the receiver, and the integrand is singular at t = i pi / 2. The error is
    therefore proportional to rho^(-2 n), with rho = pi / 2 q + sqrt(1 + (pi / 2 q)^2), if the whole
    light is above the receiver's horizon. The constant of proportionality, 100, was measured. If
    the light crosses a receiver's horizon, the integrand has a kink and the error is about 1 / (2
    n^2).

    Args:
        light: the rectangle.
        points: (..., 3) m, the receivers.
        tolerance: relative, > 0, at every one of the points.

    Returns:
        The order, one of `ORDERS`, no unit.

    Raises:
        InputError: if even the largest order is not accurate enough.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 0], [0, 2, 0], [2, 0, 0], [1.0])
        >>> [jv.order_for(lamp, jnp.array([0.0, 0.0, -below])) for below in (1.0, 20.0)]
        [6, 2]
    """
    longest = jnp.maximum(norm(light.edge_u), norm(light.edge_v))
    nearest = float(jnp.min(norm(_nearest_offset(light, as_vec(points))) / longest))
    pole = math.pi / 2 / math.asinh(0.5 / max(nearest, 1 / 64))
    rho = pole + math.hypot(1, pole)
    needed = math.log(100 / tolerance) / (2 * math.log(rho))
    if needed > ORDERS[-1]:
        raise InputError(
            f"A tolerance of {tolerance:g} needs quadrature of order {math.ceil(needed)}, above "
            f"the largest, {ORDERS[-1]}; loosen it, or use lights.polygon.rectangle_irradiance."
        )
    return next(order for order in ORDERS if order >= needed)
