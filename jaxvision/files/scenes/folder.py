"""Find the files that a scene file names, by paths relative to the scene file."""

from pathlib import Path

from ...errors import InputError


class Folder:
    """The folder of a scene file, from which its relative paths start."""

    def __init__(self, scene_file: Path) -> None:
        self._start = scene_file.parent

    def file(self, name: str) -> Path:
        """Return the path of a file relative to the folder; `InputError` if there is none."""
        path = self._start / name
        if not path.is_file():
            raise InputError(f"{path}: no such file; paths start at the folder of the scene file.")
        return path
