"""Whether intervals hold the truth as often as they say: simulated data, fitted again and again."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
