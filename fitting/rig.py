"""Read `rig.toml`, which describes each file of a calibration folder.

The classes below document the format of the file. Paths in it are relative to the rig file, or to
its `root`, in which `${NAME}` is an environment variable. The whole file is checked before any
image is read. A mistake raises an `InputError` that names the file, the entry and the remedy.
"""

import datetime
import math
import os
import warnings
from collections import Counter
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from jaxvision.errors import InputError
from jaxvision.files.toml import (
    Count,
    Entry,
    Finite,
    NonNegative,
    Positive,
    Vector,
    checked,
    read_toml,
)

RIG_FILE = "rig.toml"

Purpose = Literal["photon transfer", "a response calibration", "a reflectance calibration"]
NEEDED: dict[Purpose, tuple[str, ...]] = {  # sections of a rig that each calibration needs
    "photon transfer": ("flat", "dark"),
    "a response calibration": ("exposure",),
    "a reflectance calibration": ("light", "geometry"),
}


def _quotient(text: Any) -> Any:
    """Return a time such as "1/8" as a number; any other value unchanged."""
    try:
        return float(Fraction(text)) if isinstance(text, str) else text
    except (ValueError, ZeroDivisionError):
        raise ValueError(f'{text!r} is no time; write seconds, as in 0.125 or "1/8"') from None


Index = Annotated[int, Field(strict=True, ge=0, lt=2**31)]
Seconds = Annotated[Positive, BeforeValidator(_quotient)]
SecondsFromZero = Annotated[NonNegative, BeforeValidator(_quotient)]

UNKNOWN_DIRECTION = 0.5  # rad; an error this large means that the direction is unknown
LONGEST = 1e-3  # m, of a wavelength or a pixel; larger numbers are in nm or um
COLDEST = 100.0  # K, lowest sensor temperature; a smaller number is in degrees Celsius


def kelvin(temperature: float) -> float:
    """Return a sensor temperature in K, or refuse it if no sensor can be so cold."""
    if not temperature >= COLDEST:
        raise ValueError(
            f"{temperature:g} K is no temperature of a camera; give kelvin, 293.15 for 20 °C"
        )
    return temperature


Kelvin = Annotated[Finite, AfterValidator(kelvin)]


def _metres(length: float) -> float:
    """Refuse a wavelength or a pixel pitch that is not in metres."""
    if length > LONGEST:
        raise ValueError(f"{length:g} m is too long; give metres, 550e-9 for 550 nm, 5e-6 for 5 um")
    return length


Metres = Annotated[Positive, AfterValidator(_metres)]


def _plain(value: Any) -> Any:
    """Return an array as nested lists for a rig file; any other value unchanged."""
    of_a_file = (int, float, str, type(None))
    parts = value if isinstance(value, list | tuple) else [value]
    if all(isinstance(part, of_a_file) for part in parts):
        return value
    from jaxvision.core.plain_arrays import plain_array  # imports NumPy

    try:
        value = plain_array("this", value)
    except InputError as error:  # pydantic names the field
        raise ValueError(str(error).removesuffix(".")) from None
    return value.tolist() if hasattr(value, "tolist") else value


def _tag(value: Any) -> str:
    return "several" if isinstance(value, list | tuple) or getattr(value, "ndim", 0) else "one"


Number = TypeVar("Number")
BySite = Annotated[  # one number, or one for each site of the repeating cell
    Annotated[Number, Tag("one")]
    | Annotated[tuple[Number, ...], Field(min_length=1), Tag("several")],
    Discriminator(_tag),
    BeforeValidator(_plain),
]

BY_SITE = ("black_level", "saturation", "gain", "read_noise")
PARTS = {  # parts of a frame, each read by one amplifier: rows and columns of parts
    "left and right": (1, 2),
    "top and bottom": (2, 1),
    "quadrants": (2, 2),
}


def _part_or_period(taps: Any) -> Any:
    if isinstance(taps, list | tuple) or taps in PARTS:
        return taps
    parts = ", ".join(f'"{part}"' for part in PARTS)
    raise ValueError(
        f"{taps!r} are no taps; give rows and columns, as in [1, 2], or one of {parts}"
    )


