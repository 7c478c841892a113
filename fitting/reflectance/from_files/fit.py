"""Measured reflectance as k_d + k_s lobe, amplitudes of every band and one shape for all of them.

A sample's light on the surface falls with the cosine of incidence, so errors are judged by what is
reflected of it, x = f_r cos(theta_i). Two objectives, each with its own metric:

    cosine       sum w (x - x_measured)^2                         (Ngan, Durand & Matusik 2005)
    cube-root    sum w (c(x) - c(x_measured))^2,  c(x) = (x + d)^(1/3)

The first is ruled by the highlight; the second weighs bright and dark about as an eye does (Fores,
Ferwerda & Gu, "Toward a Perceptually Based Metric for BRDF Modeling", 2012); d, a thousandth of the
RMS of x, keeps its slope finite at 0. The cosine objective is linear in the amplitudes and is
minimised globally by variable projection; for the cube root that is repeated on its linearisation
about the last prediction (Gauss-Newton), which ends at a minimum of the true objective.
"""

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import Vec

from ...inference.separable import SeparableFit, first_knots, fit_amplitudes, fit_separable
from ..models import has_lobe, log_range, unit_brdf
from ..names import MODELS, Model, Objective
from .read import MeasuredBRDF

DARK = 1e-3  # of the RMS of f_r cos(theta_i): d of the cube-root objective
MOST_STEPS = 60
SETTLED = 1e-9  # relative fall of the cost from which a fit stands


@dataclass(frozen=True)
class LobeFit:
    """A model's best parameters on one choice of samples.

    Attributes:
        model: its name.
        diffuse: (bands,) k_d, sr^-1.
        specular: (bands,) k_s, in the record's unit.
        shape: natural; None for Lambert.
        predicted: (n, bands) f_r of ALL samples, sr^-1.
    """

    model: Model
    diffuse: Float[np.ndarray, " bands"]
    specular: Float[np.ndarray, " bands"]
    shape: float | None
    predicted: Float[np.ndarray, "n bands"]


@dataclass(frozen=True)
class ModelFit:
    """A model on all samples, and on all but those of each incidence in turn.

    Attributes:
        model: its name.
        objective: of the fits.
        whole: to all samples.
        without: one fit an incidence.
    """

    model: Model
    objective: Objective
    whole: LobeFit
    without: tuple[LobeFit, ...]


@eqx.filter_jit
def _columns(model: Model, wi: Vec, wo: Vec, index: float, log_shapes: Array) -> Array:
    return jax.lax.map(
        lambda log_shape: unit_brdf(model, jnp.exp(log_shape), wi, wo, index), log_shapes
    )


def fit_model(
    measured: MeasuredBRDF, model: Model, *, objective: Objective = "cosine", index: float
) -> ModelFit:
    """Fits one model to all samples and, for testing, with each incidence left out.

    Args:
        measured: samples of one material.
        model: to fit.
        objective: to minimise.
        index: of refraction, of the clear facets of Torrance-Sparrow.

    Returns:
        The fits.
    """
    columns = coarse = None
    low = high = 0.0
    if model != "lambert":
        low, high = log_range(model)
        columns = partial(_columns, model, measured.wi, measured.wo, index)
        coarse = columns(jnp.asarray(first_knots(low, high)))

    # A rough diffuse surface is a single term: its amplitude is the searched column's.
    body = np.zeros_like if columns is not None and not has_lobe(model) else np.ones_like
    fixed = jnp.asarray(body(measured.cosine))[None]

    def separable(values: np.ndarray, weights: np.ndarray) -> SeparableFit:
        y, w = jnp.asarray(values), jnp.asarray(weights)
        if columns is None:
            return fit_amplitudes(fixed, y, w)
        return fit_separable(columns, fixed, y, w, lower=low, upper=high, coarse=coarse)

    def prediction(found: SeparableFit) -> np.ndarray:
        amplitudes = np.asarray(found.amplitudes)
        predicted = np.asarray(fixed).T * amplitudes[:, 0]
        if columns is not None:
            lobe = np.asarray(columns(jnp.full(1, found.nonlinear)))[0]
            predicted = predicted + lobe[:, None] * amplitudes[:, 1]
        return predicted

    def fit(kept: np.ndarray) -> LobeFit:
        found = _minimise(measured, kept, objective, separable, prediction)
        diffuse, specular = np.asarray(found.amplitudes, np.float64).T
        if not has_lobe(model) and columns is not None:
            diffuse, specular = specular, diffuse
        natural = None if columns is None else float(np.exp(found.nonlinear))
        return LobeFit(model, diffuse, specular, natural, prediction(found))

    everything = np.ones(len(measured.weights))
    left_out = [measured.incidence != i for i in range(len(measured.incidences))]
    return ModelFit(
        model, objective, fit(everything), tuple(fit(kept.astype(float)) for kept in left_out)
    )


