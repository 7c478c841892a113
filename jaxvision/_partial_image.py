"""A picture on its way to a file, whose finished part survives a kill.

Of a picture by tiles the file is one line of JSON that says what is being rendered, and then a
record per tile: its values as little-endian float32 and their CRC-32. A tile is a run of pixels,
row by row, all of one length (the last is filled up), so that the tiles one after another are the
picture. A record counts when it is whole; whatever was being written when the process died is cut
off. Of a picture by passes the file is such a line and the sum so far in float64, and is replaced
as a whole.
"""

import json
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

import numpy as np

from .errors import InputError
from .io import replaced_on_success

_CHECKSUM = 4  # bytes


class PartialImage:
    """The tiles of one picture. `key`: what tells this render from every other. `values`: numbers
    in a tile. `done`: whole tiles in the file so far. A context manager."""

    def __init__(self, path: Path, *, key: str, values: int, fresh: bool) -> None:
        """Goes on where a file of the same key ends, or begins one; `InputError` for a file of
        another key unless it may be replaced (`fresh`) or has no tile yet."""
        self._path, self._values = path, values
        self._record = 4 * values + _CHECKSUM
        head = json.dumps({"render": key, "values": values}).encode() + b"\n"
        self._start = len(head)
        path.parent.mkdir(parents=True, exist_ok=True)
        found = b"" if fresh or not path.is_file() else _first_line(path)
        if found != head:
            if found.endswith(b"\n") and path.stat().st_size > len(found):
                raise _of_another(path)
            path.write_bytes(head)
        self._file = path.open("r+b")
        self.done = self._count_whole()
        self._file.truncate(self._start + self.done * self._record)

    def __enter__(self) -> "PartialImage":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def append(self, values: np.ndarray) -> None:
        """The next tile; on the disk when this returns."""
        data = np.ascontiguousarray(values, "<f4").tobytes()
        if len(data) != 4 * self._values:
            raise ValueError(f"a tile holds {self._values} values, got {values.size}.")
        self._file.seek(self._start + self.done * self._record)
        self._file.write(data + zlib.crc32(data).to_bytes(_CHECKSUM, "little"))
        self._file.flush()
        os.fsync(self._file.fileno())
        self.done += 1

    def tile(self, index: int) -> np.ndarray:
        """The values of a finished tile, flat float32."""
        self._file.seek(self._start + index * self._record)
        return np.frombuffer(self._file.read(4 * self._values), "<f4")

    def rows(self, width: int, bands: int, height: int, *, at_once: int) -> Iterator[np.ndarray]:
        """The finished picture from above, (rows, width, bands), so many rows `at_once`."""
        held = np.zeros(0, np.float32)
        left = height * width * bands
        for index in range(self.done):
            new = self.tile(index)[:left]
            held, left = np.concatenate([held, new]), left - len(new)
            whole = len(held) // (at_once * width * bands) * at_once if left else height
            size = min(whole * width * bands, len(held))
            if size:
                yield held[:size].reshape(-1, width, bands)
                held = held[size:]

    def delete(self) -> None:
        """When the picture has its own file."""
        self._file.close()
        self._path.unlink(missing_ok=True)

    def _count_whole(self) -> int:
        self._file.seek(self._start)
        for index in range(os.fstat(self._file.fileno()).st_size // self._record + 1):
            record = self._file.read(self._record)
            checksum = int.from_bytes(record[-_CHECKSUM:], "little")
            if len(record) < self._record or zlib.crc32(record[:-_CHECKSUM]) != checksum:
                return index
        return 0


class PartialSum:
    """The sum of the passes of one picture. `key`: what tells this render from every other.
    `total`: float64. `done`: passes so far."""

    def __init__(self, path: Path, *, key: str, shape: tuple[int, ...], fresh: bool) -> None:
        """Goes on from a file of the same key; `InputError` for a file of another key unless it
        may be replaced (`fresh`)."""
        self._path, self._key = path, key
        self.total, self.done = np.zeros(shape), 0
        if fresh or not path.is_file():
            return
        with path.open("rb") as file:
            line, data = file.readline(4096), file.read()
        try:
            head = json.loads(line)
        except ValueError:
            head = {}
        if head.get("render") != key or "passes" not in head:
            raise _of_another(path)
        self.total, self.done = np.frombuffer(data, "<f8").reshape(shape).copy(), head["passes"]

    def add(self, picture: np.ndarray) -> None:
        """One more pass; on the disk when this returns."""
        self.total += picture
        self.done += 1
        head = json.dumps({"render": self._key, "passes": self.done}).encode() + b"\n"
        with replaced_on_success(self._path) as new, new.open("wb") as file:
            file.write(head + self.total.astype("<f8").tobytes())
            file.flush()
            os.fsync(file.fileno())

    def delete(self) -> None:
        """When the picture has its own file."""
        self._path.unlink(missing_ok=True)


def _of_another(path: Path) -> InputError:
    return InputError(
        f"{path}: holds part of a render of another scene, version or setting; add --fresh to "
        "begin again, or write to another file."
    )


def _first_line(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.readline(4096)
