"""Tests glTF scenes: meshes are where trimesh puts them, light equals closed forms, and unsupported
content is refused by name."""

import json
import warnings
from base64 import b64decode
from dataclasses import replace
from urllib.parse import quote_from_bytes

import numpy as np
import pytest
import trimesh
from gltf_contents import CORNERS, content, matt

import jaxvision as jv
from jaxvision.errors import InputError
from jaxvision.files.meshes import read_mesh
from jaxvision.files.scenes import read_scene


def read(folder, *, quietly=True, **parts):
    (folder / "a.gltf").write_text(json.dumps(content(**parts)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if quietly else "error")
        return read_scene(folder / "a.gltf")


def middle(source):
    """Return the radiance in the centre of the picture, by direct light."""
    view = replace(source.view, resolution=(1, 1))
    return np.asarray(jv.render(source.scene, view)[0, 0])


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
@pytest.mark.filterwarnings("ignore:.*its coat")
def test_meshes_are_placed_as_by_trimesh(suffix, tmp_path):
    """Nested nodes rotate, stretch and mirror, and use one mesh twice."""
    turned = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0.1, 0.2, 0.3])
    stretched = np.diag([2.0, 0.5, -1.5, 1.0])
    shining = trimesh.visual.material.PBRMaterial(emissiveFactor=[1, 1, 1], metallicFactor=0.5)
    box, ball = trimesh.creation.box((1, 2, 3)), trimesh.creation.icosphere(1)
    for mesh in (box, ball):
        mesh.visual = trimesh.visual.TextureVisuals(material=shining)
    scene = trimesh.Scene()
    scene.add_geometry(box, geom_name="box", node_name="a")
    scene.graph.update("b", "a", matrix=turned, geometry="box")
    scene.add_geometry(ball, node_name="c", parent_node_name="b", transform=stretched)
    scene.camera_transform = trimesh.transformations.translation_matrix([0, 0, 9])
    scene.export(tmp_path / f"s.{suffix}")
    got = read_scene(tmp_path / f"s.{suffix}")
    expected = trimesh.load_scene(tmp_path / f"s.{suffix}", process=False).to_mesh().triangles
    shapes = [surface.shape for surface in got.scene.surfaces]
    triangles = np.concatenate([np.asarray(s.vertices)[np.asarray(s.faces)] for s in shapes])
    assert len(shapes) == 3

    def in_order(corners):  # triangles, each from its smallest corner
        rolled = [np.roll(t, -np.lexsort(t.T.round(4))[0], axis=0) for t in np.asarray(corners)]
        return sorted(tuple(t.round(4).ravel() + 0.0) for t in rolled)

    np.testing.assert_allclose(in_order(triangles), in_order(expected), atol=2e-4)


def test_a_primitive_equals_trimeshs(tmp_path):
    ball = trimesh.creation.icosphere(2)
    ball.vertex_normals  # noqa: B018 trimesh writes the normals that it has at hand
    ball.export(tmp_path / "ball.glb", include_normals=True)
    got = read_mesh(tmp_path / "ball.glb", primitive=(0, 0), smooth=True)
    np.testing.assert_array_equal(got.vertices, ball.vertices.astype(np.float32))
    np.testing.assert_array_equal(got.faces, ball.faces)
    np.testing.assert_allclose(got.normals, ball.vertex_normals, atol=1e-6)
    with pytest.raises(InputError, match=r"meshes\[1\]"):
        read_mesh(tmp_path / "ball.glb", primitive=(1, 0))


@pytest.mark.slow
def test_a_matte_floor_under_a_point_light(tmp_path):
    """The radiance is c / pi I / d^2, with 683 cd as 1 W sr^-1."""
    np.testing.assert_allclose(
        middle(read(tmp_path, quietly=False)), np.array([0.5, 0.4, 0.3]) / np.pi / 4, rtol=1e-5
    )


