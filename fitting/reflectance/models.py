"""The reflectance models that can be fitted, as a table with one row for each model. The equations
are those of `jaxvision.brdf`.

A model is a diffuse part of amplitude k_d plus k_s times a lobe with one shape parameter. A new
model needs one row: its record with unit k_s, and the name, unit and range of its shape parameter.
Lobes are centred on the mirror direction or on the half vector. A rough diffuse surface has a shape
parameter but no lobe.

`torrance-sparrow` has GGX facets, as the record has by default. `torrance-sparrow-beckmann` has
Beckmann facets. Both have Smith's height-correlated shadowing and the Fresnel term of a clear
dielectric with a given index of refraction. The index is never fitted, because k_s and the normal
reflectance enter only as their product, except at grazing angles. Facets of
`torrance-sparrow-metal` (GGX) have the same reflectance at all angles, which is a good
approximation for metals. In `eon` the interreflection between facets is computed for white facets,
so that k_d is an amplitude in any unit of light.
"""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import Vec
from jaxvision.brdf import evaluate, shading
from jaxvision.brdf.blinn import Blinn, NormalisedBlinn
from jaxvision.brdf.eon import EON
from jaxvision.brdf.fresnel import Dielectric
from jaxvision.brdf.gaussian_lobe import GaussianLobe
from jaxvision.brdf.oren_nayar import OrenNayar
from jaxvision.brdf.phong import NormalisedPhong, Phong
from jaxvision.brdf.torrance_sparrow import Distribution, TorranceSparrow
from jaxvision.errors import InputError
from jaxvision.scene import Material

from ..inference.parameters import Parameter, ParameterSpace
from .names import Axis, Model

HIGHEST_INDEX = 10.0  # index of refraction above that of any material


@dataclass(frozen=True)
class Reflectance:
    """A reflectance model that can be fitted."""

    label: str  # its name in reports
    axis: Axis  # direction about which the lobe is centred
    shape: Parameter | None = None  # None for Lambert
    # function from a shape and an index of refraction to the record, with unit amplitude and no
    # other part; None for Lambert
    material: Callable[[Array, float], Material] | None = None
    unit: str = "sr^-1"  # of k_s in a BRDF


def amplitude(name: str, symbol: str, unit: str) -> Parameter:
    """Return an amplitude parameter, which is positive and searched as its logarithm."""
    return Parameter(name, symbol=symbol, unit=unit, transform="log")


def _unit_amplitude(shape: Array) -> Array:
    return jnp.ones(1, shape.dtype)


def _lobe(record: Callable[[Array, Array, Array], Material]) -> Callable[[Array, float], Material]:
    """Return a function from shape and index to the lobe of a record, with diffuse 0 and specular
    1.
    """
    return lambda shape, index: record(jnp.zeros(1, shape.dtype), _unit_amplitude(shape), shape)


def _facets(
    distribution: Distribution, *, clear: bool = True
) -> Callable[[Array, float], Material]:
    def material(shape: Array, index: float) -> Material:
        interface = Dielectric(jnp.full(1, index, shape.dtype)) if clear else None
        lobe = jnp.zeros(1, shape.dtype), _unit_amplitude(shape), shape
        return TorranceSparrow(*lobe, interface=interface, distribution=distribution)

    return material


_EXPONENT = Parameter("exponent", symbol="n", unit="1", transform="log")
_CONCENTRATION = Parameter("concentration", symbol="c", unit="1/rad", transform="log")
_FACET_ROUGHNESS = Parameter("roughness", symbol="α", unit="1", transform="log")
_BODY_ROUGHNESS = Parameter("roughness", symbol="σ", unit="rad", transform="log")
_SHARE_OF_ROUGHNESS = Parameter("roughness", symbol="r", unit="1", transform="log")
# Searched range of each shape, by its symbol. A body of the smallest roughness differs from
# Lambert's model by less than a millionth up to 87 degrees from the normal.
SEARCHED = {
    "n": (0.5, 20_000.0),
    "c": (0.5, 100.0),
    "α": (0.005, 1.5),
    "σ": (1e-4, 1.5),
    "r": (1e-5, 1.0),
}

