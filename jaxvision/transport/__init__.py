"""Light that bounces: scenes in, radiance out. Radiance in W m^-2 sr^-1.

    paths        path tracing, from the eye: all that a scene's light does, with its standard error,
                 but for caustics of lights without size
    ray_tree     ray tracing: direct light, mirrors and glass, without chance
    light_paths  light tracing, from the sources: caustics and small lights
    radiosity    diffuse surfaces in patches

Each has its own reach and cost, which its file states.
"""

from .light_paths import light_traced
from .paths import Paths, Traced, path_radiance, path_sample, path_traced, path_traced_pixels
from .ray_tree import ray_traced, ray_tree_radiance, ray_tree_radiances

__all__ = [
    "Paths",
    "Traced",
    "light_traced",
    "path_radiance",
    "path_sample",
    "path_traced",
    "path_traced_pixels",
    "ray_traced",
    "ray_tree_radiance",
    "ray_tree_radiances",
]
