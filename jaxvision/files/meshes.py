"""Read triangle meshes from OBJ, PLY, GLB and STL files, and from the other formats that trimesh
reads.

This module cannot be traced; trimesh (the extra `mesh`) is loaded on first use. Several meshes in a
file are joined to one mesh, each transformed as in the file's scene. Polygons are divided into
triangles that cover exactly the polygon. Lengths are assumed to be in metres. Colours, textures and
materials of the file are not read here. Every failure raises an `InputError` with a message of one
sentence.
"""

import os
import re
from collections.abc import Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..core._warnings import warn
from ..errors import InputError, install
from ..geometry.checks import faces_without_area
from ..scene import TriangleMesh
from ._plain_content import file_at, unlike
from ._polygons import (
    are_fans,
    cut,
    fan,
    obj_counted_from_the_start,
    obj_in_triangles,
    ply_of_corners,
    polygons_of,
)
from .gltf import SUFFIXES, Gltf, primitive_of, read_gltf, unread_by_trimesh

Vector = Sequence[float | int] | np.ndarray
Axes = Sequence[Vector] | np.ndarray
Affine = Sequence[Sequence[float | int]] | np.ndarray

# Rounding above these shares causes a warning: of a triangle's area vector, and of the mesh's size.
_TURNED, _MOVED = 1e-2, 5e-4


@np.errstate(over="ignore", invalid="ignore")  # numbers that are not finite are found below
def read_mesh(
    path: str | os.PathLike[str],
    *,
    scale: float | int = 1.0,
    rotation: Axes | None = None,
    position: Vector = (0.0, 0.0, 0.0),
    matrix: Affine | None = None,
    smooth: bool = False,
    flip: bool = False,
    primitive: tuple[int, int] | None = None,
    dtype: str | np.dtype | None = None,
    uv: bool = False,
) -> TriangleMesh:
    """Read the triangles of a mesh file, in their order.

    Vertices are scaled, then rotated, then moved, or mapped by `matrix`. Triangles whose area is 0
    in `dtype`, which no ray would hit, are dropped; a warning states their number. Vertices with
    coordinates that are not finite are not removed; a warning states their number. A warning is
    given if the mesh is so far from the origin that rounding to `dtype` changes its triangles by
    more than 1 % on average, or moves its vertices by more than 5e-4 of its size.

    Args:
        path: the file.
        scale: length of the file's unit, m; 1 if it is in m. A warning is given if the file itself
            names another unit.
        rotation: (3, 3) no unit, rows are the file's axes in the world; None: the world's axes.
        position: (3,) m.
        matrix: (3, 4) rows of an affine map from the file's points, as columns, to m in the world.
            `matrix` replaces scale, rotation and position. A `matrix` that mirrors the mesh does
            not turn the mesh inside out.
        smooth: whether to shade with the file's normals at the vertices. If the file has no
            normals, the normal of a vertex is the mean over the adjacent triangles, weighted by
            their angles. If False, triangles are flat.
        flip: whether to reverse every triangle and every normal.
        primitive: for a glTF file the numbers, from 0, of a mesh and of a primitive in it, without
            the transform of the file's scene; None for all meshes, each transformed as in the
            file's scene.
        dtype: floating dtype; None is JAX's default.
        uv: whether to read texture coordinates, of an OBJ or PLY (whose v points upward, and is
            reversed here) or of a glTF primitive.

    Returns:
        The mesh.

    Raises:
        InputError: for a missing file, a file that is no mesh, a face with a vertex that does not
            exist (vertex 0 of an OBJ), or a singular matrix; for texture coordinates that the file
            does not have.
    """
    file = file_at(path, "mesh")
    loaded = _load(file) if primitive is None else _primitive(file, *primitive, uv)
    unit = getattr(loaded, "units", None) or _commented_unit(file)
    if (
        unit not in (None, "m", "meter", "meters", "metre", "metres")
        and scale == 1
        and matrix is None
    ):
        warn(
            f"{file}: says that its unit is {unit}, which is not used: lengths are taken as m "
            "times scale."
        )
    world = _world_matrix(file, scale, rotation, position, matrix)
    given = loaded.metadata.get("normals")
    loaded.apply_transform(world)
    exact = np.asarray(loaded.vertices, float)
    vertices = exact.astype(jnp.result_type(float) if dtype is None else dtype)
    if lost := int((~np.isfinite(vertices)).any(axis=1).sum()):
        warn(
            f"{file}: {lost} of its {len(vertices)} vertices are not finite in {vertices.dtype}: "
            "no ray hits their triangles; correct the file."
        )
    faces = nonempty_triangles(file, vertices, exact, np.asarray(loaded.faces, np.int32))
    normals = None
    if smooth:
        normals = np.asarray(loaded.vertex_normals, float)
        if given is not None:
            normals = _turned_normals(given, world, normals)
        normals = normals.astype(vertices.dtype)
    if flip:
        faces = faces[:, ::-1]
        normals = None if normals is None else -normals
    known = _coordinates(file, loaded, primitive).astype(vertices.dtype) if uv else None
    return TriangleMesh(vertices, faces, normals=normals, uv=known)


