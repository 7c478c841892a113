"""Light sources, one file for each kind: its record, and the light from it at a point.

A light without size sends one `Incident` to a point. An extended light is a map of the unit square
onto its directions, and a rule (`Quadrature`, `MonteCarlo`, `Balanced`) gives the sample points.
The sum over the samples is the light. For ONE point; the caller vmaps. A new type of light needs
one file, which ends in `register` or `register_extended`; a user's own file may do the same.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
