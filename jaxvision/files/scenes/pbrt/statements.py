"""Read the statements of a pbrt scene file, in which included files are resolved, as nodes with
typed values."""

import re
from bisect import bisect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ....errors import InputError, plain_text
from ..._plain_content import check_size
from ..folder import Folder
from ..nodes import Blackbody, Colour, Named, Node, Table

_TOKEN = re.compile(r'"((?:[^"\\\n]|\\[^\n])*)"|([\[\]])|#[^\n]*|([^\s"\[\]]+)|(")')
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_MAX_DEPTH = 16  # largest depth of files that include each other
_SIZES = {
    "point2": 2,
    "vector2": 2,
    "point": 3,
    "point3": 3,
    "vector": 3,
    "vector3": 3,
    "normal": 3,
    "normal3": 3,
    "float": 1,
    "integer": 1,
    "rgb": 3,
    "blackbody": 1,
}
_OF_LIBRARY = ("stdillum-", "metal-", "glass-")  # beginnings of the names of pbrt's own spectra


class Statement(NamedTuple):
    """A directive with its arguments, in the order of the file: a str, a float, a bool, or a list
    of these for brackets."""

    word: str
    arguments: list[Any]
    place: str

    def wrong(self, what: str) -> InputError:
        """Return the error for this statement."""
        return InputError(f"{self.place}: {self.word} {what}")

    def numbers(self, count: int) -> np.ndarray:
        """Return the arguments, with or without brackets, as `count` finite numbers."""
        flat = [x for one in self.arguments for x in (one if isinstance(one, list) else [one])]
        if len(flat) != count or not all(type(x) is float and np.isfinite(x) for x in flat):
            raise self.wrong(f"takes {count} finite numbers; correct it.")
        return np.array(flat)

    def names(self, count: int, *, alone: bool = False) -> list[str]:
        """Return the first `count` arguments as names; with `alone`, no other argument may
        follow.
        """
        found = self.arguments[:count]
        is_complete = len(found) == count and not (alone and self.arguments[count:])
        if not is_complete or not all(isinstance(name, str) for name in found):
            raise self.wrong(f"takes {count} name{'s' if count > 1 else ''} in quotes; correct it.")
        return found

    def name(self) -> str:
        """Return the only argument, a name."""
        return self.names(1, alone=True)[0]


def statements_of(file: Path, folder: Folder, *, depth: int = 0) -> Iterator[Statement]:
    """Yield the statements of a file and of the files that it includes. A file that is imported
    lies between two statements `ImportBegin` and `ImportEnd`."""
    check_size(file)
    if depth > _MAX_DEPTH:
        raise InputError(f"more than {_MAX_DEPTH} files are included; do they name themselves?")
    for statement in _statements(plain_text(file), f"{file.name}, " if depth else ""):
        if statement.word not in ("Include", "Import"):
            yield statement
            continue
        inner = statements_of(folder.file(statement.name()), folder, depth=depth + 1)
        if statement.word == "Include":
            yield from inner
        else:
            yield Statement("ImportBegin", [], statement.place)
            yield from inner
            yield Statement("ImportEnd", [], statement.place)


def _statements(text: str, file: str) -> Iterator[Statement]:
    ends = [found.start() for found in re.finditer("\n", text)]
    statement: Statement | None = None
    within: dict[str, int] = {}  # number of statements of each line
    opened: list[Any] | None = None  # the bracket that is not closed yet
    for token in _TOKEN.finditer(text):
        if token.lastindex is None:  # a comment
            continue
        quoted, bracket, bare, unclosed = token.groups()
        value: Any = quoted
        if quoted is not None:
            value = re.sub(r"\\(.)", r"\1", quoted)
        elif bare is not None and _NUMBER.fullmatch(bare):
            value = float(bare)
        elif bare in ("true", "false"):
            value = bare == "true"
        if value is None and bare is not None and bare.isalpha() and opened is None:
            if statement is not None:
                yield statement
            place = f"{file}line {bisect(ends, token.start()) + 1}"
            within[place] = within.get(place, 0) + 1
            nth = f", statement {within[place]}" if within[place] > 1 else ""
            statement = Statement(bare, [], place + nth)
        elif statement is not None and bracket == "[" and opened is None:
            opened = []
        elif statement is not None and bracket == "]" and opened is not None:
            statement.arguments.append(opened)
            opened = None
        elif statement is not None and value is not None:
            (statement.arguments if opened is None else opened).append(value)
        else:
            place = f"{file}line {bisect(ends, token.start()) + 1}"
            what = "a quote that its line does not close" if unclosed else f"{token[0][:40]!r}"
            raise InputError(f"{place}: {what} is out of place; correct it.")
    if opened is not None:
        raise InputError(f"{file}a bracket [ is not closed; close it.")
    if statement is not None:
        yield statement


