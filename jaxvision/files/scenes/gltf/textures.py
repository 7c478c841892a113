"""Convert glTF's textures to maps of a scene file, with texels, coordinates and wrapping."""

from tempfile import NamedTemporaryFile
from typing import Any

import jax.numpy as jnp
import numpy as np

from ....errors import InputError
from ....point_ops import srgb_decode
from ..._plain_content import unlike
from ...gltf import Gltf, image_bytes
from ...image_settings import largest_code
from ...images import read_image
from .contents import Content, Sampler, Used

_REPEAT, _CLAMP, _MIRRORED = 10497, 33071, 33648
_NEAREST = 9728


def texels_of(
    file: Gltf, content: Content, used: Used | None, label: str, *, srgb: bool = False
) -> tuple[np.ndarray, dict[str, Any]] | None:
    """Read the texels of a texture, (rows, columns, channels) in [0, 1], no unit, with sRGB decoded
    if `srgb`, and the other keys of its map. Return None if no texture is used. Raise `InputError`
    for a texture that is not supported."""
    if used is None:
        return None
    if used.index >= len(content.textures):
        raise unlike(label, f"names no texture {used.index}")
    texture = content.textures[used.index]
    sampler = Sampler()
    if texture.sampler is not None:
        if texture.sampler >= len(content.samplers):
            raise unlike(label, f"names no sampler {texture.sampler}")
        sampler = content.samplers[texture.sampler]
    if sampler.wrapS != sampler.wrapT or sampler.magFilter == _NEAREST:
        what = "wraps u and v differently" if sampler.wrapS != sampler.wrapT else "is not filtered"
        raise InputError(f"{label}: a texture that {what} is not read; change its sampler.")
    data = image_bytes(file, texture.source)
    with NamedTemporaryFile(suffix=".png" if data[:4] == b"\x89PNG" else ".jpg") as picture:
        picture.write(data)
        picture.flush()
        codes = read_image(picture.name)
        values = np.atleast_3d(codes / largest_code(picture.name, codes))
    if values.shape[2] < 3:
        values = np.repeat(values[..., :1], 3, axis=2)
    values = values[..., :3]
    if srgb:
        values = np.asarray(srgb_decode(jnp.asarray(values, float)))
    place = used.extensions.KHR_texture_transform
    scale, offset = np.array(place.scale), np.array(place.offset)
    if sampler.wrapS == _MIRRORED:
        values = np.concatenate([values, values[:, ::-1]], axis=1)
        values = np.concatenate([values, values[::-1]])
        scale, offset = scale / 2, offset / 2
    uv = np.column_stack([np.diag(scale), offset])
    keys: dict[str, Any] = {"wrap": "clamp" if sampler.wrapS == _CLAMP else "repeat"}
    if not np.array_equal(uv, np.eye(2, 3)):
        keys["uv"] = uv.tolist()
    return values, keys


def match_sizes(
    one: tuple[np.ndarray, dict[str, Any]], other: tuple[np.ndarray, dict[str, Any]], label: str
) -> tuple[np.ndarray, np.ndarray]:
    """Repeat the texels of two textures until both have the same size."""
    if one[1] != other[1]:
        raise InputError(f"{label}: its textures are placed differently; place them alike.")
    sizes = [np.array(x.shape[:2]) for x, _ in (one, other)]
    most = np.maximum(*sizes)
    if any((most % size).any() for size in sizes):
        raise InputError(f"{label}: its textures differ in size by no whole factor; resize one.")
    first, second = (
        x.repeat(most[0] // x.shape[0], axis=0).repeat(most[1] // x.shape[1], axis=1)
        for x, _ in (one, other)
    )
    return first, second
