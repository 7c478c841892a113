"""Fit lobes to measured reflectance; report held-out errors and the uncertainty of one model's
parameters.

Every angle of incidence is left out once and predicted by the fit to all other incidences. The
errors of these predictions are the held-out errors. The same fits give the covariance of the
parameters by the jackknife over incidences (Tukey 1958; Busing, Meijer & van der Leeden, "Delete-m
Jackknife for Unequal m", 1999). The jackknife allows for errors that all samples of an incidence
share, and for the error of a wrong model. For few incidences the covariance is widened to the
variance of Student's t. With three incidences that variance is infinite, and the covariance is
widened to match the 95 % interval of Student's t.
"""

from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from jaxvision import Vec, as_dtype

from ...inference.clustering import curvature_stretch
from ...inference.diagnostics import OPEN_LOG_SD
from ...inference.emcee_run import Emcee, group_options
from ...inference.parameters import ParameterSpace
from ...inference.posterior import Posterior, laplace, laplace_or_emcee
from ...inference.precision import double_precision
from ...inference.problem import Problem, log_density
from ...report.notebook import ShownInNotebooks
from ..models import REFLECTANCES, check_index, shape_range, surface_space
from ..names import INDEX, Model, Objective
from .errors import Errors, best, errors, prediction_of_held_out
from .fit import LobeFit, ModelFit, OfBands, brdf, fit_models, problem_of
from .read import MeasuredBRDF

FINE = 4000  # angles of an integral over the hemisphere
EDGE = 1e-3  # distance of a log shape from an end of its range within which it counts as there


@dataclass(frozen=True)
class Amplitudes:
    """The spectra of the diffuse and specular amplitudes, with jackknife standard errors."""

    diffuse: OfBands  # k_d
    specular: OfBands  # k_s
    diffuse_error: OfBands
    specular_error: OfBands


@dataclass(frozen=True, repr=False)
class BRDFCalibration(ShownInNotebooks):
    """The fits of every model to one material, with one model reported in full.

    Attributes:
        measured: the calibrated samples.
        objective: the objective that the fits minimise.
        index: index of refraction of dielectric facets.
        model: name of the reported model.
        fits: fits of every model.
        fitted: errors of every model on the samples that it was fitted to.
        held_out: errors of the predictions for held-out incidences.
        space: the P parameters of `model`.
        mean: (P,) natural values of the parameters, amplitudes averaged over bands.
        covariance: (P, P) covariance of the parameters' logarithms, from the jackknife, widened for
            few incidences.
        amplitudes: amplitudes of every band.
        open_parameters: parameters that the samples do not determine, with the reasons.
        posterior: posterior of `model`; None where a parameter is not determined.
    """

    measured: MeasuredBRDF
    objective: Objective
    index: float
    model: Model
    fits: dict[Model, ModelFit]
    fitted: dict[Model, Errors]
    held_out: dict[Model, Errors]
    space: ParameterSpace
    mean: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    amplitudes: Amplitudes
    open_parameters: dict[str, str]
    posterior: Posterior | None


@double_precision
def calibrate(
    measured: MeasuredBRDF,
    *,
    model: Model | None = None,
    objective: Objective = "cosine",
    index: float = INDEX,
    sampling: Emcee | None = None,
    seed: int = 0,
) -> BRDFCalibration:
    """Fit every model to a material and report one in full.

    Args:
        measured: samples of one material.
        model: model to report; None for the model with the smallest held-out error.
            "torrance-sparrow" has GGX facets, as `jaxvision.TorranceSparrow` by default.
        objective: objective that the fits minimise.
        index: index of refraction of the dielectric facets of Torrance-Sparrow.
        sampling: settings for draws of the reported model's posterior by emcee; None for Laplace.
        seed: seed of every draw.

    Returns:
        The calibration.

    Raises:
        InputError: for an index outside its range.
    """
    check_index(index)
    samples = replace(
        measured, **{name: as_dtype(getattr(measured, name), np.float64) for name in ("wi", "wo")}
    )
    fits = fit_models(samples, objective=objective, index=index)
    fitted: dict[Model, Errors] = {
        name: errors(measured, fit.whole.predicted) for name, fit in fits.items()
    }
    held_out: dict[Model, Errors] = {
        name: errors(measured, prediction_of_held_out(measured, fit)) for name, fit in fits.items()
    }
    reported = best(held_out, objective) if model is None else model
    chosen = fits[reported]
    space = surface_space(reported, "sr^-1", REFLECTANCES[reported].unit)  # means over bands
    mean = _natural(chosen.whole, space)
    covariance = _log_covariance(chosen, space)
    reasons = _open_parameters(reported, space, mean, covariance)
    posterior = None
    if not reasons:
        problem = problem_of(samples, chosen, space, index)
        own = group_options(sampling, measured.name)
        posterior = _posterior(problem, mean, covariance, own, seed)
    return BRDFCalibration(
        measured=measured,
        objective=objective,
        index=index,
        model=reported,
        fits=fits,
        fitted=fitted,
        held_out=held_out,
        space=space,
        mean=mean,
        covariance=covariance,
        amplitudes=amplitudes(chosen),
        open_parameters=reasons,
        posterior=posterior,
    )


