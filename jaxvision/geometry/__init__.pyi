# What `jaxvision.geometry` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import hemisphere as hemisphere
from ._bounds import Ball as Ball, ball_around as ball_around
from ._mesh import intersect_mesh as intersect_mesh
from ._places import (
    SurfacePoint as SurfacePoint,
    has_area as has_area,
    point_on as point_on,
    surface_area as surface_area,
)
from ._size import (
    largest_size as largest_size,
    offset_length as offset_length,
    largest_coordinate as largest_coordinate,
)
from .box import intersect_box as intersect_box
from .checks import problems as problems
from .flat import (
    intersect_disc as intersect_disc,
    intersect_plane as intersect_plane,
    intersect_quad as intersect_quad,
)
from .nearest import (
    Shapes as Shapes,
    Sorted as Sorted,
    blocked as blocked,
    hit_shape as hit_shape,
    intersect as intersect,
    nearest_shape as nearest_shape,
    occluded as occluded,
    sorted_shapes as sorted_shapes,
)
from .rays import (
    Encounter as Encounter,
    Hit as Hit,
    Ray as Ray,
    angle_between as angle_between,
    log_cos_between as log_cos_between,
    mirror_direction as mirror_direction,
    offset_origin as offset_origin,
)
from .sphere import intersect_sphere as intersect_sphere
