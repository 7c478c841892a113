"""Measured reflectance as k_d + k_s lobe, amplitudes of every band and one shape for all of them.

A sample's light on the surface falls with the cosine of incidence, so errors are judged by what is
reflected of it, x = f_r cos(theta_i). Two objectives, each with its own metric:

    cosine       sum w (x - x_measured)^2                         (Ngan, Durand & Matusik 2005)
    cube-root    sum w (c(x) - c(x_measured))^2,  c(x) = (x + d)^(1/3)

The first is ruled by the highlight; the second weighs bright and dark about as an eye does (Fores,
Ferwerda & Gu, "Toward a Perceptually Based Metric for BRDF Modeling", 2012); d, a thousandth of the
RMS of x, keeps its slope finite at 0. The cosine objective is linear in the amplitudes and is
minimised globally by variable projection. For the cube root that is repeated on its linearisation
about the last prediction (Gauss-Newton), the shape within a window about the last one that shrinks
where a step does not lower the true objective. The descent begins at the optimum of the cosine
objective and at Lambert's of the same objective, which every model contains (with an incidence left
out, at the optimum with all of them); the lowest end counts.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import Vec

from ...inference.separable import SeparableFit, first_knots, fit_amplitudes, fit_separable
from ..models import has_lobe, log_range, unit_brdf
from ..names import INDEX, MODELS, Model, Objective
from .read import MeasuredBRDF

DARK = 1e-3  # of the RMS of f_r cos(theta_i): d of the cube-root objective
MOST_STEPS = 100
SETTLED = 1e-8  # relative fall of the cost from which a fit stands
SHARES = (1.0, 0.25, 0.05, 0.01, 1e-3)  # of a step that are tried
NARROWEST = 1e-3  # of a logarithm: a shape that may move less stays


@dataclass(frozen=True)
class LobeFit:
    """A model's best parameters on one choice of samples.

    Attributes:
        model: its name.
        diffuse: (bands,) k_d, sr^-1.
        specular: (bands,) k_s, in the record's unit.
        shape: natural; None for Lambert.
        predicted: (n, bands) f_r of ALL samples, sr^-1.
        cost: what the objective is at.
        settled: whether the search ended at a minimum.
    """

    model: Model
    diffuse: Float[np.ndarray, " bands"]
    specular: Float[np.ndarray, " bands"]
    shape: float | None
    predicted: Float[np.ndarray, "n bands"]
    cost: float
    settled: bool


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
    search = _search_of(measured, model, objective, index)

    def as_fit(end: _End) -> LobeFit:
        diffuse, specular = np.asarray(end.found.amplitudes, np.float64).T
        if model != "lambert" and not has_lobe(model):
            diffuse, specular = specular, diffuse
        natural = None if model == "lambert" else float(np.exp(end.found.nonlinear))
        predicted = _prediction(search, end.found)
        return LobeFit(model, diffuse, specular, natural, predicted, end.cost, end.settled)

    everything = np.ones(len(measured.weights))
    end = _minimise(search, everything)
    left_out = [measured.incidence != i for i in range(len(measured.incidences))]
    return ModelFit(
        model,
        objective,
        as_fit(end),
        tuple(as_fit(_minimise(search, kept.astype(float), near=end.found)) for kept in left_out),
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


# ---------------------------------------------------------------- search


@dataclass(frozen=True)
class _Search:
    """What every search of one model shares.

    Attributes:
        measured: samples of one material.
        objective: to minimise.
        columns: f_r of unit amplitude at many log shapes; None for Lambert.
        coarse: the same on the first grid.
        fixed: (1, n) the column of the diffuse term, zeros where the searched column is the body's.
        low: smallest log shape.
        high: largest.
    """

    measured: MeasuredBRDF
    objective: Objective
    columns: Callable[[Array], Array] | None
    coarse: Array | None
    fixed: Array
    low: float
    high: float


@dataclass(frozen=True)
class _End:
    """Where a search ended: the fit, its cost, and whether that is a minimum."""

    found: SeparableFit
    cost: float
    settled: bool


def _search_of(measured: MeasuredBRDF, model: Model, objective: Objective, index: float) -> _Search:
    if model == "lambert":
        ones = jnp.ones((1, len(measured.cosine)))
        return _Search(measured, objective, None, None, ones, 0.0, 0.0)
    low, high = log_range(model)
    columns = partial(_columns, model, measured.wi, measured.wo, index)
    coarse = columns(jnp.asarray(first_knots(low, high)))
    # A rough diffuse surface is a single term: its amplitude is the searched column's.
    body = np.ones_like if has_lobe(model) else np.zeros_like
    fixed = jnp.asarray(body(measured.cosine))[None]
    return _Search(measured, objective, columns, coarse, fixed, low, high)


def _separable(
    search: _Search, values: np.ndarray, weights: np.ndarray, window: tuple[float, float]
) -> SeparableFit:
    """Least squares with the log shape within a window."""
    y, w = jnp.asarray(values), jnp.asarray(weights)
    if search.columns is None:
        return fit_amplitudes(search.fixed, y, w)
    low, high = max(window[0], search.low), min(window[1], search.high)
    coarse = search.coarse if (low, high) == (search.low, search.high) else None
    return fit_separable(search.columns, search.fixed, y, w, lower=low, upper=high, coarse=coarse)


def _prediction(search: _Search, found: SeparableFit) -> np.ndarray:
    """(n, bands) f_r of all samples."""
    amplitudes = np.asarray(found.amplitudes)
    predicted = np.asarray(search.fixed).T * amplitudes[:, 0]
    if search.columns is not None:
        lobe = np.asarray(search.columns(jnp.full(1, found.nonlinear)))[0]
        predicted = predicted + lobe[:, None] * amplitudes[:, 1]
    return predicted


def _cost(search: _Search, kept: np.ndarray, predicted: np.ndarray) -> float:
    measured = search.measured
    metric = reflected if search.objective == "cosine" else compressed
    missed = metric(measured, predicted) - metric(measured, measured.values)
    return float(np.sum((kept * measured.weights)[:, None] * missed**2))


def _minimise(search: _Search, kept: np.ndarray, *, near: SeparableFit | None = None) -> _End:
    """The best fit to the samples of weight `kept` times their own; also begun at `near`."""
    measured = search.measured
    everywhere = (search.low, search.high)
    weights = (kept * measured.weights * measured.cosine**2)[:, None]
    weights = np.broadcast_to(weights, measured.values.shape)
    of_squares = _separable(search, measured.values, weights, everywhere)
    if search.objective == "cosine":
        return _End(of_squares, _cost(search, kept, _prediction(search, of_squares)), True)
    ends = [_descend(search, kept, of_squares)]
    if search.columns is not None:
        matt = _matt(search, kept)
        if near is not None:
            ends.append(_descend(search, kept, near))
        if near is None or min(end.cost for end in ends) > matt.cost:
            ends.append(_descend(search, kept, matt.found))
    return min(ends, key=lambda end: end.cost)


def _matt(search: _Search, kept: np.ndarray) -> _End:
    """Lambert's optimum of the same objective as parameters of the model."""
    lambert = _search_of(search.measured, "lambert", search.objective, INDEX)
    end = _minimise(lambert, kept)
    amplitudes = end.found.amplitudes
    if not bool(search.fixed.any()):
        amplitudes = amplitudes[:, ::-1]
    return replace(end, found=SeparableFit(amplitudes, search.low, float("nan")))


