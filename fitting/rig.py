"""`rig.toml`: what each file of a calibration folder is.

The schema below is the documentation of the format; paths are relative to the rig file (or to its
`root`, in which `${NAME}` stands for an environment variable). Everything is checked before any
image is read; a mistake is an `InputError` that names the file, the entry and the remedy.
"""

import os
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from jaxvision.errors import InputError
from jaxvision.toml_files import Entry, checked, read_toml

RIG_FILE = "rig.toml"
BAYER_PHASES = ("RGGB", "BGGR", "GRBG", "GBRG")

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]


class Camera(Entry):
    """`[camera]`: what is known of the camera; what is not known stays out.

    bits: ADC bits of the digital numbers in the files (12-bit data may sit in 16-bit files).
    black_level: DN without light. saturation: DN from which a pixel counts as clipped (default:
    2^bits - 1). gamma: encoding exponent of the files, 1 = linear. gain: DN per electron.
    read_noise: electrons rms; without both gain and read_noise a fit estimates its pixels' noise
    from their residuals. pattern: phase of a Bayer mosaic. pixel_pitch: metres.
    wavelength: metres, of the monochromatic light of the flats.
    """

    bits: Annotated[int, Field(ge=1, le=16)]
    black_level: NonNegative | None = None
    saturation: Positive | None = None
    gamma: Positive | None = None
    gain: Positive | None = None
    read_noise: NonNegative | None = None
    pattern: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None
    pixel_pitch: Positive | None = None
    wavelength: Positive | None = None

    @property
    def full_scale(self) -> int:
        return 2**self.bits - 1

    @property
    def clip_level(self) -> float:
        return float(self.full_scale) if self.saturation is None else self.saturation


class Flat(Entry):
    """`[[flat]]`: two or more images of one uniform field. exposure: seconds. photons: mean photons
    per pixel, or irradiance: W m^-2 on the sensor (with the camera's pixel_pitch and wavelength);
    neither is needed unless the quantum efficiency is wanted."""

    files: Annotated[tuple[str, ...], Field(min_length=2)]
    exposure: Positive
    photons: NonNegative | None = None
    irradiance: NonNegative | None = None


class Dark(Entry):
    """`[[dark]]`: two or more images without light. exposure: seconds."""

    files: Annotated[tuple[str, ...], Field(min_length=2)]
    exposure: Positive


class Exposure(Entry):
    """`[[exposure]]`: one image of an exposure stack of a still scene. exposure: seconds.
    channels of colour images are taken apart; group separates stacks (an illumination band)."""

    file: str
    exposure: Positive
    group: str = ""


class Light(Entry):
    """`[[light]]`: one image of the object under one light. direction: unit vector from the object
    toward a distant light, or position: metres (then `[geometry]` needs a sphere in metres).
    intensity: irradiance per channel on a surface facing the light (W m^-2 or relative), or the
    point light's radiant intensity. held_out: keep this image for testing the prediction."""

    file: str
    direction: Vector | None = None
    position: Vector | None = None
    intensity: Annotated[tuple[Positive, ...], Field(min_length=1)] = (1.0,)
    held_out: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> "Light":
        if (self.direction is None) == (self.position is None):
            raise ValueError("give either direction or position")
        if self.direction is not None:
            length = float(np.linalg.norm(self.direction))
            if abs(length - 1) > 1e-2:
                raise ValueError(
                    f"direction has length {length:.4g}, not 1; give a unit vector toward the light"
                )
        return self


class SphereGeometry(Entry):
    """A sphere seen orthographically along -z (x right, y up, z toward the camera): centre (column,
    row) and radius in pixels, pixel centres at integers; radius_m: metres, for point lights."""

    centre: tuple[Finite, Finite]
    radius: Positive
    radius_m: Positive | None = None


class Geometry(Entry):
    """`[geometry]`: a sphere, or a normals file ((h, w, 3) `.npy` or EXR; x right, y up, z toward
    the camera); mask: an image that is non-zero where the object is."""

    sphere: SphereGeometry | None = None
    normals: str | None = None
    mask: str | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "Geometry":
        if (self.sphere is None) == (self.normals is None):
            raise ValueError("give either sphere or normals")
        return self


class Rig(Entry):
    """A whole rig file. `folder` is where its paths start."""

    folder: Path
    camera: Camera
    root: str = "."
    flat: tuple[Flat, ...] = ()
    dark: tuple[Dark, ...] = ()
    exposure: tuple[Exposure, ...] = ()
    light: tuple[Light, ...] = ()
    geometry: Geometry | None = None

    def path(self, name: str) -> Path:
        """Where a file named in the rig lies."""
        return self.folder / os.path.expandvars(self.root) / name


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """The checked rig of a folder (its `rig.toml`) or of a rig file given by name."""
    file = Path(path)
    if file.is_dir():
        file = file / RIG_FILE
    if not file.is_file():
        raise InputError(
            f"{file}: no such rig file; write one that says what each image is (see the README), "
            "or give the folder that holds it."
        )
    content = read_toml(file, "rig")
    if "folder" in content:
        raise InputError(f"{file}: `folder` is not a key of a rig file; remove it.")
    return checked(file, {"folder": file.parent, **content}, Rig, "rig")


def require(rig: Rig, *sections: str, purpose: str) -> None:
    """`InputError` naming the first of these sections that the rig lacks."""
    for section in sections:
        if not getattr(rig, section):
            heading = f"[{section}]" if section == "geometry" else f"[[{section}]]"
            raise InputError(
                f"{rig.folder}: the rig has no {heading} entry, which {purpose} needs; add it."
            )
