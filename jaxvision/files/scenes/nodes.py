"""The objects of a scene file of another program, with their values, as its reader parses them."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import InputError, nearest


@dataclass(frozen=True)
class Colour:
    """A colour in linear sRGB: three numbers, or one for all channels."""

    values: tuple[float, ...]


@dataclass(frozen=True)
class Flat:
    """A spectrum with one value at all wavelengths."""

    value: float


@dataclass(frozen=True)
class Table:
    """A spectrum as pairs of a wavelength, in nm, and a value."""

    pairs: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Named:
    """A spectrum that the other program knows by name."""

    name: str


@dataclass(frozen=True)
class Blackbody:
    """The spectrum of a black body by Planck's law, in W m^-2 sr^-1 per nm."""

    kelvin: float


def plain(value: Colour | Flat | float) -> Any:
    """Return a colour or a number as a spectrum of a scene file."""
    match value:
        case Colour(values):
            return list(values) if len(values) == 3 else values[0]
        case Flat(number):
            return number
    return value


@dataclass
class Node:
    """An object of a scene file of another program. A value that no function has read is not
    supported, which is an error."""

    tag: str  # what the object is, such as "shape" or "texture"
    kind: str  # its type, such as "sphere"
    label: str  # the name of the object in messages
    values: dict[str, Any] = field(default_factory=dict)  # parameters by name
    # nested objects, each with its own name or the name of its reference
    parts: list[tuple[str, "Node"]] = field(default_factory=list)
    old: bool = False  # whether the file is of a version before 2, which has other default values
    _taken: set[str] = field(default_factory=set)

    def wrong(self, what: str) -> InputError:
        """Return the error for this object."""
        return InputError(f"{self.label}: {what}")

    def filename(self) -> str:
        """Return the value of `filename`; `InputError` if there is none."""
        name = self.take("filename", str)
        if name is None:
            raise self.wrong("has no filename; add it.")
        return name

    def distribution(self) -> str:
        """Return the name of the facet distribution of a rough BSDF."""
        word = self.take("distribution", str, "beckmann")
        if word not in ("beckmann", "ggx"):
            raise self.wrong("distribution must be 'beckmann' or 'ggx'.")
        return word

    def take(self, name: str, kinds: type | tuple[type, ...], otherwise: Any = None) -> Any:
        """Return the value with that name; `InputError` if it has another type."""
        self._taken.add(name)
        if any(called == name for called, _ in self.parts):
            part = next(part for called, part in self.parts if called == name)
            raise self.wrong(
                f"{name} is a {part.tag} (type {part.kind!r}), which is not read; "
                "give one colour in its place."
            )
        value = self.values.get(name, otherwise)
        kinds = kinds if isinstance(kinds, tuple) else (kinds,)
        if float in kinds and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        # a transform and a point are both arrays, of different shapes
        fits = isinstance(value, kinds) and (
            not isinstance(otherwise, np.ndarray) or np.shape(value) == otherwise.shape
        )
        if value is not otherwise and not fits:
            raise self.wrong(f"{name} is of an unexpected kind; correct it.")
        return value

    def texture(self, name: str) -> "Node | None":
        """Return the child `<texture>` with that name, or None."""
        found = [part for called, part in self.parts if called == name and part.tag == "texture"]
        self._taken |= {name} if found else set()
        return found[0] if found else None

    def children(self, tag: str) -> list["Node"]:
        """Return the child objects with a tag."""
        return [part for _, part in self.parts if part.tag == tag]

    def only_child(self, tag: str) -> "Node | None":
        """Return the child object with a tag, or None; `InputError` if there are several."""
        found = self.children(tag)
        if len(found) > 1:
            raise self.wrong(f"has {len(found)} of <{tag}>; leave one.")
        return found[0] if found else None

    def must_be(self, *known: str) -> str:
        """Return the type of the object. Raise `InputError` for a type that is not supported."""
        if self.kind not in known:
            words = ", ".join(known)
            raise self.wrong(f"type {self.kind!r} is not read; types that are: {words}.")
        return self.kind

    def must_be_read(self, *, tags: tuple[str, ...] = (), without: tuple[str, ...] = ()) -> None:
        """Raise `InputError` for the first value or child object that no function has read. Objects
        with a tag in `tags` count as read, and so do values with a name in `without`, which have no
        effect in this library.
        """
        for name in self.values:
            if name not in self._taken and name not in without:
                hint = nearest(name, self._taken) if self._taken else "remove it"
                raise InputError(
                    f"{self.label} (type {self.kind!r}): {name!r} is not read; {hint}, or remove "
                    "it if the picture may do without."
                )
        for name, part in self.parts:
            if part.tag not in tags and not (part.tag == "texture" and name in self._taken):
                raise self.wrong(
                    f"holds <{part.tag} type={part.kind!r}>, which is not read; "
                    "remove it if the picture may do without."
                )
