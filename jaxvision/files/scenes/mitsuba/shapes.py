"""Convert Mitsuba's shapes to the tables `[[surface]]` of a scene file."""

from typing import Any

import numpy as np

from .document import Node
from .transforms import (
    Affine,
    keeps_right_angles,
    keeps_shape,
    lengths_of_axes,
    mirrors,
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
            return _sphere(node, to_world, flip)
        case "rectangle":
            return _quad(to_world, flip)
        case "disk":
            return _disc(node, to_world, flip)
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


def _sphere(node: Node, to_world: Affine, flip: bool) -> dict[str, Any]:
    centre = node.take("center", np.ndarray, np.zeros(3))
    radius = node.take("radius", float, 1.0)
    if not keeps_shape(to_world):
        raise node.wrong("is stretched to an ellipsoid; give it as a mesh.")
    _not_inside_out(node, flip)
    return {
        "shape": "sphere",
        "centre": _point(to_world, centre),
        "radius": float(radius * lengths_of_axes(to_world)[0]),
    }


def _quad(to_world: Affine, flip: bool) -> dict[str, Any]:
    """Convert the square [-1, 1] x [-1, 1], whose front faces z."""
    u, v = (2 * to_world[:3, axis] for axis in (0, 1))
    if flip != mirrors(to_world):
        u, v = v, u
    return {
        "shape": "quad",
        "corner": _point(to_world, np.array([-1.0, -1.0, 0.0])),
        "edge_u": u.tolist(),
        "edge_v": v.tolist(),
    }


def _disc(node: Node, to_world: Affine, flip: bool) -> dict[str, Any]:
    """Convert the disc of radius 1, whose front faces z."""
    if not keeps_shape(to_world, axes=2):
        raise node.wrong("is stretched to an ellipse; give it as a mesh.")
    normal = np.linalg.inv(to_world[:3, :3])[2]  # normals are transformed by the transposed inverse
    return {
        "shape": "disc",
        "centre": _point(to_world, np.zeros(3)),
        "normal": (-normal if flip else normal).tolist(),
        "radius": float(lengths_of_axes(to_world)[0]),
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
        "centre": _point(to_world, np.zeros(3)),
        "half_extents": half.tolist(),
        "rotation": axes.tolist(),
    }


def _not_inside_out(node: Node, flip: bool) -> None:
    if flip:
        raise node.wrong("flip_normals turns it inside out; give it as a mesh.")


def _point(to_world: Affine, point: np.ndarray) -> list[float]:
    return (to_world[:3, :3] @ point + to_world[:3, 3]).tolist()
