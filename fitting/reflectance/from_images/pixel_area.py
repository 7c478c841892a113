"""Whether pixels are means over their areas, as those of cameras are, or values at their middle, as
those of many rendered pictures are.

A predicted pixel is (1 - a) times the value at its middle plus a times the mean over its area. Fits
assume a = 1. The least-squares estimate of a beside all other parameters is one Gauss-Newton step
from such a fit.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from ..models import has_lobe
from .optimum import best
from .read import Photographs
from .samples import Prediction, Samples, View, cells_of, predict, select
from .signal import Form

NEAR, FAR = 3.0, 5.0  # standard errors of a from 0 and from 1 for pixels that are points
MOST = 0.5  # a of points; a surface that no model describes gives any number


def recognise_points(
    observation: Photographs,
    samples: Samples,
    exact: Prediction,
    light: Int[np.ndarray, " samples"],
) -> Photographs:
    """Return the photographs, with pixels as points if a fit of one channel shows that they are."""
    share, error = _area_share(samples, exact, light)
    if abs(share) < min(NEAR * error, MOST) and 1 - share > FAR * error:
        sentence = (
            "The highlights show the surface at the middle of each pixel, as in many rendered "
            f"pictures, not its mean over the pixel's area (of which they hold a share of "
            f"{share:.2f} ± {error:.2f}): pixels were taken as points."
        )
        return replace(observation, within=None, findings=(*observation.findings, sentence))
    return observation


def fit_and_recognise_points(observation: Photographs, form: Form) -> Photographs:
    """Return the photographs, with pixels as points if a first fit of the brightest channel by a
    model with a highlight shows that they are."""
    if observation.within is None or not has_lobe(form.model):
        return observation
    chosen = select(observation, held_out=False, form=form)
    samples = View(observation, int(np.argmax(observation.dn.mean(axis=(1, 2)))), chosen).samples(
        form
    )
    found = best(samples, cells_of(observation, chosen), None)
    return recognise_points(observation, found.samples, found.prediction, chosen.light)


def _area_share(
    samples: Samples, exact: Prediction, light: Int[np.ndarray, " samples"]
) -> tuple[float, float]:
    """Return a and its standard error, for errors that are shared within images."""
    root = 1 / samples.deviation
    if samples.saturated is not None:
        root = np.where(samples.saturated, 0, root)
    others, _ = np.linalg.qr((exact.slopes * root).T)
    middle = predict(exact.vector, replace(samples, offset=None))
    area = (exact.dn - middle.dn) * root
    area -= others @ (others.T @ area)
    squares = np.bincount(light, area**2)
    if not squares.any():
        return 1.0, np.inf
    pulls = np.bincount(light, area * (samples.dn - exact.dn) * root)
    change = pulls.sum() / squares.sum()
    scatter = np.sum((pulls - change * squares) ** 2)
    return float(1 + change), float(np.sqrt(max(scatter, squares.sum())) / squares.sum())
