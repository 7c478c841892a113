"""Mitsuba's colours and spectra as spectra of a scene file, for rendering in RGB."""

from typing import Any

from ....errors import InputError
from .document import Blackbody, Colour, Flat, Node, Table

SPECTRUM = (Colour, Flat, Table, float)


def reflectance_of(node: Node, name: str, otherwise: float) -> Any:
    """A reflectance by its name, no unit."""
    match node.take(name, SPECTRUM, otherwise):
        case Table(pairs):
            return {"pairs": [list(pair) for pair in pairs]}
        case other:
            return _plain(other)


def light_of(node: Node, name: str, otherwise: float) -> Any:
    """Return a radiance, an intensity or an irradiance by its name. A flat spectrum has equal
    energy, which is not the white of sRGB. If nothing is given, Mitsuba uses the white of sRGB. Its
    RGB variants refuse black bodies; here they are those of its spectral variants, per nm."""
    match node.take(name, (*SPECTRUM, Blackbody), otherwise):
        case Blackbody(kelvin):
            return {"blackbody": kelvin, "scale": 1e-9}
        case Table(pairs):
            return {"pairs": [list(pair) for pair in pairs]}
        case Flat(value):
            return {"pairs": [[360.0, 1.0], [830.0, 1.0]], "scale": value}
        case other:
            return _plain(other)


def index_of(node: Node, name: str, otherwise: float) -> Any:
    """A part of a metal's index by its name, no unit."""
    value = node.take(name, SPECTRUM, otherwise)
    if isinstance(value, Table):
        raise InputError(
            f"{node.label}: {name} is a table of wavelengths, for which RGB has no definite value; "
            "give it as <rgb>."
        )
    return _plain(value)


def _plain(value: Colour | Flat | float) -> Any:
    match value:
        case Colour(values):
            return list(values) if len(values) == 3 else values[0]
        case Flat(number):
            return number
    return value
