"""Measure the resolution and the aberrations of a lens from pictures of straight edges."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
