"""Read Mitsuba's XML as a tree of nodes with typed values, where `$names`, references and includes
are resolved."""

import re
import xml.etree.ElementTree as xml
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import InputError, nearest, plain_text
from ..._plain_content import DEEPEST, check_size
from ..nodes import Blackbody, Colour, Flat, Node, Table
from .transforms import check_attributes, transform_of

_PLAIN = {"float", "integer", "boolean", "string", "vector", "point", "rgb", "spectrum"}
_ATTRIBUTES = {  # besides the name
    **dict.fromkeys(("vector", "point"), ("value", "x", "y", "z")),
    "spectrum": ("value", "filename"),
}
_MAX_DEPTH = 16  # largest depth of files that include each other


def root_of(file: Path) -> Node:
    """Return the `<scene>` of a file of Mitsuba 0.5 or later, with the names of parameters that
    version 2 introduced. Raise `InputError` for a file that is not a Mitsuba scene, and for a
    missing reference."""
    root = _parse(file)
    if root.tag != "scene":
        raise InputError(f"begins with <{root.tag}>; a scene of Mitsuba begins with <scene>.")
    version = root.get("version", "3")
    try:
        old = int(version.split(".")[0]) < 2
    except ValueError:
        raise InputError(f"version = {version!r} is no version; write as in '3.0.0'.") from None
    return _Reader(file, old).node(root, "scene")


def _parse(file: Path) -> xml.Element:
    check_size(file)
    try:
        return _check_depth(xml.parse(file).getroot())
    except InputError:
        raise
    except (xml.ParseError, UnicodeError, ValueError, LookupError) as error:
        raise InputError(f"{file.name}: not an XML file ({error}); correct that line.") from error


def _check_depth(root: xml.Element) -> xml.Element:
    """Return the root of an XML tree. Refuse a tree that is too deep, or that has text outside of
    attributes, which would be ignored."""
    level, depth = [root], 0
    while level:
        for element in level:
            texts = [element.text, *(child.tail for child in element)]
            if text := " ".join(filter(None, texts)).strip():
                raise InputError(
                    f"<{element.tag}> holds the text {text[:40]!r}, which is not read; give values "
                    "as attributes."
                )
        level, depth = [child for element in level for child in element], depth + 1
        if depth > DEEPEST:
            raise InputError(f"<{root.tag}> is nested more than {DEEPEST} deep; flatten it.")
    return root


