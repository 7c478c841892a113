"""Find scene and camera files by their path, or by their name if they come with the package.

This module loads no numerical library, so that a wrong path is reported immediately.
"""

import os
from importlib.resources import files
from pathlib import Path
from typing import Literal

from ...errors import InputError, nearest
from .._plain_content import file_at

Kind = Literal["scene", "camera"]


def shipped_files(kind: Kind) -> tuple[str, ...]:
    """List the names of the scenes or cameras that come with the package, sorted."""
    return tuple(sorted(file.stem for file in _folder(kind).glob("*.toml")))


def existing_file(path: str | os.PathLike[str], kind: Kind) -> Path:
    """Return the path of a file given by path or name; `InputError` if none."""
    file, known = Path(path), shipped_files(kind)
    if file.is_file():
        return file
    if str(path) in known:
        return _folder(kind) / f"{path}.toml"
    if file.suffix or file.parent != Path("."):
        file_at(path, kind)
    hint = nearest(file.name, known)
    raise InputError(f"{path}: neither a file nor a shipped {kind}; {hint}.")


def _folder(kind: Kind) -> Path:
    return Path(str(files(__name__))) / f"{kind}s"
