"""The parts of a plan's elements that receive light, because they are not inside another body.

Each element is divided further into parts. The direct irradiance of an element is the mean over its
parts, so that an element that a shadow edge crosses receives light in proportion to its lit area.
Lengths are in m.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...core._loops.fusion import TILE, entries_per_step, vmap_in_tiles
from ...core._numerics import divide, dot
from ...core._vector import Vec, as_array, as_vec, where
from ...geometry import Ray, Sorted, hit_shape, nearest_shape, offset_origin
from ...scene import Scene
from ._grid import Plan, refined
from .patches import Patches, patch_means, patches_at

_PARTS = 2  # parts along each side of an element
_LEAST = 1e-3  # tolerance for rounding, as a fraction of an element's area; a part is far larger


class Receivers(eqx.Module):
    """The patches of a plan, their elements, and the parts of the elements. An element or part that
    is covered by another body has the area 0. A partly covered element has the area of its
    uncovered parts, and its centre is moved to an uncovered point."""

    patches: Patches
    elements: Patches
    parts: Patches


def receivers_of(scene: Scene, plan: Plan, shapes: Sorted) -> Receivers:
    """Return the patches of a plan, their elements, and the parts of the elements; lengths in m.
    `shapes` are the sorted shapes of the scene."""
    splits = (1, plan.split, plan.split * _PARTS)
    patches, elements, parts = patches_at(scene, plan, splits)
    covered = _is_covered(scene, parts, shapes)
    uncovered = 1 - mean_of_parts(covered[:, None].astype(parts.area.dtype), parts, plan)[:, 0]
    # A mean of ones may round to less than 1. Without this step, an element without an open part
    # could count as partly open.
    uncovered = jnp.where(uncovered > _LEAST, uncovered, 0)
    uncovered = jnp.where(uncovered < 1 - _LEAST, uncovered, 1)
    parts = eqx.tree_at(lambda p: p.area, parts, jnp.where(covered, 0, parts.area))
    # If three of four parts are open, the mean of their centres may lie inside the covering body.
    # Then the centre is moved to the part opposite the body. With one or two open parts the mean is
    # used.
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
    """Return the mean of values over the parts of each element, in the unit of the values."""
    return patch_means(values, parts, refined(plan, _PARTS))


def _is_covered(scene: Scene, patches: Patches, shapes: Sorted) -> Bool[Array, " patches"]:
    """Return whether each patch lies inside a body: whether the ray along its normal hits the back
    of a surface."""
    two_sided = jnp.asarray([surface.two_sided for surface in scene.surfaces])

    def faces_inside(point: Vec, normal: Vec) -> Bool[Array, ""]:
        ray = Ray(offset_origin(point, normal, normal, size=shapes.size), normal)
        encounter = nearest_shape(ray, shapes)
        back = dot(hit_shape(ray, shapes, encounter).normal, normal) > 0
        return back & (encounter.shape >= 0) & ~two_sided[jnp.maximum(encounter.shape, 0)]

    start = patches.centre + patches.bulge * patches.normal
    return vmap_in_tiles(
        faces_inside, *jax.lax.stop_gradient((start, patches.normal)), size=entries_per_step(TILE)
    )
