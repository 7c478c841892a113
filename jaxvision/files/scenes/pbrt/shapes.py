"""Convert pbrt's shapes to the tables `[[surface]]` of a scene file."""

import re
from typing import Any

import numpy as np

from ..folder import Folder
from ..nodes import Node
from ..placement import Affine, disc, mirrors, sphere

_FLAT = 1e-5  # of its size, height of the corner of a patch above the plane of the others
_PLY_NORMALS = re.compile(rb"^property\s+\S+\s+nx\s", re.MULTILINE)


def shape_of(node: Node, to_world: Affine, reverse: bool, folder: Folder) -> dict[str, Any]:
    """Return `shape` and the other keys of a shape, in m. `reverse` reverses its normals. Raise
    `InputError` for a shape, or a stretched shape, without a counterpart."""
    kind = node.must_be(*_SHAPES)
    if node.take("alpha", float, 1.0) != 1:
        raise node.wrong("alpha is not read, only 1; remove it.")
    if kind == "plymesh":
        made = {
            "shape": "mesh",
            "file": node.filename(),
            "matrix": to_world[:3].tolist(),
            "flip": reverse,
        }
        with folder.file(made["file"]).open("rb") as opened:
            made["smooth"] = _PLY_NORMALS.search(opened.read(4096)) is not None
    else:
        made = _SHAPES[kind](node, to_world, reverse)
    node.must_be_read()
    return made


def _whole(node: Node, usual: dict[str, float]) -> None:
    """Refuse a part of a round shape."""
    for name, value in (usual | {"phimax": 360.0}).items():
        if node.take(name, float, value) != value:
            raise node.wrong(f"{name} cuts it, which is not read; give it as a mesh.")


def _sphere(node: Node, to_world: Affine, reverse: bool) -> dict[str, Any]:
    radius = node.take("radius", float, 1.0)
    _whole(node, {"zmin": -radius, "zmax": radius})
    made = sphere(node, to_world, np.zeros(3), radius)
    return made | ({"turned": True} if reverse else {})


def _disk(node: Node, to_world: Affine, reverse: bool) -> dict[str, Any]:
    _whole(node, {"innerradius": 0.0})
    height, radius = node.take("height", float, 0.0), node.take("radius", float, 1.0)
    return disc(node, to_world, reverse, height=height, radius=radius)


def _points(node: Node, name: str, columns: int) -> np.ndarray | None:
    found = node.take(name, np.ndarray)
    if found is None:
        return None
    found = np.atleast_2d(found)
    if found.shape[1] != columns:
        raise node.wrong(f"{name} holds no points of {columns} numbers; correct it.")
    return found


def _patches(node: Node, corners: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return the points, the indices of the corners of each patch, and the texture coordinates."""
    points, uv = _points(node, "P", 3), _points(node, "uv", 2)
    if points is None:
        raise node.wrong("has no points P; add them.")
    indices = node.take("indices", np.ndarray)
    indices = np.arange(corners) if indices is None else indices
    if len(indices) % corners or indices.min() < 0 or indices.max() >= len(points):
        raise node.wrong(f"indices are {corners} for each face, from 0 to {len(points) - 1}.")
    return points, indices.reshape(-1, corners), uv


def _trianglemesh(node: Node, to_world: Affine, reverse: bool) -> dict[str, Any]:
    points, faces, uv = _patches(node, 3)
    normals = _points(node, "N", 3)
    node.take("S", np.ndarray)  # tangents, which isotropic materials do not use
    return _mesh(node, to_world, reverse, points, faces, uv, normals)


def _bilinearmesh(node: Node, to_world: Affine, reverse: bool) -> dict[str, Any]:
    points, patches, uv = _patches(node, 4)
    a, b, c, d = (points[patches[:, i]] for i in range(4))
    normal = np.cross(b - a, c - a)
    height = np.abs(np.sum((d - a) * normal, axis=1))
    size = np.linalg.norm(b - a, axis=1) + np.linalg.norm(c - a, axis=1)
    if (height > _FLAT * size * np.linalg.norm(normal, axis=1)).any():
        raise node.wrong("has a curved patch, which is not read; divide it to triangles.")
    if uv is not None and np.abs(a + d - b - c).max() > _FLAT * size.max():
        raise node.wrong("uv of a patch that is no parallelogram is not read; divide it.")
    faces = patches[:, [[0, 1, 3], [0, 3, 2]]].reshape(-1, 3)
    return _mesh(node, to_world, reverse, points, faces, uv, _points(node, "N", 3))


def _mesh(
    node: Node,
    to_world: Affine,
    reverse: bool,
    points: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray | None,
    normals: np.ndarray | None,
) -> dict[str, Any]:
    """Place triangles in the world. Their front is the side of the normals, if there are any."""
    if any(x is not None and len(x) != len(points) for x in (uv, normals)):
        raise node.wrong("uv and N take one entry for each point of P; correct them.")
    world = points @ to_world[:3, :3].T + to_world[:3, 3]
    turned = np.full(len(faces), reverse != mirrors(to_world))
    made: dict[str, Any] = {"shape": "triangles"}
    if normals is not None:
        normals = (-1 if reverse else 1) * normals @ np.linalg.inv(to_world[:3, :3])
        a, b, c = (world[faces[:, i]] for i in range(3))
        turned = np.sum(np.cross(b - a, c - a) * normals[faces].sum(axis=1), axis=1) < 0
        made["vertex_normals"] = normals
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    if uv is not None:
        made["uv"] = uv * [1, -1] + [0, 1]
    return made | {"vertices": world, "faces": faces}


def area_of(node: Node, shape: dict[str, Any]) -> float:
    """Return the area, m^2, over which pbrt spreads the power of a shape; for a mesh, the area of
    one face.
    """
    match shape["shape"]:
        case "sphere":
            return 4 * np.pi * shape["radius"] ** 2
        case "disc":
            return np.pi * shape["radius"] ** 2
        case "triangles":
            a, b, c = (shape["vertices"][shape["faces"][:, i]] for i in range(3))
            areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
            if np.ptp(areas) <= 1e-5 * areas.max():
                return float(areas[0]) * (2 if node.kind == "bilinearmesh" else 1)
    raise node.wrong("power is shared unequally by its faces, which is not read; give L.")


_SHAPES = {
    "sphere": _sphere,
    "disk": _disk,
    "trianglemesh": _trianglemesh,
    "bilinearmesh": _bilinearmesh,
    "plymesh": _mesh,
}