# ---------------------------------------------------------------- uncertainty


def _natural(fit: LobeFit, space: ParameterSpace) -> Float[np.ndarray, " parameters"]:
    known = {"diffuse": fit.diffuse.mean(), "specular": fit.specular.mean()}
    return np.array([known.get(parameter.name, fit.shape) for parameter in space], np.float64)


def _jackknife(
    replicates: Float[np.ndarray, "incidences parameters"],
) -> Float[np.ndarray, "parameters parameters"]:
    """Return the jackknife covariance over incidences, widened for their small number."""
    count = len(replicates)
    deviations = replicates - replicates.mean(axis=0)
    freedom = count - 1
    few = (stdtrit(freedom, 0.975) / ndtri(0.975)) ** 2  # t of 2 degrees has no variance
    widening = freedom / (freedom - 2) if freedom > 2 else few
    return widening * freedom / count * deviations.T @ deviations


def _log_covariance(
    fit: ModelFit, space: ParameterSpace
) -> Float[np.ndarray, "parameters parameters"]:
    """Return the covariance of the logarithms of the parameters. Amplitudes may vanish if an
    incidence is left out, so relative deviations replace the logarithms of amplitudes. If there are
    at most as many incidences as parameters, correlations are unknown and set to 0.
    """
    whole = _natural(fit.whole, space)
    left_out = np.stack([_natural(one, space) for one in fit.without])
    scale = np.where(whole > 0, whole, 1)
    logs = (left_out - whole) / scale
    for i, parameter in enumerate(space):
        if parameter.name not in ("diffuse", "specular"):
            logs[:, i] = np.log(left_out[:, i])
    covariance = _jackknife(logs)
    enough = len(fit.without) > len(space)
    return covariance if enough else np.diag(np.diagonal(covariance))


def amplitudes(fit: ModelFit) -> Amplitudes:
    """Return the spectra of both amplitudes with their standard errors."""
    diffuse, specular = (
        np.sqrt(np.diagonal(_jackknife(np.stack([getattr(one, name) for one in fit.without]))))
        for name in ("diffuse", "specular")
    )
    return Amplitudes(fit.whole.diffuse, fit.whole.specular, diffuse, specular)


def albedo(fit: ModelFit, index: float) -> OfBands:
    """Return the albedo of a fitted surface at normal incidence, (bands,). At normal incidence
    every lobe is centred on the normal, and the albedo is 2 pi times the integral of f_r cos(theta)
    sin(theta) over the angle theta from the normal. The albedo of a surface that emits no light is
    at most 1.
    """
    u = (np.arange(FINE) + 0.5) / FINE
    theta = np.pi / 2 * u**3  # denser near the normal, for narrow lobes
    weight = 2 * np.pi * np.cos(theta) * np.sin(theta) * 3 * np.pi / 2 * u**2 / FINE
    zero, one = np.zeros_like(theta), np.ones_like(theta)
    wi = Vec(*(jnp.asarray(x) for x in (zero, zero, one)))
    wo = Vec(*(jnp.asarray(x) for x in (np.sin(theta), zero, np.cos(theta))))
    whole = fit.whole
    values = brdf(fit.model, whole.diffuse, whole.specular, whole.shape, wi, wo, index)
    return weight @ np.broadcast_to(np.asarray(values), (FINE, len(whole.diffuse)))


def _open_parameters(
    model: Model, space: ParameterSpace, mean: np.ndarray, covariance: np.ndarray
) -> dict[str, str]:
    """Return the parameters that the samples do not determine, with the reasons."""
    reasons: dict[str, str] = {}
    for i, parameter in enumerate(space):
        if parameter.name in ("diffuse", "specular"):
            if mean[i] <= 0:
                reasons[parameter.name] = "the best fit has none: its amplitude is zero"
        else:
            low, high = shape_range(model)
            below, above = mean[i] < low * (1 + EDGE), mean[i] > high / (1 + EDGE)
            if below or above:
                reasons[parameter.name] = (
                    f"the best fit lies at the {'lower' if below else 'upper'} end of its range, "
                    f"{mean[i]:.3g}"
                )
        if parameter.name not in reasons and covariance[i, i] > OPEN_LOG_SD**2:
            reasons[parameter.name] = (
                "it changes by more than a factor of e with the incidences that are left out"
            )
    if "specular" in reasons and space[-1].name not in reasons:
        reasons[space[-1].name] = "without a lobe it has no meaning"
    return reasons


def _posterior(
    problem: Problem, mean: np.ndarray, covariance: np.ndarray, sampling: Emcee | None, seed: int
) -> Posterior:
    """Return the posterior with the jackknife's covariance. For draws by a chain, the density is
    rescaled about its mode so that it has this covariance.
    """
    space, mode = problem.space, jnp.asarray(np.log(mean))
    if sampling is not None:
        curvature = np.linalg.inv(laplace(log_density, space, mode, problem).covariance)
        stretch = jnp.asarray(curvature_stretch(curvature, covariance))
        problem = eqx.tree_at(lambda problem: problem.inputs["stretch"], problem, stretch)
    return laplace_or_emcee(
        log_density, space, mode, covariance, problem, sampling=sampling, seed=seed
    )
