"""Noise shared by rows or columns in flats beyond that of the darks, as from flickering light under
a rolling shutter. No model includes it, and in a variance it looks like shot noise. The analysis of
variance that detects it also removes it, row by row, which leaves the noise of the pixels.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from .levels import Levels, PhotonTransfer
from .shared import Found, extra_lines, temporal_lines


def extra_in_flats(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> dict[str, Found]:
    """Noise that rows or columns share in flats beyond that of the darks."""
    bright, dark = measurement.bright, measurement.dark
    if bright.shared is None or dark.shared is None:
        return {}
    own = bright.shared
    lit = replace(own, rows=own.rows[usable], columns=own.columns[usable])
    of_bright = np.asarray(bright.variance)[usable], np.asarray(bright.frames)[usable]
    of_dark = np.asarray(dark.variance), np.asarray(dark.frames)
    found = {
        name: extra_lines(lit, dark.shared, of_bright, of_dark, axis)
        for axis, name in enumerate(("rows", "columns"))
    }
    return {name: one for name, one in found.items() if one.believed}


def without_flicker(measurement: PhotonTransfer, flicker: dict[str, Found]) -> PhotonTransfer:
    """The measurement with flats whose row and column noise is reduced to that of the darks."""
    bright, dark = measurement.bright, measurement.dark
    if not flicker or bright.shared is None or dark.shared is None:
        return measurement
    of_dark = np.asarray(dark.variance), np.asarray(dark.frames)
    extra = np.zeros((2, bright.mean.size))
    for axis, (name, own) in enumerate(
        (("rows", bright.shared.rows), ("columns", bright.shared.columns))
    ):
        if name in flicker:
            unlit = temporal_lines(dark.shared, *of_dark, axis)
            extra[axis] = np.asarray(own) - (unlit.variance if unlit.believed else 0.0)
    variance = np.maximum(np.asarray(bright.variance) - extra.sum(axis=0), 0.0)
    steady: Levels = replace(
        bright, variance=jnp.asarray(variance), flicker=jnp.asarray(np.maximum(extra, 0.0))
    )
    return replace(measurement, bright=steady)
