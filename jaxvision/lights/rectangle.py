"""A rectangular light with the same radiance at all points of its front and in all directions.

Directions and lengths (m) are in world coordinates. All functions are for one point; use `jax.vmap`
for many. This module samples the light, for any BRDF; `polygon` computes the exact irradiance.
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

    The rectangle emits to the side of edge_u x edge_v. Points behind the rectangle, in its plane
    and on it receive no light.

    Attributes:
        corner: (3,) m.
        edge_u: (3,) m, from the corner along one side.
        edge_v: (3,) m, along the other side, perpendicular to the first (any parallelogram is
            correct; a skew one is sampled less efficiently).
        radiance: (bands,) W m^-2 sr^-1.

    Example:
        A lamp of 1 km side, 1 m above the floor, fills the sky.

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


_FLAT = 1e-9  # edges count as parallel if the sine of their angle is smaller


def _check_not_parallel(one: Float[Array, "3"], other: Float[Array, "3"]) -> None:
    """Raise `ValueError` for parallel edges, which span no area; edges that JAX traces are not
    checked."""
    if not (is_known(one) and is_known(other)):
        return
    u, v = (np.asarray(x, float) / np.linalg.norm(np.asarray(x, float)) for x in (one, other))
    if np.linalg.norm(np.cross(u, v)) < _FLAT:
        raise ValueError("RectangleLight.edge_u and edge_v are parallel: these edges span no area.")


def window_of(light: RectangleLight) -> Window:
    """Return the geometry of a rectangular light, lengths in m."""
    return Window(light.corner, light.edge_u, light.edge_v)


def _nearest_offset(light: RectangleLight, points: Vec) -> Vec:
    """Return the vector from the nearest point of the rectangle to each point, m."""
    apart = nearest = points - light.corner
    for edge in (as_vec(light.edge_u), as_vec(light.edge_v)):
        share = dot(apart, edge) * reciprocal(dot(edge, edge))
        nearest = nearest - jnp.clip(share, 0, 1) * edge
    return nearest


def rectangle_seen(light: RectangleLight, ray: Ray) -> Seen:
    """Return the radiance of the rectangle's front along a ray, (bands,) W m^-2 sr^-1, and the
    distance, m."""
    at, hit = hit_window(ray, window_of(light))
    return Seen(jnp.where(hit, at.distance, jnp.inf), jnp.where(hit, light.radiance, 0))


def rectangle_sample(light: RectangleLight, point: Vector, u: Float[Array, "2"]) -> Incident:
    """Map `u`, (2,) in [0, 1], to a position in the rectangle. Return the unit direction from
    `point` to this position, the radiance times the solid angle, (bands,) W m^-2, the distance, m,
    and the density, sr^-1."""
    direction, distance, solid_angle, _ = window_sample(window_of(light), point, u)
    wi = direction if not isinstance(point, Array) else as_array(direction)
    return Incident(wi, light.radiance * solid_angle, distance, reciprocal(solid_angle))


def rectangle_pdf(light: RectangleLight, point: Vector, wi: Direction) -> Scalar:
    """Return the density of the directions that `rectangle_sample` returns for uniform `u`, at the
    unit direction `wi` from `point`, in sr^-1."""
    return window_pdf(window_of(light), point, wi)


def _emit(light: RectangleLight, u: Float[Array, "4"]) -> Emitted:
    """Draw a ray from the rectangle's front, uniform by area and cosine-distributed about the
    normal, from `u`, (4,) uniform in [0, 1). The flux of the ray is pi A L, (bands,) W, where A is
    the area and L the radiance."""
    quad = Quad(light.corner, light.edge_u, light.edge_v)
    return emitted_from_surface(quad, light.radiance, u)


def _small_light(light: RectangleLight) -> SmallLight:
    """Return a small light at the rectangle's middle that has the same flux. The intensity of the
    small light is A L, W sr^-1, where A is the area and L the radiance."""
    u, v = numbers(light.edge_u), numbers(light.edge_v)
    across = np.cross(u, v)
    area = np.linalg.norm(across)
    fields = numbers(light.corner) + (u + v) / 2, across / area, numbers(light.radiance) * area
    return SmallLight(*(x.astype(light.radiance.dtype) for x in fields))


def _bound(light: Ends[RectangleLight]) -> Source:
    """Return upper bounds on the light of a rectangle (`_window_bound`). For a fixed rectangle,
    also return the small light at its middle that may replace it."""
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
    emitted=_emit,
    bound=_bound,
)