def fit_models(
    measured: MeasuredBRDF, *, objective: Objective = "cosine", index: float
) -> dict[Model, ModelFit]:
    """Every model, fitted as `fit_model` does.

    Args:
        measured: samples of one material.
        objective: to minimise.
        index: of refraction, of the clear facets of Torrance-Sparrow.

    Returns:
        The fits.
    """
    return {model: fit_model(measured, model, objective=objective, index=index) for model in MODELS}


# ---------------------------------------------------------------- objectives


def reflected(measured: MeasuredBRDF, values: np.ndarray) -> Float[np.ndarray, "n bands"]:
    """f_r cos(theta_i).

    Args:
        measured: samples of one material.
        values: (n, bands) f_r, sr^-1.

    Returns:
        (n, bands) sr^-1.
    """
    return measured.cosine[:, None] * values


def darkness(measured: MeasuredBRDF) -> float:
    """d of the cube-root objective, sr^-1."""
    x = reflected(measured, measured.values)
    return DARK * float(np.sqrt(np.average((x**2).mean(axis=1), weights=measured.weights)))


def compressed(measured: MeasuredBRDF, values: np.ndarray) -> Float[np.ndarray, "n bands"]:
    """c(f_r cos(theta_i)); negative values count as 0.

    Args:
        measured: samples of one material.
        values: (n, bands) f_r, sr^-1.

    Returns:
        (n, bands) sr^-1/3.
    """
    return np.cbrt(np.maximum(reflected(measured, values), 0) + darkness(measured))


def _minimise(measured, kept, objective, separable, prediction) -> SeparableFit:
    """The best fit to the samples of weight `kept` times their own."""
    cosine = measured.cosine[:, None]
    weights = np.broadcast_to((kept * measured.weights)[:, None], measured.values.shape)
    best = separable(measured.values, weights * cosine**2)
    if objective == "cosine":
        return best
    wanted, dark = compressed(measured, measured.values), darkness(measured)

    def cost(predicted: np.ndarray) -> float:
        return float(np.sum(weights * (compressed(measured, predicted) - wanted) ** 2))

    here = prediction(best)
    lowest = cost(here)
    for _ in range(MOST_STEPS):
        root = np.cbrt(cosine * here + dark)
        slope = cosine / (3 * root**2)
        found = separable(here + (wanted - root) / slope, weights * slope**2)
        there, share = prediction(found), 1.0
        fall = lowest - cost(there)
        # A whole step too far: part of the way, along amplitudes and the logarithm of the shape.
        while fall < 0 and share > 1e-3:
            share /= 4
            found = _between(best, found, share)
            there = prediction(found)
            fall = lowest - cost(there)
        if fall <= SETTLED * lowest:
            return best
        best, here, lowest = found, there, lowest - fall
    return best


def _between(a: SeparableFit, b: SeparableFit, share: float) -> SeparableFit:
    return SeparableFit(
        a.amplitudes + share * (b.amplitudes - a.amplitudes),
        a.nonlinear + share * (b.nonlinear - a.nonlinear),
        float("nan"),
    )
