"""Return messages about invalid geometric shapes. File readers and commands call these checks
before rays are traced. The checks use NumPy, with lengths in metres."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ..core._types import is_known
from ..core._warnings import warn_caller
from ..scene import Box, Disc, Plane, Quad, Shape, Sphere, TriangleMesh

_NAMED = 3  # largest number of bad vertices or faces that a finding names


def problems(shape: Shape) -> list[str]:
    """List everything about a shape that is not valid geometry.

    Problems are numbers that are not finite, radii and extents that are not positive, normals and
    edges of length 0, faces without area, missing vertices, and faces whose vertex normals all
    point backward. A position is a problem if it is so far from the origin that floating-point
    numbers cannot resolve the size of the shape there.

    Args:
        shape: any shape, lengths in m.

    Returns:
        One sentence for each problem; empty if there is none.

    Example:
        >>> print(jv.geometry.problems(jv.Sphere([0, 0, np.nan], 1.0)))
        ['Sphere.centre holds a number that is not finite.']
    """
    return invalid(shape) or coarse(shape)


def invalid(shape: Shape) -> list[str]:
    """List the problems of a shape that do not depend on its position."""
    kind = type(shape).__name__
    found = [
        f"{kind}.{name} holds a number that is not finite."
        for name, value in vars(shape).items()
        if value is not None and not np.isfinite(np.asarray(value)).all()
    ]
    if found and not isinstance(shape, TriangleMesh):
        return found
    match shape:
        case Sphere():
            found += _nonpositive_problem(f"{kind}.radius", shape.radius)
        case Plane():
            found += _no_direction(f"{kind}.normal", shape.normal)
        case Disc():
            found += _nonpositive_problem(f"{kind}.radius", shape.radius)
            found += _no_direction(f"{kind}.normal", shape.normal)
        case Quad():
            edges = np.asarray([shape.edge_u, shape.edge_v])
            longest = np.abs(edges).max()
            area = np.linalg.norm(np.cross(*edges.astype(float) / (longest or 1)))
            if not area > np.finfo(edges.dtype).eps:
                found.append(f"{kind}.edge_u and edge_v span no area.")
        case Box():
            found += _nonpositive_problem(f"{kind}.half_extents", shape.half_extents)
            if shape.rotation is not None:
                rotation = np.asarray(shape.rotation)
                if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
                    found.append(f"{kind}.rotation has rows that are not unit and orthogonal.")
        case TriangleMesh():
            found = _mesh_problems(shape)
    return found


def coarse(shape: Shape) -> list[str]:
    """Return a message if a shape is so far from the origin that the spacing of its dtype there
    exceeds a thousandth of the shape's size, or 4 % of the mean height of a mesh's triangles; or if
    products of its lengths leave the range of the dtype.
    """
    match shape:
        case Sphere() | Disc():
            place, size = np.asarray(shape.centre), float(shape.radius)
        case Quad():
            place = np.asarray(shape.corner)
            size = max(np.linalg.norm(edge) for edge in (shape.edge_u, shape.edge_v))
        case Box():
            place = np.asarray(shape.centre)
            size = float(2 * np.asarray(shape.half_extents).max())
        case TriangleMesh():
            place = np.asarray(shape.vertices)
            size = float(np.ptp(place, axis=0).max())
        case _:
            return []
    reach, limits = float(np.abs(place).max()), jnp.finfo(place.dtype)
    least, most = float(limits.tiny / limits.eps) ** 0.5, float(limits.max) ** 0.5 / 10
    length = size if size < least else max(reach, size)
    if (length < least or length > most) and limits.bits > 16:
        return [
            f"{type(shape).__name__} has lengths of {length:.2g} m, whose products leave the range "
            f"of {place.dtype}, so that rays may miss it; take another unit of length, of which it "
            f"has {least:.1g} to {most:.1g}, or float64."
        ]
    step = float(np.spacing(np.abs(place).max()))
    share, most, what = step / size, 1e-3, "its size"
    # A spacing below 1e-6 of the size matters only for heights below 25e-6 of the size, which occur
    # in meshes of 1e9 triangles.
    if isinstance(shape, TriangleMesh) and 1e-6 < share <= most:
        corners = place[np.asarray(shape.faces)].astype(float)
        edges = corners - np.roll(corners, 1, axis=1)
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)  # twice the area
        longest = np.linalg.norm(edges, axis=2).max(axis=1)
        share, most = step * longest.sum() / area.sum(), 4e-2  # height: area / longest
        what = "the heights of its triangles on average"
    if not share > most:
        return []
    return [
        f"{type(shape).__name__} lies up to {np.abs(place).max():.3g} m from the origin, where the "
        f"numbers of {place.dtype} are {step:.2g} m apart, {share:.2g} of {what}; move it nearer, "
        "with lamps and camera, or take float64."
    ]


def warn_of_shapes(*shapes: Shape) -> None:
    """Warn once about shapes whose numbers are known: about a shape that is not valid, about one so
    far from the origin that rounding deforms it, and of two shapes in the same place."""
    known = [all(map(is_known, jax.tree.leaves(shape))) for shape in shapes]
    for shape, sure in zip(shapes, known, strict=True):
        if sure and (found := _unmet(shape) or coarse(shape)):
            warn_caller(found[0])
            return
    where = [f"Scene.surfaces[{i}]" for i in range(len(shapes))]
    sure = [shape if sure else None for shape, sure in zip(shapes, known, strict=True)]
    if found := coincident(sure, where):
        warn_caller(found[0])


def _unmet(shape: Shape) -> list[str]:
    """List why rays meet a shape nowhere, or miss a part of a mesh."""
    if not isinstance(shape, TriangleMesh):
        return invalid(shape)
    lost = int((~np.isfinite(np.asarray(shape.vertices)).all(axis=1)).sum())
    if lost:
        return [
            f"TriangleMesh: {lost} of its {len(shape.vertices)} vertices are not finite, and rays "
            "miss the triangles there; leave them out."
        ]
    return [
        f"TriangleMesh.{name} holds a number that is not finite."
        for name in ("normals", "uv")
        if (value := getattr(shape, name)) is not None and not np.isfinite(np.asarray(value)).all()
    ]


def coincident(shapes: Sequence[Shape | None], names: Sequence[str]) -> list[str]:
    """Return one message for each shape that is exactly a shape before it; None is passed over."""
    found, known = [], {}
    for name, shape in zip(names, shapes, strict=True):
        if shape is None:
            continue
        numbers = [np.asarray(x) for x in jax.tree.leaves(shape)]
        start = (type(shape), *((x.shape, x.ravel()[:9].tobytes()) for x in numbers))
        for other, first in known.setdefault(start, []):
            if all(map(np.array_equal, numbers, other)):
                found.append(
                    f"{name}: lies exactly where {first} lies, so that rays meet only one of them; "
                    "move or remove it."
                )
                break
        else:
            known[start].append((numbers, name))
    return found


def _nonpositive_problem(name: str, value: object) -> list[str]:
    smallest = np.asarray(value).min()
    return [] if smallest > 0 else [f"{name} must be positive, got {smallest:g} m."]


def _no_direction(name: str, value: object) -> list[str]:
    return [] if np.asarray(value).any() else [f"{name} must have a direction, got zero."]


def _mesh_problems(mesh: TriangleMesh) -> list[str]:
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    found = _list_faces(
        "vertices that are not finite", np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    )
    outside = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    found += _list_faces(
        f"faces with vertices outside 0 to {len(vertices) - 1}", np.flatnonzero(outside)
    )
    flat = faces_without_area(vertices, np.clip(faces, 0, len(vertices) - 1))
    found += _list_faces("faces without area, which are never met", np.flatnonzero(flat & ~outside))
    if mesh.normals is not None and not outside.any():
        found += _list_faces("normals that all point behind their face", _backward_faces(mesh))
    for name in ("normals", "uv"):
        value = getattr(mesh, name)
        if value is not None and not np.isfinite(np.asarray(value)).all():
            found.append(f"TriangleMesh.{name} holds a number that is not finite.")
    return found


def _backward_faces(mesh: TriangleMesh) -> np.ndarray:
    """Return the faces that render black because all three vertex normals point backwards."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)].astype(float)
    normals = np.asarray(mesh.normals)[np.asarray(mesh.faces)].astype(float)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.flatnonzero((np.einsum("ijk,ik->ij", normals, across) < 0).all(axis=1))


def faces_without_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return whether each triangle of a mesh, (faces,), has no area at the precision of its
    numbers, because two corners coincide or all three lie on a line. The result is False for a
    triangle with a corner that is not finite."""
    corners = vertices[faces].astype(float)
    with np.errstate(invalid="ignore"):
        edge_b, edge_c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = np.linalg.norm(np.cross(edge_b, edge_c), axis=1)
        square = np.maximum((edge_b**2).sum(axis=1), (edge_c**2).sum(axis=1))
        return area <= np.finfo(vertices.dtype).eps * square


def _list_faces(what: str, numbers: np.ndarray) -> list[str]:
    if not len(numbers):
        return []
    named = ", ".join(str(n) for n in numbers[:_NAMED])
    more = ", ..." if len(numbers) > _NAMED else ""
    return [f"TriangleMesh has {what}: {named}{more} ({len(numbers)} in all)."]
