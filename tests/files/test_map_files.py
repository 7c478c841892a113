"""Tests maps in scene files of this library, glTF and Mitsuba: the radiance at the centre of a
texel is the one of its number in the file."""

import base64
import json
import struct
import warnings
import zlib

import numpy as np
import pytest
from gltf_contents import CORNERS, FACES, content
from oracles import mitsuba_pictures
from scene_texts import BALL

import jaxvision as jv
from jaxvision.errors import InputError
from jaxvision.files.images import write_image
from jaxvision.files.materials import read_material, write_material
from jaxvision.files.scenes import read_scene

CODES = np.array([[[20, 60, 200], [90, 30, 250]], [[255, 128, 0], [10, 160, 70]]], np.uint8)


def linear(codes):
    """Return the linear value by the sRGB standard's formula."""
    c = codes / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def test_the_keys_of_a_map(tmp_path):
    """The maps are an sRGB picture, one linear channel of it, and texels given in the file."""
    write_image(tmp_path / "codes.png", CODES)
    made = BALL.replace(
        'family = "lambert"\nalbedo = [0.2, 0.2, 0.2]',
        """family = "torrance_sparrow"
albedo = { map = "codes.png", uv = [[2, 0, 0.5], [0, 3, 0]] }
roughness = { map = "codes.png", channel = 1, scale = 0.5, wrap = "clamp" }
f0 = { texels = [[0.1, 0.3]] }""",
    )
    assert "codes" in made
    (tmp_path / "a.toml").write_text(made)
    (surface,) = read_scene(tmp_path / "a.toml").scene.surfaces
    found = surface.material
    np.testing.assert_allclose(found.diffuse.values, linear(CODES) / np.pi, atol=1e-6)
    np.testing.assert_allclose(found.diffuse.uv, [[2, 0, 0.5], [0, 3, 0]])
    np.testing.assert_allclose(found.roughness.values, CODES[..., 1] / 510, atol=1e-6)
    assert found.roughness.wrap == "clamp"
    np.testing.assert_allclose(found.interface.f0.values[0, :, 0], [0.1, 0.3], atol=1e-6)
    (tmp_path / "a.toml").write_text(made.replace("channel = 1", "channel = 3"))
    with pytest.raises(InputError, match=r"roughness: a map has rows, columns and channels"):
        read_scene(tmp_path / "a.toml")


def grey_png(path, codes, bits, chunks=()):
    """Write a grey PNG of codes below 2^bits, byte by byte (ISO/IEC 15948)."""

    def chunk(kind, content):
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    rows = b""
    for row in codes:
        digits = "".join(format(int(code), f"0{bits}b") for code in row)
        digits += "0" * (-len(digits) % 8)
        rows += b"\0" + int(digits, 2).to_bytes(len(digits) // 8, "big")
    head = struct.pack(">IIBBBBB", len(codes[0]), len(codes), bits, 0, 0, 0, 0)
    made = [(b"IHDR", head), *chunks, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*one) for one in made))


