"""Filters of pictures: linear filters with any kernel, at any border, differentiable with respect
to picture and kernel; shift-variant filters; filters as matrices; and non-linear filters.

Every name is imported when it is first used, and scipy only by functions for matrices.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
