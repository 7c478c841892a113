"""Aberrations of a lens: diffraction, defocus and Zernike terms combined in one pupil function.

With the wavefront error W, m, over points rho of the unit disc of the pupil, a point has the image

    |U(x)|^2,   U(x) = integral exp(2 pi i W(rho) / lambda - pi i x . rho / (lambda N)) d^2 rho

with x the position on the sensor in m, wavelength lambda and f-number N. If the aperture has
another shape, the integral extends over its points, relative to the radius of the lens. W = 0 gives
the Airy pattern of a round aperture. For a large W, light from each point of the pupil reaches the
sensor at 2 N grad W, as in geometrical optics.

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
from ..core._numerics import divide, safe_sqrt
from ..core._types import DIVISOR, Scalar, Scalars, check_count, is_known
from ..core.parallel_loops import map_
from ..scene import (
    AnnularAperture,
    Aperture,
    CircularAperture,
    PolygonalAperture,
    RectangularAperture,
)
from .aperture import aperture_area, aperture_corners

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
)
def wavefront_kernel(
    coefficients: Float[Array, " terms"],
    wavelength: Scalars,
    f_number: Scalar,
    pixel_pitch: Scalar,
    *,
    size: int,
    aperture: Aperture | None = None,
    order: int = 8,
    samples: int = 128,
) -> Float[Array, "..."]:
    """Return the share of a point's light that falls on each pixel around it, through a lens with
    aberrations.

    The pupil is integrated by Gauss-Legendre quadrature along its chords, which has no error at the
    rim, and between the corners of a polygon. The kernel is rescaled to sum 1, which adds the light
    outside the window to its pixels.

    Args:
        coefficients: (terms,) m, of the terms 1, 2, ... of `zernike`; x of the pupil is to the
            right in the picture and y down. The RMS wavefront error over a round aperture is the
            root of the sum of the squares of all coefficients except the first. The coefficient c
            of term 2 moves the image by 4 N c to the right.
        wavelength: () or (bands,) m; (bands, lines) for bands of several equally strong lines.
        f_number: () working f-number N, no unit.
        pixel_pitch: () m.
        size: side of the kernel in pixels, odd, static.
        aperture: shape of the pupil; None for a disc.
        order: nodes per side of a pixel, static, at least 8 / 3 pitch / (lambda N).
        samples: nodes along and across the pupil (between two corners of a polygon), static;
            without aberrations at least 24 + .43 pi size pitch / (lambda N) for a disc.

    Returns:
        (size, size), or (size, size, bands); no unit, of sum 1.

    Raises:
        ValueError: `size` is even, `wavelength`, `f_number` or `pixel_pitch` is not above 0, or
            `order` or `samples` are too few for arguments that are known.

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
    x, y, weight = _chords(CircularAperture() if aperture is None else aperture, samples, dtype)
    error = zernike(x[..., None], y, count=len(coefficients)) @ coefficients
    if all(is_known(z) for z in (error, x, wavelength, f_number, pixel_pitch)):
        parts = np.asarray(x, float), np.asarray(y, float), np.asarray(error, float)
        _check_nodes(size, order, *parts, wavelength, f_number, pixel_pitch)
    nodes, share = np.polynomial.legendre.leggauss(order)
    places = jnp.asarray((np.arange(size)[:, None] - size // 2 + nodes / 2).ravel(), dtype)
    share = jnp.asarray(np.tile(share, size), dtype)

    def kernel_at(wavelength: Scalar) -> Float[Array, "size size"]:
        scale = jnp.pi * pixel_pitch / (wavelength * f_number)
        fields = []
        for part in range(len(x)):
            pupil = _polar(weight[part], 2 * jnp.pi / wavelength * error[part])
            rows = y[part][:, None, :] * (scale * places)[None, :, None]
            inner = jnp.einsum("jk,jyk->jy", pupil, _polar(1.0, -rows))
            columns = x[part][:, None] * (scale * places)[None, :]
            fields.append(jnp.einsum("jy,jx->yx", inner, _polar(1.0, -columns)))
        field = sum(fields[1:], fields[0])
        light = (field.real**2 + field.imag**2) * share[:, None] * share[None, :]
        kernel = light.reshape(size, order, size, order).sum((1, 3))
        return kernel / kernel.sum()

    if wavelength.ndim == 0:
        return kernel_at(wavelength)
    lines = wavelength.reshape(len(wavelength), -1)
    return jax.vmap(lambda band: map_(kernel_at, band).mean(axis=0), out_axes=-1)(lines)


@takes_numbers
@takes_range(wavelength=DIVISOR, f_number=DIVISOR)
def wavefront_otf(
    frequency: Float[Array, "... 2"],
    coefficients: Float[Array, " terms"],
    wavelength: Scalar,
    f_number: Scalar,
    *,
    aperture: Aperture | None = None,
    samples: int = 32,
) -> Float[Array, "... 2"]:
    """Return the transfer function of a lens with aberrations: the integral of exp(-2 pi i f . x)
    times the normalised image of a point, with x right and down.

    The transfer at a frequency f is the overlap of the pupil function with a copy of itself,
    shifted by 2 lambda N f pupil radii (Goodman, Introduction to Fourier Optics, section 6.4).
    Reversing the signs of all even aberrations does not change the transfer.

    Args:
        frequency: (..., 2) m^-1, right and down on the sensor.
        coefficients: (terms,) m, as in `wavefront_kernel`.
        wavelength: () m.
        f_number: () working f-number, no unit.
        aperture: shape of the pupil, convex; None for a disc.
        samples: nodes along and across the overlap, static. With 32, the error for wavefront errors
            up to a quarter of a wave (rms) is at most 1e-4.

    Returns:
        (..., 2) real and imaginary part, no unit; (1, 0) at frequency 0, and 0 from the cut-off
        1 / (lambda N) on.

    Raises:
        ValueError: for an annular aperture, or a `wavelength` or `f_number` that is not above 0.

    Example:
        Half of the cut-off: .391 for a perfect lens, less with 70 nm (rms) of coma.

        >>> lens = dict(wavelength=550e-9, f_number=8.0)
        >>> half = jnp.array([0.5 / (550e-9 * 8.0), 0.0])  # m^-1
        >>> sharp = jv.optics.wavefront_otf(half, jnp.zeros(8), **lens)
        >>> blurred = jv.optics.wavefront_otf(half, jnp.zeros(8).at[7].set(70e-9), **lens)
        >>> print(f"{jnp.linalg.norm(sharp):.3f} {jnp.linalg.norm(blurred):.3f}")
        0.391 0.125
    """
    check_count("samples", samples, 1)
    aperture = CircularAperture() if aperture is None else aperture
    if isinstance(aperture, AnnularAperture):
        raise ValueError("wavefront_otf takes a convex aperture, got AnnularAperture.")
    dtype = coefficients.dtype

    def at(frequency: Float[Array, "2"]) -> Float[Array, "2"]:
        size = safe_sqrt(frequency @ frequency)
        still = size <= 0
        along = jnp.where(still, jnp.asarray([1.0, 0.0], dtype), divide(frequency, size, ~still))
        shift = wavelength * f_number * size  # half of the shift to each side
        u, v, weight = _overlap(aperture, along, shift, samples)

        def error(u: Array) -> Array:
            x, y = u * along[0] - v * along[1], u * along[1] + v * along[0]
            return zernike(x, y, count=len(coefficients)) @ coefficients

        phase = 2 * jnp.pi / wavelength * (error(u - shift) - error(u + shift))
        parts = jnp.stack([(weight * jnp.cos(phase)).sum(), (weight * jnp.sin(phase)).sum()])
        return parts / aperture_area(aperture, jnp.asarray(2.0, dtype))

    flat = frequency.reshape(-1, 2)
    return jax.vmap(at)(flat).reshape(frequency.shape)


def _overlap(
    aperture: CircularAperture | PolygonalAperture | RectangularAperture,
    along: Float[Array, "2"],
    shift: Scalar,
    samples: int,
) -> tuple[Array, Array, Array]:
    """Return nodes, u along a direction and v across it, and weights of a quadrature over part of a
    convex aperture: the points that stay inside it if they are shifted to either side along u."""
    nodes, weights = (jnp.asarray(x, along.dtype) for x in np.polynomial.legendre.leggauss(samples))
    if isinstance(aperture, CircularAperture):
        turn = jnp.pi / 2 * nodes[:, None]
        height = safe_sqrt((1 - shift) * (1 + shift))
        v = height * jnp.sin(turn)
        half = jnp.maximum(safe_sqrt((1 - v) * (1 + v)) - shift, 0)
        share = weights[:, None] * weights[None, :]
        weight = jnp.pi / 2 * height * jnp.cos(turn) * half * share
        return half * nodes[None, :], jnp.broadcast_to(v, weight.shape), weight
    right, down = aperture_corners(aperture, along.dtype)
    turned = jnp.stack(
        [along[1] * right - along[0] * down, along[0] * right + along[1] * down]
    )  # coordinates (-v, u), which keep the order of the corners
    ends = jnp.sort(turned[0])

    def free(x: Scalar) -> tuple[Scalar, Scalar]:
        low, high = _ends_of_chord(turned, x)
        return low + shift, high - shift

    def part(start: Scalar, end: Scalar) -> tuple[Array, Array, Array]:
        middle = (start + end) / 2  # the free length is linear between two corners
        inside = start + (end - start) / 4
        # Difference between the ends of the part
        slope = 4 * (_length(free(middle)) - _length(free(inside)))
        first = _length(free(middle)) - slope / 2
        root = jnp.clip(divide(-first, slope, slope != 0), 0, 1)
        begin = jnp.where(first < 0, root, 0)
        stop = jnp.where(first + slope < 0, root, 1)
        stop = jnp.where((first < 0) & (first + slope < 0), begin, stop)
        share = (stop + begin) / 2 + (stop - begin) / 2 * nodes
        x = start + share * (end - start)
        low, high = jax.vmap(free)(x)
        half = jnp.maximum(high - low, 0) / 2
        weight = (stop - begin) / 2 * (end - start) * weights * half
        u = ((high + low) / 2)[:, None] + half[:, None] * nodes[None, :]
        return u, jnp.broadcast_to(-x[:, None], u.shape), weight[:, None] * weights[None, :]

    return jax.vmap(part)(ends[:-1], ends[1:])


def _length(ends: tuple[Scalar, Scalar]) -> Scalar:
    return ends[1] - ends[0]


def _polar(radius: Array | float, phase: Array) -> Array:
    """Return complex numbers with this radius and phase in rad."""
    return jax.lax.complex(radius * jnp.cos(phase), radius * jnp.sin(phase))


def _chords(
    aperture: Aperture, samples: int, dtype: np.dtype
) -> tuple[
    Float[Array, "parts samples"],
    Float[Array, "parts samples samples"],
    Float[Array, "parts samples samples"],
]:
    """Return nodes x of a quadrature over the aperture, nodes y on the chord through each x, and
    their weights. A stop is a part with negative weights."""
    nodes, weights = np.polynomial.legendre.leggauss(samples)
    if isinstance(aperture, CircularAperture | AnnularAperture):
        # chords across x = sin t, from -cos t to cos t
        t = np.pi / 2 * nodes
        half = np.cos(t)[:, None]
        x, y = np.sin(t)[None], (half * nodes)[None]
        weight = (np.pi / 2 * half * half * weights[:, None] * weights)[None]
        x, y, weight = (jnp.asarray(z, dtype) for z in (x, y, weight))
        if isinstance(aperture, CircularAperture):
            return x, y, weight
        stop = aperture.obstruction
        x, y = (jnp.concatenate([z, stop * z]) for z in (x, y))
        return x, y, jnp.concatenate([weight, -stop * stop * weight])
    nodes, weights = (jnp.asarray(z, dtype) for z in (nodes, weights))
    corners = jnp.stack(aperture_corners(aperture, dtype))
    if isinstance(aperture, RectangularAperture):
        ends = jnp.stack([-aperture.width, aperture.width]).astype(dtype)
    else:
        ends = jnp.sort(corners[0])

    def chord(x: Scalar) -> tuple[Array, Array]:
        low, high = _ends_of_chord(corners, x)
        return (high + low) / 2 + (high - low) / 2 * nodes, (high - low) / 2 * weights

    def part(start: Scalar, end: Scalar) -> tuple[Array, Array, Array]:
        x = (end + start) / 2 + (end - start) / 2 * nodes
        y, along = jax.vmap(chord)(x)
        return x, y, ((end - start) / 2 * weights)[:, None] * along

    return jax.vmap(part)(ends[:-1], ends[1:])


def _ends_of_chord(corners: Float[Array, "2 corners"], x: Scalar) -> tuple[Scalar, Scalar]:
    """Return the smallest and the largest y at x in a convex polygon that contains 0. A side with
    the outward normal n is at n . (x, y) = d."""
    (x0, y0), (x1, y1) = corners, jnp.roll(corners, -1, axis=1)
    across, along = y1 - y0, x0 - x1
    upright = jnp.abs(along) <= 1e-6 * jnp.abs(across)
    crossing = (across * (x0 - x) + along * y0) / jnp.where(upright, 1, along)
    low = jnp.where(~upright & (along < 0), crossing, -jnp.inf)
    high = jnp.where(~upright & (along > 0), crossing, jnp.inf)
    return low.max(), high.min()


def _check_nodes(
    size: int,
    order: int,
    x: np.ndarray,
    y: np.ndarray,
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
    samples = x.shape[-1]
    nodes = np.polynomial.legendre.leggauss(samples)[0]
    own, of_image = 2 * np.pi / float(np.min(wavelength)), np.pi / 2 * size * wide
    near_ends = np.sqrt(1 - nodes**2)
    across = np.abs(np.gradient(error, nodes, axis=1)), np.abs(np.gradient(x, nodes, axis=1))
    along = np.abs(np.gradient(error, nodes, axis=2)), np.abs(np.gradient(y, nodes, axis=2))
    slopes = (
        (own * across[0] + of_image * across[1][..., None]) * near_ends[:, None],
        (own * along[0] + of_image * along[1]) * near_ends,
    )
    steepest = max(float(slope.max()) for slope in slopes)
    least = math.ceil(0.55 * steepest) + 24
    if samples < least:
        raise ValueError(
            f"samples = {samples}: a kernel of {size} pixels and this wavefront need at least "
            f"{least}; a smaller kernel needs fewer."
        )
