"""Mechanical vignetting: a second aperture, the rim, in front of the lens blocks light.

With a rim at the distance l in front of an aperture of diameter d and a plane in focus at z_f, a
ray through the point a of the aperture crosses the plane of the rim at a (1 - l / z_f) + l t, with
t the slope of the chief ray. Seen from the pixel, the aperture is therefore a disc scaled by 1 - l
/ z_f that moves off the rim by l t: a cat's eye with an area in closed form (`overlap`).
"""

import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ..core._numerics import safe_sqrt
from ..core._types import Scalar
from ..scene import AnnularAperture, CircularAperture, ThinLens
from .aperture import aperture_area, aperture_corners
from .overlap import overlap_of_disc_and_polygon, overlap_of_discs
from .views import chief_slope, focus_vergence

# Smallest radius of the aperture relative to the rim; a smaller aperture acts as a point too.
_SMALLEST = 1e-4


@takes_numbers
def clear_fraction(view: ThinLens, row: Scalar, column: Scalar) -> Scalar:
    """Return the share of the aperture's area that is visible from a pixel through the rim.

    Args:
        view: the lens.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.

    Returns:
        () relative, in [0, 1]; 1 without a rim.

    Example:
        >>> lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(3, 3), f_number=2.0)
        >>> print(jv.optics.clear_fraction(lens, 1, 1))  # no rim, no vignetting
        1.0
    """
    if view.rim is None:
        return jnp.ones_like(view.f_number)
    x, y = chief_slope(view, row, column)
    right, down = -view.rim.distance * x, -view.rim.distance * y
    rim = view.rim.diameter / 2
    scale = 1 - view.rim.distance * focus_vergence(view)
    radius = view.focal_length / view.f_number / 2 * jnp.abs(scale)
    radius = jnp.maximum(radius, _SMALLEST * rim)
    match view.aperture:
        case CircularAperture():
            shared = overlap_of_discs(safe_sqrt(right * right + down * down), radius, rim)
        case AnnularAperture():
            distance = safe_sqrt(right * right + down * down)
            stop = radius * view.aperture.obstruction
            shared = overlap_of_discs(distance, radius, rim) - overlap_of_discs(distance, stop, rim)
        case _:
            corners = aperture_corners(view.aperture, radius.dtype)
            signed = jnp.where(scale < 0, -radius, radius)
            shared = overlap_of_disc_and_polygon(
                right, down, rim, signed * corners[0], signed * corners[1]
            )
    # If the rim hides the whole aperture, the sum of parts may round to just below zero.
    return jnp.where(shared <= 0, 0.0, shared) / aperture_area(view.aperture, 2 * radius)
