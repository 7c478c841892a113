"""Vary the settings of a response-curve fit: the numbers of pixels, of bins of codes and of
iterations. The quantities compared are log exposures at given codes, in units of their standard
errors, for the first channel that can be calibrated.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxvision.accuracy.records import Compute

from ..observation import Load
from ..response.calibration import calibrate
from ..response.clipping import clear_of_clipping
from ..response.curve import ResponseCurve, fit_response_curve
from ..response.places import layout_of
from ..response.read import read_exposure_stack
from ..response.solve import STEADIEST
from ..rig import Rig
from .chains import Turn

PLACES = 64  # codes at which curves are compared


def response_knobs(rig: Rig, load: Load) -> Mapping[str, Turn]:
    """Return, for each setting of a response-curve fit by name, a function that varies it."""
    stack = read_exposure_stack(rig, load=load)
    channel = calibrate(stack).channels[0]
    plane, whole = channel.plane, channel.curve
    seen = whole.codes[whole.seen]
    judged = np.linspace(seen[0], seen[-1], PLACES + 2)[1:-1]
    errors = np.interp(judged, whole.codes, whole.standard_error)
    codes = plane.codes
    if channel.clear:
        codes = clear_of_clipping(
            codes, plane.clip, mask=plane.mask, hidden=channel.clear_of_hidden
        )
    every = codes[:, plane.mask]
    layout = layout_of(plane.codes, plane.mask, black=plane.black, clip=plane.clip)

    def fit_curve(chosen: np.ndarray | slice, **more: Any) -> np.ndarray:
        curve = fit_response_curve(
            every[:, chosen],
            plane.exposures,
            bits=stack.bits,
            black=plane.black,
            clip=plane.clip,
            layout=layout.select(chosen),
            least_error=max(STEADIEST, plane.exposure_sd),
            **more,
        )
        return _relative_log_exposure(curve, judged) / errors

    def pixels(share: float) -> Compute:
        wanted = max(int(share * every.shape[1]), 1)

        def compute(seed: int) -> np.ndarray:
            rng = np.random.default_rng(seed)
            return fit_curve(np.sort(rng.permutation(every.shape[1])[:wanted]))

        return compute

    everywhere = slice(None)
    return {
        "pixels": pixels,
        "code bins": lambda bins: lambda seed: fit_curve(everywhere, most_bins=bins),
        "curve rounds": lambda rounds: lambda seed: fit_curve(everywhere, rounds=rounds),
    }


def _relative_log_exposure(curve: ResponseCurve, codes: np.ndarray) -> np.ndarray:
    """Interpolate the log exposure at some codes, linearly in ln code between bins, and subtract
    its value at the middle code.
    """
    g = np.interp(np.log(codes), np.log(curve.codes), curve.log_exposure)
    return g - g[len(codes) // 2]
