"""An environment light at infinity, given as a latitude-longitude picture of radiance.

The picture shows the surroundings as seen from inside, with the zenith at the top. Row 0 shows the
direction +z, the last row -z, and the middle column +x. Increasing columns run clockwise as seen
from above, so that +y is a quarter of the width left of the middle. Radiance is given at pixel
centres and interpolated bilinearly between them, also across the seam and the poles. Directions are
unit vectors in world coordinates. All functions are for one ray or point; use `jax.vmap` for many.
"""

from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Source, numbers
from ..core._kinds import Picture
from ..core._numerics import arctan2, divide, safe_sqrt
from ..core._types import (
    AMOUNT,
    NOT_NEGATIVE,
    Colour,
    Range,
    Scalar,
    as_float,
    check_fields,
    check_shape,
)
from ..core._vector import Direction, Vec, Vector, as_array, as_vec
from ..geometry import Ray
from ..scene import Light
from ._nodes import gauss_legendre, product
from ._registry import Incident, Seen, register_extended


class EnvironmentMap(Light):
    """A light at infinity whose radiance depends on the direction, such as a sky.

    Use `environment_map` to make an environment from a picture, with the tables for sampling.

    Attributes:
        radiance: (h, w, bands) W m^-2 sr^-1.
        rotation: (3, 3), rows the map's x, y and z axes in the world, no unit.
        rows: (h + 1,) cumulative probability of the rows, no unit.
        columns: (h, w + 1) cumulative probability of the columns within each row, no unit.
        density: (h, w) probability per solid angle, sr^-1.

    Example:
        >>> sky = jv.environment_map(np.ones((4, 8, 1)))
        >>> round(float(sky.density[0, 0]), 4)  # of the whole sphere: 1 / (4 pi)
        0.0796
    """

    spectra = ("radiance",)
    radiance: Float[Array, "h w bands"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    rows: Float[Array, " h_1"] = eqx.field(converter=as_float)
    columns: Float[Array, "h w_1"] = eqx.field(converter=as_float)
    density: Float[Array, "h w"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, radiance=AMOUNT)
        h, w, _ = self.radiance.shape
        check_shape("EnvironmentMap.rows", self.rows, (h + 1,))
        check_shape("EnvironmentMap.columns", self.columns, (h, w + 1))


def environment_radiance(environment: EnvironmentMap, direction: Direction) -> Colour:
    """Return the radiance from a unit direction, (bands,) W m^-2 sr^-1, bilinear between pixels. At
    a pole the gradient of the radiance with respect to the azimuth is 0."""
    row, column = _place(environment, _to_map(environment, direction))
    return _bilinear(environment.radiance, row, column)


def environment_sample(
    environment: EnvironmentMap, point: Vector, u: Float[Array, "2"]
) -> Incident:
    """Draw a unit direction in proportion to the radiance of the map, from `u`, (2,) uniform in [0,
    1), for row and column. Return the direction, the radiance divided by the density of the
    direction, (bands,) W m^-2, and the density, sr^-1."""
    row, row_place = _invert(environment.rows, u[0])
    column, column_place = _invert(environment.columns[row], u[1])
    h, w, _ = environment.radiance.shape
    dtype = u.dtype
    edges = jnp.asarray(np.cos(np.pi * np.arange(h + 1) / h), dtype)
    cosine = edges[row] + row_place * (edges[row + 1] - edges[row])
    direction = _direction(cosine, (column.astype(dtype) + column_place) / w)
    density = environment.density[row, column]
    drawn = density > 0
    radiance = _bilinear(environment.radiance, *_place(environment, direction))
    weight = divide(1, density, where=drawn)
    wi = _to_world(environment, direction, point)
    return Incident(wi, radiance * weight, density=density)


def environment_pdf(environment: EnvironmentMap, point: Vector, wi: Direction) -> Scalar:
    """Return the density of the directions that `environment_sample` draws, at a unit direction, ()
    in sr^-1."""
    del point
    h, w, _ = environment.radiance.shape
    row, column = _place(environment, _to_map(environment, wi))
    i = jnp.clip(jnp.floor(row + 0.5).astype(int), 0, h - 1)
    j = jnp.floor(column + 0.5).astype(int) % w
    return environment.density[i, j]


def environment_node(environment: EnvironmentMap, point: Vector, u: Float[Array, "2"]) -> Incident:
    """Map `u`, (2,) in [0, 1], to a unit direction, uniformly over the sphere, for quadrature.
    Return the direction, and 4 pi times the radiance from there, (bands,) W m^-2."""
    direction = _direction(1 - 2 * u[0], u[1])
    radiance = _bilinear(environment.radiance, *_place(environment, direction))
    return Incident(_to_world(environment, direction, point), radiance * (4 * jnp.pi))


def _radiance_along(environment: EnvironmentMap, ray: Ray) -> Seen:
    """Return the radiance of the environment along a ray, W m^-2 sr^-1, and an infinite
    distance."""
    radiance = environment_radiance(environment, ray.direction)
    return Seen(jnp.full_like(ray.origin.x, jnp.inf), radiance)


def _nodes(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a product rule on the unit square: `order` Gauss-Legendre nodes in cos(theta), and 2
    `order` nodes of the trapezium rule in the azimuth."""
    turns = 2 * order
    around = (np.arange(turns) + 0.5) / turns, np.full(turns, 1 / turns)
    return product(gauss_legendre(order), around)


def _direction(cosine: Scalar, turn: Scalar) -> Vec:
    """Return the direction, in the map's axes, at `turn` map widths from the left edge; `cosine` is
    the cosine of the angle to the pole."""
    sine, phi = safe_sqrt((1 - cosine) * (1 + cosine)), jnp.pi * (1 - 2 * turn)
    return Vec(sine * jnp.cos(phi), sine * jnp.sin(phi), cosine)


def _place(environment: EnvironmentMap, direction: Vec) -> tuple[Scalar, Scalar]:
    """Return the (row, column) of a direction in the map's axes, as real numbers that are whole at
    pixel centres."""
    h, w, _ = environment.radiance.shape
    x, y = direction.x, direction.y
    sine = safe_sqrt(x * x + y * y)
    off_pole = sine > 0
    theta = arctan2(sine, jnp.where(off_pole | (direction.z != 0), direction.z, 1))
    phi = jnp.arctan2(jnp.where(off_pole, y, 0), jnp.where(off_pole, x, 1))
    return theta * (h / jnp.pi) - 0.5, (1 - phi / jnp.pi) * (w / 2) - 0.5


def _bilinear(picture: Float[Array, "h w bands"], row: Scalar, column: Scalar) -> Colour:
    """Interpolate a picture bilinearly. Beyond a pole, the picture continues in the columns half a
    turn away."""
    h, w, _ = picture.shape
    above = jnp.floor(row)
    below_share = row - above

    def interpolate_line(i):
        over_pole = (i < 0) | (i >= h)
        at = column + jnp.where(over_pole, w / 2, 0)
        left = jnp.floor(at)
        right_share = at - left
        line = picture[jnp.clip(i, 0, h - 1).astype(int)]
        j = left.astype(int)
        return (1 - right_share) * line[j % w] + right_share * line[(j + 1) % w]

    return (1 - below_share) * interpolate_line(above) + below_share * interpolate_line(above + 1)


def _invert(cumulative: Float[Array, " n_1"], u: Scalar) -> tuple[Array, Scalar]:
    """Return the index of the cell of a cumulative distribution that contains `u`, and the position
    in the cell as a fraction of its width. `u` stands for the interval from one multiple of the
    float resolution to the next, and the position is the middle of this interval. A position is
    therefore never on the border of two cells, where rounding could select the density of the wrong
    cell."""
    last = cumulative.shape[0] - 2
    cell = jnp.clip(jnp.searchsorted(cumulative, u, side="right") - 1, 0, last)
    start, end = cumulative[cell], cumulative[cell + 1]
    wide = end > start
    before = u - start + jnp.finfo(cumulative.dtype).eps / 2
    fraction = divide(before, end - start, where=wide)
    return cell, jnp.clip(fraction, 0, 1)


def _to_map(environment: EnvironmentMap, direction: Direction) -> Vec:
    d = as_vec(direction)
    x, y, z = (row[0] * d.x + row[1] * d.y + row[2] * d.z for row in environment.rotation)
    return Vec(x, y, z)


def _to_world(environment: EnvironmentMap, direction: Vec, point: Vector) -> Vector:
    """Convert a direction to world coordinates, as an array or a `Vec`, whichever `point` is."""
    x, y, z = (as_vec(row) for row in environment.rotation)
    world = direction.x * x + direction.y * y + direction.z * z
    return as_array(world) if isinstance(point, Array) else world


def _bound(light: Ends[EnvironmentMap]) -> Source:
    """Return upper bounds on the light: the largest radiance, and the integral of the largest
    radiance around each pixel."""
    radiance = np.maximum(*(np.abs(numbers(end.radiance)) for end in light))
    peak = radiance.reshape(-1, radiance.shape[-1]).max(0)
    rows, columns, _ = radiance.shape
    wide = np.concatenate([radiance[:1], radiance, radiance[-1:]])
    near = np.maximum.reduce([wide[k : k + rows] for k in range(3)])
    near = np.maximum.reduce([np.roll(near, k, axis=1) for k in (-1, 0, 1)])
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    solid = (edges[:-1] - edges[1:])[:, None, None] * (2 * np.pi / columns)
    sent = (near * solid).sum((0, 1))
    if rows < 3:  # the poles are means of whole rows
        sent = 4 * np.pi * peak
    share = np.max(sent / np.where(peak > 0, 2 * np.pi * peak, np.inf))
    none = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    return Source(peak, *none, None, None, "sky", share=float(min(share, 1.0)), even=True)


def _from_file(
    *,
    file: Picture | None = None,
    radiance: Colour | None = None,
    sky: Annotated[int, Range(1, 16)] | None = None,
    sun: Float[Array, "3"] | None = None,
    irradiance: Colour | None = None,
    scale: Annotated[float, NOT_NEGATIVE] = 1.0,
    up: Float[Array, "3"] = (0.0, 0.0, 1.0),  # type: ignore[assignment]
    toward: Float[Array, "3"] = (1.0, 0.0, 0.0),  # type: ignore[assignment]
) -> EnvironmentMap:
    """Distant light from all directions: a picture, a constant, or one of the CIE's skies, 1 to 16
    (`lights.daylight`), given its irradiance on level ground and the direction of the sun.

    Args:
        file: path of a latitude-longitude picture of radiance, W m^-2 sr^-1, relative to the scene
            file.
        radiance: (bands,) W m^-2 sr^-1, from all directions.
        sky: number of a CIE sky, 1 to 15, or 16 for the traditional overcast sky.
        sun: (3,) toward the sun of the `sky` (its length is ignored), not below the horizon; by
            default [0, 0, 1].
        irradiance: (bands,) W m^-2 of the `sky` on open level ground.
        scale: factor on the light, no unit.
        up: (3,) direction of the picture's upper pole in the world.
        toward: (3,) direction of the picture's middle column in the world; its component along `up`
            is ignored.
    """
    from .environment_tables import environment_map
    from .skies import daylight

    if sum(x is not None for x in (file, radiance, sky)) != 1:
        raise ValueError("give either file, radiance or sky.")
    if (sky is None) != (irradiance is None) or (sky is None and sun is not None):
        raise ValueError("a sky has its irradiance, and may have a sun; give them with a sky only.")
    if sky is not None and irradiance is not None:
        toward_sun = (0.0, 0.0, 1.0) if sun is None else sun
        light = daylight(sky, toward_sun, irradiance=np.asarray(irradiance) * float(scale))
        file = light.radiance
    picture: Any = file
    if radiance is not None:
        picture = np.broadcast_to(np.asarray(radiance), (4, 8, np.size(radiance)))
    left = np.cross(up, toward)
    if np.linalg.norm(left) <= 1e-9:
        raise ValueError("up and toward lie on one line; give another toward.")
    axes = np.stack([np.cross(left, up), left, np.asarray(up)])
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return environment_map((1 if sky else float(scale)) * picture, rotation=axes)


register_extended(
    EnvironmentMap,
    seen=_radiance_along,
    sample=environment_sample,
    pdf=environment_pdf,
    node=environment_node,
    nodes=_nodes,
    bound=_bound,
    word="environment",
    from_file=_from_file,
)
