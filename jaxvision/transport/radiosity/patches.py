"""Surfaces cut into small flat patches, each face a grid of rows and columns.

A face is a side of a surface that the unit square maps onto: a quad, a side of a box, a disc (by
radius and angle), a sphere (by polar angle and azimuth), a triangle (collapsed onto one vertex).
A patch is a cell of its grid, flat: spheres become polyhedra, discs polygons. How many cells a
face has is settled first, by `plan_patches` from numbers at hand; `patches_of` then computes where
they are, under `jit` and with gradients. Lengths in m, areas in m^2.
"""

from collections.abc import Sequence
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._numerics import norm, normalize
from ..._vector import Vec, as_vec
from ...brdf.lambert import Lambert
from ...hemisphere import cross
from ...scene import Box, Disc, Quad, Scene, Shape, Sphere, Surface, TriangleMesh
from ._faces import face_point, lengths, side
from ._grid import Face, Plan, borders, offsets_of, parents_in, parents_of, surfaces_of


class Patches(eqx.Module):
    """`corners`: four (n,) `Vec`, m, counterclockwise seen from the front (a triangle repeats
    one). `centre`: (n,) m. `normal`: (n,) unit. `area`: (n,) m^2. `bulge`: (n,) m, how high the
    surface rises above the flat patch. `surface`: (n,) its number in the scene. `plane`: (n,) a
    number that patches of one flat face share: they do not see each other."""

    corners: tuple[Vec, Vec, Vec, Vec]
    centre: Vec
    normal: Vec
    area: Float[Array, " n"]
    bulge: Float[Array, " n"]
    surface: Int[Array, " n"]
    plane: Int[Array, " n"]


# --------------------------------------------------------------------- how many


def plan_patches(scene: Scene, *, size: float, split: int = 2, graded: bool = False) -> Plan:
    """A plan whose patches are no longer than `size` m, each split into `split`^2 elements.

    `graded`: cells narrow toward the edges of quads and boxes, as the cosine does, where light
    between adjoining surfaces changes fast. Needs numbers at hand: call it before `jit`, which the
    plan, being static, then knows. `ValueError` for a surface that is not bounded or not
    `Lambert`, by its number, and for a size that is not positive.
    """
    if not size > 0:
        raise ValueError(f"size must be positive, got {size}.")
    faces = []
    for i, surface in enumerate(scene.surfaces):
        _check_surface(i, surface)
        for front in (True, False) if surface.two_sided else (True,):
            for part, reach in enumerate(lengths(surface.shape)):
                least = _LEAST.get(type(surface.shape))
                rows, columns = (
                    max(int(np.ceil(length / size - 1e-6)), fewest)
                    for length, fewest in zip(reach, least or (1, 1), strict=True)
                )
                edges = graded and isinstance(surface.shape, Quad | Box)
                faces.append(Face(i, part, front, rows, columns, edges, least is not None))
    return Plan(tuple(faces), split)


_LEAST = {Sphere: (6, 12), Disc: (2, 12)}  # rows and columns that still make one


def _check_surface(number: int, surface: Surface) -> None:
    if not isinstance(surface.shape, Sphere | Disc | Quad | Box | TriangleMesh):
        raise ValueError(
            f"Scene.surfaces[{number}].shape must be bounded for radiosity, got "
            f"{type(surface.shape).__name__}."
        )
    if not isinstance(surface.material, Lambert):
        raise ValueError(
            f"Scene.surfaces[{number}].material must be Lambert for radiosity, got "
            f"{type(surface.material).__name__}."
        )


# ------------------------------------------------------------------------ where


def patches_of(scene: Scene, plan: Plan, *, split: int = 1) -> Patches:
    """The patches of a plan, or with `split` its cells cut split by split: lengths in m."""
    corners, bulge = _cut(scene, plan, split)
    a, b, c, d = corners
    halves = [cross(b - a, c - a), cross(c - a, d - a)]
    vector = halves[0] + halves[1]
    sizes = [norm(half) for half in halves]
    both = sizes[0] + sizes[1]
    share = sizes[0] / jnp.where(both > 0, both, 1)
    third = jnp.full_like(share, 1 / 3)
    centre = third * (a + c + share * b + (1 - share) * d)
    counts = np.diff(offsets_of(plan, split=split))
    sides: dict[tuple[int, int], int] = {}
    spheres: dict[int, int] = {}  # both sides of a patch lie in one plane
    planes = []
    for face, first, count in zip(plan.faces, offsets_of(plan), counts, strict=False):
        if isinstance(scene.surfaces[face.surface].shape, Sphere):
            start = spheres.setdefault(face.surface, len(plan.faces) + first)
            planes.append(start + parents_in(face, split))
        else:
            planes.append(np.full(count, sides.setdefault(face[:2], len(sides))))
    return Patches(
        corners,
        centre,
        as_vec(normalize(vector)),
        norm(vector) / 2,
        bulge,
        jnp.asarray(surfaces_of(plan, split=split), jnp.int32),
        jnp.asarray(np.concatenate(planes), jnp.int32),
    )


