"""Calibration of a camera's response from an exposure stack: response curve, gamma and radiance
map."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
