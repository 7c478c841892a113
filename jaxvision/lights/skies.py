"""Models of the sky: the fifteen general skies of the CIE, its traditional overcast sky, and the
sky of Perez.

    L / L_zenith = g(Z) f(chi) / (g(0) f(Z_sun))
    g(Z) = 1 + a exp(b / cos(Z))
    f(chi) = 1 + c (exp(d chi) - exp(d pi / 2)) + e cos^2(chi)

where L is the radiance, Z the angle to the zenith, +z, and chi the angle to the sun. Below the
horizon the radiance is 0. Sources: ISO 15469:2004 / CIE S 011; Perez, Seals & Michalsky,
"All-Weather Model for Sky Luminance Distribution", Solar Energy 50(3) (1993) and its erratum.
Angles are in rad. The models describe luminance, so the user chooses the sky's colour.
"""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import angle_between
from ..core._types import ArrayLike, Scalar
from ..core._vector import Direction, as_array, as_vec
from ..geometry.hemisphere import product_nodes
from .environment import EnvironmentMap
from .environment_tables import environment_map

OVERCAST = 16  # the CIE's traditional sky, (1 + 2 cos(Z)) / 3
_GRADATION = ((4.0, -0.7), (1.1, -0.8), (0.0, -1.0), (-1.0, -0.55), (-1.0, -0.32), (-1.0, -0.15))
_INDICATRIX = (
    (0.0, -1.0, 0.0),
    (2.0, -1.5, 0.15),
    (5.0, -2.5, 0.3),
    (10.0, -3.0, 0.45),
    (16.0, -3.0, 0.3),
    (24.0, -2.8, 0.15),
)
# Indices of gradation and indicatrix for the CIE skies 1 to 15, from overcast to clear.
_KINDS = (
    *((0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2), (2, 3)),
    *((3, 1), (3, 2), (3, 3), (4, 3), (4, 4), (5, 4), (5, 5)),
)
# Upper ends of Perez's ranges of clearness, and the coefficients a1 to a4, b1 ... e4 of each range.
_CLEARNESS = (1.065, 1.23, 1.5, 1.95, 2.8, 4.5, 6.2)
_PEREZ = np.array(
    [
        *(1.3525, -0.2576, -0.269, -1.4366, -0.767, 0.0007, 1.2734, -0.1233, 2.8, 0.6004),
        *(1.2375, 1.0, 1.8734, 0.6297, 0.9738, 0.2809, 0.0356, -0.1246, -0.5718, 0.9938),
        *(-1.2219, -0.773, 1.4148, 1.1016, -0.2054, 0.0367, -3.9128, 0.9156, 6.975, 0.1774),
        *(6.4477, -0.1239, -1.5798, -0.5081, -1.7812, 0.108, 0.2624, 0.0672, -0.219, -0.4285),
        *(-1.1, -0.2515, 0.8952, 0.0156, 0.2782, -0.1812, -4.5, 1.1766, 24.7219, -13.0812),
        *(-37.7, 34.8438, -5.0, 1.5218, 3.9229, -2.6204, -0.0156, 0.1597, 0.4199, -0.5562),
        *(-0.5484, -0.6654, -0.2672, 0.7117, 0.7234, -0.6219, -5.6812, 2.6297, 33.3389, -18.3),
        *(-62.25, 52.0781, -3.5, 0.0016, 1.1477, 0.1062, 0.4659, -0.3296, -0.0876, -0.0329),
        *(-0.6, -0.3566, -2.5, 2.325, 0.2937, 0.0496, -5.6812, 1.8415, 21.0, -4.7656),
        *(-21.5906, 7.2492, -3.5, -0.1554, 1.4062, 0.3988, 0.0032, 0.0766, -0.0656, -0.1294),
        *(-1.0156, -0.367, 1.0078, 1.4051, 0.2875, -0.5328, -3.85, 3.375, 14.0, -0.9999),
        *(-7.1406, 7.5469, -3.4, -0.1078, -1.075, 1.5702, -0.0672, 0.4016, 0.3017, -0.4844),
        *(-1.0, 0.0211, 0.5025, -0.5119, -0.3, 0.1922, 0.7023, -1.6317, 19.0, -5.0),
        *(1.2438, -1.9094, -4.0, 0.025, 0.3844, 0.2656, 1.0468, -0.3788, -2.4517, 1.4656),
        *(-1.05, 0.0289, 0.426, 0.359, -0.325, 0.1156, 0.7781, 0.0025, 31.0625, -14.5),
        *(-46.1148, 55.375, -7.2312, 0.405, 13.35, 0.6234, 1.5, -0.6426, 1.8564, 0.5636),
    ]
).reshape(8, 5, 4)


