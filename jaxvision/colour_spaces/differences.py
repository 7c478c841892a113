"""Differences between colours in Lab, in units of L*."""

import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ..core._numerics import divide, norm, normalize, or_one, safe_sqrt
from ..core._types import Scalars
from ..core._vector import Vec, as_vec
from ._components import Colours, chroma_of, hue_angle, parts, vanishes


@takes_numbers
def delta_e_76(lab: Colours, other: Colours) -> Scalars:
    """Return the CIE 1976 colour difference, the Euclidean distance in Lab. Its gradient between
    equal colours is 0.

    Args:
        lab: (..., 3) Lab, no unit.
        other: (..., 3) Lab.

    Returns:
        (...) no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    return norm(Vec(*parts(lab - other)))


@takes_numbers
def delta_e_2000(lab: Colours, other: Colours) -> Scalars:
    """Return the CIEDE2000 colour difference. Its gradient between equal colours is 0.

    The published formula is discontinuous between colours of opposite hue. Colours with exactly
    opposite (a, b) have a hue difference of 180 degrees, independent of rounding.

    Args:
        lab: (..., 3) Lab, no unit.
        other: (..., 3) Lab.

    Returns:
        (...) no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.

    Source: Sharma, Wu, Dalal, "The CIEDE2000 Color-Difference Formula", Color Research and
    Application 30 (2005), equations 2-22.

    Example:
        >>> first = jnp.array([50.0, 2.6772, -79.7751])  # the paper's first pair
        >>> print(f"{jv.colour_spaces.delta_e_2000(first, jnp.array([50.0, 0.0, -82.7485])):.4f}")
        2.0425
    """
    dtype = jnp.result_type(lab, other)
    if dtype in (jnp.float16, jnp.bfloat16):  # half precision is too small for products of a and b
        wide = delta_e_2000(jnp.asarray(lab, jnp.float32), jnp.asarray(other, jnp.float32))
        return wide.astype(dtype)
    l1, a1, b1 = parts(lab)
    l2, a2, b2 = parts(other)
    mean_chroma = (chroma_of(a1, b1) + chroma_of(a2, b2)) / 2
    g = (1 - _chroma_weight(mean_chroma)) / 2
    # c2 - c1 and 2 sqrt(c1 c2) sin((h2 - h1) / 2) are computed from the differences of a and b,
    # because differences of chroma and hue would contain the rounding of the colours themselves
    d_l, d_a, d_b = l2 - l1, (1 + g) * (a2 - a1), b2 - b1
    opposite = (a1 * b2 == a2 * b1) & (a1 * a2 + b1 * b2 < 0)
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = chroma_of(a1, b1), chroma_of(a2, b2)
    h1, h2 = hue_angle(a1, b1), hue_angle(a2, b2)
    hued, grey = (c1 > 0) & (c2 > 0), vanishes(c1 + c2)
    d_c = divide(d_a * (a1 + a2) + d_b * (b1 + b2), c1 + c2, ~grey, c2 - c1)
    roots = or_one(c1, hued) ** 0.5, or_one(c2, hued) ** 0.5
    turn = h2 - h1
    apart = (jnp.abs(turn) > jnp.pi) & ~opposite
    turn = turn - jnp.where(apart, 2 * jnp.pi * jnp.sign(turn), 0)
    towards = as_vec(normalize(Vec(a1, b1, jnp.zeros_like(b1))))
    d_h = jnp.where(hued, _hue_difference(roots, towards, (d_a, d_b), turn), 0)

    mean_l, mean_c, mean_h = (l1 + l2) / 2, (c1 + c2) / 2, (h1 + h2) / 2
    mean_h = mean_h + jnp.where(apart, jnp.where(mean_h < jnp.pi, jnp.pi, -jnp.pi), 0)
    mean_h = jnp.where(hued, mean_h, h1 + h2)
    t = (
        1
        - 0.17 * jnp.cos(mean_h - jnp.pi / 6)
        + 0.24 * jnp.cos(2 * mean_h)
        + 0.32 * jnp.cos(3 * mean_h + jnp.pi / 30)
        - 0.20 * jnp.cos(4 * mean_h - 63 * jnp.pi / 180)
    )
    s_l = 1 + 0.015 * (mean_l - 50) ** 2 / jnp.sqrt(20 + (mean_l - 50) ** 2)
    s_c, s_h = 1 + 0.045 * mean_c, 1 + 0.015 * mean_c * t
    # in degrees, as published: 30 exp(-((h - 275) / 25)^2)
    d_theta = jnp.pi / 6 * jnp.exp(-(((jnp.rad2deg(mean_h) - 275) / 25) ** 2))
    r_t = -2 * _chroma_weight(mean_c) * jnp.sin(2 * d_theta)
    lightness, chroma, hue = d_l / s_l, d_c / s_c, d_h / s_h
    # sqrt(lightness^2 + chroma^2 + hue^2 + r_t chroma hue), r_t^2 < 4, as a sum of three squares,
    # so that the root neither underflows nor loses its gradient
    return norm(Vec(lightness, chroma + r_t / 2 * hue, safe_sqrt(1 - r_t * r_t / 4) * hue))


def _hue_difference(
    roots: tuple[Scalars, Scalars], towards: Vec, change: tuple[Scalars, Scalars], turn: Scalars
) -> Scalars:
    """Return CIEDE2000's hue difference 2 sqrt(c1 c2) sin(turn / 2), in units of chroma. `roots`
    are the square roots of the chromas c1 and c2, and `turn` is the difference of the hue angles,
    rad, in [-pi, pi]. Small angles use k / (sqrt(c1 c2) cos(turn / 2)), with k = c1 c2 sin(turn). k
    is the cross product of `towards`, the unit vector of the first colour's (a, b), and the
    `change` of (a, b), times c1.
    """
    (root1, root2), (d_a, d_b) = roots, change
    near = jnp.abs(turn) < 0.5
    small = root1 / root2 * (towards.x * d_b - towards.y * d_a)
    small = small / jnp.cos(jnp.where(near, turn, 0) / 2)
    return jnp.where(near, small, 2 * root1 * root2 * jnp.sin(turn / 2))


def _chroma_weight(chroma: Scalars) -> Scalars:
    """Return sqrt(C^7 / (C^7 + 25^7)) without overflow of the powers, and with a finite gradient at
    0.
    """
    low = jnp.minimum(chroma / 25, 1)
    high = 25 / jnp.maximum(chroma, 25)
    colourful = chroma > 25
    ratio7 = jnp.where(colourful, 1 / (1 + high**7), low**7 / (1 + low**7))
    return safe_sqrt(ratio7)
