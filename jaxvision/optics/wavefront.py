"""Aberrations of a lens: diffraction, defocus and Zernike terms combined in one pupil function.

With the wavefront error W, m, over points rho of the unit disc of the pupil, a point has the image

    |U(x)|^2,   U(x) = integral exp(2 pi i W(rho) / lambda - pi i x . rho / (lambda N)) d^2 rho

with x the position on the sensor in m, wavelength lambda and f-number N. W = 0 gives the Airy
pattern. For a large W, each point of the pupil sends its light to 2 N grad W, as in geometrical
optics.

Source:
    Born and Wolf, Principles of Optics, sections 9.1 to 9.3; Noll, "Zernike polynomials and
    atmospheric turbulence", J. Opt. Soc. Am. 66 (1976).
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, takes_range
from ..core._types import DIVISOR, Range, Scalar, Scalars, check_count, is_known

STOP = Range(0, float(np.nextafter(1, 0)), nan=True)  # diameter of a central stop
_MOST = 66  # number of terms of order up to 10


@takes_numbers
def zernike(x: Scalars, y: Scalars, *, count: int) -> Float[Array, "... count"]:
    """Return Noll's Zernike polynomials over the unit disc, each with mean square 1.

    The polynomials are piston, the tilts along x and y, defocus, astigmatism at 45 and at 0
    degrees, coma along y and x, trefoil along y and x, spherical aberration, and so on.

    Args:
        x: (...) in the unit disc, no unit.
        y: (...) in the unit disc, no unit.
        count: number of terms, at most 66, static.

    Returns:
        (..., count) no unit.

    Raises:
        ValueError: for another count.

    Example:
        >>> jv.optics.zernike(0.0, 1.0, count=4).round(3).tolist()  # the last: sqrt(3) (2 - 1)
        [1.0, 0.0, 2.0, 1.732]
    """
    check_count("count", count, 1)
    if count > _MOST:
        raise ValueError(f"count must be at most {_MOST}, got {count}.")
    square, terms = x * x + y * y, []
    powers = [(jnp.ones_like(square), jnp.zeros_like(square))]  # of x + i y
    for j in range(1, count + 1):
        n = (math.isqrt(8 * j - 7) - 1) // 2
        place = j - n * (n + 1) // 2 - 1
        m = 2 * ((place + 1) // 2) if n % 2 == 0 else 2 * (place // 2) + 1
        while len(powers) <= m:
            re, im = powers[-1]
            powers.append((re * x - im * y, re * y + im * x))
        radial = jnp.zeros_like(square)
        for k in range((n - m) // 2 + 1):  # Horner's scheme in the square of the radius
            over = math.factorial(k) * math.factorial((n + m) // 2 - k)
            over *= math.factorial((n - m) // 2 - k)
            radial = radial * square + (-1) ** k * math.factorial(n - k) / over
        scale = math.sqrt(n + 1 if m == 0 else 2 * (n + 1))
        terms.append(scale * radial * powers[m][0 if m == 0 else j % 2])
    return jnp.stack(terms, axis=-1)


@takes_numbers
@takes_range(
    wavelength=DIVISOR,
    f_number=DIVISOR,
    pixel_pitch=DIVISOR,
    obstruction=STOP,
)
def wavefront_kernel(
    coefficients: Float[Array, " terms"],
    wavelength: Scalars,
    f_number: Scalar,
    pixel_pitch: Scalar,
    *,
    size: int,
    obstruction: Scalar | None = None,
    order: int = 8,
    samples: int = 128,
) -> Float[Array, "..."]:
    """Return the share of a point's light that falls on each pixel around it, through a lens with
    aberrations.

    The pupil is integrated by Gauss-Legendre quadrature along its chords, which has no error at the
    rim. The kernel is rescaled to sum 1, which adds the light outside the window to its pixels.

    Args:
        coefficients: (terms,) m, of the terms 1, 2, ... of `zernike`; x of the pupil is to the
            right in the picture and y down. The RMS wavefront error is the root of the sum of the
            squares of all coefficients except the first. The coefficient c of term 2 moves the
            image by 4 N c to the right.
        wavelength: () or (bands,) m; (bands, lines) for bands of several equally strong lines.
        f_number: () working f-number N, no unit.
        pixel_pitch: () m.
        size: side of the kernel in pixels, odd, static.
        obstruction: () in [0, 1), diameter of a central stop over that of the pupil; None for none.
        order: nodes per side of a pixel, static, at least 8 / 3 pitch / (lambda N).
        samples: nodes along and across the pupil, static; without aberrations at least 24 + .43 pi
            size pitch / (lambda N).

    Returns:
        (size, size), or (size, size, bands); no unit, of sum 1.

    Raises:
        ValueError: `size` is even, `wavelength`, `f_number` or `pixel_pitch` is not above 0,
            `obstruction` is outside [0, 1), or `order` or `samples` are too few for arguments that
            are known.

    Example:
        Half a wave of defocus takes light from the middle.

        >>> lens = dict(wavelength=550e-9, f_number=8.0, pixel_pitch=2e-6, size=17)
        >>> sharp = jv.optics.wavefront_kernel([0.0, 0, 0, 0], **lens)
        >>> blurred = jv.optics.wavefront_kernel([0.0, 0, 0, 275e-9], **lens)
        >>> print(f"{sharp[8, 8]:.3f} {blurred[8, 8]:.3f}")
        0.156 0.006
    """
    check_count("size", size, 1, odd=True)
    check_count("order", order, 1)
    check_count("samples", samples, 1)
    dtype = coefficients.dtype
    t, along = np.polynomial.legendre.leggauss(samples)
    t, along = np.pi / 2 * t, np.pi / 2 * along * np.cos(np.pi / 2 * t) ** 2
    v, across = np.polynomial.legendre.leggauss(samples)
    # chords across x = sin t, from -cos t to cos t
    x, y = np.broadcast_to(np.sin(t)[:, None], (samples, samples)), np.cos(t)[:, None] * v
    weight = along[:, None] * across
    parts: list[tuple[Scalar | float, Array]] = [(1.0, _terms(x, y, 1.0, coefficients))]
    if obstruction is not None:
        parts.append((obstruction, _terms(x, y, obstruction, coefficients)))
    if all(is_known(z) for z in (parts[0][1], wavelength, f_number, pixel_pitch)):
        error = np.asarray(parts[0][1], float)
        _check_nodes(size, order, error, wavelength, f_number, pixel_pitch)
    nodes, share = np.polynomial.legendre.leggauss(order)
    places = jnp.asarray((np.arange(size)[:, None] - size // 2 + nodes / 2).ravel(), dtype)
    share = jnp.asarray(np.tile(share, size), dtype)

    def kernel_at(wavelength: Scalar) -> Float[Array, "size size"]:
        scale = jnp.pi * pixel_pitch / (wavelength * f_number)
        fields = []
        for radius, error in parts:
            amplitude = jnp.asarray(weight, dtype)
            pupil = _polar(amplitude, 2 * jnp.pi / wavelength * error)
            rows = jnp.asarray(y, dtype)[:, None, :] * (radius * scale * places)[None, :, None]
            inner = jnp.einsum("jk,jyk->jy", pupil, _polar(1.0, -rows))
            columns = jnp.asarray(np.sin(t), dtype)[:, None] * (radius * scale * places)[None, :]
            area = jnp.asarray(radius * radius, dtype)
            fields.append(jnp.einsum("jy,jx->yx", inner, _polar(area, -columns)))
        field = fields[0] if obstruction is None else fields[0] - fields[1]
        light = (field.real**2 + field.imag**2) * share[:, None] * share[None, :]
        kernel = light.reshape(size, order, size, order).sum((1, 3))
        return kernel / kernel.sum()

    if wavelength.ndim == 0:
        return kernel_at(wavelength)
    lines = wavelength.reshape(len(wavelength), -1)
    return jax.vmap(lambda band: jax.lax.map(kernel_at, band).mean(axis=0), out_axes=-1)(lines)


def _polar(radius: Array | float, phase: Array) -> Array:
    """Return complex numbers with this radius and phase in rad."""
    return jax.lax.complex(radius * jnp.cos(phase), radius * jnp.sin(phase))


def _terms(
    x: np.ndarray, y: np.ndarray, radius: Scalar | float, coefficients: Float[Array, " terms"]
) -> Float[Array, "samples samples"]:
    """Return the wavefront error W in m at positions of the pupil."""
    places = (radius * jnp.asarray(z, coefficients.dtype) for z in (x, y))
    return zernike(*places, count=len(coefficients)) @ coefficients


def _check_nodes(
    size: int,
    order: int,
    error: np.ndarray,
    wavelength: Scalars,
    f_number: Scalar,
    pixel_pitch: Scalar,
) -> None:
    """Raise `ValueError` for too few quadrature nodes. A rule of n nodes on [-1, 1] integrates a
    phase accurately if its slope is at most 2 n rad per unit in the middle, and 2 n / sqrt(1 - x^2)
    at x.
    """
    wide = float(np.max(pixel_pitch / (np.asarray(wavelength, float) * f_number)))
    if order < 8 / 3 * wide:
        raise ValueError(
            f"order = {order}: a pixel of {wide:.3g} lambda N needs at least "
            f"{math.ceil(8 / 3 * wide)} nodes."
        )
    samples = len(error)
    nodes = np.polynomial.legendre.leggauss(samples)[0]
    cosine = np.cos(np.pi / 2 * nodes)[:, None]
    own, of_image = 2 * np.pi / float(np.min(wavelength)), np.pi / 2 * size * wide
    steepest = 0.0
    for axis, chord in ((0, np.pi / 2 * cosine), (1, cosine)):
        slope = own * np.abs(np.gradient(error, nodes, axis=axis)) + of_image * chord
        near_ends = np.sqrt(1 - nodes**2)
        steepest = max(steepest, float((slope * (near_ends if axis else near_ends[:, None])).max()))
    least = math.ceil(0.55 * steepest) + 24
    if samples < least:
        raise ValueError(
            f"samples = {samples}: a kernel of {size} pixels and this wavefront need at least "
            f"{least}; a smaller kernel needs fewer."
        )
