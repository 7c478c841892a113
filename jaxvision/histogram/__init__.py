"""How often each value occurs, and what follows from it: distributions, quantiles, thresholds,
equalisation (full, partial, locally adaptive) and matching.

Images are (h, w), one grey plane, or (..., h, w, bands), where each band of each image is a plane
of its own. `uint8` and `uint16` images are counted code by code and exactly. Floating images have
relative values, counted in equal bins of a stated range. NaN is never counted.
"""

from .counts import (
    Histogram,
    cumulative_distribution,
    exact_histogram,
    otsu_threshold,
    quantile,
    soft_histogram,
)
from .equalisation import equalise
from .local_equalisation import equalise_locally
from .matching import match_histogram

__all__ = [
    "Histogram",
    "cumulative_distribution",
    "equalise",
    "equalise_locally",
    "exact_histogram",
    "match_histogram",
    "otsu_threshold",
    "quantile",
    "soft_histogram",
]
