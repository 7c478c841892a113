"""Slopes and curvatures of pictures, in the picture's unit per pixel.

x is to the right and y is down, as rows and columns are counted. All are exact for parabolas away
from the border. Pictures, borders and methods as in `convolution`, but "normalised_zero": the
weights of a derivative have sum 0, `ValueError`.
"""

from typing import NamedTuple

from ..padding import Filtered, Picture
from ._terms import Fill
from .convolution import _check_weighs, correlate, correlate_separable
from .kernels import derivative_kernels, laplacian_kernel


class Gradient(NamedTuple):
    """Slopes to the right and downwards, each of the picture's shape, per pixel."""

    x: Filtered
    y: Filtered


def derivative(
    picture: Picture,
    *,
    scheme: str = "central",
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Gradient:
    """First differences, per pixel, by "central", "prewitt", "sobel" or "scharr" kernels (scaled so
    that a slope of 1 gives 1). Smoother ones: `gaussian` with an order."""
    _check_weighs(border, of="a derivative")
    along, across = derivative_kernels(scheme=scheme)
    return Gradient(
        correlate_separable(picture, across, along, border=border, fill=fill, method=method),
        correlate_separable(picture, along, across, border=border, fill=fill, method=method),
    )


def laplacian(
    picture: Picture,
    *,
    isotropic: bool = False,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """f_xx + f_yy by second differences, per square pixel; `isotropic` takes the nine-point
    stencil."""
    _check_weighs(border, of="a derivative")
    kernel = laplacian_kernel(isotropic=isotropic)
    return correlate(picture, kernel, border=border, fill=fill, method=method)
