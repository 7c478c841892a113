"""Compare the irradiance of an environment by a coarse quadrature with the true irradiance."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core._types import is_known
from ..core._vector import as_array
from ..core._warnings import warn_caller
from ..scene import Light
from ._registry import Incident
from ._samples import light_nodes
from .environment import EnvironmentMap, environment_node
from .rules import Quadrature, Rule

# Errors of the irradiance above this fraction of the environment's largest irradiance are reported.
# The error for a smooth sky is smaller.
MISSED = 0.1
# An environment is interpolated to at least this number of rows, or averaged to at most twice it.
_ROWS = 64


class Found(NamedTuple):
    """The irradiance of an environment on a surface, and its value by a quadrature, W m^-2."""

    normal: np.ndarray
    true: float
    found: float
    rule: Quadrature
    directions: int

    def sentence(self, name: str) -> str:
        """Return the text of a warning about the environment called `name`: its true irradiance,
        and the irradiance by the quadrature."""
        lost = self.found < self.true
        facing = ", ".join(f"{x:.2f}" for x in self.normal + 0.0)
        return (
            f"{'Missing' if lost else 'Too much'}: light of {name}. On a surface that faces "
            f"({facing}) its irradiance is {self.true:.3g} W/m^2, of which quadrature of order "
            f"{self.rule.order} finds {self.found:.3g}, {self.found / self.true:.2g} times as "
            f"much: its {self.directions} directions {'pass by' if lost else 'meet by chance'} a "
            "small bright part, such as a sun."
        )


def found_by_quadrature(light: EnvironmentMap, rule: Quadrature) -> Found | None:
    """Compare a quadrature of an environment with its true irradiance on seven surface
    orientations. Return the worst case if its error is large, else None. The environment must not
    be traced by JAX."""
    whole = _all_cells(light)
    brightest = whole[0][np.argmax(whole[1])]
    normals = np.concatenate([np.eye(3), -np.eye(3), brightest[None]])
    nodes, shares = (np.asarray(x) for x in light_nodes(light, rule, light.radiance.dtype))
    found, true = (
        np.array([np.maximum(directions @ normal, 0) @ amounts for normal in normals])
        for directions, amounts in (_arriving(light, nodes, shares), whole)
    )
    worst = int(np.argmax(np.abs(found - true)))
    if not abs(found[worst] - true[worst]) > MISSED * true.max():
        return None
    return Found(normals[worst], float(true[worst]), float(found[worst]), rule, len(nodes))


def warn_of_skies(lights: Sequence[Light], rules: Sequence[Rule], cure: str) -> None:
    """Warn of the first environment whose quadrature has a large error; environments that JAX
    traces are skipped. `cure` is a sentence that says what to do."""
    for i, (light, rule) in enumerate(zip(lights, rules, strict=True)):
        if not (isinstance(light, EnvironmentMap) and isinstance(rule, Quadrature)):
            continue
        if not all(map(is_known, jax.tree.leaves(light))):
            continue
        with jax.ensure_compile_time_eval():  # known values may occur inside a trace
            wrong = found_by_quadrature(light, rule)
        if wrong is not None:
            warn_caller(f"{wrong.sentence(f'lights[{i}]')} {cure}")
            return


def _all_cells(light: EnvironmentMap) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions of all cells of an environment in the world, (n, 3), and the irradiance
    from each, W m^-2, averaged over the bands."""
    radiance = np.asarray(light.radiance)
    rows, columns = (size * -(-_ROWS // radiance.shape[0]) for size in radiance.shape[:2])
    edges = np.cos(np.linspace(0, np.pi, rows + 1))
    cosine = np.cos((np.arange(rows) + 0.5) * np.pi / rows)
    around = (np.arange(columns) + 0.5) / columns
    weights = (edges[:-1] - edges[1:]) / (2 * columns)
    if rows > radiance.shape[0]:
        places = np.stack(np.meshgrid((1 - cosine) / 2, around, indexing="ij"), -1).reshape(-1, 2)
        return _arriving(light, places, np.repeat(weights, columns))
    mean = radiance @ np.full(radiance.shape[-1], 1 / radiance.shape[-1], radiance.dtype)
    power = mean * (4 * np.pi * weights[:, None])
    # the sum over each block of pixels, with the direction of the block's middle
    down, across = (np.arange(0, size, max(1, rows // _ROWS)) for size in (rows, columns))
    power = np.add.reduceat(np.add.reduceat(power, down, axis=0), across, axis=1)
    theta = np.pi / 2 * (down + np.append(down[1:], rows)) / rows
    turn = np.pi * (1 - (across + np.append(across[1:], columns)) / columns)
    own_axes = np.stack(
        [
            np.outer(np.sin(theta), np.cos(turn)),
            np.outer(np.sin(theta), np.sin(turn)),
            np.outer(np.cos(theta), np.ones_like(turn)),
        ],
        axis=-1,
    )
    return own_axes.reshape(-1, 3) @ np.asarray(light.rotation, float), power.ravel()


def _arriving(
    light: EnvironmentMap, places: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions in the world of nodes in the unit square, and the irradiance from each,
    W m^-2, averaged over the bands."""
    sent = _nodes(light, jnp.asarray(places, light.radiance.dtype))
    amounts = np.asarray(sent.irradiance, float).mean(axis=-1) * weights
    return np.asarray(as_array(sent.direction), float), amounts


@jax.jit
def _nodes(light: EnvironmentMap, places: Float[jax.Array, "n 2"]) -> Incident:
    return jax.vmap(lambda u: environment_node(light, jnp.zeros(3, u.dtype), u))(places)