def test_emission_is_in_nits(tmp_path):
    lamp = matt(0, 0, 0, emissiveFactor=[1, 0.5, 0])
    lamp["extensions"]["KHR_materials_emissive_strength"] = {"emissiveStrength": 6830.0}
    (surface,) = read(tmp_path, material=lamp).scene.surfaces
    np.testing.assert_allclose(surface.emission, [10, 5, 0], rtol=1e-6)


def test_meshes_that_shine_beside_lamps_of_blender_are_named(tmp_path):
    lamp = matt(0, 0, 0, emissiveFactor=[1, 0.5, 0])
    by_blender = {"version": "2.0", "generator": "Khronos glTF Blender I/O v4.2.70"}
    (tmp_path / "a.gltf").write_text(json.dumps(content(lamp, asset=by_blender)))
    with pytest.warns(UserWarning, match="683 times too weak beside them, unless the mode was"):
        read_scene(tmp_path / "a.gltf")
    read(tmp_path, quietly=False, asset=by_blender)


@pytest.mark.parametrize("metal", [1.0, 0.25])
def test_a_lobe_follows_the_specification(metal, tmp_path):
    """The reference writes out Appendix B, at angles where the coat's F is F0 within 1e-4 (h.v =
    0.987)."""
    colour, rough, index = np.array([0.9, 0.6, 0.3]), 0.5, 1.4
    material = {
        "pbrMetallicRoughness": {
            "baseColorFactor": [*colour, 1],
            "metallicFactor": metal,
            "roughnessFactor": rough,
        },
        "extensions": {"KHR_materials_ior": {"ior": index}},
    }
    made = read(tmp_path, material=material).scene.surfaces[0].material
    wi, wo = np.array([np.sin(0.5), 0, np.cos(0.5)]), np.array([np.sin(0.2), 0, np.cos(0.2)])
    h = (wi + wo) / np.linalg.norm(wi + wo)
    a2, nl, nv = rough**4, wi[2], wo[2]
    density = a2 / np.pi / (h[2] ** 2 * (a2 - 1) + 1) ** 2
    seen = 0.5 / (nl * np.sqrt(nv**2 * (1 - a2) + a2) + nv * np.sqrt(nl**2 * (1 - a2) + a2))
    away = (1 - h @ wo) ** 5
    f_coat = (coat := ((index - 1) / (index + 1)) ** 2) + (1 - coat) * away
    f_metal = colour + (1 - colour) * away
    lobe = density * seen
    expected = metal * f_metal * lobe + (1 - metal) * (
        (1 - f_coat) * colour / np.pi + f_coat * lobe
    )
    np.testing.assert_allclose(
        jv.brdf.evaluate(made, *map(np.float32, (wi, wo))), expected, rtol=2e-4
    )


def test_glass_absorbs_as_its_volume_states(tmp_path):
    """By the Beer-Lambert law, white light has the stated colour after the stated distance."""
    clear = {
        "KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_ior": {"ior": 1.33},
        "KHR_materials_volume": {
            "thicknessFactor": 1,
            "attenuationDistance": 0.2,
            "attenuationColor": [1, 0.5, 0.25],
        },
    }
    smooth = {"metallicFactor": 0, "roughnessFactor": 0}
    glass = {"pbrMetallicRoughness": smooth, "extensions": clear}
    made = read(tmp_path, material=glass).scene.surfaces[0].material
    np.testing.assert_allclose(made.index, 1.33, rtol=1e-6)
    np.testing.assert_allclose(np.exp(-made.absorption * 0.2), [1, 0.5, 0.25], rtol=1e-6)
    thin = glass | {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}}
    with pytest.raises(InputError, match="KHR_materials_volume"):
        read(tmp_path, material=thin)


