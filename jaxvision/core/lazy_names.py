"""Load the names of a package when they are first used, and explain unknown names in error
messages."""

import difflib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lazy_loader

from .._textbook import places
from ._moved import module_of, renamed

Attached = tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]


def names_of(package: str, file: str) -> Attached:
    """Return `__getattr__`, `__dir__` and `__all__` of a package, made from its stub file. A name
    is imported when it is first used. A name that the stub does not list raises `AttributeError`.
    The error message says where the name is defined, or which listed name is nearest."""
    load, listed, offered = lazy_loader.attach_stub(package, file)

    def attribute(name: str) -> Any:
        if name in offered:
            return load(name)
        moved = module_of(f"{package}.{name}")
        if moved is not None:
            return moved
        new = renamed(f"{package}.{name}")
        if new is not None:
            return load(new)
        where = None if name.startswith("_") else _home(package, Path(file).parent, name)
        near = difflib.get_close_matches(name, offered, n=1)
        if where and where.removeprefix(f"{package}.") in offered:
            hint = f"it is {where}.{name}"
        elif where:
            hint = f"from {where} import {name} gives it"
        elif name.isidentifier() and not name.startswith("_") and _is_module(Path(file), name):
            hint = f"import {package}.{name} gives it"
        elif meaning := places(name, sys.modules["jaxvision"].__all__):
            hint = f"here it is {meaning}"
        else:
            hint = f"the nearest is {near[0]!r}" if near else f"dir({package}) lists what it has"
        said = f"{package} has no {name!r}; {hint}."
        raise AttributeError(said, name=name, obj=sys.modules[package])

    return attribute, listed, offered


def _is_module(file: Path, name: str) -> bool:
    return file.with_name(f"{name}.py").exists() or (file.parent / name / "__init__.py").exists()


def _home(package: str, folder: Path, name: str) -> str | None:
    """Return the subpackage that exports a name, or the submodule that defines it, or None."""
    listed = re.compile(rf"\bas {re.escape(name)}\b")
    for stub in sorted(folder.glob("*/__init__.pyi")):
        if listed.search(stub.read_text()):
            return f"{package}.{stub.parent.name}"
    defined = re.compile(rf"^(?:def|class) {re.escape(name)}\b", re.MULTILINE)
    for module in sorted(folder.rglob("*.py")):
        inner = module.relative_to(folder).with_suffix("").parts
        if not any(part.startswith("_") for part in inner) and defined.search(module.read_text()):
            return ".".join((package, *inner))
    return None
