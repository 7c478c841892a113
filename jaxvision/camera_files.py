"""Cameras from TOML files: one table for each record, its keys the record's fields.

    [view]
    kind = "Pinhole"              # which record, where several are possible
    focal_length = 8e-3           # units as in the records: SI, electrons, DN
    pixel_pitch = 4.8e-6
    resolution = [480, 640]

    [sensor]
    gain = 0.28
    [sensor.shot_noise]
    kind = "PoissonShotNoise"

A view without `position` and `rotation` stands at the origin and looks along +z, +x to its right
and +y down. `[sensor.colour_filter]` may name measured sensitivities of colour-science,
`sensitivities = "Nikon 5100 (NPL)"`, with `peak`, electrons per photon where it is largest, instead
of a `transmission`; `[bands]` then gives the wavelengths, `first`, `last` and `step` in m. A Bayer
`pattern` may be written as "RGGB". `about` is free text.
"""

import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from importlib.resources import files
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .colour_data import camera_sensitivities, wavelength_grid
from .colour_filters import bayer
from .errors import InputError, nearest
from .scene import Camera

_TABLES = ("view", "sensor", "development")
_BANDS = ("first", "last", "step")
_SHIPPED = Path(str(files("jaxvision"))) / "cameras"


def shipped_cameras() -> tuple[str, ...]:
    """Names of the cameras that come with the library.

    Returns:
        The names, sorted.

    Example:
        >>> jv.shipped_cameras()
        ('consumer_bayer', 'emva1288', 'ideal')
    """
    return tuple(sorted(file.stem for file in _SHIPPED.glob("*.toml")))


def read_camera(
    source: str | os.PathLike[str], *, wavelengths: Float[Array, " bands"] | None = None
) -> Camera:
    """Reads a camera from a TOML file, or a shipped camera by its name.

    Args:
        source: path of the file, or one of `shipped_cameras`.
        wavelengths: (bands,) m, instead of those of the file, for a camera with measured spectral
            sensitivities.

    Returns:
        The camera.

    Raises:
        InputError: there is no such file, it is not TOML, or it holds an unknown key or a value
            outside its range.

    Example:
        >>> float(jv.read_camera("emva1288").sensor.bits)
        12.0
    """
    from .toml_files import read_toml

    file = _found(source)
    content, place = read_toml(file, "camera"), str(file)
    _check_keys(place, "", content, (*_TABLES, "bands", "about"))
    for name in _TABLES[:2]:
        if not isinstance(content.get(name), Mapping):
            raise InputError(f"{place}: the table [{name}] is missing; add it.")
    if wavelengths is None and "bands" in content:
        wavelengths = _wavelengths(place, content["bands"])
    tables = {name: content[name] for name in _TABLES if name in content}
    tables["view"] = {"position": [0, 0, 0], "rotation": np.eye(3)} | dict(content["view"])
    tables["sensor"] = _with_sensitivities(place, content["sensor"], wavelengths)
    return _record(place, "", Camera, tables)


def _found(source: str | os.PathLike[str]) -> Path:
    file = Path(source)
    if file.is_file():
        return file
    if str(source) in shipped_cameras():
        return _SHIPPED / f"{source}.toml"
    known = ", ".join(shipped_cameras())
    raise InputError(
        f"{file}: no such camera file; check the name and the folder, or use one of {known}."
    )


def _wavelengths(place: str, table: Any) -> Float[Array, " bands"]:
    if not isinstance(table, Mapping):
        raise InputError(f"{place}: bands must be a table of first, last and step.")
    _check_keys(place, "bands", table, _BANDS)
    if any(not isinstance(table.get(name), int | float) for name in _BANDS):
        raise InputError(f"{place}: bands needs the numbers first, last and step in m; give them.")
    try:
        return wavelength_grid(**{name: float(table[name]) for name in _BANDS})
    except InputError as error:
        raise InputError(f"{place}: bands: {error}") from error


