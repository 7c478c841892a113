"""The unit square of half vectors, in which measured lobes are tabulated and sampled.

    x = sqrt(2 theta_h / pi)    y = (phi_h + pi) / (2 pi)

x gives most of the nodes to the surroundings of the normal, where lobes are narrow. Isotropic
materials count phi_h from the azimuth of `wo`. Local frame: normal = +z; angles in radians. Source:
Dupuy & Jakob, "An Adaptive Parameterization for Efficient Material Acquisition and Rendering",
2018.
"""

import jax.numpy as jnp

from ..core._numerics import arctan2, dot, safe_sqrt
from ..core._types import Scalar, Scalars
from ..core._vector import Vec
from ._warp import Square


def elevation(w: Vec) -> Scalar:
    """Return theta, the angle to the normal, in [0, pi], with full relative precision even near the
    normal. It is 0, with gradient 0, for the zero vector."""
    aside = safe_sqrt(w.x * w.x + w.y * w.y)
    defined = (aside > 0) | (w.z != 0)
    return arctan2(aside, jnp.where(defined, w.z, 1))


def azimuth(w: Vec) -> Scalar:
    """Return the azimuth phi in [-pi, pi]. On the normal it is 0 with gradient 0."""
    aside = (w.x != 0) | (w.y != 0)
    return jnp.where(aside, jnp.arctan2(jnp.where(aside, w.y, 0), jnp.where(aside, w.x, 1)), 0)


def spherical(theta: Scalars, phi: Scalars) -> Vec:
    """Return the unit vectors with these angles to the normal and azimuths."""
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
    """Return the half vector at a position of the square; its azimuth counts from `phi`."""
    x, y = position
    return spherical(jnp.square(x) * (jnp.pi / 2), (2 * y - 1) * jnp.pi + phi)


def half_to_square(h: Vec, phi: Scalar) -> Square:
    """Invert `square_to_half`: return the position of a half vector in the square."""
    return elevation_to_unit(elevation(h)), azimuth_to_unit(azimuth(h) - phi)


def reflected(w: Vec, h: Vec) -> Vec:
    """Mirror `w` about `h`: 2 (w.h) h - w."""
    return 2 * dot(w, h) * h - w


def stretch(x: Scalar, h: Vec, wo: Vec) -> Scalar:
    """Return d omega_i / d(x, y) = 4 (wo.h) 2 pi^2 x sin(theta_h), sr: the solid angle of `wi` per
    area of the square at x."""
    sin_theta = safe_sqrt(h.x * h.x + h.y * h.y)
    return 8 * jnp.pi**2 * x * sin_theta * jnp.abs(dot(wo, h))