def by_patch(
    values: Float[Array, "elements n"], elements: Patches, plan: Plan
) -> Float[Array, "patches n"]:
    """The mean over each patch of what its elements have, by their areas in m^2. A patch without
    any area is 0."""
    of_patch, count = jnp.asarray(parents_of(plan)), int(offsets_of(plan)[-1])
    total = jax.ops.segment_sum(values * elements.area[:, None], of_patch, count)
    areas = jax.ops.segment_sum(elements.area, of_patch, count)[:, None]
    return total * jnp.where(areas > 0, 1 / jnp.where(areas > 0, areas, 1), 0)


Cells = tuple[tuple[Vec, Vec, Vec, Vec], Array]  # corners and bulge


def _cut(scene: Scene, plan: Plan, split: int) -> Cells:
    """The cells of all faces: parallelograms at once, as one piece of code, others each by
    itself."""
    shapes = [scene.surfaces[face.surface].shape for face in plan.faces]
    straight = np.array([isinstance(shape, Quad | Box) for shape in shapes])
    firsts = offsets_of(plan, split=split)
    numbers = np.split(np.arange(firsts[-1]), firsts[1:-1])
    parts = []
    if straight.any():
        faces = [
            (face, shape)
            for face, shape in zip(plan.faces, shapes, strict=True)
            if isinstance(shape, Quad | Box)
        ]
        parts.append(_straight_cells(faces, split))
    parts += [
        _cells(shape, face, split)
        for face, shape in zip(plan.faces, shapes, strict=True)
        if not isinstance(shape, Quad | Box)
    ]
    if len(parts) == 1:
        return parts[0]
    order = np.concatenate([numbers[i] for i in np.argsort(~straight, kind="stable")])
    back = np.argsort(order)
    return jax.tree.map(lambda *all_parts: jnp.concatenate(all_parts)[back], *parts)


def _straight_cells(faces: Sequence[tuple[Face, Quad | Box]], split: int) -> Cells:
    """Corners and bulge, which is 0, of the cells of quads and sides of boxes."""
    sides = [side(shape, face.part) for face, shape in faces]
    corner, edge_u, edge_v = (jnp.stack(of_sides) for of_sides in zip(*sides, strict=True))
    places, owner = [], []
    for number, (face, _) in enumerate(faces):
        u, v = (borders(count * split, face.graded) for count in (face.rows, face.columns))
        low_u, low_v = (x.reshape(-1) for x in np.meshgrid(u[:-1], v[:-1], indexing="ij"))
        high_u, high_v = (x.reshape(-1) for x in np.meshgrid(u[1:], v[1:], indexing="ij"))
        turn = [(low_u, low_v), (high_u, low_v), (high_u, high_v), (low_u, high_v)]
        places.append(np.array(turn if face.front else [turn[k] for k in (0, 3, 2, 1)]))
        owner.append(np.full(len(low_u), number))
    place = jnp.asarray(np.concatenate(places, axis=-1), corner.dtype)  # (4, 2, cells)
    corner, edge_u, edge_v = (as_vec(x[np.concatenate(owner)]) for x in (corner, edge_u, edge_v))
    a, b, c, d = (corner + u * edge_u + v * edge_v for u, v in place)
    return (a, b, c, d), jnp.zeros_like(a.x)


def _cells(shape: Shape, face: Face, split: int) -> tuple[tuple[Vec, Vec, Vec, Vec], Array]:
    """Corners and bulge of a face's cells, row by row."""
    dtype = jax.tree.leaves(shape)[0].dtype
    curved = isinstance(shape, Sphere | Disc)  # cut into flat patches first, and these split
    once = 1 if curved else split
    u, v = (
        jnp.asarray(borders(count * once, face.graded), dtype)
        for count in (face.rows, face.columns)
    )
    lattice = face_point(shape, face.part, u[:, None], v[None, :])
    if curved and split > 1:
        of_rows, of_columns = (
            jnp.asarray(_between(count, split), dtype) for count in (face.rows, face.columns)
        )
        lattice = jax.tree.map(lambda x: of_rows @ x @ of_columns.T, lattice)

    def corner(i: slice, j: slice) -> Vec:
        return jax.tree.map(lambda x: x[i, j].reshape(-1), lattice)

    first, last = slice(None, -1), slice(1, None)
    a, b, c, d = (
        corner(first, first),
        corner(last, first),
        corner(last, last),
        corner(first, last),
    )
    bulge = jnp.zeros_like(a.x)
    if isinstance(shape, Sphere) and face.front:
        four = reduce(Vec.__add__, (corner - shape.centre for corner in (a, b, c, d)))
        bulge = shape.radius - norm(four) / 4
    return ((a, b, c, d) if face.front else (a, d, c, b)), bulge


def _between(count: int, split: int) -> np.ndarray:
    """Linear interpolation of count + 1 numbers to split steps between neighbours, as a matrix."""
    places = np.arange(count * split + 1) / split
    return np.maximum(1 - np.abs(places[:, None] - np.arange(count + 1)), 0)