def node_of(statement: Statement, names: int, textures: Mapping[str, Node], folder: Folder) -> Node:
    """Return the object of a statement.

    The first `names` arguments are names, the last of them the type of the object; its parameters
    follow. Raise `InputError` for a parameter of a wrong type.
    """
    kind = statement.names(names)[-1]
    node = Node(statement.word, kind, f"{statement.word} {kind[:40]}, {statement.place}")
    rest = statement.arguments[names:]
    if len(rest) % 2:
        raise node.wrong(f"{str(rest[-1])[:40]!r} has no value; add it.")
    for declared, given in zip(rest[::2], rest[1::2], strict=True):
        words = declared.split() if isinstance(declared, str) else ()
        if len(words) != 2:
            raise node.wrong(f'{str(declared)[:40]!r} is no type and name, as in "float fov".')
        of_type, name = words
        given = given if isinstance(given, list) else [given]
        if name in node.values or any(name == called for called, _ in node.parts):
            raise node.wrong(f"{name[:40]!r} stands twice; leave one of them.")
        if of_type == "texture":
            if len(given) != 1 or given[0] not in textures:
                raise node.wrong(f"{name} names no texture; define it before.")
            node.parts.append((name, textures[given[0]]))
        else:
            node.values[name] = _value(node, of_type, name, given, folder)
    return node


def _value(node: Node, of_type: str, name: str, given: list[Any], folder: Folder) -> Any:
    """Return the value of a parameter, as the kinds of value of a `Node`. Several numbers or points
    become an array, several texts a tuple."""
    kinds = {type(one) for one in given}
    numbers = np.array(given) if kinds == {float} and np.isfinite(given).all() else None
    if of_type in ("bool", "string"):
        if kinds != {bool if of_type == "bool" else str}:
            raise node.wrong(f"{name} must be of the type {of_type}; correct it.")
        return given[0] if len(given) == 1 else tuple(given)
    if of_type == "spectrum" and kinds == {str} and len(given) == 1:
        if given[0].startswith(_OF_LIBRARY):
            return Named(given[0])
        lines = plain_text(folder.file(given[0])).splitlines()
        words = [word for line in lines for word in line.split("#")[0].split()]
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            numbers = None
    size = _SIZES.get(of_type, 2 if of_type == "spectrum" else 0)
    if not size:
        raise node.wrong(f"{name} is of the type {of_type[:40]!r}, which is not read.")
    is_whole = of_type != "integer" or (numbers is not None and (numbers % 1 == 0).all())
    if numbers is None or not len(numbers) or len(numbers) % size or not is_whole:
        raise node.wrong(f"{name} does not hold finite numbers of the type {of_type}; correct it.")
    match of_type:
        case "rgb" if len(numbers) == 3 and (numbers >= 0).all():
            return Colour(tuple(numbers.tolist()))
        case "blackbody" if len(numbers) == 1 and numbers[0] > 0:
            return Blackbody(float(numbers[0]))
        case "spectrum":
            return Table(tuple((nm, value) for nm, value in numbers.reshape(-1, 2).tolist()))
        case "rgb" | "blackbody":
            raise node.wrong(f"{name} is no value of the type {of_type}; correct it.")
        case "integer":
            numbers = numbers.astype(int)
    if len(numbers) == size:
        return numbers if size > 1 else numbers[0].item()
    return numbers.reshape(-1, size) if size > 1 else numbers
