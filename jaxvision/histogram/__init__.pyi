# What `jaxvision.histogram` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .counts import (
    Histogram as Histogram,
    cumulative_distribution as cumulative_distribution,
    exact_histogram as exact_histogram,
    otsu_threshold as otsu_threshold,
    quantile as quantile,
    soft_histogram as soft_histogram,
)
from .equalisation import equalise as equalise
from .local_equalisation import equalise_locally as equalise_locally
from .matching import match_histogram as match_histogram
