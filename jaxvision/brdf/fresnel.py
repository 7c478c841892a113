"""Fresnel reflectance of a smooth interface for unpolarised light, (bands,), no unit, in [0, 1].

`cos_theta` is the cosine between the ray and the interface's normal, clipped to [0, 1]. Indices of
refraction are relative to the medium of the incident light, and are clipped to 1e9 in float32 and
1e76 in float64. The formulas avoid cancellation near equal indices and at grazing angles. At an
angle of incidence of 90 degrees every interface has the reflectance 1.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core._arguments import takes_numbers, takes_range
from ..core._bounds import Ends, numbers
from ..core._numerics import divide, or_one, polynomial, safe_sqrt, smallest_divisor
from ..core._quadrature import gauss_legendre
from ..core._shown import Shown
from ..core._types import AMOUNT, DIVISOR, Colour, Range, Scalar, as_float, check_fields


class Dielectric(Shown):
    """The interface of a clear material, such as glass.

    Attributes:
        eta: (bands,) or (1,), real relative index n_t / n_i > 0, no unit; below 1 there is total
            internal reflection beyond the critical angle.

    Example:
        >>> glass = jv.Dielectric([1.5])
        >>> round(float(jv.brdf.fresnel.fresnel(glass, jnp.array(1.0))[0]), 4)  # (0.5 / 2.5)^2
        0.04
    """

    takes_maps: ClassVar[bool] = True
    eta: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, eta=AMOUNT)


class Conductor(Shown):
    """The surface of a metal with the relative complex index of refraction eta + i k.

    Attributes:
        eta: (bands,) or (1,), real part, no unit.
        k: (bands,) or (1,), imaginary part, no unit.

    Example:
        Aluminium at 550 nm, by its index of refraction.

        >>> aluminium = jv.Conductor([0.96], [6.69])
        >>> round(float(jv.brdf.fresnel.fresnel(aluminium, jnp.array(1.0))[0]), 3)
        0.921
    """

    takes_maps: ClassVar[bool] = True
    eta: Colour = eqx.field(converter=as_float)
    k: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, eta=AMOUNT, k=AMOUNT)


class Schlick(Shown):
    """An interface whose reflectance is given by Schlick's approximation.

    Attributes:
        f0: (bands,) or (1,), reflectance along the normal, no unit.

    Example:
        >>> glass = jv.Schlick([0.04])
        >>> round(float(jv.brdf.fresnel.fresnel(glass, jnp.array(0.5))[0]), 4)  # 0.04 + 0.96 / 2^5
        0.07
    """

    takes_maps: ClassVar[bool] = True
    f0: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, f0=Range(0, 1, nan=True))


Interface = Dielectric | Conductor | Schlick

_COSINE = Range(-1.001, 1.001, nan=True)  # allows for rounding


@takes_numbers
def fresnel(interface: Interface, cos_theta: Scalar) -> Colour:
    """Return the reflectance of any interface, (bands,), no unit, at the cosine of incidence
    `cos_theta`, ().

    Example:
        >>> print(np.asarray(jv.brdf.fresnel.fresnel(jv.Dielectric([1.33]), 1.0)).round(3))  # water
        [0.02]
    """
    match interface:
        case Dielectric():
            return fresnel_dielectric(cos_theta, interface.eta)
        case Conductor():
            return fresnel_conductor(cos_theta, interface.eta, interface.k)
        case Schlick():
            return fresnel_schlick(cos_theta, interface.f0)


@takes_numbers
def mean_reflectance(interface: Interface) -> Colour:
    """Return the reflectance of a smooth interface for uniform light from a hemisphere, (bands,),
    no unit. The result is the integral of 2 c F(c) over the cosine of incidence c, where F is the
    reflectance, by 24 Gauss-Legendre nodes (error 3e-6 for glass).

    Example:
        >>> print(np.asarray(jv.brdf.fresnel.mean_reflectance(jv.Dielectric([1.5]))).round(4))
        [0.0918]
    """
    nodes, weights = gauss_legendre(24)
    dtype = jax.tree.leaves(interface)[0].dtype
    each = jax.vmap(lambda c: fresnel(interface, c))(jnp.asarray(nodes, dtype))
    return jnp.asarray(2 * nodes * weights, dtype) @ each


@takes_numbers
@takes_range(cos_theta=_COSINE, eta=DIVISOR)
def fresnel_dielectric(cos_theta: Scalar, eta: Colour) -> Colour:
    """Return the reflectance of a clear interface of relative index eta, (bands,), no unit; 1 in
    total reflection (g^2 <= 0). The reflectance is (r_s^2 + r_p^2) / 2, where c = cos_theta, g^2 =
    eta^2 - 1 + c^2 and

        r_s = (c - g) / (c + g)                = (1 - eta^2) / (c + g)^2
        r_p = (eta^2 c - g) / (eta^2 c + g)    = (eta^2 - 1) (c^2 (eta^2 + 1) - 1) / (eta^2 c + g)^2

    The forms on the right have no root in the numerator, and keep full precision where the
    reflectance is small.

    Source: Cook & Torrance, ACM TOG 1(1) (1982).

    Example:
        >>> print(np.asarray(jv.brdf.fresnel.fresnel_dielectric(1.0, [1.5])).round(3))  # glass
        [0.04]
    """
    c, eta = jnp.clip(cos_theta, 0, 1), _index(eta)
    square, contrast = eta * eta, (eta - 1) * (eta + 1)
    g_squared = contrast + c * c
    passes = ~(g_squared <= 0)
    g = safe_sqrt(g_squared)
    # Close to total reflection, rounding may make `passes` differ between its uses, so the second
    # condition is needed.
    s_sum, p_sum = (or_one(x, passes | (x > 1e-6)) for x in (c + g, square * c + g))
    # divided twice: for equal indices at grazing angles the gradient of the square would overflow
    r_s = contrast / s_sum / s_sum
    r_p = contrast * (c * c * (square + 1) - 1) / p_sum / p_sum
    r_p = jnp.where(jnp.abs(r_p) > 0.5, (square * c - g) / p_sum, r_p)  # far from Brewster's angle
    reflected = (r_s * r_s + r_p * r_p) / 2
    # if little is transmitted, the transmitted share 1 - r_s^2 = 4 c g / (c + g)^2 is more precise
    passed = 2 * ((c / s_sum) * (g / s_sum) + (square * c / p_sum) * (g / p_sum))
    return jnp.where(passes, jnp.where(reflected < 0.5, reflected, 1 - passed), 1)


def _index(x: Colour) -> Colour:
    """Clip an index of refraction, or its real or imaginary part, so that its fourth power is
    finite."""
    return jnp.minimum(x, 0.5 / smallest_divisor(x.dtype))


@takes_numbers
@takes_range(cos_theta=_COSINE, eta=AMOUNT, k=AMOUNT)
def fresnel_conductor(cos_theta: Scalar, eta: Colour, k: Colour) -> Colour:
    """Return the reflectance of a metal of relative index eta + i k, (bands,), no unit: (R_s + R_p)
    / 2 with c and s the cosine and sine of incidence, (a + i b)^2 = (eta + i k)^2 - s^2 and

        R_s = ((a - c)^2 + b^2) / ((a + c)^2 + b^2)
        R_p = R_s ((a c - s^2)^2 + b^2 c^2) / ((a c + s^2)^2 + b^2 c^2)

    Source: Born & Wolf, Principles of Optics, section 14.2.

    Example:
        >>> silver = jv.brdf.fresnel.fresnel_conductor(1.0, [0.06], [3.6])  # at 550 nm
        >>> print(np.asarray(silver).round(3))
        [0.983]
    """
    c, eta, k = jnp.clip(cos_theta, 0, 1), _index(eta), _index(k)
    s_squared = (1 - c) * (1 + c)
    contrast, half_imaginary = (eta - 1) * (eta + 1) - k * k, eta * k
    # eta^2 - k^2 - s^2, from the smaller of s^2 and c^2, which avoids cancellation.
    real = jnp.where(c * c < 0.5, contrast + c * c, (eta - k) * (eta + k) - s_squared)
    # sqrt of a complex number: first its larger part, then the smaller one from their product.
    modulus = safe_sqrt(real * real + 4 * half_imaginary * half_imaginary)
    larger = safe_sqrt((modulus + jnp.abs(real)) / 2)
    smaller = half_imaginary / jnp.maximum(larger, smallest_divisor(larger.dtype))
    clear = real > 0
    a, b = jnp.where(clear, larger, smaller), jnp.where(clear, smaller, larger)
    # a - c from a^2 - c^2 = contrast + b^2, because a and c are nearly equal for similar indices.
    apart = divide(contrast + b * b, a + c, where=clear, otherwise=a - c)

    def ratio(difference: Colour, total: Colour, other: Colour, missing: Colour) -> Colour:
        """Return (difference^2 + other^2) / (total^2 + other^2). A ratio above 1/3 is computed from
        `missing` = total^2 - difference^2, which is then more precise."""
        below = total * total + other * other
        above = difference * difference + other * other
        return jnp.where(3 * above < below, divide(above, below), 1 - divide(missing, below))

    r_s = ratio(apart, a + c, b, 4 * a * c)
    return r_s * (1 + ratio(a * c - s_squared, a * c + s_squared, b * c, 4 * a * c * s_squared)) / 2


@takes_numbers
@takes_range(cos_theta=_COSINE)
def fresnel_schlick(cos_theta: Scalar, f0: Colour) -> Colour:
    """Return Schlick's approximation of the reflectance, f0 + (1 - f0) (1 - c)^5, (bands,), no
    unit, where f0 is the reflectance at normal incidence and c the cosine.

    Source: Schlick, Computer Graphics Forum 13(3) (1994).

    Example:
        >>> for cosine in (1.0, 0.0):
        ...     print(jv.brdf.fresnel.fresnel_schlick(cosine, [0.04]))
        [0.04]
        [1.]
    """
    return _schlick(jnp.clip(cos_theta, 0, 1), f0)


@jax.custom_jvp
def _schlick(c: Scalar, f0: Colour) -> Colour:
    rest = 1 - c
    lost = (1 - rest) - c  # the rounding error of `rest`, multiplied by five in the fifth power
    fourth = jnp.square(jnp.square(rest))
    return f0 + (1 - f0) * (fourth * (rest + 5 * lost))


@_schlick.defjvp
def _schlick_jvp(primals, tangents):
    """Differentiate `_schlick`. The derivative with respect to f0 is 1 - (1 - c)^5, written as an
    expanded polynomial to avoid cancellation."""
    (c, f0), (d_c, d_f0) = primals, tangents
    fourth = jnp.square(jnp.square(1 - c))
    slope = polynomial((1.0, -5.0, 10.0, -10.0, 5.0, 0.0), c)
    return _schlick(c, f0), slope * d_f0 - 5 * fourth * (1 - f0) * d_c


# ---------------------------------------------------------------- bounds

MONOTONE = 3.7  # index up to which a dielectric's reflectance rises with the angle


def _largest_reflectance(x: Ends[Interface | None]) -> tuple[Callable[[Any], Any], bool]:
    """Return a function and a flag. The function of a cosine returns an upper bound on the
    reflectance of all bands, at this cosine of incidence and at all larger ones. The flag is true
    if all bands have the same reflectance."""
    low, high = x
    match low, high:
        case Dielectric(), Dielectric():
            eta = np.stack([numbers(low.eta), numbers(high.eta)])
            neutral = low.eta.shape == (1,)
            if np.all(eta == 1):
                return lambda c: 0 * c, True
            if np.all((eta >= 1) & (eta <= MONOTONE)):
                ends = float(eta.min()), float(eta.max())
                return lambda c: _largest_dielectric(c, *ends), neutral
            return lambda c: 0 * c + 1, neutral
        case Schlick(), Schlick():
            f0 = max(float(numbers(end.f0).max()) for end in (low, high))
            return lambda c: np.maximum(f0, f0 + (1 - f0) * (1 - c) ** 5), low.f0.shape == (1,)
        case Conductor(), Conductor():
            return lambda c: 0 * c + 1, low.eta.shape == low.k.shape == (1,)
    return lambda c: 0 * c + 1, True


def _least_reflectance(x: Ends[Interface | None]) -> float:
    """Return a lower bound on the reflectance of all bands at all angles; 0 if none is known."""
    low, high = x
    match low, high:
        case Dielectric(), Dielectric():
            eta = min(float(numbers(end.eta).min()) for end in (low, high))
            return ((eta - 1) / (eta + 1)) ** 2 if eta >= 1 else 0.0
        case Schlick(), Schlick():
            return max(min(float(numbers(end.f0).min()) for end in (low, high)), 0.0)
    return 0.0


def _largest_dielectric(c: Any, least: float, most: float) -> Any:
    """Return an upper bound on Fresnel's reflectance for unpolarised light and indices between two
    values >= 1; it is exact if the two values are equal. The reflectance of s-polarised light grows
    with the index. The reflectance of p-polarised light is largest at one of the two indices, or
    where eta^2 is twice the squared sine of the angle."""

    def amplitudes(eta: Any) -> tuple[Any, Any]:
        g = np.sqrt(eta**2 - 1 + c * c)
        return (c - g) / (c + g), (eta**2 * c - g) / (eta**2 * c + g)

    s, p = amplitudes(most)
    most_p = p * p
    if least < most:
        inner = np.clip(np.sqrt(np.maximum(2 * (1 - np.square(c)), 1)), least, most)
        for eta in (least, inner):
            most_p = np.maximum(most_p, amplitudes(eta)[1] ** 2)
    return (s * s + most_p) / 2
