"""Convert Mitsuba's sensor and film to the table `[camera]`."""

from typing import Any

import numpy as np

from ....core._warnings import warn
from ....errors import InputError
from ..nodes import Node
from ..placement import pose, thin_lens

SENSORS = ("perspective", "thinlens", "orthographic")
_DIAGONAL = float(np.hypot(36, 24))  # mm, of the film to which `focal_length` refers
_CLIPS = {"near_clip": 1e-2, "far_clip": 1e4}  # m, Mitsuba's defaults
_UNUSED = (*_CLIPS, "shutter_open", "shutter_close")


def camera_of(node: Node) -> tuple[dict[str, Any], int]:
    """Return the keys of a `<sensor>` for `[camera]`, including `kind`, in m and degrees, and the
    samples per pixel. Raise `InputError` for a camera without a counterpart."""
    kind = node.must_be(*SENSORS)
    rows, columns = _resolution(node.only_child("film"), node.label)
    to_world = node.take("to_world", np.ndarray, np.eye(4))
    made, unit = pose(node, to_world, orthographic=kind == "orthographic")
    made["resolution"] = [rows, columns]
    if kind == "orthographic":
        made |= {"kind": "orthographic", "width": 2 * unit}
    else:
        half_width = _half_width(node, rows / columns)
        degrees = float(2 * np.degrees(np.arctan(half_width)))
        made |= {"kind": "pinhole", "field_of_view": degrees}
        if kind == "thinlens":
            del made["field_of_view"]
            made |= _lens(node, half_width, columns)
    sampler, count = node.only_child("sampler"), 4
    if sampler is not None:
        count = sampler.take("sample_count", int, count)
    for name in ("principal_point_offset_x", "principal_point_offset_y"):
        if kind != "orthographic" and node.take(name, float, 0.0):
            raise node.wrong(f"{name} is not read, only 0; centre the picture.")
    if any(name in node.values and node.values[name] != usual for name, usual in _CLIPS.items()):
        warn(
            f"{node.label}: near_clip and far_clip are not used; what lies nearer or farther is "
            "seen too."
        )
    node.must_be_read(tags=("film", "sampler"), without=_UNUSED)
    return made, count


def _resolution(film: Node | None, label: str) -> tuple[int, int]:
    rows, columns, kernel = 576, 768, None
    if film is not None:
        label = film.label
        film.must_be("hdrfilm", "ldrfilm")
        columns, rows = film.take("width", int, columns), film.take("height", int, rows)
        if min(rows, columns) < 1:
            raise InputError(f"{label}: width and height must be at least 1; correct them.")
        kernel = film.only_child("rfilter")
        formats = ("pixel_format", "component_format", "file_format", "sample_border", "banner")
        film.must_be_read(tags=("rfilter",), without=formats)
    if kernel is None or kernel.kind != "box":
        warn(
            f"{label}: pixels are means over their area; Mitsuba's "
            f"{'gaussian' if kernel is None else kernel.kind} filter blurs beyond it."
        )
    return rows, columns


def _half_width(node: Node, rows_per_column: float) -> float:
    """Return the tangent of half the field of view across the picture's width."""
    axis = node.take("fov_axis", str, "x")
    focal_length = node.take("focal_length", str)
    degrees = node.take("fov", float)
    if focal_length is not None and degrees is not None:
        raise node.wrong("has a fov and a focal_length; leave one of them.")
    if degrees is None:
        focal_length = focal_length or "50mm"
        try:
            millimetres = float(focal_length.removesuffix("mm"))
        except ValueError:
            millimetres = 0.0
        if not 0 < millimetres < np.inf:
            raise node.wrong("focal_length must be above 0, as in '50mm'.")
        tangent, axis = _DIAGONAL / 2 / millimetres, "diagonal"
    elif not 0 < degrees < 180:
        raise node.wrong("needs a fov in degrees, above 0 and below 180.")
    else:
        tangent = np.tan(np.radians(degrees) / 2)
    if axis in ("smaller", "larger"):
        axis = "x" if (rows_per_column >= 1) == (axis == "smaller") else "y"
    sides = {"x": 1.0, "y": rows_per_column, "diagonal": float(np.hypot(1, rows_per_column))}
    if axis not in sides:
        raise node.wrong("fov_axis must be x, y, diagonal, smaller or larger.")
    return float(tangent / sides[axis])


def _lens(node: Node, half_width: float, columns: int) -> dict[str, Any]:
    """Return the keys of the thin lens of a sensor."""
    radius = node.take("aperture_radius", float)
    distance = node.take("focus_distance", float)
    if radius is None or distance is None or radius <= 0 or distance <= 0:
        raise node.wrong(
            "a thin lens takes an aperture_radius and a focus_distance above 0; use "
            "perspective for a pinhole."
        )
    return thin_lens(half_width, columns, radius, distance)
