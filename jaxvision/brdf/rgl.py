"""Materials of the EPFL RGL material database, in its adaptive parameterization.

For each node (theta, phi) of the direction `wo`, a file stores the values in

    f_r cos(theta_i) = values(s) ndf(h) / (4 sigma(wo)),    s = vndf^-1(h)

The material's distribution of visible normals, `vndf`, maps positions s of the unit square to half
vectors h, so that a small grid resolves narrow and wide lobes. `ndf` is the distribution of facet
normals, and sigma the projected area of the facets. `luminance` is the density of the reflected
light over s. To sample the material, uniform numbers are mapped to positions s by `luminance`, and
these to half vectors by `vndf`. Source: Dupuy & Jakob, "An Adaptive Parameterization for Efficient
Material Acquisition and Rendering", 2018, equations 6, 7 and 13.

The tabulated direction is that of `wo` here, as in other renderers, because a path starts at the
eye and samples `wi`. In the measurement it was the direction of the light, so this use assumes
reciprocity. A stored value contains the cosine of the OTHER direction, theta_i. `shading` therefore
returns the stored value, and `evaluate` divides it by cos(theta_i). Polar angles extend to pi / 2.
Negative stored values (colours out of gamut) count as 0. Units: radiance ratios in sr^-1, angles in
radians.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._bounds import Ends, Reflection
from ..core._numerics import divide, dot, normalize, or_one, smallest_divisor
from ..core._types import Colour, Scalar, as_float, as_optional_float, check_fields, check_shape
from ..core._vector import Direction, Vec, as_vec
from ..scene import Material
from ._half_vector import (
    azimuth,
    azimuth_to_unit,
    elevation,
    elevation_to_unit,
    half_to_square,
    reflected,
    square_to_half,
    stretch,
)
from ._interpolation import multilinear, place_in_unit
from ._lobe import where_above
from ._registry import register
from ._warp import Slices, Square, Warp, bilinear, slices, tabulated_warp, unwarp, warp


class RGL(Material):
    """A material of the RGL database, isotropic if `phi` has one or two nodes.

    Attributes:
        theta: (t,) rad, increasing, grid of polar angles of `wo`.
        phi: (p,) rad, increasing, grid of azimuths of `wo`.
        values: (p, t, n, n, bands) f_r cos(theta_i) over the unit square, or one factor of it if
            `scaled` is true.
        ndf: (rows, columns) over the square of half vectors, no unit.
        sigma: (rows, columns) over the square of directions, no unit.
        vndf: warp of the unit square for each (phi, theta).
        luminance: warp of the unit square for each (phi, theta).
        wavelengths: (bands,) m, or None for RGB.
        scaled: whether `values` must be multiplied by ndf / (4 sigma) (the file's `jacobian`);
            static.
        symmetry: number of equal azimuth sectors of `wo`; the grid covers one of them; static.

    Example:
        >>> from jaxvision.brdf.rgl import rgl_material
        >>> theta, one = jnp.array([0.0, np.pi / 2]), jnp.ones((1, 2, 2, 2))
        >>> flat = rgl_material(theta, jnp.zeros(1), one[..., None], one[0, 0], one[0, 0], one, one)
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> round(float(jv.reflect(flat, up, up, up)[0]), 4)  # ndf / (4 sigma)
        0.25
    """

    theta: Float[Array, " t"] = eqx.field(converter=as_float)
    phi: Float[Array, " p"] = eqx.field(converter=as_float)
    values: Float[Array, "p t n n bands"] = eqx.field(converter=as_float)
    ndf: Float[Array, "ndf_rows ndf_columns"] = eqx.field(converter=as_float)
    sigma: Float[Array, "sigma_rows sigma_columns"] = eqx.field(converter=as_float)
    vndf: Warp
    luminance: Warp
    wavelengths: Float[Array, " bands"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    scaled: bool = eqx.field(static=True, default=True, kw_only=True)
    symmetry: int = eqx.field(static=True, default=1, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self)
        nodes = (len(self.phi), len(self.theta))
        check_shape("RGL.vndf.density", self.vndf.density, (*nodes, "rows", "columns"))
        check_shape("RGL.luminance.density", self.luminance.density, (*nodes, "rows", "columns"))
        if self.symmetry not in (1, 2, 4):
            raise ValueError(f"RGL.symmetry must be 1, 2 or 4, got {self.symmetry}.")


@takes_numbers
def rgl_material(
    theta: Float[Array, " t"],
    phi: Float[Array, " p"],
    values: Float[Array, "p t n n bands"],
    ndf: Float[Array, "ndf_rows ndf_columns"],
    sigma: Float[Array, "sigma_rows sigma_columns"],
    vndf: Float[Array, "p t rows columns"],
    luminance: Float[Array, "p t n n"],
    *,
    wavelengths: Float[Array, " bands"] | None = None,
    scaled: bool = True,
    symmetry: int = 1,
) -> RGL:
    """Make an `RGL` material from the tables of a file, with angles in rad. `vndf` and `luminance`
    are densities over the unit square, which need not be normalised."""
    return RGL(
        theta,
        phi,
        values,
        ndf,
        sigma,
        tabulated_warp(phi, theta, vndf),
        tabulated_warp(phi, theta, luminance),
        wavelengths=wavelengths,
        scaled=scaled,
        symmetry=symmetry,
    )


def _unfold(material: RGL, wi: Vec, wo: Vec) -> tuple[Vec, Vec]:
    """Rotate or mirror `wi` and `wo` together so that `wo` is in the tabulated sector of
    azimuths."""

    def flip(w: Vec) -> Vec:
        y = jnp.where(wo.y > 0, -w.y, w.y)
        along = wo.x if material.symmetry == 4 else wo.y
        return Vec(jnp.where(along > 0, -w.x, w.x), y, w.z)

    return (wi, wo) if material.symmetry == 1 else (flip(wi), flip(wo))


def _view_terms(material: RGL, wo: Vec) -> tuple[Slices, Scalar, Square]:
    """Return three values for the viewing direction `wo`: the interpolation weights of the
    tabulated directions, the azimuth to which half vectors are relative, and the position of `wo`
    in the unit square of directions."""
    theta, phi = elevation(wo), azimuth(wo)
    origin = phi if len(material.phi) <= 2 else jnp.zeros_like(phi)
    place = elevation_to_unit(theta), azimuth_to_unit(phi)
    return slices(material.vndf, phi, theta), origin, place


def _interpolate_square(table: Float[Array, "rows columns"], place: Square) -> Scalar:
    """Interpolate a table over the unit square bilinearly to (x, y)."""
    rows, columns = table.shape
    return multilinear(table, place_in_unit(place[1], rows), place_in_unit(place[0], columns))


def _reflected_by(
    material: RGL, at: Slices, s: Square, h_place: Square, wo_place: Square
) -> Colour:
    """Return values(s) ndf(h) / (4 sigma(wo)), (bands,) in sr^-1, from the positions of s, h and
    `wo` in their unit squares."""
    value = jnp.maximum(bilinear(material.values, at, s), 0)
    if not material.scaled:
        return value
    ndf, sigma = (
        _interpolate_square(material.ndf, h_place),
        _interpolate_square(material.sigma, wo_place),
    )
    return jnp.where(sigma <= 0, 0, value * (ndf / (4 * or_one(sigma))))


def shading(material: RGL, wi: Direction, wo: Direction) -> Colour:
    """Return f_r cos(theta_i), the tabulated quantity, (bands,) in sr^-1; 0 if either direction is
    below the surface. `wi` and `wo` are unit vectors in the local frame.
    """
    wi, wo = as_vec(wi), as_vec(wo)
    height = jnp.minimum(wi.z, wo.z)
    wi, wo = _unfold(material, wi, wo)
    at, origin, wo_place = _view_terms(material, wo)
    h_place = half_to_square(as_vec(normalize(wi + wo)), origin)
    s, _ = unwarp(material.vndf, at, h_place)
    return where_above(height, _reflected_by(material, at, s, h_place, wo_place))


def evaluate(material: RGL, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1; 0 if either direction lies below the surface or on
    the horizon. `wi` and `wo` are unit vectors in the local frame."""
    cos_i = as_vec(wi).z
    below = cos_i <= smallest_divisor(cos_i.dtype)
    return divide(shading(material, wi, wo), cos_i, where=~below)


def sample(material: RGL, wo: Direction, u: Float[Array, "3"]) -> Vec:
    """Draw a unit local direction in proportion to the luminance reflected toward `wo`, with the
    first two of the uniform numbers `u`, (3,). A direction below the surface (at the edge of the
    tables) reflects nothing."""
    wo = as_vec(wo)
    _, turned = _unfold(material, wo, wo)
    at, origin, _ = _view_terms(material, turned)
    s, _ = warp(material.luminance, at, (u[1], u[0]))
    place, _ = warp(material.vndf, at, s)
    wi = reflected(turned, square_to_half(place, origin))
    return _unfold(material, wi, wo)[0]  # flipping a second time undoes the flips


def pdf(material: RGL, wi: Direction, wo: Direction) -> Scalar:
    """Return the density of the directions that `sample` draws, in sr^-1 over the whole sphere; 0
    if `wo` is below the surface.
    """
    wi, wo = _unfold(material, as_vec(wi), as_vec(wo))
    at, origin, _ = _view_terms(material, wo)
    h = as_vec(normalize(wi + wo))
    place = half_to_square(h, origin)
    s, visible = unwarp(material.vndf, at, place)
    area = stretch(place[0], h, wo)
    unseen = (wo.z <= 0) | (h.z <= 0) | (area <= smallest_divisor(area.dtype))
    density = visible * bilinear(material.luminance.density, at, s)
    return divide(density, area, where=~unseen)


def albedo(material: RGL, wo: Direction, *, order: int = 64) -> Colour:
    """Return the share of uniform surrounding light that is reflected to `wo`, (bands,), no unit.

    The integral of f_r cos(theta_i) over the hemisphere is computed by the midpoint rule with order
    x order nodes in s. The integrand is smooth in s, because `vndf` maps s to the lobe.
    """
    wo = as_vec(wo)
    _, turned = _unfold(material, wo, wo)
    at, origin, wo_place = _view_terms(material, turned)
    nodes = (jnp.arange(order, dtype=wo.z.dtype) + 0.5) / order

    def weight(x: Scalar, y: Scalar) -> Colour:
        place, density = warp(material.vndf, at, (x, y))
        h = square_to_half(place, origin)
        behind = (reflected(turned, h).z <= 0) | (dot(turned, h) <= 0) | (density <= 0)
        area = stretch(place[0], h, turned) / or_one(density)
        return jnp.where(behind, 0, _reflected_by(material, at, (x, y), place, wo_place) * area)

    rows = jax.vmap(jax.vmap(weight, (None, 0)), (0, None))(nodes, nodes)
    return where_above(wo.z, jnp.mean(rows, axis=(0, 1)))


def _bound(x: Ends[RGL]) -> Reflection:
    """Return infinite bounds, because no bound is known."""
    bands = x.low.values.shape[-1]
    why = "no bound of an adaptive table is known"
    return Reflection(np.full(bands, np.inf), plain=np.inf, why=why)


register(
    RGL,
    evaluate=evaluate,
    sample=sample,
    pdf=pdf,
    albedo=albedo,
    shading=shading,
    bound=_bound,
    word="",
    isotropic=lambda material: len(material.phi) <= 2,
)
