"""Mixing of counted electrons between neighbours: a linear filter after the shot noise.

After mixing with a kernel w, pixels that were independent with variance v have

    variance     v sum w^2
    covariance   v sum w(k) w(k + lag)

The sum of the covariances over all lags, with the variance at lag 0, is v, because the sum of w is
1.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..core._arguments import takes_numbers
from ..core._bounds import Ends
from ..core._numerics import safe_sqrt
from ..core._types import Scalar
from ..filters.convolution import convolve
from ..scene import Mixing
from ._draws import check_image
from ._registry import register
from .exposure import Counts


@takes_numbers
def mixed(electrons: Counts, mixing: Mixing) -> Counts:
    """Return the electrons after mixing. At the border of the image, electrons that would leave
    return.

    Args:
        electrons: (..., h, w, bands) electrons.
        mixing: the kernel.

    Returns:
        (..., h, w, bands) electrons.

    Raises:
        ValueError: `electrons` is not an image.

    Example:
        >>> mixing = jv.Mixing([[0.1, 0.9, 0.0]])  # a tenth is read one column earlier
        >>> print(jv.sensor.mixed([[[0.0], [100.0], [0.0]]], mixing).ravel())
        [10. 90.  0.]
    """
    check_image("Sensor.mixing", electrons.shape)
    return convolve(electrons, mixing.kernel.astype(electrons.dtype))


@takes_numbers
def even_mixing(share: Scalar) -> Mixing:
    """Return the `Mixing` with equal shares for the four nearest neighbours that reduces a pixel's
    variance by a given fraction.

    Args:
        share: () of the variance, 1 - sum kernel^2, below 4/5, no unit.

    Returns:
        A kernel of 3 x 3 with s = (1 - sqrt(1 - 5 share / 4)) / 5 at each neighbour.

    Example:
        >>> kernel = jv.sensor.even_mixing(0.1).kernel
        >>> print(round(float(1 - (kernel**2).sum()), 6))
        0.1
    """
    each = share / (4 * (1 + safe_sqrt(1 - 1.25 * share)))
    cross = jnp.asarray([[0, 1, 0], [1, 0, 1], [0, 1, 0]], each.dtype)
    middle = jnp.asarray([[0, 0, 0], [0, 1, 0], [0, 0, 0]], each.dtype)
    return Mixing(each * cross + (1 - 4 * each) * middle)


def _moments(mixing: Mixing, moments: Any) -> Any:
    """Return the moments of independent pixels after mixing. Pixels beyond the border are assumed
    to have the same variance."""
    check_image("Sensor.mixing", moments.mean.shape)
    square = mixing.kernel.astype(moments.mean.dtype) ** 2
    return moments._replace(
        mean=mixed(moments.mean, mixing), variance=convolve(moments.variance, square)
    )


def _bound(ends: Ends[Mixing], electrons: float) -> tuple[float, float]:
    """Return bounds on the change by mixing, for charges of at most `electrons` RMS. The bounds
    follow from S, the sum of |w| over the neighbours."""
    low, high = (np.asarray(end.kernel, float) for end in ends)
    largest = np.maximum(np.abs(low), np.abs(high))
    middle = tuple(size // 2 for size in largest.shape)
    kept = max(abs(1 - float(end[middle])) for end in (low, high))
    others = float(largest.sum() - largest[middle])
    return max(others, kept) * electrons, max(float(largest.sum()), 1.0)


register(
    Mixing,
    charge=lambda key, mixing, electrons: mixed(electrons, mixing),
    moments=_moments,
    bound=_bound,
)
