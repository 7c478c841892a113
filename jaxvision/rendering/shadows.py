"""The visibility of lights from a point of a surface, with one shadow ray for each sample of a
light.

Lengths are in m. Visibility has no gradient. All functions are for one point; use `jax.vmap` for
many.
"""

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool

from ..core._arguments import takes_numbers
from ..core._loops.fusion import materialise
from ..core._loops.groups import UNROLLED
from ..core._shown import Shown
from ..core._types import Scalar, common_dtype
from ..core._vector import Direction, Vector, as_vec
from ..core.parallel_loops import fori_loop, map_, scan
from ..geometry import Shapes, Sorted, blocked, occluded, sorted_shapes
from ..lights import (
    Balanced,
    Incident,
    Quadrature,
    Rule,
    can_be_seen,
    incident,
    incident_sample,
    light_nodes,
    lights_by_rule,
    rule_of_each,
)
from ..scene import Light

# The error of this rule is 1e-5 below a square light, at a distance of a quarter of the light's
# side.
DEFAULT_RULE = Quadrature(8)

# name of the results of a search among all shapes, which are small and expensive to recompute
TRACED = "traced"

Visible = tuple[Bool[Array, " _"] | None, ...]


class Leaving(Shown):
    """The offset of the start of shadow rays from a surface.

    Attributes:
        normal: (3,) unit length, of the surface itself, not interpolated.
        size: () m, as `geometry.Hit.size`; None for the size of the largest shape.

    Example:
        >>> up, roof = jnp.array([0.0, 0.0, 1.0]), jv.Disc([0, 0, 2], [0, 0, 1], 1)
        >>> lamp = jv.PointLight([0, 0, 3], [1.0])
        >>> bool(jv.visibility([lamp], jnp.zeros(3), [roof], jv.Leaving(up))[0][0])
        False
    """

    normal: Direction
    size: Scalar | None = None


class Place(Shown):
    """A point of a surface, and the shapes that may block light to it.

    Attributes:
        point: (3,) m.
        leaving: offset of shadow rays from the surface.
        occluders: the shapes that block light, m.
    """

    point: Vector
    leaving: Leaving
    occluders: Sorted


def clear(place: Place, direction: Direction, distance: Scalar) -> Bool[Array, ""]:
    """Return whether light reaches the point from the distance `distance`, () m, in a unit
    direction."""
    normal, size = place.leaving.normal, place.leaving.size
    return ~occluded(place.point, normal, direction, distance, place.occluders, size=size)


@takes_numbers
def visibility(
    lights: Sequence[Light],
    point: Vector,
    occluders: Shapes,
    leaving: Leaving,
    *,
    rule: Rule | Sequence[Rule] = DEFAULT_RULE,
) -> Visible:
    """Find which samples of each light are visible from a point. The result has no gradient.

    Args:
        lights: any number of sources.
        point: (3,) m.
        occluders: at least one shape; all of them block light.
        leaving: offset of shadow rays from the surface at the point.
        rule: sampling rule of extended lights, one for all or one for each light.

    Returns:
        For each light, (samples,) whether each sample reaches the point. A light without size has
        one sample. None for an extended light under `Balanced`, whose rays depend on the material.

    Example:
        >>> up, roof = jnp.array([0.0, 0.0, 1.0]), jv.Disc([0, 0, 2], [0, 0, 1], 1)
        >>> lamps = [jv.PointLight([0, 0, z], [1.0]) for z in (1, 3)]
        >>> [bool(seen[0]) for seen in jv.visibility(lamps, jnp.zeros(3), [roof], jv.Leaving(up))]
        [True, False]
    """
    place = Place(point, leaving, sorted_shapes(occluders))
    found: list[Bool[Array, " _"] | None] = [None] * len(lights)
    for members, group, own in lights_by_rule(lights, rule_of_each(lights, rule)):
        extended = can_be_seen(lights[members[0]])
        if extended and isinstance(own, Balanced):
            continue

        of_light = partial(samples_that_reach, place, own)
        if extended or len(members) > UNROLLED:
            flags = list(map_(of_light, group))
        else:
            flags = [materialise(_light_comes_through, place, lights[i])[None] for i in members]
            flags = [checkpoint_name(flag, TRACED) for flag in flags]
        for i, own_flags in zip(members, flags, strict=True):
            found[i] = own_flags
    return tuple(found)


def visible_in_order(
    group: Light,
    shown: Callable[[Light], Array],
    reached: Callable[[Light], Bool[Array, "rays samples"]],
    threshold: Scalar,
) -> tuple[Bool[Array, "lights rays samples"], Bool[Array, " lights"]]:
    """Trace the shadow rays of stacked lights for a group of camera rays, brightest light first.
    The order is that of the largest radiance that a light can add to any ray. Stop when the
    remaining lights together add at most `threshold` to each ray.

    Source: Ward, "Adaptive Shadow Testing for Ray Tracing", Proc. 2nd Eurographics Workshop on
    Rendering (1991), where each ray has its own order.

    Args:
        group: stacked lights.
        shown: function from a light to the radiance that it adds to each ray without shadows,
            (rays,) W m^-2 sr^-1, an upper bound.
        reached: function from a light to whether each of its samples reaches the point of each ray.
        threshold: () W m^-2 sr^-1.

    Returns:
        Whether each sample reaches each point, False for lights that were not traced; and whether
        each light was traced. No gradient.
    """
    group, threshold = jax.lax.stop_gradient((group, threshold))
    radiance = jax.lax.stop_gradient(jax.vmap(shown)(group))
    most = radiance.max(axis=1)
    # Ascending: the brightest is last
    order = jnp.argsort(jnp.where(jnp.isnan(most), jnp.inf, most))

    def add(rest: Array, number: Array) -> tuple[Array, Array]:
        rest = rest + radiance[number]
        return rest, rest.max()

    _, rests = scan(add, jnp.zeros_like(radiance[0]), order)
    needed = jnp.sum(~(rests <= threshold))  # NaN counts as above the threshold

    def trace(turn: Array, flags: Array) -> Array:
        number = order[-1 - turn]
        light = jax.tree.map(lambda leaf: leaf[number], group)
        return flags.at[number].set(reached(light))

    count = len(order)
    like = jax.eval_shape(reached, jax.tree.map(lambda leaf: leaf[0], group))
    flags = fori_loop(0, needed, trace, jnp.zeros((count, *like.shape), bool))
    traced = jnp.zeros(count, bool).at[order].set(jnp.arange(count) >= count - needed)
    return checkpoint_name((flags, traced), TRACED)


def samples_that_reach(place: Place, rule: Rule, light: Light) -> Bool[Array, " _"]:
    """Return whether each sample of a light is visible from the point, (samples,), no unit."""

    def is_visible(node: tuple[Array, Array]) -> Bool[Array, ""]:
        arriving = incident_sample(light, rule, place.point, *node)
        return clear(place, arriving.direction, _distance(arriving))

    dtype = common_dtype(light, place.point)
    return map_(is_visible, light_nodes(light, rule, dtype))


def _light_comes_through(place: Place, light: Light) -> Bool[Array, ""]:
    """Return whether a light without size is visible from the point, computed in one loop over all
    rays."""
    arriving, leaving = incident(light, place.point), place.leaving
    return ~blocked(
        place.point,
        leaving.normal,
        arriving.direction,
        _distance(arriving),
        place.occluders,
        leaving.size,
    )


def _distance(arriving: Incident) -> Scalar:
    if arriving.distance is None:
        return jnp.full_like(as_vec(arriving.direction).x, jnp.inf)
    return arriving.distance