Taps = Annotated[
    tuple[Count, Count] | Literal["left and right", "top and bottom", "quadrants"],
    BeforeValidator(_part_or_period),
]
COLOURS = ("red", "green", "blue")  # channels of an RGB image
MOSAIC_NAMES = {"R": ("red",), "G": ("green 1", "green 2"), "B": ("blue",)}


class _Known(Entry):
    """The stated values of a camera that are the same at all sites.

    Unless both gain and read_noise are stated, a fit estimates the noise of pixels from their
    residuals. An `_sd` is the standard deviation of a stated number, which otherwise counts as
    exact.

    Attributes:
        bits: ADC bits of the digital numbers in the files, 1 to 16; 12-bit data may lie in 16-bit
            files.
        gamma: encoding exponent of the files; 1 is linear.
        pixel_pitch: m.
        wavelength: of the monochromatic light of the flats, m.
        black_sd: standard deviation of the black level, DN.
        gamma_sd: standard deviation of the encoding exponent.
        gain_sd: standard deviation of the gain, DN per electron.
        read_noise_sd: standard deviation of the read noise, electrons rms.
        prnu_sd: standard deviation of the pixels' gains relative to their mean, after flat-field
            correction; 0 if pixels are equal.
        date: when the images were taken; studies of many cameras test for drift with it.
        temperature: of the sensor, K; studies of many cameras test for drift with it.
    """

    bits: Annotated[Count, Field(le=16)]
    gamma: Positive | None = None
    pixel_pitch: Metres | None = None
    wavelength: Metres | None = None
    black_sd: Positive | None = None
    gamma_sd: Positive | None = None
    gain_sd: Positive | None = None
    read_noise_sd: Positive | None = None
    prnu_sd: NonNegative | None = None
    date: datetime.date | None = None
    temperature: Kelvin | None = None

    @model_validator(mode="after")
    def _check_errors(self) -> "_Known":
        for name in ("gamma", "gain", "read_noise"):
            if getattr(self, f"{name}_sd") is not None and getattr(self, name) is None:
                raise ValueError(f"{name}_sd without {name}; give both, or neither")
        return self

    @property
    def encoding(self) -> float | None:
        """Return the encoding exponent gamma; None if unstated or surely linear."""
        return None if self.gamma == 1 and self.gamma_sd is None else self.gamma

    @property
    def full_scale(self) -> int:
        return 2**self.bits - 1


class SiteCamera(_Known):
    """The stated values of a camera at one of its sites, or at all sites if they are equal.

    Attributes:
        black_level: DN without light.
        saturation: DN from which a pixel counts as clipped (default: 2^bits - 1).
        gain: DN per electron.
        read_noise: electrons rms.
    """

    black_level: NonNegative | None = None
    saturation: Positive | None = None
    gain: Positive | None = None
    read_noise: NonNegative | None = None

    @property
    def clip_level(self) -> float:
        return float(self.full_scale) if self.saturation is None else self.saturation


