"""Photometric image formation as pure JAX functions: from light to digital numbers, and the image
processing that follows.

This package exports the records and the functions along the path of light. Functions for image
processing are in separate modules: `point_ops`, `colour_spaces`, `matting`, `histogram`, `filters`.
Every name is imported when it is first used; `__init__.pyi` lists them.
"""

from .core._moved import find_modules_by_old_names
from .core.lazy_names import names_of

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
find_modules_by_old_names()
