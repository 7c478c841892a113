"""Calls for rays, surfaces and shading."""

import jax.numpy as jnp
import numpy as np

from jaxvision import PointLight, Vec
from jaxvision import scene as s
from jaxvision.geometry import Encounter, Ray
from jaxvision.geometry.flat import flat_quad
from jaxvision.rendering.shadows import Leaving


def unit(*v):
    v = np.asarray(v, float)
    return jnp.asarray(v / np.linalg.norm(v))


N, W = unit(0.1, -0.2, 1), unit(0.5, 0.3, 0.9)
POINT, FAR = jnp.asarray([0.2, 0.1, -0.3]), jnp.asarray(2.3)
RAY = Ray(jnp.zeros(3), unit(0.05, 0.02, 1))
SPHERE, PLANE = s.Sphere([0.1, 0.2, 3], 1.0), s.Plane([0, 0, 5], [0.1, 0.1, -1])
DISC = s.Disc([0.1, 0.2, 4], [0.1, 0.2, -1], 0.7)
QUAD = s.Quad([-1.0, -1.1, 4], [2.1, 0.2, 0.1], [0.1, 2.2, 0.3])
BOX = s.Box([0.1, 0.2, 4], [0.6, 0.7, 0.8])
MESH = s.TriangleMesh(
    [[-1.0, -1.1, 4], [1.1, -1.2, 4.1], [0.1, 1.3, 4.2]],
    [[0, 2, 1]],
    normals=[[0.1, 0.2, -1], [-0.2, 0.1, -1], [0.1, -0.1, -1]],
    uv=[[0.1, 0.2], [0.9, 0.1], [0.4, 0.8]],
)
SHAPES = [PLANE, SPHERE, MESH]
LAMPS = [PointLight([1, 2, -3], [0.3, 0.2]), PointLight([-1, 2, -2], [0.1, 0.4])]


EXAMPLES = {
    "core._numerics.angle_between": ((N, W), {}),
    "core._numerics.log_cos_between": ((N, W), {}),
    "core._numerics.dot": ((N, POINT), {}),
    "core._numerics.norm": ((POINT,), {}),
    "core._numerics.normalize": ((POINT,), {}),
    "core._numerics.safe_sqrt": ((FAR,), {}),
    "core._types.as_dtype": ((SPHERE,), {"dtype": np.float64}),
    "core._types.as_float": ((FAR,), {}),
    "core._types.as_optional_float": ((FAR,), {}),
    "core._vector.as_array": ((Vec(FAR, -FAR, 2 * FAR),), {}),
    "core._vector.as_vec": ((POINT,), {}),
    "geometry._mesh.intersect_mesh": ((RAY, MESH), {}),
    "geometry._places.point_on": ((BOX, jnp.asarray([0.3, 0.6])), {}),
    "geometry._places.surface_area": ((MESH,), {}),
    "geometry._size.largest_size": (([SPHERE, BOX],), {}),
    "geometry._size.offset_length": ((FAR,), {}),
    "geometry.rays.mirror_direction": ((N, W), {}),
    "geometry.rays.offset_origin": ((POINT, N, W), {}),
    "geometry.sphere.sphere_distance": ((RAY, SPHERE), {}),
    "geometry.sphere.sphere_blocks": ((RAY, SPHERE, FAR), {}),
    "geometry.sphere.intersect_sphere": ((RAY, SPHERE), {}),
    "geometry.flat.intersect_plane": ((RAY, PLANE), {}),
    "geometry.flat.intersect_disc": ((RAY, DISC), {}),
    "geometry.flat.intersect_quad": ((RAY, QUAD), {}),
    "geometry.flat.flat_quad": ((QUAD,), {}),
    "geometry.flat.line_crossing": ((RAY, flat_quad(QUAD)), {}),
    "geometry.flat.quad_distance": ((RAY, flat_quad(QUAD)), {}),
    "geometry.flat.quad_blocks": ((RAY, flat_quad(QUAD), FAR), {}),
    "geometry.nearest.sorted_shapes": ((SHAPES,), {}),
    "geometry.box.intersect_box": ((RAY, BOX), {}),
    "geometry.box.box_distance": ((RAY, BOX), {}),
    "geometry.nearest.intersect": ((RAY, MESH), {}),
    "geometry.nearest.nearest_shape": ((RAY, SHAPES), {}),
    "geometry.nearest.hit_shape": (
        (RAY, SHAPES, Encounter(jnp.asarray(1), jnp.asarray(-1))),
        {},
    ),
    "rendering.shadows.visibility": ((LAMPS, POINT, SHAPES, Leaving(N)), {}),
    "geometry.nearest.occluded": ((POINT, N, W, FAR, SHAPES), {}),
}
