"""The map from half vectors to the unit square on which measured lobes are tabulated and sampled.

    x = sqrt(2 theta_h / pi)    y = (phi_h + pi) / (2 pi)

The half vector has the polar angle theta_h and the azimuth phi_h. Equally spaced nodes in x are
dense near the normal, where lobes are narrow. For isotropic materials phi_h is relative to the
azimuth of `wo`. In the local frame the normal is +z; angles are in radians. Source: Dupuy & Jakob,
"An Adaptive Parameterization for Efficient Material Acquisition and Rendering", 2018.
"""

import jax.numpy as jnp

from ..core._numerics import arctan2, dot, safe_sqrt
from ..core._types import Scalar, Scalars
from ..core._vector import Vec
from ._warp import Square


def elevation(w: Vec) -> Scalar:
    """Return theta, the angle to the normal, in [0, pi], with full relative precision even near the
    normal. The zero vector has theta = 0, with gradient 0."""
    aside = safe_sqrt(w.x * w.x + w.y * w.y)
    defined = (aside > 0) | (w.z != 0)
    return arctan2(aside, jnp.where(defined, w.z, 1))


def azimuth(w: Vec) -> Scalar:
    """Return the azimuth phi in [-pi, pi]. A vector along the normal has phi = 0, with gradient
    0."""
    aside = (w.x != 0) | (w.y != 0)
    return jnp.where(aside, jnp.arctan2(jnp.where(aside, w.y, 0), jnp.where(aside, w.x, 1)), 0)


def spherical(theta: Scalars, phi: Scalars) -> Vec:
    """Return the unit vectors with polar angles `theta` and azimuths `phi`."""
    sin_theta = jnp.sin(theta)
    return Vec(sin_theta * jnp.cos(phi), sin_theta * jnp.sin(phi), jnp.cos(theta))


def elevation_to_unit(theta: Scalar) -> Scalar:
    """Return sqrt(2 theta / pi), which maps [0, pi / 2] to [0, 1]."""
    return safe_sqrt(theta * (2 / jnp.pi))


def azimuth_to_unit(phi: Scalar) -> Scalar:
    """Return (phi + pi) / (2 pi), wrapped into [0, 1)."""
    turns = phi * (0.5 / jnp.pi) + 0.5
    return turns - jnp.floor(turns)


def square_to_half(position: Square, phi: Scalar) -> Vec:
    """Return the half vector at a position in the unit square, with its azimuth relative to
    `phi`."""
    x, y = position
    return spherical(jnp.square(x) * (jnp.pi / 2), (2 * y - 1) * jnp.pi + phi)


def half_to_square(h: Vec, phi: Scalar) -> Square:
    """Return the position of a half vector in the unit square, the inverse of `square_to_half`."""
    return elevation_to_unit(elevation(h)), azimuth_to_unit(azimuth(h) - phi)


def reflected(w: Vec, h: Vec) -> Vec:
    """Return `w` mirrored about `h`, 2 (w.h) h - w."""
    return 2 * dot(w, h) * h - w


def stretch(x: Scalar, h: Vec, wo: Vec) -> Scalar:
    """Return d omega_i / d(x, y) = 4 (wo.h) 2 pi^2 x sin(theta_h), the solid angle of `wi` per unit
    of area of the square, in sr."""
    sin_theta = safe_sqrt(h.x * h.x + h.y * h.y)
    return 8 * jnp.pi**2 * x * sin_theta * jnp.abs(dot(wo, h))
