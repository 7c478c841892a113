"""Radiosity: diffuse surfaces cut into patches, and the light that they exchange.

plan = plan_patches(scene, size=0.1)          how many patches: settled first, outside `jit`
table = form_factor_table(scene, plan)        who sees whom: once, for fixed geometry
solution = radiosity(scene, plan, table=table)
image = radiosity_image(scene, plan, solution, view)
"""

from ._grid import Face, Plan
from ._trapped import trapping_surface
from .exchange import closure_error, form_factor_table, reciprocity_error
from .form_factors import (
    Exchange,
    parallel_exchange,
    parallel_rectangles,
    perpendicular_exchange,
    perpendicular_rectangles,
    point_to_polygon,
    polygon_to_polygon,
)
from .gather import radiosity_along, radiosity_image, radiosity_rays
from .patches import Patches, by_patch, patches_of, plan_patches
from .solution import Solution, direct_irradiance, radiosity
from .solve import ambient_estimate, bounce, shoot, solve_radiosity

__all__ = [
    "Exchange",
    "Face",
    "Patches",
    "Plan",
    "Solution",
    "ambient_estimate",
    "bounce",
    "by_patch",
    "closure_error",
    "direct_irradiance",
    "form_factor_table",
    "parallel_exchange",
    "parallel_rectangles",
    "patches_of",
    "perpendicular_exchange",
    "perpendicular_rectangles",
    "plan_patches",
    "point_to_polygon",
    "polygon_to_polygon",
    "radiosity",
    "radiosity_along",
    "radiosity_image",
    "radiosity_rays",
    "reciprocity_error",
    "shoot",
    "solve_radiosity",
    "trapping_surface",
]
