"""Parameters, priors and likelihoods, searches and samplers, estimates with intervals: statistics
that know no physics and no calibration."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
