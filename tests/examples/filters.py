"""Calls for linear filters, shift-variant filters and their matrices."""

import jax.numpy as jnp
import numpy as np

from jaxvision import filters

RNG = np.random.default_rng(15)
X = jnp.asarray(RNG.uniform(0.1, 0.9, size=(3, 4, 2)))
PLANE = X[..., 0]
KERNEL = jnp.asarray(RNG.uniform(0.1, 0.9, size=(3, 2)))
COLUMN, ROW = KERNEL[:, 0], KERNEL[0]
STACK = jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 2, 3, 4)))
BANK = jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 2, 2)))
SIGMA, ONE, TWO = jnp.asarray(1.3), jnp.asarray(0.7), jnp.asarray(2.3)
SIGMAS = jnp.asarray(RNG.uniform(0.6, 1.9, size=(3, 4)))
ROWS = jnp.asarray([[0.3, 0.35], [1.4, 1.45]])  # not on a row or column, where slopes jump
COLUMNS = jnp.asarray([[0.4, 1.5], [0.45, 1.6]])
LAYER = jnp.concatenate([X, 0.5 * X[..., :1]], axis=-1)
BASIS = filters.quadrature_basis(X, ONE, size=5)
FACTORS = filters.low_rank(KERNEL, rank=1)


def blur(picture):
    return filters.box(picture, size=3)


EXAMPLES = {
    "filters.padding.pad": ((X,), {"widths": ((1, 2), (5, 0)), "border": "extend"}),
    "filters.padding.pad_axis": (
        (X[None],),
        {"axis": 2, "before": 1, "after": 5, "border": "extend", "outside": ONE},
    ),
    "filters.convolution.correlate": ((X, KERNEL), {"border": "normalised_zero"}),
    "filters.convolution.convolve": ((X, KERNEL), {"border": "constant", "fill": TWO}),
    "filters.convolution.correlate_separable": ((X, COLUMN, ROW), {}),
    "filters.operators.impulse_response": ((ONE,), {"operator": blur, "shape": (3, 4, 2)}),
    "filters.derivatives.derivative": ((X,), {"scheme": "scharr"}),
    "filters.derivatives.laplacian": ((X,), {"border": "zero"}),
    "filters.gaussians.gaussian": ((X, SIGMA), {"size": 5, "order": (0, 1)}),
    "filters.gaussians.gaussian_kernel": ((SIGMA,), {"size": 5, "sampling": "integrated"}),
    "filters.gaussians.laplacian_of_gaussian": ((X, SIGMA), {"size": 5}),
    "filters.low_rank_kernels.low_rank": ((KERNEL,), {"rank": 1}),
    "filters.low_rank_kernels.correlate_low_rank": ((X, FACTORS), {}),
    "filters.operators.adjoint": ((X,), {"operator": blur}),
    "filters.resampling.resize": ((X,), {"size": (2, 5)}),
    "filters.resampling.warp": ((X, ROWS, COLUMNS), {"samples": 2}),
    "filters.shift_variant.correlate_bank": ((X, BANK, SIGMAS - 0.5), {}),
    "filters.shift_variant.convolve_per_pixel": ((X, STACK), {}),
    "filters.shift_variant.correlate_per_pixel": ((X, STACK), {}),
    "filters.shift_variant.disk_profile": ((ONE, SIGMAS), {}),
    "filters.shift_variant.gaussian_profile": ((ONE, SIGMAS), {}),
    "filters.shift_variant.gaussian_varying": ((X, SIGMAS), {"sigmas": (0.5, 1.0, 2.0)}),
    "filters.shift_variant.radial_blur": ((X, SIGMAS), {"radius": 3}),
    "filters.smoothing.binomial": ((X,), {"size": 3}),
    "filters.smoothing.blur_straight": ((LAYER,), {"blur": blur}),
    "filters.smoothing.box": ((X,), {"size": 3}),
    "filters.smoothing.unsharp_mask": ((X, SIGMA, ONE), {"size": 5}),
    "filters.steerable.directional_derivative": ((X, SIGMA, ONE), {"size": 5}),
    "filters.steerable.dominant_orientation": ((BASIS,), {}),
    "filters.steerable.oriented_energy": ((BASIS, ONE), {}),
    "filters.steerable.quadrature_basis": ((X, ONE), {"size": 5}),
    "filters.steerable.steer": ((BASIS, SIGMAS), {}),
}
