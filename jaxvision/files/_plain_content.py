"""Check the size of text files before they are parsed, and their content afterwards. A damaged or
hostile file then leads to an error message of one sentence, and takes no more memory than a valid
file."""

import os
from pathlib import Path
from typing import Any

from ..errors import InputError

LARGEST = 16 << 20  # largest size of a text file, bytes
DEEPEST = 64  # largest depth of nested tables and arrays
LONGEST_NAME = 500  # characters
_BITS = 14_000  # largest number of bits of an integer: about as many digits as Python prints


def check_size(file: Path) -> None:
    """Raise `InputError` for a text file that is too large."""
    size = file.stat().st_size
    if size > LARGEST:
        raise InputError(f"{file}: holds {size >> 20} MiB, more than {LARGEST >> 20}; divide it.")


def damaged(file: Path, reason: str) -> InputError:
    """Return the error for a file that is damaged or incomplete."""
    return InputError(
        f"{file}: the file is damaged or cut short ({reason}); copy it again from its source."
    )


def unlike(place: object, fault: str) -> InputError:
    """Return the error for a file that does not conform to its format."""
    return InputError(f"{place}: {fault}; export it again.")


def file_at(path: str | os.PathLike[str], kind: str = "") -> Path:
    """Return the path of an existing file; `InputError` if there is none of this `kind`."""
    file = Path(path)
    if not file.is_file():
        what = f"{kind} file".strip()
        raise InputError(f"{file}: no such {what}; check the name and the folder.")
    return file


def check_content(place: str, content: Any) -> None:
    """Refuse content that is nested too deeply, or has too long numbers or names."""
    waiting: list[tuple[Any, tuple[str, ...]]] = [(content, ())]
    while waiting:
        value, path = waiting.pop()
        where = ".".join(path[:6]) or "it"
        if len(path) > DEEPEST:
            raise InputError(f"{place}: {where} is nested more than {DEEPEST} deep; flatten it.")
        if isinstance(value, dict):
            for name, inside in value.items():
                if len(name) > LONGEST_NAME:
                    raise InputError(
                        f"{place}: {where} has a key of {len(name)} characters; correct it."
                    )
                waiting.append((inside, (*path, name)))
        elif isinstance(value, list):
            waiting += [(inside, (*path, str(i))) for i, inside in enumerate(value)]
        elif type(value) is int and value.bit_length() > _BITS:
            raise InputError(f"{place}: {where} is a number of more than {_BITS} bits; correct it.")
