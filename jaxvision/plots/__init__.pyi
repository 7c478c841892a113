# What `jaxvision.plots` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .estimates import (
    corner as corner,
    curve as curve,
    curves as curves,
    error_against_time as error_against_time,
    trace as trace,
)
from .images import (
    false_colour as false_colour,
    histogram as histogram,
    picture as picture,
    pictures as pictures,
)
from .inspection import inspect as inspect
from .light import lobe as lobe, spectrum as spectrum
from .stages import pipeline as pipeline
from .summary import BandSummary as BandSummary, band_names as band_names, summarise as summarise
