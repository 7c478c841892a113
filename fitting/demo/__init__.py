"""Simulate the image files of an afternoon in a lab, calibrate from them, and compare every
estimate with its true value.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
