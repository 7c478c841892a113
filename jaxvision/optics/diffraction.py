"""Diffraction at a round aperture, which limits the sharpness of every image.

All lengths are in m on the sensor, and frequencies in cycles per m (m^-1). The f-number is the
working f-number, image distance over lens diameter (`working_f_number`), which equals that of the
lens for focus at infinity. Arguments are elementwise and broadcast: wavelengths (bands,) give a
result for each band.

Source:
    Born and Wolf, Principles of Optics, sections 8.5.2 and 9.5.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, takes_range, warn_caller
from ..core._numerics import divide
from ..core._types import AMOUNT, Colour, Image, Range, Scalar, Scalars, check_count, is_known
from ..filters import correlate
from ..scene import Diffraction, ThinLens, Wavefront
from ._bessel import jinc
from .overlap import overlap_of_discs
from .thin_lens import _reciprocal
from .views import sensor_vergence
from .wavefront import wavefront_kernel

# The first zero of J_1, divided by pi.
_FIRST_ZERO = 1.2196698912665045
# Range of the relative diameter of a central stop
_STOP = Range(0, float(np.nextafter(1, 0)), nan=True)
_WIDE = 3.0  # pixel size in lambda N; larger pixels are integrated along their edges


@takes_numbers
@takes_range(wavelength=AMOUNT, f_number=AMOUNT)
def airy_radius(wavelength: Scalars, f_number: Scalars) -> Scalars:
    """Return the radius of the first dark ring of the Airy pattern: 1.22 lambda N.

    Args:
        wavelength: (...) m.
        f_number: (...) working f-number, no unit.

    Returns:
        (...) m on the sensor.

    Raises:
        ValueError: for an argument below 0.

    Example:
        >>> micrometres = 1e6 * jv.optics.airy_radius(jnp.array(550e-9), jnp.array(8.0))
        >>> round(float(micrometres), 2)
        5.37
    """
    return _FIRST_ZERO * wavelength * f_number


@takes_numbers
@takes_range(wavelength=AMOUNT, f_number=AMOUNT)
def airy_pattern(radius: Scalars, wavelength: Scalars, f_number: Scalars) -> Scalars:
    """Return the irradiance of the Airy pattern, (2 J_1(x) / x)^2 with x = pi r / (lambda N).

    Multiply the pattern by pi / (2 lambda N)^2 to make its integral over the plane 1.

    Args:
        radius: (...) m from the middle.
        wavelength: (...) m.
        f_number: (...) working f-number, no unit.

    Returns:
        (...) relative to the middle.

    Raises:
        ValueError: for a wavelength or an f-number below 0.

    Example:
        >>> dark = jv.optics.airy_radius(550e-9, 4.0)  # m, of the first dark ring
        >>> at = (jv.optics.airy_pattern(radius, 550e-9, 4.0) for radius in (0.0, dark / 2, dark))
        >>> print([f"{x:.2f}" for x in at])
        ['1.00', '0.37', '0.00']
    """
    x = jnp.pi * radius / (wavelength * f_number)
    amplitude = jinc(x * x)
    return amplitude * amplitude


@takes_numbers
@takes_range(wavelength=AMOUNT, f_number=AMOUNT, pixel_pitch=AMOUNT)
def airy_kernel(
    wavelength: Scalar | Colour,
    f_number: Scalar,
    pixel_pitch: Scalar,
    *,
    size: int,
    order: int = 8,
) -> Float[Array, "..."]:
    """Return the share of a point's light that falls on each pixel around it.

    Pixels up to 3 lambda N use Gauss-Legendre quadrature of the pattern over each pixel. Larger
    pixels contain too many rings for the quadrature. For larger pixels, the light that leaves the
    pixel is integrated along its edges. By Gauss's theorem, with Rayleigh's encircled energy 1 -
    J_0(x)^2 - J_1(x)^2 in x = pi r / (lambda N), a pixel keeps

        [1 in the middle, else 0] - integral (J_0^2 + J_1^2) / (2 pi r^2) (r . n) ds

    with the edge's normal n. The integrand J_0^2 + J_1^2 hardly oscillates. The share of light
    beyond the distance R is about 2 lambda N / (pi^2 R). The kernel is rescaled to sum 1, which
    distributes the light outside the window over its pixels. At a wavelength or an f-number of 0,
    all light falls on the middle pixel.

    Args:
        wavelength: () or (bands,) m.
        f_number: () working f-number, no unit.
        pixel_pitch: () m.
        size: side of the kernel in pixels, odd, static.
        order: number of quadrature nodes per side of a pixel, static; the integral along an edge
            uses twice as many. With 8, a pixel's share is accurate to 2e-5 of all light, and to
            1e-7 for pixels up to 2 lambda N.

    Returns:
        (size, size), or (size, size, bands) for wavelengths (bands,); no unit, of sum 1.

    Raises:
        ValueError: `size` is even, `order` below 1, or another argument below 0.
    """
    check_count("size", size, 1, odd=True)
    check_count("order", order, 1)
    nodes, weights = np.polynomial.legendre.leggauss(order)
    places = np.arange(size)[:, None] - size // 2 + nodes / 2
    along = jnp.asarray(places.ravel(), pixel_pitch.dtype) * pixel_pitch
    share = jnp.asarray(np.tile(weights, size), pixel_pitch.dtype)
    point = jnp.zeros((size, size), pixel_pitch.dtype).at[size // 2, size // 2].set(1)

    def psf(wavelength: Scalar) -> Float[Array, "size size"]:
        unit = wavelength * f_number
        sharp = unit <= 0
        scale = divide(jnp.pi, unit, ~sharp)
        amplitude = jinc(scale * scale * (along[:, None] ** 2 + along[None, :] ** 2))
        light = amplitude * amplitude * share[:, None] * share[None, :]
        kernel = light.reshape(size, order, size, order).sum((1, 3))
        wide = ~sharp & (pixel_pitch > _WIDE * unit)
        kept = point - _leaving(divide(jnp.pi * pixel_pitch, unit, wide), size, 2 * order)
        kernel = jnp.where(wide, kept, kernel)
        return jnp.where(sharp, point, kernel / kernel.sum())

    return psf(wavelength) if wavelength.ndim == 0 else jax.vmap(psf, out_axes=-1)(wavelength)


def _leaving(scale: Scalar, size: int, order: int) -> Float[Array, "size size"]:
    """Return the integral of (J_0^2 + J_1^2) / (2 pi r^2) (r . n) along the edges of each pixel, no
    unit. `scale` is the argument x of the Bessel functions per pixel of distance.
    """
    nodes, weights = np.polynomial.legendre.leggauss(order)
    # Distances of the pixels' edges from the middle
    right = np.arange(size // 2 + 1)[:, None, None] + 0.5
    along = np.arange(size)[:, None] - size // 2 + nodes / 2
    distance = np.hypot(right, along)
    flux = jnp.asarray(right / (2 * np.pi * distance**2) * weights / 2, scale.dtype)
    rest = _outside(scale * jnp.asarray(distance, scale.dtype))
    through = (rest * flux).sum(axis=-1)
    # The light that crosses each edge to the right
    through = jnp.concatenate([-through[::-1], through])
    gained = jnp.diff(through, axis=0)
    return gained + gained.T


def _outside(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return J_0(x)^2 + J_1(x)^2, the share of light outside x, by Hankel's expansion. The
    expansion's relative error is 3e-6 for x >= 3 pi / 2. Source: DLMF 10.17.3.
    """
    far = jnp.maximum(x, 1)
    inverse = 1 / far
    wave = jnp.cos(far - np.pi / 4), jnp.sin(far - np.pi / 4)

    def expand_hankel(order: int) -> tuple[Array, Array]:
        """Return the slowly varying functions P and Q of Hankel's expansion for the Bessel function
        of this order.
        """
        term, sums = jnp.ones_like(far), [jnp.ones_like(far), jnp.zeros_like(far)]
        for k in range(1, 8):
            term = term * inverse * ((4 * order**2 - (2 * k - 1) ** 2) / (8 * k))
            sums[k % 2] = sums[k % 2] + (1, 1, -1, -1)[k % 4] * term
        return sums[0], sums[1]

    (p0, q0), (p1, q1) = expand_hankel(0), expand_hankel(1)
    j0, j1 = p0 * wave[0] - q0 * wave[1], p1 * wave[1] + q1 * wave[0]
    return 2 / np.pi * inverse * (j0 * j0 + j1 * j1)