class _Reader:
    """Converts XML elements to nodes, with the definitions of earlier elements."""

    def __init__(self, file: Path, old: bool) -> None:
        self._file, self._old, self._depth = file, old, 0
        self._defaults: dict[str, str] = {}
        self._named: dict[str, Node] = {}
        self._counts: dict[str, int] = {}

    def node(self, element: xml.Element, label: str) -> Node:
        kind = self._attributes(element).get("type", "")
        made = Node(element.tag, kind, label, old=self._old)
        for child in self._flatten(element):
            given = self._attributes(child)
            match child.tag:
                case "default":
                    self._defaults.setdefault(given.get("name", ""), given.get("value", ""))
                case "alias":
                    self._name(given.get("as", ""), self._find(given.get("id", "")))
                case "ref":
                    made.parts.append((given.get("name", ""), self._find(given.get("id", ""))))
                case "transform":
                    steps = [(step.tag, self._attributes(step)) for step in child]
                    with_name = f"{label}: {given.get('name', 'transform')}"
                    self._set(made, given, transform_of(steps, with_name))
                case "spectrum" if given.get("type") == "blackbody":
                    self._set(made, given, self._blackbody(child, label, given))
                case tag if tag in _PLAIN and "type" not in given:
                    place = f"{label}: {given.get('name', '')}"
                    check_attributes(given, _ATTRIBUTES.get(tag, ("value",)), place)
                    self._set(made, given, self._value(tag, given, place))
                case tag:
                    part = self.node(child, self._label(tag, given))
                    made.parts.append((given.get("name", ""), part))
                    if "id" in given:
                        self._name(given["id"], part)
        return made

    def _set(self, node: Node, given: Mapping[str, str], value: Any) -> None:
        """Set a value of a node; `InputError` if the node already has a value of that name."""
        name = given.get("name", "")
        if name in node.values:
            raise node.wrong(f"{name!r} stands twice; leave one of them.")
        node.values[name] = value

    def _flatten(self, element: xml.Element) -> Iterator[xml.Element]:
        """Yield the child elements, with the elements of included files in place of `<include>`."""
        for child in element:
            if child.tag != "include":
                yield child
                continue
            self._depth += 1
            if self._depth > _MAX_DEPTH:
                raise InputError(
                    f"more than {_MAX_DEPTH} files are included; do they name themselves?"
                )
            name = self._attributes(child).get("filename", "")
            file = self._file.parent / name
            if not file.is_file():
                raise InputError(f"{name}: no such file to include, from the folder of the scene.")
            root = _parse(file)
            yield from self._flatten(root) if root.tag == "scene" else (root,)

    def _attributes(self, element: xml.Element) -> dict[str, str]:
        """Return attributes with `$names` filled in and names as in version 2."""
        given = {key: self._fill_defaults(value) for key, value in element.attrib.items()}
        if self._old and "name" in given:
            given["name"] = re.sub(
                r"(?<=[a-z])([A-Z]+)", lambda m: "_" + m[1].lower(), given["name"]
            )
        return given

    def _fill_defaults(self, value: str) -> str:
        def default_value(found: re.Match[str]) -> str:
            if found[1] not in self._defaults:
                raise InputError(f"${found[1]} has no <default>; add one before its first use.")
            return self._defaults[found[1]]

        return re.sub(r"\$(\w+)", default_value, value)

    def _name(self, identifier: str, node: Node) -> None:
        if identifier in self._named:
            raise InputError(f"two objects have the id {identifier!r}; give each its own.")
        self._named[identifier] = node

    def _find(self, identifier: str) -> Node:
        if identifier not in self._named:
            hint = nearest(identifier, self._named) if self._named else "define it before"
            raise InputError(f"no object has the id {identifier!r}; {hint}.")
        return self._named[identifier]

    def _label(self, tag: str, given: Mapping[str, str]) -> str:
        self._counts[tag] = self._counts.get(tag, 0) + 1
        return f'{tag} "{given["id"]}"' if "id" in given else f"{tag}[{self._counts[tag]}]"

    def _value(self, tag: str, given: Mapping[str, str], place: str) -> Any:
        text = given.get("value", "")
        match tag:
            case "string":
                return text
            case "boolean":
                if text.lower() not in ("true", "false"):
                    raise InputError(f"{place} = {text!r} is neither true nor false.")
                return text.lower() == "true"
            case "integer":
                return _integer(text, place)
            case "float":
                return _numbers(text, place, (1,))[0]
            case "rgb":
                return Colour(_numbers(text, place, (1, 3)))
            case "spectrum":
                return self._spectrum(given, place)
            case _:
                if "value" in given:
                    return np.asarray(_numbers(text, place, (3,)))
                return np.asarray(
                    [_numbers(given.get(axis, "0"), place, (1,))[0] for axis in "xyz"]
                )

    def _blackbody(self, element: xml.Element, label: str, given: Mapping[str, str]) -> Blackbody:
        body = self.node(element, f"{label}: {given.get('name', '')}")
        kelvin = body.take("temperature", float)
        if kelvin is None or kelvin <= 0:
            raise body.wrong("needs a temperature above 0 K.")
        body.must_be_read()
        return Blackbody(kelvin)

    def _spectrum(self, given: Mapping[str, str], place: str) -> Flat | Table:
        if "filename" in given:
            file = self._file.parent / given["filename"]
            try:
                lines = plain_text(file).splitlines()
            except OSError as error:
                raise InputError(f"{place}: {file.name} cannot be read ({error}).") from error
            rows = [line.split("#")[0].split() for line in lines]
            pairs = [" ".join(row) for row in rows if row]
        elif ":" in given.get("value", ""):
            pairs = [pair.replace(":", " ") for pair in given["value"].split(",") if pair.strip()]
        else:
            return Flat(_numbers(given.get("value", ""), place, (1,))[0])
        found = [_numbers(pair, place, (2,)) for pair in pairs]
        return Table(tuple((nm, value) for nm, value in found))


def _numbers(text: str, place: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    """Parse finite numbers that are separated by commas or spaces."""
    words = text.replace(",", " ").split()
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        values = ()
    if len(values) not in counts or not np.isfinite(values).all():
        wanted = " or ".join(map(str, counts))
        raise InputError(f"{place} = {text!r} must hold {wanted} finite numbers; correct it.")
    return values


def _integer(text: str, place: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise InputError(f"{place} = {text!r} must be a whole number; correct it.") from None
