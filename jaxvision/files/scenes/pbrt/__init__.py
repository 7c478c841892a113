"""Read scenes of pbrt-v4 (`.pbrt`), as far as their parts have a counterpart in this library. The
following parts are read.

- Shapes: sphere and disk (whole), trianglemesh, bilinearmesh of flat patches, and plymesh, also in
  object instances.
- Materials: diffuse, coateddiffuse, conductor, coatedconductor (rough), dielectric (smooth),
  measured, and mix of diffuse materials and at most one conductor; with normal maps.
- Textures: constant, scale, mix and imagemap.
- Lights: point, distant, spot, goniometric and infinite, and diffuse area lights.
- Cameras: perspective, also with a lens, and orthographic, with any screen window and crop.
- Integrators: path, volpath, simplepath, bdpt, mlt and sppm, which are rendered by path tracing,
  and lightpath.

Values are float, integer, bool, string, points, vectors and normals, rgb, spectrum (pairs, files
and illuminants by name), blackbody and texture. Colours are linear sRGB. A pixel has the value that
it has in pbrt's picture: rgb (1, 1, 1) as the radiance of a light is 1, and a spectrum of a light
has a luminance of 1 times its scale. `power` in lm and `illuminance` in lux give pixels in cd m^-2.

The axes of pbrt's camera are left-handed. Unless the file mirrors them (Scale -1 1 1 before the
camera), the x axis of the world is reversed, so that the picture is pbrt's. A part that is not
supported is never dropped; the file is refused, and the message names the part. If a part is
rendered slightly differently, a warning says so.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from ....core._warnings import warn
from ....errors import InputError, nearest
from ..folder import Folder
from ..nodes import Node
from ..placement import SHINES_TO_ONE_SIDE, Affine, look_at, mirrors
from .camera import camera_of
from .lights import light_entry
from .materials import material_of
from .shapes import area_of, shape_of
from .spectra import light_of, texture_of
from .statements import Statement, node_of, statements_of

_MIRROR = np.diag([-1.0, 1, 1, 1])
_OPTIONS = {"Camera", "Film", "Sampler", "Integrator", "PixelFilter", "Accelerator"}
_OF_WORLD = {
    *("Shape", "LightSource", "AreaLightSource", "Material", "MakeNamedMaterial", "NamedMaterial"),
    *("Texture", "ReverseOrientation", "ObjectInstance", "ObjectBegin", "ObjectEnd", "Import"),
    *("AttributeBegin", "AttributeEnd", "TransformBegin", "TransformEnd", "ImportBegin"),
}
_Any = TypeVar("_Any")
_PATHS = ("path", "volpath", "simplepath", "simplevolpath", "bdpt", "mlt", "sppm", "lightpath")
_NO_EFFECT = ("lightsampler", "rrthreshold", "usemis", "samplelights", "samplebsdf")


def scene_of(file: Path) -> dict[str, Any]:
    """Convert a pbrt scene to the content of a TOML scene file, a dict of its tables by name. Raise
    `InputError` for the first part that is wrong or not supported."""
    reader = _Reader(Folder(file))
    for statement in statements_of(file, reader.folder):
        reader.read(statement)
    return reader.content()


@dataclass(frozen=True)
class _State:
    """The settings that apply to the shapes and lights of a block."""

    to_world: Affine = field(default_factory=lambda: np.eye(4))
    reverse: bool = False
    material: Node | str | None = None
    light: Node | None = None


class _Reader:
    """Collects the objects of a scene, statement by statement."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self._state, self._stack = _State(), list[tuple[str, _State]]()
        self._in_world = False
        self._options: dict[str, Node] = {}
        self._camera_to_world: Affine = np.eye(4)
        self._systems: dict[str, Affine] = {}
        self._textures: dict[str, Node] = {}
        self._materials: dict[str, Node] = {}
        self._converted: dict[str, dict[str, Any]] = {}
        self._shapes: list[tuple[Node, _State]] = []
        self._objects: dict[str, list[tuple[Node, _State]]] = {}
        self._object: str | None = None  # the one that is being defined
        self._lights: list[tuple[Node, Affine]] = []

    def read(self, statement: Statement) -> None:
        """Apply one statement."""
        word, state = statement.word, self._state
        in_world = self._in_world
        if (word in _OPTIONS and in_world) or (word in _OF_WORLD and not in_world):
            side = "before" if in_world else "after"
            raise statement.wrong(f"belongs {side} WorldBegin; move it.")
        match word:
            case "WorldBegin":
                if in_world:
                    raise statement.wrong("stands twice; leave one of them.")
                self._in_world, self._systems["world"] = True, np.eye(4)
                self._state = replace(state, to_world=np.eye(4))
            case "Camera":
                self._options[word] = self._node(statement, 1)
                self._systems["camera"] = self._camera_to_world = np.linalg.inv(state.to_world)
            case _ if word in _OPTIONS:
                self._options[word] = self._node(statement, 1)
            case _ if word in _TRANSFORMS:
                self._state = replace(state, to_world=_transformed(statement, state.to_world))
            case "ReverseOrientation":
                self._state = replace(state, reverse=not state.reverse)
            case "AreaLightSource":
                self._state = replace(state, light=self._node(statement, 1))
            case "Material":
                self._state = replace(state, material=self._node(statement, 1))
            case "NamedMaterial":
                self._state = replace(state, material=statement.name())
            case "CoordinateSystem":
                self._systems[statement.name()] = state.to_world
            case "CoordSysTransform":
                at = _found(statement, statement.name(), "coordinate system", self._systems)
                self._state = replace(state, to_world=at)
            case "ColorSpace":
                if statement.name() != "srgb":
                    raise statement.wrong("is read for srgb alone; convert the colours.")
            case "LightSource":
                self._lights.append((self._node(statement, 1), state.to_world))
            case "Texture":
                name, kind, _ = statement.names(3)
                if kind not in ("float", "spectrum") or name in self._textures:
                    raise statement.wrong("stands twice, or is neither float nor spectrum.")
                self._textures[name] = texture_of(self._node(statement, 3))
            case "MakeNamedMaterial":
                node, (name,) = self._node(statement, 1), statement.names(1)
                if (kind := node.take("type", str)) is None or name in self._materials:
                    raise node.wrong("needs a name of its own and a type; correct it.")
                self._materials[name] = replace(node, kind=kind, label=f"material {name}")
            case "Shape":
                node = self._node(statement, 1)
                if self._object is not None and state.light is not None:
                    raise node.wrong(
                        "shines within an object, which pbrt does not render; move it."
                    )
                found = self._shapes if self._object is None else self._objects[self._object]
                found.append((node, state))
            case "ObjectInstance":
                if self._object is not None:
                    raise statement.wrong("stands within an object; move it.")
                for node, own in _found(statement, statement.name(), "object", self._objects):
                    label = f"{node.label}, of the instance at {statement.place}"
                    own = replace(own, to_world=state.to_world @ own.to_world)
                    self._shapes.append((replace(node, label=label), own))
            case "ObjectBegin" | "AttributeBegin" | "TransformBegin" | "ImportBegin":
                if word == "ObjectBegin":
                    if self._object is not None or statement.name() in self._objects:
                        raise statement.wrong("stands within another or has its name; move it.")
                    self._object = statement.name()
                    self._objects[self._object] = []
                self._stack.append((word.removesuffix("Begin"), state))
            case "ObjectEnd" | "AttributeEnd" | "TransformEnd" | "ImportEnd":
                if not self._stack or self._stack[-1][0] != word.removesuffix("End"):
                    raise statement.wrong("does not end what begins before it; correct it.")
                _, self._state = self._stack.pop()
                self._object = None if word == "ObjectEnd" else self._object
            case _:
                hint = nearest(word, (*_OF_WORLD, *_TRANSFORMS, *_OPTIONS))
                raise statement.wrong(
                    f"is not read; {hint}, or remove it if the picture may do so."
                )

    def content(self) -> dict[str, Any]:
        """Return the tables of the whole scene."""
        if self._stack:
            raise InputError(
                f"{self._stack[-1][0]}Begin is not ended; add {self._stack[-1][0]}End."
            )
        if not self._in_world:
            raise InputError("has no WorldBegin, which starts the scene; add it.")
        camera, film, sampler, integrator, kernel = (
            self._options.get(word) or Node(word, usual, word)
            for word, usual in (
                ("Camera", "perspective"),
                ("Film", "rgb"),
                ("Sampler", "zsobol"),
                ("Integrator", "volpath"),
                ("PixelFilter", "gaussian"),
            )
        )
        world = np.eye(4) if mirrors(self._camera_to_world) else _MIRROR
        content: dict[str, Any] = {
            "camera": camera_of(camera, film, world @ self._camera_to_world),
            "render": _render(sampler, integrator),
            "material": {},
            "surface": [],
            "light": [light_entry(node, world @ own, self.folder) for node, own in self._lights],
        }
        radii = {kernel.take(f"{axis}radius", float, 0.5) for axis in "xy"}
        if kernel.kind != "box" or radii != {0.5}:
            blur = f"pbrt's {kernel.kind[:40]} filter blurs beyond it."
            warn(f"{kernel.label}: pixels are means over their area; {blur}")
        for node, state in self._shapes:
            if state.light and mirrors(state.to_world) and node.kind in ("sphere", "disk"):
                warn(f"{node.label}: is mirrored, which does not turn its light here.")
            own = replace(state, to_world=world @ state.to_world)
            content["surface"].append(self._surface(node, own, content["material"]))
        return content

    def _surface(self, node: Node, state: _State, materials: dict[str, Any]) -> dict[str, Any]:
        """Convert a shape with its material and area light."""
        shape = shape_of(node, state.to_world, state.reverse, self.folder)
        turned = shape.pop("turned", False)
        material = Node("Material", "diffuse", "the default material")
        if state.material is not None:
            known = state.material
            material = self._named(node, known) if isinstance(known, str) else known
        if material.label not in self._converted:
            self._converted[material.label] = material_of(material, self._named)
        table = dict(self._converted[material.label])
        normals = table.pop("normals", None)
        is_glass, two_sided = table["family"] == "glass", True
        made = {"name": node.label, **shape, "material": material.label}
        if shape["shape"] == "sphere" and _mirrors_maps(node, state.to_world, table, normals):
            made["material"] += ", mirrored"
        if normals is not None:
            made["normals"] = normals
        if state.light is not None:
            made["emission"], two_sided = _emission(state.light, node, shape)
            if not two_sided and shape["shape"] != "sphere":
                warn(f"{node.label}: {SHINES_TO_ONE_SIDE}")
        if turned and (is_glass or state.light is not None):
            raise node.wrong("is turned inside out, which is not read; give it as a mesh.")
        materials[made["material"]] = table
        return made | {"two_sided": two_sided and not is_glass}

    def _node(self, statement: Statement, names: int) -> Node:
        return node_of(statement, names, self._textures, self.folder)

    def _named(self, node: Node, name: str) -> Node:
        """Return a named material. Raise `InputError` for a mixture of mixtures."""
        found = _found(node, name, "material", self._materials)
        if node.kind == found.kind == "mix":
            raise node.wrong("mixes a mixture, which is not read; mix its materials.")
        return found


