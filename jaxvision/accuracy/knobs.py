"""Records of all approximations of the library by name, with their settings and theoretical orders
of convergence, from `knobs.toml`.

Some approximations are set by keys of `[render]` in scene files (module `scenes`). The other
approximations are measured on an example problem (package `examples`).
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
    """Return an approximation by name, or refuse it and suggest the nearest."""
    if name not in KNOBS:
        raise InputError(f"knob {name!r} is unknown; {nearest(name, KNOBS)}.")
    return KNOBS[name]
