"""Joint calibration of surface, response and sensor from the same images."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxvision.errors import InputError

from ..inference.clustering import Robustness, curvature_stretch
from ..inference.emcee_run import Emcee
from ..inference.given import require_kind
from ..inference.parameters import names
from ..inference.posterior import Posterior
from ..inference.precision import double_precision
from ..reflectance.from_images.calibration import CORRELATED, NO_GAMMA, encoded_fit
from ..reflectance.from_images.fit import Adjusted, adjusted_posterior, fit_channel, robust
from ..reflectance.from_images.optimum import weighed
from ..reflectance.from_images.perspective import AtOptimum
from ..reflectance.from_images.pixel_area import recognise_points
from ..reflectance.from_images.read import Photographs
from ..reflectance.from_images.samples import View, cells_of, select
from ..reflectance.from_images.shading_check import drop_strangers
from ..reflectance.from_images.signal import Form, parameter_space
from ..reflectance.models import check_index, has_lobe
from ..reflectance.names import INDEX, Model
from ..report.notebook import ShownInNotebooks
from ..report.progress import Progress
from .fit import JointFit, fit_turned
from .misfit import Halves, degrees_of_freedom, fit_halves, image_sandwich, laplace_miss, widened
from .model import log_posterior

STEPS = ("fit", "halves", "posterior")  # of each channel


@dataclass(frozen=True, repr=False)
class JointCalibration(ShownInNotebooks):
    """The result of a joint calibration: for each channel, one posterior of surface, response and
    sensor.

    Attributes:
        observation: the calibrated photographs.
        model: reflectance model of the surface.
        fits: the fits, one for each channel.
        posteriors: posteriors by channel, where data and priors determine every parameter.
        robust: by channel, the covariance that is robust to errors shared within images. A channel
            has none if the rig states errors of images and these explain the disagreement of the
            images. If images disagree by more than chance explains, the design effect is above 1.
        halves: by channel, separate fits of two halves of the images, for channels whose images
            disagree.
    """

    observation: Photographs
    model: Model
    fits: tuple[JointFit, ...]
    posteriors: dict[str, Posterior]
    robust: dict[str, Robustness] = field(default_factory=dict)
    halves: dict[str, Halves] = field(default_factory=dict)

    @property
    def gamma(self) -> float | None:
        """Return the encoding exponent of the first channel; None for linear files."""
        gamma = self.fits[0].values.get("gamma")
        return None if gamma is None else float(gamma)


@double_precision
def calibrate(
    measurement: Photographs,
    *,
    model: Model = "phong",
    index: float = INDEX,
    fit_gamma: bool = False,
    sampling: Emcee | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> JointCalibration:
    """Fit reflectance, encoding, gain and noise together to images of a known shape under known
    lights.

    Images that are dark or saturated throughout, are copies, or show another light than the rig
    states are left out and named in the findings.

    Args:
        measurement: photographs, with optional flats and darks.
        model: reflectance model of the surface.
        index: index of refraction of the clear facets of Torrance-Sparrow.
        fit_gamma: whether the encoding exponent is fitted even where the rig states it.
        sampling: how to draw the posterior by emcee; None for Laplace.
        seed: seed of every draw.
        progress: called with (steps done, all steps). In each channel the steps are the fit, the
            fits of two halves where images disagree, and the posterior.

    Returns:
        The calibration.

    Raises:
        InputError: where too little is left to fit, and for numbers outside their range.
    """
    kind, source = Photographs, "from_photographs"
    require_kind("joint.calibrate: measurement", measurement, kind, source=source)
    check_index(index)
    observation = drop_strangers(measurement)
    channels = len(observation.channels)
    brightest = int(np.argmax(observation.dn.mean(axis=(1, 2))))
    if not fit_gamma:
        observation, fit_gamma = _decode_photographs(
            observation, brightest, Form(model, index=index)
        )
    form = Form(model, free_gamma=fit_gamma, index=index)
    fits, posteriors, robusts, halves = [], {}, {}, {}

    def report_steps(steps: int) -> None:
        if progress is not None:
            progress(len(STEPS) * len(fits) + steps, len(STEPS) * channels)

    report_steps(0)
    first = fit_turned(observation, brightest, form)
    observation, as_areas = _recognise_pixel_means(observation, first), observation
    for channel in range(channels):
        known = channel == brightest and observation is as_areas
        fit = first if known else fit_turned(observation, channel, form)
        report_steps(1)
        if is_determined(fit):
            shown = image_sandwich(observation, fit)
            if shown is not None:
                if shown.design_effect > 1 and (
                    apart := fit_halves(observation, channel, fit, shown)
                ):
                    halves[fit.channel], shown = apart, widened(shown, apart)
                robusts[fit.channel] = shown
            report_steps(2)
            posteriors[fit.channel] = _posterior(fit, shown, sampling, seed)
        fits.append(fit)
        report_steps(0)
    return JointCalibration(observation, model, tuple(fits), posteriors, robusts, halves)


def _decode_photographs(
    observation: Photographs, channel: int, form: Form
) -> tuple[Photographs, bool]:
    """Return the photographs, decoded if they are in sRGB, and whether to fit an exponent, by
    least-squares fits of one channel. A curve that is neither sRGB nor a power is refused, because
    a fitted black level and exponent would imitate it and bias the surface.
    """
    chosen = select(observation, held_out=False, form=form)
    cells, view = cells_of(observation, chosen), View(observation, channel, chosen)
    matt: Sequence[Model] = ("oren-nayar", "torrance-sparrow")
    models = (form, *(replace(form, model=name) for name in matt if name != form.model))
    linear = (fit_channel(view, one, cells) for one in models)
    found = encoded_fit(view, form, linear, cells)
    if found is None:
        return observation, False
    observation, trial = found
    if trial.design_effect > CORRELATED:
        raise InputError(f"{NO_GAMMA}.")
    return observation, trial.form.free_gamma


def _recognise_pixel_means(observation: Photographs, fit: JointFit) -> Photographs:
    """Test, with the highlights of a fitted channel, whether a pixel's digital number is the mean
    over its area or the value at its centre. Return the photographs, with pixels as points if the
    values are those at centres.
    """
    seen = fit_of_surface(fit) if fit.grid.observation.within is not None else None
    if seen is None or not has_lobe(fit.form.model):
        return observation
    view = View(observation, fit.grid.channel, seen.selection)
    return recognise_points(observation, seen.vector, seen.samples, view=view, form=fit.form)


def fit_of_surface(fit: JointFit) -> AtOptimum | None:
    """Return the surface of a converged fit with its samples and lights as fitted; else None."""
    seen, known = fit.grid.observation, names(fit.space)
    vector = fit.vector[[known.index(name) for name in names(parameter_space(fit.form))]]
    if not np.isfinite(vector).all():
        return None
    chosen = select(seen, held_out=False, form=fit.form)
    samples = View(seen, fit.grid.channel, chosen).samples(fit.form)
    samples = replace(samples, black=np.float64(fit.values["black_level"]))
    return AtOptimum(seen, vector, weighed(vector, samples, None)[0], chosen)


def is_determined(fit: JointFit) -> bool:
    """Return whether the information matrix of a fit can be inverted."""
    return fit.converged and bool(np.linalg.eigvalsh(fit.information)[0] > 0)


def _posterior(
    fit: JointFit, shown: Robustness | None, sampling: Emcee | None, seed: int
) -> Posterior:
    mode, stretch = jnp.asarray(fit.vector), np.eye(len(fit.vector))
    covariance: dict[str, Any] = {"covariance": np.linalg.inv(fit.information)}
    if shown is not None:
        covariance = robust(shown)
        stretch = curvature_stretch(fit.information, shown.gaussian_covariance)
    elif sampling is None:
        covariance["freedom"] = degrees_of_freedom(fit, covariance["covariance"])
        covariance["missed"] = laplace_miss(fit, covariance["covariance"])
    data = Adjusted(log_posterior, fit.data, mode, jnp.asarray(stretch))
    options = {"sampling": sampling, "seed": seed}
    return adjusted_posterior(data, fit.space, fit.channel, **covariance, **options)
