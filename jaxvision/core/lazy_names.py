"""Load the names of a package when they are first used, and explain unknown names in error
messages."""

import difflib
import re
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import lazy_loader

from .._textbook import is_absent, places
from ._moved import module_of, renamed

Attached = tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]


def names_of(package: str, file: str) -> Attached:
    """Return `__getattr__`, `__dir__` and `__all__` of a package, made from its stub file. A name
    is imported when it is first used. A name that the stub does not list raises `AttributeError`.
    The error message says where the name is defined, which record has a field of that name, or
    which listed name is nearest."""
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
        where = None if name.startswith("_") else _homes(package, Path(file).parent).get(name)
        if where and where.removeprefix(f"{package}.") in offered:
            hint = f"it is {where}.{name}"
        elif where:
            hint = f"from {where} import {name} gives it"
        elif name.isidentifier() and not name.startswith("_") and _is_module(Path(file), name):
            hint = f"import {package}.{name} gives it"
            if meaning := places(name, sys.modules["jaxvision"].__all__):
                hint = f"here it is {meaning}; import {package}.{name} gives the module"
        elif meaning := places(name, sys.modules["jaxvision"].__all__):
            hint = f"here it is {meaning}"
        elif is_absent(name):
            hint = "the library does not model it"
        elif records := _records_with(name, offered):
            hint = f"it is a field of {', '.join(records)}"
        elif near := difflib.get_close_matches(name, offered, n=1):
            hint = f"the nearest is {near[0]!r}"
        else:
            hint = f"dir({package}) lists what it has"
        said = f"{package} has no {name!r}; {hint}."
        raise AttributeError(said, name=name, obj=sys.modules[package])

    return attribute, listed, offered


def _is_module(file: Path, name: str) -> bool:
    return file.with_name(f"{name}.py").exists() or (file.parent / name / "__init__.py").exists()


@cache
def _homes(package: str, folder: Path) -> dict[str, str]:
    """Return, for each name, the subpackage that exports it, or the public submodule that defines
    it."""
    exported: dict[str, str] = {}
    for stub in sorted(folder.glob("*/__init__.pyi")) + sorted(folder.glob("*/*/__init__.pyi")):
        home = ".".join((package, *stub.parent.relative_to(folder).parts))
        for name in re.findall(r"\bas (\w+)\b", stub.read_text()):
            exported.setdefault(name, home)
    defined: dict[str, str] = {}
    for module in sorted(folder.rglob("*.py")):
        inner = module.relative_to(folder).with_suffix("").parts
        if any(part.startswith("_") for part in inner) or not _is_offered(folder, inner):
            continue
        for name in re.findall(r"^(?:def|class) (\w+)", module.read_text(), re.MULTILINE):
            defined.setdefault(name, ".".join((package, *inner)))
    return defined | exported


def _is_offered(folder: Path, inner: tuple[str, ...]) -> bool:
    """Return whether every part of a module's path, after the first, is listed in the stub of the
    package that contains it."""
    stubs = (folder.joinpath(*inner[:i], "__init__.pyi") for i in range(1, len(inner)))
    return all(
        stub.exists() and re.search(rf"\bas {re.escape(part)}\b", stub.read_text())
        for stub, part in zip(stubs, inner[1:], strict=True)
    )


def _records_with(name: str, offered: list[str]) -> list[str]:
    """Return the records of scenes, lights, views and sensors among `offered` that have a field."""
    modules = [import_module(f"jaxvision.{name}") for name in ("scene", "lights")]
    kinds = [(one, getattr(m, one)) for m in modules for one in m.__all__ if one in offered]
    return [
        f"jaxvision.{one}"
        for one, kind in kinds
        if name in getattr(kind, "__dataclass_fields__", ())
    ]