@takes_numbers
def lens_kernel(
    view: ThinLens, diffraction: Diffraction | Wavefront, pixel_pitch: Scalar
) -> Float[Array, "..."]:
    """Return the share of a point's light that falls on each pixel around it, through a lens.

    Args:
        view: the lens, whose working f-number is used.
        diffraction: wavelengths and size of the kernel, and aberrations.
        pixel_pitch: () m; a fraction of the pitch of `view` if a sensor's aperture is oversampled.

    Returns:
        (size, size), or (size, size, bands); no unit, of sum 1.

    Example:
        >>> lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(9, 9), f_number=8.0)
        >>> kernel = jv.optics.lens_kernel(lens, jv.Diffraction(550e-9, size=3), 1e-5)
        >>> round(float(kernel[1, 1]), 2)
        0.89
    """
    # a closed aperture transmits no light
    f_number = jnp.where(jnp.isinf(view.f_number), 1, view.f_number)
    working = f_number * _reciprocal(sensor_vergence(view) * view.focal_length)
    size, wavelength = diffraction.size, diffraction.wavelength
    if isinstance(diffraction, Diffraction):
        _warn_of_a_small_window(wavelength, working, pixel_pitch, size)
        return airy_kernel(wavelength, working, pixel_pitch, size=size)
    return wavefront_kernel(
        diffraction.coefficients,
        wavelength,
        working,
        pixel_pitch,
        size=size,
        aperture=view.aperture,
        order=diffraction.order,
        samples=diffraction.samples,
    )


