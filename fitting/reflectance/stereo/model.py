"""Estimation of normals under a reflectance model whose parameters all pixels of a material share.

    m_k = E_k (rho n.l_k + pi k_s s(n, l_k; shape))   a lobe on a matte body
    m_k = E_k rho s(n, l_k; shape)                    a rough body

Here m_k is the reading under light k of direction l_k and irradiance E_k, n the normal, rho the
albedo, and s the shading of a model of `models.py`. The shared parameters k_s and shape are those
that minimise the sum of squares. The vector g = rho n of each pixel is a nuisance parameter,
eliminated by its Schur complement as in bundle adjustment (Triggs et al., Vision Algorithms, 2000).
The covariance of the shared parameters is a sandwich over the pixels. Readings far from the model,
as in cast shadows, have less weight, by Cauchy's weights.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxvision import as_vec
from jaxvision.brdf import reflect

from ...inference.precision import double_precision
from ..models import REFLECTANCES, has_lobe, log_range
from ..names import INDEX, Model
from .lights import (
    NORMAL_MAD,
    TAIL,
    Counted,
    Matrices,
    Readings,
    Rows,
    Vectors,
    predicted,
    strengths_of,
    take_pixels,
)

AT_ONCE = 512  # pixels computed together, and most pixels that estimate a material
STEPS, SHARED_STEPS, FIRST = 20, 25, 6  # steps for a pixel, a material, a start
DONE = 1e-7  # change of a logarithm that ends the search
STARTS = (0.3, 0.55, 0.8)  # starts of the log shape, as shares of its range
LONGEST = 0.7  # step of a logarithm


@dataclass(frozen=True)
class Surface:
    """The fitted model, linearised at the fitted normals."""

    extra: Readings  # readings of the model minus those of Lambert's law for the same g
    # derivatives of the model by g
    slopes: Float[np.ndarray, "lights pixels 3"]
    g: Vectors
    covariance: Matrices  # of g from errors of the shared numbers
    # by label: specular amplitude of a lobe, and shape, with standard deviations
    numbers: dict[int, tuple[Float[np.ndarray, " numbers"], Float[np.ndarray, " numbers"]]]

    def tilt(self, rows: Rows) -> Readings:
        """Return the readings of the linear model with the given slopes, minus the readings by
        Lambert's law."""
        return predicted(self.slopes, self.g) - predicted(rows, self.g)


@partial(jax.jit, static_argnums=0)
def _linearise(model: Model, g: Array, shared: Array, lights: Array, viewer: Array):
    """Return the readings per irradiance of each pixel and light, and their derivatives with
    respect to g and the shared log parameters.
    """
    build = REFLECTANCES[model].material
    assert build is not None, model

    def reading(g: Array, shared: Array, light: Array) -> Array:
        albedo = jnp.sqrt(jnp.sum(g * g))
        normal = as_vec(g / albedo)
        shape = jnp.exp(shared[-1])
        own = reflect(build(shape, INDEX), normal, as_vec(light), as_vec(viewer))[0]
        return light @ g + jnp.pi * jnp.exp(shared[0]) * own if has_lobe(model) else albedo * own

    def reading_and_slopes(g: Array, light: Array) -> tuple[Array, tuple[Array, Array]]:
        return reading(g, shared, light), jax.jacfwd(reading, (0, 1))(g, shared, light)

    return jax.vmap(jax.vmap(reading_and_slopes, (None, 0)))(g, lights)


