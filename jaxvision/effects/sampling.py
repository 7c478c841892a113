"""Bound the error of taking a single sample at the centre of a pixel, as a displacement in pixels.

The mean over a pixel is a mean over points at most half of the pixel's diagonal from its centre.
"""

import math

import numpy as np

from ..optics import sensor_vergence
from ..scene import Orthographic, ThinLens, View
from .boxes import corners, setting
from .certificate import IRRADIANCE
from .stages import Ends, Row

_PARTS = ("rim", "distortion", "diffraction")
_HALF_DIAGONAL = math.sqrt(0.5)  # distance from a pixel's middle to its corner, pixels
_COS4_SLOPE = 1.04  # sup of d cos^4 / d slope = 4 t (1 + t^2)^-3, at t = 1 / sqrt 5


def samples_row(view: Ends[View], radiance: np.ndarray) -> Row:
    """Return the `Row` for replacing the random rays of a pixel, which extend to its corners, by
    one ray through the pixel's centre. `radiance`, (bands,) W m^-2 sr^-1, is the largest radiance
    of the picture. The blur of the lens must have been dropped before."""
    nothing, why = np.zeros_like(radiance), "a pixel's rays reach its corners"
    needs = frozenset({"view.defocus"} if isinstance(view.high, ThinLens) else ())
    more = {"unit": IRRADIANCE, "place": _HALF_DIAGONAL, "saves": 0.5, "needs": needs}
    return Row("samples", nothing, why, setting("samples"), **more)


def oversampling_row(
    view: Ends[View], opening: float, radiance: np.ndarray, oversampling: int
) -> Row:
    """Return the `Row` for replacing all samples of a pixel aperture by a single sample at the
    pixel's centre. No sample is farther from the centre than the corners of the pixel. Between the
    centre and a sample, the cos^4 falloff changes by at most 1.04 times the change of the tangent
    of the ray's angle to the axis. `opening` is the largest gain, in W m^-2 per W m^-2 sr^-1. Parts
    of the view that spread light over several pixels must have been dropped before."""
    reach = _HALF_DIAGONAL * (1 - 1 / oversampling)
    amount = np.zeros_like(radiance)
    if not isinstance(view.high, Orthographic) and view.high.f_number is not None:
        steps = [float(v.pixel_pitch) * float(sensor_vergence(v)) for v in corners(view)]
        amount = times(radiance, opening * _COS4_SLOPE * reach * max(steps))
    parts = frozenset(f"view.{p}" for p in _PARTS if getattr(view.high, p, None) is not None)
    why = f"{oversampling} samples along each side reach {reach:.2g} pixels from the middle"
    name = "sensor.pixel_aperture.oversampling"
    more = {"unit": IRRADIANCE, "place": reach, "saves": 0.5, "needs": parts}
    return Row(name, amount, why, setting(f"camera.{name}", to=1), **more)


def times(radiance: np.ndarray, gain: float) -> np.ndarray:
    """Multiply two arrays; 0 times infinity is NaN without a warning."""
    with np.errstate(invalid="ignore"):
        return radiance * gain
