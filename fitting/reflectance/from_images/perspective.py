"""Test whether the camera is as far away as the fits assume.

A camera at distance D above the middle of the frame sees a point at (x, y) from the direction
(-x / D, -y / D, 1). Fits assume that D is infinite. A few Gauss-Newton steps from such a fit give
the least-squares estimate of 1 / D, in units of half the longer side of the frame. The other
parameters are free to first order.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from .read import Photographs
from .samples import Samples, Selection, predict
from .signal import Vector, local_geometry

STEPS, SMALL = 4, 1e-3  # Gauss-Newton steps, and the difference in 1 / D for a slope


class AtOptimum(NamedTuple):
    """A fit to one channel."""

    observation: Photographs
    vector: Vector
    samples: Samples
    selection: Selection


class Nearness(NamedTuple):
    """An estimate of 1 / D, where D is the camera's distance in half sides of the frame."""

    inverse: float
    error: float  # standard error, which allows for errors that are shared within images
    angle: float  # rad, largest angle between the directions to the camera and its axis
    explained: float  # share of the squared residuals that a camera so near explains


def camera_nearness(
    observation: Photographs, vector: Vector, samples: Samples, selection: Selection
) -> Nearness:
    """Return the estimate at the optimum `vector` of a fit to one channel."""
    light, pixel = selection.light, selection.pixel
    height, width = observation.shape
    x = observation.columns[pixel] - (width - 1) / 2
    y = (height - 1) / 2 - observation.rows[pixel]
    place = np.stack([x, y]) / (max(height, width) / 2)
    predicted = _from_nearby(observation, vector, samples, selection, place)
    root = 1 / samples.deviation
    if samples.saturated is not None:
        root = np.where(samples.saturated, 0, root)
    fitted = predict(vector, samples)
    others, _ = np.linalg.qr((fitted.slopes * root).T)

    def residual(dn: np.ndarray) -> np.ndarray:
        """Return what the fitted parameters cannot explain, in standard deviations."""
        scaled = dn * root
        return scaled - others @ (others.T @ scaled)

    far = predicted(0.0)
    before = residual(samples.dn - fitted.dn)

    def linearise(inverse: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the squared slopes and the pulls of each image, and the residuals."""
        slope = residual((predicted(inverse + SMALL) - predicted(inverse - SMALL)) / (2 * SMALL))
        left = residual(samples.dn - fitted.dn - (predicted(inverse) - far))
        return np.bincount(light, slope**2), np.bincount(light, slope * left), left

    inverse = 0.0
    for _ in range(STEPS):
        squares, pulls, _ = linearise(inverse)
        if not squares.any():
            return Nearness(0.0, np.inf, 0.0, 0.0)
        inverse += float(pulls.sum() / squares.sum())
    squares, pulls, left = linearise(inverse)
    error = np.sqrt(max(np.sum(pulls**2), squares.sum())) / squares.sum()
    angle = np.arctan(abs(inverse) * np.hypot(*place).max())
    return Nearness(inverse, float(error), float(angle), float(1 - left @ left / (before @ before)))


def _from_nearby(
    observation: Photographs,
    vector: Vector,
    samples: Samples,
    selection: Selection,
    place: Float[np.ndarray, "2 samples"],
) -> Callable[[float], np.ndarray]:
    """Return the function from 1 / D to the predicted DN at the middle of each pixel."""
    light, pixel = selection.light, selection.pixel
    normals, wi = observation.normals[pixel], observation.wi[light, pixel]

    def predicted(inverse: float) -> np.ndarray:
        toward = np.stack([*(-inverse * place), np.ones_like(place[0])], axis=-1)
        toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
        geometry = local_geometry(normals, wi, samples.geometry.irradiance, toward=toward)
        geometry = jax.tree.map(np.asarray, geometry)
        near = replace(samples, offset=None, points=(), geometry=geometry)
        return np.asarray(predict(vector, near).dn)

    return predicted
