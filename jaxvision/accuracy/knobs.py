"""Every approximation of the library by name, with its settings and its theoretical order, from
`knobs.toml`.

Settings of scene files are keys of `[render]` (`scenes`). The others are measured on their own
example (`examples`).
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, nearest
from .records import Knob

_TABLES: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)


def _knob(name: str, table: dict[str, Any]) -> Knob:
    entries: dict[str, Any] = {
        key: tuple(x) if isinstance(x, list) else x for key, x in table.items()
    }
    return Knob(name, **entries)


KNOBS: Mapping[str, Knob] = {name: _knob(name, table) for name, table in _TABLES.items()}


def knob_named(name: str) -> Knob:
    """The record of a setting; `InputError` with the nearest name for an unknown one."""
    if name not in KNOBS:
        raise InputError(f"knob {name!r} is unknown; {nearest(name, KNOBS)}.")
    return KNOBS[name]
