"""First and second derivatives of pictures, in the picture's unit per pixel.

x points right and y points down, like columns and rows. Away from the border all derivatives are
exact for parabolas. Pictures, borders and methods are those of `convolution`. Only the border
"normalised_zero" raises a `ValueError`, because the weights of a derivative have sum 0.
"""

from typing import NamedTuple

from ..core._arguments import takes_numbers
from ._terms import Fill
from .convolution import _check_weighs, correlate, correlate_separable
from .kernels import derivative_kernels, laplacian_kernel
from .padding import Filtered, Picture


class Gradient(NamedTuple):
    """The first derivatives of a picture along its columns and rows.

    Attributes:
        x: the picture's shape, its unit per pixel, positive where it rises to the right.
        y: the picture's shape, its unit per pixel, positive where it rises downwards.
    """

    x: Filtered
    y: Filtered


@takes_numbers
def derivative(
    picture: Picture,
    *,
    scheme: str = "central",
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Gradient:
    """Estimate the first derivatives along both axes by differences.

    For smoother derivatives use `gaussian` with an order.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        scheme: "central", "prewitt", "sobel" or "scharr", all scaled so that a slope of 1 gives 1.
        border: a key of `padding.BORDERS` but "normalised_zero".
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate_separable`.

    Returns:
        The slopes x and y, each of the picture's shape, in its unit per pixel.

    Raises:
        ValueError: for an unknown scheme, border or method.

    Example:
        >>> ramp = np.tile(np.arange(5.0), (3, 1))
        >>> gradient = jv.filters.derivative(ramp)
        >>> print(gradient.x[1, 1:4], gradient.y[1, 1:4])
        [1. 1. 1.] [0. 0. 0.]
    """
    _check_weighs(border, of="a derivative")
    along, across = derivative_kernels(scheme=scheme)
    return Gradient(
        correlate_separable(picture, across, along, border=border, fill=fill, method=method),
        correlate_separable(picture, along, across, border=border, fill=fill, method=method),
    )


@takes_numbers
def laplacian(
    picture: Picture,
    *,
    isotropic: bool = False,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Compute the Laplacian f_xx + f_yy by second differences.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        isotropic: whether to take the nine-point stencil.
        border: a key of `padding.BORDERS` but "normalised_zero".
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate`.

    Returns:
        The picture's shape; its unit per square pixel.

    Raises:
        ValueError: for an unknown border or method.

    Example:
        >>> bowl = np.arange(5.0)[None] ** 2 * np.ones((3, 1))
        >>> print(jv.filters.laplacian(bowl)[1, 1:4])
        [2. 2. 2.]
    """
    _check_weighs(border, of="a derivative")
    kernel = laplacian_kernel(isotropic=isotropic)
    return correlate(picture, kernel, border=border, fill=fill, method=method)
