"""Estimate where the lights are from photographs of a ball: directions or positions, with one
covariance.

An error of the ball's outline affects all lights.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
