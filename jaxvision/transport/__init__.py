"""Light that bounces: scenes in, radiance out. Radiance in W m^-2 sr^-1.

    paths        path tracing, from the eye: all that a scene's light does, with its standard error,
                 but for caustics of lights without size
    ray_tree     ray tracing: direct light, mirrors and glass, without chance
    light_paths  light tracing, from the sources: caustics and small lights
    radiosity    diffuse surfaces in patches

Each has its own reach and cost, which its file states.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..rendering import Traced
from .light_paths import light_traced
from .paths import (
    Paths,
    path_along,
    path_radiance,
    path_sample,
    path_traced,
    path_traced_pixels,
)
from .ray_tree import ray_traced, ray_tree_along, ray_tree_radiance, ray_tree_radiances

if TYPE_CHECKING:
    from . import radiosity

__all__ = [
    "Paths",
    "Traced",
    "light_traced",
    "path_along",
    "path_radiance",
    "path_sample",
    "path_traced",
    "path_traced_pixels",
    "radiosity",
    "ray_traced",
    "ray_tree_along",
    "ray_tree_radiance",
    "ray_tree_radiances",
]


def __getattr__(name: str) -> Any:
    """`radiosity` is loaded when it is first used."""
    if name == "radiosity":
        return import_module(f"{__name__}.radiosity")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
