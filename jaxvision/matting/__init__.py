"""Matting: estimate the coverage alpha and the foreground light from pictures in linear light.

    picture = alpha foreground + (1 - alpha) background

`keying` needs a known background, `closed_form` needs a trimap, and `foreground` needs the
coverage. Light is relative. An alpha is (..., 1) in [0, 1]; a foreground is returned as a layer of
`compositing`: premultiplied light, then alpha.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
