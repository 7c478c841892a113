"""Light that bounces: scenes in, radiance out. Radiance in W m^-2 sr^-1.

    paths        path tracing, from the eye: all that a scene's light does, with its standard error,
                 but for caustics of lights without size
    ray_tree     ray tracing: direct light, mirrors and glass, without chance
    light_paths  light tracing, from the sources: caustics and small lights
    radiosity    diffuse surfaces in patches
    missing      what each of them cannot find in a scene

Each has its own reach and cost, which its file states.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
