"""Sampling rules for extended lights: fixed nodes or random samples.

Every extended light maps the unit square to directions. A sampling rule gives points in the square
and their weights. More samples are more accurate, and the cost is proportional to their number.
"""

import equinox as eqx

from ..core._shown import Shown
from ..core._types import Key, check_count, check_key, print_by_name


class Quadrature(Shown):
    """Gauss-Legendre quadrature with fixed nodes: order^2 for a rectangle, 2 order^2 for an
    environment.

    Use quadrature for diffuse surfaces under area lights, and for gradients without noise.

    The error falls exponentially with the order if light and surface are smooth. If the light
    crosses the surface's horizon, as every sky does, the error falls like 1 / order^2. Under a
    constant sky the error of a diffuse surface is up to 1.2 % at order 8, and .3 % at 16. An area
    light near the surface needs more nodes. Opposite the middle of a square light, order 8 (the
    default) has a relative error of -1.2e-5 at a distance of a quarter of the light's side, -1.2e-3
    at a tenth, -1.9 % at .03 and -34 % at a hundredth (+47 % at other points). Order 32 has an
    error of -4e-4 at a hundredth. `orders.order_for` gives the order that a distance needs, and
    `adaptive.adaptive_irradiance` chooses the order for many receivers. `irradiance` and the
    functions that render pictures warn of an error above 10 % from order 4 on. Quadrature misses
    structure that is finer than the distance between nodes:

      * The sun in a sky. `render`, `ray_traced`, `capture` and `outgoing_radiance` warn of this.
      * A glossy lobe. For the highlight of GGX facets in a square light, at a distance equal to its
        side, the error is -.9 % (alpha .1), -16 % (.05) and -67 % (.02) at order 8; 2e-5, -.8 % and
        -27 % at 16; and 0, 0 and -3 % at 32. For a Phong lobe with exponent 1000 the error is up to
        120 % at order 8, 11 % at 16, .5 % at 24 and .04 % at 32. The number of nodes per side
        should be the angular width of the light divided by that of the lobe, 1 / sqrt(exponent).
        Under a constant sky the error is +4.6 % (alpha .1) and -57 % (.03) at order 8, and +4 %
        (.03) even at 32.

    Attributes:
        order: number of nodes along each side, whole, >= 1, no unit; static.

    Raises:
        ValueError: for another order.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 1], [0, 2, 0], [2, 0, 0], [1 / np.pi])
        >>> up, rule = jnp.array([0.0, 0.0, 1.0]), jv.Quadrature(8)
        >>> light = jax.jit(jv.irradiance)(lamp, jnp.zeros(3), up, rule=rule)
        >>> round(float(light[0]), 4)  # 4 x 0.1385, the form factor of a corner
        0.5541
    """

    order: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_count("Quadrature.order", self.order, 1)


class MonteCarlo(Shown):
    """Random samples of a light, dense where it is bright, which give an unbiased estimate.

    Use Monte Carlo sampling for skies, and for surfaces whose lobe is at least as wide as the
    light. The samples of one key are spread evenly (a Kronecker sequence with a random shift), so
    their mean has a smaller error than the mean of independent samples.

    Attributes:
        key: random key.
        samples: number of samples, >= 1; static.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 1], [0, 2, 0], [2, 0, 0], [1 / np.pi])
        >>> up, rule = jnp.array([0.0, 0.0, 1.0]), jv.MonteCarlo(jax.random.key(0), 4096)
        >>> light = jax.jit(jv.irradiance)(lamp, jnp.zeros(3), up, rule=rule)
        >>> round(float(light[0]), 2)  # 4 x 0.1385, the form factor of a corner
        0.55
    """

    key: Key
    samples: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_key("MonteCarlo.key", self.key)
        check_count("MonteCarlo.samples", self.samples, 1)


class Balanced(Shown):
    """Random samples of light and material, combined by the balance heuristic.

    `Balanced` draws one direction from the light, as `MonteCarlo` does, and one from the material's
    own sampler. Use this rule for glossy lobes, and if in doubt. The error is close to that of the
    better of the two samplers, whether the lobe is smaller or larger than the light. Each sample
    costs two rays. For `irradiance`, which has no material, the rule is the same as `MonteCarlo`.

    Attributes:
        key: random key.
        samples: number of samples, >= 1; static.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 1], [0, 2, 0], [2, 0, 0], [1.0])
        >>> up, white = jnp.array([0.0, 0.0, 1.0]), jv.Lambert([1 / np.pi])
        >>> rule = jv.Balanced(jax.random.key(0), 4096)
        >>> seen = jv.outgoing_radiance(white, [lamp], jnp.zeros(3), up, up, rule=rule)
        >>> round(float(seen[0]), 2)  # 4 x 0.1385, the form factor of a corner
        0.55
    """

    key: Key
    samples: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_key("Balanced.key", self.key)
        check_count("Balanced.samples", self.samples, 1)


Random = MonteCarlo | Balanced
Rule = Quadrature | Random
print_by_name(globals(), "Random", "Rule")
