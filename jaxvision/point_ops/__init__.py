"""Point operators: they act on each pixel separately, on arrays of any shape and floating dtype.

Encoded and linear values are relative, nominally in [0, 1]; values above 1 are allowed. Integer
codes raise a `ValueError`. Values and gradients of finite pixels are finite everywhere, also at and
below 0. NaN stays NaN. NaN and infinity do not affect other pixels. Parameters are Python floats or
arrays that broadcast with the pixels: one number, one per band, or one per pixel. Inside one `jit`
a chain of these operators is a single pass over the picture. For linear light and superposition see
Szeliski, Computer Vision, section 3.1.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
