"""A rough surface as the explanation of departures from Lambert's law."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .lights import EXPLAINED, Matrices, Readings, Rows, predicted, solved
from .misfit import Departures, departures
from .model import fitted_surface

FITTED = 256  # pixels of a first test whether a rough body explains residuals


@dataclass(frozen=True)
class Rough:
    """The change of the normals if a rough surface model replaces Lambert's law."""

    covariance: Matrices  # of g, including the change by the rough body
    sigma: float  # roughness, rad
    sigma_sd: float
    explained: float  # share of the residuals' squares
    turned: float  # rad, median change of the normals


def rough_body(
    rows: Rows,
    readings: Readings,
    counts: Bool[np.ndarray, "lights h w"],
    found: Departures,
    viewer: Float[np.ndarray, "3"],
) -> Rough | None:
    """Fit a rough surface (Oren-Nayar), and return it if it explains the residuals of Lambert's
    law. Roughness rotates the fitted normals toward the viewer and leaves hardly any residual under
    few lights. The detected departures from Lambert's law remain in the covariance, unless
    roughness explains all of them.
    """
    weights = found.weights
    flat = counts.reshape(len(readings), -1)
    g = solved(rows, readings, weights)[0]
    plain = np.where(flat, readings - predicted(rows, g), 0)
    lit = np.flatnonzero(np.isfinite(g[:, 0]) & (flat.sum(axis=0) > 3))
    labels = np.full(len(g), -1)
    labels[lit[:: -(-len(lit) // FITTED)]] = 0
    for part in (labels, np.where(np.isin(np.arange(len(g)), lit), 0, -1)):
        body = fitted_surface("oren-nayar", rows, readings, flat, g, part, viewer)
        if not body.numbers:
            return None
        bent = readings - body.extra + body.tilt(rows)
        own = solved(body.slopes, bent, weights)[0]
        left = np.where(flat, bent - predicted(body.slopes, own), 0)
        some = (part == 0) & np.isfinite(own[:, 0])
        explained = 1 - float((left[:, some] ** 2).sum() / (plain[:, some] ** 2).sum())
        if explained < EXPLAINED:
            return None
    after = departures(rows, bent.reshape(counts.shape), counts, body.slopes)
    own_covariance = (found if after.significant else after).covariance
    moved = np.where(some[:, None], own - g, 0)
    (sigma, sd) = (float(x[0]) for x in body.numbers[0])
    turned = np.linalg.norm(np.cross(g, own), axis=1) / np.linalg.norm(g, axis=1)
    turned = np.arcsin(np.clip(turned[some] / np.linalg.norm(own[some], axis=1), 0, 1))
    return Rough(
        own_covariance + body.covariance + moved[:, :, None] * moved[:, None, :],
        sigma,
        sd,
        explained,
        float(np.median(turned)),
    )
