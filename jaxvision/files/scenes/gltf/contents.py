"""The supported part of glTF's JSON, as models: a missing key has no exact counterpart."""

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
    """The common fields of glTF objects; `extras` are data of other programs."""

    name: str | None = None
    extras: Any = None


class Perspective(Named):
    """A camera of central projection; angles in rad."""

    yfov: Annotated[float, Field(strict=True, gt=0, lt=3.1415926)]
    aspectRatio: Positive | None = None
    znear: Any = None
    zfar: Any = None


class Parallel(Named):
    """A camera with parallel projection: half the width and half the height of the picture, m."""

    xmag: Positive
    ymag: Positive
    znear: Any = None
    zfar: Any = None


class Camera(Named):
    """An object of `cameras`."""

    type: Literal["perspective", "orthographic"]
    perspective: Perspective | None = None
    orthographic: Parallel | None = None


class Spot(Named):
    """The half angles of a spot's cones, rad."""

    innerConeAngle: NonNegative = 0.0
    outerConeAngle: NonNegative = math.pi / 4


class Light(Named):
    """A light of KHR_lights_punctual, in cd, or in lux if it is directional."""

    type: str
    color: Colour = (1.0, 1.0, 1.0)
    intensity: NonNegative = 1.0
    spot: Spot = Spot()


class Lights(Entry):
    """All lights of the file."""

    lights: tuple[Light, ...] = ()


class RootExtensions(Entry):
    """Extensions at the root."""

    KHR_lights_punctual: Lights = Lights()


class LightHere(Entry):
    """The index of a light."""

    light: Index


class NodeExtensions(Entry):
    """Extensions at a node."""

    KHR_lights_punctual: LightHere | None = None


class Node(Named):
    """An object of `nodes`: `matrix` by columns, or translation (m), rotation (x, y, z, w) and
    scale."""

    children: tuple[Index, ...] = ()
    mesh: Index | None = None
    camera: Index | None = None
    matrix: Annotated[tuple[Finite, ...], Field(min_length=16, max_length=16)] | None = None
    translation: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    rotation: tuple[Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[Finite, Finite, Finite] = (1.0, 1.0, 1.0)
    extensions: NodeExtensions = NodeExtensions()


class Primitive(Entry):
    """A part of a mesh; its numbers are read by `jaxvision.files.gltf`."""

    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: Any = 4
    extras: Any = None


class Mesh(Named):
    """An object of `meshes`."""

    primitives: tuple[Primitive, ...]


class Placed(Entry):
    """KHR_texture_transform: scale, then offset of texture coordinates. Programs differ in the
    sense of a rotation."""

    offset: tuple[Finite, Finite] = (0.0, 0.0)
    rotation: Annotated[float, Field(ge=0, le=0)] = 0.0
    scale: tuple[Finite, Finite] = (1.0, 1.0)
    texCoord: Literal[0] = 0


class TextureExtensions(Entry):
    """Extensions at the use of a texture."""

    KHR_texture_transform: Placed = Placed()


class Used(Entry):
    """The use of a texture."""

    index: Index
    texCoord: Literal[0] = 0
    extensions: TextureExtensions = TextureExtensions()
    extras: Any = None


class UsedNormals(Used):
    """The use of a normal map; `scale` multiplies x and y."""

    scale: Finite = 1.0


class Texture(Named):
    """An object of `textures`."""

    source: Index
    sampler: Index | None = None


class Sampler(Named):
    """An object of `samplers`, by the numbers of OpenGL."""

    magFilter: Any = None
    minFilter: Any = None
    wrapS: Literal[10497, 33071, 33648] = 10497
    wrapT: Literal[10497, 33071, 33648] = 10497


class Roughness(Entry):
    """`pbrMetallicRoughness`; roughness is the root of alpha."""

    baseColorFactor: tuple[Share, Share, Share, Share] = (1.0, 1.0, 1.0, 1.0)
    baseColorTexture: Used | None = None
    metallicRoughnessTexture: Used | None = None
    metallicFactor: Share = 1.0
    roughnessFactor: Share = 1.0
    extras: Any = None


class Strength(Entry):
    """KHR_materials_emissive_strength: a factor."""

    emissiveStrength: NonNegative = 1.0


class Ior(Entry):
    """KHR_materials_ior: the refractive index of a dielectric."""

    ior: Annotated[float, Field(strict=True, ge=1)] = 1.5


class Coat(Entry):
    """KHR_materials_specular: 0 for a surface without a coat."""

    specularFactor: Share = 1.0


class Transmission(Entry):
    """KHR_materials_transmission: 1 for glass."""

    transmissionFactor: Share = 0.0


class Volume(Entry):
    """KHR_materials_volume: the transmittance of white light over a distance, m."""

    thicknessFactor: NonNegative = 0.0
    attenuationDistance: Positive | None = None
    attenuationColor: Colour = (1.0, 1.0, 1.0)


class MaterialExtensions(Entry):
    """Extensions at a material."""

    KHR_materials_emissive_strength: Strength = Strength()
    KHR_materials_ior: Ior = Ior()
    KHR_materials_specular: Coat = Coat()
    KHR_materials_transmission: Transmission = Transmission()
    KHR_materials_volume: Volume = Volume()


class Material(Named):
    """An object of `materials`."""

    pbrMetallicRoughness: Roughness = Roughness()
    normalTexture: UsedNormals | None = None
    occlusionTexture: Any = None
    emissiveFactor: Colour = (0.0, 0.0, 0.0)
    doubleSided: bool = False
    alphaMode: Literal["OPAQUE"] = "OPAQUE"
    alphaCutoff: Any = None
    extensions: MaterialExtensions = MaterialExtensions()


class Part(Named):
    """An object of `scenes`."""

    nodes: tuple[Index, ...] = ()


class Content(Entry):
    """A whole file. Buffers and images are read by `files.gltf`."""

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
    """The JSON of the file at `path` as records; `InputError` for the first unsupported key or
    value."""
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
    """The place of an error, such as `materials "red".normalTexture`."""
    place, at = "", content
    for part in loc:
        at = at[part]
        name = at.get("name") if isinstance(at, dict) else None
        if isinstance(part, int):
            place += f' "{name}"' if isinstance(name, str) else f"[{part}]"
        else:
            place += f".{part}" if place else part
    return place
