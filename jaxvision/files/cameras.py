"""Read and write cameras as TOML files, with one table for each record and the record's fields as
keys.

    [view]
    kind = "Pinhole"              # name of the record, where several are possible
    focal_length = 8e-3           # units as in the records: SI, electrons, DN
    pixel_pitch = 4.8e-6
    resolution = [480, 640]

    [sensor]
    gain = 0.28
    [sensor.shot_noise]
    kind = "PoissonShotNoise"

A view without `position` and `rotation` is at the origin and looks along +z, with +x to its right
and +y downward. Instead of a `transmission`, `[sensor.colour_filter]` may name measured
sensitivities of the package colour-science, such as `sensitivities = "Nikon 5100 (NPL)"`, with
`peak`, the largest number of electrons per photon of any band. The table `[bands]` then gives the
wavelengths by `first`, `last` and `step`, in m. A Bayer `pattern` may be written as "RGGB". The key
`about` holds free text.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..colour_spaces.colour_data import camera_sensitivities, wavelength_grid
from ..core._types import require_metres
from ..core._warnings import warn
from ..scene import Camera, Sensor
from .records import Reading, attach_draws, check_keys, record_of, table_of, write_record
from .shipped import existing_file, shipped_files

_TABLES = ("view", "sensor", "development")
_BANDS = ("first", "last", "step")


def shipped_cameras() -> tuple[str, ...]:
    """List the names of the cameras that come with the library.

    Returns:
        The names, sorted.

    Example:
        >>> jv.shipped_cameras()
        ('ccd', 'cmos', 'consumer_bayer', 'emva1288', 'ideal')
    """
    return shipped_files("camera")


def read_camera(
    source: str | os.PathLike[str],
    *,
    wavelengths: Float[Array, " bands"] | None = None,
    draws: int | None = None,
) -> Camera:
    """Read a camera from a TOML file, or a shipped camera by its name.

    Args:
        source: path of the file, or one of `shipped_cameras`.
        wavelengths: (bands,) m, used in place of the wavelengths in the file, for a camera with
            measured spectral sensitivities.
        draws: number of draws of a fitted camera, which are stored in a second file next to it;
            None for the best fit.

    Returns:
        The camera; with draws, every number of it has a leading axis, for `jax.vmap`.

    Raises:
        InputError: there is no such file, it is not TOML, or it holds an unknown key or a value
            outside its range.

    Example:
        >>> float(jv.read_camera("emva1288").sensor.bits)
        12.0
    """
    from .toml import read_toml

    file = existing_file(source, "camera")
    content, reading = read_toml(file, "camera"), Reading(str(file), "camera")
    check_keys(reading, "", content, (*_TABLES, "bands", "about"))
    for name in _TABLES[:2]:
        if not isinstance(content.get(name), Mapping):
            raise reading.wrong(f"the table [{name}] is missing; add it.")
    if wavelengths is not None:
        require_metres("read_camera: wavelength", np.asarray(wavelengths, float))
    elif "bands" in content:
        wavelengths = _wavelengths(reading, content["bands"])
    colours = content["sensor"].get("colour_filter")
    if "bands" in content and not (isinstance(colours, Mapping) and "sensitivities" in colours):
        warn(f"{file}: bands has no effect without sensor.colour_filter.sensitivities.")
    tables = {name: content[name] for name in _TABLES if name in content}
    tables["view"] = {"position": [0, 0, 0], "rotation": np.eye(3)} | dict(content["view"])
    tables["sensor"] = _fill_sensitivities(reading, content["sensor"], wavelengths)
    camera = record_of(reading, "", Camera, tables)
    return camera if draws is None else attach_draws(file, camera, draws)


def write_camera(
    camera: Camera, file: str | os.PathLike[str], *, draws: Camera | None = None, about: str = ""
) -> None:
    """Write a camera to a TOML file; `read_camera` reads it back with exactly the same numbers.

    Args:
        camera: the camera to write, for example the best fit.
        file: path of the file, ending in .toml; missing folders are created.
        draws: the same camera with a leading axis of draws at every number; they are written to a
            file beside it, ending in .npz.
        about: comment on its origin.

    Raises:
        InputError: for draws of another camera, and a file name with another ending.

    Example:
        >>> from tempfile import mkdtemp
        >>> file, camera = mkdtemp() + "/mine.toml", jv.read_camera("emva1288")
        >>> jv.write_camera(camera, file)
        >>> float(jv.read_camera(file).sensor.gain) == float(camera.sensor.gain)
        True
    """
    content = table_of(camera)
    del content["kind"]
    content = ({"about": about} if about else {}) | content
    write_record(file, "camera", content, camera, draws)


def read_sensor(source: str | os.PathLike[str], *, draws: int | None = None) -> Sensor:
    """Read a sensor from a TOML file that has only the table `[sensor]`.

    Args:
        source: path of the file.
        draws: number of draws of a fitted sensor, which are stored in a second file next to it;
            None for the best fit.

    Returns:
        The sensor; with draws, every number of it has a leading axis, for `jax.vmap`.

    Raises:
        InputError: there is no such file, or it holds an unknown key or a value out of range.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/sensor.toml"
        >>> with open(file, "w") as text:
        ...     print("[sensor]", file=text)
        ...     print("quantum_efficiency = 0.6", file=text)
        >>> jv.read_sensor(file)
        Sensor(quantum_efficiency=0.6)
    """
    from .toml import read_toml

    file = Path(source)
    content, reading = read_toml(file, "sensor"), Reading(str(file), "sensor")
    check_keys(reading, "", content, ("sensor", "about"))
    if not isinstance(content.get("sensor"), Mapping):
        raise reading.wrong("the table [sensor] is missing; add it.")
    table = {name: value for name, value in content["sensor"].items() if name != "kind"}
    sensor = record_of(reading, "sensor", Sensor, table)
    return sensor if draws is None else attach_draws(file, sensor, draws)


def write_sensor(
    sensor: Sensor, file: str | os.PathLike[str], *, draws: Sensor | None = None, about: str = ""
) -> None:
    """Write a sensor to a TOML file; `read_sensor` reads it back with exactly the same numbers.

    Args:
        sensor: the sensor to write, for example the best fit.
        file: path of the file, ending in .toml; missing folders are created.
        draws: the same sensor with a leading axis of draws at every number; they are written to a
            file beside it, ending in .npz.
        about: comment on its origin.

    Raises:
        InputError: for draws of another sensor, and a file name with another ending.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/sensor.toml"
        >>> jv.write_sensor(jv.Sensor(read_noise=4.0, gain=0.5), file)
        >>> jv.read_sensor(file)
        Sensor(read_noise=4, gain=0.5)
    """
    content = ({"about": about} if about else {}) | {"sensor": table_of(sensor)}
    write_record(file, "sensor", content, sensor, draws)


def _wavelengths(reading: Reading, table: Any) -> Float[Array, " bands"]:
    if not isinstance(table, Mapping):
        raise reading.wrong("bands must be a table of first, last and step.")
    check_keys(reading, "bands", table, _BANDS)
    if any(not isinstance(table.get(name), int | float) for name in _BANDS):
        raise reading.wrong("bands needs the numbers first, last and step in m; give them.")
    with reading.placed("bands"):
        return wavelength_grid(**{name: float(table[name]) for name in _BANDS})


def _fill_sensitivities(
    reading: Reading, sensor: Mapping[str, Any], wavelengths: Float[Array, " bands"] | None
) -> dict[str, Any]:
    """Return the table `[sensor]` with numbers in place of named sensitivities."""
    table, colours = dict(sensor), sensor.get("colour_filter")
    if not isinstance(colours, Mapping) or "sensitivities" not in colours:
        return table
    colours = dict(colours)
    if wavelengths is None:
        raise reading.wrong("sensitivities are over wavelengths; add a table [bands].")
    name, peak = colours.pop("sensitivities"), colours.pop("peak", None)
    if not isinstance(peak, int | float) or not 0 < peak <= 1:
        raise reading.wrong(
            "sensor.colour_filter.peak must be above 0 and at most 1 electrons per photon, got "
            f"{peak}."
        )
    with reading.placed("sensor.colour_filter.sensitivities"):
        per_watt = np.maximum(camera_sensitivities(name, wavelengths), 0)
    # measured per radiant power; the energy of a photon falls with its wavelength
    per_photon = per_watt / np.asarray(wavelengths)[:, None]
    colours["transmission"] = (peak * per_photon / per_photon.max()).T
    conversion = table.get("photon_conversion", {})
    if isinstance(conversion, Mapping):
        table["photon_conversion"] = {"wavelength": wavelengths} | dict(conversion)
    table["colour_filter"] = colours
    return table
