"""Directions above a surface: the local frame, two samplers with their densities, and a quadrature
over the hemisphere.

The local frame has the normal along +z. Directions are unit vectors that point away from the
surface; densities and weights are per solid angle, in sr^-1 and sr. Functions take one direction;
use `jax.vmap` for many. Sampling functions return a `Vec`. `to_local` and `to_world` return vectors
of the type they were given.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import dot, norm, normalize, safe_sqrt, sine_cosine
from ..core._quadrature import gauss_legendre
from ..core._shown import Shown
from ..core._types import Scalars
from ..core._vector import Directions, Vec, Vec3, as_array, as_vec, vector_field, where


class Frame(Shown):
    """Three perpendicular unit vectors, right-handed: tangent x bitangent = normal.

    Attributes:
        tangent, bitangent, normal: (3,) unit length; (..., 3) arrays are split into components.

    Example:
        >>> frame = jv.local_frame(jnp.array([0.6, 0.0, 0.8]))
        >>> axes = frame.tangent, frame.bitangent, frame.normal
        >>> [round(abs(float(jv.dot(axis, frame.normal))), 4) for axis in axes]
        [0.0, 0.0, 1.0]
    """

    tangent: Vec = eqx.field(converter=vector_field)
    bitangent: Vec = eqx.field(converter=vector_field)
    normal: Vec = eqx.field(converter=vector_field)


@takes_numbers
def cross(u: Vec3, v: Vec3) -> Vec:
    """Return u x v, whose length is the area of the parallelogram of `u` and `v`, in the product of
    their units."""
    a, b = as_vec(u), as_vec(v)
    return Vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@takes_numbers
def local_frame(normal: Directions, *, tangent: Vec3 | None = None) -> Frame:
    """Return a local frame about a normal.

    Args:
        normal: (..., 3) unit length.
        tangent: (..., 3) of any length; the frame's tangent is its component perpendicular to the
            normal. Where it is None, zero or (nearly) parallel to the normal, the frame is that of
            Duff et al.: without branches, accurate to rounding for every normal, and discontinuous
            across normal.z = 0.

    Returns:
        Unit vectors, components of the shape of those of `normal`.

    Source:
        Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1) (2017).

    Example:
        >>> roof, south = jnp.array([0.6, 0.0, 0.8]), jnp.array([0.0, -1.0, 0.0])
        >>> frame = jv.local_frame(roof, tangent=south)
        >>> [round(float(x), 4) for x in jv.as_array(frame.bitangent)]  # normal x tangent
        [0.8, 0.0, -0.6]
    """
    n = as_vec(normal)
    sign = jnp.where(n.z < 0, -jnp.ones_like(n.z), 1)
    a = -sign * (1 / (1 + jnp.abs(n.z)))
    b = n.x * n.y * a
    t = Vec(1 + sign * n.x * n.x * a, sign * b, -sign * n.x)
    if tangent is None:
        return Frame(t, Vec(b, sign + n.y * n.y * a, -n.y), n)
    wanted = as_vec(normalize(tangent))
    along = wanted - dot(wanted, n) * n
    usable = norm(along) > jnp.finfo(n.x.dtype).eps
    chosen = as_vec(normalize(where(usable, along, t)))
    # Repeat the projection, because rounding may leave a part along the normal.
    chosen = normalize(chosen - dot(chosen, n) * n)
    return Frame(chosen, cross(n, chosen), n)


@takes_numbers
def to_local(frame: Frame, w: Vec3) -> Vec3:
    """Convert a world direction to the frame of a surface.

    Args:
        frame: from `local_frame`.
        w: (..., 3) in the world, in any unit.

    Returns:
        Its components along tangent, bitangent and normal, of the kind and in the unit of `w`.

    Example:
        >>> roof = jv.local_frame(jnp.array([0.6, 0.0, 0.8]))
        >>> sun = jnp.array([0.0, 0.0, 1.0])
        >>> round(float(jv.to_local(roof, sun)[2]), 4)  # cosine of incidence
        0.8
    """
    local = Vec(dot(w, frame.tangent), dot(w, frame.bitangent), dot(w, frame.normal))
    return local if isinstance(w, Vec) else as_array(local)


@takes_numbers
def to_world(frame: Frame, w: Vec3) -> Vec3:
    """Convert a direction in the frame of a surface to the world.

    Args:
        frame: from `local_frame`.
        w: (..., 3) along tangent, bitangent and normal, in any unit.

    Returns:
        The same in the world, of the kind and in the unit of `w`.

    Example:
        >>> roof = jv.local_frame(jnp.array([0.6, 0.0, 0.8]))
        >>> [round(float(x), 4) for x in jv.to_world(roof, jnp.array([0.0, 0.0, 1.0]))]
        [0.6, 0.0, 0.8]
    """
    v = as_vec(w)
    world = v.x * frame.tangent + v.y * frame.bitangent + v.z * frame.normal
    return world if isinstance(w, Vec) else as_array(world)


@takes_numbers
def direction_at(one_minus_cos: Scalars, phi: Scalars) -> Vec:
    """Return the unit vector at azimuth `phi` (rad) whose polar cosine is 1 - `one_minus_cos`, with
    `one_minus_cos` in [0, 2]. Near the pole 1 minus the cosine is more precise than the cosine,
    which matters for narrow lobes."""
    sine = safe_sqrt(one_minus_cos * (2 - one_minus_cos))
    return Vec(sine * jnp.cos(phi), sine * jnp.sin(phi), 1 - one_minus_cos)


@takes_numbers
def cosine_direction(u: Float[Array, "2"]) -> Vec:
    """Draw a unit local direction with density cos(theta) / pi sr^-1, from two uniform numbers, by
    a point that is uniform in the unit disc (Malley)."""
    return _spherical_direction(safe_sqrt(u[0]), safe_sqrt(1 - u[0]), u[1])


@takes_numbers
def cosine_pdf(w: Directions) -> Scalars:
    """Return max(cos(theta), 0) / pi in sr^-1, the density of `cosine_direction`, for a local
    direction `w`."""
    return jnp.maximum(as_vec(w).z, 0) / jnp.pi


@takes_numbers
def uniform_direction(u: Float[Array, "2"]) -> Vec:
    """Draw a unit local direction with the constant density 1 / (2 pi) sr^-1 over the hemisphere,
    from two uniform numbers in [0, 1)."""
    return _spherical_direction(safe_sqrt(u[0] * (2 - u[0])), 1 - u[0], u[1])


@takes_numbers
def uniform_pdf(w: Vec3) -> Scalars:
    """Return the density of `uniform_direction`: 1 / (2 pi) sr^-1 above the surface, 0 below."""
    z = as_vec(w).z
    return jnp.where(z > 0, 0.5 / jnp.pi, jnp.where(z <= 0, 0, z))


def _spherical_direction(sine: Scalars, cosine: Scalars, turns: Scalars) -> Vec:
    """Return the unit vector with the given polar sine and cosine, and azimuth in turns of 2 pi
    rad."""
    across, along = sine_cosine(turns)
    return Vec(sine * along, sine * across, cosine)


def product_nodes(
    polar: int, azimuths: int
) -> tuple[Float[np.ndarray, "nodes 3"], Float[np.ndarray, " nodes"]]:
    """Return unit local directions, (nodes, 3), and weights, (nodes,) sr, in NumPy float64. The
    rule is Gauss-Legendre in cos(theta) times the trapezium rule in phi. The rule integrates
    polynomials in the direction's components exactly up to degree min(2 polar - 1, azimuths - 1).
    """
    if polar < 1 or azimuths < 1:
        raise ValueError(f"polar and azimuths must be at least 1, got {polar} and {azimuths}.")
    mu, w_mu = gauss_legendre(polar)
    phi = 2 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    sine = np.sqrt(1 - mu**2)[:, None]
    directions = np.stack(
        [sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(mu[:, None], (polar, azimuths))],
        axis=-1,
    )
    weights = np.broadcast_to(w_mu[:, None] * 2 * np.pi / azimuths, (polar, azimuths))
    return directions.reshape(-1, 3), weights.reshape(-1)
