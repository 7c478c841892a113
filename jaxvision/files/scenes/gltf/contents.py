"""Models of the supported part of glTF's JSON. A key that these models do not have has no exact
counterpart in this library, and raises `InputError`."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from ....errors import InputError
from ...toml import Entry, Finite, NonNegative, Positive, checked

Share = Annotated[float, Field(strict=True, ge=0, le=1)]
Index = Annotated[int, Field(strict=True, ge=0)]
Colour = tuple[Share, Share, Share]


class Named(Entry):
    """The fields that all glTF objects share; `extras` are data of other programs."""

    name: str | None = None
    extras: Any = None


class Perspective(Named):
    """A camera with central projection; angles in rad."""

    yfov: Annotated[float, Field(strict=True, gt=0, lt=3.1415926)]
    aspectRatio: Positive | None = None
    znear: Any = None
    zfar: Any = None


class Parallel(Named):
    """A camera with parallel projection, of half width `xmag` and half height `ymag`, m."""

    xmag: Positive
    ymag: Positive
    znear: Any = None
    zfar: Any = None


class Camera(Named):
    """A camera, an object of the array `cameras`."""

    type: Literal["perspective", "orthographic"]
    perspective: Perspective | None = None
    orthographic: Parallel | None = None


class Spot(Named):
    """The half-angles of a spotlight's inner and outer cone, in rad."""

    innerConeAngle: NonNegative = 0.0
    outerConeAngle: NonNegative = math.pi / 4


class Light(Named):
    """A light of KHR_lights_punctual. The intensity is in cd, or in lux for a directional light."""

    type: str
    color: Colour = (1.0, 1.0, 1.0)
    intensity: NonNegative = 1.0
    spot: Spot = Spot()


class Lights(Entry):
    """The lights of a file."""

    lights: tuple[Light, ...] = ()


class RootExtensions(Entry):
    """The extensions at the root of a file."""

    KHR_lights_punctual: Lights = Lights()


class LightHere(Entry):
    """The index of the light at a node."""

    light: Index


class NodeExtensions(Entry):
    """The extensions of a node."""

    KHR_lights_punctual: LightHere | None = None


