"""Files of measured reflectance: MERL, Cornell goniometer, RGL. Eager.

The module of each format describes its layout. Every failure is an `InputError` of one sentence
that names the file.
"""

from ...core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
