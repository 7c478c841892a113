"""Convert pbrt's camera and film to the table `[camera]`."""

from typing import Any

import numpy as np

from ....core._warnings import warn
from ..nodes import Node
from ..placement import Affine, pose, thin_lens


def camera_of(camera: Node, film: Node, to_world: Affine) -> dict[str, Any]:
    """Return the keys of a camera, in m and degrees. `to_world` is the map from the camera's axes,
    x right, y up and z forward. Raise `InputError` for a camera without a counterpart."""
    kind = camera.must_be("perspective", "orthographic")
    columns, rows, crop = _film(film)
    aspect = camera.take("frameaspectratio", float, columns / rows)
    usual = np.array([-1, 1, -1, 1]) * np.repeat([max(aspect, 1), max(1 / aspect, 1)], 2)
    left, right, bottom, top = camera.take("screenwindow", np.ndarray, usual)
    if not (left < right and bottom < top):
        raise camera.wrong("screenwindow must be ascending in x and in y; correct it.")
    per_x, per_y = columns / (right - left), rows / (top - bottom)  # pixels
    is_square = abs(per_x / per_y - 1) < 1e-6
    # the point of the screen's origin, in pixels from the corner of the picture
    x0, x1, y0, y1 = crop
    origin = np.array([-left * per_x - x0, top * per_y - y0])
    shift = (np.array([x1 - x0, y1 - y0]) / 2 - origin) / [per_x, -per_y]
    is_central = np.abs(shift).max() < 1e-6 * (right - left)
    made, unit = pose(
        camera, to_world @ np.diag([-1.0, 1, 1, 1]), orthographic=kind == "orthographic"
    )
    made["resolution"] = [y1 - y0, x1 - x0]
    radius = camera.take("lensradius", float, 0.0) * unit
    distance = camera.take("focaldistance", float, 1e6) * unit
    if kind == "orthographic":
        if radius or not is_square:
            raise camera.wrong("a lens or pixels that are not square are not read; change it.")
        moved = to_world[:3, :2] @ shift
        made |= {name: (np.array(made[name]) + moved).tolist() for name in ("position", "target")}
        made |= {"kind": "orthographic", "width": float((x1 - x0) / per_x * unit)}
    else:
        degrees = camera.take("fov", float, 90.0)
        if not 0 < degrees < 180:
            raise camera.wrong("needs a fov in degrees, above 0 and below 180.")
        tangent = np.tan(np.radians(degrees) / 2)
        half_width = float(tangent * (x1 - x0) / per_x / 2)
        if radius:
            if not (is_square and is_central) or distance <= 0:
                raise camera.wrong("a lens is read with square pixels about its axis alone.")
            made |= thin_lens(half_width, x1 - x0, radius, distance)
        elif is_square and is_central:
            made |= {
                "kind": "pinhole",
                "field_of_view": float(2 * np.degrees(np.arctan(half_width))),
            }
        else:
            (cx, cy), fx, fy = origin - 0.5, per_x / tangent, per_y / tangent
            matrix = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
            made |= {"kind": "pinhole", "matrix": np.array(matrix, float).tolist()}
    _warn_of_exposure(camera, film)
    camera.must_be_read()
    return made


def _film(film: Node) -> tuple[int, int, list[int]]:
    """Return the size of the whole picture, and the first and last column and row of its crop."""
    film.must_be("rgb", "gbuffer")
    size = film.take("xresolution", int, 1280), film.take("yresolution", int, 720)
    if min(size) < 1:
        raise film.wrong("xresolution and yresolution must be at least 1; correct them.")
    ends = np.repeat(size, 2)
    window = film.take("cropwindow", np.ndarray, np.array([0.0, 1.0, 0.0, 1.0]))
    bounds = np.ceil(np.clip(window, 0, 1) * ends).astype(int)
    if "pixelbounds" in film.values:
        if "cropwindow" in film.values:
            raise film.wrong("has pixelbounds and a cropwindow; leave one of them.")
        bounds = np.clip(film.take("pixelbounds", np.ndarray, bounds), 0, ends)
    x0, x1, y0, y1 = bounds.tolist()
    if x0 >= x1 or y0 >= y1:
        raise film.wrong("its crop holds no pixel; correct it.")
    return *size, [x0, x1, y0, y1]


def _warn_of_exposure(camera: Node, film: Node) -> None:
    """Name the parameters by which pbrt changes its picture after the light has arrived."""
    opened = camera.take("shutterclose", float, 1.0) - camera.take("shutteropen", float, 0.0)
    factor = opened * film.take("iso", float, 100.0) / 100
    if factor != 1:
        warn(
            f"{film.label}: pictures hold radiance, where pbrt multiplies it by {factor:.4g} for "
            "the shutter and iso."
        )
    changes = {"sensor": "cie1931", "whitebalance": 0.0, "maxcomponentvalue": np.inf}
    for name, usual in changes.items():
        if film.take(name, type(usual), usual) != usual:
            warn(f"{film.label}: {name} is not used; pictures hold radiance.")
    film.must_be_read(without=("filename", "diagonal", "savefp16", "coordinatesystem"))
