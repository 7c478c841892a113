"""Convert Mitsuba's colours and spectra to spectra of a scene file, for rendering in RGB."""

from typing import Any

import numpy as np

from ..nodes import Blackbody, Colour, Flat, Node, Table, plain

SPECTRUM = (Colour, Flat, Table, float)


def map_of(node: Node, name: str) -> dict[str, Any] | None:
    """Return the table of a map for the bitmap `<texture>` with that name, or None if there is
    none. As in Mitsuba, texels are encoded in sRGB unless the texture is `raw`."""
    texture = node.texture(name)
    if texture is None:
        return None
    if texture.kind != "bitmap":
        raise node.wrong(
            f"{name} is a texture (type {texture.kind!r}), of which only bitmap is "
            "read; give a picture, or one colour."
        )
    file, wrap = texture.take("filename", str), texture.take("wrap_mode", str, "repeat")
    if file is None or wrap not in ("repeat", "clamp"):
        wanted = "a filename" if file is None else "wrap_mode 'repeat' or 'clamp'"
        raise texture.wrong(f"needs {wanted}; correct it.")
    if texture.take("filter_type", str, "bilinear") != "bilinear":
        raise texture.wrong("filter_type is not read, only 'bilinear'; change it.")
    raw = texture.take("raw", bool, False)
    made = {"map": file, "wrap": wrap, "encoding": "linear" if raw else "srgb"}
    to_uv = texture.take("to_uv", np.ndarray, np.eye(4))
    if not np.array_equal(to_uv, np.eye(4)):
        made["uv"] = to_uv[:2][:, [0, 1, 3]].tolist()
    texture.must_be_read(without=("accel", "format"))
    return made


def reflectance_of(node: Node, name: str, otherwise: float) -> Any:
    """Return the reflectance with that name, no unit."""
    if (found := map_of(node, name)) is not None:
        return found
    match node.take(name, SPECTRUM, otherwise):
        case Table(pairs):
            return {"pairs": [list(pair) for pair in pairs]}
        case other:
            return plain(other)


def light_of(node: Node, name: str, otherwise: float) -> Any:
    """Return the radiance, intensity or irradiance with that name. If the file states no such
    value, the result is the white of sRGB. A spectrum with one value has that value at all
    wavelengths. The values of a black body are per nm, as in Mitsuba's spectral variants."""
    match node.take(name, (*SPECTRUM, Blackbody), otherwise):
        case Blackbody(kelvin):
            return {"blackbody": kelvin, "scale": 1e-9}
        case Table(pairs):
            return {"pairs": [list(pair) for pair in pairs]}
        case Flat(value):
            return {"pairs": [[360.0, 1.0], [830.0, 1.0]], "scale": value}
        case other:
            return plain(other)


def index_of(node: Node, name: str, otherwise: float) -> Any:
    """Return a part, by its name, of a metal's complex refractive index."""
    value = node.take(name, SPECTRUM, otherwise)
    if isinstance(value, Table):
        raise node.wrong(
            f"{name} is a table of wavelengths, for which RGB has no definite value; "
            "give it as <rgb>."
        )
    return plain(value)
