"""Scene and view -> radiance, W m^-2 sr^-1.

pixel_loop   the one loop over pixels and their samples, for any integrator
direct       what a ray sees by direct light, and the picture of it
light_field  the same along all lines through two windows
"""

from .direct import direct_along, radiance_along, render
from .light_field import render_light_field
from .pixel_loop import Along, PixelSamples, Traced, each, numbers_of, photograph, sample_ray

__all__ = [
    "Along",
    "PixelSamples",
    "Traced",
    "direct_along",
    "each",
    "numbers_of",
    "photograph",
    "radiance_along",
    "render",
    "render_light_field",
    "sample_ray",
]
