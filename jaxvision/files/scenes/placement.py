"""Convert placed shapes and cameras of other programs to the tables of a scene file.

A transform is an affine map of column vectors to the world, (4, 4), with lengths in m.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from .nodes import Node

Affine = Float[np.ndarray, "4 4"]

SHINES_TO_ONE_SIDE = "shines to one side, and so reflects from that side only."


def look_at(origin: np.ndarray, target: np.ndarray, up: np.ndarray, place: str) -> Affine:
    """Return the map of a camera that looks along z with y up, so its x points left."""
    forward = target - origin
    left = np.cross(up, forward)
    if not forward.any() or np.linalg.norm(left) <= 1e-9 * np.linalg.norm(forward):
        raise InputError(f"{place}: target and up give no direction of view; correct one of them.")
    step = np.eye(4)
    axes = np.stack([left, np.cross(forward, left), forward])
    step[:3, :3] = (axes / np.linalg.norm(axes, axis=1, keepdims=True)).T
    step[:3, 3] = origin
    return step


def lengths_of_axes(to_world: Affine) -> np.ndarray:
    """Return the lengths of the unit vectors along the axes after the transform, (3,) m."""
    return np.linalg.norm(to_world[:3, :3], axis=0)


def keeps_right_angles(to_world: Affine, *, axes: int = 3) -> bool:
    """Return whether the coordinate axes are still perpendicular after the transform."""
    linear = (to_world[:3, :3] / lengths_of_axes(to_world))[:, :axes]
    return bool(np.abs(linear.T @ linear - np.eye(axes)).max() <= 1e-5)


def keeps_shape(to_world: Affine, *, axes: int = 3) -> bool:
    """Return whether axes stay perpendicular and equally long."""
    lengths = lengths_of_axes(to_world)[:axes]
    return keeps_right_angles(to_world, axes=axes) and bool(np.ptp(lengths) <= 1e-5 * lengths.max())


def mirrors(to_world: Affine) -> bool:
    """Return whether the transform mirrors space."""
    return bool(np.linalg.det(to_world[:3, :3]) < 0)


def placed(to_world: Affine, point: np.ndarray) -> list[float]:
    """Return a point after the transform, (3,) m."""
    return (to_world[:3, :3] @ point + to_world[:3, 3]).tolist()


def sphere(node: Node, to_world: Affine, centre: np.ndarray, radius: float) -> dict[str, Any]:
    """Return the table of a sphere; `InputError` if the transform makes it an ellipsoid."""
    if not keeps_shape(to_world):
        raise node.wrong("is stretched to an ellipsoid; give it as a mesh.")
    return {
        "shape": "sphere",
        "centre": placed(to_world, centre),
        "radius": float(radius * lengths_of_axes(to_world)[0]),
    }


def disc(
    node: Node, to_world: Affine, flip: bool, *, height: float = 0.0, radius: float = 1.0
) -> dict[str, Any]:
    """Return the table of a disc about the z axis, whose front faces z unless `flip`. Raise
    `InputError` if the transform makes it an ellipse."""
    if not keeps_shape(to_world, axes=2):
        raise node.wrong("is stretched to an ellipse; give it as a mesh.")
    normal = np.linalg.inv(to_world[:3, :3])[2]  # normals are transformed by the transposed inverse
    normal = normal / np.linalg.norm(normal)
    return {
        "shape": "disc",
        "centre": placed(to_world, np.array([0, 0, height])),
        "normal": (-normal if flip else normal).tolist(),
        "radius": float(radius * lengths_of_axes(to_world)[0]),
    }


def pose(node: Node, to_world: Affine, *, orthographic: bool) -> tuple[dict[str, Any], float]:
    """Return the position and orientation of a camera that looks along its z axis, with y up and x
    to the left, and the length of its unit in m. Raise `InputError` for a transform that mirrors or
    stretches the picture."""
    across, _, along = lengths_of_axes(to_world)
    if orthographic:  # a scaling along the axis does not change the picture
        to_world = to_world @ np.diag([1, 1, across / along, 1])
    if mirrors(to_world) or not keeps_shape(to_world):
        raise node.wrong("its transform mirrors or stretches the picture; correct it.")
    position = to_world[:3, 3]
    _, up, forward = (to_world[:3, :3] / lengths_of_axes(to_world)).T
    made = {
        "position": position.tolist(),
        "target": (position + forward).tolist(),
        "up": up.tolist(),
    }
    return made, float(across)


def thin_lens(half_width: float, columns: int, radius: float, distance: float) -> dict[str, Any]:
    """Return the keys of a thin lens of a radius, m, with a short focal length, focused at a
    distance s, m. The sensor is at the image distance v of s, and its width follows from
    `half_width`, the tangent of half the field of view, at v."""
    focal_length = distance / 100
    image = focal_length * distance / (distance - focal_length)
    return {
        "kind": "thin_lens",
        "focal_length": focal_length,
        "pixel_pitch": 2 * half_width * image / columns,
        "f_number": focal_length / (2 * radius),
        "focus_distance": distance,
    }
