"""Mitsuba's emitters, except those of shapes, as the tables `[[light]]`."""

from typing import Any

import numpy as np

from ....errors import InputError
from .document import Node
from .spectra import light_of

EMITTERS = ("point", "directional", "spot", "constant", "envmap")


def light_entry(node: Node) -> dict[str, Any]:
    """`kind` and the other keys of an `<emitter>` of the scene, lengths in m; `InputError` for one
    without a counterpart."""
    kind = node.must_be(*EMITTERS)
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
            file = node.take("filename", str)
            if file is None:
                raise InputError(f"{node.label}: has no filename; add it.")
            made = {"kind": "environment", "file": file, "scale": node.take("scale", float, 1.0)}
            made |= {"up": to_world[:3, 1].tolist(), "toward": to_world[:3, 2].tolist()}
    node.must_be_read(without=("sampling_weight",))
    return {"name": node.label, **made}
