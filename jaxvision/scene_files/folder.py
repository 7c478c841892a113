"""The files that a scene is made of: found beside it, and remembered by their contents."""

import hashlib
from pathlib import Path

from ..errors import InputError


class Folder:
    """Where the paths of one scene file start. What was asked for is part of the `digest`."""

    def __init__(self, scene_file: Path) -> None:
        self._start = scene_file.parent
        self._hashes = {str(scene_file.name): _hash(scene_file)}

    def file(self, name: str) -> Path:
        """The file of that name; `InputError` where there is none."""
        path = self._start / name
        if not path.is_file():
            raise InputError(f"{path}: no such file; paths start at the folder of the scene file.")
        self._hashes[name] = _hash(path)
        return path

    def text(self, name: str) -> str:
        """The contents of a text file."""
        path = self.file(name)
        try:
            return path.read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: not a text file ({error.reason}).") from error

    def digest(self) -> str:
        """One hash of the scene file and of all files it named so far."""
        whole = hashlib.sha256()
        for name in sorted(self._hashes):
            whole.update(f"{name}\0{self._hashes[name]}\0".encode())
        return whole.hexdigest()


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
