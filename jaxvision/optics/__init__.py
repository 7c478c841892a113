"""The optics of a camera, from the scene to the sensor's surface.

Projection, focus, apertures, diffraction, vignetting, distortion and chromatic aberrations.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
