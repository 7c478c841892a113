"""Scene and view -> radiance, W m^-2 sr^-1.

pixel_loop   the one loop over pixels and their samples, for any integrator
direct       what a ray sees by direct light, and the picture of it
light_field  the same along all lines through two windows
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
