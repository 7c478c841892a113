# What `jaxvision.transport` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import radiosity as radiosity
from .light_paths import light_traced as light_traced
from .missing import missing_light as missing_light
from .paths import (
    Paths as Paths,
    Traced as Traced,
    path_along as path_along,
    path_radiance as path_radiance,
    path_sample as path_sample,
    path_traced as path_traced,
    path_traced_pixels as path_traced_pixels,
)
from .ray_tree import (
    ray_traced as ray_traced,
    ray_tree_along as ray_tree_along,
    ray_tree_radiance as ray_tree_radiance,
    ray_tree_radiances as ray_tree_radiances,
)
