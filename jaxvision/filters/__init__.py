"""Filters of pictures: linear filters with any kernel, at any border, with gradients with respect
to picture and kernel; shift-variant filters; filters as matrices; and non-linear filters.

Every name is loaded when it is first used, and scipy with the matrix forms only.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
