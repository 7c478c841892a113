"""Tests meshes written by other programs: polygons that are not convex, and damaged files."""

import struct
import warnings

import numpy as np
import pytest
import trimesh

from jaxvision.errors import InputError
from jaxvision.files.meshes import read_mesh

PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
)
PLY += "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
RNG = np.random.default_rng(5)


def areas(mesh):
    """Return the sum of the triangles' areas, and the area of their vector sum. The two are equal
    if no triangle covers another."""
    a, b, c = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    return np.linalg.norm(across, axis=1).sum() / 2, np.linalg.norm(across.sum(axis=0)) / 2


def shoelace(flat):
    x, y = flat.T
    return abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def star(points, start=0):
    """Return a star-shaped polygon around the origin, most of whose corners are concave or
    sharp."""
    radius = np.where(np.arange(points) % 2, 1.0, 3.0) + RNG.uniform(0, 0.5, points)
    angle = 2 * np.pi * np.arange(points) / points
    return np.roll(np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1), start, axis=0)


def written(folder, kind, corners, polygons):
    file = folder / f"m.{kind.split('-')[0]}"
    vertices = [" ".join(f"{x:.9g}" for x in row) for row in corners]
    faces = [" ".join(map(str, [len(one), *one])) for one in polygons]
    if kind == "obj":
        vertices = [f"v {row}" for row in vertices]
        faces = ["f " + " ".join(f"{i + 1}" for i in one) for one in polygons]
        file.write_text("\n".join([*vertices, *faces]) + "\n")
    elif kind == "off":
        head = ["OFF", f"{len(vertices)} {len(faces)} 0"]
        file.write_text("\n".join([*head, *vertices, *faces]) + "\n")
    elif kind == "ply":
        head = PLY.format("ascii", len(vertices), len(faces))
        file.write_text(head + "\n".join([*vertices, *faces]) + "\n")
    else:
        body = np.asarray(corners, "<f4").tobytes()
        body += b"".join(struct.pack(f"<B{len(one)}i", len(one), *one) for one in polygons)
        head = PLY.format("binary_little_endian", len(vertices), len(faces))
        file.write_bytes(head.encode() + body)
    return file


@pytest.mark.parametrize("kind", ["obj", "off", "ply", "ply-binary"])
@pytest.mark.parametrize("start", [0, 1, 2, 3])
def test_an_arrow_head_has_four_square_metres_from_any_corner(tmp_path, kind, start):
    flat = np.roll([[0.0, 0], [4, 0], [1, 1], [0, 4]], start, axis=0)
    file = written(tmp_path, kind, np.column_stack([flat, flat * 0 @ [[0], [0]]]), [[0, 1, 2, 3]])
    np.testing.assert_allclose(areas(read_mesh(file)), 4, rtol=1e-6)


@pytest.mark.parametrize("kind", ["obj", "off", "ply", "ply-binary"])
def test_polygons_that_are_not_convex_are_covered_once(tmp_path, kind):
    """Stars in tilted planes, in both orientations, are compared with the shoelace formula."""
    tilt = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    for axes in (np.eye(3), np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 1, 0]], tilt):
        flat = star(14, start=3)
        corners = np.column_stack([flat, np.zeros(14)]) @ axes + [1, 2, 3]
        for order in (range(14), range(13, -1, -1)):
            mesh = read_mesh(written(tmp_path, kind, corners, [list(order)]))
            assert len(mesh.faces) == 12
            np.testing.assert_allclose(areas(mesh), shoelace(flat), rtol=1e-5)


def test_convex_polygons_stay_as_they_were(tmp_path):
    corners = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [3, 1, 0], [1, 1, 0]]
    polygons = [[0, 1, 2, 3], [1, 4, 2]]
    for kind in ("obj", "ply", "off"):
        mesh = read_mesh(written(tmp_path, kind, np.array(corners, float), polygons))
        found = {tuple(sorted(face)) for face in np.asarray(mesh.faces).tolist()}
        assert found == {(0, 1, 2), (0, 2, 3), (1, 2, 4)}


