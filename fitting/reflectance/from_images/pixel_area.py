"""Test whether pixels are means over their areas, as in cameras, or values at their centres, as in
many rendered pictures.

A predicted pixel is (1 - a) times the value at its centre plus a times the mean over its area. Fits
assume a = 1. One Gauss-Newton step from such a fit gives the least-squares estimate of a, with all
other parameters free.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from .read import Photographs
from .samples import Samples, predict
from .signal import Vector

NEAR, FAR = 3.0, 5.0  # standard errors of a from 0 and from 1 for pixels that are points
MOST = 0.5  # a of points; a surface that no model describes gives any number


def recognise_points(
    observation: Photographs, vector: Vector, samples: Samples, light: Int[np.ndarray, " samples"]
) -> Photographs:
    """Return the photographs, with pixels as points if the fit of one channel shows that they are.
    The `samples` have the fit's deviations and means over pixels; `vector` is its optimum."""
    share, error = _area_share(vector, samples, light)
    if abs(share) < min(NEAR * error, MOST) and 1 - share > FAR * error:
        sentence = (
            "The highlights show the surface at the middle of each pixel, as in many rendered "
            f"pictures, not its mean over the pixel's area (of which they hold a share of "
            f"{share:.2f} ± {error:.2f}): pixels were taken as points."
        )
        return replace(observation, within=None, findings=(*observation.findings, sentence))
    return observation


def _area_share(
    vector: Vector, samples: Samples, light: Int[np.ndarray, " samples"]
) -> tuple[float, float]:
    """Return a and its standard error, which allows for errors that are shared within images."""
    root = 1 / samples.deviation
    if samples.saturated is not None:
        root = np.where(samples.saturated, 0, root)
    exact = predict(vector, samples)
    middle = predict(vector, replace(samples, offset=None, points=()))
    others, _ = np.linalg.qr((exact.slopes * root).T)
    area = (exact.dn - middle.dn) * root
    area -= others @ (others.T @ area)
    squares = np.bincount(light, area**2)
    if not squares.any():
        return 1.0, np.inf
    pulls = np.bincount(light, area * (samples.dn - exact.dn) * root)
    change = pulls.sum() / squares.sum()
    scatter = np.sum((pulls - change * squares) ** 2)
    return float(1 + change), float(np.sqrt(max(scatter, squares.sum())) / squares.sum())
