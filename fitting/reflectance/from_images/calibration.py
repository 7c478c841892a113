"""Fit reflectance models to the photographs of a rig, and find their unidentifiable parameters."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit
from threadpoolctl import threadpool_limits

from jaxvision.core.side_by_side import side_by_side
from jaxvision.errors import InputError
from jaxvision.point_ops import srgb_decode, srgb_encode

from ...inference.diagnostics import OPEN_LOG_SD
from ...inference.emcee_run import Emcee, Progress
from ...inference.given import require_kind
from ...inference.posterior import Posterior
from ...inference.precision import double_precision
from ...report.notebook import ShownInNotebooks
from ..models import check_index, shape_of
from ..names import INDEX, MODELS, Model
from .comparison import ModelScore, compare, relative_rms
from .fit import ChannelFit, channel_posterior, fit_channel, lights_as_fitted, predicted_image
from .pixel_area import recognise_points
from .read import Photographs
from .samples import Grouping, Selection, View, cells_of, predict, select
from .shading_check import drop_strangers
from .signal import Form, parameter_space

FEWEST_SAMPLES = 50
FEWEST_IN_HIGHLIGHT = 6.0  # samples that determine size, height and width of a highlight
LINEAR_ERROR = 0.01  # relative rms error below which a model of linear files describes them
LEAST_EXPONENT = 1.4  # of encoded files
ENCODED = (
    "The files are treated as encoded, with a fitted exponent, although the rig states no "
    "gamma: no model of linear files describes them half as well. State camera.gamma where it is "
    "known (1 for linear files)."
)
SRGB = (
    "The files are treated as sRGB and were decoded, although the rig does not say so: no model of "
    "linear files describes them half as well, and no pure gamma as well. State camera.gamma where "
    "it is known (1 for linear files)."
)
NO_LEVELS = "Flats and darks, which are encoded too, were not used."
NO_GAMMA = (
    "the files seem to be encoded, and neither by a pure gamma nor as sRGB: decode them, or state "
    "camera.gamma"
)
CLOSER = 0.9  # ratio of errors from which sRGB describes files better than a fitted exponent
CORRELATED = 1.5  # design effect from which a pure gamma does not describe encoded files
NEGLIGIBLE = 40.0  # fall of ln k_s after which no highlight is left
USUAL: tuple[Model, ...] = (
    "lambert",
    "oren-nayar",
    "eon",
    "phong",
    "gaussian-lobe",
    "blinn",
    "torrance-sparrow-beckmann",
    "torrance-sparrow",
)


@dataclass(frozen=True, repr=False)
class ReflectanceCalibration(ShownInNotebooks):
    """The fits of several models to the photographs of a rig, with one model reported in full.

    Attributes:
        observation: the calibrated photographs.
        model: name of the reported model.
        fits: fits of every model, by channel.
        scores: scores of every model in every channel.
        open_parameters: by channel, the parameters of `model` that the data do not determine, with
            the reason.
        posteriors: posteriors of the channels where all parameters are determined.
        fitted: samples to which the models were fitted.
        held_out: samples that test the predictions.
        minimum_cosine: smallest n.l of the samples that were used.
    """

    observation: Photographs
    model: Model
    fits: dict[Model, tuple[ChannelFit, ...]]
    scores: tuple[ModelScore, ...]
    open_parameters: dict[str, dict[str, str]]
    posteriors: dict[str, Posterior]
    fitted: Selection
    held_out: Selection
    minimum_cosine: float

    @property
    def chosen_fits(self) -> tuple[ChannelFit, ...]:
        """The fits of the chosen model, one for each channel."""
        return self.fits[self.model]

    @property
    def reported(self) -> tuple[ChannelFit, ...]:
        """Former name of `chosen_fits`."""
        warnings.warn("reported is now chosen_fits.", DeprecationWarning, stacklevel=2)
        return self.chosen_fits

    @property
    def gamma(self) -> float | None:
        """Return the fitted encoding exponent of the first channel; None if it was not fitted."""
        fit = self.chosen_fits[0]
        return float(fit.natural[-1]) if fit.form.free_gamma else None


@double_precision
@threadpool_limits.wrap(limits=1, user_api="blas")  # matrices are too small for threads
def calibrate(
    observation: Photographs,
    *,
    model: Model,
    compare_all: bool = False,
    index: float = INDEX,
    sampling: Emcee | None = None,
    seed: int = 0,
    ambient: bool = False,
    fit_gamma: bool = False,
    minimum_cosine: float = 0.0,
    progress: Progress | None = None,
) -> ReflectanceCalibration:
    """Fit a model, and others to compare it with, to the images whose lights are not held out.

    Images that are dark or saturated throughout, are copies, or show another light than the rig
    states are left out and named in the findings.

    Args:
        observation: photographs of a known shape under known lights.
        model: the model reported in full; "torrance-sparrow" has GGX facets, as
            `jaxvision.TorranceSparrow` by default.
        compare_all: whether to compare `model` with every other model instead of the usual ones
            (`USUAL`), which takes about twice the time.
        index: index of refraction of the dielectric facets of Torrance-Sparrow.
        sampling: settings for draws of the posterior of `model` by emcee; None for Laplace.
        seed: seed of every draw.
        ambient: whether to add a constant signal to each channel, which is estimated from lit
            pixels and from attached shadows.
        fit_gamma: whether to fit the encoding exponent; a known `camera.gamma` is then ignored.
        minimum_cosine: samples with a smaller cosine n.l of the angle of incidence are left out.
            Useful for objects on which light at grazing incidence is uncertain.
        progress: called with (models fitted, all models), the first time with no model fitted.

    Returns:
        The calibration.

    Raises:
        InputError: where too few samples are left, and for numbers outside their range.
    """
    kind, source = Photographs, "from_photographs"
    require_kind("reflectance.calibrate: observation", observation, kind, source=source)
    if not 0 <= minimum_cosine < 1:
        raise InputError(f"minimum_cosine = {minimum_cosine}: give a cosine from 0 up to below 1.")
    check_index(index)
    observation = drop_strangers(observation)
    forms: dict[Model, Form] = {
        name: Form(name, ambient, fit_gamma, index)
        for name in MODELS
        if compare_all or name in (*USUAL, model)
    }
    fitted, held_out = (
        select(observation, held_out=kept, form=forms[model], minimum_cosine=minimum_cosine)
        for kept in (False, True)
    )
    if len(fitted.light) < FEWEST_SAMPLES:
        raise InputError(
            f"only {len(fitted.light)} samples have n.l > {minimum_cosine:g} under the fitted "
            "lights; lower minimum_cosine, enlarge the mask or add lights."
        )
    cells = cells_of(observation, fitted)

    def fit_models(
        observation: Photographs, channels: Sequence[int]
    ) -> dict[Model, tuple[ChannelFit, ...]]:
        views = [View(observation, channel, fitted) for channel in channels]

        def fitted_channels(form: Form) -> tuple[ChannelFit, ...]:
            return tuple(fit_channel(view, form, cells) for view in views)

        # all channels of one model in succession: its lobe is compiled once
        pieces = [partial(fitted_channels, form) for form in forms.values()]
        if progress is not None:
            progress(0, len(pieces))  # the first model may take seconds to compile
        return dict(zip(forms, side_by_side(pieces, progress=progress), strict=True))

    brightest = int(np.argmax(observation.dn.mean(axis=(1, 2))))
    first = fit_models(observation, [brightest])
    encoding = None
    if not fit_gamma:
        linear = [of_model[0] for of_model in first.values()]
        view = View(observation, brightest, fitted)
        encoding = encoded_fit(view, forms[model], linear, cells)
    if encoding is not None:
        observation, trial = encoding
        free = trial.form.free_gamma
        forms = {name: replace(form, free_gamma=free) for name, form in forms.items()}
        first = fit_models(observation, [brightest])
    if observation.within is not None:
        fit = max((of_model[0] for of_model in first.values()), key=lambda x: x.log_likelihood)
        observation = recognise_points(
            observation, fit.vector, fit.samples, view=fit.view, form=fit.requested
        )
        if observation.within is None:
            first = fit_models(observation, [brightest])
    fits: dict[Model, tuple[ChannelFit, ...]] = first
    rest = [i for i in range(len(observation.channels)) if i != brightest]
    if rest:
        fits = {
            name: (*others[:brightest], *first[name], *others[brightest:])
            for name, others in fit_models(observation, rest).items()
        }
    reasons = {
        fit.channel: open_parameters(fit, matt)
        for fit, matt in zip(fits[model], fits["lambert"], strict=True)
    }
    if encoding is not None:
        reasons |= _reasons_of_curved(fits[model])
    return ReflectanceCalibration(
        observation=observation,
        model=model,
        fits=fits,
        scores=compare(observation, fits, held_out),
        open_parameters=reasons,
        posteriors={
            fit.channel: channel_posterior(fit, cells, sampling=sampling, seed=seed)
            for fit in fits[model]
            if not reasons[fit.channel]
        },
        fitted=fitted,
        held_out=held_out,
        minimum_cosine=minimum_cosine,
    )


def encoded_fit(
    view: View, form: Form, linear: Iterable[ChannelFit], cells: Grouping
) -> tuple[Photographs, ChannelFit] | None:
    """Return the photographs and the fit of encoded files if images without a stated gamma are
    encoded. Images count as encoded if decoding them, as sRGB or with a fitted exponent far from 1,
    more than halves the error of every model of linear files. The models of linear files include
    rough surfaces, because these have flat shading too.
    """
    observation = view.observation
    if observation.camera.gamma is not None:
        return None
    least = np.inf
    for fit in linear:
        least = min(least, relative_rms(fit.by_light) or 0.0)
        if least < LINEAR_ERROR:
            return None
    decoded = _decoded_from_srgb(observation)
    of_srgb = fit_channel(replace(view, observation=decoded), form, cells)
    power = fit_channel(view, replace(form, free_gamma=True), cells)
    error = relative_rms(power.by_light) or 0.0
    if not power.converged or power.natural[-1] < LEAST_EXPONENT:
        error = np.inf
    if of_srgb.converged and _error_in_srgb(of_srgb) < min(least / 2, CLOSER * error):
        unused = (NO_LEVELS,) if observation.levels else ()
        trial, observation, said = of_srgb, decoded, (SRGB, *unused)
    elif error < least / 2:
        trial, said = power, (ENCODED,)
    else:
        return None
    observation = replace(observation, findings=(*said, *observation.findings))
    if observation.within is not None:
        observation = recognise_points(
            observation, trial.vector, trial.samples, view=view, form=trial.requested
        )
        if observation.within is None:
            trial = fit_channel(replace(view, observation=observation), trial.requested, cells)
    return observation, trial


def _decoded_from_srgb(observation: Photographs) -> Photographs:
    """Return photographs whose digital numbers are decoded by the inverse of the sRGB curve."""
    black, white = observation.black, observation.white

    def linear(dn: np.ndarray | float) -> np.ndarray:
        share = jnp.asarray(np.clip((dn - black) / white, 0, 1))
        return black + white * np.asarray(srgb_decode(share))

    of_noise = {"gain": None, "read_noise": None}  # of encoded numbers
    return replace(
        observation,
        dn=linear(observation.dn),
        clip=float(linear(observation.clip)),
        camera=observation.camera.model_copy(update={"gamma": 1.0} | of_noise),
        levels=None,
        **of_noise,
    )


def _error_in_srgb(fit: ChannelFit) -> float:
    """Return the relative RMS error, in encoded digital numbers, of a fit to decoded images."""
    samples = fit.samples
    trusted = samples.dn < samples.clip
    predicted, measured = (
        np.asarray(srgb_encode(np.maximum(dn[trusted] - samples.black, 0) / samples.white))
        for dn in (predict(fit.vector, samples).dn, samples.dn)
    )
    return float(np.sqrt(np.sum((predicted - measured) ** 2) / np.sum(measured**2)))


def _reasons_of_curved(fits: Sequence[ChannelFit]) -> dict[str, dict[str, str]]:
    """Return the reasons why channels of encoded images are reported without numbers. This is the
    case if a channel's residuals are correlated, because no interval then includes the error of its
    curve."""
    names = [parameter.name for parameter in parameter_space(fits[0].requested)]
    curved = [fit.channel for fit in fits if fit.design_effect > CORRELATED]
    return {channel: dict.fromkeys(names, NO_GAMMA) for channel in curved}


def open_parameters(fit: ChannelFit, without_lobe: ChannelFit) -> dict[str, str]:
    """Return the parameters of the requested form that the data do not determine, by name, with the
    reasons.

    A lobe counts as significant if BIC prefers the fit to Lambert's (`without_lobe`). A test by the
    lobe's standard error would be invalid, because the best of many lobes always fits slightly
    better than none (Davies, Biometrika 64, 1977).
    """
    wanted = [parameter.name for parameter in parameter_space(fit.requested)]
    present = [parameter.name for parameter in fit.space]
    reasons = dict.fromkeys(
        (name for name in wanted if name not in present),
        "the best fit has none: its amplitude is zero",
    )
    of_lobe = () if fit.form.model == "lambert" else ("specular", shape_of(fit.form.model).name)
    size = fit.samples.dn.size / fit.design_effect
    effect = fit.design_effect
    gain = 2 * (fit.log_evidence(effect) - without_lobe.log_evidence(effect))
    if fit.form.model != "lambert" and gain < 2 * np.log(size):
        unseen = (
            "a fit without a highlight is as good"
            if "specular" in present
            else "the surface looks smooth: Lambert's model is as good"
        )
        reasons |= dict.fromkeys((name for name in of_lobe if name in present), unseen)
    if fit.turned is not None and not fit.turned.followed:
        astray = f"lights would have to be rotated by {fit.turned.size:.2g} times direction_sd"
        for name in of_lobe:
            if name in present:
                reasons.setdefault(name, astray)
    if not fit.converged:
        reasons |= dict.fromkeys(present, "the fit did not converge")
    elif "specular" in present and (seen := samples_in_highlight(fit)) < FEWEST_IN_HIGHLIGHT:
        narrow = (
            f"the highlight is narrower than the samples: it is seen by only {seen:.1f} of them"
        )
        for name in of_lobe:
            reasons.setdefault(name, narrow)
    if fit.robustness is None:
        for name, inflation in zip(present, fit.identifiability.inflation, strict=True):
            if not np.isfinite(inflation):
                reasons.setdefault(name, "the data do not determine it (see the findings)")
        return reasons
    half_widths = stdtrit(fit.robustness.freedom, 0.975) * np.sqrt(
        np.diagonal(fit.robustness.covariance)
    )
    for name, half_width in zip(present, half_widths, strict=True):
        if half_width > ndtri(0.975) * OPEN_LOG_SD:
            factor = np.exp(min(float(half_width), 30.0))
            why = f"its 95 % interval is from 1/{factor:.2g} to {factor:.2g} times its value"
            reasons.setdefault(name, why)
    return reasons


def samples_in_highlight(fit: ChannelFit) -> float:
    """Return the effective number of samples in the fitted highlight: the square of the sum of the
    lobe's signals, divided by the sum of their squares."""
    matt = np.array(fit.vector)
    matt[[parameter.name for parameter in fit.space].index("specular")] -= NEGLIGIBLE
    lobe = np.asarray(predict(fit.vector, fit.samples).dn - predict(matt, fit.samples).dn)
    squares = float(np.sum(lobe**2))
    return float(np.sum(lobe)) ** 2 / squares if squares > 0 else 0.0


