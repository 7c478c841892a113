"""An image shown as numbers: the picture, a histogram of each channel, a scan line, the grid of
values about a pixel, and the surface over the plane (Szeliski, Computer Vision, fig. 3.3).

This is the edge of the library: eager, NumPy in, with matplotlib loaded on first use. Values are DN
(integer images) or relative (floating images). An image that cannot be shown raises `InputError`,
one sentence.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