@pytest.mark.parametrize(
    ("name", "data", "sentence"),
    [
        ("a.stl", bytes(80) + struct.pack("<I", 3) + bytes(100), "announces 3 .* length of 2"),
        (
            "a.ply",
            (PLY.format("ascii", 4, 1).replace("face", "tristrips")).encode()
            + b"0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 2 3\n",
            "strips of triangles",
        ),
        ("a.obj", b"v 0,0 0,0 0,0\nv 2,5 0,0 0,0\nv 0,0 2,0 0,0\nf 1 2 3\n", "with commas"),
        ("b.obj", b"v 0 0 0\nv 2 0 0\nv 0 2 0\nv 0 0 2\nf 0/1 1/1 2/1\n", "vertex 0, .* from 1"),
    ],
)
def test_empty_meshes_name_their_content(tmp_path, name, data, sentence):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=sentence):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize("head", ["4OFF", "nOFF\n3", "C4nOFF"])
def test_points_of_four_coordinates_in_off_are_refused(tmp_path, head):
    """(2, 0, 0, 2) is (1, 0, 0) in homogeneous coordinates, so the area would be twice as large."""
    (tmp_path / "a.off").write_text(head + "\n3 1 0\n0 0 0 1\n2 0 0 2\n0 1 0 1\n3 0 1 2\n")
    with pytest.raises(InputError, match="more than three coordinates"):
        read_mesh(tmp_path / "a.off")


@pytest.mark.parametrize("wrong", ["nan", "inf", "1e300"])
def test_vertices_that_are_not_finite_are_counted(tmp_path, wrong):
    """There is one warning, and none of NumPy's."""
    text = f"v 0 0 0\nv {wrong} 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 3\nf 1 4 3\n"
    (tmp_path / "a.obj").write_text(text)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        read_mesh(tmp_path / "a.obj", dtype="float32")
    assert ["1 of its 4 vertices are not finite" in str(w.message) for w in said] == [True]


def test_bytes_after_the_triangles_of_an_stl_are_named(tmp_path):
    data = trimesh.creation.box(extents=(1, 2, 3)).export(file_type="stl")
    (tmp_path / "a.stl").write_bytes(data + b"made by")
    with pytest.warns(UserWarning, match="7 bytes after its last triangle are not used"):
        np.testing.assert_allclose(areas(read_mesh(tmp_path / "a.stl"))[0], 22, rtol=1e-6)


