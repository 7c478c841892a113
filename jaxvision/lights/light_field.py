"""A light given by a 4-D light field: the radiance along all lines through two parallel windows,
sampled on a grid.

A line is given by its position (s, t) in one window, the aperture, and its position (u, v) in the
other, the focal window. Light leaves through the aperture, toward its front. The focal window is
behind or in front of the aperture. Sources: Levoy and Hanrahan, "Light Field Rendering", SIGGRAPH
1996; Gortler et al., "The Lumigraph", SIGGRAPH 1996. Lengths are in m, radiance is in W m^-2 sr^-1.
All functions are for one ray or point; use `jax.vmap` for many.
"""

from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import dot, norm, normalize, reciprocal, unknown_at_nan
from ..core._types import AMOUNT, Colour, Scalar, as_float, check_fields, is_known
from ..core._vector import Direction, Vec, Vector, as_array, as_vec
from ..geometry import Ray
from ..geometry.hemisphere import cross
from ..scene import Light
from ._nodes import square_nodes
from ._registry import Emitted, Incident, Seen, register_extended
from .window import Window, _window_bound, crossing, hit_window, window_pdf, window_sample


class LightFieldLight(Light):
    """A window whose radiance depends on position and direction, as recorded in a light field.

    The window illuminates surfaces in front of it, and a camera that looks at the window sees the
    recorded scene behind it.

    Attributes:
        radiance: (s, t, u, v, bands) W m^-2 sr^-1; the first and last sample of each axis lie on
            the edges of the windows.
        aperture: the window (s, t), one-sided; lengths in m.
        focal: the window (u, v), parallel to the aperture to 1 mrad and not in its plane; lengths
            in m.

    Raises:
        ValueError: for windows that are not parallel, lie in one plane or have no area.

    Example:
        >>> near, far = (jv.Window([0, 0, z], [1, 0, 0], [0, 1, 0]) for z in (0, -1))
        >>> brighter_to_the_right = jnp.array([0.0, 4.0]).reshape(1, 1, 2, 1, 1)
        >>> light_field = jv.LightFieldLight(brighter_to_the_right, near, far)
        >>> ray = jv.Ray([0.25, 0.5, 2], [0, 0, -1])
        >>> float(jv.lights.radiance_along(light_field, ray).radiance[0])
        1.0
    """

    spectra = ("radiance",)
    radiance: Float[Array, "s t u v bands"] = eqx.field(converter=as_float)
    aperture: Window
    focal: Window

    def __check_init__(self) -> None:
        check_fields(self, radiance=AMOUNT)
        if 0 in self.radiance.shape:
            raise ValueError(
                "LightFieldLight.radiance must have at least one sample along each axis, got shape "
                f"{self.radiance.shape}."
            )
        if all(is_known(x) for x in jax.tree.leaves((self.aperture, self.focal))):
            _check_windows(self.aperture, self.focal)


_PARALLEL = 1e-3  # largest angle between the windows, rad; float32 rounding is smaller
_APART = 1e-5  # smallest distance between their planes, relative to the largest length


def _check_windows(aperture: Window, focal: Window) -> None:
    """Raise `ValueError` unless the windows have area, are parallel and lie in different planes."""
    normals, lengths = [], []
    for name, window in (("aperture", aperture), ("focal", focal)):
        u, v = (np.asarray(edge, np.float64) for edge in (window.edge_u, window.edge_v))
        across, sides = np.cross(u, v), (np.linalg.norm(u), np.linalg.norm(v))
        area = np.linalg.norm(across)
        if not area > _APART * sides[0] * sides[1]:
            raise ValueError(f"LightFieldLight.{name} must be a window with an area, got {area:g}.")
        normals.append(across / area)
        lengths += sides
    tilt = np.arcsin(min(np.linalg.norm(np.cross(*normals)), 1))
    if tilt > _PARALLEL:
        raise ValueError(
            f"LightFieldLight.focal must be parallel to the aperture, got {tilt:.3g} rad between "
            "them."
        )
    between = np.asarray(focal.corner, np.float64) - np.asarray(aperture.corner, np.float64)
    distance = abs(between @ normals[0])
    if not distance > _APART * max(*lengths, np.linalg.norm(between)):
        raise ValueError(
            "LightFieldLight.focal must lie behind or before the aperture, got a distance of "
            f"{distance:g} m between their planes."
        )


def light_field_radiance(light_field: LightFieldLight, ray: Ray) -> Colour:
    """Return the radiance that comes along a ray from the aperture, (bands,) W m^-2 sr^-1, by
    quadrilinear interpolation; 0 if the ray misses a window. The ray starts in front of the
    aperture."""
    return light_field_seen(light_field, ray).radiance


def light_field_seen(light_field: LightFieldLight, ray: Ray) -> Seen:
    """Return `light_field_radiance`, W m^-2 sr^-1, and the distance to the aperture, m."""
    near, hit = hit_window(ray, light_field.aperture)
    far = crossing(ray, light_field.focal)
    hit &= far.meets & (far.u >= 0) & (far.u <= 1) & (far.v >= 0) & (far.v <= 1)
    places = jnp.stack([jnp.where(hit, x, 0) for x in (near.u, near.v, far.u, far.v)])
    radiance = jnp.where(hit, _interpolate(light_field.radiance, places), 0)
    return Seen(jnp.where(hit, near.distance, jnp.inf), radiance)


