"""Convert pbrt's lights to the tables `[[light]]` of a scene file.

`scale` multiplies the colour of a light. Given its `power` (lm) or `illuminance` (lux), a light
whose spectrum is not `rgb` has this amount of light, in cd, lux or cd m^-2.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ....core._warnings import warn
from ...images import read_sky
from ..folder import Folder
from ..nodes import Node
from ..placement import Affine, keeps_shape, placed
from .spectra import light_of

_SAMPLES = (np.arange(3) + 0.5) / 3  # within a pixel of the sky, along each axis


def light_entry(node: Node, to_world: Affine, folder: Folder) -> dict[str, Any]:
    """Return `kind` and the other keys of a light source, with lengths in m. Raise `InputError` for
    a light without a counterpart."""
    kind = node.must_be("point", "distant", "spot", "infinite")
    start, end = node.take("from", np.ndarray, np.zeros(3)), np.array([0.0, 0.0, 1.0])
    if kind in ("distant", "spot"):
        end = node.take("to", np.ndarray, end)
    toward = to_world[:3, :3] @ (end - start)
    if not toward.any():
        raise node.wrong("from and to are one point; move one of them.")
    colour = light_of(node, "L" if kind in ("distant", "infinite") else "I")
    amount = (colour * _scale(node)).tolist()
    match kind:
        case "point":
            made = {"position": placed(to_world, start), "intensity": amount}
        case "distant":
            made = {"kind": "directional", "direction": (-toward).tolist(), "irradiance": amount}
        case "spot":
            outer = node.take("coneangle", float, 30.0)
            if not keeps_shape(to_world):
                raise node.wrong("is stretched; remove the scaling.")
            made = {"position": placed(to_world, start), "direction": toward.tolist()}
            made |= {"intensity": amount, "falloff": "smoothstep", "outer": outer}
            made["inner"] = outer - node.take("conedeltaangle", float, 5.0)
        case _:
            made = {"kind": "environment", "radiance": amount}
            if (name := node.take("filename", str)) is not None:
                if "L" in node.values:
                    raise node.wrong("has an L and a filename; leave one of them.")
                made = {"kind": "environment", "scale": amount[0]}
                made["file"] = _sky(node, folder.file(name), to_world)
    node.must_be_read()
    return {"name": node.label, "kind": kind, **made}


def _scale(node: Node) -> float:
    """Return the factor on the colour of a light, with its power or illuminance."""
    scale = node.take("scale", float, 1.0)
    if node.kind in ("point", "spot") and (power := node.take("power", float, -1.0)) > 0:
        outer = node.take("coneangle", float, 30.0)
        inner = outer - node.take("conedeltaangle", float, 5.0)
        cosines = np.cos(np.radians([inner, outer])) if node.kind == "spot" else -1.0
        scale *= power / (2 * np.pi * (1 - np.mean(cosines)))
    elif node.kind in ("distant", "infinite") and "illuminance" in node.values:
        if "filename" in node.values:
            raise node.wrong("the illuminance of a picture is not read; give its scale.")
        lux = node.take("illuminance", float)
        scale *= (lux if node.kind == "distant" else lux / np.pi) if lux > 0 else 1
    if scale < 0:
        raise node.wrong("scale must be at least 0; correct it.")
    return float(scale)


def _sky(node: Node, file: Path, to_world: Affine) -> np.ndarray:
    """Return a latitude-longitude picture about the world's z axis of a square picture of the
    sphere. Each pixel is the mean of the nearest pixels at nine points. The square shows the
    hemisphere z > 0 of the light within the diagonals between the middles of its sides. Equal areas
    of the square are equal solid angles. Source: Clarberg, "Fast Equal-Area Mapping of the
    (Hemi)Sphere using SIMD", Journal of Graphics Tools 13(3) (2008)."""
    square = read_sky(file)
    if square.shape[0] != square.shape[1]:
        raise node.wrong(f"{file.name} is not square, as pbrt's pictures of the sky are.")
    warn(f"{node.label}: its picture is resampled to latitudes and longitudes, which blurs pixels.")
    size = len(square)
    found = np.zeros((size, 2 * size, square.shape[2]))
    edges = np.cos(np.pi * np.arange(size + 1) / size)[:, None]
    inverse = np.linalg.inv(to_world[:3, :3])
    for down in _SAMPLES:
        for along in _SAMPLES:
            z = edges[:-1] + down * (edges[1:] - edges[:-1])
            phi = np.pi * (1 - (np.arange(2 * size) + along) / size)
            sine = np.sqrt(1 - z * z)
            w = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), z), axis=-1)
            w = w @ inverse.T
            p = _on_square(w / np.linalg.norm(w, axis=-1, keepdims=True))
            column, row = np.moveaxis(np.clip((p * size).astype(int), 0, size - 1), -1, 0)
            found += square[row, column]
    return found / len(_SAMPLES) ** 2


def _on_square(w: np.ndarray) -> np.ndarray:
    """Return the place on the square, (..., 2) in [0, 1], of unit directions, (..., 3)."""
    r = np.sqrt(np.maximum(1 - np.abs(w[..., 2]), 0))
    v = r * np.arctan2(np.abs(w[..., 1]), np.abs(w[..., 0])) * 2 / np.pi
    u = r - v
    u, v = (np.where(w[..., 2] < 0, outer, inner) for outer, inner in ((1 - v, u), (1 - u, v)))
    return (np.stack([np.copysign(u, w[..., 0]), np.copysign(v, w[..., 1])], axis=-1) + 1) / 2
