"""Read and write files of measured reflectance: MERL, Cornell goniometer and RGL.

The module of each format describes the layout of its files. Every failure raises an `InputError`
with a message of one sentence that names the file.
"""

from ...core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
