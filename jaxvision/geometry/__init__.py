"""Rays and the surfaces they meet. For ONE ray; the caller vmaps.

Lengths are metres, directions unit vectors. A ray meets what lies at a distance > 0; a miss has
distance inf, a zero normal, and gradients of zero. Each shape has a file; `nearest` finds the
first of many and what lies in between.
"""

from .._numerics import angle_between, log_cos_between
from ._bounds import Ball, ball_around
from ._mesh import intersect_mesh
from ._places import SurfacePoint, has_area, point_on, surface_area
from ._size import largest_size, offset_length, reach_of
from .box import intersect_box
from .checks import problems
from .flat import intersect_disc, intersect_plane, intersect_quad
from .nearest import (
    Shapes,
    Sorted,
    blocked,
    hit_shape,
    intersect,
    nearest_shape,
    occluded,
    sorted_shapes,
)
from .rays import Encounter, Hit, Ray, mirror_direction, offset_origin
from .sphere import intersect_sphere

__all__ = [
    "Ball",
    "Encounter",
    "Hit",
    "Ray",
    "Shapes",
    "Sorted",
    "SurfacePoint",
    "angle_between",
    "ball_around",
    "blocked",
    "has_area",
    "hit_shape",
    "intersect",
    "intersect_box",
    "intersect_disc",
    "intersect_mesh",
    "intersect_plane",
    "intersect_quad",
    "intersect_sphere",
    "largest_size",
    "log_cos_between",
    "mirror_direction",
    "nearest_shape",
    "occluded",
    "offset_length",
    "offset_origin",
    "point_on",
    "problems",
    "reach_of",
    "sorted_shapes",
    "surface_area",
]
