"""The division of surfaces into small flat patches, by a grid of rows and columns on each face.

A face is a part of a surface with a map from the unit square: a quad, a side of a box, a disc (by
radius and angle), a sphere (by polar angle and azimuth), or a triangle (collapsed onto one vertex).
A patch is a flat cell of this grid, so spheres become polyhedra and discs become polygons. First
`plan_patches` chooses the number of cells, which needs concrete numbers. Then `patches_of` computes
the geometry of the cells, under `jit` and with gradients. Lengths are in m, areas in m^2.
"""

from collections.abc import Sequence
from functools import partial, reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...brdf.lambert import Lambert
from ...core._arguments import takes_numbers
from ...core._loops.fusion import fuse, materialise, one_program
from ...core._maps import maps_of
from ...core._numerics import divide, norm, normalize, reciprocal
from ...core._shown import Shown
from ...core._vector import Vec, as_vec
from ...geometry.hemisphere import cross
from ...scene import Box, Disc, Quad, Scene, Shape, Sphere, Surface, TriangleMesh
from ._faces import face_point, lengths, side
from ._grid import Face, Plan, borders, offsets_of, parents_in, parents_of, surfaces_of


class Patches(Shown):
    """The geometry of n flat cells of surfaces.

    Attributes:
        corners: four (n,) `Vec`, m, counterclockwise seen from the front; a triangle repeats one.
        centre: (n,) m.
        normal: (n,) unit length.
        area: (n,) m^2.
        bulge: (n,) m, height of the surface above the flat patch.
        surface: (n,) number of the surface in the scene.
        plane: (n,) index of the flat face that contains the patch; patches with the same index do
            not see each other.
    """

    corners: tuple[Vec, Vec, Vec, Vec]
    centre: Vec
    normal: Vec
    area: Float[Array, " n"]
    bulge: Float[Array, " n"]
    surface: Int[Array, " n"]
    plane: Int[Array, " n"]


# --------------------------------------------------------------------- how many


