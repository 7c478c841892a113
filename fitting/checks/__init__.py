"""Coverage of intervals: fit simulated data many times, and count the intervals that contain the
true value."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
