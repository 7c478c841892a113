# What `jaxvision.rendering` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import (
    hemisphere_integral as hemisphere_integral,
    lifted_scene as lifted_scene,
    scene_checks as scene_checks,
    shading as shading,
    shadows as shadows,
)
from .direct import direct_along as direct_along, radiance_along as radiance_along, render as render
from .edges import Edges as Edges
from .light_field import render_light_field as render_light_field
from .pixel_loop import (
    Along as Along,
    PixelSamples as PixelSamples,
    Traced as Traced,
    map_rays as map_rays,
    numbers_of as numbers_of,
    photograph as photograph,
    sample_ray as sample_ray,
)
