"""Sample lights at the nodes of a sampling rule, one node at a time, for a loop over samples."""

from collections.abc import Sequence
from functools import reduce
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Integer

from ..core._arguments import takes_numbers
from ..core._loops.groups import group_by_structure
from ..core._types import Scalar, check_kind
from ..core._vector import Vector
from ..scene import Light, Scene
from ._nodes import shifted_lattice
from ._registry import Discrete, Incident, kind_of
from .rules import Balanced, MonteCarlo, Random, Rule

AnyRule = TypeVar("AnyRule", bound=Rule)


def light_nodes(
    light: Light, rule: Rule, dtype: DTypeLike
) -> tuple[Float[Array, "samples 2"], Float[Array, " samples"]]:
    """Return the positions in the unit square at which a rule samples a light.

    Args:
        light: any registered light; a light without size has one sample.
        rule: sampling rule.
        dtype: floating, of the result.

    Returns:
        (samples, 2) positions in the unit square and (samples,) weights of sum 1, no unit.

    Raises:
        ValueError: if `rule` is not a rule.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 3], [0, 2, 0], [2, 0, 0], [5.0])
        >>> places, weights = jv.lights.light_nodes(lamp, jv.Quadrature(2), np.float32)
        >>> print(places.shape, weights)
        (4, 2) [0.25 0.25 0.25 0.25]
    """
    check_kind("rule", rule, Rule)
    kind = kind_of(light)
    if isinstance(kind, Discrete):
        return jnp.zeros((1, 2), dtype), jnp.ones(1, dtype)
    if isinstance(rule, Random):
        return shifted_lattice(rule.key, rule.samples, dtype)
    nodes, weights = kind.nodes(rule.order)
    return jnp.asarray(nodes, dtype), jnp.asarray(weights, dtype)


@takes_numbers
def incident_sample(
    light: Light, rule: Rule, point: Vector, u: Float[Array, "2"], weight: Scalar
) -> Incident:
    """Return the light that reaches a point from one node of a sampling rule (`light_nodes`).

    Args:
        light: any registered light.
        rule: the sampling rule that gave the node.
        point: (3,) m.
        u: (2,) the node, no unit.
        weight: () of the node, no unit.

    Returns:
        Direction, distance, and irradiance, (bands,) W m^-2: radiance times the solid angle of the
        node.

    Example:
        >>> lamp = jv.PointLight([0, 0, 2], [8.0])  # W sr^-1
        >>> node = jv.lights.incident_sample(lamp, jv.Quadrature(1), [0, 0, 0], [0.5, 0.5], 1.0)
        >>> print(node.distance, node.irradiance)  # 8 / 2^2 W m^-2
        2.0 [2.]
    """
    kind = kind_of(light)
    if isinstance(kind, Discrete):
        return kind.incident(light, point)
    arriving = (kind.sample if isinstance(rule, Random) else kind.node)(light, point, u)
    return Incident(arriving.direction, arriving.irradiance * weight, arriving.distance)


def rule_for(rule: AnyRule, number: Integer[Array, ""]) -> AnyRule:
    """Return a sampling rule whose random samples are specific to one of many points.

    Args:
        rule: sampling rule for all points.
        number: () whole number that identifies the point, for example a pixel, no unit.

    Returns:
        The rule with a random key for this point; a rule with fixed nodes is returned unchanged.
    """
    if isinstance(rule, MonteCarlo | Balanced):
        return type(rule)(jax.random.fold_in(rule.key, number), rule.samples)
    return rule


def rules_of(
    scene: Scene, rule: Rule, *, numbers: Sequence[Array] = (), count: int | None = None
) -> tuple[Rule, ...]:
    """Return the sampling rule of each light of a scene: the light's entry in `Scene.rules`, or
    `rule` if it has none.

    Args:
        scene: gives the lights, and their rules if they have any.
        rule: sampling rule for all lights without a rule of their own.
        numbers: () each, whole numbers that identify a pixel and its sample, or another point.
            Random rules draw different samples for different numbers. Without numbers, rules are
            returned unchanged.
        count: number of sources: first the scene's lights, then surfaces that emit, which use
            `rule`; None for the lights alone.

    Returns:
        One rule for each source.

    Raises:
        ValueError: if an entry of `Scene.rules` is neither a rule nor None.
    """

    def anew(rule: Rule) -> Rule:
        return reduce(rule_for, numbers, rule)

    shared, own_rules = anew(rule), scene.rules or ()
    for i, own in enumerate(own_rules):
        check_kind(f"Scene.rules[{i}]", own, Rule)
    rules = [shared if own is None else anew(own) for own in own_rules]
    count = len(scene.lights) if count is None else count
    return (*rules, *(shared,) * (count - len(rules)))


def rule_of_each(lights: Sequence[Light], rule: Rule | Sequence[Rule]) -> tuple[Rule, ...]:
    """Return one sampling rule for each light.

    Args:
        lights: any lights.
        rule: one for each light, or a single one for all.

    Returns:
        As many rules as lights.

    Raises:
        ValueError: if there are not as many rules as lights.

    Example:
        >>> lamp = jv.PointLight([0, 0, 2], [8.0])
        >>> print(len(jv.lights.rule_of_each([lamp, lamp], jv.Quadrature(4))))
        2
    """
    if not isinstance(rule, Sequence):
        return (rule,) * len(lights)
    if len(rule) != len(lights):
        raise ValueError(
            f"rule must be one, or one for each of {len(lights)} lights, got {len(rule)}."
        )
    return tuple(rule)


def lights_by_rule(
    lights: Sequence[Light], rules: Sequence[Rule]
) -> list[tuple[tuple[int, ...], Light, Rule]]:
    """Stack the lights that have the same structure and the same sampling rule.

    Args:
        lights: any lights.
        rules: one for each light.

    Returns:
        For each stack: the indices of its lights, the stack, the rule.
    """
    groups = group_by_structure(lights)
    return [part for members, group in groups for part in split_by_rule(members, group, rules)]


def split_by_rule(
    members: tuple[int, ...], group: Any, rules: Sequence[AnyRule]
) -> list[tuple[tuple[int, ...], Any, AnyRule]]:
    """Divide a stack of sources into parts whose members have the same sampling rule.

    Args:
        members: indices of the sources in the scene.
        group: the sources, stacked along the leading axis of each array.
        rules: one for each source of the scene.

    Returns:
        For each part: the indices of its sources in the scene, the stack, the rule.
    """
    shared: dict[tuple, list[int]] = {}
    for place, i in enumerate(members):
        leaves, kind = jax.tree.flatten(rules[i])
        shared.setdefault((kind, *map(id, leaves)), []).append(place)
    if len(shared) == 1:
        return [(members, group, rules[members[0]])]
    return [
        (
            tuple(members[place] for place in places),
            jax.tree.map(lambda leaf, at=tuple(places): leaf[jnp.asarray(at)], group),
            rules[members[places[0]]],
        )
        for places in shared.values()
    ]
