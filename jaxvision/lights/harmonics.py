"""The irradiance from an environment in terms of spherical harmonics up to order 2, nine
coefficients per band.

Source: Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment Maps",
SIGGRAPH 2001. The functions are for one normal; use `jax.vmap` for many.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._types import Colour
from ..core._vector import Direction, Directions, Vec, as_vec
from .environment import EnvironmentMap, _to_map

# The coefficients A_l of the clamped cosine, pi, 2 pi / 3 and pi / 4, for each (l, m).
_COSINE = np.pi * np.repeat([1, 2 / 3, 1 / 4], [1, 3, 5])


@takes_numbers
def harmonics(direction: Directions) -> Float[Array, "9 ..."]:
    """Return the nine orthonormal real spherical harmonics of order <= 2 of unit directions, as
    (9, ...), no unit, with (l, m) in the order (0,0), (1,-1), (1,0), (1,1), (2,-2) ... (2,2)."""
    d = as_vec(direction)
    x, y, z = d.x, d.y, d.z
    c0, c1, c2 = (float(np.sqrt(share / np.pi)) for share in (0.25, 0.75, 3.75))
    return jnp.stack(
        [
            jnp.full_like(x, c0),
            c1 * y,
            c1 * z,
            c1 * x,
            c2 * x * y,
            c2 * y * z,
            c2 / 12**0.5 * (3 * z * z - 1),
            c2 * x * z,
            c2 / 2 * (x * x - y * y),
        ]
    )


def irradiance_coefficients(environment: EnvironmentMap) -> Float[Array, "9 bands"]:
    """Compute the nine spherical-harmonic coefficients of an environment's irradiance, (9, bands) W
    m^-2, in the map's own axes, by a sum over all pixels.

    Example:
        >>> sky = jv.environment_map(np.ones((8, 16, 1)))
        >>> print(jv.lights.harmonics.irradiance_coefficients(sky).shape)
        (9, 1)
    """
    h, w, bands = environment.radiance.shape
    theta, phi = np.pi * (np.arange(h) + 0.5) / h, np.pi * (1 - 2 * (np.arange(w) + 0.5) / w)
    solid_angle = 2 * np.sin(theta) * np.sin(np.pi / (2 * h)) * 2 * np.pi / w
    dtype = environment.radiance.dtype
    sine, cosine = (jnp.asarray(f(theta)[:, None], dtype) for f in (np.sin, np.cos))
    x = sine * jnp.asarray(np.cos(phi)[None], dtype)
    y = sine * jnp.asarray(np.sin(phi)[None], dtype)
    basis = harmonics(Vec(x, y, jnp.broadcast_to(cosine, (h, w))))
    weighted = environment.radiance * jnp.asarray(solid_angle[:, None, None], dtype)
    projected = basis.reshape(9, h * w) @ weighted.reshape(h * w, bands)
    return jnp.asarray(_COSINE[:, None], dtype) * projected


@takes_numbers
def harmonic_irradiance(
    environment: EnvironmentMap, coefficients: Float[Array, "9 bands"], normal: Direction
) -> Colour:
    """Return the irradiance of an environment on a surface that faces `normal`, (bands,) W m^-2, by
    spherical harmonics of order <= 2 from `irradiance_coefficients`.

    The error of the irradiance is at most 3/32 of the integral of the radiance over the sphere.
    Light from a single direction causes this error on a surface that it grazes. On a surface that
    faces such light, the error is 6 % of the irradiance. The result may be negative. Under natural
    skies the mean error is about 1 % of the irradiance. For a map that consists of harmonics of
    order <= 2, only the error of the pixel sum remains.

    Example:
        >>> sky = jv.environment_map(np.ones((8, 16, 1)))  # W m^-2 sr^-1 from everywhere
        >>> coefficients = jv.lights.harmonics.irradiance_coefficients(sky)
        >>> light = jv.lights.harmonics.harmonic_irradiance(sky, coefficients, [0.0, 0.0, 1.0])
        >>> print(round(float(light[0] / np.pi), 3))
        1.008
    """
    basis = harmonics(_to_map(environment, normal))
    return (basis[:, None] * coefficients).sum(axis=0)