def cie_sky(kind: int) -> Float[np.ndarray, "5"]:
    """Return the parameters a to e of one of the CIE's general skies.

    Args:
        kind: 1 (overcast, steep) to 15 (clear, turbid); 5 is uniform, 12 the clear standard sky.

    Returns:
        a, b, c, d and e, no unit; d per rad.

    Raises:
        ValueError: for another kind.

    Example:
        >>> print(jv.lights.cie_sky(12))
        [-1.   -0.32 10.   -3.    0.45]
    """
    if kind not in range(1, 16):
        raise ValueError(f"kind must be a whole number from 1 to 15, got {kind}.")
    gradation, indicatrix = _KINDS[kind - 1]
    return np.array([*_GRADATION[gradation], *_INDICATRIX[indicatrix]])


def perez_sky(sun_zenith: float, clearness: float, brightness: float) -> Float[np.ndarray, "5"]:
    """Return the parameters a to e of Perez's sky, in the form of the CIE skies.

    Args:
        sun_zenith: rad, from the zenith to the sun.
        clearness: epsilon, no unit, 1 (overcast) to about 12 (clear).
        brightness: Delta, no unit, 0 to about 0.6; at most 1.

    Returns:
        a, b, c, d and e, no unit; d per rad.

    Raises:
        ValueError: for a clearness below 1, a brightness outside [0, 1], or a sun below the
            horizon.

    Example:
        >>> clear, overcast = jv.lights.perez_sky(0.6, 8.0, 0.1), jv.lights.perez_sky(0.6, 1.0, 0.2)
        >>> print(clear[0] < 0, overcast[0] > 0)  # brighter toward the horizon; toward the zenith
        True True
    """
    if clearness < 1 or not 0 <= brightness <= 1 or not 0 <= sun_zenith <= np.pi / 2:
        raise ValueError(
            "a Perez sky has a clearness of at least 1, a brightness from 0 to 1 and a sun above "
            f"the horizon, got {clearness:g}, {brightness:g} and a zenith angle of "
            f"{sun_zenith:g} rad."
        )
    row = int(np.searchsorted(_CLEARNESS, clearness, side="right"))
    x, z, delta = _PEREZ[row], sun_zenith, brightness
    a, b, c, d, e = x[:, 0] + x[:, 1] * z + delta * (x[:, 2] + x[:, 3] * z)
    if row == 0:
        c = np.exp((delta * (x[2, 0] + x[2, 1] * z)) ** x[2, 2]) - x[2, 3]
        d = -np.exp(delta * (x[3, 0] + x[3, 1] * z)) + x[3, 2] + delta * x[3, 3]
    # 1 + c exp(d chi) + e cos^2 = k (1 + c / k (exp(d chi) - exp(d pi / 2)) + e / k cos^2)
    k = 1 + c * np.exp(d * np.pi / 2)
    return np.array([a, b, c / k, d, e / k])


