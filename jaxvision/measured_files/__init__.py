"""Files of measured reflectance: MERL, Cornell goniometer, RGL. Eager.

The module of each format describes its layout. Every failure is an `InputError` of one sentence
that names the file.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
