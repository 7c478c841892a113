"""Checks that the paths given to a command are either one rig or files of measured reflectance."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxvision.errors import InputError

from .names import CLEAR, INDEX, Model, Objective, is_measured_brdf


def check_one_rig(paths: Sequence[Path], objective: Objective | None) -> None:
    """Raise `InputError` for anything but a single rig, and for options that apply only to files of
    measured reflectance."""
    if len(paths) > 1:
        raise InputError(f"{paths[1]}: a second rig; calibrate one folder of images at a time.")
    if paths[0].is_file() and paths[0].suffix != ".toml":
        raise InputError(
            f"{paths[0]}: neither a rig nor a file of measured reflectance by its suffix; give "
            "a folder with a rig.toml, or a .brdf, .bsdf or .binary file."
        )
    if objective is not None:
        raise InputError(f"{paths[0]}: --objective is for files of measured reflectance.")


def check_files(paths: Sequence[Path], of_rigs: dict[str, Any]) -> None:
    """Raise `InputError` for files other than measured reflectance, and for options that apply only
    to rigs."""
    for path in paths:
        if not is_measured_brdf(path):
            raise InputError(
                f"{path}: not a measured-BRDF file, unlike the others; give either such files "
                "(.brdf, .bsdf, .binary) or one rig folder."
            )
    for name, value in of_rigs.items():
        if value:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{paths[0]}: {option} is for images; leave it out for files.")


def check_index_of(model: Model, index: float) -> None:
    """Raise `InputError` for an index of refraction with a model that has none."""
    if index != INDEX and model not in CLEAR:
        raise InputError(
            f"--index: {model} has no index of refraction; leave it out, or fit "
            f"{' or '.join(CLEAR)}."
        )
