"""What is said of bad input: the one exception a user of the tools sees, and the word that was
meant."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Input that cannot be used. The message is one sentence: what, where, and what to do."""


def nearest(word: str, known: Iterable[str]) -> str:
    """What is said after an unknown word: the nearest known one, or all of them."""
    words = sorted(known)
    if not words:
        return "there are none"
    match = difflib.get_close_matches(word, words, n=1)
    return f"the nearest is {match[0]!r}" if match else f"use one of {', '.join(words)}"