@pytest.mark.parametrize(
    ("name", "largest"),
    [
        *(("1.png", 1), ("2.png", 3), ("4.png", 15), ("8.png", 255), ("16.png", 65535)),
        *(("sbit.png", 4095), ("contradicted.png", 65535), ("100.pgm", 100), ("1023.pgm", 1023)),
    ],
)
def test_a_map_of_any_depth_is_scaled_by_its_largest_code(name, largest, tmp_path):
    """White is 1 for all bit depths, for example 1 in 1 bit, and 4095 of 12 bits in 16."""
    codes = np.round(largest * np.array([[0, 1 / 3], [0.7, 1]])).astype(int)
    stem, file = name.partition(".")[0], tmp_path / name
    if name == "sbit.png":  # 12 bits, scaled to 16
        grey_png(file, codes * 16 + codes // 256, 16, [(b"sBIT", b"\x0c")])
    elif name == "contradicted.png":
        grey_png(file, codes, 16, [(b"sBIT", b"\x0c")])
    elif name.endswith(".png"):
        grey_png(file, codes, int(stem))
    else:
        kind = ">u2" if largest > 255 else "u1"
        file.write_bytes(b"P5\n2 2\n%d\n" % largest + codes.astype(kind).tobytes())
    made = BALL.replace(
        'family = "lambert"\nalbedo = [0.2, 0.2, 0.2]',
        'family = "torrance_sparrow"\nalbedo = [0.2, 0.2, 0.2]\n'
        f'f0 = [0.04, 0.04, 0.04]\nroughness = {{ map = "{name}" }}',
    )
    (tmp_path / "a.toml").write_text(made)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (surface,) = read_scene(tmp_path / "a.toml").scene.surfaces
    wanted = codes / largest
    np.testing.assert_allclose(surface.material.roughness.values, wanted, atol=1e-6)


def test_a_texture_of_gltf_of_4_bits_is_no_darker(tmp_path):
    codes = np.array([[0, 5], [10, 15]])
    paint = {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}
    with pytest.warns(UserWarning, match="its coat"):
        textured(tmp_path, pbrMetallicRoughness=paint)
    grey_png(tmp_path / "codes.png", codes, 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = read_scene(tmp_path / "a.gltf").scene
    found = np.asarray(scene.surfaces[0].material.diffuse.values)[..., 0]
    np.testing.assert_allclose(found / found.max(), linear(codes * 17), atol=1e-5)


def test_a_material_with_a_map_is_read_back(tmp_path):
    paint = jv.Lambert(jv.Map(np.random.default_rng(0).random((2, 3, 1)), wrap="clamp"))
    write_material(paint, tmp_path / "paint.toml")
    again = read_material(tmp_path / "paint.toml")
    np.testing.assert_array_equal(again.diffuse.values, paint.diffuse.values)
    assert again.diffuse.wrap == "clamp"


UPRIGHT = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4")  # as seen from above


def textured(tmp_path, codes=CODES, corners=UPRIGHT, scale=(1, 1, 1), **material):
    """Return the scene of a 2 m square whose picture is `codes.png`."""
    write_image(tmp_path / "codes.png", codes)
    data = CORNERS.tobytes() + FACES.tobytes() + corners.tobytes()
    made = content({"name": "paint", **material})
    made["accessors"].append({"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2"})
    made["bufferViews"].append({"buffer": 0, "byteOffset": 60, "byteLength": 32})
    uri = "data:application/gltf-buffer;base64," + base64.b64encode(data).decode()
    made["buffers"] = [{"byteLength": len(data), "uri": uri}]
    made["nodes"][0]["scale"] = list(scale)
    made["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = 2
    made["images"], made["textures"] = [{"uri": "codes.png"}], [{"source": 0}]
    (tmp_path / "a.gltf").write_text(json.dumps(made))
    return read_scene(tmp_path / "a.gltf").scene


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*its coat")
def test_textures_of_gltf(tmp_path):
    """The upper left texel is the picture's first, green is roughness, and blue is metalness."""
    matt = {"KHR_materials_specular": {"specularFactor": 0}}
    surface = {"baseColorTexture": {"index": 0}, "metallicFactor": 0}
    scene = textured(tmp_path, pbrMetallicRoughness=surface, extensions=matt)
    for (x, y), code in {(-0.5, 0.5): CODES[0, 0], (0.5, -0.5): CODES[1, 1]}.items():
        seen = jv.radiance_along(scene, jv.as_dtype(jv.Ray([x, y, 5], [0, 0, -1]), "float32"))
        way = np.array([-x, -y, 2])
        light = way[2] / np.linalg.norm(way) ** 3
        np.testing.assert_allclose(seen, linear(code) / np.pi * light, rtol=1e-4)
    surface = {"metallicRoughnessTexture": {"index": 0}, "baseColorFactor": [0.5, 0.6, 0.7, 1]}
    (made,) = textured(tmp_path, pbrMetallicRoughness=surface).surfaces
    metal = CODES[..., 2:] / 255
    np.testing.assert_allclose(
        made.material.roughness.values, (CODES[..., 1] / 255) ** 2, atol=1e-6
    )
    colour = np.array([0.5, 0.6, 0.7])
    wanted = (1 - metal) * 0.04 + metal * colour
    np.testing.assert_allclose(made.material.interface.f0.values, wanted, atol=1e-6)
    with pytest.warns(UserWarning, match="50% of the normals of its map point into the surface"):
        (made,) = textured(tmp_path, normalTexture={"index": 0, "scale": 0.5}).surfaces
    wanted = (2 * (CODES / 255) - 1) * [0.5, 0.5, 1]
    np.testing.assert_allclose(made.normals.values, wanted, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("corners", [UPRIGHT, UPRIGHT * [-1, 1], UPRIGHT * [1, -1], -UPRIGHT])
@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, -1, 1)])
def test_normals_of_gltf_stay_upright_on_mirrored_charts(tmp_path, corners, scale):
    """x of the map is along growing u, and y along falling v, as the corners of the square show."""
    codes = np.full((2, 2, 3), [200, 160, 230], np.uint8)
    scene = textured(
        tmp_path,
        codes,
        corners.astype("<f4"),
        scale,
        normalTexture={"index": 0},
        extensions={"KHR_materials_specular": {"specularFactor": 0}},
        pbrMetallicRoughness={"metallicFactor": 0},
    )
    along_u = (CORNERS[1] - CORNERS[0]) * (corners[1] - corners[0])[0] * scale
    along_v = (CORNERS[3] - CORNERS[0]) * (corners[3] - corners[0])[1] * scale
    x, y, z = 2 * (codes[0, 0] / 255) - 1
    normal = x * along_u / 2 - y * along_v / 2 + z * np.array([0, 0, 1])
    normal /= np.linalg.norm(normal)
    for place in ([0.3, 0.2], [-0.3, -0.2]):
        toward = np.array([*place, -2.0]) * -1
        light = max(normal @ toward, 0) / np.linalg.norm(toward) ** 3
        seen = jv.radiance_along(scene, jv.as_dtype(jv.Ray([*place, 5], [0, 0, -1]), "float32"))
        np.testing.assert_allclose(seen, light / np.pi, rtol=1e-5)


@pytest.mark.filterwarnings("ignore:.*max_depth has no limit")
def test_textures_of_mitsuba_that_are_not_read_are_named(tmp_path):
    write_image(tmp_path / "codes.png", CODES)
    texture = """<bsdf type="diffuse"><texture type="{}" name="reflectance">
        <string name="filename" value="codes.png"/>{}</texture></bsdf>"""
    turn = '<transform name="to_world"><rotate z="1" angle="30"/></transform>'
    camera = mitsuba_pictures.camera("perspective", '<float name="fov" value="40"/>')
    for shape, kind, more, words in (
        ("sphere", "checkerboard", "", "of which only bitmap is read"),
        ("sphere", "bitmap", '<string name="filter_type" value="nearest"/>', "filter_type"),
        ("disk", "bitmap", "", "no texture coordinates"),
        ("sphere", "bitmap", turn, "is rotated"),
    ):
        inside = texture.format(kind, "" if more == turn else more) + (turn if more == turn else "")
        parts = f'{camera}<emitter type="constant"/><shape type="{shape}">{inside}</shape>'
        (tmp_path / "a.xml").write_text(f'<scene version="3.0.0">{parts}</scene>')
        with pytest.raises(InputError, match=words):
            read_scene(tmp_path / "a.xml")


def relief(size=32):
    """Return heights of bumps as codes of normals with y up, in a picture whose rows run down."""
    row, column = np.mgrid[:size, :size] / size
    spots = np.random.default_rng(4).uniform(0.2, 0.8, (6, 2))
    height = sum(0.02 * np.exp(-((row - r) ** 2 + (column - c) ** 2) / 0.01) for r, c in spots)
    down, right = np.gradient(height, 1 / size)
    normals = np.stack([-right, down, np.ones_like(height)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.round(255 * (normals + 1) / 2).astype(np.uint8)


REVERSED = np.array([0, 255, 0]) + np.array([1, -1, 1]) * relief().astype(int)
UP = "uv = [[1, 0, 0], [0, -1, 1]]"  # the first row is at the end of edge_v


def quad(tmp_path, normals):
    """Return a 1 m square with the given normal map."""
    head, _, rest = BALL.partition("[[surface]]")
    shape = 'shape = "quad"\ncorner = [0, 0, 0]\nedge_u = [1, 0, 0]\nedge_v = [0, 1, 0]\n'
    shape += f'material = "grey"\nnormals = {{ {normals} }}\n'
    light = rest[rest.index("[[light]]") :]
    (tmp_path / "a.toml").write_text(f"{head}[[surface]]\n{shape}{light}")
    (surface,) = read_scene(tmp_path / "a.toml").scene.surfaces
    return surface


@pytest.mark.parametrize(
    ("codes", "more", "named"),
    [(relief(), UP, False), (REVERSED, UP, True), (REVERSED, "", False), (relief(), "", True)],
)
def test_a_relief_whose_y_axis_is_reversed_is_named(codes, more, named, tmp_path):
    """Without a warning, the radiance of the quad equals that of the relief in world
    coordinates."""
    write_image(tmp_path / "n.png", codes.astype(np.uint8))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        surface = quad(tmp_path, 'map = "n.png"' + (", " + more if more else ""))
    assert any("only if their y axis is reversed" in str(one.message) for one in said) == named
    if named:
        return
    toward = np.array([0.6, 0.5, 0.6245]) / np.linalg.norm([0.6, 0.5, 0.6245])
    scene = jv.as_dtype(jv.Scene((surface,), (jv.DirectionalLight(toward, [1.0] * 3),)), "float32")
    rows, columns = np.array([12, 22, 8]), np.array([9, 15, 20])
    x, y, z = (2 * (relief()[rows, columns] / 255) - 1).T  # y up in the picture
    up = 1 if more else -1  # else the picture is upside down, and bumps stay bumps
    wanted = (np.stack([x, up * y, z], axis=-1) @ toward) / np.sqrt(x**2 + y**2 + z**2)
    across, down = (columns + 0.5) / len(codes), (rows + 0.5) / len(codes)
    for u, v, expected in zip(across, 1 - down if more else down, wanted, strict=True):
        ray = jv.as_dtype(jv.Ray([u, v, 3], [0, 0, -1]), "float32")
        seen = float(jv.radiance_along(scene, ray)[0])
        np.testing.assert_allclose(seen, expected * 0.2 / np.pi, rtol=2e-3)


def test_maps_without_normals_are_named_and_signed_ones_read(tmp_path):
    """Components below 0 in a floating-point picture were mapped as codes, which made z 1 and x
    -1."""
    normals = 2 * (relief() / 255) - 1
    write_image(tmp_path / "n.exr", normals.astype(np.float32))
    found = quad(tmp_path, f'map = "n.exr", {UP}').normals.values
    np.testing.assert_allclose(found, normals, atol=1e-3)
    heights = np.full((16, 16, 3), 60, np.uint8)
    heights[:4] = 200
    write_image(tmp_path / "h.png", heights)
    with pytest.warns(UserWarning, match="75% of the normals of its map point into the surface"):
        quad(tmp_path, 'map = "h.png"')


@pytest.mark.filterwarnings("ignore:.*its coat")
@pytest.mark.parametrize(("codes", "named"), [(relief(), False), (REVERSED, True)])
def test_normals_of_directx_in_gltf_are_named(codes, named, tmp_path):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        textured(tmp_path, codes.astype(np.uint8), normalTexture={"index": 0})
    assert any("only if their y axis is reversed" in str(one.message) for one in said) == named
