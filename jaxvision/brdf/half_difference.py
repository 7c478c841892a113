"""Half and difference angles, and the isotropic BRDF tabulated over them (the MERL layout).

The half vector h = (wi + wo) / |wi + wo| has angles (theta_h, phi_h). A rotation by -phi_h about z
and then by -theta_h about y takes h to the normal. The same rotation takes `wi` to the difference
vector, with angles (theta_d, phi_d). The angle theta_d is half the angle between `wi` and `wo`.
Exchanging `wi` and `wo` adds pi to phi_d. Reflecting both directions in the plane through h and the
normal changes the sign of phi_d. Source: Rusinkiewicz, "A New Change of Variables for Efficient
BRDF Representation", 1998.

The table has (n_h, n_d, n_p) bins over theta_h in [0, pi / 2], theta_d in [0, pi / 2] and phi_d in
[0, pi). Bin i of theta_h starts at (i / n_h)^2 pi / 2, so that bins are narrow near the normal,
where lobes are concentrated. The bins of theta_d and phi_d have equal width. The angle phi_d is
taken modulo pi, so the table is reciprocal by construction. Each value of the table is the BRDF at
the centre of its bin. Beyond the centres of the outermost bins the BRDF is constant. Values are in
sr^-1, angles in radians. Source of the layout: Matusik, Pfister, Brand, McMillan, "A Data-Driven
Reflectance Model", 2003, and the reference reader published with it.
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._kinds import Measured
from ..core._numerics import dot, normalize, or_one, safe_sqrt
from ..core._shown import Shown
from ..core._types import Colour, Scalar, as_float, as_optional_float, check_choice, check_fields
from ..core._vector import Direction, Vec, as_vec
from ..scene import Material
from ._half_vector import azimuth, elevation, elevation_to_unit, spherical
from ._interpolation import bin_centre_position, containing_bin, multilinear
from ._lobe import where_seen
from ._lobe_sampler import LobeSampler, albedo, pdf, sample, table_bound
from ._registry import register


class HalfDifference(Shown):
    """The angles of the half vector, and the angles of `wi` relative to the half vector.

    Attributes:
        theta_h: () of the half vector, rad.
        phi_h: () of the half vector, rad.
        theta_d: () of `wi` about the half vector, rad.
        phi_d: () of `wi` about the half vector, rad.
    """

    theta_h: Scalar
    phi_h: Scalar
    theta_d: Scalar
    phi_d: Scalar


def _rotate(w: Vec, theta: Scalar, phi: Scalar) -> Vec:
    """Rotate `w` by theta about y and then by phi about z, a rotation that takes +z to the
    direction with polar angle theta and azimuth phi."""
    c, s = jnp.cos(theta), jnp.sin(theta)
    x, z = c * w.x + s * w.z, c * w.z - s * w.x
    c, s = jnp.cos(phi), jnp.sin(phi)
    return Vec(c * x - s * w.y, s * x + c * w.y, z)


def half_difference(wi: Direction, wo: Direction) -> HalfDifference:
    """Return the half and difference angles of two unit vectors of the local frame, rad: theta in
    [0, pi / 2], phi in [-pi, pi]. If h is the normal, phi_h is 0; for wi = wo, phi_d is 0."""
    wi, wo = as_vec(wi), as_vec(wo)
    h = as_vec(normalize(wi + wo))
    sin_h = safe_sqrt(h.x * h.x + h.y * h.y)
    aside = sin_h > 0
    scale = 1 / or_one(sin_h)
    cos_phi, sin_phi = jnp.where(aside, h.x * scale, 1), jnp.where(aside, h.y * scale, 0)
    # Half of wi - wo is the part of wi across h, without the rounding error of the part along h.
    across = (wi - wo) * jnp.asarray(0.5, wi.x.dtype)
    x = cos_phi * across.x + sin_phi * across.y
    y = cos_phi * across.y - sin_phi * across.x
    d = Vec(h.z * x - sin_h * across.z, y, dot(wi, h))
    return HalfDifference(elevation(h), azimuth(h), elevation(d), azimuth(d))


def from_half_difference(angles: HalfDifference) -> tuple[Vec, Vec]:
    """Return (wi, wo) for half and difference angles in rad, the inverse of `half_difference`.
    Either direction may lie below the surface."""
    d = spherical(angles.theta_d, angles.phi_d)
    opposite = Vec(-d.x, -d.y, d.z)
    return (
        _rotate(d, angles.theta_h, angles.phi_h),
        _rotate(opposite, angles.theta_h, angles.phi_h),
    )


class HalfDifferenceTable(Material):
    """An isotropic BRDF tabulated over half and difference angles.

    Attributes:
        values: (n_h, n_d, n_p, bands) sr^-1; 90 x 90 x 180 in MERL files.
        wavelengths: (bands,) m, or None for RGB.
        sampler: distribution from which `sample` draws; None for the cosine distribution.
        interpolation: "linear" between the centres of bins, or "nearest", which takes the bin
            itself, as the reference reader does; static.

    Example:
        >>> up, aside = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> flat = jv.HalfDifferenceTable(np.full((2, 2, 2, 1), 0.25))
        >>> round(float(jv.reflect(flat, up, aside, up)[0]), 4)  # 0.25 x 0.8
        0.2
    """

    values: Float[Array, "n_h n_d n_p bands"] = eqx.field(converter=as_float)
    wavelengths: Float[Array, " bands"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    sampler: LobeSampler | None = eqx.field(default=None, kw_only=True)
    interpolation: Literal["linear", "nearest"] = eqx.field(
        static=True, default="linear", kw_only=True
    )

    def __check_init__(self) -> None:
        check_fields(self)
        words = ("linear", "nearest")
        check_choice("HalfDifferenceTable.interpolation", self.interpolation, words)


def bin_angles(
    table: HalfDifferenceTable,
) -> tuple[Float[Array, " n_h"], Float[Array, " n_d"], Float[Array, " n_p"]]:
    """Return theta_h, theta_d and phi_d in rad at the centres of the table's bins."""
    h, d, p = ((jnp.arange(n, dtype=table.values.dtype) + 0.5) / n for n in table.values.shape[:3])
    return jnp.square(h) * (jnp.pi / 2), d * (jnp.pi / 2), p * jnp.pi


def evaluate(material: HalfDifferenceTable, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1; 0 if either direction lies below the surface. `wi`
    and `wo` are unit vectors in the local frame."""
    wi, wo = as_vec(wi), as_vec(wo)
    angles = half_difference(wi, wo)
    n_h, n_d, n_p, _ = material.values.shape
    h, d = elevation_to_unit(angles.theta_h), angles.theta_d * (2 / jnp.pi)
    p = angles.phi_d * (1 / jnp.pi)
    p = p - jnp.floor(p)
    if material.interpolation == "nearest":
        places = containing_bin(h, n_h), containing_bin(d, n_d), containing_bin(p, n_p)
    else:
        places = (
            bin_centre_position(h, n_h),
            bin_centre_position(d, n_d),
            bin_centre_position(p, n_p, periodic=True),
        )
    return where_seen(wi, wo, multilinear(material.values, *places))


def _from_file(*, file: Measured) -> Material:
    """A measured BRDF.

    Args:
        file: path of the measurement, relative to the scene file.
    """
    from .measured import tabulate_sampler

    return tabulate_sampler(file) if isinstance(file, HalfDifferenceTable) else file


register(
    HalfDifferenceTable,
    evaluate=evaluate,
    sample=sample,
    pdf=pdf,
    albedo=albedo,
    bound=table_bound,
    word="measured",
    from_file=_from_file,
    isotropic=True,
)
