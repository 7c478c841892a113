"""The table of form factors between the patches of a scene, and two checks of it (closure and
reciprocity).

A row of the table belongs to a receiving element, and a column to a sending patch. An entry is the
form factor from the centre of the element to the patch (`point_to_polygon`), times the share of the
patch that shadow rays reach. As long as the geometry is fixed, one table serves for any colours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...core._arguments import takes_numbers
from ...core._loops.fusion import one_program
from ...core._numerics import dot, norm, reciprocal
from ...core._quadrature import KRONECKER_STEPS
from ...core._random import Stream, uniforms
from ...core._types import Scalar, check_count
from ...core._vector import Vec
from ...core.parallel_loops import fori_loop, map_, scan
from ...geometry import (
    Sorted,
    occluded,
    offset_length,
    offset_origin,
)
from ...scene import Scene
from ._grid import Plan
from ._polygons import bilinear, contour_form_factor, far_factor, is_far
from ._receivers import receivers_of
from ._sources import largest_of, shapes_of
from .patches import Patches

# The table is computed in tiles of TILE elements by TILE patches. A step that no pair of a tile
# needs is skipped.
TILE = 128
Tile = tuple[Float[Array, "*tiles lengths n"], Int[Array, "*tiles numbers n"]]
Numbered = tuple[Patches, Int[Array, "..."]]


@one_program
def form_factor_table(
    scene: Scene, plan: Plan, *, rays: int = 1, elements: Int[Array, " rows"] | None = None
) -> Float[Array, "rows patches"]:
    """Compute the form factor from each element to each patch of a plan.

    Form factors are computed at the centre of an element, or at an uncovered point of it if it is
    partly covered. In a cube with 3 x 3 patches per wall and a split of 2, reciprocity is violated
    by at most 2 % of the largest exchange, and by less with a finer split. Gradients with respect
    to the geometry are those of the unoccluded factors, because visibility has no gradient.

    Args:
        scene: the scene of the plan.
        plan: from `plan_patches`.
        rays: static, >= 1: number of shadow rays that determine how much of a patch an element
            sees. The rays end at points spread over the patch, at different points for each pair. A
            patch with split^2 elements therefore receives light from another patch along split^2
            `rays` rays. The relative error of a half-blocked factor is about 1 / sqrt(rays), and
            averages out over patches.
        elements: (rows,) indices of the elements to compute, for example where devices share the
            work; None for all.

    Returns:
        (rows, patches), no unit.

    Raises:
        ValueError: for fewer than one ray, or a scene without surfaces.
    """
    of = _pairs_of(scene, plan, rays, elements)

    def rows(receivers: Tile) -> Array:
        return map_(partial(of.factors, receivers), of.senders)

    table = map_(rows, of.receivers)  # (tiles, tiles, TILE, TILE)
    table = table.swapaxes(1, 2).reshape(table.shape[0] * TILE, -1)
    return table[: of.counts[0], : of.counts[1]]


@takes_numbers
@one_program
def exchanged(
    scene: Scene,
    plan: Plan,
    sent: Float[Array, "patches bands"],
    *,
    rays: int = 1,
    elements: Int[Array, " rows"] | None = None,
) -> Float[Array, "rows bands"]:
    """Return the irradiance of each element from all patches, `form_factor_table(...) @ sent`,
    without storing the table. Only `TILE` by `TILE` factors are in memory at a time, and each call
    recomputes all factors.

    Use this function if the table is too large for memory. The sum over patches is computed tile by
    tile, so the result equals that with the table up to rounding.

    Args:
        scene, plan, rays, elements: as in `form_factor_table`.
        sent: (patches, bands) radiosity of each patch, W m^-2.

    Returns:
        (rows, bands) W m^-2.

    Raises:
        ValueError: for fewer than one ray, or a scene without surfaces.
    """
    of = _pairs_of(scene, plan, rays, elements)
    missing = len(of.senders[0]) * TILE - of.counts[1]
    light = jnp.pad(sent, ((0, missing), (0, 0))).reshape(-1, TILE, sent.shape[1])

    def rows(receivers: Tile) -> Array:
        def arriving(total: Array, part: tuple[Array, Tile]) -> tuple[Array, None]:
            leaving, senders = part
            return total + of.factors(receivers, senders) @ leaving, None

        # made from the receivers, so that it varies over devices in the same way
        none = jnp.zeros_like(receivers[0], shape=(TILE, sent.shape[1]), dtype=sent.dtype)
        return scan(arriving, none, (light, of.senders))[0]

    return map_(rows, of.receivers).reshape(-1, sent.shape[1])[: of.counts[0]]


@dataclass(frozen=True)
class _Pairs:
    """The elements and patches of a plan in tiles, their numbers, and the function that computes
    the form factors between two tiles, (TILE, TILE)."""

    receivers: Tile
    senders: Tile
    counts: tuple[int, int]
    factors: Callable[[Tile, Tile], Array]


def _pairs_of(scene: Scene, plan: Plan, rays: int, elements: Array | None) -> _Pairs:
    check_count("rays", rays, 1)
    shapes = shapes_of(scene)
    rounding = offset_length(largest_of(shapes))
    receivers = receivers_of(scene, plan, shapes)
    patches, numbers = receivers.patches, elements
    if numbers is None:
        numbers = jnp.arange(len(receivers.elements.area))
    wanted = jax.tree.map(lambda x: x[numbers], receivers.elements)

    def pair_visibility(receiver: Numbered, sender: Numbered) -> Scalar:
        (element, row), (patch, column) = receiver, sender
        stream = Stream(row.astype(jnp.uint32), column.astype(jnp.uint32), jnp.asarray(_SEED))
        return _visible_part(element, patch, stream, rays, shapes)

    @jax.checkpoint
    def tile(receivers: Tile, senders: Tile) -> Array:
        def every(pair: Callable[[Numbered, Numbered], Scalar]) -> Array:
            first, second = (_unpack(part, patches) for part in (receivers, senders))
            return jax.vmap(lambda e: jax.vmap(lambda p: pair(e, p))(second))(first)

        factors = every(partial(_far_factor, rounding))
        factors = jax.lax.cond(
            (factors < 0).any(),
            lambda: jnp.where(factors < 0, every(_near_factor), factors),
            lambda: factors,
        )
        return jax.lax.cond(
            (factors > 0).any(), lambda: factors * every(pair_visibility), lambda: factors
        )

    return _Pairs(
        receivers=_split_tiles(wanted, numbers),
        senders=_split_tiles(patches, jnp.arange(len(patches.area))),
        counts=(len(numbers), len(patches.area)),
        factors=tile,
    )


def _split_tiles(patches: Patches, numbers: Int[Array, " patches"]) -> Tile:
    """Divide patches and their indices into tiles. The last patch is repeated to fill the last
    tile. All real numbers are stored in one array and all integers in another, because every
    further array makes the compiled code longer."""
    count = len(patches.area)
    tiles = np.minimum(np.arange(-(-count // TILE) * TILE), count - 1).reshape(-1, TILE)
    leaves = jax.tree.leaves(patches)
    measured = jnp.stack([x for x in leaves if jnp.issubdtype(x.dtype, jnp.floating)])
    counted = [x for x in leaves if not jnp.issubdtype(x.dtype, jnp.floating)]
    counted = jnp.stack([*counted, numbers.astype(jnp.int32)])
    return measured[:, tiles].swapaxes(0, 1), counted[:, tiles].swapaxes(0, 1)


def _unpack(tile: Tile, like: Patches) -> Numbered:
    """Return the patches of a tile, in the structure of `like`, and their indices."""
    rows = [iter(array) for array in tile]
    leaves, structure = jax.tree.flatten(like)
    of_kind = [next(rows[not jnp.issubdtype(leaf.dtype, jnp.floating)]) for leaf in leaves]
    return jax.tree.unflatten(structure, of_kind), next(rows[1])


def _far_factor(rounding: Scalar, receiver: Numbered, sender: Numbered) -> Scalar:
    """Return the form factor by the far-field quadrature, or -1 if the patch is too near for it.
    The result is 0 if the element is less than `rounding`, m, in front of the patch, where the
    contour integral is dominated by rounding errors. The value -1 replaces a separate flag. XLA may
    round differently for factor and flag, so with a flag a pair could be neither near nor far."""
    element, patch = receiver[0], sender[0]
    above = [dot(element.normal, corner - element.centre) > 0 for corner in patch.corners]
    front = dot(patch.normal, element.centre - patch.centre) > rounding
    faces = (element.plane != patch.plane) & front & reduce(jnp.logical_or, above)
    factor = far_factor(element.centre, element.normal, patch.corners)
    return jnp.where(faces, jnp.where(is_far(element.centre, patch.corners), factor, -1), 0)


def _near_factor(receiver: Numbered, sender: Numbered) -> Scalar:
    element, patch = receiver[0], sender[0]
    return contour_form_factor(element.centre, element.normal, patch.corners)


# For a patch that is half below the horizon, all points are below it with probability 2^-6
_TRIES = 6
_SEED = np.array([0x9E3779B9, 0x7F4A7C15], np.uint32)


def _visible_part(
    element: Patches, patch: Patches, stream: Stream, rays: int, shapes: Sorted
) -> Scalar:
    """Return the visible fraction of a patch: the share of rays from the centre of an element to
    points of the patch that no shape blocks."""
    start = element.centre + element.bulge * element.normal
    size = 4 * largest_of(shapes)
    shift = uniforms(stream, 0, element.area.dtype)[:2]

    def ray(k: Int[Array, ""], seen: Scalar) -> Scalar:
        target = _place_above(element, patch, shift, k)
        # aim slightly above the patch; otherwise the ray, whose start is offset, could hit it
        toward = offset_origin(target, patch.normal, patch.normal, size=size) - start
        distance = norm(toward)
        direction = toward * reciprocal(distance)
        blocked = occluded(start, element.normal, direction, distance, shapes)
        return seen + jnp.where(blocked, 0, jnp.ones_like(seen))

    return fori_loop(0, rays, ray, jnp.zeros_like(shift[0])) / rays


def _place_above(
    element: Patches, patch: Patches, shift: Float[Array, "2"], ray: Int[Array, ""]
) -> Vec:
    """Return the point of a patch, m, to which shadow ray number `ray` is traced. Among `_TRIES`
    points, one above the element's horizon is chosen, if there is one. The form factor includes
    only the part of the patch above the horizon, so the visible fraction must do the same."""
    above = [dot(element.normal, corner - element.centre) for corner in patch.corners]
    rise = patch.bulge * dot(element.normal, patch.normal)

    def place(k: int) -> tuple[Scalar, Scalar]:
        number = (ray * _TRIES + k).astype(shift.dtype)
        s, t = (u + number * step for u, step in zip(shift, KRONECKER_STEPS, strict=True))
        return s - jnp.floor(s), t - jnp.floor(t)

    s, t = place(0)
    for k in range(1, _TRIES):
        height = bilinear(above, s, t) + rise
        s, t = (jnp.where(height > 0, *pair) for pair in zip((s, t), place(k), strict=True))
    return bilinear(patch.corners, s, t) + patch.bulge * patch.normal


@takes_numbers
def closure_error(table: Float[Array, "n patches"]) -> Float[Array, " n"]:
    """Return the closure error of a table of form factors: the sum of each row, minus 1.

    Args:
        table: (n, patches), no unit.

    Returns:
        (n,), no unit: 0 in a closed scene; in an open one, minus the fraction of light that
        escapes.

    Example:
        >>> table = [[0.2, 0.8], [0.5, 0.25]]  # the second patch sees a window
        >>> print(jv.transport.radiosity.closure_error(table))
        [ 0.   -0.25]
    """
    return table.sum(axis=1) - 1


@takes_numbers
def reciprocity_error(
    table: Float[Array, "patches patches"], area: Float[Array, " patches"]
) -> Float[Array, "patches patches"]:
    """Return the reciprocity error A_i F_ij - A_j F_ji for areas A and form factors F, which is 0
    for exact factors.

    Args:
        table: (patches, patches), no unit.
        area: (patches,) m^2.

    Returns:
        (patches, patches) m^2.
    """
    exchange = area[:, None] * table
    return exchange - exchange.T
