"""Scene and view -> radiance, W m^-2 sr^-1.

pixel_loop   the one loop over pixels and their samples, for any integrator
direct       what a ray sees by direct light, and the picture of it
light_field  the same along all lines through two windows
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
