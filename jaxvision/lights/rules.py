"""How finely an extended light is taken apart: as fixed nodes or as random samples.

Every extended light is a map from the unit square to directions. A rule says where in the square
it is looked at, and how much each place counts; more samples cost in proportion, and that number is
the knob of accuracy.
"""

import equinox as eqx

from .._types import Key


class Quadrature(eqx.Module):
    """Fixed nodes, `order` a side: order^2 for a rectangle, twice that for an environment.

    The error falls exponentially where light and surface are smooth, and like 1 / order^2 where
    the light crosses the surface's horizon. `order`: static, >= 1.
    """

    order: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        _check_count("Quadrature.order", self.order)


class MonteCarlo(eqx.Module):
    """Random samples where the light is bright, without bias.

    `key`: random key. `samples`: static, >= 1. The samples of one key are spread evenly (a
    Kronecker sequence with a random shift), so their mean is better than that of independent ones.
    """

    key: Key
    samples: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        _check_count("MonteCarlo.samples", self.samples)


Rule = Quadrature | MonteCarlo


def _check_count(name: str, count: int) -> None:
    if count < 1:
        raise ValueError(f"{name} must be at least 1, got {count}.")
