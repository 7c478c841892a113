"""Intersection of rays with surfaces. Functions take one ray; use `jax.vmap` for many.

Lengths are metres, directions unit vectors. Only intersections at a distance > 0 are hits. A miss
has distance inf, a zero normal, and gradients of zero. If a number of a ray is NaN or infinite, its
hit consists of NaN. Lengths may be 3e-16 to 1e18 m in float32, 1e-146 to 1e153 m in float64. Each
shape has its own module. `nearest` finds the first of many shapes, and tests for occlusion.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
