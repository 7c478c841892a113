"""The description of a light's or material's table in a scene file."""

import re
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

# What a key may name a file of, beside numbers and spectra: (h, w, bands) W m^-2 sr^-1, the record
# of a measured BRDF in the bands of the scene, and a lamp as sold.
Picture = Annotated[Any, "picture"]
Measured = Annotated[Any, "measured"]
Photometry = Annotated[Any, "photometry"]


class Table(NamedTuple):
    """A table of a scene file."""

    word: str  # its `kind` or `family`
    record: type  # the class of what it becomes
    make: Callable[..., Any]  # the record, or what makes it of the values of its keys


def table_for(record: type, word: str | None, from_file: Callable[..., Any] | None) -> Table | None:
    """The table of a kind; None for "", a kind that no file contains."""
    if word is None:
        name = record.__name__.removesuffix("Light") or record.__name__
        word = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
    return Table(word, record, from_file or record) if word else None
