"""The Bessel function J_1, for diffraction at a round aperture, vectorised.

The function J_1 is computed by Chebyshev expansions, whose coefficients have 40 digits and are
dropped below 1e-16. Up to x = 8, 2 J_1(x) / x is expanded in x^2. For larger x, the slowly varying
functions P and Q of

    J_1(x) = sqrt(2 / (pi x)) (P cos(x - 3 pi / 4) - (8 / x) Q sin(x - 3 pi / 4))

are expanded in (8 / x)^2 (Abramowitz and Stegun, Handbook of Mathematical Functions, 9.2.5).
"""

import jax.numpy as jnp

from ..core._numerics import chebyshev
from ..core._types import Scalars

_NEAR = (
    0.16208969265131623,
    -0.2979502901353042,
    0.3219985247144194,
    -0.16536098353363582,
    0.04442727930993207,
    -0.007293881201538552,
    0.0008100675456709644,
    -6.511109733714517e-05,
    3.971754809983033e-06,
    -1.9043969513500872e-07,
    7.374267518194296e-09,
    -2.35605324539177e-10,
    6.320309160696006e-12,
    -1.4443510479303547e-13,
    2.8464288007027885e-15,
    -4.888394583238093e-17,
)
_IN_PHASE = (
    1.0009030408600137,
    0.0008989898330859408,
    -3.987284300488908e-06,
    6.177633960644299e-08,
    -1.8718907491063067e-09,
    8.816898659582339e-11,
    -5.704863640395645e-12,
    4.699195515230542e-13,
    -4.6842237839904895e-14,
    5.452674896044717e-15,
    -7.221180842274018e-16,
    1.0667689114335412e-16,
)
_ACROSS = (
    0.04677778706953532,
    -9.62772354915708e-05,
    9.138615257955454e-07,
    -2.0959781384083424e-08,
    8.229193327650554e-10,
    -4.686363688176945e-11,
    3.5152187949686082e-12,
    -3.2643156743279e-13,
    3.5967765829165294e-14,
    -4.5612523950772974e-15,
    6.508282957783384e-16,
    -1.0269147531823243e-16,
)


def jinc(square: Scalars) -> Scalars:
    """Return 2 J_1(x) / x as a function of `square` = x^2 >= 0; at 0 it is 1, with slope -1 / 8."""
    near = square < 64
    low = chebyshev(_NEAR, jnp.where(near, square, 0) / 32 - 1)
    x = jnp.sqrt(jnp.where(near, 64, square))
    w = 8 / x
    in_phase = chebyshev(_IN_PHASE, 2 * w * w - 1)
    across = w * chebyshev(_ACROSS, 2 * w * w - 1)
    # sqrt(2) times the cosine and the sine of x - 3 pi / 4, without rounding the difference
    cosine, sine = jnp.sin(x) - jnp.cos(x), -jnp.sin(x) - jnp.cos(x)
    high = 2 / (x * jnp.sqrt(jnp.pi * x)) * (in_phase * cosine - across * sine)
    return jnp.where(near, low, high)
