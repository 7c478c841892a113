"""Read scenes in Mitsuba's XML (versions 0.5 to 3), as far as their parts have an exact counterpart
in this library. The following parts are read.

- Shapes: sphere, rectangle, disk, cube, obj and ply.
- BSDFs: diffuse, twosided, dielectric, conductor (material "none"), roughconductor, plastic,
  roughplastic and normalmap, with textures of type bitmap.
- Emitters: point, directional, spot, constant and envmap, and area on any shape.
- Sensors: perspective, thinlens and orthographic.
- Integrators: path, volpath and direct, which are rendered by path tracing, and ptracer.

Supported values are float, integer, boolean, string, vector, point, rgb, spectrum, transforms,
`<default>`, `<ref>`, `<alias>` and `<include>`, and for lights also blackbody. Colours are
converted as in Mitsuba's RGB variants. A part that is not supported is never dropped; the file is
refused, and the message names the part. If a part is rendered slightly differently, a warning says
so. If a mesh has mirrored texture coordinates, the y axis of a normal map points upward in the
picture of the map, whereas in Mitsuba it points downward.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ....core._warnings import warn
from ....errors import InputError
from ..nodes import Node
from ..placement import SHINES_TO_ONE_SIDE
from .camera import camera_of
from .document import root_of
from .materials import material_of
from .shapes import shape_of
from .spectra import light_of

_DEPTH = 16  # largest number of segments of a path that Mitsuba would not limit
_READ = ("shape", "bsdf", "emitter", "sensor", "integrator")


def scene_of(file: Path) -> dict[str, Any]:
    """Convert a Mitsuba scene to the tables, by name, of a TOML scene file. Raise `InputError` for
    the first part that is wrong or not supported."""
    root = root_of(file)
    root.must_be_read(tags=_READ)
    sensors = root.children("sensor")
    if not sensors:
        raise InputError("has no <sensor>; add one.")
    if len(sensors) > 1:
        warn(f"has {len(sensors)} sensors; the first is taken.")
    camera, samples = camera_of(sensors[0])
    content: dict[str, Any] = {
        "camera": camera,
        "render": _render(root.only_child("integrator"), samples, old=root.old),
        "material": {},
        "surface": [],
        "light": [light_entry(node) for node in root.children("emitter")],
    }
    for node in root.children("shape"):
        surface = _surface(node, content["material"])
        content["surface"].append(surface)
    return content


def _surface(node: Node, materials: dict[str, Any]) -> dict[str, Any]:
    """Convert a shape with its BSDF and area light; a shape with a light but no BSDF is black."""
    bsdf, emitter = node.only_child("bsdf"), node.only_child("emitter")
    made = {"name": node.label, **shape_of(node)}
    two_sided = False
    if bsdf is not None or emitter is None:
        made["material"] = "diffuse" if bsdf is None else bsdf.label
        material, two_sided = material_of(bsdf)
        normals = material.pop("normals", None)
        maps = [x for x in (*material.values(), normals) if isinstance(x, dict) and "map" in x]
        made |= {} if normals is None else {"normals": normals}
        _check_coordinates(node, made, bool(maps))
        materials[made["material"]] = material
    if emitter is not None:
        emitter.must_be("area")
        made["emission"] = light_of(emitter, "radiance", 1.0)
        emitter.must_be_read(without=("sampling_weight",))
        if two_sided and made["shape"] in ("quad", "disc", "mesh"):
            warn(f"{node.label}: {SHINES_TO_ONE_SIDE}")
        two_sided = False
    if (
        made["shape"] == "mesh"
        and not two_sided
        and np.linalg.det(np.array(made["matrix"])[:, :3]) < 0
    ):
        warn(
            f"{node.label}: to_world mirrors the mesh, whose outside stays outside here; Mitsuba "
            "turns it inside out."
        )
    node.must_be_read(tags=("bsdf", "emitter"), without=("flip_tex_coords",))
    return made | {"two_sided": two_sided}


def _check_coordinates(node: Node, surface: dict[str, Any], mapped: bool) -> None:
    """Refuse a texture whose coordinates differ from those of our record."""
    turned = node.take("to_world", np.ndarray, np.eye(4))[:3, :3]
    usual = node.take("flip_tex_coords", bool, node.kind == "obj") == (node.kind == "obj")
    if not mapped:
        return
    if surface["shape"] == "quad" and not np.allclose(surface["edge_u"], 2 * turned[:, 0]):
        raise node.wrong("is turned over, which textures are not; give it as a mesh.")
    if surface["shape"] == "sphere" and not np.allclose(turned, abs(turned[0, 0]) * np.eye(3)):
        raise node.wrong("is rotated, which its texture is not; give it as a mesh.")
    if not usual:
        raise node.wrong("flip_tex_coords is not read with a texture; remove it.")


def _render(node: Node | None, samples: int, *, old: bool) -> dict[str, Any]:
    """Convert the integrator; the largest number of path segments equals Mitsuba's `max_depth`. For
    a scene without an integrator, Mitsuba renders direct light before version 2, and all light from
    version 2 on."""
    if node is None and old:
        return {"integrator": "path", "samples": samples, "depth": 2}
    if node is None:
        return _paths("integrator", -1, samples)
    kind = node.must_be("path", "volpath", "volpathmis", "direct", "ptracer")
    if node.take("hide_emitters", bool, False):
        raise node.wrong("hide_emitters is not read; remove it.")
    if kind == "direct":
        node.must_be_read(without=("shading_samples", "emitter_samples", "bsdf_samples"))
        return {"integrator": "path", "samples": samples, "depth": 2}
    made = _paths(node.label, node.take("max_depth", int, -1), samples)
    node.must_be_read(without=("rr_depth", "samples_per_pass"))
    return made | ({"integrator": "light"} if kind == "ptracer" else {})


def _paths(label: str, depth: int, samples: int) -> dict[str, Any]:
    if depth < 0:
        warn(
            f"{label}: max_depth has no limit; paths end after {_DEPTH} segments here. Choose "
            "another number by --depth."
        )
        depth = _DEPTH
    return {"integrator": "path", "samples": samples, "depth": max(depth, 1)}


EMITTERS = ("point", "directional", "spot", "constant", "envmap")


def light_entry(node: Node) -> dict[str, Any]:
    """Return `kind` and the other keys of an `<emitter>` of the scene, with lengths in m. Raise
    `InputError` for an emitter without a counterpart."""
    kind = node.must_be(*EMITTERS)
    place = {"point": "position", "directional": "direction"}.get(kind)
    if {place, "to_world"} <= set(node.values):
        raise node.wrong(f"has a {place} and a to_world, of which Mitsuba takes one; leave one.")
    to_world = node.take("to_world", np.ndarray, np.eye(4))
    match kind:
        case "point":
            position = node.take("position", np.ndarray, to_world[:3, 3])
            intensity = light_of(node, "intensity", 1.0)
            made = {"kind": "point", "position": position.tolist(), "intensity": intensity}
        case "directional":
            direction = node.take("direction", np.ndarray, to_world[:3, 2])
            made = {"kind": "directional", "direction": (-direction).tolist()}
            made["irradiance"] = light_of(node, "irradiance", 1.0)
        case "spot":
            outer = node.take("cutoff_angle", float, 20.0)
            made = {"kind": "spot", "falloff": "linear", "outer": outer}
            made["inner"] = node.take("beam_width", float, 0.75 * outer)
            made |= {"position": to_world[:3, 3].tolist(), "direction": to_world[:3, 2].tolist()}
            made["intensity"] = light_of(node, "intensity", 1.0)
        case "constant":
            made = {"kind": "environment", "radiance": light_of(node, "radiance", 1.0)}
        case _:
            made = {"kind": "environment", "file": node.filename()}
            made |= {"scale": node.take("scale", float, 1.0)}
            made |= {"up": to_world[:3, 1].tolist(), "toward": to_world[:3, 2].tolist()}
    node.must_be_read(without=("sampling_weight",))
    return {"name": node.label, **made}