class Node(Named):
    """A node, with a `matrix` by columns, or a translation (m), rotation (x, y, z, w), scale."""

    children: tuple[Index, ...] = ()
    mesh: Index | None = None
    camera: Index | None = None
    matrix: Annotated[tuple[Finite, ...], Field(min_length=16, max_length=16)] | None = None
    translation: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    rotation: tuple[Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[Finite, Finite, Finite] = (1.0, 1.0, 1.0)
    extensions: NodeExtensions = NodeExtensions()


class Primitive(Entry):
    """A primitive of a mesh; `jaxvision.files.gltf` reads its numbers."""

    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: Any = 4
    extras: Any = None


class Mesh(Named):
    """A mesh, an object of the array `meshes`."""

    primitives: tuple[Primitive, ...]


class Placed(Entry):
    """KHR_texture_transform, which scales texture coordinates and then adds an offset. A rotation
    of texture coordinates raises an error, because programs that write glTF disagree on its
    direction."""

    offset: tuple[Finite, Finite] = (0.0, 0.0)
    rotation: Annotated[float, Field(ge=0, le=0)] = 0.0
    scale: tuple[Finite, Finite] = (1.0, 1.0)
    texCoord: Literal[0] = 0


class TextureExtensions(Entry):
    """The extensions at a reference to a texture."""

    KHR_texture_transform: Placed = Placed()


class Used(Entry):
    """A reference from a material to a texture."""

    index: Index
    texCoord: Literal[0] = 0
    extensions: TextureExtensions = TextureExtensions()
    extras: Any = None


class UsedNormals(Used):
    """A reference from a material to a normal map; `scale` multiplies x and y of the normals."""

    scale: Finite = 1.0


class Texture(Named):
    """A texture, an object of the array `textures`."""

    source: Index
    sampler: Index | None = None


class Sampler(Named):
    """A sampler, with filters and wrapping as numbers of OpenGL."""

    magFilter: Any = None
    minFilter: Any = None
    wrapS: Literal[10497, 33071, 33648] = 10497
    wrapT: Literal[10497, 33071, 33648] = 10497


class Roughness(Entry):
    """The object `pbrMetallicRoughness`; its roughness is the root of GGX's alpha."""

    baseColorFactor: tuple[Share, Share, Share, Share] = (1.0, 1.0, 1.0, 1.0)
    baseColorTexture: Used | None = None
    metallicRoughnessTexture: Used | None = None
    metallicFactor: Share = 1.0
    roughnessFactor: Share = 1.0
    extras: Any = None


class Strength(Entry):
    """KHR_materials_emissive_strength: a factor on the emission."""

    emissiveStrength: NonNegative = 1.0


class Ior(Entry):
    """KHR_materials_ior: the refractive index of a dielectric."""

    ior: Annotated[float, Field(strict=True, ge=1)] = 1.5


class Coat(Entry):
    """KHR_materials_specular: the strength of a dielectric's specular coat, 0 for none."""

    specularFactor: Share = 1.0


class Transmission(Entry):
    """KHR_materials_transmission: the share of light that is transmitted, 1 for glass."""

    transmissionFactor: Share = 0.0


class Volume(Entry):
    """KHR_materials_volume: the transmittance of a volume over a given distance, in m."""

    thicknessFactor: NonNegative = 0.0
    attenuationDistance: Positive | None = None
    attenuationColor: Colour = (1.0, 1.0, 1.0)


class MaterialExtensions(Entry):
    """The extensions of a material."""

    KHR_materials_emissive_strength: Strength = Strength()
    KHR_materials_ior: Ior = Ior()
    KHR_materials_specular: Coat = Coat()
    KHR_materials_transmission: Transmission = Transmission()
    KHR_materials_volume: Volume = Volume()


class Material(Named):
    """A material, an object of the array `materials`."""

    pbrMetallicRoughness: Roughness = Roughness()
    normalTexture: UsedNormals | None = None
    occlusionTexture: Any = None
    emissiveFactor: Colour = (0.0, 0.0, 0.0)
    doubleSided: bool = False
    alphaMode: Literal["OPAQUE"] = "OPAQUE"
    alphaCutoff: Any = None
    extensions: MaterialExtensions = MaterialExtensions()


class Part(Named):
    """A scene, an object of the array `scenes`."""

    nodes: tuple[Index, ...] = ()


class Content(Entry):
    """The JSON of a whole glTF file. `files.gltf` reads buffers and images."""

    asset: Any
    scene: Index = 0
    scenes: tuple[Part, ...] = ()
    nodes: tuple[Node, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    materials: tuple[Material, ...] = ()
    cameras: tuple[Camera, ...] = ()
    extensions: RootExtensions = RootExtensions()
    extensionsUsed: Any = None
    extensionsRequired: Any = None
    accessors: Any = None
    buffers: Any = None
    bufferViews: Any = None
    images: Any = None
    samplers: tuple[Sampler, ...] = ()
    textures: tuple[Texture, ...] = ()
    extras: Any = None


def content_of(path: object, content: Mapping[str, Any]) -> Content:
    """Convert the JSON of the file at `path` to records; refuse the first fault."""
    try:
        return Content.model_validate(content)
    except ValidationError as error:
        for mistake in error.errors():
            if mistake["type"] == "extra_forbidden":
                raise InputError(
                    f"{path}: {_place(mistake['loc'], content)} is not read; export the scene "
                    "without it."
                ) from error
    return checked(str(path), content, Content, "glTF", first=0)


def _place(loc: tuple[int | str, ...], content: Any) -> str:
    """Return the place of an error in the JSON, such as `materials "red".normalTexture`."""
    place, at = "", content
    for part in loc:
        at = at[part]
        name = at.get("name") if isinstance(at, dict) else None
        if isinstance(part, int):
            place += f' "{name}"' if isinstance(name, str) else f"[{part}]"
        else:
            place += f".{part}" if place else part
    return place
