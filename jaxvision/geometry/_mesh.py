"""Intersection of a ray with a triangle mesh. In a mesh of up to a hundred triangles (several
thousand on an accelerator), each triangle is tested; Embree searches larger meshes. Functions take
one ray; lengths are in metres."""

import warnings
from functools import cache

import jax
from jaxtyping import Array, Bool, Int

from ..core._types import Scalar
from ..errors import install
from ..programs import targets_cpu
from ..scene import TriangleMesh
from . import _embree
from ._triangle import any_triangle, nearest_triangle, triangle_hit
from ._unknown import unknown_hit
from .rays import Hit, Ray

# Largest number of triangles for which a CPU tests each triangle faster than Embree searches its
# tree
_TRIED = 100
_TRIED_ELSEWHERE = 4096  # this number on an accelerator, whose rays must be copied to the CPU


def mesh_nearest(ray: Ray, mesh: TriangleMesh) -> tuple[Scalar, Int[Array, ""]]:
    """Return (distance in m, index) of the first triangle hit, (inf, -1) for none."""
    if not _search(mesh):
        return nearest_triangle(ray, mesh)
    primitive = _embree.embree_nearest(ray, mesh)
    return triangle_hit(ray, mesh, primitive).distance, primitive


def mesh_blocks(ray: Ray, mesh: TriangleMesh, distance: Scalar) -> Bool[Array, ""]:
    """Return whether the ray hits the mesh before `distance`, m."""
    if not _search(mesh):
        return any_triangle(ray, mesh, distance)
    return _embree.embree_blocks(ray, mesh, distance)


def intersect_mesh(ray: Ray, mesh: TriangleMesh) -> Hit:
    """Return the nearest hit of a mesh ahead of the ray's origin, differentiable with respect to
    the ray and the vertices.

    Args:
        ray: its origin in m.
        mesh: the mesh, lengths in m.

    Returns:
        The hit; a miss has distance inf.
    """
    _, primitive = mesh_nearest(*jax.lax.stop_gradient((ray, mesh)))
    return unknown_hit(triangle_hit(ray, mesh, primitive), ray)


def _search(mesh: TriangleMesh) -> bool:
    tried = _TRIED if targets_cpu() else _TRIED_ELSEWHERE
    if len(mesh.faces) <= tried:
        return False
    if not _embree.available():
        _warn_of_slow_search(tried)
    return _embree.available()


@cache
def _warn_of_slow_search(tried: int) -> None:
    warnings.warn(
        f"meshes of more than {tried} triangles are searched one triangle at a time, which is "
        f"slow; install embreex ({install('mesh')}) for speed.",
        stacklevel=2,
    )