class Camera(_Known):
    """`[camera]`: the known values of the camera. Leave unknown values out.

    Neighbouring pixels may differ in the colours of a mosaic (`pattern`), and in the amplifiers
    that read them (`taps`). Both repeat after a cell whose rows and columns are the least common
    multiples of 2 x 2 and `taps`. black_level, saturation, gain and read_noise are each one number,
    or a list with one number for each site of this cell, in reading order from the first pixel of
    the whole frame: `black_level = [480, 512, 512, 560]` for a mosaic. For RGB images the list has
    three numbers, or three for each site. If each part of a frame has its own amplifier, imagine
    the cells of the parts side by side: the first row of the left cell comes first, then the first
    row of the right cell.

    Attributes:
        black_level: DN without light.
        saturation: DN from which a pixel counts as clipped (default: 2^bits - 1).
        gain: DN per electron.
        read_noise: electrons rms.
        pattern: phase of a Bayer mosaic.
        taps: rows and columns after which the readout amplifiers repeat; [1, 2] if even and odd
            columns have different amplifiers. Or the parts of the frame with one amplifier each:
            "left and right", "top and bottom" or "quadrants".
        region: top, left, height and width, in pixels, of the used part of each frame, for example
            one half of a chip with two amplifiers.
        sensor: file of a calibrated sensor, `sensor.toml` of `jaxvision-fit noise`. It supplies
            black_level, gain, read_noise and prnu_sd where they are missing here, with standard
            deviations from its draws. Its codes must be those of the images.
    """

    black_level: BySite[NonNegative] | None = None
    saturation: BySite[Positive] | None = None
    gain: BySite[Positive] | None = None
    read_noise: BySite[NonNegative] | None = None
    pattern: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None
    taps: Taps | None = None
    region: tuple[Index, Index, Count, Count] | None = None
    sensor: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _insert_sensor(cls, content: Any) -> Any:
        if not isinstance(content, dict) or not isinstance(content.get("sensor"), str):
            return content
        try:
            stated = {key: content[key] for key in ("pattern", "taps") if key in content}
            measured = _values_of_sensor(Path(content["sensor"]), stated)
        except InputError as error:
            raise ValueError(str(error).removesuffix(".")) from error
        for name, numbers in measured.items():
            if content.get(name) is None:
                content = content | numbers
        return content

    @model_validator(mode="after")
    def _one_a_site(self) -> "Camera":
        sites = len(self.sites)
        if self.taps == (1, 1):
            raise ValueError("taps = [1, 1] repeat at every pixel and separate nothing; remove it")
        if self.has_tap_regions and self.region:
            raise ValueError(
                f'taps = "{self.taps}" are parts of a whole frame and exclude a region; give one '
                "part at a time as the region, without taps"
            )
        for name in BY_SITE:
            values = getattr(self, name)
            if not isinstance(values, tuple) or len(values) in self._lengths:
                continue
            lengths = " or ".join(map(str, self._lengths))
            cell = f"the cell of {self.cell[0]} x {self.cell[1]} pixels that pattern and taps make"
            where = f'taps = "{self.taps}"' if self.has_tap_regions and not self.pattern else cell
            if self.has_tap_regions and self.pattern:
                where = f'a mosaic with taps = "{self.taps}"'
            raise ValueError(
                f"{name} lists {len(values)} numbers, but {where} has {sites} "
                f"site{'s' * (sites > 1)}; give one number, or {lengths} in reading order"
            )
        return self

    @property
    def _lengths(self) -> tuple[int, ...]:
        sites = len(self.sites)
        colours = () if self.pattern else (len(COLOURS) * sites,)
        return tuple(length for length in (sites, *colours) if length > 1)

    @property
    def has_tap_regions(self) -> bool:
        """Return whether each amplifier reads its own contiguous part of the frame."""
        return isinstance(self.taps, str)

    @property
    def in_parts(self) -> bool:
        """Former name of `has_tap_regions`."""
        warnings.warn("in_parts is now has_tap_regions.", DeprecationWarning, stacklevel=2)
        return self.has_tap_regions

    @property
    def layout(self) -> tuple[int, int]:
        """Return the number of rows and columns of sites: the size of the cell or, if the frame has
        parts, of the cells of all parts side by side.
        """
        (down, across), (rows, columns) = self.cell, PARTS.get(str(self.taps), (1, 1))
        return down * rows, across * columns

    def places(self, height: int, width: int) -> list[tuple[slice, slice]]:
        """Return the rows and columns of each site as slices, in the order of `sites`, within the
        region or frame.
        """
        parts, (top, left) = PARTS.get(str(self.taps), (1, 1)), (self.region or (0, 0))[:2]

        def lines(size: int, parts: int, period: int, first: int) -> list[slice]:
            ends = [-(-size * i // parts) for i in range(parts + 1)]
            return [
                slice(start + (phase - first - start) % period, end, period)
                for start, end in pairwise(ends)
                for phase in range(period)
            ]

        rows = lines(height, parts[0], self.cell[0], top)
        return [(row, own) for row in rows for own in lines(width, parts[1], self.cell[1], left)]

    @property
    def cell(self) -> tuple[int, int]:
        """Return the period of the sites in rows and columns, within a part if the frame has parts;
        (1, 1) if sites do not repeat.
        """
        down, across = (1, 1) if self.taps is None or isinstance(self.taps, str) else self.taps
        return (math.lcm(down, 2), math.lcm(across, 2)) if self.pattern else (down, across)

    @property
    def sites(self) -> tuple[str, ...]:
        """Return the names of the sites, in reading order. The name is `grey` for a single site. It
        is `tap 0,1` (row and column in the cell) for several taps, and `tap top left` and the like
        for parts of a frame. For a mosaic it is `red`, `green 1`, `green 2` or `blue`, and `red tap
        0,2` or `red tap left` if several taps read a colour.
        """
        (rows, columns), (down, across) = self.layout, self.cell
        places = [(row, column) for row in range(rows) for column in range(columns)]
        if isinstance(self.taps, str):
            of_rows = (" top", " bottom") if rows > down else ("",)
            of_columns = (" left", " right") if columns > across else ("",)
            taps = [f"tap{of_rows[i // down]}{of_columns[j // across]}" for i, j in places]
        elif self.taps is not None:
            taps = [f"tap {row % self.taps[0]},{column % self.taps[1]}" for row, column in places]
        else:
            taps = [""] * len(places)
        if self.pattern is None:
            return ("grey",) if self.taps is None else tuple(taps)
        of_mosaic = _mosaic_sites(self.pattern)
        own = [of_mosaic[row % 2][column % 2] for row, column in places]
        alone = len(own) == 4
        return tuple(o if alone else f"{o} {tap}" for o, tap in zip(own, taps, strict=True))

    def at(self, channel: str) -> SiteCamera:
        """Return the known values of one site.

        Args:
            channel: a name in `sites`; for RGB images also `red`, `green` or `blue`, before the
                name of a tap where there are several.

        Returns:
            The camera of that channel, with one number for each property.

        Raises:
            ValueError: for an unknown name.
        """
        known: dict[str, Any] = self.model_dump(include=set(_Known.model_fields))
        known |= {name: self._number(name, channel) for name in BY_SITE}
        return SiteCamera(**known)

    def channels(self, *, colour: bool) -> tuple[str, ...]:
        """Return the names of the planes of one frame.

        Args:
            colour: whether frames are RGB images.

        Returns:
            `sites`; for RGB images three names for each site: `red`, or `red tap 0,1` and the like.
        """
        if not colour:
            return self.sites
        of_site = {site: "" if site == "grey" else f" {site}" for site in self.sites}
        return tuple(f"{name}{of_site[site]}" for site in self.sites for name in COLOURS)

    def _number(self, name: str, channel: str) -> float | None:
        names = self.sites if channel in self.sites else self.channels(colour=True)
        if channel not in names:
            raise ValueError(f"{channel!r} is no channel of the camera; use {', '.join(names)}")
        values = getattr(self, name)
        if not isinstance(values, tuple):
            return values
        if len(values) not in (len(names), len(self.sites)):
            raise ValueError(f"{name} lists {len(values)} numbers for {len(names)} channels")
        place = names.index(channel)
        return values[place if len(values) == len(names) else place // len(COLOURS)]


def _values_of_sensor(file: Path, stated: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the values in a sensor file, by the rig's key that they replace. If the sensor has
    taps, the values are lists, and the rig must have `stated` the same pattern and taps. Standard
    deviations come from the draws in the file next to it.
    """
    import numpy as np

    from jaxvision.files.cameras import read_sensor
    from jaxvision.files.records import count_draws

    best, count = read_sensor(file), count_draws(file)
    draws = read_sensor(file, draws=count) if count else None
    taps, tile = best.taps, [0]
    if taps is not None:
        tile = np.ravel(taps.pattern)
        names = () if taps.names is None else tuple(taps.names[i] for i in tile)
        if names != Camera(bits=16, **stated).sites:
            raise InputError(
                f"{file} has {len(set(tile))} taps, {', '.join(names) or 'without names'}; state "
                "camera.pattern and camera.taps as its calibration had them, or give black_level, "
                "gain and read_noise in place of sensor"
            )

    def rms(sensor: Any, *names: str) -> Any:
        parts = [getattr(sensor, name) for name in names]
        squares = [np.asarray(part, float) ** 2 for part in parts if part is not None]
        return np.sqrt(sum(squares)) if squares else None

    of_names: dict[str, tuple[str, tuple[str, ...]]] = {
        "black_level": ("black_sd", ("offset",)),
        "gain": ("gain_sd", ("gain",)),
        "read_noise": (
            "read_noise_sd",
            ("read_noise", "row_noise", "column_noise", "frame_noise"),
        ),
        "prnu_sd": ("", ("prnu", "column_prnu")),
    }
    found = {}
    for key, (error, names) in of_names.items():
        value = rms(best, *names)
        if value is None:
            continue
        found[key] = {key: float(value)}
        factors = getattr(taps, names[0], None)
        if factors is not None and key == "black_level":
            found[key] = {key: (float(value) + np.asarray(factors)[tile]).tolist()}
        elif factors is not None and key in BY_SITE:
            own = np.asarray(factors)[tile] * float(rms(best, names[0]))
            beside = rms(best, *names[1:])
            found[key] = {key: np.hypot(own, 0.0 if beside is None else beside).tolist()}
        spread = 0.0 if draws is None else float(np.std(rms(draws, *names)))
        if error and spread > 0:
            found[key][error] = spread
    return found


def _mosaic_sites(pattern: str) -> tuple[tuple[str, str], tuple[str, str]]:
    left = {letter: list(names) for letter, names in MOSAIC_NAMES.items()}
    first, second, third, fourth = (left[letter].pop(0) for letter in pattern)
    return (first, second), (third, fourth)


class Level(Entry):
    """The keys that entries of flats and of darks share.

    A rig may contain frames taken at several gains and temperatures. All its entries then state
    their gain by the same key.

    Attributes:
        files: names.
        exposure: s, or as "1/8"; 0 for a bias frame, or where the light comes from a flash.
        iso: ISO speed at which the frames were taken.
        gain_db: gain at which the frames were taken, dB, instead of an ISO speed.
        temperature: K, of the sensor (default: the camera's temperature).
    """

    files: Annotated[tuple[str, ...], Field(min_length=2)]
    exposure: SecondsFromZero
    iso: Positive | None = None
    gain_db: Finite | None = None
    temperature: Kelvin | None = None

    @model_validator(mode="after")
    def _check_gain(self) -> "Level":
        if self.iso is not None and self.gain_db is not None:
            raise ValueError("give either iso or gain_db")
        return self


class Flat(Level):
    """`[[flat]]`: two or more images of one uniform field.

    Photons or irradiance are needed only for the quantum efficiency.

    Attributes:
        photons: mean number of photons per pixel and exposure.
        irradiance: W m^-2 on the sensor (with the camera's pixel_pitch and wavelength).
    """

    photons: NonNegative | None = None
    irradiance: NonNegative | None = None


class Dark(Level):
    """`[[dark]]`: two or more images without light."""


class Exposure(Entry):
    """`[[exposure]]`: one image of an exposure stack of a still scene. Colour channels are fitted
    separately.

    Attributes:
        file: name.
        exposure: s, or as "1/8".
        group: name that separates stacks (an illumination band).
        exposure_sd: relative standard deviation of the exposure.
    """

    file: str
    exposure: Seconds
    group: str = ""
    exposure_sd: Positive | None = None


class Light(Entry):
    """`[[light]]`: one image of the object under one light, which has either a direction or a
    position.

    Attributes:
        file: name.
        direction: unit vector from the object toward a distant light.
        position: m, from the centre of the sphere (then `[geometry]` needs a sphere in metres).
        intensity: irradiance on a surface facing the light (W m^-2 or relative), or the radiant
            intensity of a point light; one number, or a list of one for each channel.
        held_out: whether to use this image only to test predictions.
        intensity_sd: relative standard deviation of the intensity.
        direction_sd: standard deviation of the direction, rad along each of two axes perpendicular
            to it.
        exposure_sd: relative standard deviation of the image's exposure.
        stray_sd: rms of stray light on every pixel, relative to the irradiance of this light.
    """

    file: str
    direction: Vector | None = None
    position: Vector | None = None
    intensity: Annotated[
        tuple[Positive, ...],
        Field(min_length=1),
        BeforeValidator(lambda value: (value,) if isinstance(value, int | float) else value),
    ] = (1.0,)
    held_out: bool = False
    intensity_sd: Positive | None = None
    direction_sd: Positive | None = None
    exposure_sd: Positive | None = None
    stray_sd: Positive | None = None

    @model_validator(mode="after")
    def _check_place(self) -> "Light":
        if (self.direction is None) == (self.position is None):
            raise ValueError("give either direction or position")
        if (self.direction_sd or 0) > UNKNOWN_DIRECTION:
            raise ValueError(
                f"direction_sd = {self.direction_sd:g} rad leaves the direction unknown; give it "
                "in radians"
            )
        for name in ("intensity_sd", "exposure_sd", "stray_sd"):
            relative = getattr(self, name) or 0.0
            if relative >= 1:
                raise ValueError(
                    f"{name} = {relative:g} is relative: give {relative / 100:g} for {relative:g} %"
                )
        if self.direction is not None:
            length = math.hypot(*self.direction)
            if abs(length - 1) > 1e-2:
                raise ValueError(
                    f"direction has length {length:.4g}, not 1; give a unit vector toward the light"
                )
        return self


class SphereGeometry(Entry):
    """A sphere seen orthographically along -z (x right, y up, z toward the camera).

    Attributes:
        centre: (column, row) in pixels, pixel centres at integers.
        radius: pixels.
        radius_m: m, for point lights.
    """

    centre: tuple[Finite, Finite]
    radius: Positive
    radius_m: Positive | None = None


class Geometry(Entry):
    """`[geometry]`: either a sphere or a file of normals.

    Attributes:
        sphere: in orthographic projection.
        normals: an (h, w, 3) `.npy` or EXR file; x right, y up, z toward the camera.
        mask: an image that is non-zero where the object is.
    """

    sphere: SphereGeometry | None = None
    normals: str | None = None
    mask: str | None = None

    @model_validator(mode="after")
    def _check_shape(self) -> "Geometry":
        if (self.sphere is None) == (self.normals is None):
            raise ValueError("give either sphere or normals")
        return self


class Rig(Entry):
    """The contents of a rig file.

    Attributes:
        folder: folder to which its paths are relative.
        camera: known values of the camera that took the images.
        root: folder of the images, relative to `folder`; `${NAME}` is an environment variable.
        flat: frames for the noise calibration.
        dark: frames for the noise calibration, and for the black level of a response.
        exposure: images for the response calibration.
        light: images for the reflectance calibration.
        geometry: shape of the object, for the reflectance calibration.
        covariance: file with the joint covariance of all lights, `lights.npz` as `jaxvision-fit
            lights` writes it, next to the rig; it replaces `direction_sd`.
    """

    folder: Path
    camera: Camera
    root: str = "."
    flat: tuple[Flat, ...] = ()
    dark: tuple[Dark, ...] = ()
    exposure: tuple[Exposure, ...] = ()
    light: tuple[Light, ...] = ()
    geometry: Geometry | None = None
    covariance: str | None = None

    @model_validator(mode="after")
    def _check_errors(self) -> "Rig":
        if self.covariance is not None and any(light.direction_sd for light in self.light):
            raise ValueError("give either covariance or the direction_sd of lights")
        return self

    @model_validator(mode="after")
    def _each_file_once(self) -> "Rig":
        entries = {"flat": (*self.flat, *self.dark), "exposure": self.exposure, "light": self.light}
        for kind, listed in entries.items():
            which = "[[flat]] and [[dark]]" if kind == "flat" else f"[[{kind}]]"
            try:
                require_one_file_each(which, [name for entry in listed for name in _images(entry)])
            except InputError as error:  # pydantic adds the point
                raise ValueError(str(error).removesuffix(".")) from None
        return self

    def path(self, name: str) -> Path:
        """Return the path of a file that the rig names."""
        return self.folder / os.path.expandvars(self.root) / name


def require_one_file_each(where: str, names: Sequence[str]) -> None:
    """Refuse a file that is listed twice, and files of one name in two formats."""
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(
            f"{', '.join(twice[:3])} stands more than once in {where}; list each file once."
        )
    formats = {name: Path(name).suffix for name in names}
    stems = {n: n.removesuffix(end) if end[1:2].isalpha() else n for n, end in formats.items()}
    counts = Counter(stems.values())
    if alike := [name for name in names if counts[stems[name]] > 1]:
        same = [name for name in alike if stems[name] == stems[alike[0]]]
        raise InputError(
            f"{' and '.join(same)} in {where} are files of one name, as of one photograph in two "
            "formats; list the one with the camera's own numbers, or rename one if they are two "
            "exposures."
        )


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """Read and check a rig.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from fitting.rig import load_rig
        >>> with TemporaryDirectory() as folder:
        ...     _ = (Path(folder) / "rig.toml").write_text("camera = {bits = 12, black_level = 64}")
        ...     camera = load_rig(folder).camera
        >>> print(camera.full_scale, camera.black_level)  # DN
        4095 64.0
    """
    file = Path(path)
    if file.is_dir():
        file = file / RIG_FILE
    if not file.is_file():
        if not file.suffix:
            raise InputError(f"{file}: no such rig file, and no such folder; check the name.")
        raise InputError(
            f"{file}: no such rig file; write one that says what each image is (see the README; "
            "`jaxvision-fit init FOLDER` begins it), or give the folder that holds it."
        )
    content = read_toml(file, "rig")
    if "folder" in content:
        raise InputError(f"{file}: `folder` is not a key of a rig file; remove it.")
    if isinstance(camera := content.get("camera"), dict) and isinstance(camera.get("sensor"), str):
        content = {**content, "camera": camera | {"sensor": str(file.parent / camera["sensor"])}}
    return checked(file, {"folder": file.parent, **content}, Rig, "rig")


def as_rig(given: Rig | str | os.PathLike[str]) -> Rig:
    """Return a rig unchanged, or read it from its folder or file."""
    return given if isinstance(given, Rig) else load_rig(given)


def require(rig: Rig, purpose: Purpose) -> None:
    """Refuse a rig without a section that a calibration needs."""
    for section in NEEDED[purpose]:
        if not getattr(rig, section):
            heading = f"[{section}]" if section == "geometry" else f"[[{section}]]"
            raise InputError(
                f"{rig.folder}: the rig has no {heading} entry, which {purpose} needs; add it."
            )


def require_images(rig: Rig, purpose: Purpose) -> None:
    """Refuse a rig if an image that a calibration needs does not exist. No image is read."""
    for section in NEEDED[purpose]:
        entries = getattr(rig, section)
        for entry in [entries] if isinstance(entries, Geometry) else entries or ():
            for name in _images(entry):
                if not rig.path(name).is_file():
                    raise InputError(
                        f"{rig.path(name)}: no such image file; check the name and the folder."
                    )


def _images(entry: Flat | Dark | Exposure | Light | Geometry) -> tuple[str, ...]:
    match entry:
        case Flat() | Dark():
            return entry.files
        case Exposure() | Light():
            return (entry.file,)
        case Geometry():
            return tuple(name for name in (entry.normals, entry.mask) if name is not None)
