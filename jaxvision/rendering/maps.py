"""Evaluate materials that vary over a surface, at one point or averaged over the footprint of a
pixel.

Between the centres of texels a map is bilinear. The rays of a pixel project onto a parallelogram of
the surface. The parallelogram is approximated by a box in texture coordinates, with sides along u
and v, whose variances along u and v are those of the parallelogram. The approximation is exact if
the sides of the parallelogram are along u and v. The integral over the box is exact. Along each
axis, the box covers parts of two texels at each end, and whole texels between. The sums of whole
texels are differences of a summed-area table (Crow, SIGGRAPH 1984). Each entry of the table is
stored as two numbers, so that differences of large sums lose no digits. All functions are for one
point; use `jax.vmap` for many. Lengths are in metres.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..core._arguments import takes_numbers
from ..core._maps import maps_of, replace_maps
from ..core._numerics import arctan2, divide, dot, normalize, replace_gradient, safe_sqrt
from ..core._types import Scalar, Varying
from ..core._vector import Vec, as_vec, where
from ..geometry import Hit, Ray
from ..geometry.hemisphere import cross
from ..scene import Map, Material, Scene, Shape, TriangleMesh
from ._coordinates import Coordinates, coordinates
from .pixel_loop import PixelRay

_NARROWEST = 2.0**-10  # texels; a narrower box is widened to it
_WIDEST = 2.0**20  # texels; a wider box is cut to it


class Summed(Varying):
    """A map with its summed-area table. `values`, `uv` and `wrap` are copied from the map. `mean`,
    (...), is the mean of the values. The mean is subtracted before summing. The table is the sum of
    `high` and `low`, (rows + 1, columns + 1, ...). The entry (i, j) of the table is the sum of the
    texels above row i and left of column j."""

    values: Array
    uv: Array | None
    mean: Array
    high: Array
    low: Array
    wrap: str = eqx.field(static=True)


class Varied(eqx.Module):
    """The shapes, the normal maps (or None) and the indices of those surfaces of a scene that have
    maps."""

    shapes: tuple[Shape, ...]
    normals: tuple[Any, ...]
    numbers: tuple[int, ...] = eqx.field(static=True)


class Patch(eqx.Module):
    """The piece of a surface that the ray of a pixel hits. `point` is its position, m, and `own`
    are the shape's texture coordinates there. `tilted` is the unit shading normal from a normal
    map, or None. `steps` are the vectors along the surface to the next row and column of pixels, m,
    or None for a point without extent."""

    point: Vec
    own: Coordinates
    tilted: Vec | None
    steps: tuple[Vec, Vec] | None


# ---------------------------------------------------------------- values of a map


@takes_numbers
def material_at(
    material: Material, uv: Float[Array, "2"], *, width: Float[Array, "2"] | None = None
) -> Material:
    """Evaluate a material at one point of its surface: replace its maps by numbers.

    Args:
        material: any material, with or without maps.
        uv: (2,) no unit, the shape's texture coordinates at the place.
        width: (2,) no unit, sides of the box in the shape's coordinates over which maps are
            averaged; None for the values at the place.

    Returns:
        The material.

    Raises:
        ValueError: for a map whose `uv` of (2, 4) places it in the world.

    Example:
        >>> stripes = jv.Map([[[0.0], [0.3], [0.0], [0.3]]])
        >>> cloth, place = jv.Lambert(stripes), jnp.array([0.375, 0.5])  # centre of a bright stripe
        >>> widths = None, jnp.array([0.25, 1.0]), jnp.array([0.5, 1.0])
        >>> seen = (jv.material_at(cloth, place, width=width) for width in widths)
        >>> [round(float(there.diffuse[0]), 4) for there in seen]
        [0.3, 0.225, 0.15]
    """
    for name, found in maps_of(material):
        if found.uv is not None and found.uv.shape[-1] == 4:
            raise ValueError(f"material_at: {name} is placed by points of the world, not by uv.")
    zero = jnp.zeros_like(uv[0])
    across, down = Vec(zero + 1, zero, zero), Vec(zero, zero + 1, zero)
    steps = None if width is None else (width[0] * across, width[1] * down)
    own = Coordinates(uv[0], uv[1], across, down)
    ready = material if width is None else replace_maps(material, summed)
    return evaluate_maps(ready, Patch(Vec(zero, zero, zero), own, None, steps))


def evaluate_maps(record: Any, patch: Patch) -> Any:
    """Replace the maps of a record by their values at a patch. If `patch.steps` is not None, each
    map must be a `Summed`."""
    return replace_maps(record, lambda own: _value(own, patch))


def _value(own: Any, patch: Patch) -> Array:
    """Return the value of a map at a patch, averaged over it if it has an extent, in the map's
    unit."""
    here = _coordinates(own.uv, patch)
    rows, columns = own.values.shape[:2]
    if patch.steps is None or not isinstance(own, Summed):
        (i, p), (j, q) = (
            _neighbouring_texels(here.v, rows, own.wrap),
            _neighbouring_texels(here.u, columns, own.wrap),
        )
        near = [[own.values.at[a, b].get(mode="promise_in_bounds") for b in j] for a in i]
        above, below = (left + q * (right - left) for left, right in near)
        return above + p * (below - above)
    down, right = patch.steps
    width, height = (
        safe_sqrt(dot(along, down) ** 2 + dot(along, right) ** 2)
        for along in (here.along_u, here.along_v)
    )
    columns_of, shares_x = _pieces(here.u, width, columns, own.wrap)
    rows_of, shares_y = _pieces(here.v, height, rows, own.wrap)
    pieces = _sums(own.high, rows_of, columns_of) + _sums(own.low, rows_of, columns_of)
    return own.mean + jnp.tensordot(shares_x, jnp.tensordot(shares_y, pieces, 1), 1)


def _coordinates(uv: Array | None, patch: Patch) -> Coordinates:
    """Return the texture coordinates of a map at a patch. If `uv` is None, they are the coordinates
    of the shape. Otherwise they are computed by the matrix `uv`: from the shape's coordinates, or
    from the point in the world if `uv` is (2, 4)."""
    own = patch.own
    if uv is None:
        return own
    if uv.shape[-1] == 4:
        u, v = (dot(as_vec(row[:3]), patch.point) + row[3] for row in uv)
        along_u, along_v = (as_vec(row[:3]) for row in uv)
        return Coordinates(u, v, along_u, along_v)
    u, v = (row[0] * own.u + row[1] * own.v + row[2] for row in uv)
    along_u, along_v = (row[0] * own.along_u + row[1] * own.along_v for row in uv)
    return Coordinates(u, v, along_u, along_v)


def _neighbouring_texels(
    place: Scalar, count: int, wrap: str
) -> tuple[tuple[Int[Array, ""], Int[Array, ""]], Scalar]:
    """Return the two texels next to a position along one axis, and the interpolation weight of the
    second. The position is the distance from the map's border, in units of the map's width."""
    x = (place - jnp.floor(place) if wrap == "repeat" else place) * count - 0.5
    x = jnp.clip(x, -0.5, count - 0.5)  # beyond the map, "clamp" extends the border
    first = jnp.floor(x)
    k = first.astype(jnp.int32)
    if wrap == "repeat":
        return (k % count, (k + 1) % count), x - first
    return (jnp.clip(k, 0, count - 1), jnp.clip(k + 1, 0, count - 1)), x - first


def _pieces(
    place: Scalar, width: Scalar, count: int, wrap: str
) -> tuple[Int[Array, "6"], Float[Array, "5"]]:
    """Return the six texel borders that divide a box along one axis into five pieces, and the
    weight of the texels of each piece in the mean over the box. The middle `place` and the `width`
    of the box are in units of the map's width."""
    if wrap == "repeat":
        place, half = place - jnp.floor(place), jnp.clip(width * count, _NARROWEST, _WIDEST) / 2
        start, length = place * count - 0.5 - half, 2 * half
    else:  # the box ends at the map's border; texel 0 is a copy of the border texel outside
        low = jnp.clip(place * count - 0.5 - width * count / 2, -0.5, count - 0.5 - _NARROWEST)
        high = jnp.clip(place * count - 0.5 + width * count / 2, -0.5, count - 0.5)
        start, length = low + 1, jnp.maximum(high - low, _NARROWEST)
    first = jnp.floor(start)
    begin = start - first
    end = begin + length
    last = jnp.floor(end)

    def share(i: Scalar | float) -> Scalar:
        """Return the integral over the box of the linear hat function of texel i, an index relative
        to the first texel."""
        a, b = jnp.clip(begin, i - 1, i), jnp.clip(end, i - 1, i)
        c, d = jnp.clip(begin, i, i + 1), jnp.clip(end, i, i + 1)
        return (b - a) * ((a + b) / 2 - i + 1) + (d - c) * (i + 1 - (c + d) / 2)

    ends = (share(0.0), share(1.0), jnp.ones_like(end), share(last), share(last + 1))
    borders = jnp.stack([0 * last, 0 * last + 1, 0 * last + 2, last, last + 1, last + 2])
    borders = jnp.where(jnp.arange(6) < 3, borders, jnp.maximum(borders, 2))
    return (first + borders).astype(jnp.int32), jnp.stack(ends) / length


