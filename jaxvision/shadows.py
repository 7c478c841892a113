"""Which light comes through to a point of a surface: shadows, hard for each sample of a light.

Lengths in m; no gradient. For ONE point: the caller vmaps.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool

from ._groups import group_by_structure
from ._staging import stored
from ._types import Scalar, common_dtype
from ._vector import Vector, as_vec
from .geometry import Shapes, blocked, occluded, sorted_shapes
from .lights import Incident, Quadrature, Rule, incident, incident_sample, light_nodes
from .scene import Light

DEFAULT_RULE = Quadrature(8)  # 1e-5 off a quarter of its side below a square light

TRACED = "traced"  # what a search among all shapes found: few bytes, and dear to find again

Visible = tuple[Bool[Array, " _"], ...]


class Leaving(eqx.Module):
    """How shadow rays leave a surface. `normal`: (3,) unit, of the surface itself. `size`: () m,
    as `geometry.Hit.size`, or None: that of the largest shape."""

    normal: Vector
    size: Scalar | None = None


class Place(eqx.Module):
    """A point of a surface, m, and what may lie between it and the light."""

    point: Vector
    leaving: Leaving
    occluders: Shapes


def clear(place: Place, direction: Vector, distance: Scalar) -> Bool[Array, ""]:
    """Whether light from so far, m, in a unit direction comes through to the place."""
    normal, size = place.leaving.normal, place.leaving.size
    return ~occluded(place.point, normal, direction, distance, place.occluders, size=size)


def comes_through(place: Place, arriving: Incident) -> Bool[Array, ""]:
    """Whether what a light sends comes through to the place; lengths in m."""
    return clear(place, arriving.direction, _distance(arriving))


def light_comes_through(place: Place, light: Light) -> Bool[Array, ""]:
    """Whether a light at one place comes through to a point; lengths in m. One loop over the rays,
    from the light's place to the answer."""
    return checkpoint_name(stored(_comes_through, place, light), TRACED)


def _comes_through(place: Place, light: Light) -> Bool[Array, ""]:
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


def visibility(
    lights: Sequence[Light],
    point: Vector,
    occluders: Shapes,
    leaving: Leaving,
    *,
    rule: Rule = DEFAULT_RULE,
) -> Visible:
    """Which nodes of each light come through to `point`, (3,) m: (nodes,) for each. No gradient;
    no unit."""
    place, dtype = Place(point, leaving, sorted_shapes(occluders)), common_dtype(lights, point)

    def of_light(light: Light) -> Bool[Array, " nodes"]:
        nodes, weights = light_nodes(light, rule, dtype)
        return jax.lax.map(
            lambda node: comes_through(place, incident_sample(light, rule, place.point, *node)),
            (nodes, weights),
        )

    flags: dict[int, Bool[Array, " nodes"]] = {}
    for members, group in group_by_structure(lights):
        flags |= dict(zip(members, jax.lax.map(of_light, group), strict=True))
    return tuple(flags[i] for i in range(len(lights)))
