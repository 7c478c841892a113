"""Read glTF 2.0 files, `.gltf` and `.glb`: their JSON, and the numbers in their buffers.

The functions cannot be traced by JAX, and use only NumPy. Coordinates are returned as stored, in
metres according to the standard. Source: Khronos, glTF 2.0 Specification, version 2.0.1. Every
failure raises an `InputError` with a message of one sentence.
"""

import base64
import binascii
import json
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from ..errors import InputError
from ._plain_content import check_content, unlike

Value = TypeVar("Value")
SUFFIXES = (".gltf", ".glb")
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # the kinds of a chunk
_HEAD = struct.Struct("<4sII")
_CHUNK = struct.Struct("<II")


@dataclass(frozen=True)
class Gltf:
    """The JSON and the binary data of one glTF file."""

    path: Path  # the file
    content: dict[str, Any]  # its JSON
    binary: bytes | None  # the binary part of a `.glb`, or None
    # buffers that were read, by URI
    files: dict[str, bytes] = field(default_factory=dict, repr=False, compare=False)

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """Return an entry of an array at the root, such as "nodes"; `InputError` if none."""
        array = self.content.get(kind, [])
        known = isinstance(array, list) and type(index) is int and 0 <= index < len(array)
        if not known or not isinstance(array[index], dict):
            raise unlike(self.path, f"refers to {kind}[{index!r}], which it does not hold")
        return array[index]


@dataclass(frozen=True)
class Primitive:
    """The triangles of one primitive of a glTF mesh."""

    vertices: np.ndarray  # (vertices, 3) m
    faces: np.ndarray  # (faces, 3) indices of vertices, counter-clockwise seen from outside
    normals: np.ndarray | None  # (vertices, 3), or None
    uv: np.ndarray | None = None  # (vertices, 2), v downward, or None


def read_gltf(path: str | os.PathLike[str]) -> Gltf:
    """Read the JSON of a glTF file, and the binary part of a `.glb`. Other buffers are read when
    they are needed. Raise `InputError` for a missing file and for anything but glTF 2."""
    file = Path(path)
    try:
        raw = file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); check the name.") from error
    text, binary = _chunks(file, raw) if raw[:4] == b"glTF" else (raw, None)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise unlike(file, "not a glTF file (no JSON in it)") from error
    check_content(str(file), content)
    asset = content.get("asset") if isinstance(content, dict) else None
    version = asset.get("version") if isinstance(asset, dict) else None
    least = asset.get("minVersion", "2.0") if isinstance(asset, dict) else "2.0"
    if not str(version).startswith("2.") or least != "2.0":
        version = version if least == "2.0" else f"{least} at least"
        raise InputError(f"{file}: not of glTF 2 (version {version}); export it as 2.0.")
    _check_places(file, content)
    return Gltf(file, content, binary)


def _check_places(file: Path, content: Mapping[str, Any]) -> None:
    """Refuse a node that has both a matrix and another transform, a matrix that is not affine, or a
    rotation of length 0."""
    nodes = content.get("nodes")
    for i, node in enumerate(nodes if isinstance(nodes, list) else ()):
        if not isinstance(node, dict):
            continue
        beside = [name for name in ("translation", "rotation", "scale") if name in node]
        if "matrix" in node and beside:
            raise InputError(
                f"{file}: nodes[{i}] has a {beside[0]} beside its matrix; leave one of them."
            )
        matrix = node.get("matrix")
        last = matrix[3::4] if isinstance(matrix, list) else []
        known = len(last) == 4 and all(isinstance(x, int | float) for x in last)
        if known and not np.allclose(last, [0, 0, 0, 1], rtol=0, atol=1e-6):
            raise InputError(
                f"{file}: nodes[{i}] has a matrix whose last row is {last}, where glTF has "
                "[0, 0, 0, 1]; store it by columns, and divide it by its last number."
            )
        turn = node.get("rotation")
        if isinstance(turn, list) and turn and not any(turn):
            raise InputError(
                f"{file}: nodes[{i}] has a rotation of length 0; write [0, 0, 0, 1] for none."
            )