def plan_patches(scene: Scene, *, size: float, split: int = 2, graded: bool = False) -> Plan:
    """Divide the surfaces of a scene into patches no longer than a given size.

    This function needs concrete numbers, so call it outside `jit`. The plan is a static argument of
    a jitted function.

    Args:
        scene: bounded surfaces of `Lambert` material.
        size: longest side of a patch, m, > 0.
        split: number of elements along each side of a patch, >= 1.
        graded: whether cells narrow toward the edges of quads and boxes, where light between
            adjoining surfaces varies fast.

    Returns:
        The faces of all surfaces with their grids.

    Raises:
        ValueError: for a surface that is not bounded or not `Lambert`, named by its index, and for
            a size that is not positive.

    Example:
        >>> floor = jv.Surface(jv.Quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), jv.Lambert([0.1]))
        >>> plan = jv.transport.radiosity.plan_patches(jv.Scene(floor, []), size=0.5, split=1)
        >>> print(plan.faces[0].rows, plan.faces[0].columns)
        2 2
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


_LEAST = {Sphere: (6, 12), Disc: (2, 12)}  # the fewest rows and columns


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
    for name, _ in maps_of(surface):
        raise ValueError(
            f"Scene.surfaces[{number}].{name} is a Map, which radiosity's patches cannot hold; "
            "follow paths, or give its mean."
        )


# ------------------------------------------------------------------------ where


def patches_of(scene: Scene, plan: Plan, *, split: int = 1) -> Patches:
    """Compute the geometry of a plan's patches, differentiable with respect to the shapes.

    Args:
        scene: the scene of the plan.
        plan: from `plan_patches`.
        split: static, number of cells along each side of a patch.

    Returns:
        All cells, lengths in m, areas in m^2.
    """
    return patches_at(scene, plan, (split,))[0]


def patches_at(scene: Scene, plan: Plan, splits: Sequence[int]) -> list[Patches]:
    """Return the result of `patches_of` for each of several splits, lengths in m, compiled as one
    program."""
    return _patches_at(scene, plan, tuple(splits))


@one_program
def _patches_at(scene: Scene, plan: Plan, splits: tuple[int, ...]) -> list[Patches]:
    measured = materialise(partial(_pack_patches, plan=plan, splits=splits), scene)
    start, results = 0, []
    for split in splits:
        surfaces = surfaces_of(plan, split=split)
        end = start + len(surfaces)
        rows = list(measured[:, start:end])
        a, b, c, d, centre, normal = (Vec(*rows[k : k + 3]) for k in range(0, 18, 3))
        numbers = (jnp.asarray(x, jnp.int32) for x in (surfaces, _planes(scene, plan, split)))
        results.append(Patches((a, b, c, d), centre, normal, *rows[18:], *numbers))
        start = end
    return results


def _pack_patches(scene: Scene, plan: Plan, splits: Sequence[int]) -> Float[Array, "20 cells"]:
    """Return an array whose rows are the real-valued fields of `Patches`, in order, for the cells
    of all splits."""
    corners, bulge = _cut(scene, plan, splits)
    a, b, c, d = corners
    halves = [cross(b - a, c - a), cross(c - a, d - a)]
    vector = halves[0] + halves[1]
    sizes = [norm(half) for half in halves]
    both = sizes[0] + sizes[1]
    share = divide(sizes[0], both)
    third = jnp.full_like(share, 1 / 3)
    centre = third * (a + c + share * b + (1 - share) * d)
    fields = (*corners, centre, as_vec(normalize(vector)), norm(vector) / 2, bulge)
    return jnp.stack(fuse(jax.tree.leaves(fields)))


def _planes(scene: Scene, plan: Plan, split: int) -> np.ndarray:
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
    return np.concatenate(planes)


@takes_numbers
def patch_means(
    values: Float[Array, "elements n"], elements: Patches, plan: Plan
) -> Float[Array, "patches n"]:
    """Return the area-weighted mean over each patch of values that are given for its elements.

    Args:
        values: (elements, n), in any unit.
        elements: their areas, m^2.
        plan: from `plan_patches`.

    Returns:
        (patches, n) in the unit of `values`; 0 for a patch without area.
    """
    if plan.split == 1:  # keeps the rows of a sharded table on their devices
        return jnp.where(elements.area[:, None] > 0, values, 0)
    of_patch, count = jnp.asarray(parents_of(plan)), int(offsets_of(plan)[-1])
    weighted = jnp.concatenate([values, jnp.ones_like(values[:, :1])], axis=1)
    sums = jax.ops.segment_sum(weighted * elements.area[:, None], of_patch, count)
    total, area = sums[:, :-1], sums[:, -1:]
    return total * reciprocal(area)


Cells = tuple[tuple[Vec, Vec, Vec, Vec], Array]  # corners and bulge


def _cut(scene: Scene, plan: Plan, splits: Sequence[int]) -> Cells:
    """Return the cells of all faces for each split. The cells of all parallelograms are computed
    together, which shortens the compiled code, and those of other faces one face at a time."""
    shapes = [scene.surfaces[face.surface].shape for face in plan.faces]
    straight = np.array([isinstance(shape, Quad | Box) for shape in shapes] * len(splits))
    counts = np.concatenate([np.diff(offsets_of(plan, split=split)) for split in splits])
    numbers = np.split(np.arange(counts.sum()), np.cumsum(counts)[:-1])
    pairs = list(zip(plan.faces, shapes, strict=True))
    flat = [(face, shape) for face, shape in pairs if isinstance(shape, Quad | Box)]
    parts = [_straight_cells(flat, splits)] if flat else []
    parts += [
        _cells(shape, face, split)
        for split in splits
        for face, shape in pairs
        if not isinstance(shape, Quad | Box)
    ]
    if len(parts) == 1:
        return parts[0]
    order = np.concatenate([numbers[i] for i in np.argsort(~straight, kind="stable")])
    back = np.argsort(order)
    return jax.tree.map(lambda *all_parts: jnp.concatenate(all_parts)[back], *parts)


def _straight_cells(faces: Sequence[tuple[Face, Quad | Box]], splits: Sequence[int]) -> Cells:
    """Return the corners of the cells of quads and box sides, and their bulge, which is 0."""
    sides = jnp.stack([row for face, shape in faces for row in side(shape, face.part)])
    sides = sides.reshape(len(faces), 9)
    places, owner = [], []
    for split in splits:
        for number, (face, _) in enumerate(faces):
            u, v = (borders(count * split, face.graded) for count in (face.rows, face.columns))
            low_u, low_v = (x.reshape(-1) for x in np.meshgrid(u[:-1], v[:-1], indexing="ij"))
            high_u, high_v = (x.reshape(-1) for x in np.meshgrid(u[1:], v[1:], indexing="ij"))
            turn = [(low_u, low_v), (high_u, low_v), (high_u, high_v), (low_u, high_v)]
            places.append(np.array(turn if face.front else [turn[k] for k in (0, 3, 2, 1)]))
            owner.append(np.full(len(low_u), number))
    place = jnp.asarray(np.concatenate(places, axis=-1), sides.dtype)  # (4, 2, cells)
    of_cells = sides[np.concatenate(owner)]
    corner, edge_u, edge_v = (as_vec(of_cells[:, k : k + 3]) for k in (0, 3, 6))
    a, b, c, d = (corner + u * edge_u + v * edge_v for u, v in place)
    return (a, b, c, d), jnp.zeros_like(a.x)


def _cells(shape: Shape, face: Face, split: int) -> tuple[tuple[Vec, Vec, Vec, Vec], Array]:
    """Return the corners of a face's cells, row by row, and the bulge of each cell."""
    dtype = jax.tree.leaves(shape)[0].dtype
    # The face is cut into flat patches, which are then split
    curved = isinstance(shape, Sphere | Disc)
    once = 1 if curved else split
    u, v = (
        jnp.asarray(borders(count * once, face.graded), dtype)
        for count in (face.rows, face.columns)
    )
    lattice = face_point(shape, face.part, u[:, None], v[None, :])
    if curved and split > 1:
        of_rows, of_columns = (
            jnp.asarray(_interpolation_matrix(count, split), dtype)
            for count in (face.rows, face.columns)
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


def _interpolation_matrix(count: int, split: int) -> np.ndarray:
    """Return the matrix that interpolates count + 1 numbers linearly, with `split` intervals
    between adjacent numbers."""
    places = np.arange(count * split + 1) / split
    return np.maximum(1 - np.abs(places[:, None] - np.arange(count + 1)), 0)
