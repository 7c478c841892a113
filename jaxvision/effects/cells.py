"""Divide surfaces into small cells, each bounded by a ball of points and a cone of normals.

Distances, cosines and mirror directions are bounded over all points and normals of a cell. Bounds
over a small cell are much sharper than bounds over a whole surface. A cell that no pixel sees,
because it is outside the picture or faces away, is excluded from the bounds on the picture. Lengths
are in m, angles in rad; computed in NumPy float64.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from ..core._bounds import Ends
from ..optics.views import focus_vergence, sensor_vergence
from ..scene import (
    Box,
    Disc,
    Orthographic,
    Plane,
    Quad,
    RectangularAperture,
    Sphere,
    Surface,
    ThinLens,
    TriangleMesh,
    View,
)
from ..scene.shapes import Shape
from .bodies import (
    Bodies,
    body_of,
    bounding_balls,
    faces_of,
    heights,
    numbers,
    stacked,
    tangents,
    unit,
)
from .boxes import corners, same

_BUDGET = 6000  # largest number of cells of a scene
_FINEST, _COARSEST = 12, 2  # cells along one side of a flat surface
_NOT_FLAT = 1e-9  # rad, spread of the normals of a run of triangles, which need not be coplanar
_TRIANGLES = 400  # triangles of a mesh, up to which each is its own cell


class Cells(NamedTuple):
    """Bounds on the points and normals of c cells. The cells are in the order of their surfaces."""

    centre: np.ndarray  # (c, 3) m
    # (c,) m, radius of a ball around it that contains the cell; inf for an endless one
    radius: np.ndarray
    axis: np.ndarray  # (c, 3) unit, the middle of its normals
    # (c,) rad, largest angle of a normal to it; 0: flat; pi: any normal
    spread: np.ndarray
    surface: np.ndarray  # (c,) number of the surface


class Eye(NamedTuple):
    """The positions and viewing directions of a camera over the range of its parameters."""

    place: np.ndarray  # (3,) m, middle of the pinhole or lens
    moves: float  # m, the largest distance by which a fit may move it
    # m, the largest distance of a ray's start from it: `moves` plus the radius of the lens
    size: float
    rotation: np.ndarray  # (3, 3), rows right, down and forward
    # (k, 3) normals of the planes through `place` between which all rays that start there lie,
    # inward; for a parallel view with `offsets`, m
    planes: np.ndarray
    offsets: np.ndarray  # (k,) m
    parallel: bool  # whether all pixels look along the axis
    everywhere: bool  # whether its viewing direction is unknown


def eye_of(view: Ends[View]) -> Eye:
    """Bound the position and field of view of a camera over the range of its parameters, m."""
    low, high = view
    place, other = numbers(low.position), numbers(high.position)
    names = ("rotation", "focal_length", "pixel_pitch", "focus_distance")
    fixed = all(same(*(getattr(end, name, None) for end in view)) for name in names)
    everywhere = not fixed or getattr(low, "distortion", None) is not None
    moves, radius = float(np.linalg.norm(other - place)) / 2, 0.0
    if isinstance(low, ThinLens):
        radius = max(lens_radius(lens) for lens in corners(view))
    right, down, forward = numbers(low.rotation)
    rows, columns = low.resolution
    pitch = float(low.pixel_pitch)
    half = np.array([columns / 2 + 0.5, rows / 2 + 0.5]) * pitch
    parallel = isinstance(low, Orthographic)
    if parallel:
        planes, offsets = np.stack([right, -right, down, -down]), np.repeat(half, 2)
    else:
        slopes = half * float(sensor_vergence(low))
        if isinstance(low, ThinLens):  # a ray from the edge of the lens through the point in focus
            slopes = slopes + radius * float(focus_vergence(low))
        sides = [
            s * axis + k * forward
            for axis, k in zip((right, down), slopes, strict=True)
            for s in (1, -1)
        ]
        planes, offsets = unit(np.stack([forward, *sides])), np.zeros(5)
    middle, size = (place + other) / 2, moves + radius
    return Eye(middle, moves, size, numbers(low.rotation), planes, offsets, parallel, everywhere)


def lens_radius(lens: ThinLens) -> float:
    """Return the distance, m, from the axis to the farthest point of a lens's aperture."""
    radius = float(lens.focal_length) / float(lens.f_number) / 2
    if isinstance(lens.aperture, RectangularAperture):
        return radius * math.hypot(float(lens.aperture.width), float(lens.aperture.height))
    return radius