def _found(place: Statement | Node, name: str, kind: str, known: Mapping[str, _Any]) -> _Any:
    if name not in known:
        hint = nearest(name, known) if known else "define it before"
        raise place.wrong(f"no {kind} is named {name[:40]!r}; {hint}.")
    return known[name]


def _transformed(statement: Statement, to_world: Affine) -> Affine:
    step = _TRANSFORMS[statement.word](statement)
    whole = step if statement.word in ("Transform", "Identity") else to_world @ step
    if not np.isfinite(whole).all() or not np.linalg.det(whole[:3, :3]):
        raise statement.wrong("flattens space or is not finite; correct its numbers.")
    return whole


def _emission(light: Node, node: Node, shape: dict[str, Any]) -> tuple[list[float], bool]:
    """Return the radiance of an area light, and whether it shines to both sides."""
    light.must_be("diffuse")
    two_sided, scale = light.take("twosided", bool, False), light.take("scale", float, 1.0)
    if (power := light.take("power", float, -1.0)) > 0:
        scale *= power / (np.pi * (2 if two_sided else 1) * area_of(node, shape))
    radiance = (scale * light_of(light, "L")).tolist()
    light.must_be_read()
    return radiance, two_sided


def _mirrors_maps(
    node: Node, to_world: Affine, table: dict[str, Any], normals: dict[str, Any] | None
) -> bool:
    """Mirror the maps in the material of a sphere if the world is mirrored, and return whether it
    is.

    Maps of spheres have the world's z axis, so other rotations raise `InputError`.
    """
    maps = {key: x for key, x in table.items() if isinstance(x, dict) and "map" in x}
    linear = to_world[:3, :3] / np.linalg.norm(to_world[:3, 2])
    if not (maps or normals) or np.allclose(linear, np.eye(3), atol=1e-6):
        return False
    if not np.allclose(linear, np.diag([-1, 1, 1]), atol=1e-6) or normals is not None:
        raise node.wrong("is rotated, which its texture is not; give it as a mesh.")
    for key, found in maps.items():  # phi becomes pi - phi
        (a, b, c), second = found.get("uv", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        table[key] = found | {"uv": [[-a, b, c + a / 2], second]}
    return True


def _render(sampler: Node, integrator: Node) -> dict[str, Any]:
    """Convert sampler and integrator. pbrt counts reflections, one less than the path's
    segments.
    """
    if sampler.kind == "stratified":
        samples = sampler.take("xsamples", int, 4) * sampler.take("ysamples", int, 4)
    else:
        samples = sampler.take("pixelsamples", int, 16)
    kind = integrator.must_be(*_PATHS)
    if integrator.take("regularize", bool, False):
        raise integrator.wrong("regularize is not read; set it to false.")
    depth = integrator.take("maxdepth", int, 5) + 1
    if kind not in ("mlt", "sppm", "bdpt"):  # whose further parameters change the noise alone
        integrator.must_be_read(without=_NO_EFFECT)
    name = "light" if kind == "lightpath" else "path"
    return {"integrator": name, "samples": samples, "depth": max(depth, 1)}


# ---------------------------------------------------------------- transforms


def _matrix(statement: Statement) -> Affine:
    matrix = statement.numbers(16).reshape(4, 4).T  # the file lists its columns
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise statement.wrong("is a projection; its last column must be 0 0 0 1.")
    return matrix


def _translation(statement: Statement) -> Affine:
    step = np.eye(4)
    step[:3, 3] = statement.numbers(3)
    return step


def _rotation(statement: Statement) -> Affine:
    degrees, *axis = statement.numbers(4)
    if not np.any(axis):
        raise statement.wrong("has an axis of length 0; correct it.")
    step = np.eye(4)
    turn = np.radians(degrees) * np.array(axis) / np.linalg.norm(axis)
    step[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return step


def _view(statement: Statement) -> Affine:
    origin, target, up = statement.numbers(9).reshape(3, 3)
    return np.linalg.inv(look_at(origin, target, up, f"{statement.place}: LookAt"))


_TRANSFORMS: dict[str, Callable[[Statement], Affine]] = {
    "Identity": lambda statement: np.eye(4),
    "Translate": _translation,
    "Scale": lambda statement: np.diag([*statement.numbers(3), 1.0]),
    "Rotate": _rotation,
    "LookAt": _view,
    "Transform": _matrix,
    "ConcatTransform": _matrix,
}
