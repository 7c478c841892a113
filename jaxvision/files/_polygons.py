"""Divide the polygons of OBJ, PLY and OFF files into triangles that cover exactly the polygon.

Other readers use the fan of triangles from the first corner, which is wrong for polygons that are
not convex. Here convex polygons are divided into this fan, and other polygons by ear clipping.
"""

import re
from pathlib import Path

import numpy as np

Polygons = list[np.ndarray]  # of corners, numbers of vertices

_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


def cut(vertices: np.ndarray, polygons: Polygons) -> list[np.ndarray]:
    """Divide each polygon into triangles, (triangles, 3) indices into its list of corners."""
    counts = np.array([len(one) for one in polygons])
    found = [fan(count) for count in counts]
    for count in np.unique(counts[counts > 3]):
        members = np.flatnonzero(counts == count)
        corners = vertices[np.stack([polygons[i] for i in members])]
        edges = np.roll(corners, -1, axis=1) - corners
        normals = np.cross(corners - corners[:, :1], edges).sum(axis=1)  # twice the area
        turns = np.cross(np.roll(edges, 1, axis=1), edges)
        inward = np.einsum("ijk,ik->ij", turns, normals)
        for k in np.flatnonzero((inward < 0).any(axis=1)):
            found[members[k]] = _clip_ears(corners[k], normals[k])
    return found


def fan(count: int) -> np.ndarray:
    """Return the fan of triangles from the first of `count` corners, (count - 2, 3) indices."""
    return np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], 1)


def are_fans(pieces: list[np.ndarray]) -> bool:
    """Return whether every polygon was divided as the fan of triangles from its first corner."""
    return all(len(one) == 1 or np.array_equal(one, fan(len(one) + 2)) for one in pieces)


