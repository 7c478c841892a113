"""Warnings that name the line of the user's code from which the library was called."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# packages whose frames are skipped on the way to the caller's line
_PACKAGES = ("jaxvision", "jax", "equinox", "contextlib", "functools")

# The warnings given during the current call from outside; None between calls.
_of_call: ContextVar[list[str] | None] = ContextVar("_of_call", default=None)


@contextmanager
def one_call() -> Iterator[None]:
    """Mark the duration of one call from user code, including all calls that it makes inside the
    library."""
    outer = _of_call.get()
    call = _of_call.set([] if outer is None else outer)
    try:
        yield
    finally:
        _of_call.reset(call)


def warn_caller(text: str) -> None:
    """Warn at the line of user code that called the library. A text is issued once per call from
    user code."""
    given = _of_call.get()
    if not given:
        if given is not None:
            given.append(text)
        warn(text)


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line of user code that called the library."""
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] in _PACKAGES:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)
