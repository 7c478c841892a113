"""Read and set fields of a scene or camera by name, and give a fit's free parameters their smallest
and largest values. The name of a field is its path in the record, such as

"surfaces[0].material.specular", "lights[1].position", "ambient.radiance", "view.focal_length",
"sensor.gain". Free parameters are given as a mapping from such names to the smallest and largest
values, in the unit of the field.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from itertools import product
from typing import Any

import jax
import numpy as np

from ..core._types import is_known
from ..errors import InputError, nearest
from ..scene import Camera, Scene
from .stages import Draft, Drop, Ends

Box = Mapping[str, tuple[Any, Any]]
# a pinhole in place of a lens has the values at the working aperture
_LENS_FIELDS = "view.f_number", "view.focal_length"
_STEP = re.compile(r"(\w+)|\[(\d+)\]")


def refuse_tracers(*records: Any) -> None:
    """Refuse traced numbers, because effects are dropped before JAX traces a program."""
    for leaf in jax.tree.leaves(records):
        if not is_known(leaf):
            raise ValueError(
                "effects are decided on known numbers, outside jit, grad and vmap; got a tracer."
            )


def unbounded(scene: Scene, camera: Camera) -> str:
    """Return the name of a number that makes every bound infinite: a number of the scene that is
    not finite, or a NaN of the camera. Return "" if no number does."""
    for record, wrong in ((scene, lambda x: ~np.isfinite(x)), (camera, np.isnan)):
        if any(np.any(wrong(leaf)) for leaf in jax.tree.leaves(record)):
            every = _names(record, "")
            return next(name for name in every if np.any(wrong(value_at(record, name))))
    return ""


def steps_of(name: str) -> list[str | int]:
    """Split the name of a field into the fields and indices along its path."""
    return [int(number) if number else word for word, number in _STEP.findall(name)]


def _entry(record: Any, step: str | int) -> Any:
    if isinstance(step, int):
        inside = isinstance(record, tuple) and step < len(record)
        return record[step] if inside else None
    return getattr(record, step, None)


def value_at(record: Any, name: str) -> Any:
    """Return the value of the field with that name, or None if the record has no such field."""
    for step in steps_of(name):
        record = _entry(record, step)
    return record


def replace_at(record: Any, steps: list[str | int], value: Any) -> Any:
    """Return a copy of a record with the value at the end of a path replaced."""
    if not steps:
        return value
    first, rest = steps[0], steps[1:]
    inner = replace_at(_entry(record, first), rest, value)
    if isinstance(first, int):
        return (*record[:first], inner, *record[first + 1 :])
    return replace(record, **{first: inner})


def setting(name: str, *, to: Any = None) -> Drop:
    """Return a function that sets one field of a `Draft`, such as "camera.sensor.bits", to `to`."""
    return lambda draft: replace_at(draft, steps_of(name), to)


def _names(record: Any, prefix: str) -> Iterator[str]:
    """Yield the names of all floating-point numbers in a record."""
    if isinstance(record, tuple):
        for i, own in enumerate(record):
            yield from _names(own, f"{prefix}[{i}]")
    elif is_dataclass(record):
        for field in fields(record):
            yield from _names(getattr(record, field.name), f"{prefix}.{field.name}".lstrip("."))
    elif isinstance(record, jax.Array) and np.issubdtype(record.dtype, np.floating):
        yield prefix


def ends_of(scene: Scene, camera: Camera, free: Box | None) -> tuple[Ends[Scene], Ends[Camera]]:
    """Return the scene and the camera as `Ends`: copies with the free fields at their smallest and
    at their largest values. `free` maps the names of fields to these two values, in the field's
    unit. If a scene or camera has no free field, both copies are the same record. `InputError` is
    raised for an unknown name, and for values that do not fit the field."""
    scenes, cameras = [scene, scene], [camera, camera]
    if not isinstance(free or {}, Mapping):
        raise InputError(f"free must map names of fields to their two ends, got {free!r}.")
    for name, values in (free or {}).items():
        held, known = (scenes, scene) if value_at(scene, name) is not None else (cameras, camera)
        own = value_at(known, name)
        if not isinstance(own, jax.Array):
            hint = nearest(name, [*_names(scene, ""), *_names(camera, "")])
            raise InputError(f"free: {name!r} is no number of this scene and camera; {hint}.")
        for end, value in enumerate(_check_ends(name, own, values)):
            held[end] = replace_at(held[end], steps_of(name), value)
    return Ends(*scenes), Ends(*cameras)


def _check_ends(name: str, own: jax.Array, values: tuple[Any, Any]) -> list[np.ndarray]:
    """Return both ends of a free field in its shape and dtype."""
    try:
        low, high = (np.broadcast_to(np.asarray(v, float), own.shape) for v in values)
    except (TypeError, ValueError):
        raise InputError(
            f"free: {name} needs a low and a high value of shape {own.shape}, got {values!r}."
        ) from None
    if not (np.all(np.isfinite(low)) and np.all(np.isfinite(high))):
        raise InputError(f"free: {name} needs finite ends, got {values!r}.")
    if not np.all(low <= high):
        raise InputError(f"free: {name} must not have its low end above its high end.")
    return [end.astype(own.dtype) for end in (low, high)]


def keeps(draft: Draft, name: str, scene: Scene, camera: Camera) -> bool:
    """Return whether a `Draft` still has the field of that name, with its shape and meaning."""
    place = re.match(r"surfaces\[(\d+)\]", name)
    if place is not None and draft.unmet and int(place[1]) >= min(draft.unmet):
        return False  # another surface would have its number
    if name in _LENS_FIELDS and type(draft.camera.view) is not type(camera.view):
        return False
    of_scene = value_at(scene, name)
    before = of_scene if of_scene is not None else value_at(camera, name)
    now = value_at(draft if of_scene is not None else draft.camera, name)
    return isinstance(now, jax.Array) and now.shape == before.shape


def same(a: Any, b: Any) -> bool:
    """Return whether two trees of records have the same structure and numbers."""
    leaves, tree = jax.tree.flatten(a)
    others, other = jax.tree.flatten(b)
    return tree == other and all(np.array_equal(x, y) for x, y in zip(leaves, others, strict=True))


def corners(ends: Ends[Any]) -> list[Any]:
    """List copies of a record with all combinations of the ends of its free numbers."""
    low, tree = jax.tree.flatten(ends.low)
    high = jax.tree.leaves(ends.high)
    choices = [(a,) if np.array_equal(a, b) else (a, b) for a, b in zip(low, high, strict=True)]
    return [jax.tree.unflatten(tree, leaves) for leaves in product(*choices)]
