"""Tests meshes from files: their triangles, their placement, and one sentence for each failure."""

import builtins

import numpy as np
import pytest
import trimesh
from scene_texts import PLY

from jaxvision.errors import InputError
from jaxvision.files.meshes import read_mesh
from jaxvision.geometry import problems

CUBE = trimesh.creation.box((2, 4, 6))


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb", ".stl", ".off"])
def test_a_cube_is_read_back(tmp_path, suffix):
    """Corners, twelve triangles, area and volume agree. The volume is positive, so the triangles
    face outwards."""
    CUBE.export(tmp_path / f"cube{suffix}")
    mesh = read_mesh(tmp_path / f"cube{suffix}")
    a, b, c = np.moveaxis(np.asarray(mesh.vertices)[np.asarray(mesh.faces)], 1, 0)
    assert mesh.faces.shape == (12, 3)
    np.testing.assert_allclose(np.abs(mesh.vertices), [[1, 2, 3]] * len(mesh.vertices), rtol=1e-6)
    across = np.cross(b - a, c - a)
    np.testing.assert_allclose(np.linalg.norm(across, axis=1).sum() / 2, 88, rtol=1e-6)
    np.testing.assert_allclose(np.einsum("ij,ij->", a, across) / 6, 48, rtol=1e-6)
    assert mesh.normals is None


def test_polygons_and_the_order_of_points_in_obj(tmp_path):
    """A quad becomes two triangles of the same orientation, and points keep the file's order."""
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nf 1 2 3 4\n")
    mesh = read_mesh(tmp_path / "a.obj")
    np.testing.assert_allclose(mesh.vertices, [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]])
    a, b, c = np.moveaxis(np.asarray(mesh.vertices)[np.asarray(mesh.faces)], 1, 0)
    np.testing.assert_allclose(np.cross(b - a, c - a), [[0, 0, 2]] * 2)


def test_it_is_scaled_turned_and_moved(tmp_path):
    """x' = position + scale (x e_1 + y e_2 + z e_3), with the rows e of the rotation."""
    CUBE.export(tmp_path / "a.ply")
    rows = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]])
    plain = read_mesh(tmp_path / "a.ply")
    placed = read_mesh(tmp_path / "a.ply", scale=0.5, rotation=rows, position=(1, 2, 3))
    expected = [
        np.array([1, 2, 3]) + 0.5 * sum(part * row for part, row in zip(vertex, rows, strict=True))
        for vertex in np.asarray(plain.vertices)
    ]
    np.testing.assert_allclose(placed.vertices, expected)


def test_the_parts_of_a_glb_stand_where_it_puts_them(tmp_path):
    scene = trimesh.Scene()
    there = trimesh.transformations.translation_matrix([10, 0, 0])
    scene.add_geometry(CUBE, node_name="here")
    scene.add_geometry(CUBE, node_name="there", transform=there)
    scene.export(tmp_path / "a.glb")
    mesh = read_mesh(tmp_path / "a.glb")
    assert mesh.faces.shape == (24, 3)
    x = np.asarray(mesh.vertices)[:, 0]
    assert sorted(set(np.round(x, 6))) == [-1, 1, 9, 11]


def test_smooth_normals_of_a_sphere_point_outwards(tmp_path):
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / "a.ply")
    mesh = read_mesh(tmp_path / "a.ply", smooth=True, scale=3)
    radial = np.asarray(mesh.vertices) / 3
    assert (np.einsum("ij,ij->i", mesh.normals, radial) > 0.999).all()
    flipped = read_mesh(tmp_path / "a.ply", smooth=True, scale=3, flip=True)
    np.testing.assert_allclose(flipped.normals, -np.asarray(mesh.normals))
    np.testing.assert_array_equal(flipped.faces, np.asarray(mesh.faces)[:, ::-1])


def test_triangles_without_area_are_left_out_and_counted(tmp_path):
    """A corner used twice, and three corners on a line, are among four valid triangles."""
    points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 2 0 0\n"
    sound = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "a.obj").write_text(points + "f 1 1 2\n" + sound + "f 1 2 5\n")
    with pytest.warns(UserWarning, match=r"a\.obj: 2 of 6 triangles have no area and"):
        mesh = read_mesh(tmp_path / "a.obj", scale=1e-3)
    np.testing.assert_array_equal(mesh.faces, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert problems(mesh) == []
    (tmp_path / "b.obj").write_text(points + "f 1 1 2\nf 1 2 5\n")
    with pytest.raises(InputError, match=r"b\.obj: none of its 2 triangles has area"):
        read_mesh(tmp_path / "b.obj")


@pytest.mark.parametrize(
    ("name", "data", "sentence"),
    [
        (
            "cow.ply",
            PLY.replace("3 0 1 2", "3 0 1 7").encode(),
            "vertex 7, counted from 0, where there are 3",
        ),
        ("cow.obj", None, "no such mesh file"),
        ("cow.xyz7", b"v 0 0 0", "is not a mesh format"),
        ("cow.ply", b"not a mesh", "not readable as a mesh|holds no triangles"),
        ("cow.glb", b"glTF\0\0", "not a glTF file"),
        ("cow.obj", b"v 0 0 0\nv 1 0 0\n", "holds no triangles|not readable"),
        (
            "cow.ply",
            b"ply\ngarbage",
            r"mesh \(it ends too early, or refers to parts that are not in it",
        ),
        ("cow.obj", b"v 0 0 0\nf 1 2 9\n", r"refers to parts that are not in it|where there are 1"),
        (
            "cow.ply",
            PLY.partition("1 0 0")[0].encode() + b"1 0\n",
            r"not readable as a mesh \(it ends too early, or",
        ),
        ("cow.obj", b"\xff\xfe\0\0", r"mesh \(it holds bytes that are not text|no triangles"),
        ("cow.gltf", b"{bad", "not a glTF file"),
    ],
)
def test_bad_files_are_one_sentence(tmp_path, name, data, sentence):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=rf"{name}: .*({sentence})") as caught:
        read_mesh(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_without_trimesh_it_says_what_to_install(tmp_path, monkeypatch):
    CUBE.export(tmp_path / "a.ply")
    real = builtins.__import__

    def absent(name, *arguments, **options):
        if name.startswith("trimesh"):
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(InputError, match=r"`pip install 'jaxvision-imaging\[mesh\]'`"):
        read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize("smooth", [False, True])
def test_points_have_three_coordinates(tmp_path, smooth):
    (tmp_path / "flat.obj").write_text("v 0 0\nv 1 0\nv 1 1\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"flat\.obj: its points do not have three coordinates"):
        read_mesh(tmp_path / "flat.obj", smooth=smooth)
