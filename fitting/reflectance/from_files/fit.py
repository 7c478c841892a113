"""Fit measured reflectance by a diffuse term and a lobe, with amplitudes k_d and k_s for each band
and one shape for all bands.

The irradiance is proportional to the cosine of the angle of incidence theta_i, so errors are
measured in the reflected light, x = f_r cos(theta_i). With the weights w of the samples, there are
two objectives, each with its own metric of errors:

    cosine       sum w (x - x_measured)^2                         (Ngan, Durand & Matusik 2005)
    cube-root    sum w (c(x) - c(x_measured))^2,  c(x) = (x + d)^(1/3)

The highlight dominates the cosine objective. The cube root weights bright and dark values about as
the eye does (Fores, Ferwerda & Gu, "Toward a Perceptually Based Metric for BRDF Modeling", 2012).
The constant d, a thousandth of the RMS of x, keeps the slope of c finite at 0.

Under the cosine objective, the best amplitudes for a given shape follow from linear least squares,
so only the shape is searched (variable projection). For the cube root, variable projection is
repeated with a linearisation about the last
prediction (Gauss-Newton). The shape is limited to a window about its last value. The window shrinks
if a step does not lower the true objective. Searches begin at the optimum of the cosine objective
and at the optimum of Lambert's model, which every model contains. If an incidence is left out, a
further search begins at the optimum for all incidences. The result with the lowest objective is
used.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import Vec
from jaxvision.core.parallel_loops import map_

from ...inference.likelihoods import Gaussian
from ...inference.parameters import ParameterSpace
from ...inference.problem import Problem, Values
from ...inference.separable import first_knots, fit_amplitudes, fit_separable
from ..models import has_lobe, log_range, unit_brdf
from ..names import MODELS, Model, Objective
from .read import MeasuredBRDF

DARK = 1e-3  # of the RMS of f_r cos(theta_i): d of the cube-root objective
MOST_STEPS = 100
SETTLED = 1e-8  # relative decrease of the cost below which a fit has converged
SHARES = (1.0, 0.25, 0.05, 0.01, 1e-3)  # shares of a step that are tried
NARROWEST = 1e-3  # narrowest window of a log shape; below it the shape is fixed
OfBands = Float[np.ndarray, " bands"]
OfSamples = Float[np.ndarray, "n bands"]


@dataclass(frozen=True)
class LobeFit:
    """A model's best parameters for one choice of samples."""

    model: Model  # its name
    diffuse: OfBands  # k_d, sr^-1
    specular: OfBands  # k_s, in the record's unit
    shape: float | None  # in natural units; None for Lambert
    predicted: OfSamples  # f_r of ALL samples, sr^-1
    cost: float  # value of the objective
    converged: bool  # whether the search ended at a minimum


@dataclass(frozen=True)
class ModelFit:
    """A model fitted to all samples, and with each incidence left out in turn."""

    model: Model  # its name
    objective: Objective  # of the fits
    whole: LobeFit  # fit to all samples
    without: tuple[LobeFit, ...]  # one fit for each incidence that is held out


def brdf(
    model: Model, diffuse: Any, specular: Any, shape: Any, wi: Vec, wo: Vec, index: float
) -> Float[Array, "n bands"]:
    """Return f_r in sr^-1, (n, bands), of a surface with these amplitudes (bands,) for n pairs of
    directions; n is 1 for Lambert's model.
    """
    diffuse, specular = (jnp.asarray(k)[None] for k in (diffuse, specular))
    if model == "lambert":
        return diffuse
    unit = unit_brdf(model, jnp.asarray(shape), wi, wo, index)[:, None]
    return diffuse + specular * unit if has_lobe(model) else diffuse * unit


def problem_of(
    measured: MeasuredBRDF, fit: ModelFit, space: ParameterSpace, index: float
) -> Problem:
    """State the fit of one model to a material as a problem in its mean amplitudes and its shape.
    The spectra of the amplitudes are fixed. All samples have equal errors in the quantity that the
    objective compares, the reflected light or its cube root.
    """
    whole = fit.whole
    mean = {"diffuse": whole.diffuse.mean(), "specular": whole.specular.mean() or 1.0}
    wanted = compared_quantity(measured, fit.objective, measured.values)
    missed = compared_quantity(measured, fit.objective, whole.predicted) - wanted
    squares = np.mean(missed**2, axis=1)
    variance = np.average(squares, weights=measured.weights)
    variance = max(float(variance), float(np.finfo(np.float32).tiny))
    sd = np.sqrt(variance / measured.weights)[:, None]
    names = [parameter.name for parameter in space]
    inputs = {
        "diffuse": whole.diffuse / mean["diffuse"],
        "specular": whole.specular / mean["specular"],
        "wi": measured.wi,
        "wo": measured.wo,
        "index": index,
        "mode": np.log([mean.get(name, whole.shape) for name in names]),
        "stretch": np.eye(len(names)),
        "dark": darkness(measured) if fit.objective == "cube-root" else None,
    }
    return Problem(
        {parameter.name: parameter for parameter in space},
        _predict_of(fit.model),
        Gaussian(sd=np.broadcast_to(sd, wanted.shape)),
        data=wanted,
        inputs=inputs,
    )


