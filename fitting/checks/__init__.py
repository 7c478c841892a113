"""Whether intervals hold the truth as often as they say: simulated data, fitted again and again."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
