"""Store an unfinished picture on disk, so that its completed part survives a kill of the process.

The file of a picture in tiles begins with one line of JSON that describes the render. A record for
each tile follows, with its values as little-endian float32 and their CRC-32. A tile is a sequence
of pixels in row order. All tiles have the same length; the last tile is padded. A record is valid
only if it is complete. An incomplete record at the end is removed when the render continues. The
file of a picture in passes also begins with a line of JSON. The sum of the passes so far follows,
in float64, with the CRC-32 of line and sum. This file is replaced as a whole after each pass. No
file is created before there is a result to store.
"""

import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from ..errors import InputError
from ..files.images import replaced_on_success

_CHECKSUM = 4  # bytes

Key = Mapping[str, Any]  # of values in JSON


class PartialImage:
    """The file with the finished tiles of one picture, for a `with` block. `key` identifies the
    render; its names are used in messages. `values` is the number of values per tile, and `done`
    the number of finished tiles."""

    def __init__(self, path: Path, *, key: Key, values: int, fresh: bool) -> None:
        """Continue at the end of a file with the same key. Raise `InputError` for a file with
        another key, unless that file may be replaced (`fresh`) or contains no tile yet."""
        self._path, self._values = path, values
        self._record = 4 * values + _CHECKSUM
        self._head = _head(key, values=values)
        self._file: BinaryIO | None = None
        self.done = 0
        found = b"" if fresh or not path.is_file() else _first_line(path)
        if found == self._head:
            self._file = path.open("r+b")
            self.done = self._count_whole(self._file)
            self._file.truncate(self._start_of(self.done))
        elif found.endswith(b"\n") and path.stat().st_size > len(found):
            raise _differs_error(path, found, key)

    def __enter__(self) -> "PartialImage":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            with suppress(OSError):  # a tile that a full disk cut off does not count
                self._file.close()

    def append(self, values: np.ndarray) -> None:
        """Append the next tile. When this method returns, the tile is on the disk."""
        data = np.ascontiguousarray(values, "<f4").tobytes()
        if len(data) != 4 * self._values:
            raise ValueError(f"a tile holds {self._values} values, got {values.size}.")
        file = self._open()
        file.seek(self._start_of(self.done))
        try:
            file.write(data + _checksum(data))
            file.flush()
            os.fsync(file.fileno())
        except OSError as error:
            error.filename = str(self._path)  # the error of a full disk does not name the file
            raise
        self.done += 1

    def tile(self, index: int) -> np.ndarray:
        """Return the values of a finished tile, as a flat array of float32."""
        file = self._open()
        file.seek(self._start_of(index))
        return np.frombuffer(file.read(4 * self._values), "<f4")

    def rows(self, width: int, bands: int, height: int, *, at_once: int) -> Iterator[np.ndarray]:
        """Yield the finished picture from the top, in blocks (rows, width, bands) of `at_once`
        rows."""
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
        """Delete the partial file after the picture is written."""
        if self._file is not None:
            self._file.close()
        self._path.unlink(missing_ok=True)

    def _start_of(self, index: int) -> int:
        return len(self._head) + index * self._record

    def _open(self) -> BinaryIO:
        if self._file is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.write_bytes(self._head)
            self._file = self._path.open("r+b")
        return self._file

    def _count_whole(self, file: BinaryIO) -> int:
        file.seek(len(self._head))
        for index in range(os.fstat(file.fileno()).st_size // self._record + 1):
            record = file.read(self._record)
            if len(record) < self._record or not _is_whole(record):
                return index
        return 0


class PartialSum:
    """The file with the sum of the finished passes of one picture. `key` identifies the render; its
    names are used in messages. `total` is the sum, in float64, and `done` the number of finished
    passes."""

    def __init__(self, path: Path, *, key: Key, shape: tuple[int, ...], fresh: bool) -> None:
        """Continue from a file with the same key, or begin again if the file is damaged. Raise
        `InputError` for a file with another key, unless that file may be replaced (`fresh`)."""
        self._path, self._key = path, key
        self.total, self.done = np.zeros(shape), 0
        if fresh or not path.is_file():
            return
        content = path.read_bytes()
        line, _, data = content.partition(b"\n")
        passes = _read_head(line).get("passes")
        if not isinstance(passes, int) or line + b"\n" != _head(key, passes=passes):
            raise _differs_error(path, line, key)
        if len(data) == self.total.nbytes + _CHECKSUM and _is_whole(content):
            self.total = np.frombuffer(data[:-_CHECKSUM], "<f8").reshape(shape).copy()
            self.done = passes

    def add(self, picture: np.ndarray) -> None:
        """Add one more pass. When this method returns, the new sum is on the disk."""
        self.total += picture
        self.done += 1
        data = _head(self._key, passes=self.done) + self.total.astype("<f8").tobytes()
        with replaced_on_success(self._path) as new, new.open("wb") as file:
            file.write(data + _checksum(data))
            file.flush()
            os.fsync(file.fileno())

    def delete(self) -> None:
        """Delete the partial file after the picture is written."""
        self._path.unlink(missing_ok=True)


def _head(key: Key, **more: int) -> bytes:
    return json.dumps({"render": key, **more}).encode() + b"\n"


def _read_head(line: bytes) -> dict[str, Any]:
    try:
        head = json.loads(line)
    except ValueError:
        return {}
    return head if isinstance(head, dict) else {}


def _first_line(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.readline(8192)


def _differs_error(path: Path, line: bytes, key: Key) -> InputError:
    found, wanted = _read_head(line).get("render"), json.loads(json.dumps(key))
    if isinstance(found, dict):
        differing = [name for name in {**found, **wanted} if found.get(name) != wanted.get(name)]
        # damage can produce other errors
        names = [name for name in differing if name.isprintable()]
        holds = f"part of a render with another {' and another '.join(names) or 'kind of part'}"
    else:
        holds = "something else than part of this render"
    return InputError(
        f"{path}: holds {holds}; add --fresh to begin again, or write to another file."
    )


def _checksum(data: bytes) -> bytes:
    return zlib.crc32(data).to_bytes(_CHECKSUM, "little")


def _is_whole(record: bytes) -> bool:
    return _checksum(record[:-_CHECKSUM]) == record[-_CHECKSUM:]
