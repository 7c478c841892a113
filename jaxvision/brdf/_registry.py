"""The registry of BRDF families: the functions of each material class, with defaults for missing
functions.

All functions of a family use the local frame: normal = +z, `wi` toward the light, `wo` toward the
viewer.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._bounds import Ends, Reflection
from ..core._kinds import Table, table_for
from ..core._maps import ENDS, is_map, maps_of, replace_maps
from ..core._types import Colour, Scalar
from ..core._vector import Direction, Vec, Vector, as_vec
from ..geometry.hemisphere import cosine_direction, cosine_pdf, product_nodes
from ..scene import Material
from ._lobe import where_above
from ._specular import Specular, draw_way

POLAR, AZIMUTHS = 32, 64  # nodes of the default albedo


Bound = Callable[[Ends], Reflection]


class Family(NamedTuple):
    """The functions of one family of materials. `brdf/__init__` describes their results.

    `specular(material, w)` returns how a ray that came from `w` continues; it is None unless the
    BRDF is a sum of delta functions. `absorption(material)` returns the absorption of the body
    behind the surface, (bands,) m^-1; it is None for a family that encloses no body. `bound`
    returns upper bounds on the shading; it is None if no bound is known. `table` describes the
    material's table in scene files, or is None. `isotropic(material)` tells whether the BRDF
    depends on the azimuths of `wi` and `wo` only by their difference.
    """

    evaluate: Callable[[Any, Vector, Vector], Colour]
    sample: Callable[[Any, Vector, Float[Array, "3"]], Vector]
    pdf: Callable[[Any, Vector, Vector], Scalar]
    albedo: Callable[[Any, Vector], Colour]
    shading: Callable[[Any, Vector, Vector], Colour]
    bound: Bound | None
    table: Table | None
    specular: Callable[[Any, Vec], Specular] | None = None
    absorption: Callable[[Any], Colour | None] | None = None
    isotropic: Callable[[Any], bool] = lambda material: False


_FAMILIES: dict[type, Family] = {}


def families() -> Mapping[type, Family]:
    """Return all registered families, including those of the library.

    Returns:
        The registered functions of each record.
    """
    room = import_module(__package__ or "")
    for name in dir(room):
        getattr(room, name)
    return _FAMILIES


def register(
    record: type,
    *,
    evaluate: Callable[[Any, Vector, Vector], Colour],
    sample: Callable[[Any, Vector, Float[Array, "3"]], Vector] | None = None,
    pdf: Callable[[Any, Vector, Vector], Scalar] | None = None,
    albedo: Callable[[Any, Vector], Colour] | None = None,
    shading: Callable[[Any, Vector, Vector], Colour] | None = None,
    bound: Bound | None = None,
    word: str | None = None,
    from_file: Callable[..., Any] | None = None,
    isotropic: bool | Callable[[Any], bool] = False,
) -> None:
    """Register the class of a material with its functions, so that all integrators can use it.

    Integrators call the functions with unit directions in the local frame, as `Vec`.

    Args:
        record: the class of the material.
        evaluate: `evaluate(material, wi, wo)`, the BRDF, (bands,) sr^-1.
        sample: `sample(material, wo, u)`, a direction from three uniform numbers; without it
            directions are cosine-distributed.
        pdf: `pdf(material, wi, wo)`, () sr^-1, the density of `sample`.
        albedo: `albedo(material, wo)`, (bands,) no unit; without it a product quadrature of
            32 x 64 directions, good for broad lobes.
        shading: `shading(material, wi, wo)`, (bands,) sr^-1; without it the BRDF times the cosine
            of incidence.
        bound: `bound(ends) -> effects.Reflection`, upper bounds on the shading. `ends` contains the
            material twice, with its free parameters at their smallest and at their largest values.
            Without `bound`, `effects` drops nothing that depends on the material.
        word: the name of the `family` in scene files. None takes the name of the class in snake
            case; "" excludes the material from scene files.
        from_file: function that makes the record from the keys of a file, if the keys are not the
            fields of the record. The names, defaults and docstring of its parameters define the
            keys; `**fields` takes all other fields of the record.
        isotropic: whether the BRDF depends on the azimuths of `wi` and `wo` only by their
            difference, or a function of the material that returns this flag. A coat over an
            isotropic body is computed much faster.

    Raises:
        ValueError: if only one of `sample` and `pdf` is given.
    """
    if (sample is None) != (pdf is None):
        given, missing = ("pdf", "sample") if sample is None else ("sample", "pdf")
        raise ValueError(f"{record.__name__}: got {given} without {missing}; they come together.")

    def shading_from_brdf(material: Any, wi: Direction, wo: Direction) -> Colour:
        return evaluate(material, wi, wo) * jnp.maximum(as_vec(wi).z, 0)

    def integrate_albedo(material: Any, wo: Direction) -> Colour:
        return integrate_shading(shading_from_brdf if shading is None else shading, material, wo)

    _FAMILIES[record] = Family(
        evaluate,
        sample_cosine if sample is None else sample,
        pdf_cosine if pdf is None else pdf,
        integrate_albedo if albedo is None else albedo,
        shading_from_brdf if shading is None else shading,
        bound,
        table_for(record, word, from_file),
        isotropic=isotropic if callable(isotropic) else lambda material: isotropic,
    )


def register_delta(
    record: type,
    *,
    specular: Callable[[Any, Vec], Specular],
    absorption: Callable[[Any], Colour | None] | None = None,
    bound: Bound | None = None,
    word: str | None = None,
    from_file: Callable[..., Any] | None = None,
) -> None:
    """Register the class of a mirror-like or clear material with its functions, so that all
    integrators can use it.

    The `evaluate`, `shading` and `pdf` of the material are 0, because no point light and no
    quadrature node lies exactly in a mirrored or refracted direction. `sample` returns one of these
    directions.

    Args:
        record: the class of the material.
        specular: `specular(material, w)`, the directions in which a ray continues that came from
            the unit local direction `w`, a `Vec`. It is also called for rays from below the
            surface, w.z < 0, for which a mirror with an opaque back reflects 0.
        absorption: `absorption(material)`, (bands,) m^-1 of the body behind the surface, or None
            for a clear body; omit this function for a material that encloses no body.
        bound, word, from_file: as in `register`.
    """

    def evaluate(material: Any, wi: Direction, wo: Direction) -> Colour:
        del wi
        return jnp.zeros_like(specular(material, as_vec(wo)).reflectance)

    def sample(material: Any, wo: Direction, u: Float[Array, "3"]) -> Vec:
        return draw_way(specular(material, as_vec(wo)), u[2], carries="light")[0]

    def pdf(material: Any, wi: Direction, wo: Direction) -> Scalar:
        del material, wi
        return jnp.zeros_like(as_vec(wo).z)

    def albedo(material: Any, wo: Direction) -> Colour:
        viewer = as_vec(wo)
        return where_above(viewer.z, specular(material, viewer).reflectance)

    table = table_for(record, word, from_file)
    _FAMILIES[record] = Family(
        evaluate,
        sample,
        pdf,
        albedo,
        evaluate,
        bound,
        table,
        specular=specular,
        absorption=absorption,
    )


def family(material: Any) -> Family:
    """Return the registered functions of a material. Raise `TypeError` if its class was never
    registered, and `ValueError` for a material that varies over its surface."""
    own = _family(material)
    for name, _ in maps_of(material):
        raise ValueError(
            f"{type(material).__name__}.{name} is a Map, which varies over its surface; take the "
            "material at one place, with jaxvision.material_at."
        )
    return own


def _family(material: Any) -> Family:
    kind = type(material)
    if kind not in _FAMILIES:
        raise TypeError(
            f"{kind.__name__} is no known material: call jaxvision.brdf.register for it first."
        )
    return _FAMILIES[kind]


def suprema(material: Ends[Any]) -> Reflection:
    """Return upper bounds on a material's shading over all directions.

    Args:
        material: the material twice, with its free parameters at their smallest and at their
            largest values. A map is replaced by its smallest and largest values.

    Returns:
        The suprema, sr^-1; inf for a family without a registered bound.
    """
    if any(True for _ in maps_of(material.low)):
        low, high = (replace_maps(end, pick) for end, pick in zip(material, ENDS, strict=True))
        material = Ends(low, high)
    own = _FAMILIES.get(type(material.low))
    bound = None if own is None else own.bound
    if bound is None:
        kind = type(material.low).__name__
        return Reflection(np.array([np.inf]), plain=np.inf, why=f"no bound of {kind} is known")
    return bound(material)


def is_delta(material: Any) -> bool:
    """Return whether a material reflects into one or two directions only, as mirrors and glass do.

    Args:
        material: any registered material.

    Returns:
        Whether the BRDF is a sum of delta functions, a Python bool, no unit.

    Example:
        >>> print(jv.brdf.is_delta(jv.Mirror([0.9])), jv.brdf.is_delta(jv.Lambert([0.1])))
        True False
    """
    return _family(material).specular is not None


def is_body(material: Any) -> bool:
    """Return whether a material fills the shape that it covers, as glass does, so that light
    continues inside.

    Args:
        material: any registered material.

    Returns:
        Whether light passes through a body of this material, a Python bool, no unit.

    Example:
        >>> print(jv.brdf.is_body(jv.Glass(1.5)), jv.brdf.is_body(jv.Mirror([0.9])))
        True False
    """
    return _family(material).absorption is not None


def lambertian(material: Any, *, bands: int = 1) -> Material:
    """Return a Lambertian surface with the diffuse coefficient k_d and the ambient coefficient k_a
    of a material.

    Args:
        material: any material; one without a field `diffuse`, such as a mirror, becomes black.
        bands: number of bands of a black surface.

    Returns:
        The material with its Lambertian and ambient parts only.
    """
    from .lambert import Lambert

    black = jnp.zeros(bands, jax.tree.leaves(material)[0].dtype)
    return Lambert(getattr(material, "diffuse", black), ambient=getattr(material, "ambient", None))


def absorption(material: Any) -> Colour | None:
    """Return the absorption coefficient of a material that fills its shape, such as glass.

    Args:
        material: any registered material.

    Returns:
        (bands,) m^-1; None for a clear material or one that encloses no body.
    """
    of_body = _family(material).absorption
    found = None if of_body is None else of_body(material)
    if is_map(found):
        raise ValueError(
            f"{type(material).__name__}.absorption must be plain numbers, got a Map: the inside of "
            "a body has no texture coordinates."
        )
    return found


@takes_numbers
def specular(material: Any, w: Vector) -> Specular:
    """Return the directions in which a ray continues at a mirror or a clear surface.

    Args:
        material: a mirror or glass.
        w: (3,) unit, local, the direction from which the ray came.

    Returns:
        The directions, unit, local, and their shares of the flux, (bands,) no unit.

    Raises:
        ValueError: for a material that is neither a mirror nor clear.
    """
    of_family = family(material).specular
    if of_family is None:
        raise ValueError(f"specular needs a mirror or glass, got {type(material).__name__}.")
    return of_family(material, as_vec(w))


@takes_numbers
def seen_in_mirror(material: Any, wo: Direction) -> tuple[Vec, Colour] | None:
    """Return the direction that a viewer sees reflected in an opaque mirror, and the reflectance.

    Args:
        material: any registered material.
        wo: (3,) unit, local, toward the viewer.

    Returns:
        The direction in which the viewer looks via the mirror, unit, local, and the reflectance
        there, (bands,) no unit. None for all other materials, including glass, which also
        transmits.

    Example:
        >>> from jaxvision.brdf import seen_in_mirror
        >>> direction, share = seen_in_mirror(jv.Mirror([0.9]), jv.Vec(0.6, 0.0, 0.8))
        >>> print(direction.x, share)
        -0.6 [0.9]
    """
    if not is_delta(material):
        return None
    ways = specular(material, wo)
    return (ways.mirrored, ways.reflectance) if ways.refracted is None else None


def sample_cosine(material: Any, wo: Direction, u: Float[Array, "3"]) -> Vec:
    """Draw a cosine-distributed direction above the surface, for any material and viewer."""
    del material, wo
    return cosine_direction(u[:2])


def pdf_cosine(material: Any, wi: Direction, wo: Direction) -> Scalar:
    """Return the density of cosine-distributed directions, max(cos(theta), 0) / pi in sr^-1."""
    del material, wo
    return cosine_pdf(wi)


def integrate_shading(
    shading: Callable[[Any, Vec, Vec], Colour],
    material: Any,
    wo: Direction,
    *,
    polar: int = POLAR,
    azimuths: int = AZIMUTHS,
) -> Colour:
    """Return the integral of a family's shading over the directions of the light, by product
    quadrature."""
    viewer = as_vec(wo)
    nodes, weights = (jnp.asarray(x, viewer.z.dtype) for x in product_nodes(polar, azimuths))
    values = jax.vmap(lambda wi: shading(material, wi, viewer))(as_vec(nodes))
    return (weights[:, None] * values).sum(axis=0)