def light_field_sample(
    light_field: LightFieldLight, point: Vector, u: Float[Array, "2"]
) -> Incident:
    """Map `u`, (2,) in [0, 1], to a position in the aperture. Return the unit direction from
    `point` to this position, the radiance times the solid angle, (bands,) W m^-2, the distance, m,
    and the density, sr^-1."""
    direction, distance, solid_angle, _ = window_sample(light_field.aperture, point, u)
    radiance = light_field_radiance(light_field, Ray(point, direction))
    wi = as_array(direction) if isinstance(point, Array) else direction
    return Incident(wi, radiance * solid_angle, distance, reciprocal(solid_angle))


def light_field_pdf(light_field: LightFieldLight, point: Vector, wi: Direction) -> Scalar:
    """Return the density of the directions that `light_field_sample` returns for uniform `u`, in
    sr^-1."""
    return window_pdf(light_field.aperture, point, wi)


@takes_numbers
def light_field_ray(aperture: Window, focal: Window, place: Float[Array, "4"]) -> Ray:
    """Return the ray along which one sample of a light field is recorded, at `place` = (s, t, u, v)
    in [0, 1] of the windows. The ray starts in the aperture and points away from its front."""
    start = _point(aperture, place[:2])
    return Ray(start, _inward(aperture, start, _point(focal, place[2:])))


@takes_numbers
def refocus(
    light_field: LightFieldLight, focus: Vector, *, order: int = 8, opening: float = 1.0
) -> Colour:
    """Return the mean radiance on the lines from the aperture to one point.

    This mean is the value of a pixel that images the point through a lens as large as the aperture.
    Surfaces at the depth of the point are sharp, others are blurred.

    Args:
        light_field: the light field.
        focus: (3,) m.
        order: number of Gauss-Legendre nodes along each side; static.
        opening: used fraction of the aperture about its middle, in (0, 1], no unit; a smaller one
            gives a larger depth of field.

    Returns:
        The radiance, (bands,) W m^-2 sr^-1.

    Source: Isaksen, McMillan & Gortler, "Dynamically Reparameterized Light Fields", SIGGRAPH 2000.

    Example:
        >>> near, far = (jv.Window([0, 0, z], [1, 0, 0], [0, 1, 0]) for z in (0, -1))
        >>> brighter_to_the_right = jnp.array([0.0, 4.0]).reshape(1, 1, 2, 1, 1)
        >>> light_field = jv.LightFieldLight(brighter_to_the_right, near, far)
        >>> focus = jnp.array([0.25, 0.5, -1.0])  # on the focal window: all lines are alike
        >>> round(float(jax.jit(jv.refocus)(light_field, focus)[0]), 4)
        1.0
    """
    nodes, weights = square_nodes(order)
    aperture, dtype = light_field.aperture, light_field.radiance.dtype
    target = as_array(focus)

    def through(node):
        start = _point(aperture, 0.5 + opening * (node - 0.5))
        direction = _inward(aperture, start, target)
        return light_field_radiance(light_field, Ray(start - as_array(direction), direction))

    radiance = jax.vmap(through)(jnp.asarray(nodes, dtype))
    mean = (jnp.asarray(weights, dtype)[:, None] * radiance).sum(axis=0)
    return unknown_at_nan(mean, target)


def _inward(aperture: Window, start: Float[Array, "3"], target: Float[Array, "3"]) -> Vec:
    """Return the unit direction of the line through two points, pointing away from the front of the
    aperture."""
    along = as_vec(normalize(target - start))
    forward = dot(cross(aperture.edge_u, aperture.edge_v), along) > 0
    return along * jnp.where(forward, -1, 1).astype(start.dtype)


def _point(window: Window, place: Float[Array, "2"]) -> Float[Array, "3"]:
    return window.corner + place[0] * window.edge_u + place[1] * window.edge_v


def _interpolate(grid: Float[Array, "s t u v bands"], places: Float[Array, "4"]) -> Colour:
    """Interpolate linearly along all four axes between the sixteen samples around a position."""
    cells = []
    for at, size in zip(places, grid.shape[:4], strict=True):
        at = at * (size - 1)
        below = jnp.clip(jnp.floor(at).astype(int), 0, max(size - 2, 0))
        share = at - below.astype(at.dtype)
        cells.append(((below, 1 - share), (jnp.minimum(below + 1, size - 1), share)))
    total = jnp.zeros(grid.shape[4], grid.dtype)
    for (s, a), (t, b), (u, c), (v, d) in product(*cells):
        total = total + (a * b * c * d) * grid[s, t, u, v]
    return total


def _emit(light: LightFieldLight, u: Float[Array, "4"]) -> Emitted:
    """Draw a ray through a random point of the aperture and a random point of the focal window,
    from `u`, (4,) uniform in [0, 1). Return the ray and its flux, (bands,) W."""
    start, target = as_vec(_point(light.aperture, u[:2])), as_vec(_point(light.focal, u[2:]))
    span = cross(light.aperture.edge_u, light.aperture.edge_v)
    normal, whole = as_vec(normalize(span)), norm(span)
    line = start - target
    inverse = reciprocal(norm(line))
    away = line * (inverse * jnp.where(dot(normal, line) < 0, -1, 1).astype(u.dtype))
    cosine = dot(normal, away)
    focal = norm(cross(light.focal.edge_u, light.focal.edge_v))
    solid_angle = focal * cosine * inverse * inverse
    radiance = light_field_radiance(light, Ray(start + away, -away))
    return Emitted(Ray(start, away), radiance * (whole * cosine * solid_angle), normal)


register_extended(
    LightFieldLight,
    seen=light_field_seen,
    sample=light_field_sample,
    pdf=light_field_pdf,
    emitted=_emit,
    bound=lambda light: _window_bound(light, light.field("aperture")),
    word="",
)
