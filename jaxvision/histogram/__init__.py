"""Histograms and operations based on them: cumulative distributions, quantiles, thresholds,
equalisation (full, partial, locally adaptive) and matching.

An image is one grey plane (h, w), or (..., h, w, bands), where each band of each image is a
separate plane. `uint8` and `uint16` images are counted exactly, with one bin per code. Floating
images have relative values and are counted in equal bins of a stated range. NaN is never counted.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
