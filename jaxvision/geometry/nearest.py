"""Find the first of many surfaces that a ray intersects, and test for occlusion. Functions take one
ray; use `jax.vmap` for many.

The search returns integers and has no gradient. The hit is then recomputed from the shape that was
found, with gradients with respect to ray and shape. Only intersections at a distance > 0 are hits.
A miss has distance inf, a zero normal, and gradients of zero. Lengths are metres.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..core._arguments import takes_numbers
from ..core._loops.fusion import fuse, inline, materialise
from ..core._loops.groups import group_by_structure, take
from ..core._numerics import dot, or_one
from ..core._shown import Shown
from ..core._types import Scalar, check_kind
from ..core._vector import Direction, Vec, Vector, as_vec, where
from ..core.parallel_loops import fori_loop
from ..scene import Box, Disc, Plane, Quad, Shape, Sphere, TriangleMesh
from ._mesh import intersect_mesh, mesh_blocks, mesh_nearest
from ._size import largest_component, offset_length, size_of
from ._triangle import triangle_hit
from ._unknown import unknown_hit
from .box import box_distance, box_hit, intersect_box
from .checks import warn_of_shapes
from .flat import (
    FlatQuad,
    disc_hit,
    flat_quad,
    intersect_disc,
    intersect_plane,
    intersect_quad,
    plane_hit,
    quad_blocks,
    quad_distance,
    quad_hit,
)
from .rays import Encounter, Hit, Ray, offset_origin
from .sphere import intersect_sphere, sphere_blocks, sphere_distance

Carry = TypeVar("Carry")
_CHUNK = 8  # number of shapes tested at once, because a single shape does not fill the vector units


class Sorted(Shown):
    """Shapes sorted by type, with everything precomputed that does not depend on the ray.

    Attributes:
        groups: all shapes except meshes, stacked by type.
        meshes: the meshes.
        size: () m, the largest coordinate of all shapes, NaN if a number of a simple shape is
            NaN; None without shapes.
        members: the indices of the shapes in each group; static.
        mesh_numbers: the indices of the meshes; static.
    """

    groups: tuple[Any, ...]
    meshes: tuple[TriangleMesh, ...]
    size: Scalar | None
    members: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    mesh_numbers: tuple[int, ...] = eqx.field(static=True)


Shapes = Sequence[Shape] | Sorted


def sorted_shapes(shapes: Shapes) -> Sorted:
    """Prepare shapes for many rays; call it once, outside a loop over rays.

    Args:
        shapes: any shapes, lengths in m, or a result of this function.

    Returns:
        The shapes, sorted by type.
    """
    if isinstance(shapes, Sorted):
        return shapes
    simple = [i for i, shape in enumerate(shapes) if not isinstance(shape, TriangleMesh)]
    meshes = {i: shape for i, shape in enumerate(shapes) if isinstance(shape, TriangleMesh)}
    groups = group_by_structure([shapes[i] for i in simple])
    sizes = [jax.vmap(size_of)(group).max() for _, group in groups]
    for number in jax.tree.leaves([group for _, group in groups]):
        sizes.append(jnp.where(jnp.isnan(number).any(), jnp.nan, 0))
    sizes += [size_of(mesh) for mesh in meshes.values()]
    return Sorted(
        tuple(fuse(jax.vmap(flat_quad)(g)) if isinstance(g, Quad) else g for _, g in groups),
        tuple(meshes.values()),
        reduce(jnp.maximum, sizes) if sizes else None,
        tuple(tuple(simple[place] for place in places) for places, _ in groups),
        tuple(meshes),
    )


def intersect(ray: Ray, shape: Shape) -> Hit:
    """Return the first hit of a shape by a ray.

    Args:
        ray: its origin in m.
        shape: any shape, m.

    Returns:
        The nearest hit in front of the origin; a miss has distance inf. All numbers are NaN if
        the ray has one that is NaN or infinite, or if the shape, except a mesh, has one that is
        NaN.

    Raises:
        ValueError: if the arguments are not a ray and a shape.

    This function warns of a shape so far from the origin that rounding in its dtype deforms it.

    Example:
        >>> ray, ball = jv.Ray([0.6, 0, 5], [0, 0, -1]), jv.Sphere([0, 0, 0], 1)
        >>> hit = jv.intersect(ray, ball)
        >>> round(float(hit.distance), 4), round(float(hit.normal.z), 4)  # 5 - 0.8
        (4.2, 0.8)
    """
    check_kind("intersect: ray", ray, Ray)
    check_kind("intersect: shape", shape, Shape)
    warn_of_shapes(shape)
    match shape:
        case Sphere():
            return intersect_sphere(ray, shape)
        case Plane():
            return intersect_plane(ray, shape)
        case Disc():
            return intersect_disc(ray, shape)
        case Quad():
            return intersect_quad(ray, shape)
        case Box():
            return intersect_box(ray, shape)
        case TriangleMesh():
            return intersect_mesh(ray, shape)


def nearest_shape(ray: Ray, shapes: Shapes) -> Encounter:
    """Find the shape that a ray intersects first. Among equally near shapes of one type, the shape
    with the smallest index is returned.

    Args:
        ray: its origin in m.
        shapes: any shapes, m.

    Returns:
        The indices of the shape and of its triangle. Distances are compared without their last
        three bits. There is no gradient.

    Example:
        >>> floors = [jv.Disc([0, 0, z], [0, 0, 1], 1) for z in (0, 1)]
        >>> rays = (jv.Ray([x, 0, 5], [0, 0, -1]) for x in (0, 3))
        >>> [int(jv.nearest_shape(ray, floors).shape) for ray in rays]  # the upper one, and none
        [1, -1]
    """
    return materialise(_nearest, *jax.lax.stop_gradient((ray, sorted_shapes(shapes))))


def _nearest(ray: Ray, ready: Sorted) -> Encounter:
    nothing = jnp.full((), -1, jnp.int32)
    nearest, found = jnp.full_like(ray.origin.x, jnp.inf), nothing
    for members, group in zip(ready.members, ready.groups, strict=True):
        first_of = _materialise_chunks(_first_of, len(members))

        def closer(
            carry: tuple[Scalar, Int[Array, ""]],
            start: Int[Array, ""],
            chunk: Any,
            first_of: Callable[..., Any] = first_of,
        ) -> tuple[Scalar, Int[Array, ""]]:
            nearest, found = carry
            distance, place = _unpack(first_of(ray, chunk))
            before = distance < nearest
            return jnp.where(before, distance, nearest), jnp.where(before, start + place, found)

        before = nearest
        nearest, place = _search_chunks(closer, (nearest, nothing), group, len(members))
        number = jnp.asarray(members, jnp.int32).at[place].get(mode="clip")
        if members == tuple(range(members[0], members[0] + len(members))):
            number = members[0] + place
        found = jnp.where(nearest < before, number, found)
    if not ready.meshes:
        return Encounter(found)
    primitive = nothing
    for index, mesh in zip(ready.mesh_numbers, ready.meshes, strict=True):
        distance, triangle = mesh_nearest(ray, mesh)
        before = distance < nearest
        nearest = jnp.where(before, distance, nearest)
        found = jnp.where(before, index, found)
        primitive = jnp.where(before, triangle, primitive)
    return Encounter(found, primitive)


def hit_shape(ray: Ray, shapes: Shapes, encounter: Encounter) -> Hit:
    """Return the hit of the shape that `nearest_shape` found, with gradients to this shape only.

    Args:
        ray: its origin in m.
        shapes: the same shapes, m.
        encounter: as `nearest_shape` returns it.

    Returns:
        The hit; a miss if nothing was found. NaN for a ray that is not finite, and if a shape,
        except a mesh, has a number that is NaN.

    Example:
        >>> floors = [jv.Disc([0, 0, z], [0, 0, 1], 1) for z in (0, 1)]
        >>> ray = jv.Ray([0, 0, 5], [0, 0, -1])
        >>> float(jv.hit_shape(ray, floors, jv.nearest_shape(ray, floors)).distance)
        4.0
    """
    ready, zero = sorted_shapes(shapes), jnp.zeros_like(ray.origin.x)
    nowhere = Vec(zero, zero, zero)
    chosen = Hit(
        zero + jnp.inf,
        nowhere,
        ray.origin,
        zero,
        nowhere if any(mesh.normals is not None for mesh in ready.meshes) else None,
        (zero, zero) if any(mesh.uv is not None for mesh in ready.meshes) else None,
    )
    for members, group in zip(ready.members, ready.groups, strict=True):
        shape, among = take(members, group, encounter.shape)
        hit = _hit_of(ray, shape, among)
        chosen = _choose(among, hit, chosen)
    for index, mesh in zip(ready.mesh_numbers, ready.meshes, strict=True):
        among = encounter.shape == index
        triangle = -1 if encounter.primitive is None else encounter.primitive
        hit = triangle_hit(ray, mesh, jnp.where(among, triangle, -1))
        chosen = _choose(among, hit, chosen)
    return unknown_hit(chosen, ray, *(() if ready.size is None else (ready.size,)))


def _hit_of(ray: Ray, shape: Shape | FlatQuad, among: Bool[Array, ""]) -> Hit:
    """Return the hit of one shape, without materialising values, for use inside a caller's loop.
    `among` tells whether the ray is known to hit this shape.
    """
    match shape:
        case FlatQuad():
            return quad_hit(ray, shape, among, inline)
        case Plane():
            return plane_hit(ray, shape, inline)
        case Disc():
            return disc_hit(ray, shape, inline)
        case Box():
            return box_hit(ray, shape, inline)
        case _:
            return intersect(ray, shape)


def _choose(here: Bool[Array, ""], hit: Hit, other: Hit) -> Hit:
    """Return `hit` if `here` is true, else `other`; fields that `hit` lacks are filled in."""
    shading_normal = None if other.shading_normal is None else hit.shading_normal or hit.normal
    zero = jnp.zeros_like(hit.distance)
    uv = None if other.uv is None else hit.uv or (zero, zero)
    filled = Hit(hit.distance, hit.normal, hit.point, hit.size, shading_normal, uv)
    return jax.tree.map(lambda new, old: jnp.where(here, new, old), filled, other)


@takes_numbers
def occluded(
    point: Vector,
    normal: Direction,
    direction: Direction,
    distance: Scalar,
    shapes: Shapes,
    *,
    size: Scalar | None = None,
) -> Bool[Array, ""]:
    """Return whether any shape lies between a point of a surface and its target.

    Args:
        point: (3,) m.
        normal: (3,) unit normal of the surface at the point; 0 for a point in free space.
        direction: (3,) unit, toward the target.
        distance: () m to the target, inf for a target at infinity. The tested segment is shortened
            at both ends by the largest rounding error, see `offset_origin`.
        shapes: any shapes, m.
        size: () m, as `Hit.size`; None for the largest coordinate of all shapes.

    Returns:
        A flag, (). No gradient.

    Example:
        >>> point, up = jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])
        >>> roof = jv.Disc([0, 0, 2], [0, 0, 1], 1)
        >>> [bool(jv.occluded(point, up, up, jnp.array(far), [roof])) for far in (1.0, 3.0)]
        [False, True]
    """
    return materialise(blocked, point, normal, direction, distance, sorted_shapes(shapes), size)


def blocked(
    point: Vector,
    normal: Direction,
    direction: Direction,
    distance: Scalar,
    shapes: Shapes,
    size: Scalar | None,
) -> Bool[Array, ""]:
    """Return the result of `occluded`, for use inside a caller's loop.

    Args:
        point: (3,) m.
        normal: (3,) unit, or 0 for a point in free space.
        direction: (3,) unit, toward the target.
        distance: () m to the target.
        shapes: any shapes, m.
        size: () m, as `Hit.size`, or None.

    Returns:
        A flag, ().
    """
    point, normal, direction, distance, ready, size = jax.lax.stop_gradient(
        (as_vec(point), normal, as_vec(direction), distance, sorted_shapes(shapes), size)
    )
    size, reach = ready.size if size is None else size, largest_component(point)
    reach = reach if size is None else jnp.maximum(reach, size)
    start = offset_origin(point, normal, direction, size=reach)
    # The moved start needs a new direction; otherwise a light seen at a slant would block itself.
    finite = distance < jnp.inf
    end = point + jnp.where(finite, distance, 0) * direction
    reach = jnp.maximum(reach, largest_component(end))
    way = end - start
    square = dot(way, way)
    apart = finite & (square > 0)
    inverse = jnp.where(apart, jax.lax.rsqrt(or_one(square, apart)), 0)
    toward = where(apart, way * inverse, direction)
    length = jnp.where(finite, square * inverse - offset_length(reach), jnp.inf)
    ray = Ray(start, toward)

    anything = jnp.zeros((), bool)
    for members, group in zip(ready.members, ready.groups, strict=True):
        any_of = _materialise_chunks(_any_of, len(members))

        def blocks(
            before: Bool[Array, ""],
            start: Int[Array, ""],
            chunk: Any,
            any_of: Callable[..., Any] = any_of,
        ) -> Bool[Array, ""]:
            del start
            return before | any_of(ray, chunk, length)

        anything = _search_chunks(blocks, anything, group, len(members))
    return reduce(
        lambda before, mesh: before | mesh_blocks(ray, mesh, length), ready.meshes, anything
    )


def meets(ray: Ray, shapes: Sorted, number: Int[Array, ""]) -> Bool[Array, ""]:
    """Return whether a ray hits the shape with this index, even if other shapes are nearer; always
    False for a mesh. No gradient.
    """
    ray, shapes = jax.lax.stop_gradient((ray, shapes))
    met = jnp.zeros((), bool)
    for members, group in zip(shapes.members, shapes.groups, strict=True):
        shape, among = take(members, group, number)
        met = met | (among & (_distance(ray, shape) < jnp.inf))
    return met


# ---------------------------------------------------------------- one shape of a kind


@jax.jit  # traced once for all shapes of a kind
def _distance(ray: Ray, shape: Shape | FlatQuad) -> Scalar:
    match shape:
        case Sphere():
            return sphere_distance(ray, shape)
        case FlatQuad():
            return quad_distance(ray, shape)
        case Box():
            return box_distance(ray, shape)
        case _:
            return _hit_of(ray, shape, jnp.asarray(True)).distance


@jax.jit
def _blocks(ray: Ray, shape: Shape | FlatQuad, distance: Scalar) -> Bool[Array, ""]:
    match shape:
        case Sphere():
            return sphere_blocks(ray, shape, distance)
        case FlatQuad():
            return quad_blocks(ray, shape, distance)
        case _:
            return _distance(ray, shape) < distance


# ---------------------------------------------------------------- many shapes of a kind


def _materialise_chunks(of_chunk: Callable[..., Any], count: int) -> Callable[..., Any]:
    """Wrap a function of a chunk of shapes so that its result is materialised if there are several
    chunks. Otherwise the chunk would be read again for each ray.
    """
    return partial(materialise, of_chunk) if count > 2 * _CHUNK else of_chunk


def _search_chunks(
    step: Callable[[Carry, Int[Array, ""], Any], Carry], carry: Carry, group: Any, count: int
) -> Carry:
    """Compute `carry = step(carry, start, group[start : start + size])` for each chunk of a stacked
    group of shapes. The last chunk may repeat some shapes.
    """
    if count <= 2 * _CHUNK:
        for start in range(0, count, _CHUNK):
            chunk = jax.tree.map(lambda x, start=start: x[start : start + _CHUNK], group)
            carry = step(carry, jnp.asarray(start, jnp.int32), chunk)
        return carry

    def turn(number: Int[Array, ""], carry: Carry) -> Carry:
        start = jnp.minimum(number * _CHUNK, count - _CHUNK).astype(jnp.int32)
        chunk = jax.tree.map(
            lambda x: jax.lax.dynamic_slice_in_dim(x, start, _CHUNK, axis=0), group
        )
        return step(carry, start, chunk)

    return fori_loop(0, -(-count // _CHUNK), turn, carry)


def _unstack(chunk: Any) -> list[Any]:
    leaves, tree = jax.tree.flatten(chunk)
    return [tree.unflatten(one) for one in zip(*map(list, leaves), strict=True)]


def _first_of(ray: Ray, chunk: Any) -> Int[Array, ""]:
    """Return the nearest shape of a chunk as one integer: the bits of its distance, with the last
    three replaced by the shape's position. These integers have the order of the distances.
    """
    keys = []
    for place, shape in enumerate(_unstack(chunk)):
        distance = _distance(ray, shape)
        bits = jnp.int64 if distance.dtype.itemsize == 8 else jnp.int32
        keys.append((jax.lax.bitcast_convert_type(distance, bits) & -_CHUNK) | place)
    return reduce(jnp.minimum, keys)


def _unpack(key: Int[Array, ""]) -> tuple[Scalar, Int[Array, ""]]:
    """Return the distance of the nearest shape, m, and its position in the chunk, from the integer
    that `_first_of` returns."""
    floats = jnp.float64 if key.dtype.itemsize == 8 else jnp.float32
    place = (key & (_CHUNK - 1)).astype(jnp.int32)
    return jax.lax.bitcast_convert_type(key & -_CHUNK, floats), place


def _any_of(ray: Ray, chunk: Any, distance: Scalar) -> Bool[Array, ""]:
    return reduce(jnp.logical_or, (_blocks(ray, shape, distance) for shape in _unstack(chunk)))
