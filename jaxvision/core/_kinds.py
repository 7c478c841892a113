"""Link the tables of scene files to the types of light and material records that the tables
describe."""

import re
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

# Contents of the files that a key may name: an image (h, w, bands) W m^-2 sr^-1, the record of a
# measured BRDF in the bands of the scene, or the photometric data of a lamp.
Picture = Annotated[Any, "picture"]
Measured = Annotated[Any, "measured"]
Photometry = Annotated[Any, "photometry"]


class Table(NamedTuple):
    """The conversion of one type of table in a scene file to a record."""

    word: str  # the value of its key `kind` or `family`
    record: type  # the class of the record that it describes
    make: Callable[..., Any]  # makes the record from the values of its keys


def table_for(record: type, word: str | None, from_file: Callable[..., Any] | None) -> Table | None:
    """Return the table of a light or material record; None if `word` is "", which means that scene
    files cannot contain the record."""
    if word is None:
        name = record.__name__.removesuffix("Light") or record.__name__
        word = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
    return Table(word, record, from_file or record) if word else None
