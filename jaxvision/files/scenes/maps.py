"""Make the maps of a scene file. A map takes the place of a constant number or spectrum of a
material. The texels of a map are in a picture file or in the scene file itself.

    albedo = { map = "wood.png" }
    roughness = { map = "worn.png", channel = 1, scale = 0.5, uv = [[4, 0, 0], [0, 4, 0]] }
    specular = { texels = [[0.1, 0.3], [0.3, 0.1]], wrap = "clamp" }

The codes of an integer picture are decoded from sRGB if the map replaces a spectrum. Otherwise the
texels are the codes divided by the largest code, without decoding. Floating-point pictures are
linear.
"""

from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core._types import NOT_NEGATIVE
from ...core._warnings import warn
from ...errors import InputError
from ...point_ops import srgb_decode
from ...scene import Map, Quad, Shape, TriangleMesh
from ..image_settings import largest_code
from ..images import read_image
from .bands import Bands
from .folder import Folder

INWARD = 0.05  # share of normals that point into the surface
STEEPEST = 0.1  # smallest z of a normal whose slope is used
CELLS = 50  # smallest number of cells of 2 x 2 texels
REVERSED = 4.0  # ratio of the curl to the curl with a reversed y axis
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB


def make_map(
    stands_for: Literal["spectrum", "number", "normal"],
    bands: Bands,
    folder: Folder,
    *,
    map: str | None = None,
    texels: Any = None,
    encoding: Literal["srgb", "linear"] | None = None,
    channel: Annotated[int, NOT_NEGATIVE] | None = None,
    scale: float = 1.0,
    uv: Float[np.ndarray, "2 affine"] | None = None,
    wrap: Literal["repeat", "clamp"] = "repeat",
) -> Map:
    """Make a map from the keys of its table in a scene file, in the unit of the number that the map
    replaces. A picture of normals holds (n + 1) / 2 for each component n, or n itself if it has
    numbers below 0. A map from a picture may have the key `encoding`, and the key `channel`, which
    is the index of one channel, from 0. By default, a map of a spectrum uses all channels of the
    picture except alpha, and a map of one number uses their luminance. Raise `InputError` if the
    number of channels does not fit the spectrum.

    Args:
        map: path of a picture, relative to the scene file.
        texels: rows of numbers, or rows of lists with one number for each channel, in place of a
            picture.
        encoding: of the codes of a picture; by default "srgb" for an integer picture of a spectrum,
            and "linear" otherwise.
        channel: index of the only channel that is used, from 0.
        scale: factor on the texels, no unit.
        uv: two rows of three numbers, which map the shape's (u, v, 1) to the map's (u, v), or of
            four, which map (x, y, z, 1) of a point in the world, m; by default the shape's own
            coordinates.
        wrap: continuation beyond the map: "repeat" tiles it, "clamp" extends its border.
    """
    if (map is None) == (texels is None):
        raise InputError("give either map, the name of a picture, or texels.")
    if map is not None:
        picture = folder.file(map)
        values = read_image(picture)
        if np.issubdtype(values.dtype, np.integer):
            values = values / largest_code(picture, values)
            if (encoding or ("srgb" if stands_for == "spectrum" else "linear")) == "srgb":
                values = np.asarray(srgb_decode(jnp.asarray(values, float)))
    else:
        values = np.asarray(texels, float)
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] <= (channel or 0):
        raise InputError(f"a map has rows, columns and channels, got shape {values.shape}.")
    values = values[..., [channel]] if channel is not None else values
    if values.shape[2] in (2, 4):  # the last channel is the coverage
        values = values[..., :-1]
    count = {"spectrum": bands.count, "number": 1, "normal": 3}[stands_for]
    if stands_for == "number" and values.shape[2] == 3:
        values = values @ _LUMINANCE[:, None]
    is_rgb = values.shape[2] == 3 and bands.wavelengths is not None and stands_for == "spectrum"
    neutral = () if stands_for == "normal" else (1,)
    if values.shape[2] not in (*neutral, count) or is_rgb:
        kind = "RGB" if values.shape[2] == 3 else f"{values.shape[2]} channels"
        raise InputError(
            f"a map holds {kind} where {count} bands of their own are wanted; render the scene in "
            "RGB, or give texels with those bands."
        )
    if stands_for == "normal" and map is not None and values.min() >= 0:
        values = 2 * values - 1  # else a floating picture holds the components themselves
    values = np.broadcast_to(values * scale, (*values.shape[:2], count))
    return Map(values[..., 0] if stands_for == "number" else values, uv, wrap=wrap)


def name_doubtful_normals(where: str, shape: Shape, normals: Map) -> None:
    """Warn about a map if many of its normals point into the surface, or if its slopes are free of
    curl only with a reversed y axis.

    The slopes of a relief have no curl.
    """
    values = np.asarray(normals.values, float)
    if (inward := float(np.mean(values[..., 2] <= 0))) > INWARD:
        warn(
            f"{where}: {inward:.0%} of the normals of its map point into the surface (z up to 0), "
            "as in a map of heights, of normals in other axes, or with another order of channels."
        )
        return
    uv = np.eye(2, 3) if normals.uv is None else np.asarray(normals.uv)
    if not isinstance(shape, Quad | TriangleMesh) or uv.shape == (2, 4):
        return
    turned = uv[:, :2]
    if turned[0, 1] or turned[1, 0] or (isinstance(shape, TriangleMesh) and turned[1, 1] < 0):
        return
    right, down = np.sign(turned[0, 0]), np.sign(turned[1, 1])
    if isinstance(shape, TriangleMesh):
        down = -1  # y is up in the picture
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = -values[..., :2] / np.maximum(values[..., 2:], STEEPEST) * [right, down]
    cells = [slopes[:-1, :-1], slopes[:-1, 1:], slopes[1:, :-1], slopes[1:, 1:]]
    if cells[0].shape[0] * cells[0].shape[1] < CELLS:
        return
    first = (cells[2] + cells[3] - cells[0] - cells[1])[..., 0]  # of the slope to the right, down
    second = (cells[1] + cells[3] - cells[0] - cells[2])[..., 1]
    curl, reversed_curl = float(np.sum((first - second) ** 2)), float(np.sum((first + second) ** 2))
    if curl > REVERSED * reversed_curl > 0:
        warn(
            f"{where}: the normals of its map belong to a relief only if their y axis is reversed: "
            "bumps become hollows from above or below. Files of DirectX have y down in the "
            "picture; those of OpenGL and glTF have it up, as a mesh needs it. On a quad y points "
            "along its second edge, so that uv = [[1, 0, 0], [0, -1, 1]] puts a picture upright. "
            "Reverse the green channel, or the picture."
        )
