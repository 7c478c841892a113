"""Measured BRDFs, as samples at arbitrary pairs of directions or as tables over the angles.

A table contains f_r(theta_i, phi_i, theta_o, phi_o; lambda) at the nodes of a grid, or the
isotropic f_r(theta_i, theta_o, phi_o - phi_i; lambda). Between nodes f_r is linear in each angle.
`outside` determines f_r at polar angles beyond the outermost nodes: the angles are clamped, f_r is
extrapolated from the last two nodes (never below 0), or f_r is 0. Azimuths are periodic.
Measurements are not exactly reciprocal. If `reciprocal` is true, the BRDF is the mean of the
tabulated f_r(wi, wo) and f_r(wo, wi). Interpolation over these angles blurs narrow lobes between
nodes. If the nodes are more than a lobe's width apart, `half_difference` resolves them better.

The index `i` stands for the direction toward the light, `o` for the direction toward the viewer. In
the local frame the normal is +z. Angles are in rad, wavelengths in m, and f_r is in sr^-1 without
the cosine of incidence.
"""

from typing import Literal, TypeVar, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._shown import Shown
from ..core._types import Colour, as_float, as_optional_float, check_choice, check_fields
from ..core._vector import Direction, Vec, as_vec
from ..scene import Material
from ._half_vector import azimuth, elevation, spherical
from ._interpolation import Place, around_circle, interpolation_weights, multilinear
from ._lobe import where_seen
from ._lobe_sampler import LobeSampler, albedo, pdf, sample, table_bound, tabulated_lobe
from ._registry import family, register

Outside = Literal["clamp", "extrapolate", "zero"]


class BRDFSamples(Shown):
    """BRDF values measured at arbitrary pairs of directions, for example by a goniometer.

    Attributes:
        theta_i: (n,) polar angle of the light, rad.
        phi_i: (n,) azimuth of the light, rad.
        theta_o: (n,) polar angle of the viewer, rad.
        phi_o: (n,) azimuth of the viewer, rad.
        values: (n, bands) f_r in sr^-1.
        wavelengths: (bands,) m, or None where bands are not wavelengths (RGB).

    Example:
        Both samples are lit at normal incidence, and the second is seen at 0.5 rad.

        >>> samples = jv.BRDFSamples([0, 0], [0, 0], [0, 0.5], [0, np.pi], [[0.1], [0.3]])
        >>> wi, wo = jv.sample_directions(samples)
        >>> [round(float(angle), 4) for angle in jv.angle_between(wi, wo)]
        [0.0, 0.5]
    """

    theta_i: Float[Array, " n"] = eqx.field(converter=as_float)
    phi_i: Float[Array, " n"] = eqx.field(converter=as_float)
    theta_o: Float[Array, " n"] = eqx.field(converter=as_float)
    phi_o: Float[Array, " n"] = eqx.field(converter=as_float)
    values: Float[Array, "n bands"] = eqx.field(converter=as_float)
    wavelengths: Float[Array, " bands"] | None = eqx.field(
        converter=as_optional_float, default=None
    )

    def __check_init__(self) -> None:
        check_fields(self)


class IsotropicTable(Material):
    """An isotropic BRDF tabulated over (theta_i, theta_o, phi_o - phi_i).

    Attributes:
        theta_i: (a,) rad, increasing.
        theta_o: (b,) rad, increasing.
        phi: (c,) rad, increasing.
        values: (a, b, c, bands) f_r in sr^-1.
        wavelengths: (bands,) m, or None.
        sampler: distribution from which `sample` draws, see `tabulate_sampler`; None for the
            cosine.
        azimuths: "mirrored": nodes of `phi` lie within [0, pi], for a BRDF that is symmetric under
            phi -> -phi; "full": within one turn. Static.
        outside: value at angles beyond the nodes: "clamp", "extrapolate" or "zero"; static.
        reciprocal: whether to average over both orders of the directions; static.

    Example:
        The value is 0 for a viewer along the normal and 1 at 90 degrees, so it is 0.5 at 45
        degrees.

        >>> values, ends = np.zeros((2, 2, 2, 1)), [0, np.pi / 2]
        >>> values[:, 1] = 1
        >>> table = jv.IsotropicTable(ends, ends, [0, np.pi], values)
        >>> round(float(jv.brdf.at_angles(table, 0.0, 0.0, np.pi / 4, 0.0)[0]), 4)
        0.5
    """

    theta_i: Float[Array, " a"] = eqx.field(converter=as_float)
    theta_o: Float[Array, " b"] = eqx.field(converter=as_float)
    phi: Float[Array, " c"] = eqx.field(converter=as_float)
    values: Float[Array, "a b c bands"] = eqx.field(converter=as_float)
    wavelengths: Float[Array, " bands"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    sampler: LobeSampler | None = eqx.field(default=None, kw_only=True)
    azimuths: Literal["mirrored", "full"] = eqx.field(static=True, default="mirrored", kw_only=True)
    outside: Outside = eqx.field(static=True, default="clamp", kw_only=True)
    reciprocal: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self)
        check_choice("IsotropicTable.azimuths", self.azimuths, ("mirrored", "full"))
        check_choice("IsotropicTable.outside", self.outside, get_args(Outside))