def mean_residual(calibration: ReflectanceCalibration) -> Float[np.ndarray, " pixels"]:
    """Return, for each pixel, the relative residual (measured - predicted) / predicted. The
    measured and predicted signals are summed over the lights and channels in which the pixel is lit
    and unsaturated; NaN if there are no such lights.
    """
    return _relative(calibration, axis=0)


def residual_of_images(calibration: ReflectanceCalibration) -> Float[np.ndarray, " lights"]:
    """Return the mean relative residual of each light's image, over pixels and channels."""
    return _relative(calibration, axis=1)


def _relative(calibration: ReflectanceCalibration, *, axis: int) -> np.ndarray:
    observation = calibration.observation
    shape = observation.cosine.shape
    difference, total = np.zeros(shape), np.zeros(shape)
    lit = observation.cosine > calibration.minimum_cosine
    for channel, fit in enumerate(calibration.chosen_fits):
        seen = lights_as_fitted(observation, fit)
        for light in range(len(observation.files)):
            used = lit[light] & (observation.dn[channel, light] < observation.clip)
            predicted = predicted_image(seen, fit, light)
            difference[light] += np.where(used, observation.dn[channel, light] - predicted, 0)
            total[light] += np.where(used, predicted - observation.black, 0)
    apart, signal = difference.sum(axis=axis), total.sum(axis=axis)
    return np.where(signal > 0, apart / np.where(signal > 0, signal, 1), np.nan)
