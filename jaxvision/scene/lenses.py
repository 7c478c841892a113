"""Apertures, vignetting, diffraction and distortion of a lens."""

import equinox as eqx
from jaxtyping import Array, Float

from .._shown import Shown
from .._types import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    Colour,
    Range,
    Scalar,
    as_float,
    as_optional_float,
    check_count,
    check_fields,
)

# A thinner ring, relative to its radius, is closed.
_WIDEST_STOP = 1 - 1e-6


class CircularAperture(Shown):
    """A round aperture that fills the lens's diameter."""


class PolygonalAperture(Shown):
    """The aperture of an iris: a regular polygon with corners on the lens's diameter.

    Attributes:
        blades: number of sides, >= 3; static.
        angle: () rad, of one corner from the camera's right towards down; None is 0, to the right.
    """

    blades: int = eqx.field(static=True)
    angle: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_count("PolygonalAperture.blades", self.blades, 3)
        check_fields(self, angle=FINITE)


class RectangularAperture(Shown):
    """A slit or square along the camera's right and down axes.

    Attributes:
        width: () > 0, relative to the lens's diameter.
        height: () > 0, relative to the lens's diameter.
    """

    width: Scalar = eqx.field(converter=as_float)
    height: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, width=POSITIVE, height=POSITIVE)


class AnnularAperture(Shown):
    """A round aperture with a central round stop, as in a mirror lens.

    Attributes:
        obstruction: () in [0, 1), diameter of the stop relative to that of the aperture.
    """

    obstruction: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, obstruction=Range(0, _WIDEST_STOP))


Aperture = CircularAperture | PolygonalAperture | RectangularAperture | AnnularAperture


class Rim(Shown):
    """A round edge in front of the aperture, of the front element, that cuts off oblique light.

    Attributes:
        distance: () m in front of the aperture, >= 0.
        diameter: () m, > 0.
    """

    distance: Scalar = eqx.field(converter=as_float)
    diameter: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, distance=NOT_NEGATIVE, diameter=POSITIVE)


class Diffraction(Shown):
    """Diffraction at a round aperture, which spreads each point into an Airy pattern.

    Attributes:
        wavelength: () or (bands,) m, > 0.
        size: side in pixels of the kernel, odd (in samples where a sensor's aperture is
            oversampled); static. The light outside it is put back into it: `optics.airy_kernel`
            says how much that is.
    """

    wavelength: Scalar | Colour = eqx.field(converter=as_float)
    size: int = eqx.field(static=True, default=33, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, wavelength=POSITIVE)
        check_count("Diffraction.size", self.size, 1, odd=True)


class Distortion(Shown):
    """Polynomial distortion: where the lens images a ray that an ideal lens images at (x, y).

        r^2 = x^2 + y^2,   s = 1 + k_1 r^2 + k_2 r^4 + ...
        (x s + 2 p_1 x y + p_2 (r^2 + 2 x^2),   y s + p_1 (r^2 + 2 y^2) + 2 p_2 x y)

    Attributes:
        radial: (terms,) k_1, k_2, ..., no unit; k_1 < 0 is a barrel, k_1 > 0 a pincushion.
        tangential: (2,) p_1, p_2 of a decentred lens, no unit, or None.

    Source:
        Brown, "Close-Range Camera Calibration", Photogrammetric Engineering 37 (1971), with the
        signs of OpenCV.
    """

    radial: Float[Array, " terms"] = eqx.field(converter=as_float)
    tangential: Float[Array, "2"] | None = eqx.field(converter=as_optional_float, default=None)

    def __check_init__(self) -> None:
        check_fields(self, radial=FINITE, tangential=FINITE)
