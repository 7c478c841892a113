"""A light sampled by a rule, one node at a time: what a loop over samples runs on."""

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from .._types import Scalar, check_kind
from .._vector import Vector
from ..scene import Light
from ._nodes import shifted_lattice
from ._registry import Discrete, Incident, kind_of
from .rules import Balanced, MonteCarlo, Random, Rule


def light_nodes(
    light: Light, rule: Rule, dtype: DTypeLike
) -> tuple[Float[Array, "samples 2"], Float[Array, " samples"]]:
    """Where in the unit square a rule looks at a light, and the weights, of sum 1; no unit. A
    light at one place is looked at once. `ValueError` for what is no rule."""
    check_kind("rule", rule, Rule)
    kind = kind_of(light)
    if isinstance(kind, Discrete):
        return jnp.zeros((1, 2), dtype), jnp.ones(1, dtype)
    if isinstance(rule, Random):
        return shifted_lattice(rule.key, rule.samples, dtype)
    nodes, weights = kind.nodes(rule.order)
    return jnp.asarray(nodes, dtype), jnp.asarray(weights, dtype)


def incident_sample(
    light: Light, rule: Rule, point: Vector, u: Float[Array, "2"], weight: Scalar
) -> Incident:
    """What one node of `light_nodes` sends to `point`, (3,) in m: its irradiance, W m^-2, is the
    radiance times the solid angle that the node stands for."""
    kind = kind_of(light)
    if isinstance(kind, Discrete):
        return kind.incident(light, point)
    arriving = (kind.sample if isinstance(rule, Random) else kind.node)(light, point, u)
    return Incident(arriving.direction, arriving.irradiance * weight, arriving.distance)


def rule_for(rule: Rule, number: Int[Array, ""]) -> Rule:
    """The rule for one of many points, pixels by their number: each draws its own random samples;
    fixed nodes stay as they are."""
    match rule:
        case MonteCarlo():
            return MonteCarlo(jax.random.fold_in(rule.key, number), rule.samples)
        case Balanced():
            return Balanced(jax.random.fold_in(rule.key, number), rule.samples)
    return rule
