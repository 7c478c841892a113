"""Convert pbrt's spectra and textures to spectra and maps of a scene file, for rendering in RGB."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ....colour_spaces import colour_data, rgb_to_xyz
from ....errors import InputError
from ....spectra import blackbody
from ..bands import Bands, reduction
from ..nodes import Blackbody, Colour, Named, Node, Table, plain

_ILLUMINANTS = {"A": "A", "D50": "D50", "D65": "D65"} | {f"F{i}": f"FL{i}" for i in range(1, 13)}
_GRID = np.arange(360, 831) * 1e-9  # m


def light_of(node: Node, name: str) -> np.ndarray:
    """Return the colour, (3,), of a light, which is white by default. As in pbrt, a spectrum is
    divided by its luminance, and only `rgb` has a level of its own."""
    match node.take(name, (Colour, Table, Blackbody, Named), Colour((1.0, 1.0, 1.0))):
        case Colour(values):
            return np.array(values)
        case Table() as table:
            nm, values = pairs_of(node, name, table)
            grid = nm * 1e-9
        case Blackbody(kelvin):
            grid, values = (
                _GRID,
                np.asarray(blackbody(jnp.asarray(_GRID), jnp.asarray(kelvin)), float),
            )
        case named:
            word = named.name
            illuminant = _ILLUMINANTS.get(word.removeprefix("stdillum-"))
            if illuminant is None or not word.startswith("stdillum-"):
                raise node.wrong(
                    f"{name}: the spectrum {word[:40]!r} is not known; give its pairs."
                )
            grid = np.arange(380, 781) * 1e-9
            values = np.asarray(colour_data.illuminant(illuminant, jnp.asarray(grid)), float)
    rgb = values @ reduction(grid, Bands(3), quantity="light")
    luminance = float(rgb_to_xyz(jnp.asarray(rgb))[1])
    if not luminance > 0:
        raise node.wrong(f"{name} has no light that is seen; correct it.")
    return np.maximum(rgb / luminance, 0)


def pairs_of(node: Node, name: str, table: Table) -> np.ndarray:
    """Return the wavelengths, nm, and the values of a table, (2, pairs)."""
    nm, values = np.array(table.pairs).T
    if len(nm) < 2 or not nm[0] > 0 or (np.diff(nm) <= 0).any() or (values < 0).any():
        raise node.wrong(f"{name} takes ascending wavelengths and no value below 0.")
    return np.stack([nm, values])


def numbers_of(node: Node, name: str, otherwise: float) -> Any:
    """Return a parameter of a material, as in a scene file: a number, a colour, a spectrum or a
    map.
    """
    texture = node.texture(name)
    if texture is None:
        return plain(_table(node.take(name, (Colour, Table, float), otherwise)))
    found = texture.values["found"]
    if isinstance(found, InputError):
        raise found
    return dict(found) if isinstance(found, dict) else found


def texture_of(node: Node) -> Node:
    """Return a texture as a node with one value, `found`: the number, colour, spectrum or map for a
    scene file, or the error for a texture that is not supported.
    """
    found: Any
    try:
        match node.must_be("constant", "scale", "mix", "imagemap"):
            case "constant":
                found = numbers_of(node, "value", 1.0)
            case "scale":
                found = _product(node, *(numbers_of(node, key, 1.0) for key in ("tex", "scale")))
            case "mix":
                both = numbers_of(node, "tex1", 0.0), numbers_of(node, "tex2", 1.0)
                found = mixed(node, *both, node.take("amount", float, 0.5))
            case _:
                found = map_of(node)
        node.must_be_read()
    except InputError as error:
        found = error
    return Node("texture", node.kind, node.label, {"found": found})


def _table(value: Any) -> Any:
    return {"pairs": [list(pair) for pair in value.pairs]} if isinstance(value, Table) else value


def _product(node: Node, first: Any, second: Any) -> Any:
    if isinstance(first, dict):
        first, second = second, first
    if not isinstance(second, dict):
        return (np.asarray(first) * np.asarray(second)).tolist()
    if not isinstance(first, float):
        raise node.wrong("multiplies a picture or a table by more than a number; draw it so.")
    return second | {"scale": second.get("scale", 1.0) * first}


def mixed(node: Node, first: Any, second: Any, share: float) -> Any:
    """Return the weighted mean of two numbers or colours; `share` is the weight of the second."""
    if isinstance(first, dict) or isinstance(second, dict):
        raise node.wrong("mixes pictures or tables, which are not read; give numbers or rgb.")
    return ((1 - share) * np.asarray(first) + share * np.asarray(second)).tolist()


def map_of(texture: Node) -> dict[str, Any]:
    """Return the table of the map of an `imagemap`. In the table v counts from the top of the
    picture, in pbrt from the bottom."""
    encoding = texture.take("encoding", str, "sRGB")
    wrap = texture.take("wrap", str, "repeat")
    if encoding not in ("sRGB", "linear") or wrap not in ("repeat", "clamp"):
        raise texture.wrong(
            "is read with encoding sRGB or linear, wrap repeat or clamp; change it."
        )
    if texture.take("mapping", str, "uv") != "uv" or texture.take("invert", bool, False):
        raise texture.wrong("is read with the mapping uv and without invert; change it.")
    if texture.take("filter", str, "bilinear") == "point":
        raise texture.wrong("filter 'point' is not read; take bilinear.")
    made: dict[str, Any] = {"map": texture.filename(), "wrap": wrap}
    made["encoding"] = "linear" if encoding == "linear" else "srgb"
    (su, du), (sv, dv) = (
        (texture.take(f"{axis}scale", float, 1.0), texture.take(f"{axis}delta", float, 0.0))
        for axis in "uv"
    )
    if (su, du, sv, dv) != (1, 0, 1, 0):
        made["uv"] = [[su, 0.0, du], [0.0, sv, 1 - sv - dv]]
    if (scale := texture.take("scale", float, 1.0)) != 1:
        made["scale"] = scale
    texture.take("maxanisotropy", float, 8.0)
    return made
