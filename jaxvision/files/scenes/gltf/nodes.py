"""The tree of glTF's nodes: the positions of meshes, lights and the camera. In m; y is up."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....errors import InputError
from .contents import Content, Node


def placed_nodes(path: Path, content: Content) -> Iterator[tuple[str, Node, np.ndarray]]:
    """The nodes of the file's scene, parents first: name, node, and its (4, 4) map of column points
    to the world. `InputError` for a missing node, or one that is reached twice."""
    if not content.scenes:
        raise InputError("has no scene; export it again.")
    if content.scene >= len(content.scenes):
        raise InputError(f"has no scene {content.scene}; export it again.")
    waiting = [(i, np.eye(4)) for i in reversed(content.scenes[content.scene].nodes)]
    seen: set[int] = set()
    while waiting:
        index, above = waiting.pop()
        if index >= len(content.nodes) or index in seen:
            raise InputError(f"its nodes make no tree at nodes[{index}]; export it again.")
        seen.add(index)
        node = content.nodes[index]
        here = above @ _local(node)
        yield f"nodes[{index}]" if node.name is None else f'node "{node.name}"', node, here
        waiting += [(child, here) for child in reversed(node.children)]


def _local(node: Node) -> np.ndarray:
    """(4, 4): scale, then rotation, then translation."""
    if node.matrix is not None:
        return np.reshape(node.matrix, (4, 4)).T
    x, y, z, w = np.array(node.rotation) / np.linalg.norm(node.rotation)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = turn * node.scale, node.translation
    return whole
