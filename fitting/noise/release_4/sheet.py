"""The complete data sheet of release 4 for one camera: the *Linear* sheet, nonuniformities and the
*General* sheet.

Release 4 *Linear*: the temporal figures by the regressions of release 3.1, with these
differences:

    threshold   mu_e.min = sqrt(sigma_d^2 + sigma_q^2 / K^2 + 1/4) + 1/2      (26, 27)
    saturation  .1 to .2 % of the numbers at the end of the scale             (clause 6.6)
    linearity   LE = mean of |deviation|, 5 % to 95 % of saturation           (62, 63)

Release 3.1 has no 1/4 under the root of the threshold, takes saturation at the largest variance,
and states the extreme deviations from linearity. Gain, responsivity, dark noise and dark current
are the same in both releases.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxvision import as_dtype

from ...inference.precision import double_precision
from ...report.notebook import ShownInNotebooks
from .. import emva1288
from ..emva1288 import Evaluation, Ranges, Sheet, Statistics, evaluate, linearity_deviation
from ..levels import PhotonTransfer
from ..shared import shared_noise
from .general import General, general
from .nonuniformity import Loss, Split, can_filter, high_pass, loss_of_filter, simulate, split
from .saturation import ranges
from .stacks import Stack, Stacks

PARTS = Split._fields  # total, row, col, pixel
FILTERED, PLAIN = "high-pass (8.1)", "no filter"


@dataclass(frozen=True)
class Nonuniformity:
    """DSNU and PRNU from the average frames of a dark and a bright level."""

    dark: Split  # the standard's spatial variances of the dark, DN^2
    bright: Split  # the standard's spatial variances of the bright level, DN^2
    signal: float  # mean of the bright level minus that of its dark, DN
    dsnu: Mapping[str, Float[np.ndarray, " draws"]]  # draws of s^2_dark, DN^2, by part
    # draws of (s^2_50 - s^2_dark) / signal^2, by part
    prnu: Mapping[str, Float[np.ndarray, " draws"]]


@dataclass(frozen=True, repr=False)
class Release4(ShownInNotebooks):
    """The data sheet of EMVA 1288, release 4.0, of a camera.

    Attributes:
        stacks: the data from which the sheet is computed.
        within: levels that enter each figure.
        clipped: whether the saturation point was found as in release 4, from values at the end of
            the scale.
        linear: figures of *Linear* with their standard errors.
        nonuniformity: DSNU and PRNU with the high-pass filter (`FILTERED`) and without it
            (`PLAIN`); empty without images, `PLAIN` alone for frames smaller than the filter.
        general: signal-to-noise ratios without a linear model.
        seed: of the draws behind the intervals.
    """

    stacks: Stacks
    within: Ranges
    clipped: bool
    linear: Evaluation
    nonuniformity: Mapping[str, Nonuniformity]
    general: General
    seed: int = 0

    @property
    def gain(self) -> float:
        """The system gain K, DN/e-."""
        return float(self.linear.values["system_gain"])


def figures(stats: Statistics, measurement: PhotonTransfer, within: Ranges) -> Sheet:
    """Return the figures of release 4 Linear; those that the measurement cannot give are missing.

    Source:
        EMVA Standard 1288, release 4.0 Linear (2021).
    """
    found = emva1288.sheet(stats, measurement, within)
    gain = found["system_gain"]
    threshold = jnp.sqrt((found["temporal_dark_noise"] / gain) ** 2 + 0.25) + 0.5
    changed = {"threshold_electrons": threshold}
    if "quantum_efficiency" in found:
        changed["threshold_photons"] = threshold / (found["quantum_efficiency"] / 100)
    if "saturation_electrons" in found:
        changed |= emva1288.dynamic_ranges(found["saturation_electrons"], threshold)
    signal = stats.bright_mean - stats.dark_mean[measurement.dark_of]
    off = linearity_deviation(measurement.bright.light, signal, within.linearity)
    count = jnp.sum(within.linearity, dtype=signal.dtype)
    changed["linearity_error"] = jnp.sum(
        jnp.where(within.linearity, jnp.abs(off), 0)
    ) / jnp.maximum(count, 1)
    for name in ("linearity_error_min", "linearity_error_max"):
        del found[name]
    return found | changed


@double_precision
def release_4_sheet(stacks: Stacks, *, seed: int = 0) -> Release4:
    """Compute the data sheet of EMVA 1288, release 4.0, of a camera.

    Args:
        stacks: data from `read_stacks` or `stacks_from_frames`.
        seed: of the draws behind the intervals.

    Returns:
        The data sheet, which a notebook and `print` display. The `section` of the sheet has the
        estimates by name.

    Source:
        EMVA Standard 1288, releases 4.0 Linear and 4.0 General (2021).

    Example:
        >>> from fitting.noise import Camera, release_4_sheet, stacks_from_frames
        >>> rng = np.random.default_rng(0)
        >>> columns = 3 * (-1.0) ** np.arange(40)  # DN, the same in every frame
        >>> def frames(light):
        ...     return np.round(rng.poisson(light, (8, 40, 40)) + 20 + columns)
        >>> photons = [200, 400, 600, 800, 1000]
        >>> lit, dark = [frames(light / 2) for light in photons], [frames(4)]
        >>> at = {"camera": Camera(bits=12), "dark_exposures": [0.01], "photons": photons}
        >>> stacks = stacks_from_frames(lit, dark, [0.01] * 5, **at)
        >>> sheet = release_4_sheet(stacks)
        >>> found = sheet.nonuniformity["no filter"].dark
        >>> [round(float(np.sqrt(max(x, 0))), 1) for x in (found.row, found.col)]  # DN
        [0.0, 3.0]
    """
    rng = np.random.default_rng(seed)
    measurement = as_dtype(stacks.measurement, np.float64)
    within, clipped = ranges(measurement, stacks.numbers)
    dark = measurement.dark
    shared = shared_noise(dark)
    linear = evaluate(measurement, within, shared=shared, figures=figures)
    found = {}
    if stacks.averages is not None:
        unlit, lit = stacks.averages.unlit, stacks.averages.lit
        if can_filter(lit.image.shape):
            found[FILTERED] = _nonuniformity(unlit, lit, True, rng)
        found[PLAIN] = _nonuniformity(unlit, lit, False, rng)
    return Release4(
        stacks, within, clipped, linear, found, general(stacks, within, shared, rng), seed
    )


def _nonuniformity(
    unlit: Stack, lit: Stack, filtered: bool, rng: np.random.Generator
) -> Nonuniformity:
    images = [one.image for one in (unlit, lit)]
    signal = float(images[1].mean() - images[0].mean())
    loss = Loss()
    if filtered:
        images, loss = [high_pass(image) for image in images], loss_of_filter()
    rest = np.array([one.noise / one.frames for one in (unlit, lit)])
    degrees = np.array([images[0].size * (one.frames - 1) for one in (unlit, lit)])
    draws = simulate(images[0], images[1], rest, rest * np.sqrt(2 / degrees), loss, rng)
    return Nonuniformity(
        split(images[0], unlit.rest),
        split(images[1], lit.rest),
        signal,
        {part: one[:, 0, 0] for part, one in draws.items()},
        {part: (one[:, 1, 1] - one[:, 0, 0]) / signal**2 for part, one in draws.items()},
    )
