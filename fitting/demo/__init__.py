"""A simulated lab afternoon: its image files, their calibrations, and every estimate beside the
truth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
