"""Microfacet distributions, and shadowing and masking between facets, for unit directions in the
local frame.

`alpha`: (2,), the roughness along x and y, no unit. For a Beckmann surface alpha is sqrt(2) times
the root mean square slope. An alpha below 1e-6 is replaced by 1e-6, with no gradient.
`distribution`: "beckmann" (Gaussian slopes) or "ggx" (heavy tails). `shadowing`: "smith"
(height-correlated) or "v-cavity" (the grooves of Torrance and Sparrow, for any distribution).
Densities are in sr^-1. Sources: Walter et al., "Microfacet Models for Refraction through Rough
Surfaces", EGSR 2007; Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based
BRDFs", JCGT 3(2) (2014).
"""

from typing import Literal

import jax.numpy as jnp
from jax.lax import erfc
from jaxtyping import Array, Float

from ..core._numerics import (
    divide,
    dot,
    log_of_zero,
    normalize,
    or_one,
    safe_sqrt,
    smallest_divisor,
)
from ..core._types import Scalar, print_by_name
from ..core._vector import Direction, Vec, Vector, as_vec
from ..geometry.hemisphere import cross
from ._lobe import divisor

Distribution = Literal["beckmann", "ggx"]
Shadowing = Literal["smith", "v-cavity"]
Alpha = Float[Array, "2"]
print_by_name(globals(), "Alpha")


LEAST_ROUGHNESS = 1e-6  # smaller roughnesses count as this one


def clamped_roughness(alpha: Alpha) -> Alpha:
    """Return the roughness clipped to at least 1e-6, no unit. A clipped roughness has no
    gradient."""
    return jnp.maximum(alpha, LEAST_ROUGHNESS)


def half_vector(wi: Direction, wo: Direction) -> Vec:
    """Return the unit vector half-way between two unit directions, or zero for opposite directions.
    A facet with this normal mirrors one direction into the other. Rounding rotates the half vector
    by about eps / cos(theta), where eps is the machine epsilon and theta the polar angle. In
    float32, a lobe with alpha cos(theta) < 1e-6 is narrower than this error."""
    return as_vec(normalize(as_vec(wi) + as_vec(wo)))


def normal_distribution(h: Direction, alpha: Alpha, *, distribution: Distribution) -> Scalar:
    """Return D(h) in sr^-1, the area of facets with normal `h` per solid angle and per area of the
    surface; 0 below the surface. The slopes divided by their roughness are p = h.x / (h.z alpha_x)
    and q = h.y / (h.z alpha_y):

        beckmann   exp(-(p^2 + q^2)) / (pi alpha_x alpha_y h.z^4)
        ggx        1 / (pi alpha_x alpha_y h.z^4 (1 + p^2 + q^2)^2)
    """
    n, a = as_vec(h), clamped_roughness(alpha)
    across = jnp.square(n.x / a[0]) + jnp.square(n.y / a[1])
    scale = jnp.pi * a[0] * a[1]
    match distribution:
        case "beckmann":
            above = ~(n.z <= 1e-5)  # the weight of steeper facets underflows
            z = jnp.maximum(n.z, 1e-5)
            steepness = across / (z * z)
            # if the exponential is 0, z^4 is replaced, because it would underflow in a derivative
            counts = above & ~(steepness >= -log_of_zero(z.dtype))
            z = or_one(z, counts)
            density = jnp.exp(-jnp.where(counts, steepness, 0)) / (scale * jnp.square(z * z))
            return jnp.where(counts, density, 0)
        case "ggx":
            facing = ~(n.z <= 0)
            spread = or_one(across + n.z * n.z, facing)
            return jnp.where(facing, 1 / (scale * jnp.square(spread)), 0)
        case _:
            raise ValueError(f"distribution must be 'beckmann' or 'ggx', got {distribution!r}.")


