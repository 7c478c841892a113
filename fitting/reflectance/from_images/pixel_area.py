"""Test whether pixels are means over their areas, as in sharp photographs, or values at their
centres, as in many rendered pictures, or whether the pictures were blurred or sharpened.

A predicted pixel is (1 - a) times the value at its centre plus a times the mean over its area. Fits
assume a = 1. One Gauss-Newton step from such a fit gives the least-squares estimate of a, with all
other parameters free. To second order in the size of a pixel, a blur with the standard deviation s,
in pixels, has a = 1 + 12 s^2, because a uniform distribution over a pixel has the variance 1 / 12.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from ...inference.parameters import names
from ..models import has_lobe
from .fit import fit_channel
from .read import Photographs
from .samples import Samples, View, cells_of, predict
from .signal import Form, Vector, parameter_space

NEAR, FAR = 3.0, 3.5  # standard errors of a from 0 and from 1 for pixels that are points
MOST = 0.5  # largest |a| of points; if no model describes the surface, a may have any value
CLOSE = 2.0  # the same in a fit to points, from which sharpened pictures do not differ by much
CURVED = 0.1  # relative change of a parameter, beyond which one step is far from the best a


class AreaShare(NamedTuple):
    """An estimate of a: 0 where pixels are points, above 1 after a blur."""

    share: float
    error: float  # standard error, which allows for errors that are shared within images
    explained: float  # share of the squared residuals that a, if not 1, explains
    # relative changes of parameters with pixels as points, where over half their standard errors
    moves: dict[str, float]

    @property
    def blur(self) -> float:
        """Return the standard deviation of the blur, in pixels; negative after sharpening."""
        return float(np.sign(self.share - 1) * np.sqrt(abs(self.share - 1) / 12))


def recognise_points(
    observation: Photographs, vector: Vector, samples: Samples, *, view: View, form: Form
) -> Photographs:
    """Return the photographs. If the fit of one channel shows that pixels are points, they are
    treated as points. If the fit cannot decide and the difference matters, a finding says so. The
    `samples` have the fit's deviations and means over pixels; `vector` is its optimum. Where pixels
    as points would move it far, both are fitted, in the view of its channel."""
    share, error, _, moves = area_share(vector, samples, view.selection.light)
    are_points = abs(share) < min(NEAR * error, MOST) and 1 - share > FAR * error
    if 1 - share > FAR * error and max(map(abs, moves.values()), default=0.0) > CURVED:
        share, error = _share_of_points(observation, view, form)
        are_points = abs(share) < CLOSE * error and 1 - share > FAR * error
    if are_points:
        sentence = (
            "The highlights show the surface at the middle of each pixel, as in many rendered "
            "pictures, not its mean over the pixel's area (the share of the mean is "
            f"{share:.2f} ± {error:.2f}): pixels were taken as points."
        )
        return replace(observation, within=None, findings=(*observation.findings, sentence))
    if abs(share) < NEAR * error and moves:
        listed = ", ".join(f"{name} by {100 * move:+.2g} %" for name, move in moves.items())
        sentence = (
            "The noise hides whether pixels are means over their areas, as in a camera, which is "
            "assumed here, or values at their centres, as in many rendered pictures (the share of "
            f"means is {share:.2f} ± {error:.2f}). With values at the centres, parameters of the "
            f"best model, {samples.form.model}, change by over half their standard errors: "
            f"{listed}."
        )
        return replace(observation, findings=(*observation.findings, sentence))
    return observation


def _share_of_points(observation: Photographs, view: View, form: Form) -> tuple[float, float]:
    """Return a and its error, from a fit to pixels as points; 1 for a fit without a highlight."""
    view = replace(view, observation=replace(observation, within=None))
    fit = fit_channel(view, form, cells_of(observation, view.selection))
    if not has_lobe(fit.samples.form.model):
        return 1.0, 0.0
    samples = replace(view, observation=observation).samples(fit.samples.form)
    samples = replace(samples, deviation=fit.samples.deviation)
    return area_share(fit.vector, samples, view.selection.light, of_points=True)[:2]


def area_share(
    vector: Vector,
    samples: Samples,
    light: Int[np.ndarray, " samples"],
    *,
    of_points: bool = False,
) -> AreaShare:
    """Return the estimate of a at the optimum `vector` of a fit to one channel, or, with
    `of_points`, of a fit with pixels as points."""
    root = 1 / samples.deviation
    if samples.saturated is not None:
        root = np.where(samples.saturated, 0, root)
    exact = predict(vector, samples)
    middle = predict(vector, replace(samples, offset=None, points=()))
    others, triangle = np.linalg.qr((exact.slopes * root).T)

    def residual(dn: np.ndarray) -> np.ndarray:
        """Return what the fitted parameters cannot explain, in standard deviations."""
        scaled = dn * root
        return scaled - others @ (others.T @ scaled)

    fitted = middle if of_points else exact
    area, left = residual(exact.dn - middle.dn), residual(samples.dn - fitted.dn)
    squares = np.bincount(light, area**2)
    if not squares.any():
        return AreaShare(1.0, np.inf, 0.0, {})
    pulls = np.bincount(light, area * left)
    change = pulls.sum() / squares.sum()
    scatter = np.sum((pulls - change * squares) ** 2)
    error = np.sqrt(max(scatter, squares.sum())) / squares.sum()
    explained = change * pulls.sum() / max(left @ left, 1e-300)
    inverse = np.linalg.pinv(triangle)
    moves = inverse @ (others.T @ ((exact.dn - middle.dn) * root))
    sure = np.abs(moves) > np.linalg.norm(inverse, axis=1) / 2
    known = names(parameter_space(samples.form))
    moved = {known[i]: float(np.expm1(moves[i])) for i in np.flatnonzero(sure)}
    share = float(change) if of_points else 1 + float(change)
    return AreaShare(share, float(error), float(explained), moved)
