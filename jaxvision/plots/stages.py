"""Plot the stages of a camera, from light to picture, as boxes."""

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..scene import Camera, Sensor
from .legible_axes import new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LENS = ("f_number", "aperture", "rim", "distortion", "diffraction")
_PRESENT, _ABSENT = "tab:blue", "0.75"
_COLUMNS = 5


def pipeline(camera: Camera | Sensor, *, axes: "Axes | None" = None) -> "Axes":
    """Plot the stages of a camera in the order in which light passes them, with absent stages in
    grey.

    The stages are the fields of the lens, the sensor and the development. A field that is None is
    an absent stage, which is not computed.

    Args:
        camera: the camera, or a sensor alone.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes, one box for each stage; no unit.

    Raises:
        InputError: for something else than a camera or a sensor.

    Example:
        >>> axes = jv.plots.pipeline(jv.read_camera("ideal"))
        >>> shown = {text.get_text(): text.get_color() for text in axes.texts}
        >>> print(shown["read noise"], shown["quantum efficiency"] != "0.75")
        0.75 True
    """
    if not isinstance(camera, Camera | Sensor):
        raise InputError(f"pipeline shows a Camera or a Sensor, got {type(camera).__name__}.")
    axes = new_axes(axes)
    row = 0.0
    for title, record, names in _stages(camera):
        axes.text(0, row, title, fontsize=9, fontweight="bold", va="center")
        for number, name in enumerate(names):
            down, across = divmod(number, _COLUMNS)
            value = getattr(record, name, None)
            absent = value is None or value is False or (isinstance(value, tuple) and not value)
            axes.text(
                across + 0.5,
                row + 0.7 * (down + 1),
                name.replace("_", " "),
                color=_ABSENT if absent else _PRESENT,
                fontsize=7,
                ha="center",
                va="center",
                bbox={"boxstyle": "round", "fc": "none", "ec": _ABSENT if absent else _PRESENT},
            )
        row += 0.7 * (-(-len(names) // _COLUMNS) + 1)
    axes.set(xlim=(0, _COLUMNS), ylim=(row, -0.5))
    axes.axis("off")
    return axes


def _stages(camera: Camera | Sensor) -> list[tuple[str, Any, list[str]]]:
    """Return the title, the record and the field names of the lens, the sensor and the
    development."""
    if isinstance(camera, Sensor):
        return [("sensor", camera, [field.name for field in fields(Sensor)])]
    stages: list[tuple[str, Any, list[str]]] = [("lens", camera.view, list(_LENS))]
    for title, record in (("sensor", camera.sensor), ("development", camera.development)):
        if record is not None:
            stages.append((title, record, [field.name for field in fields(type(record))]))
    return stages
