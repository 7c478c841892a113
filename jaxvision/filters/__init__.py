"""Filters of pictures: linear filters with any kernel, at any border, with gradients with respect
to picture and kernel; shift-variant filters; filters as matrices; and non-linear filters.

The matrix forms need scipy, which is loaded when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .bilateral import bilateral_filter, joint_bilateral_filter
from .convolution import convolve, correlate, correlate_separable
from .derivatives import Gradient, derivative, laplacian
from .gaussians import gaussian, gaussian_kernel, laplacian_of_gaussian
from .integral import IntegralImage, box_sum, integral_image, window_sum
from .kernels import (
    binomial_kernel,
    blur_sigmas,
    box_kernel,
    derivative_kernels,
    gaussian_size,
    laplacian_kernel,
)
from .low_rank_kernels import LowRank, correlate_low_rank, low_rank
from .median import median_filter
from .nonlocal_means import nonlocal_means_filter
from .operators import adjoint, impulse_response
from .pyramid import (
    blend_by_pyramid,
    collapse_laplacian,
    expand,
    gaussian_pyramid,
    laplacian_pyramid,
    reduce_by_two,
)
from .shift_variant import (
    correlate_bank,
    correlate_per_pixel,
    disk_profile,
    gaussian_profile,
    gaussian_varying,
    radial_blur,
)
from .smoothing import binomial, blur_straight, box, unsharp_mask
from .steerable import (
    QuadratureBasis,
    directional_derivative,
    dominant_orientation,
    oriented_energy,
    quadrature_basis,
    steer,
)

if TYPE_CHECKING:
    from .matrix import MatrixForm, filter_matrix, per_pixel_matrix
    from .scipy_operators import scipy_matrix, scipy_operator

_WITH_SCIPY = {
    "MatrixForm": "matrix",
    "filter_matrix": "matrix",
    "per_pixel_matrix": "matrix",
    "scipy_matrix": "scipy_operators",
    "scipy_operator": "scipy_operators",
}

__all__ = [
    "Gradient",
    "IntegralImage",
    "LowRank",
    "MatrixForm",
    "QuadratureBasis",
    "adjoint",
    "bilateral_filter",
    "binomial",
    "binomial_kernel",
    "blend_by_pyramid",
    "blur_sigmas",
    "blur_straight",
    "box",
    "box_kernel",
    "box_sum",
    "collapse_laplacian",
    "convolve",
    "correlate",
    "correlate_bank",
    "correlate_low_rank",
    "correlate_per_pixel",
    "correlate_separable",
    "derivative",
    "derivative_kernels",
    "directional_derivative",
    "disk_profile",
    "dominant_orientation",
    "expand",
    "filter_matrix",
    "gaussian",
    "gaussian_kernel",
    "gaussian_profile",
    "gaussian_pyramid",
    "gaussian_size",
    "gaussian_varying",
    "impulse_response",
    "integral_image",
    "joint_bilateral_filter",
    "laplacian",
    "laplacian_kernel",
    "laplacian_of_gaussian",
    "laplacian_pyramid",
    "low_rank",
    "median_filter",
    "nonlocal_means_filter",
    "oriented_energy",
    "per_pixel_matrix",
    "quadrature_basis",
    "radial_blur",
    "reduce_by_two",
    "scipy_matrix",
    "scipy_operator",
    "steer",
    "unsharp_mask",
    "window_sum",
]


def __getattr__(name: str) -> Any:
    if name in _WITH_SCIPY:
        return getattr(import_module(f".{_WITH_SCIPY[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
