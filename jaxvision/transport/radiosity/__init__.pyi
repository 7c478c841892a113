# What `jaxvision.transport.radiosity` offers, each name where it is defined; see
# `jaxvision/__init__.pyi`.

from ._grid import Face as Face, Plan as Plan
from ._trapped import trapping_surface as trapping_surface
from .exchange import (
    closure_error as closure_error,
    exchanged as exchanged,
    form_factor_table as form_factor_table,
    reciprocity_error as reciprocity_error,
)
from .form_factors import (
    Exchange as Exchange,
    parallel_exchange as parallel_exchange,
    parallel_rectangles as parallel_rectangles,
    perpendicular_exchange as perpendicular_exchange,
    perpendicular_rectangles as perpendicular_rectangles,
    point_to_polygon as point_to_polygon,
    polygon_to_polygon as polygon_to_polygon,
)
from .gather import (
    radiosity_along as radiosity_along,
    radiosity_image as radiosity_image,
    radiosity_rays as radiosity_rays,
)
from .patches import (
    Patches as Patches,
    patch_means as patch_means,
    patches_of as patches_of,
    plan_patches as plan_patches,
)
from .solution import (
    Solution as Solution,
    direct_irradiance as direct_irradiance,
    radiosity as radiosity,
)
from .solve import (
    ambient_estimate as ambient_estimate,
    bounce as bounce,
    shoot as shoot,
    solve_radiosity as solve_radiosity,
)
