"""Matting: coverage alpha and foreground light, from pictures in linear light.

    picture = alpha foreground + (1 - alpha) background

`keying` needs a known background, `closed_form` a trimap, `foreground` the coverage. Light is
relative. An alpha is (..., 1) in [0, 1]; a foreground comes as a layer of `compositing`:
premultiplied light, then alpha.
"""

from .closed_form import Matte, closed_form_matte
from .foreground import estimate_foreground
from .keying import (
    blue_screen_matte,
    difference_matte,
    least_squares_matte,
    lift,
    projected_matte,
    triangulation_matte,
)

__all__ = [
    "Matte",
    "blue_screen_matte",
    "closed_form_matte",
    "difference_matte",
    "estimate_foreground",
    "least_squares_matte",
    "lift",
    "projected_matte",
    "triangulation_matte",
]
