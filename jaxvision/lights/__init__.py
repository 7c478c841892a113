"""Light sources: each file contains the record of one kind of light, and computes its light at a
point.

A light without size gives one `Incident` at a point. An extended light maps the unit square to
directions, and a sampling rule (`Quadrature`, `MonteCarlo`, `Balanced`) chooses points of the
square. The light at the point is the sum over these samples. All functions are for one point; use
`jax.vmap` for many. A new kind of light needs one file, which ends with a call of `register` or
`register_extended`. Users can register their own lights in the same way.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
