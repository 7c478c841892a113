"""The optics of a camera, from the scene to the sensor's surface.

This package computes projection, focus, apertures, diffraction, vignetting, distortion and
chromatic aberrations.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