def _warn_of_a_small_window(
    wavelength: Scalar | Colour, f_number: Scalar, pixel_pitch: Scalar, size: int
) -> None:
    """Warn about a kernel that ends within the first dark ring, if the numbers are known."""
    if not all(map(is_known, (wavelength, f_number, pixel_pitch))):
        return
    waves, numbers, pitches = map(np.asarray, (wavelength, f_number, pixel_pitch))
    ring = _FIRST_ZERO * float(waves.max() * numbers.max() / pitches.min())
    if size / 2 < ring < np.inf:
        warn_caller(
            f"Diffraction: a kernel of {size} pixels ends within the first dark ring, whose radius "
            f"is {ring:.3g} pixels, and keeps the picture too sharp; give size = "
            f"{2 * int(np.ceil(2 * ring)) + 1} or more."
        )


@takes_numbers
def diffracted(view: ThinLens, diffraction: Diffraction | Wavefront, irradiance: Image) -> Image:
    """Compute the irradiance on the sensor after diffraction at the aperture.

    The picture is convolved with the `airy_kernel` of the working f-number, or with the
    `wavefront_kernel` of a lens with aberrations. Border pixels are repeated outside, so a flat
    picture stays flat.

    Args:
        view: the lens.
        diffraction: wavelengths and size of the kernel, and aberrations.
        irradiance: (..., h, w, bands) W m^-2.

    Returns:
        (..., h, w, bands) W m^-2.
    """
    kernel = lens_kernel(view, diffraction, view.pixel_pitch)
    if isinstance(diffraction, Wavefront):
        kernel = kernel[::-1, ::-1]  # an Airy pattern is symmetric and needs no flip
    # rounding in a transform may leave negative light
    return jnp.maximum(correlate(irradiance, kernel, border="clamp"), 0)


@takes_numbers
@takes_range(wavelength=AMOUNT, f_number=AMOUNT, obstruction=_STOP)
def diffraction_mtf(
    frequency: Scalars,
    wavelength: Scalars,
    f_number: Scalars,
    *,
    obstruction: Scalars | None = None,
) -> Scalars:
    """Return the contrast of a sine pattern after diffraction, which is 0 at and above the cut-off
    frequency 1 / (lambda N).

    The contrast is the overlap of the pupil with a copy of itself, shifted by 2 lambda N
    `frequency` pupil radii. For a full disc the contrast is (2 / pi) (arccos v - v sqrt(1 - v^2)),
    with v the ratio of the frequency to the cut-off.

    Args:
        frequency: (...) m^-1.
        wavelength: (...) m.
        f_number: (...) working f-number, no unit.
        obstruction: (...) in [0, 1), diameter of a central round stop over that of the aperture;
            None for no stop.

    Returns:
        (...) relative contrast, in [0, 1].

    Raises:
        ValueError: for a wavelength or an f-number below 0, or an obstruction outside [0, 1).

    Example:
        >>> half = jnp.array(0.5 / (550e-9 * 8.0))  # half of the cut-off
        >>> round(float(jv.optics.diffraction_mtf(half, jnp.array(550e-9), jnp.array(8.0))), 4)
        0.391
    """
    shift = 2 * jnp.abs(frequency * wavelength * f_number)
    outer = jnp.ones_like(shift)
    shared = overlap_of_discs(shift, outer, outer)
    if obstruction is None:
        return shared / jnp.pi
    inner = obstruction * outer
    with_stop = 2 * overlap_of_discs(shift, outer, inner) - overlap_of_discs(shift, inner, inner)
    return (shared - with_stop) / (jnp.pi * (1 - obstruction * obstruction))
