"""Read and replace the numbers at paths into records, such as `scene.lights[0].position` and
`camera.sensor.gain`.

A path begins with the name of a record. Attributes, indices in lists and keys of dictionaries
follow, down to an array. A last `[i]` may select one number of that array.
"""

import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxvision.errors import InputError, nearest

STEP = re.compile(r"\.(\w+)|\[(\d+)\]|\[['\"]([^'\"]+)['\"]\]")
Step = str | int


def is_path(name: str) -> bool:
    """Return whether a parameter's name is a path into a record."""
    return "." in name or "[" in name


def head(path: str) -> str:
    """Return the name of the record in which a path begins."""
    return re.split(r"[.\[]", path, maxsplit=1)[0]


def _steps(path: str) -> list[Step]:
    rest = path[len(head(path)) :]
    found = list(STEP.finditer(rest))
    if "".join(step[0] for step in found) != rest:
        raise InputError(f"{path!r} is no path: write it like 'scene.lights[0].position'.")
    return [step[1] or step[3] or int(step[2]) for step in found]


def _inside(value: Any) -> dict[Step, Any]:
    """Return the fields, items or keys of a value, with their contents."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "_fields"):
        return value._asdict()
    return dict(enumerate(value)) if isinstance(value, (list, tuple)) else {}


def _is_number(value: Any) -> bool:
    return isinstance(value, float) or eqx.is_inexact_array(value)


def _offers(value: Any) -> str:
    """Say in words which names a path may continue with."""
    there = _inside(value)
    if _is_number(value):
        return f"an array of shape {np.shape(value)}"
    if not there:
        return "nothing that can be fitted" if value is not None else "None: it is switched off"
    if all(isinstance(key, int) for key in there):
        return f"{len(there)} of them, from [0]" if len(there) > 1 else "[0] alone"
    return ", ".join(str(key) for key, part in there.items() if part is not None) or "nothing"


def read(records: Mapping[str, Any], path: str) -> Array:
    """Return the number or array at the end of a path."""
    value = reach(records, path)
    if not _is_number(value):
        raise InputError(f"{path} is no number; there is {_offers(value)}.")
    return jnp.asarray(value)


def reach(records: Mapping[str, Any], path: str) -> Any:
    """Return the value at the end of a path, a number or a record."""
    if head(path) not in records:
        raise InputError(
            f"{path}: there is no record {head(path)!r}; {nearest(head(path), records)}."
        )
    value, walked = records[head(path)], head(path)
    for step in _steps(path):
        if _is_number(value) and isinstance(step, int) and np.ndim(value):
            if step >= len(value):
                raise InputError(f"{path}: {walked} has {len(value)} numbers.")
            value = value[step]
        elif step in (there := _inside(value)):
            value = there[step]
        else:
            raise InputError(f"{path}: {walked} has no {step!r}; there is {_offers(value)}.")
        walked += f"[{step}]" if isinstance(step, int) else f".{step}"
    return value


def replaced(records: Mapping[str, Any], values: Mapping[str, Array]) -> dict[str, Any]:
    """Return the records with other numbers at some paths."""
    new = dict(records)
    for path, value in values.items():
        name = head(path)
        there = jnp.shape(read(new, path))
        if jnp.shape(value) not in ((), there):
            raise InputError(
                f"{path}: shape {jnp.shape(value)} does not fit, the record's is {there}."
            )
        new[name] = _replace(new[name], _steps(path), jnp.broadcast_to(value, there))
    return new


def _replace(record: Any, steps: list[Step], value: Array) -> Any:
    if not steps:
        return value
    if _is_number(record):
        return jnp.asarray(record).at[tuple(steps)].set(value)
    step = steps[0]
    inner = _replace(_inside(record)[step], steps[1:], value)
    return eqx.tree_at(lambda record: _inside(record)[step], record, inner)