@lru_cache
def _predict_of(model: Model) -> Any:
    """Return the prediction function of one model. The same function is returned in every call,
    because the function is part of the key under which JAX stores compiled programs.
    """

    def predict(values: Values, inputs: dict[str, Any]) -> Array:
        """Predict in the objective's metric, with deviations of log parameters multiplied."""
        names = list(values)
        vector = jnp.log(jnp.stack([values[name] for name in names]))
        stretched = inputs["mode"] + inputs["stretch"] @ (vector - inputs["mode"])
        at = dict(zip(names, jnp.exp(stretched), strict=True))
        diffuse = at.pop("diffuse") * inputs["diffuse"]
        specular = at.pop("specular", 0.0) * inputs["specular"]
        shape = next(iter(at.values()), None)
        wi, wo = inputs["wi"], inputs["wo"]
        reflected = wi.z[:, None] * brdf(model, diffuse, specular, shape, wi, wo, inputs["index"])
        return reflected if inputs["dark"] is None else jnp.cbrt(reflected + inputs["dark"])

    return predict


def reflected(measured: MeasuredBRDF, values: np.ndarray) -> OfSamples:
    """Return f_r cos(theta_i) in sr^-1 from f_r (n, bands)."""
    return measured.cosine[:, None] * values


def darkness(measured: MeasuredBRDF) -> float:
    """Return the constant d of the cube-root objective in sr^-1."""
    x = reflected(measured, measured.values)
    return DARK * float(np.sqrt(np.average((x**2).mean(axis=1), weights=measured.weights)))


def compressed(measured: MeasuredBRDF, values: np.ndarray) -> OfSamples:
    """Return c(f_r cos(theta_i)) in sr^-1/3 from f_r (n, bands); negative values count as 0."""
    return np.cbrt(np.maximum(reflected(measured, values), 0) + darkness(measured))


def compared_quantity(
    measured: MeasuredBRDF, objective: Objective, values: np.ndarray
) -> OfSamples:
    """Return the quantity that an objective compares: the reflected light or its cube root."""
    return (reflected if objective == "cosine" else compressed)(measured, values)


# ---------------------------------------------------------------- search


@eqx.filter_jit
def _columns(model: Model, wi: Vec, wo: Vec, index: float, log_shapes: Array) -> Array:
    return map_(lambda log_shape: unit_brdf(model, jnp.exp(log_shape), wi, wo, index), log_shapes)