class AnisotropicTable(Material):
    """An anisotropic BRDF tabulated over (theta_i, phi_i, theta_o, phi_o).

    Attributes:
        theta_i: (a,) rad, increasing.
        phi_i: (b,) rad, increasing, within one turn.
        theta_o: (c,) rad, increasing.
        phi_o: (d,) rad, increasing, within one turn.
        values: (a, b, c, d, bands) f_r in sr^-1.
        wavelengths: (bands,) m, or None.
        sampler: distribution from which `sample` draws, see `tabulate_sampler`; None for the
            cosine.
        outside: value at angles beyond the nodes: "clamp", "extrapolate" or "zero"; static.
        reciprocal: whether to average over both orders of the directions; static.

    Example:
        >>> values, ends, turn = np.zeros((2, 2, 2, 2, 1)), [0, np.pi / 2], [0, np.pi]
        >>> values[:, :, :, 1] = 1  # of viewers on one side
        >>> table = jv.AnisotropicTable(ends, turn, ends, turn, values)
        >>> angles = 0.0, np.pi / 2, np.pi
        >>> [round(float(jv.brdf.at_angles(table, 0.5, 0.0, 0.5, phi)[0]), 4) for phi in angles]
        [0.0, 0.5, 1.0]
    """

    theta_i: Float[Array, " a"] = eqx.field(converter=as_float)
    phi_i: Float[Array, " b"] = eqx.field(converter=as_float)
    theta_o: Float[Array, " c"] = eqx.field(converter=as_float)
    phi_o: Float[Array, " d"] = eqx.field(converter=as_float)
    values: Float[Array, "a b c d bands"] = eqx.field(converter=as_float)
    wavelengths: Float[Array, " bands"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    sampler: LobeSampler | None = eqx.field(default=None, kw_only=True)
    outside: Outside = eqx.field(static=True, default="clamp", kw_only=True)
    reciprocal: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self)
        check_choice("AnisotropicTable.outside", self.outside, get_args(Outside))


AngleTable = IsotropicTable | AnisotropicTable


def _is_inside(nodes: Float[Array, " n"], x: Float[Array, ""]) -> Array:
    return (x >= nodes[0]) & (x <= nodes[-1])


def _places(table: AngleTable, wi: Vec, wo: Vec) -> tuple[Place, ...]:
    beyond = "extrapolate" if table.outside == "extrapolate" else "clamp"
    i = interpolation_weights(table.theta_i, elevation(wi), outside=beyond)
    o = interpolation_weights(table.theta_o, elevation(wo), outside=beyond)
    if isinstance(table, AnisotropicTable):
        return (
            i,
            around_circle(table.phi_i, azimuth(wi)),
            o,
            around_circle(table.phi_o, azimuth(wo)),
        )
    # The azimuth between wi and wo, from products of their components, which needs no wrapping.
    between = azimuth(Vec(wi.x * wo.x + wi.y * wo.y, wi.x * wo.y - wi.y * wo.x, wi.z))
    if table.azimuths == "full":
        return i, o, around_circle(table.phi, between)
    return i, o, interpolation_weights(table.phi, jnp.abs(between))


def _looked_up(table: AngleTable, wi: Vec, wo: Vec) -> Colour:
    value = multilinear(table.values, *_places(table, wi, wo))
    if table.outside == "clamp":
        return value
    if table.outside == "extrapolate":
        return jnp.maximum(value, 0)
    covered = _is_inside(table.theta_i, elevation(wi)) & _is_inside(table.theta_o, elevation(wo))
    return jnp.where(covered, value, 0)


