"""A simulated lab afternoon: its image files, their calibrations, and every estimate compared with
the truth."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
