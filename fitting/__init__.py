"""Digital numbers back to the parameters of light, surface and camera, with honest uncertainty.

`Problem` states what is unknown, what is predicted and how data scatter about that; `fit` gives a
`Fit`: estimates with intervals, a verdict, and what the data cannot tell. Every name is loaded when
it is first used; `__init__.pyi` lists them.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