@takes_numbers
def sky_radiance(parameters: Float[Array, "5"], sun: Direction, direction: Direction) -> Scalar:
    """Return the radiance of a sky, relative to that of its zenith.

    Args:
        parameters: a, b, c, d and e of `cie_sky` or `perez_sky`.
        sun: (3,) unit, toward the sun.
        direction: (3,) unit, toward the sky; the zenith is +z.

    Returns:
        () at least 0, no unit; 0 below the horizon.

    Example:
        >>> sun = np.array([0.6, 0.0, 0.8])
        >>> for at in ([0.0, 0.0, 1.0], sun):
        ...     print(jv.lights.sky_radiance(jv.lights.cie_sky(12), sun, at).round(3))
        1.0
        5.163
    """
    a, b, c, d, e = parameters
    zenith = jnp.array([0.0, 0.0, 1.0], parameters.dtype)

    def gradation(cosine: Scalar) -> Scalar:
        return 1 + a * jnp.exp(b / jnp.maximum(cosine, 1e-3))

    def indicatrix(to: Array) -> Scalar:
        chi = angle_between(to, as_array(sun))
        return 1 + c * (jnp.exp(d * chi) - jnp.exp(d * jnp.pi / 2)) + e * jnp.square(jnp.cos(chi))

    up = as_vec(direction).z
    value = gradation(up) * indicatrix(as_array(direction))
    whole = value / (gradation(jnp.ones_like(up)) * indicatrix(zenith))
    return jnp.where(up > 0, jnp.maximum(whole, 0), 0)


def daylight(
    parameters: ArrayLike | int,
    sun: ArrayLike,
    *,
    irradiance: ArrayLike,
    rows: int = 128,
) -> EnvironmentMap:
    """Make an environment light from a model of the sky, without the sun itself (use `SunDisc`).

    Args:
        parameters: a, b, c, d and e of `cie_sky` or `perez_sky`; or the number of a CIE sky, 1 to
            15, or 16 for the traditional overcast sky.
        sun: (3,) toward the sun (its length is ignored), not below the horizon.
        irradiance: (bands,) W m^-2 of the sky on open level ground.
        rows: number of rows of the sky's picture, at least 16; the relative error of its light is
            about 1 / rows^2.

    Returns:
        The light; +z is up, and the lower half is black.

    Raises:
        ValueError: for a sun of length 0 or below the horizon, and another kind.

    Warns:
        UserWarning: if the formula is negative in some direction, where the radiance is then set to
            0.

    Example:
        >>> sky = jv.lights.daylight(16, [0, 0, 1], irradiance=[100.0])
        >>> up, rule = jnp.array([0.0, 0.0, 1.0]), jv.Quadrature(64)
        >>> print(jv.irradiance(sky, jnp.zeros(3), up, rule=rule).round(1))
        [100.]
    """
    toward = np.asarray(sun, float)
    length = np.linalg.norm(toward)
    if not 0 < length < np.inf:
        raise ValueError(f"sun must be a finite vector with a direction, got {toward}.")
    toward = toward / length
    if toward[2] < 0:
        raise ValueError(f"the sun must stand above the horizon, got {toward}.")
    if rows < 16:
        raise ValueError(f"rows must be at least 16, got {rows}.")

    # a Python, NumPy or JAX whole number
    whole = np.ndim(parameters) == 0 and np.asarray(parameters).dtype.kind in "iu"

    def relative(directions: np.ndarray) -> np.ndarray:
        if whole and parameters == OVERCAST:
            up = directions[:, 2]
            return np.where(up > 0, (1 + 2 * up) / 3, 0)
        own = cie_sky(np.asarray(parameters).item()) if whole else np.asarray(parameters, float)
        return np.asarray(_over_sky(jnp.asarray(own), jnp.asarray(toward), jnp.asarray(directions)))

    theta = np.pi * (np.arange(rows) + 0.5) / rows
    phi = np.pi * (1 - 2 * (np.arange(2 * rows) + 0.5) / (2 * rows))
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    sine = np.sin(theta)
    at = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)
    nodes, weights = product_nodes(64, 256)
    level = weights @ (relative(nodes) * nodes[:, 2])
    picture = relative(at.reshape(-1, 3)).reshape(theta.shape)
    dark = float((picture[np.cos(theta) > 0] == 0).mean())
    if dark > 0:
        warnings.warn(
            f"the sky's formula falls below 0 in {dark:.0%} of the upper half, which counts as 0; "
            "a sun, a clearness and a brightness that were measured together do not do this.",
            stacklevel=2,
        )
    return environment_map(picture[..., None] * (np.atleast_1d(irradiance) / level))


_over_sky = jax.jit(jax.vmap(sky_radiance, in_axes=(None, None, 0)))
