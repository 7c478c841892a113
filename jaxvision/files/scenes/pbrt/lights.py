"""Convert pbrt's lights to the tables `[[light]]` of a scene file.

`scale` multiplies the colour of a light. If a light states its `power` (lm) or `illuminance` (lux),
its spectrum is scaled to this amount, and its values are in cd, lux or cd m^-2.
"""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ....core._warnings import warn
from ....spectra import LUMINOUS_EFFICACY
from ...images import read_sky
from ...luminaires import small_luminaire
from ..folder import Folder
from ..nodes import Node
from ..placement import Affine, keeps_shape, placed
from .spectra import light_of

_SAMPLES = (np.arange(3) - 1) * 2 / 3  # in half pixels from the middle, along each axis
_WITH_POWER = ("point", "spot", "goniometric")
_WITH_FROM = ("point", "spot", "distant")


def light_entry(node: Node, to_world: Affine, folder: Folder) -> dict[str, Any]:
    """Return `kind` and the other keys of a light source, with lengths in m. Raise `InputError` for
    a light without a counterpart."""
    kind = node.must_be("point", "distant", "spot", "infinite", "goniometric")
    name = node.take("filename", str) if kind in ("infinite", "goniometric") else None
    if name is not None and "L" in node.values:
        raise node.wrong("has an L and a filename; leave one of them.")
    square = None if name is None else _square(node, folder.file(name))
    colour = light_of(node, "L" if kind in ("distant", "infinite") else "I")
    start = node.take("from", np.ndarray, np.zeros(3)) if kind in _WITH_FROM else np.zeros(3)
    end = np.array([0.0, 0.0, 1.0])
    if kind in ("distant", "spot"):
        end = node.take("to", np.ndarray, end)
        if not np.any(end - start):
            raise node.wrong("from and to are one point; move one of them.")
    toward = (to_world[:3, :3] @ (end - start)).tolist()
    amount, inner, outer = colour * _scale(node), 0.0, 0.0
    if kind == "spot":
        if not keeps_shape(to_world):
            raise node.wrong("is stretched; remove the scaling.")
        inner, outer = _cone(node)
    if (power := node.take("power", float, -1.0) if kind in _WITH_POWER else -1.0) > 0:
        mean = 1.0 if square is None else float(square.mean())
        cosines = np.cos(np.radians([inner, outer])) if kind == "spot" else -1.0
        amount = amount * power / (2 * np.pi * (1 - np.mean(cosines)) * mean)
    given = amount.tolist()
    match kind:
        case "point":
            made = {"kind": "point", "position": placed(to_world, start), "intensity": given}
        case "distant":
            direction = [-x for x in toward]
            made = {"kind": "directional", "direction": direction, "irradiance": given}
        case "spot":
            made = {"kind": "spot", "position": placed(to_world, start), "direction": toward}
            made |= {"intensity": given, "falloff": "smoothstep", "inner": inner, "outer": outer}
        case "infinite" if square is None:
            made = {"kind": "environment", "radiance": given}
        case _ if square is None:
            raise node.wrong("has no filename; add it.")
        case "infinite":
            made = {"kind": "environment", "file": _sky(square, to_world), "scale": given[0]}
        case _:
            lamp = _luminaire(square.mean(axis=2), to_world)
            made = {"kind": "goniometric", "file": lamp, "colour": given}
            made["position"] = placed(to_world, np.zeros(3))
    node.must_be_read()
    return {"name": node.label, **made}


def _cone(node: Node) -> tuple[float, float]:
    """Return the half angles of a spot, degrees."""
    outer = node.take("coneangle", float, 30.0)
    return outer - node.take("conedeltaangle", float, 5.0), outer


def _scale(node: Node) -> float:
    """Return the factor on the colour of a light: its scale times its illuminance, if given."""
    scale = node.take("scale", float, 1.0)
    if scale < 0:
        raise node.wrong("scale must be at least 0; correct it.")
    if node.kind not in ("distant", "infinite") or "illuminance" not in node.values:
        return scale
    if "filename" in node.values:
        raise node.wrong("the illuminance of a picture is not read; give its scale.")
    lux = node.take("illuminance", float)
    return scale * (lux if node.kind == "distant" else lux / np.pi) if lux > 0 else scale


def _square(node: Node, file: Path) -> np.ndarray:
    """Read a square picture of the sphere, (n, n, bands)."""
    square = read_sky(file)
    if square.shape[0] != square.shape[1]:
        raise node.wrong(f"{file.name} is not square, as pbrt's pictures of the sphere are.")
    warn(f"{node.label}: its picture is resampled to angles, which blurs its pixels.")
    return square


def _sky(square: np.ndarray, to_world: Affine) -> np.ndarray:
    """Return a latitude-longitude picture about the world's z axis. Each pixel is the mean of the
    nearest pixels of the square at nine points."""
    size = len(square)
    edges = np.cos(np.pi * np.arange(size + 1) / size)[:, None]
    found = np.zeros((size, 2 * size, square.shape[2]))
    for down, along in product((_SAMPLES + 1) / 2, repeat=2):
        z = edges[:-1] + down * (edges[1:] - edges[:-1])
        phi = np.pi * (1 - (np.arange(2 * size) + along) / size)
        found += _nearest(square, z, phi, to_world[:3, :3])
    return found / len(_SAMPLES) ** 2


def _luminaire(square: np.ndarray, to_world: Affine) -> Any:
    """Return a lamp about the world's z axis.

    Its intensity at each angle is the mean of the nearest pixels of the square at nine points. The
    picture's axis is the y axis of the light.
    """
    size = len(square)
    vertical, horizontal = (np.linspace(0, k * np.pi, k * size + 1) for k in (1, 2))
    found = np.zeros((size + 1, 2 * size + 1))
    axes = to_world[:3, :3] @ np.eye(3)[[0, 2, 1]]
    for down, along in product(_SAMPLES / 2, repeat=2):
        z = -np.cos(np.clip(vertical + down * np.pi / size, 0, np.pi))[:, None]
        phi = horizontal + along * np.pi / size
        found += _nearest(square[..., None], z, phi, axes)[..., 0]
    candela = LUMINOUS_EFFICACY * found / len(_SAMPLES) ** 2
    return small_luminaire(candela, vertical, horizontal)


def _nearest(square: np.ndarray, z: np.ndarray, phi: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the pixels of a square picture of the sphere in the world's directions of height `z`
    and azimuth `phi`. Equal areas of the square are equal solid angles. The hemisphere z > 0 is
    inside the diamond that connects the midpoints of the sides. Source: Clarberg,
    "Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD", Journal of Graphics Tools 13(3)
    (2008)."""
    sine = np.sqrt(np.maximum(1 - z * z, 0))
    w = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), z), axis=-1)
    w = w @ np.linalg.inv(axes).T
    x, y, z = np.moveaxis(w / np.linalg.norm(w, axis=-1, keepdims=True), -1, 0)
    r = np.sqrt(np.maximum(1 - np.abs(z), 0))
    v = r * np.arctan2(np.abs(y), np.abs(x)) * 2 / np.pi
    u = r - v
    u, v = np.where(z < 0, 1 - v, u), np.where(z < 0, 1 - u, v)
    place = (np.stack([np.copysign(v, y), np.copysign(u, x)]) + 1) / 2
    row, column = np.clip((place * len(square)).astype(int), 0, len(square) - 1)
    return square[row, column]
