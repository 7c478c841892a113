"""Who sees whom: the table of form factors between the patches of a scene, and its two laws.

A row of the table belongs to an element, which receives, and a column to a patch, which sends:
F from the element's centre to the patch by `point_to_polygon`, times the part of the patch that
shadow rays find in sight. Fixed geometry needs the table once, whatever the colours.
"""

from collections.abc import Callable
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from ..._numerics import dot, norm
from ..._random import Stream, uniforms
from ..._staging import stored
from ..._types import Scalar
from ..._vector import Vec, where
from ...geometry import (
    Sorted,
    largest_size,
    occluded,
    offset_length,
    offset_origin,
    sorted_shapes,
)
from ...scene import Scene
from ._grid import Plan
from ._polygons import far_factor, is_far, near_factor, on_polygon
from ._receivers import receivers_of
from .patches import Patches, patches_of

TILE = 128  # elements by patches at once: what is not needed for any of them is skipped
# steps of the Kronecker sequence of the plastic number (Roberts, 2018)
Number = UInt32[Array, ""]
Numbers = UInt32[Array, "*tiles n"]
_STEPS = (0.7548776662466927, 0.5698402909980532)


def form_factor_table(
    scene: Scene, plan: Plan, *, rays: int = 1
) -> Float[Array, "elements patches"]:
    """F from each element to each patch of a plan: (elements, patches), no unit.

    `rays`: static, how many shadow rays decide how much of a patch an element sees, at least 1
    else `ValueError`; they go to places spread over the patch, and differently for each pair, so
    that a patch, split into elements, sees others by split^2 `rays` rays. The error of a
    half-hidden factor is of the order of itself over sqrt(rays), and averages out over patches.
    Elements receive at their centres, those covered in part where they are open: reciprocity holds
    to 2 % of the largest exchange in a cube of 3 x 3 patches a wall, split by 2, and better with a
    finer split.
    Gradients in the geometry are those of the unoccluded factors: none reaches visibility.
    """
    if rays < 1:
        raise ValueError(f"rays must be at least 1, got {rays}.")
    patches = stored(partial(patches_of, plan=plan), scene)
    elements = receivers_of(scene, plan).elements
    shapes = [surface.shape for surface in scene.surfaces]
    size, ready = stored(largest_size, shapes), stored(sorted_shapes, shapes)
    counts = len(elements.area), len(patches.area)

    def seen(element: Patches, receiver: Number, patch: Patches, sender: Number) -> Scalar:
        stream = Stream(receiver, sender, jnp.asarray(_SEED))
        return _visible_part(element, patch, stream, rays, ready, size)

    def tile(receivers: tuple[Patches, Numbers], senders: tuple[Patches, Numbers]) -> Array:
        pair = receivers[0], senders[0]
        factors = _every(partial(_far_factor, offset_length(size)), *pair)
        factors = jax.lax.cond(
            (factors < 0).any(),
            lambda: jnp.where(factors < 0, _every(_near_factor, *pair), factors),
            lambda: factors,
        )
        return jax.lax.cond(
            (factors > 0).any(),
            lambda: factors * _every(lambda e, p: seen(*e, *p), receivers, senders),
            lambda: factors,
        )

    def rows(receivers: tuple[Patches, Numbers]) -> Array:
        return jax.lax.map(jax.checkpoint(partial(tile, receivers)), _in_tiles(patches))

    table = jax.lax.map(rows, _in_tiles(elements))  # (tiles, tiles, TILE, TILE)
    table = table.swapaxes(1, 2).reshape(table.shape[0] * TILE, -1)
    return table[: counts[0], : counts[1]]


def _in_tiles(patches: Patches) -> tuple[Patches, Numbers]:
    """Patches and their numbers by the tile, (tiles, TILE); the last one is repeated to fill up."""
    count = len(patches.area)
    numbers = np.minimum(np.arange(-(-count // TILE) * TILE), count - 1).reshape(-1, TILE)
    return jax.tree.map(lambda x: x[numbers], patches), jnp.asarray(numbers, jnp.uint32)


def _every(pair: Callable[[Any, Any], Any], first: Any, second: Any) -> Any:
    """`pair` of each of the first with each of the second."""
    return jax.vmap(lambda e: jax.vmap(lambda p: pair(e, p))(second))(first)


def _far_factor(rounding: Scalar, element: Patches, patch: Patches) -> Scalar:
    """The factor as from far away; -1 where the patch is too near for that, and 0 where the element
    is less than `rounding`, m, in front of it: there the contour is noise.

    One number, not a number and a flag: XLA may compute the two in different places with different
    rounding, and what then is neither near nor far is lost, or taken for far when it touches.
    """
    above = [dot(element.normal, corner - element.centre) > 0 for corner in patch.corners]
    front = dot(patch.normal, element.centre - patch.centre) > rounding
    faces = (element.plane != patch.plane) & front & reduce(jnp.logical_or, above)
    factor = far_factor(element.centre, element.normal, patch.corners)
    return jnp.where(faces, jnp.where(is_far(element.centre, patch.corners), factor, -1), 0)


def _near_factor(element: Patches, patch: Patches) -> Scalar:
    return near_factor(element.centre, element.normal, patch.corners)


_TRIES = 6  # a patch cut in half by the horizon is missed once in 2^6
_SEED = np.array([0x9E3779B9, 0x7F4A7C15], np.uint32)


def _visible_part(
    element: Patches, patch: Patches, stream: Stream, rays: int, shapes: Sorted, size: Scalar
) -> Scalar:
    """The fraction of rays from an element's centre to places of a patch, m, that nothing stops."""
    start = element.centre + element.bulge * element.normal
    shift = uniforms(stream, 0, element.area.dtype)[:2]

    def ray(k: Int[Array, ""], seen: Scalar) -> Scalar:
        target = _place_above(element, patch, shift, k)
        # aimed above the patch, or it would itself be met by a ray whose start has been moved
        toward = offset_origin(target, patch.normal, patch.normal, size=4 * size) - start
        distance = norm(toward)
        direction = toward * (1 / jnp.where(distance > 0, distance, 1))
        blocked = occluded(start, element.normal, direction, distance, shapes)
        return seen + jnp.where(blocked, 0, jnp.ones_like(seen))

    return jax.lax.fori_loop(0, rays, ray, jnp.zeros_like(shift[0])) / rays


def _place_above(
    element: Patches, patch: Patches, shift: Float[Array, "2"], ray: Int[Array, ""]
) -> Vec:
    """A place of a patch for the ray of that number, m, above the element's horizon if one of
    `_TRIES` is: the factor is that of the part above alone, and so must be its visible fraction."""

    def place(k: int) -> Vec:
        number = (ray * _TRIES + k).astype(shift.dtype)
        s, t = ((u + number * step) % 1 for u, step in zip(shift, _STEPS, strict=True))
        return on_polygon(patch.corners, s, t)[0] + patch.bulge * patch.normal

    chosen = place(0)
    for k in range(1, _TRIES):
        below = dot(element.normal, chosen - element.centre) <= 0
        chosen = where(below, place(k), chosen)
    return chosen


def closure_error(table: Float[Array, "n patches"]) -> Float[Array, " n"]:
    """How far each row's sum is from 1, no unit: in a closed scene all light arrives somewhere;
    in an open one it is what escapes."""
    return table.sum(axis=1) - 1


def reciprocity_error(
    table: Float[Array, "patches patches"], area: Float[Array, " patches"]
) -> Float[Array, "patches patches"]:
    """A_i F_ij - A_j F_ji in m^2, which is 0 of exact factors."""
    exchange = area[:, None] * table
    return exchange - exchange.T