def hidden_cosine(w: Direction, alpha: Alpha, *, distribution: Distribution) -> Scalar:
    """Return cos(theta) Lambda(w), no unit: the facet area projected toward `w` that other facets
    hide, per area of the surface. The visible facet area is cos(theta). The product is finite at
    grazing angles, unlike Smith's function Lambda. Source: Heitz (2014), equations 68 to 72."""
    v, a = as_vec(w), clamped_roughness(alpha)
    squared = jnp.square(v.x * a[0]) + jnp.square(v.y * a[1])
    match distribution:
        case "beckmann":
            t = safe_sqrt(squared)
            tilted = ~(t <= smallest_divisor(t.dtype))
            steepness = v.z / or_one(t, tilted)
            bell = jnp.exp(-jnp.square(steepness)) / (2 * jnp.sqrt(jnp.pi))
            hidden = t * bell - v.z * erfc(steepness) / 2
            return jnp.where(tilted, jnp.maximum(hidden, 0), 0)
        case "ggx":
            root = safe_sqrt(v.z * v.z + squared)
            below = 2 * (root + v.z)
            return divide(squared, below, ~(below <= smallest_divisor(below.dtype)))
        case _:
            raise ValueError(f"distribution must be 'beckmann' or 'ggx', got {distribution!r}.")


def visibility(
    wi: Direction,
    wo: Direction,
    h: Vector,
    alpha: Alpha,
    *,
    distribution: Distribution,
    shadowing: Shadowing,
) -> Scalar:
    """Return the visibility term G / (4 cos(theta_i) cos(theta_o)), no unit, in a form that is
    finite at grazing angles too. Below, c_i and c_o are the cosines, H_i and H_o the values of
    `hidden_cosine`, and d = wo.h:

        smith      G = 1 / (1 + Lambda_i + Lambda_o)
                   1 / (4 (c_i c_o + c_i H_o + c_o H_i))
        v-cavity   G = min(1, 2 h.z c_o / d, 2 h.z c_i / d)
                   1 / (4 max(c_i c_o, c_i d / (2 h.z), c_o d / (2 h.z)))
    """
    c_i, c_o = as_vec(wi).z, as_vec(wo).z
    match shadowing:
        case "smith":
            hidden_i, hidden_o = (
                hidden_cosine(w, alpha, distribution=distribution) for w in (wi, wo)
            )
            below = c_i * c_o + c_i * hidden_o + c_o * hidden_i
        case "v-cavity":
            n = as_vec(h)
            d = dot(as_vec(wo), n) / (2 * divisor(n.z))
            below = jnp.maximum(c_i * c_o, jnp.maximum(c_i, c_o) * d)
        case _:
            raise ValueError(f"shadowing must be 'smith' or 'v-cavity', got {shadowing!r}.")
    return 0.25 / divisor(below)


# ---------------------------------------------------------------- directions


def sample_facet(wo: Direction, alpha: Alpha, u: Float[Array, "2"]) -> Vec:
    """Draw the unit normal of a GGX facet that is visible from `wo`, from two uniform numbers in
    [0, 1) (Heitz, JCGT 7(4) (2018)). Beckmann facets are sampled in the same way, because
    D_beckmann / D_ggx <= 4 / e for the same alpha."""
    v, a = as_vec(wo), clamped_roughness(alpha)
    view = as_vec(normalize(Vec(v.x * a[0], v.y * a[1], v.z)))
    sine = safe_sqrt(view.x * view.x + view.y * view.y)
    tilted = sine > smallest_divisor(sine.dtype)
    side = 1 / divisor(sine)
    t1 = Vec(jnp.where(tilted, -view.y * side, 1), jnp.where(tilted, view.x * side, 0), 0 * view.z)
    t2 = cross(view, t1)
    radius, phi = safe_sqrt(u[0]), 2 * jnp.pi * u[1]
    p1, s = radius * jnp.cos(phi), (1 + view.z) / 2
    p2 = (1 - s) * safe_sqrt(1 - p1 * p1) + s * radius * jnp.sin(phi)
    p3 = safe_sqrt(1 - p1 * p1 - p2 * p2)
    n = p1 * t1 + p2 * t2 + p3 * view
    return as_vec(normalize(Vec(a[0] * n.x, a[1] * n.y, jnp.maximum(n.z, 0))))


def facet_pdf(wi: Direction, wo: Direction, alpha: Alpha) -> Scalar:
    """Return the density, in sr^-1 over the whole sphere, of the direction `wo` mirrored about a
    normal that `sample_facet` draws. The density is D_ggx(h) / (4 (cos(theta_o) + H_o)), where H_o
    is the value of `hidden_cosine`."""
    facets = normal_distribution(half_vector(wi, wo), alpha, distribution="ggx")
    seen = as_vec(wo).z + hidden_cosine(wo, alpha, distribution="ggx")
    return facets / (4 * divisor(seen))
