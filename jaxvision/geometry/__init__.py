"""Rays and the surfaces they meet. For ONE ray; the caller vmaps.

Lengths are metres, directions unit vectors. A ray meets what lies at a distance > 0; a miss has
distance inf, a zero normal, and gradients of zero. Each shape has a file; `nearest` finds the
first of many and what lies in between.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
