"""A rectangle that emits equally in all directions, with one radiance over its front.

Directions and lengths (m) in the world; for ONE point, the caller vmaps. `polygon` has the exact
irradiance. This module has samples for any BRDF.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Source, numbers
from ..core._numerics import dot, reciprocal
from ..core._types import AMOUNT, Colour, Scalar, as_float, check_direction, check_fields, is_known
from ..core._vector import Direction, Vec, Vector, as_array, as_vec
from ..geometry import Ray
from ..scene import Light, Quad
from ._emission import emitted_from_surface
from ._registry import Emitted, Incident, Seen, register_extended
from .small import SmallLight
from .window import Window, _window_bound, hit_window, window_pdf, window_sample


class RectangleLight(Light):
    """A one-sided, uniform, diffusely emitting rectangle.

    It emits to the side of edge_u x edge_v. Points behind it, in its plane and on it receive
    nothing.

    Attributes:
        corner: (3,) m.
        edge_u: (3,) m, from the corner along one side.
        edge_v: (3,) m, along the other side, perpendicular to the first (any parallelogram is
            correct; a skew one is sampled less efficiently).
        radiance: (bands,) W m^-2 sr^-1.

    Example:
        A lamp of 1 km side, 1 m above, fills the sky.

        >>> lamp = jv.RectangleLight([-500, -500, 1], [0, 1000, 0], [1000, 0, 0], [1 / np.pi])
        >>> floor = jnp.array([0.0, 0.0, 1.0])
        >>> round(float(jv.rectangle_irradiance(lamp, jnp.zeros(3), floor)[0]), 3)  # pi L
        1.0
    """

    spectra = ("radiance",)
    corner: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_u: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_v: Float[Array, "3"] = eqx.field(converter=as_float)
    radiance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, radiance=AMOUNT)
        check_direction("RectangleLight.edge_u", self.edge_u)
        check_direction("RectangleLight.edge_v", self.edge_v)
        _check_not_parallel(self.edge_u, self.edge_v)


_FLAT = 1e-9  # sine of the angle between edges that are called parallel


def _check_not_parallel(one: Float[Array, "3"], other: Float[Array, "3"]) -> None:
    """`ValueError` for known edges that are parallel, which leave no area."""
    if not (is_known(one) and is_known(other)):
        return
    u, v = (np.asarray(x, float) / np.linalg.norm(np.asarray(x, float)) for x in (one, other))
    if np.linalg.norm(np.cross(u, v)) < _FLAT:
        raise ValueError("RectangleLight.edge_u and edge_v are parallel: these edges span no area.")


def window_of(light: RectangleLight) -> Window:
    """The rectangle without its radiance; lengths in m."""
    return Window(light.corner, light.edge_u, light.edge_v)


def _nearest_offset(light: RectangleLight, points: Vec) -> Vec:
    """The vector from the nearest point of the rectangle to each point, m."""
    apart = nearest = points - light.corner
    for edge in (as_vec(light.edge_u), as_vec(light.edge_v)):
        share = dot(apart, edge) * reciprocal(dot(edge, edge))
        nearest = nearest - jnp.clip(share, 0, 1) * edge
    return nearest


def rectangle_seen(light: RectangleLight, ray: Ray) -> Seen:
    """The radiance of the front that a ray hits, (bands,) W m^-2 sr^-1, and its distance, m."""
    at, hit = hit_window(ray, window_of(light))
    return Seen(jnp.where(hit, at.distance, jnp.inf), jnp.where(hit, light.radiance, 0))


def rectangle_sample(light: RectangleLight, point: Vector, u: Float[Array, "2"]) -> Incident:
    """A unit direction toward a position of the rectangle selected by `u`, (2,) in [0, 1], L times
    solid angle, (bands,) W m^-2, and the distance, m."""
    direction, distance, solid_angle, _ = window_sample(window_of(light), point, u)
    wi = direction if not isinstance(point, Array) else as_array(direction)
    return Incident(wi, light.radiance * solid_angle, distance)


def rectangle_pdf(light: RectangleLight, point: Vector, wi: Direction) -> Scalar:
    """Density of the directions of `rectangle_sample` toward the unit `wi` from `point`, sr^-1."""
    return window_pdf(window_of(light), point, wi)


def _emitted(light: RectangleLight, u: Float[Array, "4"]) -> Emitted:
    """A ray from a position of the front, uniform by area and cosine-distributed about its normal;
    `u`: (4,) uniform in [0, 1). Its flux is pi A L, (bands,) W."""
    quad = Quad(light.corner, light.edge_u, light.edge_v)
    return emitted_from_surface(quad, light.radiance, u)


def _small_light(light: RectangleLight) -> SmallLight:
    """The light of the same flux at the rectangle's middle, of intensity A L, W sr^-1."""
    u, v = numbers(light.edge_u), numbers(light.edge_v)
    across = np.cross(u, v)
    area = np.linalg.norm(across)
    fields = numbers(light.corner) + (u + v) / 2, across / area, numbers(light.radiance) * area
    return SmallLight(*(x.astype(light.radiance.dtype) for x in fields))


def _bound(light: Ends[RectangleLight]) -> Source:
    """A window, which a small light at its middle may replace if it is fixed."""
    source = _window_bound(light, light)._replace(even=True)
    u, v = numbers(light.low.edge_u), numbers(light.low.edge_v)
    if light.low is not light.high or not np.any(np.cross(u, v)):
        return source
    return source._replace(small=(u, v, _small_light(light.low)))


register_extended(
    RectangleLight,
    seen=rectangle_seen,
    sample=rectangle_sample,
    pdf=rectangle_pdf,
    emitted=_emitted,
    bound=_bound,
)
