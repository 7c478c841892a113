"""Common parts of families with a diffuse part and a lobe about one axis. Local frame."""

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
    """The fields of Phong's and Blinn's records. Each record describes its lobe and its convention.

    `diffuse`, `specular`: (bands,); a `specular` of shape (1,) is neutral. `exponent`: () >= 0, no
    unit. `ambient`: (bands,) k_a, no unit, or None.
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
    """Return `value` if the height above the surface is positive, else 0; NaN if the height is
    NaN."""
    return jnp.where(height > 0, value, jnp.where(height <= 0, 0, height))


def where_seen(wi: Direction, wo: Direction, value: Scalars) -> Scalars:
    """Return `value` if both directions lie above the surface, else 0; NaN if one of them is
    NaN."""
    return where_above(jnp.minimum(as_vec(wi).z, as_vec(wo).z), value)


def divisor(cosine: Scalar) -> Scalar:
    """Limit a cosine to at least `smallest_divisor`, to divide by it."""
    return jnp.maximum(cosine, smallest_divisor(cosine.dtype))


def diffuse_share(diffuse: Float[Array, " diffuse"], specular: Float[Array, " specular"]) -> Scalar:
    """Return the share of samples for the diffuse part, in proportion to its albedo; a half if both
    albedos are 0."""
    body, lobe = diffuse.sum() / diffuse.size, specular.sum() / specular.size
    # relative to the larger one, so that the square of a tiny albedo does not underflow
    size = jax.lax.stop_gradient(jnp.maximum(body, lobe))
    scale = reciprocal(size)
    body, lobe = body * scale, lobe * scale
    # written as quotients, so that the derivative near a share of 1 or 0 does not cancel
    brighter = ~(body < lobe)
    mostly = 1 / (1 + lobe / or_one(body, ~(body <= 0.5)))  # the larger one is 1 here
    little = body / or_one(body + lobe, ~(lobe <= 0.5))
    return jnp.where(size <= 0, 0.5, jnp.where(brighter, mostly, little))


def choose(diffuse_part: Scalar, u: Float[Array, "3"], lobe: Vec) -> Vec:
    """Return the lobe's direction, or a cosine-distributed one if u_2 falls into the diffuse
    part."""
    body, diffuse = cosine_direction(u[:2]), u[2] < diffuse_part
    return where(diffuse, body, lobe)


def mixed_pdf(diffuse_part: Scalar, wi: Direction, lobe_pdf: Scalar) -> Scalar:
    """Return the density of `choose`, in the unit of `lobe_pdf`."""
    return diffuse_part * cosine_pdf(wi) + (1 - diffuse_part) * lobe_pdf


def about(axis: Vector, one_minus_cos: Scalar, phi: Scalar) -> Vec:
    """Return the direction at a polar angle, given by 1 - cos, and an azimuth about `axis`."""
    return as_vec(to_world(local_frame(axis), direction_at(one_minus_cos, phi)))


# ---------------------------------------------------------------- lobes above the horizon


def log_cosine(angle: Scalars) -> Scalars:
    """Return log(cos(angle)) for `angle` in [0, pi / 2] rad, and `log_of_zero` at pi / 2. Near 0 it
    uses 1 - cos = 2 sin^2(angle / 2), which keeps the digits that a narrow lobe amplifies."""
    near = angle < 1
    small = log1p(-2 * jnp.square(jnp.sin(jnp.minimum(angle, 1.25) / 2)))
    return jnp.where(near, small, safe_log(jnp.cos(angle)))


_NODES = 48


def circles(
    cos_axis: Scalar, *, width: Scalar, end: float
) -> tuple[tuple[Scalars, Scalars], tuple[Scalars, Scalars], tuple[Scalars, Scalars]]:
    """Return quadrature nodes for circles at angles alpha about an axis, which the horizon may cut.
    theta is the polar angle of the axis, with cos(theta) in [0, 1]. Circles with alpha < pi / 2 -
    theta lie above the horizon. Of larger circles, up to pi / 2 + theta, the part |phi| < phi_m
    lies above it, with cos(phi_m) = -cot(alpha) cot(theta). The result is (alpha, weight) for the
    complete circles, the same for the cut circles, and (p, q) for the cut circles, with p =
    cos(alpha) cos(theta), q = sqrt(sin^2(alpha) sin^2(theta) - p^2) and phi_m = atan2(q, -p). Each
    part ends at `width` from its start, or at `end`. Nodes of the cut circles are transformed by
    sin^2, because phi_m has square-root behaviour at both ends."""
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
    """Return the integrals of lobe(alpha) over directions above the horizon, without and with the
    factor cos(theta_i), in sr:

        int lobe sin(alpha) 2 phi_m dalpha
        int lobe sin(alpha) 2 (phi_m p + q) dalpha

    with phi_m, p and q of `circles` about an axis at theta.
    """
    (inner, inner_weight), (outer, outer_weight), (p, q) = circles(cos_axis, width=width, end=end)
    whole = inner_weight * 2 * jnp.sin(inner) * lobe(inner)
    cut = outer_weight * 2 * jnp.sin(outer) * lobe(outer)
    phi_m = arctan2(q, -p)
    plain = jnp.pi * whole.sum() + (cut * phi_m).sum()
    cosine = jnp.pi * cos_axis * (whole * jnp.cos(inner)).sum() + (cut * (phi_m * p + q)).sum()
    return plain, cosine
