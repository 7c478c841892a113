"""Convert Mitsuba's `<transform>` to affine maps of column vectors, (4, 4), in m; angles are in
degrees."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ....errors import InputError
from ..placement import Affine, look_at


def transform_of(steps: Iterable[tuple[str, Mapping[str, str]]], place: str) -> Affine:
    """Return the map to the world: the product of all steps, which are applied in the order of the
    file. A step is a pair of an XML tag and its attributes. Raise `InputError` for an unknown step,
    or for a map without an inverse."""
    whole = np.eye(4)
    for tag, given in steps:
        whole = _step(tag, given, f"{place}, {tag}") @ whole
    if not np.isfinite(whole).all() or not np.linalg.det(whole[:3, :3]):
        raise InputError(f"{place}: flattens space or is not finite; correct its numbers.")
    return whole


def check_attributes(given: Mapping[str, str], known: tuple[str, ...], place: str) -> None:
    """Raise `InputError` for an attribute that nothing reads, or for `value` beside x, y, z."""
    for name in given:
        if name not in ("name", "id", *known):
            raise InputError(f"{place}: the attribute {name} is not read; correct or remove it.")
    if "value" in given and {"x", "y", "z"} & set(given):
        raise InputError(f"{place}: has a value beside x, y or z; leave one of them.")


_OF_STEPS = {
    **dict.fromkeys(("translate", "scale"), ("value", "x", "y", "z")),
    "rotate": ("value", "x", "y", "z", "angle"),
    **dict.fromkeys(("lookat", "lookAt"), ("origin", "target", "up")),
    "matrix": ("value",),
}


def _step(tag: str, given: Mapping[str, str], place: str) -> Affine:
    step = np.eye(4)
    check_attributes(given, _OF_STEPS.get(tag, tuple(given)), place)
    match tag:
        case "translate":
            step[:3, 3] = _vector(given, place, otherwise=0.0)
        case "scale":
            step[:3, :3] = np.diag(_vector(given, place, otherwise=1.0))
        case "rotate":
            axis = _vector(given, place, otherwise=0.0)
            # Mitsuba scales space by an axis that is not of length 1
            if abs(np.linalg.norm(axis) - 1) > 1e-3:
                raise InputError(
                    f"{place}: its axis {axis.tolist()} must be of length 1; divide it."
                )
            angle = np.radians(_words(given.get("angle", ""), place, 1)[0])
            turned = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
            step[:3, :3] = turned.as_matrix()
        case "lookat" | "lookAt":
            origin, target = (
                _words(given.get(name, ""), place, 3) for name in ("origin", "target")
            )
            step = look_at(origin, target, _words(given.get("up", "0 1 0"), place, 3), place)
        case "matrix":
            values = given.get("value", "").replace(",", " ").split()
            side = 3 if len(values) == 9 else 4
            entries = _words(given.get("value", ""), place, side * side)
            step[:side, :side] = entries.reshape(side, side)
            if (step[3] != [0, 0, 0, 1]).any():
                raise InputError(f"{place}: is a projection; its last row must be 0 0 0 1.")
        case _:
            raise InputError(
                f"{place}: is not read; use translate, rotate, scale, lookat or matrix."
            )
    return step


def _vector(given: Mapping[str, str], place: str, *, otherwise: float) -> np.ndarray:
    """Read `value`, with one or three numbers, or the attributes `x`, `y` and `z`."""
    if "value" in given:
        several = len(given["value"].replace(",", " ").split()) > 1
        return np.broadcast_to(_words(given["value"], place, 3 if several else 1), 3)
    return np.concatenate([_words(given.get(axis, str(otherwise)), place, 1) for axis in "xyz"])


def _words(text: str, place: str, count: int) -> np.ndarray:
    try:
        found = np.asarray([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        found = np.empty(0)
    if len(found) != count or not np.isfinite(found).all():
        raise InputError(f"{place}: {text!r} must be {count} finite numbers; correct it.")
    return found
