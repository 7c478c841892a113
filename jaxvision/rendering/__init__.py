"""Rendering: compute the radiance of each pixel, W m^-2 sr^-1, from a scene and a view.

pixel_loop   the loop over pixels and their samples, for any integrator
direct       radiance along a ray by direct light, and a picture of it
light_field  radiance along all lines through two windows
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