BOX = "".join(f"v {x} {y} {z}\n" for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
BOX += "v 9 9 9\nf 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_byte_order_mark_does_not_hide_a_vertex(tmp_path, mark):
    file = tmp_path / "box.obj"
    file.write_bytes(mark + BOX.encode())
    np.testing.assert_allclose(areas(read_mesh(file))[0], 6)


def test_free_form_surfaces_are_named(tmp_path):
    file = tmp_path / "box.obj"
    file.write_text(BOX + "cstype bezier\ndeg 1 1\nsurf 0 1 0 1 1 2 4 3\nend\n")
    with pytest.warns(UserWarning, match=r"free form \(surf\), which are not read"):
        np.testing.assert_allclose(areas(read_mesh(file))[0], 6)


@pytest.mark.parametrize(
    ("properties", "row"),
    [
        ("list uchar int vertex_indices\nproperty list uchar float texcoord", "{} 2 .5 .5"),
        ("uchar red\nproperty list uchar int vertex_index", "255 {}"),
    ],
)
def test_other_properties_of_a_text_ply_are_skipped(tmp_path, properties, row):
    head = PLY.format("ascii", 4, 2).replace("list uchar int vertex_indices", properties)
    rows = ["0 0 0", "2 0 0", "2 2 0", "0 2 0", row.format("3 0 1 2"), row.format("3 0 2 3")]
    (tmp_path / "a.ply").write_text(head + "\n".join(rows) + "\n")
    np.testing.assert_allclose(areas(read_mesh(tmp_path / "a.ply")), 4)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_face_over_two_lines_is_covered_once(tmp_path, end):
    """The face is a square of 2 m minus a triangle of 1.5 m^2, on two lines of fewer than four
    corners each."""
    file = tmp_path / "a.obj"
    lines = ["v 0 0 0", "v 2 0 0", "v 2 2 0", "v 1 .5 0", "v 0 2 0", "f 1 2 \\", " 3 4 5", ""]
    file.write_bytes(end.join(lines).encode())
    np.testing.assert_allclose(areas(read_mesh(file)), 2.5)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("notch", [".5", "3"])  # with a concave corner, and without
def test_a_comment_that_ends_in_a_backslash_does_not_hide_a_vertex(tmp_path, end, notch):
    """The reference is a pentagon by the shoelace formula. The comment names the program's
    folder."""
    file = tmp_path / "a.obj"
    comment = "# written by C:\\models\\"
    lines = [comment, "v 0 0 0", "v 2 0 0", "v 2 2 0 # in D:\\", f"v 1 {notch} 0", "v 0 2 0"]
    lines += ["f 1 2 \\", " 3 4 5 # over two lines", "v 9 9 9", ""]
    file.write_bytes(end.join(lines).encode())
    corners = np.array([[0, 0], [2, 0], [2, 2], [1, float(notch)], [0, 2]])
    np.testing.assert_allclose(areas(read_mesh(file)), shoelace(corners))


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_comments_and_line_ends_of_an_obj_do_not_matter(tmp_path, newline):
    file = tmp_path / "m.obj"
    lines = "o part#2", "v 0 0 0 # corner", "v 2 0 0", "v 0 1 0#", "f 1 2 3 # the only face", ""
    file.write_bytes(newline.join(lines).encode())
    assert areas(read_mesh(file)) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("comment", "unit"),
    [
        ("# File units = millimeters", "millimeters"),
        ("# Units: in", "in"),
        ("# Units in feet", "feet"),
        ("# 1 unit is 1 mm", "mm"),
        ("# units in metres", None),
        ("# unit normals in this file", None),
    ],
)
def test_a_unit_in_a_comment_is_named(tmp_path, comment, unit):
    obj, ply = tmp_path / "m.obj", tmp_path / "m.ply"
    obj.write_text(f"{comment}\nv 0 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\n")
    head = PLY.format("ascii", 3, 1).replace("1.0\n", f"1.0\n{comment.replace('#', 'comment')}\n")
    ply.write_text(head + "0 0 0\n2 0 0\n0 1 0\n3 0 1 2\n")
    for file in (obj, ply):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            read_mesh(file)
        assert [f"its unit is {unit}," in str(one.message) for one in said] == [True] * bool(unit)


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def test_negative_indices_count_from_the_line_of_the_face(tmp_path):
    """An earlier version repeated the first triangle."""
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvn 0 0 1\nf -3//-1 -2//-1 -1//-1\n"
    (tmp_path / "a.obj").write_text(text + text.replace("v 0", "v 5").replace("v 1", "v 6"))
    mesh = read_mesh(tmp_path / "a.obj")
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    np.testing.assert_array_equal(corners[:, :, 0], [[0, 1, 1], [5, 6, 6]])


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb"])
def test_normals_of_a_file_are_used(tmp_path, suffix):
    """An earlier version computed normals from the triangles."""
    normals = np.array([[0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1]])
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]])
    if suffix == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        lines += [f"vn {x} {y} {z}" for x, y, z in normals]
        (tmp_path / "a.obj").write_text("\n".join([*lines, "f 1//1 2//2 3//3\n"]))
    else:
        mesh = trimesh.Trimesh(corners, [[0, 1, 2]], vertex_normals=normals, process=False)
        mesh.export(tmp_path / f"a.{suffix}")
    found = read_mesh(tmp_path / f"a.{suffix}", smooth=True)
    np.testing.assert_allclose(found.normals, normals, atol=1e-6)
    stretched = np.diag([2.0, 1.0, 1.0])  # normals of a stretched surface rotate away from its axis
    found = read_mesh(
        tmp_path / f"a.{suffix}", smooth=True, matrix=np.column_stack([stretched, np.zeros(3)])
    )
    expected = normals / [2, 1, 1]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(found.normals, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\n", r"its 2 materials \(usemtl\)"),
        ("v 0 0 1 1 0 0\nf 1 2 3\n", "the colours of its vertices"),
        ("v 0 0 1 1.0e+00\nv 0 0 1 2\nf 1 2 3\n", r"the weights w of its vertices \(v x y z w\)"),
        ("f 1 2 3\nl 1 2\np 4\n", r"lines \(l\), points \(p\)"),
        ("call other.obj\nf 1 2 3\n", r"another file \(call\)"),
    ],
)
def test_other_content_of_an_obj_is_named(tmp_path, more, said):
    (tmp_path / "a.obj").write_text(SQUARE + more)
    with pytest.warns(UserWarning, match=f"not used: {said}"):
        read_mesh(tmp_path / "a.obj")
    (tmp_path / "b.obj").write_text(SQUARE.replace(" ", "\t") + "v 1 1 1 1.0\nf\t1 2 3\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(read_mesh(tmp_path / "b.obj").faces) == 1
