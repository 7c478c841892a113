"""Intersection of a ray with triangles, without gaps along shared edges. Functions take one ray;
lengths are in m.

The method is that of Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1)
(2013). In a frame where the ray is the z axis, the vertices a, b, c give three edge functions:

    U = c x b    V = a x c    W = b x a    t = (U a_z + V b_z + W c_z) / (U + V + W).

t is the distance along the ray. Two triangles compute the function of a shared edge from the same
two vertices, so their values differ only in sign and rounding. Compiled code may round them
differently. An edge function within this rounding error of zero therefore counts as inside for both
triangles.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..core._loops.fusion import materialise
from ..core._numerics import divide, dot, normalize, or_one, smallest_divisor
from ..core._types import Scalar
from ..core._vector import Vec, as_vec, masked, where
from ..core.parallel_loops import fori_loop
from ..scene import TriangleMesh
from ._size import largest_component
from .hemisphere import Frame, cross, local_frame
from .rays import Hit, Ray

# Triangles per step of the loop, because a single triangle does not fill the vector units
_CHUNK = 8


def corners(mesh: TriangleMesh) -> Float[Array, "faces 3 3"]:
    """Return the vertices of each triangle, m."""
    return mesh.vertices.at[mesh.faces].get(mode="clip")


def _edge(p: Vec, q: Vec) -> tuple[Scalar, Scalar]:
    """Return p x q in the plane perpendicular to the ray, and a bound on its rounding error."""
    one, other = p.x * q.y, p.y * q.x
    of_products = jnp.abs(one) + jnp.abs(other)
    of_vertices = _perpendicular_size(p) * _reach(q) + _perpendicular_size(q) * _reach(p)
    return one - other, 2 * jnp.finfo(one.dtype).eps * (of_products + of_vertices)


def _perpendicular_size(v: Vec) -> Scalar:
    return jnp.abs(v.x) + jnp.abs(v.y)


def _reach(v: Vec) -> Scalar:
    """Return an upper bound on the length of a vector in the frame of the ray. The rounding error
    of each component is proportional to that bound.
    """
    return _perpendicular_size(v) + jnp.abs(v.z)


def triangle_distance(ray: Ray, frame: Frame, a: Vec, b: Vec, c: Vec) -> Scalar:
    """Return the distance to one triangle, m, inf for a miss. `frame`: a local frame whose normal
    is the ray's direction. `a`, `b`, `c`: the vertices, m.
    """
    a, b, c = (_view(ray, frame, v) for v in (a, b, c))
    (u, du), (v, dv), (w, dw) = _edge(c, b), _edge(a, c), _edge(b, a)
    front = (u >= -du) & (v >= -dv) & (w >= -dw)
    back = (u <= du) & (v <= dv) & (w <= dw)
    area = u + v + w
    # the area is 0 within rounding (edge-on or degenerate); the distance becomes 0, which is a miss
    flat = jnp.abs(area) <= jnp.maximum(jnp.maximum(du, dv), dw)
    inverse = 1 / jnp.where(flat, jnp.inf, area)
    # weights are computed first, because area times length overflows or underflows in float32 above
    # 1e12 and below 1e-12 m
    distance = (u * inverse) * a.z + (v * inverse) * b.z + (w * inverse) * c.z
    return jnp.where((front | back) & ~flat & (distance > 0), distance, jnp.inf)


def _view(ray: Ray, frame: Frame, v: Vec) -> Vec:
    toward = v - ray.origin
    return Vec(dot(toward, frame.tangent), dot(toward, frame.bitangent), dot(toward, frame.normal))


def nearest_triangle(ray: Ray, mesh: TriangleMesh) -> tuple[Scalar, Int[Array, ""]]:
    """Return (distance in m, index) of the first triangle along the ray, (inf, -1) for a miss. The
    function tests all triangles, a chunk at a time.
    """
    frame, triangles = local_frame(ray.direction), corners(mesh)
    count = len(triangles)

    def try_one(
        carry: tuple[Scalar, Int[Array, ""]], number: Int[Array, ""], triangle: Array
    ) -> tuple[Scalar, Int[Array, ""]]:
        nearest, index = carry
        distance = triangle_distance(ray, frame, *(as_vec(v) for v in triangle))
        closer = distance < nearest
        return jnp.where(closer, distance, nearest), jnp.where(closer, number, index)

    nothing = jnp.full_like(ray.origin.x, jnp.inf), jnp.full((), -1, jnp.int32)
    return scan_chunks(try_one, nothing, triangles, count)


def any_triangle(ray: Ray, mesh: TriangleMesh, distance: Scalar) -> Bool[Array, ""]:
    """Return whether the ray hits a triangle before `distance`, m."""
    frame, triangles = local_frame(ray.direction), corners(mesh)

    def try_one(
        blocked: Bool[Array, ""], number: Int[Array, ""], triangle: Array
    ) -> Bool[Array, ""]:
        del number
        return blocked | (triangle_distance(ray, frame, *(as_vec(v) for v in triangle)) < distance)

    return scan_chunks(try_one, jnp.asarray(False), triangles, len(triangles))


def scan_chunks(step, carry, items, count: int):
    """Compute `carry = step(carry, i, items[i])` for each item, unrolled a chunk at a time.
    `items`: a tree with a leading axis of `count`. Some items may be passed to `step` twice."""
    if count <= 2 * _CHUNK:
        for i in range(count):
            carry = step(carry, jnp.asarray(i, jnp.int32), jax.tree.map(lambda x, i=i: x[i], items))
        return carry

    def chunk(turn: Int[Array, ""], carry):
        for i in range(_CHUNK):
            number = jnp.minimum(turn * _CHUNK + i, count - 1).astype(jnp.int32)
            carry = step(carry, number, jax.tree.map(lambda x, at=number: x[at], items))
        return carry

    return fori_loop(0, -(-count // _CHUNK), chunk, carry)


def triangle_hit(ray: Ray, mesh: TriangleMesh, primitive: Int[Array, ""]) -> Hit:
    """Return the hit of a triangle that the ray is known to hit, computed from the triangle's
    plane; a miss if the index is -1. The hit is differentiable with respect to the ray and the
    vertices."""
    face = mesh.faces.at[primitive].get(mode="clip")
    a, b, c = (as_vec(v) for v in mesh.vertices.at[face].get(mode="clip"))
    distance, v, w = materialise(_place, ray, primitive >= 0, a, b, c)
    hit, u = distance < jnp.inf, 1 - v - w
    normal = as_vec(masked(hit, normalize(cross(b - a, c - a))))
    point = where(hit, a + v * (b - a) + w * (c - a), ray.origin)
    size = jnp.maximum(
        jnp.maximum(largest_component(a), largest_component(b)), largest_component(c)
    )
    shading_normal, uv = None, None
    if mesh.normals is not None:
        at_a, at_b, at_c = (as_vec(n) for n in mesh.normals.at[face].get(mode="clip"))
        smooth = as_vec(normalize(u * at_a + v * at_b + w * at_c))
        shading_normal = where(hit & (dot(smooth, smooth) > 0.5), smooth, normal)
    if mesh.uv is not None:
        at_a, at_b, at_c = mesh.uv.at[face].get(mode="clip")
        first, second = (u * at_a[i] + v * at_b[i] + w * at_c[i] for i in range(2))
        uv = jnp.where(hit, first, 0), jnp.where(hit, second, 0)
    return Hit(distance, normal, point, size, shading_normal, uv)


def _place(
    ray: Ray, known: Bool[Array, ""], a: Vec, b: Vec, c: Vec
) -> tuple[Scalar, Scalar, Scalar]:
    """Return the distance, m, and the barycentric weights of b and c. The weights are inner
    products with the reciprocal edges, clipped if rounding puts the point outside the triangle.
    """
    edge_b, edge_c = b - a, c - a
    area = cross(edge_b, edge_c)
    normal = as_vec(normalize(area))
    slope, length = dot(normal, ray.direction), dot(area, normal)
    crosses = known & (jnp.abs(slope) > smallest_divisor(slope.dtype)) & (length > 0)
    distance = dot(normal, a - ray.origin) / or_one(slope, crosses)
    hit = crosses & (distance > 0)
    place = ray.origin + jnp.where(hit, distance, 0) * ray.direction - a
    inverse = divide(1, length, where=hit)
    v = jnp.clip(dot(place, cross(edge_c, normal)) * inverse, 0, 1)
    w = jnp.clip(dot(place, cross(normal, edge_b)) * inverse, 0, 1)
    excess = jnp.maximum(v + w - 1, 0) / 2
    return jnp.where(hit, distance, jnp.inf), v - excess, w - excess