@pytest.mark.parametrize(
    ("camera", "top"),
    [
        (
            {"type": "perspective", "perspective": {"yfov": 0.6, "aspectRatio": 1.5, "znear": 1}},
            5 * np.tan(0.3),
        ),
        (
            {
                "type": "orthographic",
                "orthographic": {"xmag": 1.5, "ymag": 1, "znear": 0, "zfar": 9},
            },
            1,
        ),
    ],
)
def test_the_field_of_view_is_the_cameras(camera, top, tmp_path):
    """The corner of the field of view is at the corner of the picture."""
    view = read(tmp_path, camera=camera).view
    assert view.resolution == (480, 720)
    row, column = np.asarray(jv.project(view, [1.5 * top, top, 0.0]))[..., :2].ravel()
    np.testing.assert_allclose([row, column], [-0.5, 719.5], atol=2e-3)


def changed(*path, to):
    """Return the content with one value changed or added."""
    made = content()
    at = made
    for part in path[:-1]:
        at = at[part]
    at[path[-1]] = to
    return made


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (
            changed("materials", 0, "emissiveTexture", to={"index": 0}),
            'materials "paint".emissiveTexture is not read',
        ),
        (
            changed("materials", 0, "pbrMetallicRoughness", "baseColorTexture", to={"index": 0}),
            "names no texture 0",
        ),
        (
            changed("materials", 0, "extensions", "KHR_materials_sheen", to={}),
            "KHR_materials_sheen is not read",
        ),
        (
            changed(
                *("materials", 0, "extensions", "KHR_materials_specular"),
                to={"specularFactor": 0.5},
            ),
            "specularFactor = 0.5",
        ),
        (changed("materials", 0, "alphaMode", to="BLEND"), "alphaMode = 'BLEND'"),
        (changed("animations", to=[{}]), "animations is not read"),
        (changed("nodes", 0, "skin", to=0), 'nodes "floor".skin is not read'),
        (changed("extensionsRequired", to=["KHR_draco_mesh_compression"]), "needs KHR_draco"),
        (
            changed(
                *("extensions", "KHR_lights_punctual", "lights", 0),
                to={"type": "area"},
            ),
            "'area' is not read",
        ),
        (
            changed(
                *("extensions", "KHR_lights_punctual", "lights", 0),
                to={"type": "point", "range": 3},
            ),
            "range is not read",
        ),
        (changed("meshes", 0, "primitives", 0, "attributes", "COLOR_0", to=0), "COLOR_0"),
        (changed("meshes", 0, "primitives", 0, "mode", to=1), "mode 1 is not read"),
        (changed("meshes", 0, "primitives", 0, "targets", to=[{}]), "targets is not read"),
        (changed("meshes", 0, "primitives", 0, "material", to=4), "item 4, counted from 0, of 1"),
        (changed("meshes", 0, "primitives", 0, "material", to=-1), r"meshes\[0\]\.primitives\[0\]"),
        (changed("accessors", 0, "sparse", to={}), "sparse"),
        (changed("accessors", 0, "count", to=9), "beyond its buffer"),
        (changed("accessors", 1, "count", to=5), "make no triangles"),
        (changed("accessors", 0, "bufferView", to=7), r"bufferViews\[7\]"),
        (changed("buffers", 0, to={"uri": "none.bin"}), "none.bin: no such file"),
        (changed("nodes", 0, "children", to=[0]), "make no tree"),
        (changed("nodes", 1, "scale", to=[1, -1, 1]), "mirrors or flattens"),
        (
            changed("nodes", 0, to={"mesh": 0, "matrix": [*np.eye(4).ravel()], "scale": [2, 2, 2]}),
            r"nodes\[0\] has a scale beside its matrix",
        ),
        (
            changed("nodes", 0, "rotation", to=[0, 0, 0, 0]),
            "has a rotation of length 0",
        ),
        (changed("scenes", 0, "nodes", to=[0, 2]), "has no camera"),
        (changed("scenes", 0, "nodes", to=[1]), "has no mesh"),
        (changed("asset", to={"version": "1.0"}), "not of glTF 2"),
    ],
)
def test_unsupported_content_is_named(made, words, tmp_path):
    file = tmp_path / "a.gltf"
    file.write_text(json.dumps(made))
    with pytest.raises(InputError, match=words) as caught:
        read_scene(file)
    assert "a.gltf" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_coat_is_told(tmp_path):
    plain = {"pbrMetallicRoughness": {"metallicFactor": 0}}
    (tmp_path / "a.gltf").write_text(json.dumps(content(material=plain)))
    with pytest.warns(UserWarning, match=r"a\.gltf: material .*too bright at grazing"):
        read_scene(tmp_path / "a.gltf")


