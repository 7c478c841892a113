"""How much a surface of Smith's facets loses, and how much clear facets reflect.

Chebyshev polynomials, fitted to quadratures of a single reflection (`tests/oracles/facet_energy.py`
writes the file): the share of light that white facets lose, and what the roughness of clear facets
adds to Fresnel's reflectance. The cosine enters as x = (asinh(c / 2 alpha) / asinh(1 / 2
alpha))^0.6, which resolves grazing views at every roughness. The shares err by at most 5e-4.
Nothing here has a unit.
"""

from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._quadrature import gauss_legendre
from ..core._types import Colour, Scalar
from .fresnel import fresnel_dielectric
from .microfacet import LEAST_ROUGHNESS, Distribution

SMOOTHEST, ROUGHEST = 1e-3, 1.0
LEAST_INDEX, LARGEST_INDEX = 1.1, 2.5
_T, _DT = gauss_legendre(32)
_NODES, _WEIGHTS = _T**3, 6 * _T**5 * _DT  # of 2 c dc, dense where c is small: c = t^3


@cache
def _coefficients(distribution: Distribution) -> tuple[np.ndarray, np.ndarray]:
    """Of the loss, (x, y), and of what clear facets add, (x, y, index)."""
    with np.load(Path(__file__).with_name("facet_energy.npz")) as file:
        return file[f"{distribution}_lost"], file[f"{distribution}_clear"]


def _chebyshev(place: Array, count: int) -> Array:
    """T_0 to T_(count - 1), (count, *n), at places in [0, 1]."""
    t = 2 * place - 1
    found = [jnp.ones_like(t), t]
    while len(found) < count:
        found.append(2 * t * found[-1] - found[-2])
    return jnp.stack(found)


def _roughness_basis(alpha: Scalar, count: int) -> Float[Array, " count"]:
    def stretch(a):
        return jnp.arcsinh(jnp.sqrt(a / 0.3))

    low, high = (float(np.arcsinh(np.sqrt(end / 0.3))) for end in (SMOOTHEST, ROUGHEST))
    return _chebyshev((stretch(_polynomial(alpha)) - low) / (high - low), count)


def _polynomial(alpha: Scalar) -> Scalar:
    return jnp.clip(alpha, SMOOTHEST, ROUGHEST)


def _cosine_basis(cosine: Array, alpha: Scalar, count: int) -> Array:
    """T_k at the places of cosines; smoother facets look alike at the same cosine over alpha."""
    a = _polynomial(alpha)
    scaled = cosine * (a / jnp.clip(alpha, LEAST_ROUGHNESS, ROUGHEST))
    ratio = jnp.arcsinh(jnp.clip(scaled, 1e-6, 1) / (2 * a)) / jnp.arcsinh(0.5 / a)
    return _chebyshev(ratio**0.6, count)


def lost(cosine: Array, alpha: Scalar, distribution: Distribution) -> Array:
    """The share of light that white facets lose, seen at a cosine."""
    table = jnp.asarray(_coefficients(distribution)[0], alpha.dtype)
    line = table @ _roughness_basis(alpha, table.shape[1])
    return jnp.clip(line @ _cosine_basis(cosine, alpha, table.shape[0]), 0, 1)


def mean_lost(alpha: Scalar, distribution: Distribution) -> Scalar:
    """The mean of `lost` over even light."""
    nodes, weights = (jnp.asarray(x, alpha.dtype) for x in (_NODES, _WEIGHTS))
    return weights @ lost(nodes, alpha, distribution)


def reflected(cosine: Scalar, alpha: Scalar, eta: Colour, distribution: Distribution) -> Colour:
    """The share that clear facets of relative indices `eta` reflect, (bands,), seen at a cosine."""
    table = jnp.asarray(_coefficients(distribution)[1], alpha.dtype)
    by_index = jnp.einsum("xyz,y->xz", table, _roughness_basis(alpha, table.shape[1]))
    span = float(np.log(LARGEST_INDEX / LEAST_INDEX))
    place = jnp.log(jnp.clip(eta, LEAST_INDEX, LARGEST_INDEX) / LEAST_INDEX) / span
    line = by_index @ _chebyshev(place, table.shape[2])
    added = _cosine_basis(cosine, alpha, table.shape[0]) @ line
    # of smoother facets than fitted the loss stays at the same cosine over alpha; what the tilt of
    # the facets changes of Fresnel's reflectance falls with alpha
    loss, smoother = lost(cosine, alpha, distribution), alpha / _polynomial(alpha)
    added = (added + loss) * smoother - loss
    return jnp.clip(fresnel_dielectric(jnp.clip(cosine, 0, 1), eta) + added, 0, 1)