def _sums(table: Array, rows: Int[Array, "6"], columns: Int[Array, "6"]) -> Array:
    """Return the sum of the texels in each of the 5 x 5 pieces of a box, (5, 5, ...), from a
    summed-area table."""
    height, width = (size - 1 for size in table.shape[:2])
    i, j = jnp.append(rows % height, height), jnp.append(columns % width, width)
    part = table.at[i[:, None], j].get(mode="promise_in_bounds")
    for axis, borders in enumerate((rows, columns)):
        part = jnp.moveaxis(part, axis, 0)
        turns = jnp.diff(borders // (height, width)[axis]).astype(part.dtype)
        # the sum over whole repetitions of the map inside a piece
        whole = turns.reshape(-1, *(1,) * (part.ndim - 1)) * part[6][None]
        part = jnp.moveaxis(jnp.diff(part[:6], axis=0) + whole, 0, axis)
    return part


def summed(own: Map) -> Summed:
    """Compute the summed-area table of a map, in the unit of its values."""
    values = own.values
    mean = jax.lax.stop_gradient(values.mean(axis=(0, 1), keepdims=True))
    rest = values - mean
    if own.wrap == "clamp":
        rest = jnp.pad(rest, ((1, 1), (1, 1), *((0, 0),) * len(own.shape)), mode="edge")
    high, low = jax.lax.stop_gradient(rest), jnp.zeros_like(rest)
    for axis in (0, 1):
        high, low = jax.lax.associative_scan(_sum_of_pairs, (high, low), axis=axis)
    high = replace_gradient(high, jnp.cumsum(jnp.cumsum(rest, axis=0), axis=1))
    first = ((1, 0), (1, 0), *((0, 0),) * len(own.shape))
    high, low = jnp.pad(high, first), jnp.pad(low, first)
    return Summed(values, own.uv, mean[0, 0], high, low, own.wrap)


def _sum_of_pairs(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
    """Add two numbers, each given as a pair (value, rounding error).


    Source: Dekker, Numerische Mathematik 18 (1971)."""
    high = a[0] + b[0]
    part = high - a[0]
    low = (a[0] - (high - part)) + (b[0] - part) + a[1] + b[1]
    whole = high + low
    return whole, low - (whole - high)


# ---------------------------------------------------------------- where a ray meets a map


def varied_surfaces(scene: Scene) -> Varied | None:
    """Return the surfaces of a scene that have maps, with lengths in m, or None if no surface has a
    map."""
    found = [i for i, own in enumerate(scene.surfaces) if any(True for _ in maps_of(own))]
    if not found:
        return None
    own = [scene.surfaces[i] for i in found]
    return Varied(tuple(s.shape for s in own), tuple(s.normals for s in own), tuple(found))


def patch_of(
    varied: Varied,
    surface: Int[Array, ""],
    primitive: Int[Array, ""] | None,
    hit: Hit,
    *,
    seen: PixelRay | None = None,
) -> Patch:
    """Return the patch at a hit on one of the surfaces with maps. If `seen` is given, the patch has
    the size of the pixel's footprint."""
    steps = None
    if seen is not None:
        steps = _step(seen.ray, seen.by_row, hit), _step(seen.ray, seen.by_column, hit)
    shading = hit.normal if hit.shading_normal is None else hit.shading_normal
    point, tilted, own = hit.point, shading, None
    for number, shape, normals in zip(varied.numbers, varied.shapes, varied.normals, strict=True):
        here = coordinates(shape, point, primitive)
        own = (
            here
            if own is None
            else jax.tree.map(
                lambda new, old, n=number: jnp.where(surface == n, new, old), here, own
            )
        )
        if normals is not None:
            x, y, z = _value(normals, Patch(point, here, None, steps))
            along = _coordinates(normals.uv, Patch(point, here, None, None))
            # the direction along the surface in which u grows and v is constant
            way = cross(along.along_v, hit.normal)
            way = way * jnp.where(dot(way, along.along_u) < 0, -1, 1)
            right = as_vec(normalize(way - dot(way, shading) * shading))
            up = cross(shading, right)
            if isinstance(shape, TriangleMesh):  # texture coordinates of meshes may be mirrored
                up = up * jnp.where(dot(up, along.along_v) > 0, -1, 1)
            found = as_vec(normalize(x * right + y * up + z * shading))
            tilted = where(surface == number, found, tilted)
    assert own is not None
    if all(normals is None for normals in varied.normals):
        return Patch(point, own, None, steps)
    return Patch(point, own, tilted, steps)


def _step(ray: Ray, change: Ray, hit: Hit) -> Vec:
    """Return the vector, m, from the point where a pixel's ray hits the surface to the point where
    the next pixel's ray hits it."""
    distance = jnp.where(hit.distance < jnp.inf, hit.distance, 0)
    aside = change.origin + distance * change.direction
    slope = dot(hit.normal, ray.direction)
    return aside - divide(dot(hit.normal, aside), slope, where=slope != 0) * ray.direction


def shading_normal(tilted: Vec, flat: Vec, viewer: Vec) -> Vec:
    """Return the normal `tilted` of a normal map, bent toward the shape's normal `flat` so that the
    mirror direction of the viewer is above the surface. Both normals are unit vectors on the
    viewer's side. Without this bending, a matte surface would be black where the viewer is below
    the plane perpendicular to `tilted`.

    In the plane of both normals, let b be the viewer's angle to `flat`, and a >= 0 the angle of the
    shading normal to `flat`. The mirror direction has the angle 2 a - b, which is at most pi / 2
    for a <= pi / 4 + b / 2.
    """
    height = dot(tilted, flat)
    aside = tilted - height * flat
    across = as_vec(normalize(aside))
    tilt = arctan2(dot(aside, across), height)
    beside = dot(viewer, across)
    angle = jnp.where(beside < 0, -1, 1) * arctan2(jnp.abs(beside), dot(viewer, flat))
    most = jnp.pi / 4 + angle / 2
    bent = jnp.sin(most) * across + jnp.cos(most) * flat
    return where((tilt > most) & (dot(viewer, flat) > 0), bent, tilted)
