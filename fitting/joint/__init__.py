"""Fit surface, response and sensor to the same images, in one posterior."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