def anywhere(eye: Eye) -> Eye:
    """Return an eye that stands for a viewer at any position, such as another surface."""
    return eye._replace(everywhere=True)


def visible_flags(eye: Eye, bodies: Bodies) -> np.ndarray:
    """Return flags, (n,): whether any pixel may see a part of each body. No pixel sees a body whose
    flag is False. A ray through a thin lens of radius r starts at a distance of at most r from the
    centre of the lens. The slope of this ray exceeds that of the pixel's chief ray by at most r /
    z_f, with the focus distance z_f. So at depth z the two rays are at most r (1 + z / z_f) apart.
    """
    if eye.everywhere:
        return np.ones(len(bodies.points), bool)
    moved = Bodies(bodies.points - eye.place, bodies.radii)
    return np.all(heights(moved, eye.planes) + eye.offsets + eye.size >= 0, axis=1)


def cells_of(surfaces: Sequence[Ends[Surface]], *, about: np.ndarray) -> Cells:
    """Divide all surfaces into cells. A two-sided surface has cells for each of its sides. An
    infinite plane has one cell, centred at the point of the plane nearest to `about`, (3,) m."""
    side = int(np.sqrt(_BUDGET / max(len(surfaces), 1) / 3))
    side = min(max(side, _COARSEST), _FINEST)
    found = []
    for i, surface in enumerate(surfaces):
        own = _cells(surface.field("shape"), side, about)
        if surface.low.two_sided:
            signs = (1, 1, -1, 1)  # the axes of the other side
            own = [np.concatenate([x, sign * x]) for x, sign in zip(own, signs, strict=True)]
        found.append((*own, np.full(len(own[0]), i)))
    return Cells(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


Parts = list[np.ndarray]  # centre, radius, axis, spread


def _cells(shape: Ends[Shape], side: int, about: np.ndarray) -> Parts:
    low, high = shape
    if low is not high:
        return _anywhere(shape)
    match low:
        case Quad():
            return _quad_cells(numbers(low.corner), numbers(low.edge_u), numbers(low.edge_v), side)
        case Disc():
            return _disc_cells(low, side)
        case Sphere():
            return _sphere_cells(low, max(side // 2, _COARSEST))
        case Box():
            return _box_cells(low, max(side // 2, 1))
        case TriangleMesh():
            return _mesh_cells(low)
        case Plane():
            point, normal = numbers(low.point), unit(numbers(low.normal))
            foot = about - ((about - point) @ normal) * normal
            return [foot[None], np.array([np.inf]), normal[None], np.zeros(1)]


def _anywhere(shape: Ends[Shape]) -> Parts:
    """Return one cell, with any normal, that contains a shape for all values of its parameters."""
    body = body_of(shape)
    if body is None:
        return [np.zeros((1, 3)), np.array([np.inf]), np.eye(3)[:1], np.array([np.pi])]
    middle, radius = bounding_balls(stacked([body]))
    return [middle, radius, np.eye(3)[:1], np.array([np.pi])]


def _quad_cells(corner: np.ndarray, u: np.ndarray, v: np.ndarray, side: int) -> Parts:
    t = (np.arange(side) + 0.5) / side
    s, t = (x.ravel()[:, None] for x in np.meshgrid(t, t))
    radius = max(np.linalg.norm(u + v), np.linalg.norm(u - v)) / (2 * side)
    centre, count = corner + s * u + t * v, side * side
    axis = np.broadcast_to(unit(np.cross(u, v)), (count, 3))
    return [centre, np.full(count, radius), axis, np.zeros(count)]


def _disc_cells(shape: Disc, side: int) -> Parts:
    normal, r = unit(numbers(shape.normal)), float(shape.radius)
    u, v = (2 * r * along for along in tangents(normal))
    middle = numbers(shape.centre)
    centre, radius, axis, spread = _quad_cells(middle - (u + v) / 2, u, v, side)
    on = np.linalg.norm(centre - middle, axis=1) <= r + radius
    return [centre[on], radius[on], axis[on], spread[on]]


def _sphere_cells(shape: Sphere, side: int) -> Parts:
    """Return the cells of a sphere: the squares of a grid on the cube around it, projected."""
    axis, spread = _sphere_axes(side)
    r = float(shape.radius)
    return [numbers(shape.centre) + r * axis, 2 * r * np.sin(spread / 2), axis, spread]


@cache
def _sphere_axes(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis, (c, 3), and the largest angle, (c,) rad, of each cell's cone of normals."""
    t = np.tan(np.pi / 4 * np.linspace(-1, 1, side + 1))
    middle, edge = np.tan(np.pi / 4 * (np.linspace(-1, 1, 2 * side + 1)[1::2])), t
    a, b = (x.ravel() for x in np.meshgrid(middle, middle, indexing="ij"))
    lows, highs = (np.meshgrid(e, e, indexing="ij") for e in (edge[:-1], edge[1:]))
    axis, spread = [], []
    for k in range(3):
        for sign in (-1.0, 1.0):
            place = lambda p, q, k=k, sign=sign: unit(  # noqa: E731
                np.insert(np.stack([p, q], -1), k, sign, axis=-1)
            )
            centre = place(a, b)
            ends = [
                place(x.ravel(), y.ravel())
                for x in (lows[0], highs[0])
                for y in (lows[1], highs[1])
            ]
            cosine = np.min([np.einsum("ck,ck->c", centre, end) for end in ends], axis=0)
            axis.append(centre)
            spread.append(np.arccos(np.clip(cosine, -1, 1)) * (1 + 1e-9))
    return np.concatenate(axis), np.concatenate(spread)


def _box_cells(shape: Box, side: int) -> Parts:
    axes = np.eye(3) if shape.rotation is None else numbers(shape.rotation)
    centre, half = numbers(shape.centre), numbers(shape.half_extents)
    faces = []
    for k in range(3):
        for sign in (-1.0, 1.0):
            i, j = (k + 1) % 3, (k + 2) % 3
            u, v = 2 * half[i] * axes[i], 2 * sign * half[j] * axes[j]
            faces.append(_quad_cells(centre + sign * half[k] * axes[k] - (u + v) / 2, u, v, side))
    return [np.concatenate(parts) for parts in zip(*faces, strict=True)]


def has_face_cells(shape: TriangleMesh) -> bool:
    """Return whether each triangle of a mesh is a separate cell."""
    return len(shape.faces) <= _TRIANGLES


def _mesh_cells(shape: TriangleMesh) -> Parts:
    """Return the cells of a mesh: one for each triangle, or for each run of triangles."""
    vertices = numbers(shape.vertices)
    faces = faces_of(shape)
    own = vertices[faces]
    normal = unit(np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0]))
    tilt = np.zeros(len(faces))
    if shape.normals is not None:
        smooth = unit(numbers(shape.normals))[faces]
        tilt = np.arccos(np.clip(np.einsum("fvk,fk->fv", smooth, normal), -1, 1)).max(1)
    run = -(-len(faces) // _TRIANGLES)
    first = np.arange(0, len(faces), run)
    low = np.minimum.reduceat(own.min(1), first)
    high = np.maximum.reduceat(own.max(1), first)
    member = np.arange(len(faces)) // run
    # a flat cell has its middle in its plane
    centre = own.mean(1) if run == 1 else (low + high) / 2
    reach = np.linalg.norm(own - centre[member][:, None], axis=-1).max(1)
    axis = unit(np.add.reduceat(normal, first))
    apart = np.arccos(np.clip(np.einsum("fk,fk->f", normal, axis[member]), -1, 1)) + tilt
    spread = tilt if run == 1 else np.maximum(np.maximum.reduceat(apart, first), _NOT_FLAT)
    return [centre, np.maximum.reduceat(reach, first), axis, np.minimum(spread, np.pi)]


def part_of(cells: Cells, surface: int) -> slice:
    """Return the slice of the array of cells that holds the cells of one surface."""
    return slice(*np.searchsorted(cells.surface, [surface, surface + 1]))


def starts(cells: Cells) -> np.ndarray:
    """Return the index, (n,), of the first cell of each surface."""
    return np.flatnonzero(np.diff(cells.surface, prepend=-1))


def bodies_of(cells: Cells) -> Bodies:
    """Return the ball around each cell. An unbounded cell gets a radius of 1e300 m."""
    return Bodies(
        cells.centre[:, None], np.where(np.isinf(cells.radius), 1e300, cells.radius)[:, None]
    )
