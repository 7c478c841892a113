"""The record of a calibrated camera, which findings, figures and report read."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from .emva1288 import Evaluation, Ranges
from .fixed_pattern import PatternVariance
from .levels import PhotonTransfer
from .noise_fit import LikelihoodFit
from .posterior import Posterior
from .results import Estimate

STANDARD, LIKELIHOOD = "EMVA 1288", "likelihood"


@dataclass(frozen=True)
class NoiseCalibration:
    """standard: the sheet by the standard. linear, chosen: the likelihood fits of a linear camera
    and of the model that the camera calls for, the same where the linear one does. sheet: figures
    of the chosen model. standard_of_chosen: K, DN/e-, that the standard's regression would give for
    the chosen model's own curves. usable: the bright levels below saturation. patterns: by the
    standard and by the fit to all levels, None where only temporal sums are known."""

    measurement: PhotonTransfer
    within: Ranges
    usable: Int[np.ndarray, " usable"]
    standard: Evaluation
    linear: LikelihoodFit
    chosen: LikelihoodFit
    posterior: Posterior
    sheet: tuple[Estimate, ...]
    standard_of_chosen: float
    patterns: tuple[PatternVariance, PatternVariance] | None
