"""Errors of input: the exception that users of the tools see, and hints for misspelt words."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Input that cannot be used. The message is one sentence: what, where, and what to do."""


def nearest(word: str, known: Iterable[str]) -> str:
    """Hint after an unknown word: the nearest known word, or all of them.

    Args:
        word: the unknown word.
        known: the known ones.

    Returns:
        Part of a sentence.

    Example:
        >>> jv.errors.nearest("lambart", ["lambert", "phong"])
        "the nearest is 'lambert'"
    """
    words = sorted(known)
    if not words:
        return "there are none"
    match = difflib.get_close_matches(word, words, n=1)
    return f"the nearest is {match[0]!r}" if match else f"use one of {', '.join(words)}"
