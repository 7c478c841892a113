"""Shafer's dichromatic reflection model: a body term and an interface term, each a geometry factor
times a spectrum.

    f_r(wi, wo; lambda) = m_b(wi, wo) c_b(lambda) + m_i(wi, wo) c_i(lambda)

The body term, with geometry factor m_b and spectrum c_b, is light that entered the material and
took its colour. The interface term, with m_i and c_i, is light reflected at the surface. The
geometry factors are any two neutral materials (one band) with a BRDF in sr^-1, such as Lambert and
a microfacet lobe. Mirrors and glass are not allowed, because their BRDFs are delta functions.
`dichromatic_separation` separates a picture into the two terms. In the local frame the normal is
+z; f_r is in sr^-1. Source: Shafer, "Using Color to Separate Reflection Components", Color Research
and Application 10(4) (1985).
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Reflection, peak
from ..core._numerics import or_one
from ..core._types import AMOUNT, Colour, Scalar, as_float, check_fields, print_by_name
from ..core._vector import Direction, Vec, as_vec
from ..scene import Material
from ._lobe import ColourOrNeutral, diffuse_share
from ._registry import family, is_delta, register, suprema

Body = Float[Array, " body"]
Interface = Float[Array, " interface"]
print_by_name(globals(), "Body", "Interface")


class Dichromatic(Material):
    """A material with a body and an interface reflection, each a geometry factor times a spectrum.

    Attributes:
        body: material of one band, the geometry factor m_b in sr^-1.
        interface: material of one band, the geometry factor m_i in sr^-1.
        body_spectrum: (bands,) c_b, no unit.
        interface_spectrum: (bands,) or (1,) for all bands, c_i, no unit.

    Raises:
        ValueError: if a geometry factor is a mirror or glass, because `pdf` is 0 for their samples.

    Example:
        >>> body, gloss = jv.Lambert([0.3]), jv.PhongBRDF([0.0], [0.1], 20.0)
        >>> paint = jv.Dichromatic(body, gloss, [1.0, 0.5], [1.0])
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> [round(float(x), 4) for x in jv.reflect(paint, up, up, up)]  # 0.3 c_b + 0.1
        [0.4, 0.25]
    """

    body: Material
    interface: Material
    body_spectrum: Colour = eqx.field(converter=as_float)
    interface_spectrum: ColourOrNeutral = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        for name, part in (("body", self.body), ("interface", self.interface)):
            if is_delta(part):
                raise ValueError(
                    f"Dichromatic.{name} must have a BRDF in sr^-1, got {type(part).__name__}, a "
                    "delta function: a polished TorranceSparrow (roughness 1e-3) has one."
                )
        check_fields(self, body_spectrum=AMOUNT, interface_spectrum=AMOUNT)


def evaluate(material: Dichromatic, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1."""
    return _two_terms(material, lambda part: family(part).evaluate(part, wi, wo))


def shading(material: Dichromatic, wi: Direction, wo: Direction) -> Colour:
    """Return the sum of the two materials' shadings times their spectra, (bands,) in sr^-1."""
    return _two_terms(material, lambda part: family(part).shading(part, wi, wo))


def albedo(material: Dichromatic, wo: Direction) -> Colour:
    """Return the sum of the two materials' albedos times their spectra, (bands,), no unit."""
    return _two_terms(material, lambda part: family(part).albedo(part, wo))


def _two_terms(material: Dichromatic, of_part: Callable[[Material], Colour]) -> Colour:
    m_b, m_i = of_part(material.body), of_part(material.interface)
    for name, m in (("body", m_b), ("interface", m_i)):
        if m.shape != (1,):
            raise ValueError(f"Dichromatic.{name} must reflect in one band, got {m.shape[0]}.")
    return material.body_spectrum * m_b + material.interface_spectrum * m_i


def _body_part(material: Dichromatic) -> Scalar:
    """Return the probability of sampling the body, computed from the two spectra alone."""
    return diffuse_share(material.body_spectrum, material.interface_spectrum)


def sample(material: Dichromatic, wo: Direction, u: Float[Array, "3"]) -> Vec:
    """Draw a unit direction with the sampler of the body or of the interface. The number u_2
    selects the sampler, and is then rescaled to [0, 1) for use in that sampler.
    """
    part = _body_part(material)
    from_body = u[2] < part
    left_body = u[2] / or_one(part)
    left_interface = (u[2] - part) / or_one(1 - part)
    body = family(material.body).sample(material.body, wo, u.at[2].set(left_body))
    lobe = family(material.interface).sample(material.interface, wo, u.at[2].set(left_interface))
    return jax.tree.map(lambda b, i: jnp.where(from_body, b, i), as_vec(body), as_vec(lobe))


def pdf(material: Dichromatic, wi: Direction, wo: Direction) -> Scalar:
    """Return the density of the directions that `sample` draws, in sr^-1."""
    part = _body_part(material)
    body = family(material.body).pdf(material.body, wi, wo)
    return part * body + (1 - part) * family(material.interface).pdf(material.interface, wi, wo)


def _bound(x: Ends[Dichromatic]) -> Reflection:
    """Return upper bounds on the shading: the sum of the bounds of body and interface, each times
    its spectrum. A diffuse part of the interface is added to the bound of the body."""
    body, interface = (suprema(x.field(name)) for name in ("body", "interface"))
    c_b, c_i = peak(x, "body_spectrum"), peak(x, "interface_spectrum")
    diffuse = c_b * body.body + c_i * interface.body
    parts = [(own.lobe, c) for own, c in ((body, c_b), (interface, c_i)) if own.lobe is not None]
    grazing = max(body.grazing, interface.grazing)
    why = body.why or interface.why
    if not parts:
        return Reflection(diffuse, plain=np.inf, why=why, grazing=grazing, angular=True)
    first, colour = parts[0]
    if len(parts) == 2:
        return Reflection(
            diffuse + np.inf, plain=np.inf, why="two lobes in one material", angular=True
        )
    spectrum = colour * first.spectrum
    lobe = first._replace(spectrum=spectrum)
    return Reflection(diffuse, lobe, np.inf, why=why, grazing=grazing, angular=True)


register(
    Dichromatic,
    evaluate=evaluate,
    sample=sample,
    pdf=pdf,
    albedo=albedo,
    shading=shading,
    bound=_bound,
    word="",
    isotropic=lambda own: all(family(x).isotropic(x) for x in (own.body, own.interface)),
)
