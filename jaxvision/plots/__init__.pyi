# What `jaxvision.plots` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .inspection import inspect as inspect
from .summary import BandSummary as BandSummary, band_names as band_names, summarise as summarise
