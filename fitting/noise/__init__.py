"""Calibration of a camera's gain, noise and linearity by photon transfer."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
