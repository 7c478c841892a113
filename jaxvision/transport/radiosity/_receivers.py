"""The receiving parts of the elements of a plan: the parts that no other body covers.

Each element is divided into parts once more, and its direct irradiance is the mean over these. If
the edge of a shadow crosses an element, only its lit part counts. Lengths in m.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...core._loops.fusion import TILE, at_a_time, in_tiles
from ...core._numerics import divide, dot
from ...core._vector import Vec, as_array, as_vec, where
from ...geometry import Ray, Sorted, hit_shape, nearest_shape, offset_origin
from ...scene import Scene
from ._grid import Plan, refined
from .patches import Patches, by_patch, patches_at

_PARTS = 2  # of an element, along each side
_LEAST = 1e-3  # of an element, far less than a part is


class Receivers(eqx.Module):
    """`patches`: all patches of the plan. `elements`, `parts`: covered ones have no area. A partly
    covered element has the area of the uncovered part, and its centre is uncovered."""

    patches: Patches
    elements: Patches
    parts: Patches


def receivers_of(scene: Scene, plan: Plan, shapes: Sorted) -> Receivers:
    """The patches of a plan, their elements and the parts of those; lengths in m. `shapes`: of the
    scene's surfaces."""
    splits = (1, plan.split, plan.split * _PARTS)
    patches, elements, parts = patches_at(scene, plan, splits)
    covered = _covered(scene, parts, shapes)
    uncovered = 1 - mean_of_parts(covered[:, None].astype(parts.area.dtype), parts, plan)[:, 0]
    # a mean of ones may round to less than 1, and no part would be left to define a centre
    uncovered = jnp.where(uncovered > _LEAST, uncovered, 0)
    uncovered = jnp.where(uncovered < 1 - _LEAST, uncovered, 1)
    parts = eqx.tree_at(lambda p: p.area, parts, jnp.where(covered, 0, parts.area))
    # The middle of an L is outside it where a body's corner reaches past the element's own middle:
    # of three open parts of four the one across from the body is taken, of fewer their middle.
    middle = as_vec(mean_of_parts(as_array(parts.centre), parts, plan))
    partly = (uncovered > 0) & (uncovered < 1)
    away = divide(uncovered, jnp.minimum(uncovered, 1 - uncovered), partly, uncovered)
    in_the_open = elements.centre + away * (middle - elements.centre)
    elements = eqx.tree_at(
        lambda e: (e.centre, e.area),
        elements,
        (where(partly, in_the_open, elements.centre), elements.area * uncovered),
    )
    return Receivers(patches, elements, parts)


def mean_of_parts(
    values: Float[Array, "parts n"], parts: Patches, plan: Plan
) -> Float[Array, "elements n"]:
    """The mean over the parts of each element, in the unit of the values."""
    return by_patch(values, parts, refined(plan, _PARTS))


def _covered(scene: Scene, patches: Patches, shapes: Sorted) -> Bool[Array, " patches"]:
    """Whether the surface in front of a patch shows its back, as seen from inside a body."""
    two_sided = jnp.asarray([surface.two_sided for surface in scene.surfaces])

    def at(point: Vec, normal: Vec) -> Bool[Array, ""]:
        ray = Ray(offset_origin(point, normal, normal, size=shapes.size), normal)
        encounter = nearest_shape(ray, shapes)
        back = dot(hit_shape(ray, shapes, encounter).normal, normal) > 0
        return back & (encounter.shape >= 0) & ~two_sided[jnp.maximum(encounter.shape, 0)]

    start = patches.centre + patches.bulge * patches.normal
    return in_tiles(at, *jax.lax.stop_gradient((start, patches.normal)), size=at_a_time(TILE))
