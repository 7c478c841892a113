"""Development: from the raw data of a sensor to a picture file."""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
