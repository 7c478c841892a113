"""Errors of input: the exception that users of the tools see, hints for misspelt words, and
handling of names and texts that are not UTF-8."""

import difflib
import errno
from collections.abc import Iterable
from pathlib import Path

from ._textbook import meant, similar

DISTRIBUTION = "jaxvision-imaging"  # in package indices, where `jaxvision` is another project


def install(extra: str) -> str:
    """Return the command that installs an optional feature's dependencies."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"


LONGEST = 900  # characters of a message


class InputError(ValueError):
    """The exception for input that cannot be used. Its message is one sentence that says what is
    wrong, where, and what to do.

    Example:
        >>> try:
        ...     jv.read_camera("emva1289")
        ... except jv.InputError as error:
        ...     print(error)
        emva1289: neither a file nor a shipped camera; the nearest is 'emva1288'.
    """

    def __init__(self, message: object = "") -> None:
        text = str(message)  # which may quote a damaged file
        if len(text) > LONGEST:
            text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 3 :]}"
        super().__init__(text)


def nearest(word: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown word: this library's name for a textbook's word (perhaps
    misspelt), the nearest word in `known`, or all of `known`.
    """
    words = sorted(known)
    if not words:
        return "there are none"
    if meaning := meant(word, words):
        return f"here it is {' or '.join(map(repr, meaning))}"
    if not difflib.get_close_matches(word, words, n=1, cutoff=0.85) and (
        alike := similar(word, words)
    ):
        return f"{alike[0]!r} is here {' or '.join(map(repr, alike[1]))}"
    folded = {one.casefold(): one for one in reversed(words)}
    match = difflib.get_close_matches(word, words, n=1) or [
        folded[one] for one in difflib.get_close_matches(word.casefold(), folded, n=1)
    ]
    return f"the nearest is {match[0]!r}" if match else f"use one of {', '.join(words)}"


def shorten(x: object) -> str:
    """Format a value on one line of at most some 80 characters, for an error message."""
    words = " ".join(repr(x).split())
    return words if len(words) <= 80 else f"{words[:80]} ..."


def check_utf8(path: str | Path) -> None:
    """Raise `InputError` for a path whose bytes are not UTF-8, which image and report libraries
    need.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(f"{str(path)!a}: the path is not UTF-8; rename that.") from None


def unwritable(error: OSError) -> str:
    """Return the operating system's reason why a file cannot be written, and a remedy."""
    said = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{said}; make room or choose another path"
    return f"{said}; choose another path"


def plain_text(file: Path) -> str:
    """Return the content of a text file, with line ends as newlines and without byte order mark.
    Raise `InputError` unless it is UTF-8.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        data = error.object
        if not data.startswith((b"\xff\xfe", b"\xfe\xff")) and b"\0" not in data[:4]:
            line = data.count(b"\n", 0, error.start) + 1
            raise InputError(
                f"{file}: line {line} holds the byte {data[error.start]:#x}, which is not UTF-8 "
                "but perhaps Latin-1; save it as UTF-8."
            ) from None
        text = "\0"
    if "\0" in text[:4]:
        raise InputError(f"{file}: is text in UTF-16 or UTF-32; save it as UTF-8.")
    return text
