"""Functions for families with a diffuse part and a specular lobe about one axis, in the local
frame."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._numerics import (
    arctan2,
    log1p,
    or_one,
    reciprocal,
    safe_log,
    safe_sqrt,
    smallest_divisor,
)
from ..core._quadrature import gauss_legendre
from ..core._types import AMOUNT, Colour, Scalar, Scalars, as_float, as_optional_float, check_fields
from ..core._vector import Direction, Vec, Vector, as_vec, where
from ..geometry.hemisphere import cosine_direction, cosine_pdf, direction_at, local_frame, to_world
from ..scene import Material

ColourOrNeutral = Colour | Float[Array, "1"]


class PowerLobe(Material):
    """The fields that the records of Phong and Blinn have in common.

    `diffuse`, `specular`: (bands,); a `specular` of shape (1,) applies to all bands. `exponent`: ()
    >= 0, no unit. `ambient`: (bands,) k_a, no unit, or None.
    """

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    specular: ColourOrNeutral = eqx.field(converter=as_float)
    exponent: Scalar = eqx.field(converter=as_float)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, diffuse=AMOUNT, specular=AMOUNT, exponent=AMOUNT, ambient=AMOUNT)


def mirrored(w: Vector) -> Vec:
    """Mirror `w` about the normal: (-x, -y, z)."""
    v = as_vec(w)
    return Vec(-v.x, -v.y, v.z)


def where_above(height: Scalar, value: Scalars) -> Scalars:
    """Return `value` if `height`, the z component of a direction, is positive, else 0; NaN if
    `height` is NaN."""
    return jnp.where(height > 0, value, jnp.where(height <= 0, 0, height))


def where_seen(wi: Direction, wo: Direction, value: Scalars) -> Scalars:
    """Return `value` if light and viewer are above the surface, else 0; NaN if one of them is
    NaN."""
    return where_above(jnp.minimum(as_vec(wi).z, as_vec(wo).z), value)


def divisor(cosine: Scalar) -> Scalar:
    """Return the cosine, raised to at least `smallest_divisor` so that division by it is safe."""
    return jnp.maximum(cosine, smallest_divisor(cosine.dtype))


def diffuse_share(diffuse: Float[Array, " diffuse"], specular: Float[Array, " specular"]) -> Scalar:
    """Return the probability of sampling the diffuse part: its share of the total albedo, or 1/2 if
    both albedos are 0."""
    body, lobe = diffuse.sum() / diffuse.size, specular.sum() / specular.size
    # divided by the larger albedo, so that the square of a tiny albedo does not underflow
    size = jax.lax.stop_gradient(jnp.maximum(body, lobe))
    scale = reciprocal(size)
    body, lobe = body * scale, lobe * scale
    # written as quotients, so that the derivative near a share of 1 or 0 does not cancel
    brighter = ~(body < lobe)
    mostly = 1 / (1 + lobe / or_one(body, ~(body <= 0.5)))  # the larger albedo is now 1
    little = body / or_one(body + lobe, ~(lobe <= 0.5))
    return jnp.where(size <= 0, 0.5, jnp.where(brighter, mostly, little))


def choose(diffuse_part: Scalar, u: Float[Array, "3"], lobe: Vec) -> Vec:
    """Return a cosine-distributed direction if u_2 < `diffuse_part`, else the direction `lobe`."""
    body, diffuse = cosine_direction(u[:2]), u[2] < diffuse_part
    return where(diffuse, body, lobe)


def mixed_pdf(diffuse_part: Scalar, wi: Direction, lobe_pdf: Scalar) -> Scalar:
    """Return the density of the directions that `choose` returns, in sr^-1."""
    return diffuse_part * cosine_pdf(wi) + (1 - diffuse_part) * lobe_pdf


def about(axis: Vector, one_minus_cos: Scalar, phi: Scalar) -> Vec:
    """Return the direction at the azimuth `phi` about `axis`, whose angle to the axis is given as 1
    - cos."""
    return as_vec(to_world(local_frame(axis), direction_at(one_minus_cos, phi)))


# ---------------------------------------------------------------- lobes above the horizon


def log_cosine(angle: Scalars) -> Scalars:
    """Return log(cos(angle)) for `angle` in [0, pi / 2] rad, and `log_of_zero` at pi / 2. Near 0 it
    is computed from 1 - cos = 2 sin^2(angle / 2), because a narrow lobe amplifies rounding
    errors."""
    near = angle < 1
    small = log1p(-2 * jnp.square(jnp.sin(jnp.minimum(angle, 1.25) / 2)))
    return jnp.where(near, small, safe_log(jnp.cos(angle)))


_NODES = 48


def circles(
    cos_axis: Scalar, *, width: Scalar, end: float
) -> tuple[tuple[Scalars, Scalars], tuple[Scalars, Scalars], tuple[Scalars, Scalars]]:
    """Return quadrature nodes for circles at angles alpha about a lobe's axis, some of which are
    cut by the horizon. The axis has the polar angle theta, with cos(theta) in [0, 1]. Circles with
    alpha < pi / 2 - theta lie above the horizon. Of larger circles, up to pi / 2 + theta, the arc
    |phi| < phi_m lies above the horizon, with cos(phi_m) = -cot(alpha) cot(theta). The result is
    (alpha, weight) of the complete circles, (alpha, weight) of the cut circles, and (p, q) of the
    cut circles, with p = cos(alpha) cos(theta), q = sqrt(sin^2(alpha) sin^2(theta) - p^2) and phi_m
    = atan2(q, -p). Both ranges of alpha are at most `width` long, and the second does not extend
    beyond `end`. Nodes of the cut circles are transformed by sin^2, because phi_m behaves like a
    square root at both ends."""
    t, dt = gauss_legendre(_NODES)
    ease, d_ease = np.sin(np.pi / 2 * t) ** 2, np.pi / 2 * np.sin(np.pi * t) * dt
    t, dt, ease, d_ease = (jnp.asarray(a, cos_axis.dtype) for a in (t, dt, ease, d_ease))
    c = jnp.clip(cos_axis, 0, 1)
    s = safe_sqrt((1 - c) * (1 + c))
    start = arctan2(c, s)  # pi / 2 - theta
    whole = jnp.minimum(start, width)
    cut = jnp.minimum(jnp.minimum(jnp.pi - 2 * start, end - start), width)
    alpha = start + cut * ease
    p = jnp.cos(alpha) * c
    q = safe_sqrt(jnp.sin(cut * ease) * jnp.sin(start + alpha))
    return (whole * t, whole * dt), (alpha, cut * d_ease), (p, q)


def lobe_integrals(
    lobe: Callable[[Scalars], Scalars], cos_axis: Scalar, *, width: Scalar, end: float
) -> tuple[Scalar, Scalar]:
    """Return two integrals of lobe(alpha) over directions above the horizon, without and with the
    factor cos(theta_i), in sr:

        int lobe sin(alpha) 2 phi_m dalpha
        int lobe sin(alpha) 2 (phi_m p + q) dalpha

    `circles` defines phi_m, p and q.
    """
    (inner, inner_weight), (outer, outer_weight), (p, q) = circles(cos_axis, width=width, end=end)
    whole = inner_weight * 2 * jnp.sin(inner) * lobe(inner)
    cut = outer_weight * 2 * jnp.sin(outer) * lobe(outer)
    phi_m = arctan2(q, -p)
    plain = jnp.pi * whole.sum() + (cut * phi_m).sum()
    cosine = jnp.pi * cos_axis * (whole * jnp.cos(inner)).sum() + (cut * (phi_m * p + q)).sum()
    return plain, cosine
