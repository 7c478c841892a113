"""Read scenes of glTF 2.0 (`.gltf`, `.glb`), as far as their parts have a counterpart in this
library. The following parts are read.

- Meshes: triangles with their normals. Every node that shows a mesh becomes surfaces.
- Materials: metallic-roughness with its factors, and the extensions KHR_materials_ior,
  KHR_materials_emissive_strength and KHR_materials_specular (factor 0 or 1). Glass is read from
  KHR_materials_transmission and KHR_materials_volume.
- Textures: base colour, metallic and roughness, and normal maps, from PNG and JPEG, with the scale
  and offset of KHR_texture_transform.
- Lights: point, directional and spot lights of KHR_lights_punctual.
- Cameras: perspective and orthographic.

glTF measures light in candela, lux and cd m^-2. This library uses watts instead of lumens, at 683
lm for 1 W. In its lighting mode "Standard", Blender writes lamps in units at 683 lm for 1 W, but
not emissive meshes. A warning is given for a file with both lamps and emissive meshes. Colours are
linear sRGB. A part that is not supported is never dropped; the file is refused, and the message
names the part. If a part is rendered slightly differently, a warning says so.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....core._warnings import warn
from ....errors import InputError
from ....spectra import LUMINOUS_EFFICACY
from ..._plain_content import unlike
from ...gltf import Gltf, read_gltf
from .contents import Camera, Content, Light, Material, Node, content_of
from .materials import emission_of, material_of, normals_of

ROWS = 480  # rows of the picture: a file gives its aspect ratio, not its pixels
_EXTENSIONS = {
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_texture_transform",
}
_UNREAD = ("COLOR_", "JOINTS_", "WEIGHTS_")  # attributes that change the picture


def scene_of(file: Path) -> dict[str, Any]:
    """Convert a `.gltf` or `.glb` file to the tables, by name, of a TOML scene file. Raise
    `InputError` for the first part that is wrong or not supported."""
    whole = read_gltf(file)
    content = content_of(file, whole.content)
    for name in content.extensionsRequired or ():
        if name not in _EXTENSIONS:
            raise InputError(f"needs {name}, which is not read; export the scene without it.")
    lights, cameras, surfaces, materials = [], [], [], {}
    for label, node, to_world in placed_nodes(content):
        here = node.extensions.KHR_lights_punctual
        if here is not None:
            known = content.extensions.KHR_lights_punctual.lights
            lights.append({"name": label, **_light(_item(known, here.light, label), to_world)})
        if node.camera is not None:
            cameras.append(_camera(_item(content.cameras, node.camera, label), to_world, label))
        if node.mesh is not None:
            surfaces += _surfaces(whole, content, node.mesh, to_world, label, materials)
    if not cameras:
        raise InputError("has no camera in its scene; add one.")
    if len(cameras) > 1:
        warn(f"has {len(cameras)} cameras; the first is taken.")
    if len(content.scenes) > 1:
        warn(f"has {len(content.scenes)} scenes; scene {content.scene}, counted from 0, is taken.")
    if not surfaces:
        raise InputError("has no mesh in its scene; add one.")
    if (
        "Blender" in str(content.asset)
        and lights
        and any("emission" in surface for surface in surfaces)
    ):
        warn(
            "holds lamps and meshes that shine, written by Blender, whose lighting mode 'Standard' "
            "counts 683 lm for a watt of its lamps but not of its meshes: these are 683 times too "
            "weak beside them, unless the mode was 'Unitless'; then all of the picture is."
        )
    return {
        "camera": cameras[0],
        "render": {"integrator": "path"},
        "material": materials,
        "surface": surfaces,
        "light": lights,
    }


def _item(items: tuple, index: int, label: str):
    if index >= len(items):
        raise unlike(label, f"names item {index}, counted from 0, of {len(items)}")
    return items[index]


def _light(light: Light, to_world: np.ndarray) -> dict[str, Any]:
    """Convert a light at its node, along whose -z it shines."""
    if light.type not in ("point", "directional", "spot"):
        raise InputError(
            f"a light of type {light.type!r} is not read, only 'point', 'directional' and 'spot'; "
            "put a mesh that shines in its place."
        )
    amount = (light.intensity / LUMINOUS_EFFICACY * np.array(light.color)).tolist()
    if light.type == "directional":
        return {"kind": "directional", "direction": to_world[:3, 2].tolist(), "irradiance": amount}
    made = {"kind": light.type, "position": to_world[:3, 3].tolist(), "intensity": amount}
    if light.type == "spot":
        inner, outer = light.spot.innerConeAngle, light.spot.outerConeAngle
        if not inner < outer <= np.pi / 2:
            raise InputError(
                f"a spot has cones of {inner:g} and {outer:g} rad: the inner one must be the "
                "smaller, the outer one at most pi / 2; export it again."
            )
        made |= {"inner": float(np.degrees(inner)), "outer": float(np.degrees(outer))}
        made["direction"] = (-to_world[:3, 2]).tolist()
    return made


def _camera(camera: Camera, to_world: np.ndarray, label: str) -> dict[str, Any]:
    """Convert a camera of glTF, placed and rotated by its node, to keys of a scene file. The camera
    looks along -z, with y up."""
    if np.linalg.det(to_world[:3, :3]) <= 0:
        raise InputError(f"{label}: mirrors or flattens its camera; correct its scale.")
    position = to_world[:3, 3]
    made = {
        "position": position.tolist(),
        "target": (position - to_world[:3, 2]).tolist(),
        "up": to_world[:3, 1].tolist(),
    }
    if camera.type == "perspective":
        lens = camera.perspective
        if lens is None:
            raise unlike(label, "its camera has no 'perspective'")
        columns = max(1, round(ROWS * (lens.aspectRatio or 4 / 3)))
        across = 2 * np.arctan(np.tan(lens.yfov / 2) * columns / ROWS)
        made |= {"kind": "pinhole", "field_of_view": float(np.degrees(across))}
    else:
        size = camera.orthographic
        if size is None:
            raise unlike(label, "its camera has no 'orthographic'")
        columns = max(1, round(ROWS * size.xmag / size.ymag))
        made |= {"kind": "orthographic", "width": 2 * size.ymag * columns / ROWS}
    return made | {"resolution": [ROWS, columns]}


def _surfaces(
    file: Gltf,
    content: Content,
    index: int,
    to_world: np.ndarray,
    label: str,
    materials: dict[str, Any],
) -> list[dict[str, Any]]:
    """Convert each primitive of a mesh to a surface."""
    made = []
    for number, part in enumerate(_item(content.meshes, index, label).primitives):
        unread = [name for name in part.attributes if name.startswith(_UNREAD)]
        if unread:
            raise InputError(f"{label}: {unread[0]} is not read; export the mesh without it.")
        material, name = Material(), "glTF's default"
        if part.material is not None:
            material = _item(content.materials, part.material, label)
            name = f"{material.name or 'material'} {part.material}"
        if name not in materials:
            materials[name] = material_of(file, content, material, f"material {name!r}")
        surface = {
            "name": label,
            "shape": "mesh",
            "file": file.path.name,
            "primitive": [index, number],
            "matrix": to_world[:3].tolist(),
            "smooth": "NORMAL" in part.attributes,
            "material": name,
            "two_sided": material.doubleSided,
        }
        normals = normals_of(file, content, material, f"material {name!r}")
        if normals is not None:
            surface["normals"] = normals
            if "TANGENT" in part.attributes:
                warn(
                    f"{label}: TANGENT is not used; tangents of its normal map follow from the "
                    "texture coordinates."
                )
        emission = emission_of(material)
        if emission.any():
            surface["emission"] = (emission / LUMINOUS_EFFICACY).tolist()
        made.append(surface)
    return made


def placed_nodes(content: Content) -> Iterator[tuple[str, Node, np.ndarray]]:
    """Yield the nodes of the file's scene, parents first: the name, the node, and the matrix, (4,
    4), that maps its points, as columns, to the world. Raise `InputError` for a missing node, or
    for a node with two parents."""
    if not content.scenes:
        raise InputError("has no scene; export it again.")
    if content.scene >= len(content.scenes):
        raise InputError(f"has no scene {content.scene}; export it again.")
    waiting = [(i, np.eye(4)) for i in reversed(content.scenes[content.scene].nodes)]
    seen: set[int] = set()
    while waiting:
        index, above = waiting.pop()
        if index >= len(content.nodes) or index in seen:
            raise InputError(f"its nodes make no tree at nodes[{index}]; export it again.")
        seen.add(index)
        node = content.nodes[index]
        here = above @ _local(node)
        yield f"nodes[{index}]" if node.name is None else f'node "{node.name}"', node, here
        waiting += [(child, here) for child in reversed(node.children)]


def _local(node: Node) -> np.ndarray:
    """Return the matrix of a node, (4, 4), which scales, then rotates, then translates."""
    if node.matrix is not None:
        return np.reshape(node.matrix, (4, 4)).T
    x, y, z, w = np.array(node.rotation) / np.linalg.norm(node.rotation)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = turn * node.scale, node.translation
    return whole
