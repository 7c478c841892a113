"""The share of light that a microfacet surface with Smith's masking loses to multiple reflections,
and the share that clear facets reflect.

Chebyshev polynomials approximate two quantities: the share of light that white facets lose, and the
amount that roughness adds to the Fresnel reflectance of clear facets. The polynomials were fitted
to quadratures of a single reflection by `tests/oracles/facet_energy.py`. They depend on the
variable x = (asinh(c / 2 alpha) / asinh(1 / 2 alpha))^0.6, where c is the cosine of the view and
alpha the roughness. This variable resolves grazing views at every roughness. The polynomials have
an absolute error of at most 5e-4. All quantities in this file are dimensionless.
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
_NODES, _WEIGHTS = _T**3, 6 * _T**5 * _DT  # for the weight 2 c dc, with c = t^3, dense at small c


@cache
def _coefficients(distribution: Distribution) -> tuple[np.ndarray, np.ndarray]:
    """Return the Chebyshev coefficients of the share of light lost, (x, y), and of the reflectance
    added by roughness, (x, y, index). Axis x is the order in the variable x of the module, axis y
    the order in a variable of the roughness alone, and the last axis the order in the logarithm of
    the index."""
    with np.load(Path(__file__).with_name("facet_energy.npz")) as file:
        return file[f"{distribution}_lost"], file[f"{distribution}_clear"]


def _chebyshev(place: Array, count: int) -> Array:
    """Return the Chebyshev polynomials T_0 to T_(count - 1), (count, *n), at `place` in [0, 1]."""
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
    """Return the Chebyshev polynomials T_k in the variable x of the module, for given cosines.
    Below the smallest fitted alpha, the result depends on cosine / alpha alone."""
    a = _polynomial(alpha)
    scaled = cosine * (a / jnp.clip(alpha, LEAST_ROUGHNESS, ROUGHEST))
    ratio = jnp.arcsinh(jnp.clip(scaled, 1e-6, 1) / (2 * a)) / jnp.arcsinh(0.5 / a)
    return _chebyshev(ratio**0.6, count)


def lost_energy(cosine: Array, alpha: Scalar, distribution: Distribution) -> Array:
    """Return the share of light that white facets lose, for a view at `cosine` to the normal."""
    table = jnp.asarray(_coefficients(distribution)[0], alpha.dtype)
    line = table @ _roughness_basis(alpha, table.shape[1])
    return jnp.clip(line @ _cosine_basis(cosine, alpha, table.shape[0]), 0, 1)


def mean_lost(alpha: Scalar, distribution: Distribution) -> Scalar:
    """Return the mean of `lost` over the cosine c of the view, weighted by 2 c (uniform light)."""
    nodes, weights = (jnp.asarray(x, alpha.dtype) for x in (_NODES, _WEIGHTS))
    return weights @ lost_energy(nodes, alpha, distribution)


def reflected(cosine: Scalar, alpha: Scalar, eta: Colour, distribution: Distribution) -> Colour:
    """Return the share of light that clear facets with relative refractive indices `eta` reflect,
    (bands,), for a view at `cosine` to the normal."""
    table = jnp.asarray(_coefficients(distribution)[1], alpha.dtype)
    by_index = jnp.einsum("xyz,y->xz", table, _roughness_basis(alpha, table.shape[1]))
    span = float(np.log(LARGEST_INDEX / LEAST_INDEX))
    place = jnp.log(jnp.clip(eta, LEAST_INDEX, LARGEST_INDEX) / LEAST_INDEX) / span
    line = by_index @ _chebyshev(place, table.shape[2])
    added = _cosine_basis(cosine, alpha, table.shape[0]) @ line
    # Below the fitted range of roughness, the loss depends on cosine / alpha only, and the tilt of
    # the facets changes Fresnel's reflectance in proportion to alpha.
    loss, smoother = lost_energy(cosine, alpha, distribution), alpha / _polynomial(alpha)
    added = (added + loss) * smoother - loss
    return jnp.clip(fresnel_dielectric(jnp.clip(cosine, 0, 1), eta) + added, 0, 1)
