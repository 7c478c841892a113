"""Filters of any orientation as sums of a few basis filters (Freeman and Adelson, "The Design and
Use of Steerable Filters", PAMI 13, 1991).

Angles are in rad, 0 to the right and pi/2 upward, with shape () or (h, w). `width`, in pixels, is
the unit of length in the paper's exp(-x^2 - y^2), a Gaussian of sigma = width / sqrt(2).
First-order responses are in the picture's unit per pixel, all other responses in the picture's
unit.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import safe_sqrt
from ..core._types import Scalar, as_float, check_count, print_by_name
from ._terms import Fill
from .convolution import _check_weighs, correlate_separable
from .gaussians import Sigma, gaussian
from .padding import Filtered, Picture

Angle = Float[Array, ""] | Float[Array, "h w"]
print_by_name(globals(), "Angle")
Basis = tuple[Filtered, ...]

# The paper's tables III and V: each basis filter is exp(-x^2 - y^2) times one polynomial in x and
# one in y. A response is a correlation with the filter as it is.
_Factor = Callable[[Float[Array, " taps"]], Float[Array, " taps"]]
_G2: tuple[tuple[_Factor, _Factor], ...] = (
    (lambda x: 0.9213 * (2 * x * x - 1), jnp.ones_like),
    (lambda x: 1.843 * x, lambda y: y),
    (jnp.ones_like, lambda y: 0.9213 * (2 * y * y - 1)),
)
_H2: tuple[tuple[_Factor, _Factor], ...] = (
    (lambda x: 0.9780 * (x * x - 2.254) * x, jnp.ones_like),
    (lambda x: 0.9780 * (x * x - 0.7515), lambda y: y),
    (lambda x: x, lambda y: 0.9780 * (y * y - 0.7515)),
    (jnp.ones_like, lambda y: 0.9780 * (y * y - 2.254) * y),
)


class QuadratureBasis(NamedTuple):
    """Responses of the basis filters of the quadrature pair G2 and H2.

    Attributes:
        even: three responses for G2, each of the picture's shape and unit.
        odd: four responses for H2, each of the picture's shape and unit.
    """

    even: Basis
    odd: Basis


@takes_numbers
def directional_derivative(
    picture: Picture,
    sigma: Sigma,
    angle: Angle | float,
    *,
    size: int | None = None,
    truncate: float = 4.0,
    border: str = "mirror",
    fill: Fill = 0.0,
) -> Filtered:
    """Return the derivative of a Gaussian-filtered picture in the direction of an angle: cos f_x +
    sin f_up.

    The directional derivative is the steerable filter of first order.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        sigma: () or (2,), down and across, in pixels.
        angle: () or (h, w) in rad, 0 to the right and pi/2 up.
        size: taps of the kernel along both axes; None for `gaussian_size` of the largest sigma.
        truncate: sigmas at which the kernel is cut off, if `size` is None; no unit.
        border: a key of `padding.BORDERS` but "normalised_zero".
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".

    Returns:
        The picture's shape; its unit per pixel.

    Raises:
        ValueError: as for `gaussian`.
    """

    def smoothed_derivative(order: tuple[int, int]) -> Filtered:
        return gaussian(
            picture, sigma, size=size, truncate=truncate, order=order, border=border, fill=fill
        )

    right, up = smoothed_derivative((0, 1)), -smoothed_derivative((1, 0))
    return _map_kernels(jnp.cos(angle), right) * right + _map_kernels(jnp.sin(angle), up) * up


@takes_numbers
def quadrature_basis(
    picture: Picture,
    width: Scalar | float,
    *,
    size: int,
    border: str = "mirror",
    fill: Fill = 0.0,
) -> QuadratureBasis:
    """Compute the seven separable responses from which G2 and H2 follow at every orientation.

    For a width of at least 2, the squared weights of G2 sum to 1 (within 4e-5). The squared weights
    of H2, the paper's fit to a Hilbert transform, sum to 0.99. Narrower filters are sampled too
    coarsely: at width 1 the two sums are 1.18 to 1.41 and 0.53 to 0.81, depending on the angle.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        width: () in pixels.
        size: taps of the kernels along both axes, odd; 7 widths are accurate to 1e-4.
        border: a key of `padding.BORDERS` but "normalised_zero", because most weights have sum 0.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".

    Returns:
        Three responses for G2 and four for H2, each of the picture's shape and unit.

    Raises:
        ValueError: for an even size or the border "normalised_zero".

    Source: Freeman and Adelson 1991, tables III and V.
    """
    _check_weighs(border, of="the quadrature pair")
    width = as_float(width)
    check_count("size", size, 1, odd=True)
    x = (jnp.arange(size, dtype=width.dtype) - size // 2) / width
    bell = jnp.exp(-x * x)

    def response(factors: tuple[_Factor, _Factor]) -> Filtered:
        across, up = factors
        column = (bell * up(x))[::-1] / width
        return correlate_separable(picture, column, bell * across(x), border=border, fill=fill)

    return QuadratureBasis(tuple(map(response, _G2)), tuple(map(response, _H2)))


def steer(basis: QuadratureBasis, angle: Angle | float) -> tuple[Filtered, Filtered]:
    """Return the responses of G2 and H2, rotated to an angle.

    With y up, the basis functions of G2 and H2 contain (x cos + y sin) to the second and third
    power, so all signs are plus. (In the paper y points down, so some signs are negative.)

    Args:
        basis: the responses of `quadrature_basis`.
        angle: () or (h, w) in rad, 0 to the right and pi/2 up.

    Returns:
        The even and the odd response, each of the picture's shape and unit.
    """
    c, s = jnp.cos(jnp.asarray(angle)), jnp.sin(jnp.asarray(angle))
    even = (c * c, 2 * c * s, s * s)
    odd = (c * c * c, 3 * c * c * s, 3 * c * s * s, s * s * s)
    return _weight(even, basis.even), _weight(odd, basis.odd)


def oriented_energy(basis: QuadratureBasis, angle: Angle | float) -> Filtered:
    """Return G2^2 + H2^2 at an angle, the strength of a line or an edge across that direction.

    The energy is independent of the phase, the position of the line within the period of the
    filters.

    Args:
        basis: the responses of `quadrature_basis`.
        angle: () or (h, w) in rad, 0 to the right and pi/2 up.

    Returns:
        The picture's shape; its unit squared.
    """
    even, odd = steer(basis, angle)
    return even * even + odd * odd


def dominant_orientation(basis: QuadratureBasis) -> tuple[Filtered, Filtered]:
    """Return the angle theta at which the lowest harmonic of the energy, C_2 cos 2 theta + C_3 sin
    2 theta, is largest.

    C_2 and C_3 are computed as sums of products of the responses, without the energy's isotropic
    part, which would cause cancellation.

    Args:
        basis: the responses of `quadrature_basis`.

    Returns:
        The angle in rad in (-pi/2, pi/2], 0 where there is no orientation, and the maximum in the
        picture's unit squared; each of the picture's shape.

    Source: Freeman and Adelson 1991, table XI.
    """
    a, b, c = basis.even
    c2, c3 = (a - c) * (a + c) / 2, (a + c) * b
    a, b, c, d = basis.odd
    c2 = c2 + 3 / 32 * ((a + c) * (5 * a - 3 * c) + (b + d) * (3 * b - 5 * d))
    c3 = c3 + 3 / 16 * (a * (5 * b + d) + c * (9 * b + 5 * d))
    square = c2 * c2 + c3 * c3
    flat = square <= 0
    angle = jnp.arctan2(jnp.where(flat, 0, c3), jnp.where(flat, 1, c2)) / 2
    return angle, safe_sqrt(square)


def _weight(weights: tuple[Angle, ...], basis: Basis) -> Filtered:
    total = _map_kernels(weights[0], basis[0]) * basis[0]
    for weight, response in zip(weights[1:], basis[1:], strict=True):
        total = total + _map_kernels(weight, response) * response
    return total


def _map_kernels(weight: Angle, picture: Filtered) -> Float[Array, "..."]:
    """Reshape a number, or a map of numbers, to broadcast over the axes of a picture."""
    if weight.ndim == 0 or picture.ndim == 2:
        return weight.astype(picture.dtype)
    shape = (1,) * (picture.ndim - 3) + weight.shape + (1,)
    return weight.astype(picture.dtype).reshape(shape)
