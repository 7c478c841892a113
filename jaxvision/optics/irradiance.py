"""Conversion of radiance in front of the lens to irradiance on the sensor.

    E = L A cos^4 / z_i^2,   with a round aperture   E = L (pi / 4) (d / z_i)^2 cos^4

E is the irradiance, L the radiance, A the area of the aperture, d its diameter, z_i the distance to
the sensor (equal to the focal length only for focus at infinity) and cos the cosine between the
chief ray and the axis. The factor cos^4 is due to the distance z_i / cos of the small aperture, and
to the inclination of both aperture and sensor to the ray. Only this module applies the factor; rays
have no such weight.

Source:
    Szeliski, Computer Vision, section 2.2.3.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..core._arguments import takes_numbers, warn_caller
from ..core._numerics import divide, smallest_divisor
from ..core._types import Colour, Image, Scalar, as_float, is_known
from ..scene import Orthographic, ThinLens, View
from .aperture import aperture_area
from .diffraction import diffracted
from .distortion import distortion_area
from .views import chief_slope, pixel_grid, sensor_vergence
from .vignetting import clear_fraction

WIDEST = 0.5  # f-number at which a lens in air gathers light from a whole hemisphere


@takes_numbers
def pixel_irradiance(view: View, radiance: Colour, row: Scalar, column: Scalar) -> Colour:
    """Compute the irradiance on the sensor at one pixel.

    A rim vignettes (`clear_fraction`). If distortion enlarges the image locally, the irradiance is
    divided by the ratio of areas. A view without an f-number returns the radiance unchanged,
    without falloff.

    Args:
        view: the camera's projection.
        radiance: (bands,) W m^-2 sr^-1 seen by the pixel.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.

    Returns:
        (bands,) W m^-2.

    Example:
        >>> view = jv.Pinhole(np.zeros(3), np.eye(3), 0.05, 1e-5, resolution=(1, 1), f_number=8.0)
        >>> zero = jnp.array(0.0)
        >>> E = jv.optics.pixel_irradiance(view, jnp.array([1.0]), zero, zero)
        >>> round(float(E[0]), 6)  # pi / (4 8^2)
        0.012272
    """
    if isinstance(view, ThinLens):
        area = aperture_area(view.aperture, view.focal_length / view.f_number)
        opening = area * sensor_vergence(view) ** 2
    elif view.f_number is None:
        return radiance
    else:
        opening = jnp.pi / (4 * view.f_number**2)
    if isinstance(view, Orthographic):
        return radiance * opening
    x, y = chief_slope(view, row, column)
    cos_squared = 1 / (1 + x * x + y * y)
    light = opening * cos_squared * cos_squared
    if isinstance(view, ThinLens) and view.rim is not None:
        light = light * clear_fraction(view, row, column)
    if view.distortion is not None:
        spread = distortion_area(view.distortion, x, y)
        light = divide(light, spread, ~(spread <= smallest_divisor(spread.dtype)))
    return radiance * light


@takes_numbers
def sensor_irradiance(view: View, radiance: Image) -> Image:
    """Compute the irradiance on the sensor for a whole picture, with diffraction at a thin lens.

    Args:
        view: the camera's projection.
        radiance: (h, w, bands) W m^-2 sr^-1, of the view's resolution.

    Returns:
        (h, w, bands) W m^-2; the radiance unchanged for a view without an f-number.

    Raises:
        ValueError: `radiance` has another resolution than the view.

    Example:
        A pixel at 45 degrees gets cos^4 = 1 / 4 of the irradiance in the middle.

        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 0.05, resolution=(1, 3), f_number=2.0)
        >>> light = jv.sensor_irradiance(view, jnp.full((1, 3, 1), 16 / np.pi))
        >>> [round(float(x), 4) for x in light.ravel()]
        [0.25, 1.0, 0.25]
    """
    radiance = as_float(radiance)
    if radiance.shape[:-1] != view.resolution:
        raise ValueError(
            f"radiance must be {view.resolution} and bands, as the view's resolution, got shape "
            f"{radiance.shape}."
        )
    known = view.f_number is not None and is_known(view.f_number)
    f_number = float(np.min(np.asarray(view.f_number))) if known else np.inf
    if 0 < f_number < WIDEST:
        warn_caller(
            f"sensor_irradiance: a lens in air is at most f/{WIDEST:g}, where it gathers light of "
            f"a whole hemisphere; at f/{f_number:g} the sensor may get more than pi "
            "times the radiance."
        )
    over_columns = jax.vmap(pixel_irradiance, in_axes=(None, 0, None, 0))
    over_rows = jax.vmap(over_columns, in_axes=(None, 0, 0, None))
    irradiance = over_rows(view, radiance, *pixel_grid(view))
    if isinstance(view, ThinLens) and view.diffraction is not None:
        irradiance = diffracted(view, view.diffraction, irradiance)
    return irradiance
