"""Parameters, priors and likelihoods, searches and samplers, estimates with intervals: statistics
that know no physics and no calibration."""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