def _with_sensitivities(
    place: str, sensor: Mapping[str, Any], wavelengths: Float[Array, " bands"] | None
) -> dict[str, Any]:
    """The table of the sensor, with numbers instead of the name of measured sensitivities."""
    table, colours = dict(sensor), sensor.get("colour_filter")
    if not isinstance(colours, Mapping) or "sensitivities" not in colours:
        return table
    colours = dict(colours)
    if wavelengths is None:
        raise InputError(f"{place}: sensitivities are over wavelengths; add a table [bands].")
    name, peak = colours.pop("sensitivities"), colours.pop("peak", None)
    if not isinstance(peak, int | float) or not 0 < peak <= 1:
        raise InputError(
            f"{place}: sensor.colour_filter.peak must be above 0 and at most 1 electrons per "
            f"photon, got {peak}."
        )
    try:
        per_watt = np.maximum(camera_sensitivities(name, wavelengths), 0)
    except InputError as error:
        raise InputError(f"{place}: sensor.colour_filter.sensitivities: {error}") from error
    # measured per radiant power; the energy of a photon falls with its wavelength
    per_photon = per_watt / np.asarray(wavelengths)[:, None]
    colours["transmission"] = (peak * per_photon / per_photon.max()).T
    conversion = table.get("photon_conversion", {})
    if isinstance(conversion, Mapping):
        table["photon_conversion"] = {"wavelength": wavelengths} | dict(conversion)
    table["colour_filter"] = colours
    return table


def _record(place: str, where: str, kind: type, table: Mapping[str, Any]) -> Any:
    """The record of that kind from its table; tables within it become records too."""
    hints = get_type_hints(kind)
    known = {field.name: field for field in fields(kind)}
    _check_keys(place, where, table, known)
    values = {}
    for name, value in table.items():
        inside = f"{where}.{name}".lstrip(".")
        if isinstance(value, Mapping):
            values[name] = _chosen_record(place, inside, hints[name], value)
        elif _holds_records_only(hints[name]):
            kinds = " or ".join(kind.__name__ for kind in _records(hints[name]))
            raise InputError(
                f"{place}: {inside} must be the table of a {kinds}, got {value!r}; head it "
                f"[{inside}]."
            )
        elif known[name].metadata.get("static"):
            values[name] = _static(place, inside, value)
        else:
            values[name] = _number(place, inside, value)
    for name, field in known.items():
        required = field.default is MISSING and field.default_factory is MISSING
        if required and name not in values:
            raise InputError(f"{place}: {where}.{name} is missing; add it.")
    try:
        return kind(**values)
    except (TypeError, ValueError) as error:
        raise InputError(f"{place}: {error}") from error


def _chosen_record(place: str, where: str, annotation: Any, table: Mapping[str, Any]) -> Any:
    """The record of a field: the only kind possible, or the one that the key `kind` names."""
    kinds = {kind.__name__: kind for kind in _records(annotation)}
    if not kinds:
        raise InputError(f"{place}: {where} is a number, not a table; write {where} = ....")
    rest = dict(table)
    name = rest.pop("kind", next(iter(kinds)) if len(kinds) == 1 else None)
    if name is None:
        raise InputError(f"{place}: {where}.kind is missing; use one of {', '.join(kinds)}.")
    if not isinstance(name, str) or name not in kinds:
        hint = nearest(str(name), kinds)
        raise InputError(f"{place}: {where}.kind = {name!r} is unknown; {hint}.")
    return _record(place, where, kinds[name], rest)


def _records(annotation: Any) -> tuple[type, ...]:
    """The records in an annotation, which may be a union."""
    if get_origin(annotation) in (Union, UnionType):
        return tuple(kind for part in get_args(annotation) for kind in _records(part))
    is_record = isinstance(annotation, type) and issubclass(annotation, eqx.Module)
    return (annotation,) if is_record else ()


def _holds_records_only(annotation: Any) -> bool:
    """Whether a field, apart from None, holds nothing but records."""
    parts = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    return all(part is type(None) or _records(part) for part in parts)


def _number(place: str, where: str, value: Any) -> Any:
    array = np.asarray(value, dtype=None if not isinstance(value, list) else object)
    numbers = array.ravel().tolist()
    if any(isinstance(x, bool) or not isinstance(x, int | float) for x in numbers):
        raise InputError(f"{place}: {where} = {value!r} must be a number or numbers; correct it.")
    try:
        return np.reshape([float(x) for x in numbers], array.shape)
    except OverflowError as error:
        raise InputError(f"{place}: {where} is out of the range of numbers; correct it.") from error


def _static(place: str, where: str, value: Any) -> Any:
    """A static value as its record has it: lists become tuples, and "RGGB" its pattern."""
    if where.endswith(".pattern") and isinstance(value, str):
        try:
            return bayer(value)
        except ValueError as error:
            raise InputError(f"{place}: {where}: {error}") from error
    if isinstance(value, list):
        return tuple(_static(place, where, part) for part in value)
    return value


def _check_keys(place: str, where: str, table: Mapping[str, Any], known: Any) -> None:
    for key in table:
        if key not in known:
            name = f"{where}.{key}".lstrip(".")
            hint = nearest(key, known)
            raise InputError(f"{place}: {name} is not a key of a camera file; {hint}.")