@dataclass(frozen=True)
class _Search:
    """The data that all searches for one model share."""

    measured: MeasuredBRDF
    model: Model
    objective: Objective
    index: float

    @cached_property
    def range(self) -> tuple[float, float]:
        """Return the range of the logarithm of the shape."""
        return (0.0, 0.0) if self.model == "lambert" else log_range(self.model)

    @cached_property
    def compared_values(self) -> np.ndarray:
        return compared_quantity(self.measured, self.objective, self.measured.values)

    def columns(self, log_shapes: Any) -> Array:
        """Return f_r (knots, n) of a lobe of unit amplitude, for each of several shapes."""
        measured = self.measured
        return _columns(self.model, measured.wi, measured.wo, self.index, jnp.asarray(log_shapes))

    @cached_property
    def coarse(self) -> Array:
        """Return f_r of unit amplitude for the shapes of the first grid."""
        return self.columns(first_knots(*self.range))

    def evaluate(
        self, kept: np.ndarray, diffuse: np.ndarray, specular: np.ndarray, shape: float | None
    ) -> LobeFit:
        """Return the fit at some parameters; `kept` is a factor on each sample's weight."""
        measured = self.measured
        parameters = self.model, diffuse, specular, shape
        predicted = np.asarray(brdf(*parameters, measured.wi, measured.wo, self.index))
        predicted = np.broadcast_to(predicted, measured.values.shape)
        missed = compared_quantity(measured, self.objective, predicted) - self.compared_values
        cost = float(np.sum((kept * measured.weights)[:, None] * missed**2))
        return LobeFit(*parameters, predicted, cost, converged=True)

    def separable(
        self,
        values: np.ndarray,
        weights: np.ndarray,
        window: tuple[float, float] = (-np.inf, np.inf),
    ) -> tuple[np.ndarray, np.ndarray, float | None]:
        """Fit amplitudes and shape by least squares, with the log shape inside a window."""
        y, w = jnp.asarray(values), jnp.asarray(weights)
        ones = jnp.ones((1, len(values)), y.dtype)
        if self.model == "lambert":
            (diffuse, specular) = np.asarray(fit_amplitudes(ones, y, w).amplitudes, np.float64).T
            return diffuse, specular, None
        low, high = max(window[0], self.range[0]), min(window[1], self.range[1])
        coarse = self.coarse if (low, high) == self.range else None
        # A rough diffuse surface is a single term: its amplitude is the searched column's.
        fixed = ones if has_lobe(self.model) else 0 * ones
        found = fit_separable(self.columns, fixed, y, w, lower=low, upper=high, coarse=coarse)
        diffuse, specular = np.asarray(found.amplitudes, np.float64).T
        if not has_lobe(self.model):
            diffuse, specular = specular, diffuse
        return diffuse, specular, float(np.exp(found.nonlinear))

    def minimum(self, kept: np.ndarray, matt: LobeFit | None, near: LobeFit | None) -> LobeFit:
        """Return the best fit. For the cube-root objective, further searches start at Lambert's
        model and at `near`, if given.
        """
        measured = self.measured
        weights = (kept * measured.weights * measured.cosine**2)[:, None]
        weights = np.broadcast_to(weights, measured.values.shape)
        of_squares = self.evaluate(kept, *self.separable(measured.values, weights))
        if self.objective == "cosine":
            return of_squares
        ends = [self.descent(kept, of_squares)]
        if matt is not None and near is not None:
            ends.append(self.descent(kept, near))
        if matt is not None and (near is None or min(end.cost for end in ends) > matt.cost):
            ends.append(self.descent(kept, replace(matt, shape=float(np.exp(self.range[0])))))
        return min(ends, key=lambda end: end.cost)

    def descent(self, kept: np.ndarray, start: LobeFit) -> LobeFit:
        """Minimise the cube-root objective by Gauss-Newton steps. If a step increases the cost, the
        step of the amplitudes and the window of the shape are reduced.
        """
        measured, cosine = self.measured, self.measured.cosine[:, None]
        weights, dark = (kept * measured.weights)[:, None], darkness(measured)
        best = self.evaluate(kept, start.diffuse, start.specular, start.shape)
        reach = self.range[1] - self.range[0]
        for _ in range(MOST_STEPS):
            root = np.cbrt(cosine * best.predicted + dark)
            slope = cosine / (3 * root**2)
            goal, pull = best.predicted + (self.compared_values - root) / slope, weights * slope**2
            here = 0.0 if best.shape is None else float(np.log(best.shape))
            diffuse, specular, shape = self.separable(goal, pull, (here - reach, here + reach))
            away = 0.0 if shape is None else float(np.log(shape)) - here
            tried = (
                self.evaluate(
                    kept,
                    best.diffuse + share * (diffuse - best.diffuse),
                    best.specular + share * (specular - best.specular),
                    None if shape is None else float(np.exp(here + share * away)),
                )
                for share in SHARES
            )
            lower = next((one for one in tried if one.cost < best.cost * (1 - SETTLED)), None)
            if lower is not None:
                best = lower
            elif reach <= NARROWEST:
                return best
            else:
                reach /= 16
        return replace(best, converged=False)


def fit_model(
    measured: MeasuredBRDF,
    model: Model,
    *,
    objective: Objective = "cosine",
    index: float,
    matt: ModelFit | None = None,
) -> ModelFit:
    """Fit one model to all samples and, for testing, to the samples without each incidence."""
    if model == "lambert" or objective == "cosine":
        matt = None
    elif matt is None:
        matt = fit_model(measured, "lambert", objective=objective, index=index)
    search = _Search(measured, model, objective, index)
    matts = [None] * len(measured.incidences) if matt is None else matt.without
    whole = search.minimum(np.ones(len(measured.weights)), matt and matt.whole, None)
    without = tuple(
        search.minimum((measured.incidence != i).astype(float), own, whole)
        for i, own in enumerate(matts)
    )
    return ModelFit(model, objective, whole, without)


def fit_models(
    measured: MeasuredBRDF, *, objective: Objective = "cosine", index: float
) -> dict[Model, ModelFit]:
    """Fit every model with `fit_model`."""
    options: dict[str, Any] = {"objective": objective, "index": index}
    matt = fit_model(measured, "lambert", **options)
    return {
        model: matt if model == "lambert" else fit_model(measured, model, matt=matt, **options)
        for model in MODELS
    }