def _clip_ears(corners: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Divide a polygon by ear clipping; one that intersects itself is divided into the fan."""
    axis = int(np.abs(normal).argmax())
    x, y = np.delete(corners, axis, axis=1).T
    if (normal[axis] < 0) != (axis == 1):  # x and z are seen from behind
        x = -x

    def turn(a: int, b: int, c: int | np.ndarray) -> np.ndarray:
        return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])

    left, triangles = list(range(len(corners))), []
    while len(left) > 3:
        for k, b in enumerate(left):
            a, c = left[k - 1], left[(k + 1) % len(left)]
            size = turn(a, b, c)
            others = np.array([p for p in left if p not in (a, b, c)])
            same = np.zeros(len(others), bool)
            for corner in (a, b, c):  # a bridge to a hole passes some corners twice
                same |= (x[others] == x[corner]) & (y[others] == y[corner])
            inside = (turn(a, b, others) >= 0) & (turn(b, c, others) >= 0)
            inside &= (turn(c, a, others) >= 0) & ~same
            if size == 0 or (size > 0 and not inside.any()):
                break
        else:
            return fan(len(corners))
        triangles.append((a, b, c))
        left.remove(b)
    return np.array([*triangles, left])


def obj_counted_from_the_start(text: str) -> str:
    """Return an OBJ text whose negative indices, which count back from the line of the face, are
    replaced by positive ones."""
    if not re.search(r"^[ \t]*f\b.*[\s/]-\d", text, re.MULTILINE):
        return text
    lines, counts = text.splitlines(), {"v": 0, "vt": 0, "vn": 0}

    def corner(word: str) -> str:
        indices = []
        for index, kind in zip(word.split("/"), counts, strict=False):
            back = index.startswith("-") and index[1:].isdigit()
            if back and int(index) < -counts[kind]:
                return word  # the reader says so
            indices.append(str(counts[kind] + 1 + int(index)) if back else index)
        return "/".join(indices)

    for place, line in enumerate(lines):
        words = line.split("#", 1)[0].split()
        if words and words[0] in counts:
            counts[words[0]] += 1
        elif words[:1] == ["f"]:
            lines[place] = " ".join(["f", *map(corner, words[1:])])
    return "\n".join(lines) + "\n"


def obj_in_triangles(text: str) -> str | None:
    """Return an OBJ text (continued lines joined) in triangles, or None if all are convex."""
    if not re.search(r"^[ \t]*f(?:[ \t]+\S+){4}", text, re.MULTILINE):
        return None
    lines = text.splitlines()
    vertices, places, polygons = [], [], []
    for place, line in enumerate(lines):
        words = line.split("#", 1)[0].split()
        if words[:1] == ["v"]:
            vertices.append(words[1:4])
        elif words[:1] == ["f"] and len(words) > 4:
            corners = np.array([int(word.split("/")[0]) for word in words[1:]])
            places.append(place)
            polygons.append(np.where(corners < 0, len(vertices) + corners, corners - 1))
    if not polygons:
        return None
    points = np.array(vertices, float)
    if any(one.min() < 0 or one.max() >= len(points) for one in polygons):
        return None  # the reader says so
    pieces = cut(points, polygons)
    if are_fans(pieces):
        return None
    for place, triangles in zip(places, pieces, strict=True):
        words = np.array(lines[place].split("#", 1)[0].split()[1:])
        lines[place] = "\n".join("f " + " ".join(three) for three in words[triangles])
    return "\n".join(lines) + "\n"


def polygons_of(file: Path) -> Polygons | None:
    """Return the polygons of a PLY or OFF file, or None for triangles or an unknown file."""
    try:
        found = (
            _off_polygons(file)
            if file.suffix.lower() == ".off"
            else _ply_polygons(file.read_bytes())
        )
    except (ValueError, IndexError, KeyError, StopIteration, OverflowError):
        return None  # the reader of meshes says why
    if not found or all(len(one) == 3 for one in found) or min(map(len, found)) < 3:
        return None
    return found


def _off_polygons(file: Path) -> Polygons:
    text = re.sub(r"#.*", "", file.read_text("latin-1")).split("OFF", 1)[1]
    lines = [line.split() for line in text.splitlines() if line.strip()]
    vertices, faces = int(lines[0][0]), int(lines[0][1])
    rows = lines[1 + vertices : 1 + vertices + faces]
    return [np.array(row[1 : int(row[0]) + 1], int) for row in rows]


def ply_of_corners(data: bytes) -> bytes | None:
    """Rewrite a PLY text file so that its faces have no property except their list of corners.
    Return None if the faces already have only this property, or if this module cannot read the
    file. In a text file, mesh readers expect one list per face, as the first property."""
    try:
        kind, elements, start = _ply_head(data)
        faces = next((e for e in elements if e[0] == "face"), None)
        if kind != "ascii" or faces is None or len(faces[2]) == 1:
            return None
        lines = data[start:].decode("latin-1").splitlines()
        first = sum(count for _, count, _ in elements[: elements.index(faces)])
        for at in range(first, first + faces[1]):
            corners = _corners_of(lines[at].split(), faces[2])
            lines[at] = " ".join(map(str, [len(corners), *corners]))
    except (ValueError, IndexError, KeyError, StopIteration):
        return None  # the reader of meshes says why
    head = data[:start].decode("latin-1").splitlines()
    place = next(n for n, line in enumerate(head) if line.split()[:2] == ["element", "face"])
    kept = next(w for w in faces[2] if w[0] == "list" and "vertex_ind" in w[3])
    after = place + 1
    while head[after].split()[:1] in (["property"], ["comment"]):
        del head[after]
    head.insert(after, " ".join(["property", *kept]))
    return "\n".join([*head, *lines, ""]).encode("latin-1")


def _ply_head(data: bytes) -> tuple[str, list[tuple[str, int, list[list[str]]]], int]:
    """Return the format of a PLY file, its elements, and the position of the first number."""
    end = data.index(b"end_header")
    head = [line.split() for line in data[:end].decode("latin-1").splitlines()]
    kind = next(words[1] for words in head if words[:1] == ["format"])
    elements: list[tuple[str, int, list[list[str]]]] = []
    for words in head:
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    return kind, elements, data.index(b"\n", end) + 1


def _ply_polygons(data: bytes) -> Polygons:
    """Return the corner lists of a PLY file; [] for a binary file of unequal polygons."""
    kind, elements, start = _ply_head(data)
    if kind == "ascii":
        lines = iter(line.split() for line in data[start:].decode("latin-1").splitlines())
        for name, count, properties in elements:
            rows = [next(lines) for _ in range(count)]
            if name == "face":
                return [_corners_of(row, properties) for row in rows]
        return []
    order = "<" if "little" in kind else ">"
    for name, count, properties in elements:
        if count == 0:
            continue
        fields, at = [], start
        for place, words in enumerate(properties):
            if words[0] == "list":
                size = np.dtype(order + _PLY_TYPES[words[1]])
                many = int(np.frombuffer(data, size, 1, at)[0])
                fields.append((f"n{place}", size))
                fields.append((words[3], np.dtype(order + _PLY_TYPES[words[2]]), (many,)))
            else:
                fields.append((words[1], np.dtype(order + _PLY_TYPES[words[0]])))
            at = start + np.dtype(fields).itemsize
        table = np.frombuffer(data, np.dtype(fields), count, start)
        for field in fields:
            counts = field[0] if re.fullmatch(r"n\d+", field[0]) else None
            if counts and (table[counts] != table[counts][0]).any():
                return []
        if name == "face":
            corners = next(w[3] for w in properties if w[0] == "list" and "vertex_ind" in w[3])
            return list(table[corners].astype(int))
        start += table.nbytes
    return []


def _corners_of(row: list[str], properties: list[list[str]]) -> np.ndarray:
    at = 0
    for words in properties:
        many = int(row[at]) if words[0] == "list" else 0
        if words[0] == "list" and "vertex_ind" in words[3]:
            return np.array(row[at + 1 : at + 1 + many], int)
        at += 1 + many
    raise KeyError("vertex_indices")
