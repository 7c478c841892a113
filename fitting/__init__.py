"""Estimation of the parameters of light, surface and camera from digital numbers, with intervals.

`Problem` states the parameters, the prediction and the likelihood. `fit` returns a `Fit`: estimates
with intervals, a verdict, and the parameters that are not identifiable. Every name is loaded at its
first use; `__init__.pyi` lists them.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