def _descend(search: _Search, kept: np.ndarray, start: SeparableFit) -> _End:
    """Gauss-Newton on the cube roots; a step that leads up is shortened, in the amplitudes and in
    how far the shape may move."""
    measured, cosine = search.measured, search.measured.cosine[:, None]
    wanted, dark = compressed(measured, measured.values), darkness(measured)
    weights = (kept * measured.weights)[:, None]
    best, here = start, _prediction(search, start)
    lowest = _cost(search, kept, here)
    reach = search.high - search.low
    for _ in range(MOST_STEPS):
        root = np.cbrt(cosine * here + dark)
        slope = cosine / (3 * root**2)
        goal, pull = here + (wanted - root) / slope, weights * slope**2
        window = (best.nonlinear - reach, best.nonlinear + reach)
        found = _separable(search, goal, pull, window)
        parts = (_between(best, found, share) for share in SHARES)
        tried = ((part, _prediction(search, part)) for part in parts)
        costs = ((part, there, _cost(search, kept, there)) for part, there in tried)
        lower = next((step for step in costs if step[2] < lowest * (1 - SETTLED)), None)
        if lower is not None:
            best, here, lowest = lower
        elif reach <= NARROWEST:
            return _End(best, lowest, True)
        else:
            reach /= 16
    return _End(best, lowest, False)


def _between(a: SeparableFit, b: SeparableFit, share: float) -> SeparableFit:
    return SeparableFit(
        a.amplitudes + share * (b.amplitudes - a.amplitudes),
        a.nonlinear + share * (b.nonlinear - a.nonlinear),
        float("nan"),
    )
