"""Settings of a camera: the gains and temperatures at which the frames of a rig were taken.

In the standard (EMVA 1288, release 4.0, section 2), gain, temperature and black level are the
camera's operating point, and a sheet applies to one operating point.
"""

from dataclasses import dataclass
from typing import Any, Literal

from jaxvision.errors import InputError

from ..rig import Rig, kelvin


@dataclass(frozen=True, order=True)
class Setting:
    """The gain and temperature at which frames were taken.

    Attributes:
        gain: as set on the camera; None where it is not stated.
        gain_unit: "ISO" for an ISO speed or another number that is proportional to the gain, "dB"
            for 20 log10 of such a number.
        temperature: of the sensor, K, at least 100; None where it is not stated.

    Example:
        >>> from fitting.noise import Setting
        >>> Setting(gain=6.0, gain_unit="dB", temperature=293.0).label
        '6 dB, 293 K'
    """

    gain: float | None = None
    gain_unit: Literal["ISO", "dB"] = "ISO"
    temperature: float | None = None

    def __post_init__(self) -> None:
        try:
            if self.temperature is not None:
                kelvin(self.temperature)
        except ValueError as error:
            raise InputError(f"Setting: {error}.") from None

    @property
    def gain_factor(self) -> float:
        """The stated gain as a linear factor, to which the gain in DN/e- should be proportional."""
        gain = 1.0 if self.gain is None else self.gain
        return gain if self.gain_unit == "ISO" or self.gain is None else 10 ** (gain / 20)

    @property
    def gain_label(self) -> str:
        if self.gain is None:
            return ""
        return f"ISO {self.gain:g}" if self.gain_unit == "ISO" else f"{self.gain:g} dB"

    @property
    def temperature_label(self) -> str:
        return "" if self.temperature is None else f"{self.temperature:g} K"

    @property
    def label(self) -> str:
        return ", ".join(part for part in (self.gain_label, self.temperature_label) if part)


def split_by_setting(rig: Rig) -> dict[Setting, Rig]:
    """Split a rig into one rig for each gain and temperature."""
    settings: dict[Setting, dict[str, tuple[Any, ...]]] = {}
    for kind in ("flat", "dark"):
        for entry in getattr(rig, kind):
            gain = entry.iso if entry.gain_db is None else entry.gain_db
            warmth = entry.temperature or rig.camera.temperature
            setting = Setting(gain, "ISO" if entry.gain_db is None else "dB", warmth)
            own = settings.setdefault(setting, {"flat": (), "dark": ()})
            own[kind] = (*own[kind], entry)
    for name, word in (("gain", "iso (or gain_db)"), ("temperature", "temperature")):
        if len({getattr(setting, name) is None for setting in settings}) > 1:
            raise InputError(
                f"{rig.folder}: some flats or darks state their {name} and others do not; give "
                f"every one its {word}."
            )
    if len({setting.gain_unit for setting in settings if setting.gain is not None}) > 1:
        raise InputError(f"{rig.folder}: gains are stated as iso and as gain_db; use one of them.")
    order = sorted(settings, key=lambda one: (one.gain_factor, one.temperature or 0))
    return {setting: rig.model_copy(update=settings[setting]) for setting in order}


def require_one_setting(rig: Rig, remedy: str) -> None:
    """Raise InputError if a rig has flats or darks of several gains or temperatures."""
    settings = list(split_by_setting(rig))
    if len(settings) > 1:
        labels = "; ".join(setting.label for setting in settings)
        raise InputError(
            f"{rig.folder}: flats and darks are of {len(settings)} settings ({labels}); {remedy}."
        )
