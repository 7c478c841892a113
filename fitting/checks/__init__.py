"""Coverage of intervals: simulated data are fitted many times, and intervals that contain the true
value are counted."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