def _commented_unit(file: Path) -> str | None:
    """Return the unit of length in a comment at the top of an OBJ or PLY, or None."""
    if file.suffix.lower() not in (".obj", ".ply"):
        return None
    with file.open("rb") as opened:
        found = _UNIT.search(opened.read(4096).decode("latin-1").replace("\r", "\n"))
    return found and found[1].lower()


def _coordinates(file: Path, mesh, primitive: tuple[int, int] | None) -> np.ndarray:
    """Return the texture coordinates of a mesh, (vertices, 2), with v downward."""
    if primitive is not None:
        known = mesh.metadata["uv"]
    elif file.suffix.lower() in (".obj", ".ply") and mesh.metadata["pieces"] == 1:
        known = getattr(mesh.visual, "uv", None)
    else:
        known = None  # trimesh rearranges the coordinates of several pieces
    if known is None or len(known) != len(mesh.vertices) or not np.isfinite(known).all():
        raise InputError(
            f"{file}: holds no texture coordinates that are read, and its surface has a map; "
            "export them, in one mesh of an OBJ or PLY, or as glTF."
        )
    return np.asarray(known) if primitive is not None else np.asarray(known) * [1, -1] + [0, 1]


def _world_matrix(
    file: Path,
    scale: float | int,
    rotation: Axes | None,
    position: Vector,
    matrix: Affine | None,
) -> np.ndarray:
    """Return the matrix, (4, 4), that maps the file's points, as columns, to m in the world."""
    whole = np.eye(4)
    if matrix is None:
        axes = np.eye(3) if rotation is None else np.asarray(rotation, float)
        whole[:3, :3], whole[:3, 3] = scale * axes.T, position
        return whole
    given = np.asarray(matrix, float)
    if given.shape != (3, 4) or not np.isfinite(given).all():
        raise InputError(f"{file}: matrix must be three rows of four finite numbers; correct it.")
    if not np.linalg.det(given[:, :3]):
        raise InputError(f"{file}: matrix flattens the mesh; give one that has an inverse.")
    whole[:3] = given
    return whole