def unread_by_trimesh(file: Gltf) -> list[str]:
    """List, in words, the parts of a file that trimesh drops.

    Raise `InputError` for points in sparse accessors or stored as integers, which trimesh misreads.
    """
    found: dict[str, None] = {}  # in order, each once
    nodes, meshes = (_objects(file.content.get(kind)) for kind in ("nodes", "meshes"))
    for node in nodes:
        if "skin" in node:
            found["skins, which pose meshes"] = None
        if _value_of(node.get("extensions"), "EXT_mesh_gpu_instancing") is not None:
            found["copies of meshes (EXT_mesh_gpu_instancing)"] = None
    weighed = [entry for entry in nodes + meshes if isinstance(entry.get("weights"), list)]
    if any(any(entry["weights"]) for entry in weighed):
        found["weights, which deform meshes"] = None
    for part in (part for mesh in meshes for part in _objects(mesh.get("primitives"))):
        if part.get("mode", 4) not in (4, 5):
            found["points, lines or fans"] = None
        index = _value_of(part.get("attributes"), "POSITION")
        if type(index) is int and part.get("mode", 4) in (4, 5):
            accessor, label = _full_accessor(file, index)
            if accessor.get("componentType") != 5126:
                raise InputError(
                    f"{label}: points that are stored as integers (KHR_mesh_quantization) are not "
                    "read; export the file without."
                )
    return list(found)


def _full_accessor(file: Gltf, index: Any) -> tuple[dict[str, Any], str]:
    accessor, label = file.item("accessors", index), f"{file.path}: accessors[{index}]"
    if "sparse" in accessor or "bufferView" not in accessor:
        raise InputError(f"{label}: sparse accessors are not read; export it without.")
    return accessor, label


def _objects(entries: Any) -> list[dict[str, Any]]:
    return [x for x in entries if isinstance(x, dict)] if isinstance(entries, list) else []


def _value_of(entry: Any, key: str) -> Any:
    return entry.get(key) if isinstance(entry, dict) else None


