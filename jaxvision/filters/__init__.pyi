# What `jaxvision.filters` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import padding as padding
from .bilateral import (
    bilateral_filter as bilateral_filter,
    joint_bilateral_filter as joint_bilateral_filter,
)
from .convolution import (
    convolve as convolve,
    correlate as correlate,
    correlate_separable as correlate_separable,
)
from .derivatives import Gradient as Gradient, derivative as derivative, laplacian as laplacian
from .gaussians import (
    gaussian as gaussian,
    gaussian_kernel as gaussian_kernel,
    laplacian_of_gaussian as laplacian_of_gaussian,
)
from .integral import (
    IntegralImage as IntegralImage,
    box_sum as box_sum,
    integral_image as integral_image,
    window_sum as window_sum,
)
from .kernels import (
    binomial_kernel as binomial_kernel,
    blur_sigmas as blur_sigmas,
    box_kernel as box_kernel,
    derivative_kernels as derivative_kernels,
    gaussian_size as gaussian_size,
    laplacian_kernel as laplacian_kernel,
)
from .low_rank_kernels import (
    LowRank as LowRank,
    correlate_low_rank as correlate_low_rank,
    low_rank as low_rank,
)
from .matrix import (
    MatrixForm as MatrixForm,
    filter_matrix as filter_matrix,
    per_pixel_matrix as per_pixel_matrix,
)
from .median import median_filter as median_filter
from .nonlocal_means import nonlocal_means_filter as nonlocal_means_filter
from .operators import adjoint as adjoint, impulse_response as impulse_response
from .padding import BORDERS as BORDERS, pad_axis as pad_axis, pad as pad
from .pyramid import (
    blend_by_pyramid as blend_by_pyramid,
    collapse_laplacian as collapse_laplacian,
    expand as expand,
    gaussian_pyramid as gaussian_pyramid,
    laplacian_pyramid as laplacian_pyramid,
    reduce_by_two as reduce_by_two,
)
from .resampling import resize as resize, warp as warp
from .scipy_operators import scipy_matrix as scipy_matrix, scipy_operator as scipy_operator
from .shift_variant import (
    convolve_per_pixel as convolve_per_pixel,
    correlate_bank as correlate_bank,
    correlate_per_pixel as correlate_per_pixel,
    disk_profile as disk_profile,
    gaussian_profile as gaussian_profile,
    gaussian_varying as gaussian_varying,
    radial_blur as radial_blur,
)
from .smoothing import (
    binomial as binomial,
    blur_straight as blur_straight,
    box as box,
    unsharp_mask as unsharp_mask,
)
from .steerable import (
    QuadratureBasis as QuadratureBasis,
    directional_derivative as directional_derivative,
    dominant_orientation as dominant_orientation,
    oriented_energy as oriented_energy,
    quadrature_basis as quadrature_basis,
    steer as steer,
)