REFLECTANCES: dict[Model, Reflectance] = {
    "lambert": Reflectance("Lambert", "none"),
    "oren-nayar": Reflectance(
        "Oren-Nayar",
        "none",
        _BODY_ROUGHNESS,
        lambda shape, index: OrenNayar(_unit_amplitude(shape), shape),
    ),
    "eon": Reflectance(
        "EON",
        "none",
        _SHARE_OF_ROUGHNESS,
        lambda shape, index: EON(
            _unit_amplitude(shape), shape, facet_albedo=_unit_amplitude(shape)
        ),
    ),
    "phong": Reflectance("Phong", "mirror", _EXPONENT, _lobe(Phong)),
    "normalised-phong": Reflectance(
        "normalised Phong", "mirror", _EXPONENT, _lobe(NormalisedPhong), "1"
    ),
    "gaussian-lobe": Reflectance("Gaussian lobe", "mirror", _CONCENTRATION, _lobe(GaussianLobe)),
    "blinn": Reflectance("Blinn", "half", _EXPONENT, _lobe(Blinn)),
    "normalised-blinn": Reflectance(
        "normalised Blinn", "half", _EXPONENT, _lobe(NormalisedBlinn), "1"
    ),
    "torrance-sparrow-beckmann": Reflectance(
        "Torrance-Sparrow (Beckmann)", "half", _FACET_ROUGHNESS, _facets("beckmann"), "1"
    ),
    "torrance-sparrow": Reflectance(
        "Torrance-Sparrow (GGX)", "half", _FACET_ROUGHNESS, _facets("ggx"), "1"
    ),
    "torrance-sparrow-metal": Reflectance(
        "Torrance-Sparrow (GGX, metal)", "half", _FACET_ROUGHNESS, _facets("ggx", clear=False), "1"
    ),
}

LABELS: dict[Model, str] = {model: row.label for model, row in REFLECTANCES.items()}


def facet_sentence(index: float) -> str:
    """Return a finding for fits with clear facets."""
    along_normal = ((index - 1) / (index + 1)) ** 2
    return (
        f"Clear facets have the index of refraction {index:g} (Fresnel reflectance "
        f"{along_normal:.3f} along the normal). It is given, not fitted, because k_s and the index "
        "enter as a product: an unexpected k_s means another index, or facets that do not cover "
        "the surface."
    )


def check_index(index: float) -> None:
    """Raise `InputError` for an index of refraction that no clear material has."""
    if not 1 < index < HIGHEST_INDEX:
        raise InputError(f"index = {index:g}: give an index of refraction above 1 and below 10.")


def surface_space(model: Model, diffuse: str, specular: str) -> ParameterSpace:
    """Return the parameters that the model has (diffuse, specular, shape), with the units of the
    amplitudes."""
    space = [amplitude("diffuse", "k_d", diffuse)]
    if has_lobe(model):
        space.append(amplitude("specular", "k_s", specular))
    return tuple(space) if model == "lambert" else (*space, shape_of(model))


def has_lobe(model: Model) -> bool:
    """Return whether the model has a specular term in addition to the diffuse one."""
    return REFLECTANCES[model].axis != "none"


def shape_of(model: Model) -> Parameter:
    """Return the shape parameter of any model but Lambert's."""
    shape = REFLECTANCES[model].shape
    assert shape is not None, model
    return shape


def shape_range(model: Model) -> tuple[float, float]:
    """Return the searched range of the shape, in its unit, for any model but Lambert's."""
    return SEARCHED[shape_of(model).symbol]


def log_range(model: Model) -> tuple[float, float]:
    """Return the logarithms of the searched range of the shape, for any model but Lambert's."""
    low, high = shape_range(model)
    return float(np.log(low)), float(np.log(high))


def is_searched(model: Model, shape: float) -> bool:
    """Return whether a shape is inside its searched range. Outside this range, predictions hardly
    change with the shape, so a search that ends outside has found a plateau and not an optimum. A
    rough diffuse model may have any small roughness, because without roughness this model is
    Lambert's.
    """
    low, high = shape_range(model)
    return shape <= high and (low <= shape or not has_lobe(model))


def unit_brdf(
    model: Model, shape: Float[Array, ""], wi: Vec, wo: Vec, index: float
) -> Float[Array, " n"]:
    """Return f_r of unit amplitude for pairs of directions."""
    return _pair_values(evaluate, model, shape, wi, wo, index)


def unit_shading(
    model: Model, shape: Float[Array, "*n"], wi: Vec, wo: Vec, index: float
) -> Float[Array, " n"]:
    """Return the reflected light per irradiance on a surface that faces the light, for unit
    amplitude. The shape is one number for all pairs of directions or one number for each pair."""
    return _pair_values(shading, model, shape, wi, wo, index)


@eqx.filter_jit
def _pair_values(
    of_pair: Callable[[Material, Vec, Vec], Array],
    model: Model,
    shape: Array,
    wi: Vec,
    wo: Vec,
    index: float,
) -> Array:
    build = REFLECTANCES[model].material
    assert build is not None, model

    def pair_value(shape: Array, wi: Vec, wo: Vec) -> Array:
        return of_pair(build(shape, index), wi, wo)[0]

    return jax.vmap(pair_value, (0 if shape.ndim else None, 0, 0))(shape, wi, wo)
