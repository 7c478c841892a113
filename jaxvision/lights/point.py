"""A point light with the same intensity in every direction. The irradiance from it is inversely
proportional to the square of the distance."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Source, box_corners, numbers, peak
from ..core._loops.bands import map_bands
from ..core._numerics import dot, or_one, smallest_divisor
from ..core._types import AMOUNT, Colour, Scalar, as_float, check_fields
from ..core._vector import Vector, as_vec
from ..geometry.hemisphere import direction_at
from ..scene import Light
from ._emission import emitted_from_point
from ._registry import Emitted, Incident, register


class PointLight(Light):
    """An isotropic point source.

    Attributes:
        position: (3,) m.
        intensity: (bands,) W sr^-1.

    Example:
        >>> lamp = jv.PointLight([0.0, 0.0, 3.0], [18.0])
        >>> round(float(jv.incident(lamp, jnp.zeros(3)).irradiance[0]), 4)  # 18 / 3^2
        2.0
    """

    spectra = ("intensity",)
    position: Float[Array, "3"] = eqx.field(converter=as_float)
    intensity: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, intensity=AMOUNT)


def from_point_light(light: PointLight, point: Vector) -> Incident:
    """Return the light that arrives from a point light: the unit direction, the irradiance E = I /
    d^2 on a surface that faces it, (bands,) W m^-2, and the distance d, m. Here I is the intensity.
    Direction, irradiance and distance are 0 if the distance is below `smallest_divisor`."""
    direction, distance, dilution = _toward(light.position, point)
    return Incident(direction, map_bands(lambda band: band * dilution, light.intensity), distance)


def _toward(position: Float[Array, "3"], point: Vector) -> tuple[Vector, Scalar, Scalar]:
    """Return the unit direction from a point to a position, the distance, m, and its inverse
    square, m^-2; all 0 if the two coincide."""
    toward = position - point
    square = dot(toward, toward)
    apart = ~(square <= smallest_divisor(square.dtype) ** 2)
    divisor = or_one(square, apart)
    nearness, dilution = (jnp.where(apart, x, 0) for x in (jax.lax.rsqrt(divisor), 1 / divisor))
    return toward * nearness, square * nearness, dilution


def _emit(light: PointLight, u: Float[Array, "4"]) -> Emitted:
    """Draw a ray in a direction that is uniform over the sphere, from u_2 and u_3 of `u`, (4,)
    uniform in [0, 1). The flux of the ray is 4 pi I, (bands,) W, where I is the intensity."""
    direction = direction_at(2 * u[2], 2 * jnp.pi * u[3])
    return emitted_from_point(as_vec(light.position), direction, 4 * jnp.pi * light.intensity)


def _place_bound(light: Ends[Any], *, normal: np.ndarray | None = None) -> Source:
    """Return upper bounds on the light of a point lamp. The lamp emits in all directions or, if
    `normal` is given, to the side of `normal` only."""
    points = box_corners(numbers(light.low.position), numbers(light.high.position))
    middle = points.mean(0)
    size = np.linalg.norm(points - middle, axis=1).max()
    body, own = (points, np.zeros(len(points))), np.array([1.0])
    return Source(peak(light, "intensity"), middle[None], own * size, own, normal, body, "place")


register(PointLight, incident=from_point_light, emitted=_emit, bound=_place_bound)
