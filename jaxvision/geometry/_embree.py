"""Intersection of rays with large meshes by Embree, which returns the indices of triangles;
optional (`embreex`).

This module computes distances and normals from the triangle, so they have gradients and the
caller's dtype. Embree works in float32. If a float64 ray passes an edge within float32 rounding,
Embree may return the neighbouring triangle. Embree misses a triangle whose distance is below the
float32 rounding error of the mesh's size.
"""

import importlib.util
from collections import OrderedDict
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from itertools import pairwise
from threading import Lock
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Int

from ..core._types import Scalar
from ..core._vector import as_array
from ..core.side_by_side import cores
from ..scene import TriangleMesh
from .rays import Ray

Query = Callable[..., np.ndarray]  # function of a scene and rays

_SHARE = 2048  # smallest number of rays for which another core is used
_KEPT = 8  # largest number of stored scenes; each contains a search tree as large as its mesh
_built: OrderedDict[int, tuple[np.ndarray, np.ndarray, Any, np.float32]] = OrderedDict()
_building = Lock()
# A search starts at this distance along its ray, in sizes of the mesh. Embree also returns hits at
# distance 0, so a ray that starts on the mesh would find only its own triangle.
_START = 2 * np.finfo(np.float32).eps


def available() -> bool:
    """Whether embreex is installed."""
    return importlib.util.find_spec("embreex") is not None


def embree_nearest(ray: Ray, mesh: TriangleMesh) -> Int[Array, ""]:
    """Return the index of the first triangle hit, -1 for none."""
    return _answer(_nearest, jnp.int32, ray, mesh)


def embree_blocks(ray: Ray, mesh: TriangleMesh, distance: Scalar) -> Bool[Array, ""]:
    """Return whether the ray hits a triangle before `distance`, m."""
    return _answer(_blocks, jnp.bool_, ray, mesh, distance)


def _answer(query: Query, dtype: DTypeLike, ray: Ray, mesh: TriangleMesh, *distance: Scalar):
    return jax.pure_callback(
        query,
        jax.ShapeDtypeStruct(jnp.shape(ray.origin.x), dtype),
        mesh.vertices,
        mesh.faces,
        *(as_array(ray.origin), as_array(ray.direction), *distance),
        vmap_method="expand_dims",
    )


def _first_hits(scene: Any, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    found = scene.run(origin, direction)
    lost = found < 0
    found[lost] = scene.run(origin[lost], _broadcast(direction[lost]))
    return found


def _is_blocked(
    scene: Any, origin: np.ndarray, direction: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    found = scene.run(origin, direction, dists=distance, query="OCCLUDED") >= 0
    lost = ~found
    found[lost] = (
        scene.run(origin[lost], _broadcast(direction[lost]), dists=distance[lost], query="OCCLUDED")
        >= 0
    )
    return found


def _broadcast(direction: np.ndarray) -> np.ndarray:
    """Perturb directions by a few rounding errors. One in 100000 rays aimed at a vertex slips
    through the mesh, so a ray without a hit is traced again in the perturbed direction.
    """
    return direction + 4 * np.finfo(np.float32).eps * direction[:, [1, 2, 0]]


def _ask(query: Query, vertices: Any, faces: Any, *rays: Any) -> np.ndarray:
    """Call `query(scene, *rays)` for rays with any leading axes, against one mesh, or for each ray
    against its own mesh if `vmap` also maps over meshes."""
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces, np.int32)
    meshes = np.broadcast_shapes(vertices.shape[:-2], faces.shape[:-2])
    ends = (3,), (3,), ()
    numbers = [np.asarray(ray, np.float32) for ray in rays]
    leading = [x.shape[: x.ndim - len(end)] for x, end in zip(numbers, ends, strict=False)]
    batch = np.broadcast_shapes(meshes, *leading)
    full = [np.broadcast_to(x, batch + end) for x, end in zip(numbers, ends, strict=False)]
    if all(size == 1 for size in meshes):
        flat = [x.reshape(-1, *end) for x, end in zip(full, ends, strict=False)]
        scene, scale = _scene(vertices.reshape(-1, 3), faces.reshape(-1, 3))

        def trace(part: slice) -> np.ndarray:
            # a copy of the directions, because Embree rejects read-only arrays
            origin, direction, *far = (x[part] for x in flat)
            start = scale * origin + _START * direction
            return query(scene, start, np.array(direction), *(scale * x - _START for x in far))

        return np.concatenate(list(_split_by_cores(trace, len(flat[0])))).reshape(batch)
    vertices = np.broadcast_to(vertices, batch + vertices.shape[-2:])
    faces = np.broadcast_to(faces, batch + faces.shape[-2:])
    one_by_one = [
        _ask(query, vertices[at], faces[at], *(x[at] for x in full)) for at in np.ndindex(batch)
    ]
    return np.asarray(one_by_one).reshape(batch)


_nearest, _blocks = partial(_ask, _first_hits), partial(_ask, _is_blocked)


def _split_by_cores(found: Callable[[slice], np.ndarray], count: int) -> Iterable[np.ndarray]:
    """Compute the results for `count` rays on all cores, because Embree releases the interpreter
    lock."""
    parts = max(min(cores(), count // _SHARE), 1)
    ends = [count * k // parts for k in range(parts + 1)]
    slices = [slice(*pair) for pair in pairwise(ends)]
    return map(found, slices) if parts == 1 else _threads().map(found, slices)


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="embree")


def _scene(vertices: np.ndarray, faces: np.ndarray) -> tuple[Any, np.float32]:
    """Return the search tree of a mesh scaled to a size of about 1, and the scale, a power of two.
    Without scaling, rays would slip through very small triangles. Trees are cached by the mesh's
    numbers; comparing these numbers takes less time than tracing a thousand rays.
    """
    from embreex.mesh_construction import TriangleMesh as EmbreeMesh
    from embreex.rtcore_scene import EmbreeScene

    with _building:
        for number, (known_vertices, known_faces, scene, scale) in _built.items():
            if np.array_equal(known_vertices, vertices) and np.array_equal(known_faces, faces):
                _built.move_to_end(number)
                return scene, scale
        clipped = np.clip(faces, 0, len(vertices) - 1)
        scene = EmbreeScene(robust=True)
        largest = np.abs(vertices).max()
        usable = 0 < largest < np.inf
        scale = np.float32(2.0 ** -np.frexp(largest)[1]) if usable else np.float32(1)
        EmbreeMesh(scene, scale * vertices, np.ascontiguousarray(clipped))
        number = max(_built, default=0) + 1
        _built[number] = vertices.copy(), faces.copy(), scene, scale
        if len(_built) > _KEPT:
            _built.popitem(last=False)
        return scene, scale