def evaluate(material: AngleTable, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1; 0 if either direction lies below the surface. `wi`
    and `wo` are unit vectors in the local frame."""
    wi, wo = as_vec(wi), as_vec(wo)
    value = _looked_up(material, wi, wo)
    if material.reciprocal:
        value = (value + _looked_up(material, wo, wi)) / 2
    return where_seen(wi, wo, value)


for _record in (IsotropicTable, AnisotropicTable):
    register(
        _record,
        evaluate=evaluate,
        sample=sample,
        pdf=pdf,
        albedo=albedo,
        bound=table_bound,
        word="",
        isotropic=_record is IsotropicTable,
    )

Table = TypeVar("Table", bound=Material)


def tabulate_sampler(
    material: Table, *, thetas: int = 16, phis: int = 1, rows: int = 33, columns: int = 91
) -> Table:
    """Return the table with a sampler that draws directions in proportion to its shading, averaged
    over bands. The sampler is tabulated at `thetas` polar angles and `phis` azimuths of `wo`,
    equally spaced in rad, and at rows x columns half vectors; all four numbers are static. Without
    a sampler, `sample` draws cosine-distributed directions."""
    dtype = jnp.result_type(*jax.tree.leaves(material))
    theta = jnp.linspace(0, 0.999 * jnp.pi / 2, thetas, dtype=dtype)
    phi = jnp.linspace(-jnp.pi, jnp.pi, phis, dtype=dtype) if phis > 1 else jnp.zeros(1, dtype)
    sampler = tabulated_lobe(material, phi, theta, rows, columns)
    return eqx.tree_at(
        lambda record: record.sampler, material, sampler, is_leaf=lambda leaf: leaf is None
    )


def sample_directions(samples: BRDFSamples) -> tuple[Vec, Vec]:
    """Return the light and viewing directions of measured BRDF samples.

    Args:
        samples: measured values at scattered angles, rad.

    Returns:
        (wi, wo), components (n,): unit, local.

    Example:
        >>> samples = jv.BRDFSamples([np.pi / 6], [0], [np.pi / 3], [np.pi], [[0.1]])
        >>> wi, wo = jv.sample_directions(samples)
        >>> [round(float(x), 4) for x in (wi.x[0], wi.z[0], wo.x[0], wo.z[0])]
        [0.5, 0.866, -0.866, 0.5]
    """
    return spherical(samples.theta_i, samples.phi_i), spherical(samples.theta_o, samples.phi_o)


@takes_numbers
def samples_of(
    material: Material,
    theta_i: Float[Array, " a"],
    theta_o: Float[Array, " b"],
    phi_o: Float[Array, " c"],
    *,
    phi_i: Float[Array, " d"] | None = None,
) -> BRDFSamples:
    """Evaluate f_r (without the cosine) of any material on a grid of angles, as samples to fit.

    The samples are all a * d * b * c combinations of the angles. The index of theta_i varies most
    slowly, followed by the indices of phi_i, theta_o and phi_o. `values.reshape(a, b, c, bands)`
    has the order of an `IsotropicTable` over phi_o, and `values.reshape(a, d, b, c, bands)` that of
    an `AnisotropicTable`.

    Args:
        material: any material with a BRDF in sr^-1.
        theta_i: (a,) rad.
        theta_o: (b,) rad.
        phi_o: (c,) rad.
        phi_i: (d,) rad; 0 by default.

    Returns:
        The samples, (a d b c, bands) in sr^-1.

    Example:
        >>> theta, phi = jnp.array([0.0, 0.5]), jnp.array([0.0, 1.0, 2.0])
        >>> samples = jv.samples_of(jv.Lambert([0.25]), theta, theta, phi)
        >>> samples.values.shape, float(samples.values.mean())
        ((12, 1), 0.25)
    """
    phi_i = jnp.zeros_like(theta_i[:1]) if phi_i is None else phi_i
    grid = jnp.meshgrid(theta_i, phi_i, theta_o, phi_o, indexing="ij")
    theta_i, phi_i, theta_o, phi_o = (axis.reshape(-1) for axis in grid)
    wi, wo = spherical(theta_i, phi_i), spherical(theta_o, phi_o)
    values = jax.vmap(family(material).evaluate, (None, 0, 0))(material, wi, wo)
    wavelengths = getattr(material, "wavelengths", None)
    return BRDFSamples(theta_i, phi_i, theta_o, phi_o, values, wavelengths)
