"""Convert Mitsuba's shapes to the tables `[[surface]]` of a scene file."""

from typing import Any

import numpy as np

from ..nodes import Node
from ..placement import (
    Affine,
    disc,
    keeps_right_angles,
    lengths_of_axes,
    mirrors,
    placed,
    sphere,
)

SHAPES = ("sphere", "rectangle", "disk", "cube", "obj", "ply")


def shape_of(node: Node) -> dict[str, Any]:
    """Return `shape` and the other keys of a `<shape>`, in m. Raise `InputError` for a shape, or a
    stretched shape, without a counterpart."""
    kind = node.must_be(*SHAPES)
    to_world = node.take("to_world", np.ndarray, np.eye(4))
    flip = node.take("flip_normals", bool, False)
    match kind:
        case "sphere":
            centre = node.take("center", np.ndarray, np.zeros(3))
            _not_inside_out(node, flip)
            return sphere(node, to_world, centre, node.take("radius", float, 1.0))
        case "rectangle":
            return _quad(to_world, flip)
        case "disk":
            return disc(node, to_world, flip)
        case "cube":
            return _box(node, to_world, flip)
        case _:
            return {
                "shape": "mesh",
                "file": node.filename(),
                "matrix": to_world[:3].tolist(),
                "smooth": not node.take("face_normals", bool, False),
                "flip": flip,
            }


def _quad(to_world: Affine, flip: bool) -> dict[str, Any]:
    """Convert the square [-1, 1] x [-1, 1], whose front faces z."""
    u, v = (2 * to_world[:3, axis] for axis in (0, 1))
    if flip != mirrors(to_world):
        u, v = v, u
    return {
        "shape": "quad",
        "corner": placed(to_world, np.array([-1.0, -1.0, 0.0])),
        "edge_u": u.tolist(),
        "edge_v": v.tolist(),
    }


def _box(node: Node, to_world: Affine, flip: bool) -> dict[str, Any]:
    """Convert the box that extends from -1 to 1 along each axis."""
    if not keeps_right_angles(to_world):
        raise node.wrong("is sheared to a parallelepiped; give it as a mesh.")
    _not_inside_out(node, flip)
    half = lengths_of_axes(to_world)
    axes = (to_world[:3, :3] / half).T
    if mirrors(to_world):
        axes[0] = -axes[0]
    return {
        "shape": "box",
        "centre": placed(to_world, np.zeros(3)),
        "half_extents": half.tolist(),
        "rotation": axes.tolist(),
    }


def _not_inside_out(node: Node, flip: bool) -> None:
    if flip:
        raise node.wrong("flip_normals turns it inside out; give it as a mesh.")
