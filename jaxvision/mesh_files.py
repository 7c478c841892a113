"""Triangle meshes from files: OBJ, PLY, GLB, STL and what else trimesh reads. The edge of the
library: eager; trimesh (`pip install jaxvision[mesh]`) is loaded on first use.

A file of several meshes becomes one, each put where the file's scene has it; polygons are cut into
triangles. Lengths are taken as metres. Every failure is an `InputError` of one sentence.
"""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from .errors import InputError
from .geometry.checks import faces_without_area
from .scene import TriangleMesh

Vector = Sequence[float | int] | np.ndarray
Axes = Sequence[Vector] | np.ndarray


def read_mesh(
    path: str | os.PathLike[str],
    *,
    scale: float | int = 1.0,
    rotation: Axes | None = None,
    position: Vector = (0.0, 0.0, 0.0),
    smooth: bool = False,
    flip: bool = False,
    dtype: str | np.dtype | None = None,
) -> TriangleMesh:
    """The triangles of a file, in its order, as numbers of `dtype` (None: JAX's own). Those
    without area in such numbers, which no ray would meet, are left out, and a warning counts them.

    Points are scaled, then rotated by `rotation`, (3, 3), whose rows are the file's axes in the
    world (None: the world's own), then moved by `position`, (3,) m. `smooth`: with normals at the
    vertices, the file's or, where it has none, the means of the triangles around by their angles.
    `flip`: every triangle, and every normal, turned around. Places without a number are left as
    they are: `geometry.problems` names them. `InputError` for corners that are not there.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{file}: no such mesh file; check the name and the folder.")
    loaded = _load(file)
    axes = np.eye(3) if rotation is None else np.asarray(rotation, float)
    vertices = scale * np.asarray(loaded.vertices, float) @ axes + np.asarray(position, float)
    with np.errstate(over="ignore"):  # `geometry.problems` names what is not finite
        vertices = vertices.astype(jnp.result_type(float) if dtype is None else dtype)
    faces = _with_area(file, vertices, np.asarray(loaded.faces, np.int32))
    normals = None
    if smooth:
        normals = (np.asarray(loaded.vertex_normals, float) @ axes).astype(vertices.dtype)
    if flip:
        faces = faces[:, ::-1]
        normals = None if normals is None else -normals
    return TriangleMesh(vertices, faces, normals=normals)


def _with_area(file: Path, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The triangles that have one; meshes found in the wild often hold some that do not."""
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise InputError(
            f"{file}: a triangle names vertex {wrong}, counted from 0, where there are "
            f"{len(vertices)}; export it again."
        )
    flat = faces_without_area(vertices, faces)
    if flat.all():
        raise InputError(f"{file}: none of its {len(faces)} triangles has area; export it again.")
    if flat.any():
        warnings.warn(
            f"{file}: {flat.sum()} of {len(faces)} triangles have no area and were left out.",
            stacklevel=3,
        )
    return faces[~flat]


def _load(file: Path):
    """One trimesh mesh, its vertices merged only where the file shares them."""
    try:
        import trimesh
        from trimesh.exchange.load import mesh_formats
    except ImportError as error:
        raise InputError(
            f"{file}: reading meshes takes trimesh; install it with `pip install jaxvision[mesh]`."
        ) from error
    if file.suffix.lower().lstrip(".") not in mesh_formats():
        raise InputError(
            f"{file}: {file.suffix!r} is no mesh format that trimesh reads; convert the file to "
            "OBJ, PLY or GLB."
        )
    try:
        mesh = trimesh.load_scene(file, process=False).to_mesh()
    except Exception as error:  # each format's reader fails in its own way
        reason = _in_plain_words(error)
        raise InputError(f"{file}: not readable as a mesh ({reason}); export it again.") from error
    if len(mesh.faces) == 0:
        raise InputError(f"{file}: holds no triangles; export it again as a mesh.")
    return mesh


def _in_plain_words(error: Exception) -> str:
    """Why a reader of trimesh failed, as far as the kind of its failure tells."""
    match error:
        case UnicodeError() | ModuleNotFoundError(name="charset_normalizer"):
            return "it holds bytes that are no text where its format has text"
        case ModuleNotFoundError():
            return f"its format takes the package {error.name}, which is not installed"
        case FileNotFoundError():
            return "it is not whole, or a file that it names is missing"
        case IndexError() | KeyError():
            return "it ends too early, or refers to what is not in it"
    return "it ends too early, or holds what its format does not have there"
