"""The records of a lens's aperture, vignetting, diffraction and distortion."""

import equinox as eqx
from jaxtyping import Array, Float

from ..core._shown import Shown
from ..core._types import (
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
    print_by_name,
)

# Largest obstruction; above it, the ring is so thin that the aperture counts as closed.
_WIDEST_STOP = 1 - 1e-6


class CircularAperture(Shown):
    """A round aperture with the diameter of the lens.

    Example:
        >>> round(float(jv.optics.aperture_area(jv.CircularAperture(), jnp.array(2.0))), 4)
        3.1416
    """


class PolygonalAperture(Shown):
    """The aperture of an iris: a regular polygon whose corners lie on the rim of the lens.

    Attributes:
        blades: number of sides, >= 3; static.
        angle: () rad, from the camera's right axis towards down to one corner; None for 0.

    Example:
        >>> square = jv.PolygonalAperture(blades=4)  # its diagonal is the diameter
        >>> round(float(jv.optics.aperture_area(square, jnp.array(2.0))), 4)
        2.0
    """

    blades: int = eqx.field(static=True)
    angle: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_count("PolygonalAperture.blades", self.blades, 3)
        check_fields(self, angle=FINITE)


class RectangularAperture(Shown):
    """A rectangular aperture with sides along the camera's right and down axes.

    Attributes:
        width: () > 0, relative to the lens's diameter.
        height: () > 0, relative to the lens's diameter.

    Example:
        >>> slit = jv.RectangularAperture(width=0.5, height=1.0)
        >>> round(float(jv.optics.aperture_area(slit, jnp.array(2.0))), 4)
        2.0
    """

    width: Scalar = eqx.field(converter=as_float)
    height: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, width=POSITIVE, height=POSITIVE)


class AnnularAperture(Shown):
    """A round aperture with a round stop in the middle, as in a mirror lens.

    Attributes:
        obstruction: () in [0, 1), diameter of the stop relative to that of the aperture.

    Example:
        >>> mirror_lens = jv.AnnularAperture(obstruction=0.5)
        >>> round(float(jv.optics.aperture_area(mirror_lens, jnp.array(2.0))), 4)  # pi (1 - 0.5^2)
        2.3562
    """

    obstruction: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, obstruction=Range(0, _WIDEST_STOP))


Aperture = CircularAperture | PolygonalAperture | RectangularAperture | AnnularAperture
print_by_name(globals(), "Aperture")


class Rim(Shown):
    """A round rim in front of the aperture, such as the edge of the front element, that blocks
    oblique light.

    Attributes:
        distance: () m in front of the aperture, >= 0.
        diameter: () m, > 0.

    Example:
        Seen from this pixel, the rim is displaced by its radius, and the two discs overlap by
        (2 pi / 3 - sqrt(3) / 2) / pi of their area.

        >>> lens = dict(rotation=np.eye(3), focal_length=0.05, pixel_pitch=1e-5, resolution=(1, 1))
        >>> view = jv.ThinLens([0, 0, 0], **lens, f_number=2.0, rim=jv.Rim(0.025, 0.025))
        >>> round(float(jv.optics.clear_fraction(view, jnp.array(0.0), jnp.array(2500.0))), 3)
        0.391
    """

    distance: Scalar = eqx.field(converter=as_float)
    diameter: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, distance=NOT_NEGATIVE, diameter=POSITIVE)


class Diffraction(Shown):
    """Diffraction at a round aperture, which spreads each point into an Airy pattern.

    Attributes:
        wavelength: () or (bands,) m, > 0.
        size: side of the kernel in pixels, odd (in samples if the pixel aperture is oversampled);
            static. Light outside the kernel is added to its pixels; `optics.airy_kernel` states the
            amount.

    Example:
        A star spreads over its neighbours, and no light is lost.

        >>> lens = dict(rotation=np.eye(3), focal_length=0.05, pixel_pitch=1e-5, resolution=(5, 5))
        >>> airy = jv.Diffraction(550e-9, size=3)
        >>> view = jv.ThinLens([0, 0, 0], **lens, f_number=8.0, diffraction=airy)
        >>> star = jnp.zeros((5, 5, 1)).at[2, 2].set(4 * 8**2 / np.pi)
        >>> light = jax.jit(jv.sensor_irradiance)(view, star)
        >>> bool(light[2, 2, 0] < 0.9), round(float(light.sum()), 3)
        (True, 1.0)
    """

    wavelength: Scalar | Colour = eqx.field(converter=as_float)
    size: int = eqx.field(static=True, default=33, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, wavelength=POSITIVE)
        check_count("Diffraction.size", self.size, 1, odd=True)


