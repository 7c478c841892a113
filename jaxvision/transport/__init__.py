"""Global illumination: the radiance of a scene with interreflections, in W m^-2 sr^-1.

    paths        path tracing from the eye: all light except caustics of lights without size, with
                 its standard error
    ray_tree     ray tracing: direct light, mirrors and glass, deterministic
    light_paths  light tracing from the sources: caustics and small lights
    radiosity    diffuse surfaces in patches
    missing      messages about light that an integrator neglects

Each file states which light its integrator includes, and its cost.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