def nonempty_triangles(
    file: Path | str, vertices: np.ndarray, exact: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Return the triangles with a positive area, because files often contain some of area 0. A
    warning states how many triangles have an area of 0 only because vertices are rounded to the
    dtype."""
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise unlike(
            file,
            f"a triangle names vertex {wrong}, counted from 0, where there are {len(vertices)}",
        )
    flat = faces_without_area(vertices, faces)
    if np.isfinite(vertices).all():
        _check_rounding(file, vertices, exact, faces)
    if flat.all():
        raise unlike(file, f"none of its {len(faces)} triangles has area")
    if flat.any():
        rounded = (flat & ~faces_without_area(exact, faces)).sum()
        by_rounding = f" ({rounded} of them in {vertices.dtype} alone)" if rounded else ""
        warn(
            f"{file}: {flat.sum()} of {len(faces)} triangles have no area{by_rounding} and were "
            "left out."
        )
    return faces[~flat]


def _check_rounding(
    file: Path | str, vertices: np.ndarray, exact: np.ndarray, faces: np.ndarray
) -> None:
    """Warn if rounding changes a mesh, or its place, far from the origin."""
    before, after = (
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for corners in (exact[faces], vertices[faces].astype(float))
    )
    whole = np.linalg.norm(before, axis=1).sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.linalg.norm(after - before, axis=1).sum() / whole
        shift = np.abs(vertices - exact).max()
        share = shift / np.ptp(exact, axis=0).max()
    if change > _TURNED or share > _MOVED:
        warn(
            f"{file}: lies up to {np.abs(exact).max():.3g} m from the origin, where "
            f"{vertices.dtype} moves its vertices by up to {shift:.2g} m and changes the areas and "
            f"slopes of its triangles by {change:.2g} on average; move it near the origin, with "
            "lamps and camera, as by position, or take the dtype float64."
        )


def _primitive(file: Path, mesh: int, primitive: int, uv: bool):
    """Read one primitive of a glTF file as a trimesh mesh."""
    part = primitive_of(_gltf(file, file.stat().st_mtime_ns), mesh, primitive, uv=uv)
    made = _trimesh(file).Trimesh(
        part.vertices, part.faces, vertex_normals=part.normals, process=False, validate=False
    )
    made.metadata |= {"uv": part.uv, "normals": part.normals}
    return made


@lru_cache(maxsize=1)
def _gltf(file: Path, _changed: int) -> Gltf:
    """Read a glTF file once for all its primitives, as long as it does not change."""
    return read_gltf(file)


def _trimesh(file: Path):
    """Import trimesh; if it is not installed, raise an error that names the mesh file."""
    try:
        import trimesh
    except ImportError as error:
        raise InputError(
            f"{file}: reading meshes needs trimesh; install it with `{install('mesh')}`."
        ) from error
    return trimesh


def _load(file: Path):
    """Read a file as one trimesh mesh. Vertices are shared only where the file shares them."""
    trimesh = _trimesh(file)
    from trimesh.exchange.load import mesh_formats

    if file.suffix.lower().lstrip(".") not in mesh_formats():
        raise InputError(
            f"{file}: {file.suffix!r} is not a mesh format that trimesh reads; convert the file to "
            "OBJ, PLY or GLB."
        )
    if file.suffix.lower() in SUFFIXES and (unread := unread_by_trimesh(read_gltf(file))):
        warn(f"{file}: not used: {', '.join(unread)}.")
    try:
        scene = trimesh.load_scene(**_source(file), process=False)
        mesh = scene.to_mesh()
        mesh.metadata["pieces"] = len(scene.geometry)
        own = _file_normals(scene)
        if own is not None and len(own) == len(mesh.vertices):
            mesh.metadata["normals"] = own
        if scene.units is not None:
            mesh.units = scene.units
    except InputError:
        raise
    except Exception as error:  # each format's reader fails in its own way
        reason = _content_fault(file) or _error_in_words(error)
        raise unlike(file, f"not readable as a mesh ({reason})") from error
    if np.shape(mesh.vertices)[1:] != (3,):
        raise unlike(file, "its points do not have three coordinates")
    if len(mesh.faces) == 0:
        why = _content_fault(file)
        reason = f" that can be read: {why}" if why else ""
        raise InputError(f"{file}: holds no triangles{reason}; export it again as a mesh.")
    return _cut_polygons(file, mesh)


def _file_normals(scene) -> np.ndarray | None:
    """Return the vertex normals in a file, (vertices, 3), or None without normals.

    The order is that of the merged mesh, which has lost its normals.
    """
    found, given = [], False
    for node in scene.graph.nodes_geometry:
        to_world, name = scene.graph[node]
        piece = scene.geometry[name]
        if not hasattr(piece, "faces"):
            continue  # points or lines
        if len(piece.faces) and piece.faces.max() >= len(piece.vertices):
            return None  # the faces are checked later
        computed = piece.copy().vertex_normals  # a copy forgets those of the file
        given |= not np.allclose(piece.vertex_normals, computed, atol=1e-6)
        found.append(_turned_normals(piece.vertex_normals, to_world, computed))
    return np.concatenate(found) if given else None


def _turned_normals(normals: np.ndarray, matrix: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return unit normals after an affine map of the points. A normal without a length becomes the
    normal in `otherwise`."""
    turned = np.asarray(normals, float) @ np.linalg.inv(matrix[:3, :3])
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    known = np.isfinite(length) & (length > 0)
    return np.where(known, turned / np.where(known, length, 1), otherwise)


_OBJ_ZERO = re.compile(r"^[ \t]*f\b(?:[^\n#]*\s)0+(?=[/\s]|$)", re.MULTILINE)
_OBJ_TAB = re.compile(r"^([ \t]*\w+)\t", re.MULTILINE)
_OBJ_COLOURS = re.compile(r"^[ \t]*v(?:[ \t]+[^\s#]+){6,7}[ \t]*\r?$", re.MULTILINE)
_OBJ_WEIGHT = re.compile(r"^[ \t]*v(?:[ \t]+[^\s#]+){3}[ \t]+([^\s#]+)[ \t]*\r?$", re.MULTILINE)
_OBJ_ONE = re.compile(r"\+?1(?:\.0*)?(?:e[+-]?0+)?", re.IGNORECASE)
_OBJ_OTHER = {
    r"^[ \t]*l[ \t]": "lines (l)",
    r"^[ \t]*p[ \t]": "points (p)",
    r"^[ \t]*call[ \t]": "another file (call)",
    r"^[ \t]*fo[ \t]": "outlines of faces (fo)",
}
_OBJ_CURVED = re.compile(r"^[ \t]*(curv2?|surf)\b", re.MULTILINE)
_OBJ_COMMENT = re.compile(r"^([ \t]*(?:v[tnp]?|f|l|p)[ \t][^\n#]*)#.*", re.MULTILINE)
# a line that goes on in the next; a comment does not, though it may end in a backslash
_OBJ_CONTINUED = re.compile(r"^([^#\n]*)\\[ \t]*\r?\n", re.MULTILINE)
_OBJ_PATH = re.compile(r"(#.*?)[\\ \t]+(?=\r?$)", re.MULTILINE)
_UNIT = re.compile(
    r"^[ \t]*(?:#|comment\b).*\bunits?\b"
    r"[ \t]*(?:[:=]|is\b|are\b|in\b(?=[ \t]+\w))?[ \t]*(?:1[ \t]*)?"
    r"([mcuk]?m|in|ft|inch(?:es)?|foot|feet|(?:milli|centi|micro|kilo)?met(?:er|re)s?)\b",
    re.MULTILINE | re.IGNORECASE,
)
_OFF_FOUR = re.compile(rb"\s*((?:ST)?C?N?(?:4n?|n)OFF)\b")  # of Geomview
_MARK = b"\xef\xbb\xbf"  # byte order mark before text in UTF-8


def _source(file: Path) -> dict[str, Any]:
    """Return the input for trimesh: the file, or a copy without the parts that trimesh misreads."""
    suffix, data = file.suffix.lower(), file.read_bytes()
    plain = data
    if suffix == ".obj":
        plain = data.removeprefix(_MARK)  # otherwise a vertex right after the mark would be lost
        text = plain.decode("latin-1")
        if "\n" not in text:
            text = text.replace("\r", "\n")
        text = _OBJ_CONTINUED.sub(r"\1 ", _OBJ_PATH.sub(r"\1", text))
        text = _OBJ_COMMENT.sub(r"\1", text)
        text = obj_counted_from_the_start(_OBJ_TAB.sub(r"\1 ", text))
        if _OBJ_ZERO.search(text):
            raise unlike(file, "a face names the vertex 0, where OBJ counts from 1")
        if curved := sorted(set(_OBJ_CURVED.findall(text))):
            warn(
                f"{file}: holds curves or surfaces of free form ({', '.join(curved)}), which are "
                "not read."
            )
        if unused := _unused_of_obj(text):
            warn(f"{file}: not used: {', '.join(unused)}.")
        read = (obj_in_triangles(text) or text).encode("latin-1")
        plain = data if read == data else read
    elif suffix == ".ply":
        plain = ply_of_corners(data) or data
    elif suffix == ".off" and (head := _OFF_FOUR.match(data)):
        raise unlike(file, f"its points have more than three coordinates ({head[1].decode()})")
    elif suffix == ".stl" and data[:5].lower() != b"solid":
        end = 84 + 50 * int.from_bytes(data[80:84], "little")
        if 84 < end < len(data):
            plain = data[:end]
            warn(f"{file}: {len(data) - end} bytes after its last triangle are not used.")
    if plain is data:
        return {"file_obj": file}
    _trimesh(file)  # raises an error that says how to install it
    from trimesh.resolvers import FilePathResolver

    of_folder = FilePathResolver(str(file.absolute()))
    return {"file_obj": BytesIO(plain), "file_type": suffix[1:], "resolver": of_folder}


def _unused_of_obj(text: str) -> list[str]:
    """List, in words, the contents of an OBJ text other than the triangles of one mesh."""
    materials = set(re.findall(r"^[ \t]*usemtl[ \t]+(\S+)", text, re.MULTILINE))
    several = [f"its {len(materials)} materials (usemtl)"] if len(materials) > 1 else []
    if _OBJ_COLOURS.search(text):
        several.append("the colours of its vertices")
    if not all(map(_OBJ_ONE.fullmatch, set(_OBJ_WEIGHT.findall(text)))):
        several.append("the weights w of its vertices (v x y z w), by which some programs divide")
    return several + [what for word, what in _OBJ_OTHER.items() if re.search(word, text, re.M)]


def _cut_polygons(file: Path, mesh):
    """Divide the polygons of a PLY or OFF file correctly into triangles."""
    polygons = polygons_of(file) if file.suffix.lower() in (".ply", ".off") else None
    if polygons is None or max(one.max() for one in polygons) >= len(mesh.vertices):
        return mesh
    pieces = cut(np.asarray(mesh.vertices, float), polygons)
    if are_fans(pieces):
        return mesh
    fans = np.concatenate([corners[fan(len(corners))] for corners in polygons])
    one, other = (np.unique(np.sort(faces, axis=1), axis=0) for faces in (fans, mesh.faces))
    if not np.array_equal(one, other):
        raise InputError(
            f"{file}: holds polygons that are not convex, whose corners texture has changed; "
            "export it again in triangles."
        )
    whole = zip(polygons, pieces, strict=True)
    mesh.faces = np.concatenate([corners[three] for corners, three in whole])
    return mesh


def _content_fault(file: Path) -> str | None:
    """Return the reason why trimesh could not read a file, found in its content, or None."""
    data = file.read_bytes()
    match file.suffix.lower():
        case ".stl" if len(data) >= 84:
            announced, held = int.from_bytes(data[80:84], "little"), (len(data) - 84) // 50
            if not data.startswith(b"solid") and announced != held:
                return f"it announces {announced} triangles and has the length of {held}"
        case ".ply" if b"element tristrips" in data[:10_000]:
            return "it has strips of triangles, which are not read"
        case ".obj" if re.search(rb"^v[ \t]+\S*\d,\d", data, re.MULTILINE):
            return "it writes decimals with commas"
    return None


def _error_in_words(error: Exception) -> str:
    """Return the reason why trimesh could not read a file, derived from the type of its error."""
    match error:
        case UnicodeError() | ModuleNotFoundError(name="charset_normalizer"):
            return "it holds bytes that are not text where its format has text"
        case ModuleNotFoundError():
            return f"its format takes the package {error.name}, which is not installed"
        case FileNotFoundError():
            return "it is incomplete, or a file that it names is missing"
        case IndexError() | KeyError():
            return "it ends too early, or refers to parts that are not in it"
    return "it ends too early, or holds data that its format does not allow there"
