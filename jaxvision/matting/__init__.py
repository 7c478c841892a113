"""Matting: coverage alpha and foreground light, from pictures in linear light.

    picture = alpha foreground + (1 - alpha) background

`keying` needs a known background, `closed_form` a trimap, `foreground` the coverage. Light is
relative. An alpha is (..., 1) in [0, 1]; a foreground comes as a layer of `compositing`:
premultiplied light, then alpha.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
