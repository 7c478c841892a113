"""Noise that rows or columns of the flats share and those of the darks do not, as light has it that
flickers while a shutter rolls: no model of the calibration knows of it, and it passes for light's.
"""

from dataclasses import replace

import jax
import numpy as np

from ..inference.formatting import format_with_error
from .calibration import NoiseCalibration
from .shared import Found, extra_lines

WHY = "the flats share noise that the darks do not have, which passes for light's"


def extra_in_flats(calibration: NoiseCalibration) -> dict[str, Found]:
    """Noise that rows or columns share in flats alone.

    Args:
        calibration: of a camera.

    Returns:
        What is believed, by "rows" and "columns".
    """
    bright, dark = calibration.measurement.bright, calibration.measurement.dark
    if bright.shared is None or dark.shared is None:
        return {}
    usable = calibration.usable
    lit = jax.tree.map(lambda x: x[usable], replace(bright.shared, shape=None))
    lit = replace(lit, shape=bright.shared.shape)
    of_bright = np.asarray(bright.variance)[usable], np.asarray(bright.frames)[usable]
    of_dark = np.asarray(dark.variance), np.asarray(dark.frames)
    found = {
        name: extra_lines(lit, dark.shared, of_bright, of_dark, axis)
        for axis, name in enumerate(("rows", "columns"))
    }
    return {name: one for name, one in found.items() if one.believed}


def flicker_in_words(flicker: dict[str, Found]) -> list[str]:
    """A sentence for each.

    Args:
        flicker: as `extra_in_flats` finds it.

    Returns:
        The sentences.
    """
    return [
        f"The {name} of a flat share noise of "
        f"{format_with_error(one.deviation, one.error / (2 * one.deviation))} DN rms where it is "
        "plainest, new in every frame, that the darks do not have: no model here knows of it, and "
        "where it is part of the variance it passes for light's. Gain, efficiency and what follows "
        "from them are not given, and no sensor is made: look for a flickering lamp or "
        "interference, or take darks and flats in the same state of the camera."
        for name, one in flicker.items()
    ]