class Wavefront(Shown):
    """Aberrations of a lens, and diffraction at its aperture, which may have any shape. Both are
    constant over the picture. If all coefficients are 0 and the aperture is round, the result
    equals `Diffraction`. Large coefficients give the spot of geometrical optics.

    Attributes:
        coefficients: (terms,) m, of Noll's Zernike terms 1, 2, ...; `optics.zernike` names them.
        wavelength: () or (bands,) m, > 0; (bands, lines) for bands of several equal lines.
        size: side of the kernel in pixels, odd; static. Light outside the kernel is added to its
            pixels.
        order: nodes per side of a pixel; static.
        samples: nodes along and across the pupil; static. `optics.wavefront_kernel` says how many
            are needed.

    Example:
        A fifth of a wave of defocus (rms) leaves less light in the middle of a star.

        >>> lens = dict(rotation=np.eye(3), focal_length=0.05, pixel_pitch=1e-5, resolution=(9, 9))
        >>> star = jnp.zeros((9, 9, 1)).at[4, 4].set(4 * 8**2 / np.pi)
        >>> def middle(defocus):
        ...     error = jv.Wavefront([0.0, 0.0, 0.0, defocus], 550e-9, size=9)
        ...     view = jv.ThinLens([0, 0, 0], **lens, f_number=8.0, diffraction=error)
        ...     return float(jv.sensor_irradiance(view, star)[4, 4, 0])
        >>> print(f"{middle(0.0):.2f} {middle(110e-9):.2f}")
        0.86 0.34
    """

    coefficients: Float[Array, " terms"] = eqx.field(converter=as_float)
    wavelength: Scalar | Colour | Float[Array, "bands lines"] = eqx.field(converter=as_float)
    size: int = eqx.field(static=True, default=33, kw_only=True)
    order: int = eqx.field(static=True, default=8, kw_only=True)
    samples: int = eqx.field(static=True, default=128, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, coefficients=FINITE, wavelength=POSITIVE)
        check_count("Wavefront.size", self.size, 1, odd=True)
        check_count("Wavefront.order", self.order, 1)
        check_count("Wavefront.samples", self.samples, 1)


class Distortion(Shown):
    """Polynomial distortion of a lens. A ray that an ideal lens images at (x, y) is imaged at

        r^2 = x^2 + y^2,   s = 1 + k_1 r^2 + k_2 r^4 + ...
        (x s + 2 p_1 x y + p_2 (r^2 + 2 x^2),   y s + p_1 (r^2 + 2 y^2) + 2 p_2 x y)

    The image is shifted if the middle of the sensor is not on the optical axis, and stretched if
    pixels are not square. `optics.opencv_view` makes such views from a camera matrix.

    Attributes:
        radial: (terms,) k_1, k_2, ..., no unit; k_1 < 0 is a barrel, k_1 > 0 a pincushion.
        tangential: (2,) p_1, p_2 for a decentred lens, no unit, or None.
        shift: (2,) displacement of the optical axis from the middle of the picture, right and down,
            divided by the image distance, no unit, or None.
        stretch: () factor by which the image is stretched downwards, > 0, no unit: fy / fx; None
            for 1.

    Source:
        Brown, "Close-Range Camera Calibration", Photogrammetric Engineering 37 (1971), with the
        signs of OpenCV.

    Example:
        >>> pincushion = jv.Distortion([0.1])
        >>> x, y = jv.optics.distort(pincushion, jnp.array(0.5), jnp.array(0.0))
        >>> round(float(x), 4)  # 0.5 (1 + 0.1 x 0.5^2)
        0.5125
    """

    radial: Float[Array, " terms"] = eqx.field(converter=as_float)
    tangential: Float[Array, "2"] | None = eqx.field(converter=as_optional_float, default=None)
    shift: Float[Array, "2"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    stretch: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, radial=FINITE, tangential=FINITE, shift=FINITE, stretch=POSITIVE)
