"""Estimate parameters without any physics: parameters, priors and likelihoods, searches and
samplers, and estimates with intervals.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