def test_bytes_that_are_no_gltf(tmp_path):
    for raw in (b"", b"glTF", b"glTF\2\0\0\0\0\0\0\0\xff\0\0\0JSON{}", b"[1]", b"\xff{"):
        (tmp_path / "a.glb").write_bytes(raw)
        with pytest.raises(InputError, match=r"a\.glb"):
            read_scene(tmp_path / "a.glb")


@pytest.mark.parametrize("place", ["componentType", "type", "uri"])
def test_lists_where_words_belong(tmp_path, place):
    made = content()
    (made["buffers"] if place == "uri" else made["accessors"])[0][place] = [1]
    (tmp_path / "a.gltf").write_text(json.dumps(made))
    with pytest.raises(InputError, match=r"a\.gltf: .*export it again"):
        read_scene(tmp_path / "a.gltf")


def test_other_scenes_of_a_file_are_named(tmp_path):
    both = content(scenes=[{"nodes": [0, 1, 2]}, {"nodes": [0]}])
    (tmp_path / "a.gltf").write_text(json.dumps(both))
    with pytest.warns(UserWarning, match="has 2 scenes; scene 0, counted from 0, is taken"):
        read_scene(tmp_path / "a.gltf")


def test_a_version_above_2_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"version 2\.1 at least"):
        read(tmp_path, asset={"version": "2.0", "minVersion": "2.1"})


def mesh_of(folder, made):
    (folder / "a.gltf").write_text(json.dumps(made))
    return read_mesh(folder / "a.gltf")


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"sparse": {"count": 1}}, "sparse accessors are not read"),
        ({"componentType": 5122, "normalized": True}, "stored as integers"),
    ],
)
def test_points_that_trimesh_would_misread_are_refused(changed, said, tmp_path):
    made = content()
    assert mesh_of(tmp_path, made).vertices.shape == (4, 3)
    made["accessors"][0] |= changed
    with pytest.raises(InputError, match=said):
        mesh_of(tmp_path, made)


def test_a_matrix_that_is_not_affine_is_refused(tmp_path):
    made = content()
    made["nodes"][0]["matrix"] = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]
    assert float(mesh_of(tmp_path, made).vertices.max()) == 6
    made["nodes"][0]["matrix"][15] = 2
    with pytest.raises(InputError, match=r"last row is \[0, 0, 0, 2\]"):
        mesh_of(tmp_path, made)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c["nodes"][0].update(skin=0), "skins"),
        (lambda c: c["nodes"][0].update(weights=[0, 0.5]), "weights"),
        (lambda c: c["meshes"][0].update(weights=[1.0]), "weights"),
        (
            lambda c: c["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}}),
            "copies of meshes",
        ),
        (
            lambda c: c["meshes"][0]["primitives"].append(
                {"attributes": {"POSITION": 0}, "mode": 6}
            ),
            "points, lines or fans",
        ),
    ],
)
def test_dropped_content_of_a_gltf_mesh_is_named(change, said, tmp_path):
    made = content()
    change(made)
    with pytest.warns(UserWarning, match=f"not used: {said}"):
        assert len(mesh_of(tmp_path, made).faces) == 2


def test_data_without_base_64_are_read(tmp_path):
    made = content()
    stored = b64decode(made["buffers"][0]["uri"].partition(",")[2])
    made["buffers"][0]["uri"] = "data:application/octet-stream," + quote_from_bytes(stored)
    (tmp_path / "a.gltf").write_text(json.dumps(made))
    mesh = read_mesh(tmp_path / "a.gltf", primitive=(0, 0))
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