def _chunks(file: Path, raw: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON and the binary part of a `.glb` file."""
    found: dict[int, bytes] = {}
    start, end = _HEAD.size, len(raw)
    while start + _CHUNK.size <= end:
        length, kind = _CHUNK.unpack_from(raw, start)
        start += _CHUNK.size
        if start + length > end:
            raise unlike(file, "ends too early")
        found.setdefault(kind, raw[start : start + length])
        start += length + -length % 4
    if _JSON not in found:
        raise unlike(file, "not a glTF file (no JSON in it)")
    return found[_JSON], found.get(_BINARY)


def primitive_of(file: Gltf, mesh: int, primitive: int, *, uv: bool = False) -> Primitive:
    """Return the triangles of a primitive of a mesh. Mesh and primitive are given by indices from
    0. With `uv`, also return the texture coordinates. Raise `InputError` for a primitive that is
    not a set of triangles, or that has morph targets or extensions."""
    label = f"{file.path}: meshes[{mesh}].primitives[{primitive}]"
    parts = file.item("meshes", mesh).get("primitives", [])
    if not isinstance(parts, list) or not 0 <= primitive < len(parts):
        raise InputError(f"{label}: there is no such primitive; export the file again.")
    part = parts[primitive]
    attributes = part.get("attributes") if isinstance(part, dict) else None
    if not isinstance(attributes, dict) or "POSITION" not in attributes:
        raise unlike(label, "has no POSITION")
    if part.get("mode", 4) != 4:
        raise InputError(f"{label}: mode {part['mode']!r} is not read, only 4, triangles.")
    for key in ("targets", "extensions"):
        if part.get(key):
            raise InputError(f"{label}: {key} are not read; export the mesh without.")
    vertices = _numbers(file, attributes["POSITION"], 3)
    every = np.arange(len(vertices))
    indices = _numbers(file, part["indices"], 1).ravel() if "indices" in part else every
    if len(indices) % 3 or not len(indices) or indices.max() >= len(vertices):
        raise unlike(label, f"{len(indices)} indices of {len(vertices)} vertices make no triangles")

    def read_vertex_values(name: str, what: str, width: int) -> np.ndarray | None:
        own = _numbers(file, attributes[name], width) if name in attributes else None
        if own is not None and len(own) != len(vertices):
            raise unlike(label, f"has not one {what} a vertex")
        return own

    normals = read_vertex_values("NORMAL", "normal", 3)
    known = read_vertex_values("TEXCOORD_0", "texture coordinate", 2) if uv else None
    return Primitive(vertices, indices.reshape(-1, 3).astype(np.int64), normals, known)


def image_bytes(file: Gltf, index: int) -> bytes:
    """Return the bytes of an entry of `images`, a complete image file."""
    image = file.item("images", index)
    if "bufferView" not in image:
        uri = image.get("uri")
        if not isinstance(uri, str):
            raise unlike(file.path, f"images[{index}] names no file")
        return _bytes_at(file.path, uri)
    view = file.item("bufferViews", image["bufferView"])
    buffer = _buffer(file, view.get("buffer"))
    start, length = view.get("byteOffset", 0), view.get("byteLength")
    if not all(type(x) is int and x >= 0 for x in (start, length)) or start + length > len(buffer):
        raise unlike(file.path, f"images[{index}] reaches beyond its buffer")
    return buffer[start : start + length]


def _numbers(file: Gltf, index: Any, width: int) -> np.ndarray:
    """Return the numbers of an accessor, (count, width)."""
    accessor, label = _full_accessor(file, index)
    count = accessor.get("count")
    kind = _value(_TYPES, accessor.get("componentType"))
    whole = width == 1  # indices are integers, points are floating numbers
    if kind is None or _value(_WIDTHS, accessor.get("type")) != width or (kind == "<f4") == whole:
        wanted = "whole numbers" if whole else f"{width} float numbers"
        raise unlike(label, f"is not of {wanted}")
    view = file.item("bufferViews", accessor["bufferView"])
    buffer = _buffer(file, view.get("buffer"))
    size = np.dtype(kind).itemsize
    starts = [view.get("byteOffset", 0), accessor.get("byteOffset", 0)]
    stride = view.get("byteStride", size * width)
    if type(count) is not int or not all(type(x) is int and x >= 0 for x in (*starts, stride)):
        raise unlike(label, "its place in the buffer is no number")
    last = sum(starts) + stride * (count - 1) + size * width
    if count < 1 or stride < size * width or last > len(buffer):
        raise unlike(label, "reaches beyond its buffer")
    return np.ndarray((count, width), kind, buffer, sum(starts), (stride, size)).copy()


def _buffer(file: Gltf, index: Any) -> bytes:
    entry = file.item("buffers", index)
    uri = entry.get("uri")
    if uri is None:
        if file.binary is None or index != 0:
            raise unlike(file.path, f"buffers[{index}] has no bytes")
        return file.binary
    if not isinstance(uri, str):
        raise unlike(file.path, f"buffers[{index}] names no file")
    if uri not in file.files:
        file.files[uri] = _bytes_at(file.path, uri)
    return file.files[uri]


def _value(table: Mapping[Any, Value], key: Any) -> Value | None:
    """Return the value of a key; None if it is neither text nor a number, as in a damaged file."""
    return table.get(key) if isinstance(key, str | int) else None


def _bytes_at(path: Path, uri: str) -> bytes:
    """Return the bytes of a URI: a file relative to the glTF, or data, in base 64 or with escapes
    (RFC 2397)."""
    if uri.startswith("data:"):
        head, _, text = uri.partition(",")
        if not head.endswith(";base64"):
            return unquote_to_bytes(text)
        try:
            return base64.b64decode(text, validate=True)
        except binascii.Error as error:
            raise unlike(path, "a buffer is not in base 64") from error
    beside = path.parent / unquote(uri)
    if not beside.is_file():
        raise InputError(f"{beside}: no such file, which {path.name} names; put it beside.")
    return beside.read_bytes()
