"""The division of faces into grids of cells: the indices, borders and neighbours of the cells. All
quantities in this file are dimensionless."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...core._numerics import arctan2, reciprocal, safe_sqrt
from ...core._shown import Shown
from ...core._types import Scalar, check_count


class Face(NamedTuple):
    """One face of a surface, with its grid of cells.

    Attributes:
        surface: number of the surface in its scene.
        part: side of a box, or triangle of a mesh; else 0.
        front: whether it is the front of the surface.
        rows, columns: size of the grid.
        graded: whether cells narrow toward the edges.
        wraps: whether the last column adjoins the first.
    """

    surface: int
    part: int
    front: bool
    rows: int
    columns: int
    graded: bool
    wraps: bool


class Plan(Shown):
    """The division of the surfaces of a scene into patches and elements.

    Attributes:
        faces: all faces, surface by surface; static.
        split: each patch, which sends light, consists of split^2 elements, which receive it;
            static, >= 1.

    Raises:
        ValueError: for a split below 1.
    """

    faces: tuple[Face, ...] = eqx.field(static=True)
    split: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_count("Plan.split", self.split, 1)


def offsets_of(plan: Plan, *, split: int = 1) -> np.ndarray:
    """Return the index of the first cell of each face, followed by the total number of cells:
    (faces + 1,) whole numbers, no unit. Every patch has split^2 cells."""
    sizes = [face.rows * face.columns * split**2 for face in plan.faces]
    return np.cumsum([0, *sizes])


def parents_of(plan: Plan) -> np.ndarray:
    """Return the index of the patch to which each element belongs, (elements,), no unit."""
    firsts = offsets_of(plan)
    of_faces = [
        first + parents_in(face, plan.split)
        for face, first in zip(plan.faces, firsts, strict=False)
    ]
    return np.concatenate(of_faces)


def parents_in(face: Face, split: int) -> np.ndarray:
    """Return, for each grid cell of one face, the index of its patch, relative to the face's first
    patch."""
    rows, columns = (np.arange(count * split) // split for count in (face.rows, face.columns))
    return (rows[:, None] * face.columns + columns).reshape(-1)


def refined(plan: Plan, split: int) -> Plan:
    """Return a finer plan, whose patches are the elements of `plan`, and in which each patch has
    split^2 elements."""
    faces = [
        face._replace(rows=face.rows * plan.split, columns=face.columns * plan.split)
        for face in plan.faces
    ]
    return Plan(tuple(faces), split)


def surfaces_of(plan: Plan, *, split: int = 1) -> np.ndarray:
    """Return the index of the surface of each cell, (cells,), no unit. Every patch has split^2
    cells."""
    return np.repeat([face.surface for face in plan.faces], np.diff(offsets_of(plan, split=split)))


def borders(count: int, graded: bool) -> np.ndarray:
    """Return the borders of `count` cells that divide [0, 1]; graded cells narrow toward both
    ends."""
    t = np.linspace(0, 1, count + 1)
    return (1 - np.cos(np.pi * t)) / 2 if graded else t


def around_place(
    plan: Plan, covered: Bool[Array, " elements"], face: Int[Array, ""], u: Scalar, v: Scalar
) -> tuple[Int[Array, " 4"], Float[Array, " 4"]]:
    """Return four elements around a position (u, v) of a face, with weights for bilinear
    interpolation, no unit: the element that contains the position, and three neighbours. The
    weights sum to 1, or to 0 if all four elements are covered.

    The neighbours on the side nearer to the position are used. If these are `covered`, or the face
    ends there, the neighbours on the opposite side are used, and the weights extrapolate by at most
    half a cell. The cells of discs and spheres continue around the axis. If the element at the
    position is covered, its weight is divided among the uncovered neighbours.
    """
    firsts = offsets_of(plan, split=plan.split)[:-1]
    counts = [(f.rows * plan.split, f.columns * plan.split) for f in plan.faces]
    rows, columns = jnp.asarray(counts, jnp.int32)[face]
    first = jnp.asarray(firsts, jnp.int32)[face]
    graded = jnp.asarray([f.graded for f in plan.faces])[face]
    wraps = jnp.asarray([f.wraps for f in plan.faces])[face]

    def own(place: Scalar, count: Int[Array, ""]) -> tuple[Int[Array, ""], Scalar]:
        even = 2 / jnp.pi * arctan2(safe_sqrt(place), safe_sqrt(1 - place))
        at = jnp.where(graded, even, place) * count.astype(place.dtype)
        cell = jnp.clip(jnp.floor(at).astype(jnp.int32), 0, count - 1)
        return cell, at - cell.astype(at.dtype) - 0.5

    def cell(i: Int[Array, ""], j: Int[Array, ""]) -> Int[Array, ""]:
        return first + (i % rows) * columns + j % columns

    def neighbour(
        share: Scalar, barred: Callable[[Int[Array, ""]], Bool[Array, ""]]
    ) -> tuple[Int[Array, ""], Scalar]:
        """Return the step (1 or -1) to the neighbouring cell along one axis, and the weight of that
        cell."""
        step = jnp.where(share < 0, -1, 1)
        ahead, behind = barred(step), barred(-step)
        away = jnp.where(behind, 0, -jnp.abs(share))
        return jnp.where(ahead, -step, step), jnp.where(ahead, away, jnp.abs(share))

    (i, s), (j, t) = own(u, rows), own(v, columns)
    hidden = covered[cell(i, j)]
    down, s = neighbour(
        s, lambda k: (i + k < 0) | (i + k >= rows) | (covered[cell(i + k, j)] & ~hidden)
    )
    right, t = neighbour(
        t,
        lambda k: (
            (~wraps & ((j + k < 0) | (j + k >= columns))) | (covered[cell(i, j + k)] & ~hidden)
        ),
    )
    cells = jnp.stack(
        [cell(i, j), cell(i + down, j), cell(i, j + right), cell(i + down, j + right)]
    )
    none = jnp.zeros_like(s)
    # Interpolation through three values; the fourth has weight 0
    plane = jnp.stack([1 - s - t, s, t, none])
    weights = plane + jnp.where(covered[cells[3]], none, s * t) * jnp.asarray(
        [1, -1, -1, 1], s.dtype
    )
    open_ = jnp.where(covered[cells], none, jnp.maximum(weights, 0))
    total = open_.sum()
    shared = open_ * reciprocal(total)
    return cells, jnp.where(hidden, shared, weights)
