"""Scene and camera files by path, or by name if they come with the package.

No numerical library is loaded here, so a wrong path is reported immediately.
"""

import os
from importlib.resources import files
from pathlib import Path
from typing import Literal

from ...errors import InputError, nearest
from .._plain_content import file_at

Kind = Literal["scene", "camera"]


def shipped_files(kind: Kind) -> tuple[str, ...]:
    """Names of the files that come with the package, sorted."""
    return tuple(sorted(file.stem for file in _folder(kind).glob("*.toml")))


def existing_file(path: str | os.PathLike[str], kind: Kind) -> Path:
    """The existing file for a path or name; `InputError` without one."""
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
