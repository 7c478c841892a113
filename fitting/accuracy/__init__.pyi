# What `fitting.accuracy` offers, each name where it is defined; see `fitting/__init__.pyi`.

from .knobs import KNOBS as KNOBS
from .rigs import measured as measured, problems as problems
