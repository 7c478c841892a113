"""The files that a scene is made of, found beside it."""

from pathlib import Path

from ..errors import InputError


class Folder:
    """Where the paths of one scene file start."""

    def __init__(self, scene_file: Path) -> None:
        self._start = scene_file.parent

    def file(self, name: str) -> Path:
        """The file of that name; `InputError` where there is none."""
        path = self._start / name
        if not path.is_file():
            raise InputError(f"{path}: no such file; paths start at the folder of the scene file.")
        return path

    def text(self, name: str) -> str:
        """The contents of a text file."""
        path = self.file(name)
        try:
            return path.read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: not a text file ({error.reason}).") from error
