"""Fit models of light, surface and camera to digital numbers; return estimates with intervals.

`Problem` states the parameters, the prediction and the likelihood. `fit` returns a `Fit`: estimates
with intervals, an assessment of the fit, and the names of the parameters that the data do not
identify. The package imports each public name at its first use; `__init__.pyi` lists them.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