@dataclass(frozen=True)
class _Pixels:
    """The readings of pixels of one material, with the lights and the viewer."""

    model: Model
    rows: Rows
    viewer: Float[np.ndarray, "3"]
    readings: Readings
    counts: Counted

    def evaluate(self, g: Vectors, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the residuals (pixels, lights), 0 for unused readings, and the derivatives of the
        model.
        """
        found, strengths = [], strengths_of(self.rows)
        lights = np.swapaxes(self.rows.reshape(*strengths.shape, 3) / strengths[..., None], 0, 1)
        for start in range(0, len(g), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            own = lights[part] if len(lights) > 1 else lights
            some = len(g[part])
            padded = np.resize(g[part], (AT_ONCE, 3))
            own = np.resize(own, (AT_ONCE, *lights.shape[1:]))
            value, slopes = _linearise(self.model, padded, shared, own, self.viewer)
            found.append([np.asarray(x)[:some] for x in (value, *slopes)])
        value, by_g, by_shared = (np.concatenate(x) for x in zip(*found, strict=True))
        scale = strengths.T
        residuals = np.where(self.counts.T, self.readings.T - scale * value, 0)
        return residuals, by_g * scale[..., None], by_shared * scale[..., None]

    def weights(self, residuals: np.ndarray, scale: float) -> np.ndarray:
        """Return Cauchy's weights, 0 for unused readings."""
        return self.counts.T / (1 + (residuals / (TAIL * scale)) ** 2)

    def normals(self, g: Vectors, shared: np.ndarray, scale: float, steps: int) -> Vectors:
        """Fit g of each pixel by Levenberg and Marquardt's method."""
        damping = np.full(len(g), 1e-3)
        residuals, slopes, _ = self.evaluate(g, shared)
        for _ in range(steps):
            weights = self.weights(residuals, scale)
            normal = np.einsum("pl,pli,plj->pij", weights, slopes, slopes)
            size = np.trace(normal, axis1=1, axis2=2)
            size = np.maximum(size, 1e-9 * size.mean())
            damped = normal + (damping * size)[:, None, None] * np.eye(3)
            step = np.linalg.solve(
                damped, np.einsum("pl,pli,pl->pi", weights, slopes, residuals)[..., None]
            )[..., 0]
            tried = g + step
            after, slopes_after, _ = self.evaluate(tried, shared)
            better = (weights * after**2).sum(axis=1) <= (weights * residuals**2).sum(axis=1)
            g = np.where(better[:, None], tried, g)
            residuals = np.where(better[:, None], after, residuals)
            slopes = np.where(better[:, None, None], slopes_after, slopes)
            damping = np.clip(np.where(better, damping / 10, 10 * damping), 1e-9, 1e6)
            moved = np.linalg.norm(step, axis=1) > DONE * np.linalg.norm(g, axis=1)
            if not (moved & (damping < 1e6)).any():
                break
        return g

    def reduced(self, g: Vectors, shared: np.ndarray, scale: float) -> tuple[np.ndarray, ...]:
        """Return the normal matrix and the right sides (pixels, numbers) for the shared log
        parameters with g eliminated, and the derivative of g with respect to them (pixels, 3,
        numbers).
        """
        residuals, by_g, by_shared = self.evaluate(g, shared)
        weights = self.weights(residuals, scale)
        own = np.einsum("pl,pli,plj->pij", weights, by_g, by_g)
        size = np.trace(own, axis1=1, axis2=2)
        own += 1e-9 * (size + size.mean())[:, None, None] * np.eye(3)
        across = np.einsum("pl,pli,plq->piq", weights, by_g, by_shared)
        moved = -np.linalg.solve(own, across)
        free = by_shared + np.einsum("pli,piq->plq", by_g, moved)
        normal = np.einsum("pl,plq,plr->qr", weights, free, free)
        return normal, np.einsum("pl,plq,pl->pq", weights, free, residuals), moved

    def cost(self, g: Vectors, shared: np.ndarray, scale: float) -> float:
        return float(np.log1p((self.evaluate(g, shared)[0] / (TAIL * scale)) ** 2).sum())

    def search(
        self, g: Vectors, shared: np.ndarray, scale: float, steps: int
    ) -> tuple[float, np.ndarray, Vectors]:
        """Minimise the cost by damped Gauss-Newton steps in the shared log parameters; return the
        cost, the shared log parameters, and g of each pixel."""
        low, high = log_range(self.model)
        g = self.normals(g, shared, scale, 6)
        cost, damping = self.cost(g, shared, scale), 1e-3
        for _ in range(steps):
            normal, right, moved = self.reduced(g, shared, scale)
            damped = normal + damping * np.diag(np.diag(normal) + 1e-300)
            step = np.clip(np.linalg.lstsq(damped, right.sum(axis=0))[0], -LONGEST, LONGEST)
            tried = shared + step
            tried[-1] = np.clip(tried[-1], low, high)
            there = self.normals(g + moved @ (tried - shared), tried, scale, 4)
            after = self.cost(there, tried, scale)
            if after < cost:
                size = np.abs(tried - shared).max()
                shared, g, cost, damping = tried, there, after, damping / 10
                if size < DONE:
                    break
            else:
                damping *= 10
                if damping > 1e6:
                    break
        return cost, shared, g


@double_precision
def fitted_surface(
    model: Model,
    rows: Rows,
    readings: Readings,
    counts: Counted,
    start: Vectors,
    labels: Int[np.ndarray, " pixels"],
    viewer: Float[np.ndarray, "3"],
) -> Surface:
    """Fit the model to each material, starting from the normals by Lambert's law."""
    slopes = rows.copy() if rows.ndim == 3 else np.repeat(rows[:, None], len(start), axis=1)
    extra = np.zeros_like(readings)
    g, covariance, numbers = start.copy(), np.zeros((len(start), 3, 3)), {}
    usable = np.isfinite(start).all(axis=1) & (start @ viewer > 0) & (counts.sum(axis=0) > 3)
    for label in np.unique(labels[usable & (labels >= 0)]):
        own = np.flatnonzero(usable & (labels == label))
        some = own[:: -(-len(own) // AT_ONCE)]

        def pixels(places: np.ndarray) -> _Pixels:
            values = np.nan_to_num(readings[:, places])
            own_rows = take_pixels(rows, places)
            return _Pixels(model, own_rows, viewer, values, counts[:, places])

        best = _material(pixels(some), start[some])
        scale = best[1]
        shared, there = best[0], pixels(own)
        normal, right, _ = pixels(some).reduced(best[2], shared, scale)
        inverse = np.linalg.pinv(normal)
        by_pixel = right @ inverse
        of_shared = by_pixel.T @ by_pixel
        g[own] = there.normals(start[own], shared, scale, STEPS)
        moved = there.reduced(g[own], shared, scale)[2]
        covariance[own] = moved @ of_shared @ np.swapaxes(moved, 1, 2)
        residuals, by_g, _ = there.evaluate(g[own], shared)
        extra[:, own] = there.readings - residuals.T - predicted(there.rows, g[own])
        slopes[:, own] = np.swapaxes(by_g, 0, 1)
        values = np.exp(shared)
        numbers[int(label)] = values, values * np.sqrt(np.diag(of_shared))
    return Surface(extra, slopes, g, covariance, numbers)


def _material(pixels: _Pixels, start: Vectors) -> tuple[np.ndarray, float, Vectors]:
    """Return the shared log parameters of one material, the scale of its residuals, and g of the
    pixels.
    """
    low, high = log_range(pixels.model)
    residuals = np.where(pixels.counts, pixels.readings - predicted(pixels.rows, start), 0).T
    scale = max(NORMAL_MAD * float(np.median(np.abs(residuals[pixels.counts.T]))), 1e-9)
    starts = []
    for place in STARTS:
        shared = np.array([low + place * (high - low)])
        if has_lobe(pixels.model):
            lobe = pixels.evaluate(start, np.array([0.0, shared[0]]))[2][..., 0]
            lobe = np.where(pixels.counts.T, lobe, 0)
            amount = (lobe * residuals).sum() / max((lobe**2).sum(), 1e-300)
            least = 1e-3 * np.median(np.linalg.norm(start, axis=1))
            shared = np.array([np.log(max(amount, least)), shared[0]])
        starts.append(pixels.search(start, shared, scale, FIRST))
    _, shared, g = min(starts, key=lambda found: found[0])
    left = pixels.evaluate(g, shared)[0]
    scale = max(NORMAL_MAD * float(np.median(np.abs(left[pixels.counts.T]))), 1e-9)
    _, shared, g = pixels.search(g, shared, scale, SHARED_STEPS)
    return shared, scale, g
