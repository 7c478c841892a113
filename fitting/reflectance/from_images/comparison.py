"""Which model describes the surface: by what it predicts, and by what its fit costs.

Held-out lights decide: the relative error of images that no fit has seen. AIC and BIC judge the
fit itself; pixels of one image share their errors, so the log likelihood and the sample size are
divided by the design effect of the best model before they enter

    AIC = -2 log L / d + 2 P,      BIC = -2 log L / d + P log(N / d).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ...report.section import Table
from ..models import LABELS, Model
from .fit import ChannelFit
from .model import predicted_dn
from .read import ReflectanceObservation
from .samples import Selection, make_samples

ALIKE = 0.005  # relative RMS within which models predict equally well
DECISIVE = 10.0  # difference of BIC, summed over channels, that counts as very strong evidence


@dataclass(frozen=True)
class ModelScore:
    """How one model does in one channel. fitted_error, predicted_error: relative RMS on the lights
    of the fit and on the held-out ones (None without any). aic, bic: less the best model's.
    effective_size: samples that the fit's samples are worth."""

    model: Model
    channel: str
    fitted_error: float
    predicted_error: float | None
    parameters: int
    aic: float
    bic: float
    effective_size: float


def relative_error(
    observation: ReflectanceObservation, fit: ChannelFit, selection: Selection
) -> float | None:
    """RMS of predicted - measured over the RMS of the measured signal above black, on unsaturated
    samples; None without samples."""
    if not len(selection.light):
        return None
    channel = observation.channels.index(fit.channel)
    samples = make_samples(observation, channel, fit.form, selection)
    predicted = np.asarray(predicted_dn(jnp.asarray(fit.vector), samples), np.float64)
    measured = np.asarray(samples.dn, np.float64)
    trusted = measured < observation.clip
    error = (predicted - measured)[trusted]
    signal = (measured - observation.black)[trusted]
    return float(np.sqrt(np.mean(error**2) / np.mean(signal**2)))


def compare(
    observation: ReflectanceObservation,
    fits: Mapping[Model, Sequence[ChannelFit]],
    fitted: Selection,
    held_out: Selection,
) -> tuple[ModelScore, ...]:
    """Scores of every model in every channel."""
    scores = []
    for i in range(len(observation.channels)):
        channel: dict[Model, ChannelFit] = {model: fits[model][i] for model in fits}
        best = max(channel.values(), key=lambda fit: fit.log_likelihood)
        size = best.samples.dn.size / best.design_effect
        deviance = {
            model: -2 * fit.log_likelihood / best.design_effect for model, fit in channel.items()
        }
        aic = {model: deviance[model] + 2 * len(fit.space) for model, fit in channel.items()}
        bic = {m: deviance[m] + np.log(size) * len(fit.space) for m, fit in channel.items()}
        for model, fit in channel.items():
            fitted_error = relative_error(observation, fit, fitted)
            assert fitted_error is not None
            scores.append(
                ModelScore(
                    model=model,
                    channel=fit.channel,
                    fitted_error=fitted_error,
                    predicted_error=relative_error(observation, fit, held_out),
                    parameters=len(fit.space),
                    aic=float(aic[model] - min(aic.values())),
                    bic=float(bic[model] - min(bic.values())),
                    effective_size=size,
                )
            )
    return tuple(scores)


def comparison_table(scores: Sequence[ModelScore], held_out: int) -> Table:
    """The scores as a table."""
    return Table(
        title="Models compared",
        columns=(
            "channel",
            "model",
            "held-out relative RMS",
            "fitted relative RMS",
            "parameters",
            "ΔAIC",
            "ΔBIC",
            "effective samples",
        ),
        rows=tuple(
            (
                score.channel,
                LABELS[score.model],
                score.predicted_error,
                score.fitted_error,
                score.parameters,
                round(score.aic, 1),
                round(score.bic, 1),
                round(score.effective_size),
            )
            for score in scores
        ),
        caption=f"Relative RMS over unsaturated lit pixels, held out: {held_out} lights that no "
        "fit has seen. ΔAIC and ΔBIC are differences from the channel's best, with the likelihood "
        "and the sample size divided by the design effect.",
    )


def verdict(scores: Sequence[ModelScore], held_out: int) -> str:
    """The winner and by how much, as one sentence."""
    channels = tuple(dict.fromkeys(score.channel for score in scores))
    by_model: dict[Model, list[ModelScore]] = {}
    for score in scores:
        by_model.setdefault(score.model, []).append(score)
    costs: dict[Model, float] = {
        model: float(sum(score.bic for score in own)) for model, own in by_model.items()
    }
    cheapest = _least(costs)
    if not held_out:
        return (
            f"{LABELS[cheapest]} has the smallest BIC; without held-out lights its prediction is "
            "untested."
        )
    errors: dict[Model, np.ndarray] = {
        model: np.array([score.predicted_error for score in own], float)
        for model, own in by_model.items()
    }
    best = _least({model: float(of_channels.mean()) for model, of_channels in errors.items()})
    equal: list[Model] = [
        model for model in errors if np.all(np.abs(errors[model] - errors[best]) <= ALIKE)
    ]
    how = "predict best and equally well" if len(equal) > 1 else "predicts best"
    sentence = (
        f"On {held_out} held-out lights {' and '.join(LABELS[m] for m in equal)} {how}: relative "
        f"RMS {_percentages(errors[best])} ({', '.join(channels)})"
    )
    if "lambert" not in equal:
        fall = 1 - errors[best] / errors["lambert"]
        sentence += (
            f", against {_percentages(errors['lambert'])} for Lambert, "
            f"{_percentages(fall, digits=0)} less"
        )
    if len(equal) > 1:
        lead = min(costs[model] - costs[cheapest] for model in equal if model != cheapest)
        sentence += (
            f"; BIC prefers {LABELS[cheapest]} by {lead:.0f}"
            if lead > DECISIVE
            else "; BIC does not decide between them"
        )
    return sentence + "."


def _least(values: dict[Model, float]) -> Model:
    return min(values.items(), key=lambda item: item[1])[0]


def _percentages(values: np.ndarray, *, digits: int = 1) -> str:
    return " / ".join(f"{100 * value:.{digits}f}" for value in values) + " %"
