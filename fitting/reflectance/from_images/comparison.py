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
from ..models import LABELS
from ..names import Model
from .fit import ChannelFit
from .model import predicted_dn
from .read import ReflectanceObservation
from .samples import Selection, make_samples

ALIKE = 0.005  # relative RMS within which models predict equally well
DECISIVE = 10.0  # difference of BIC, summed over channels, that counts as very strong evidence


@dataclass(frozen=True)
class ModelScore:
    """How one model does in one channel.

    Attributes:
        model: its name.
        channel: name.
        fitted_error: relative RMS on the lights of the fit.
        predicted_error: on the held-out ones; None without any.
        parameters: how many.
        aic: less the best model's.
        bic: less the best model's.
        effective_size: independent samples that the fit's samples are worth.
    """

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
    samples.

    Args:
        observation: of the object.
        fit: of one channel.
        selection: of the samples.

    Returns:
        The ratio; None without samples.
    """
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
    """Scores of every model in every channel.

    Args:
        observation: of the object.
        fits: of each model, by channel.
        fitted: samples that the fits have seen.
        held_out: samples that they have not.

    Returns:
        The scores.
    """
    scores = []
    for of_models in zip(*fits.values(), strict=True):
        best = max(of_models, key=lambda fit: fit.log_likelihood)
        size = best.samples.dn.size / best.design_effect
        counts = np.array([len(fit.space) for fit in of_models])
        deviance = -2 * np.array([fit.log_likelihood for fit in of_models]) / best.design_effect
        criteria = deviance + np.array([[2.0], [np.log(size)]]) * counts
        for model, fit, (aic, bic) in zip(
            fits, of_models, (criteria - criteria.min(axis=1, keepdims=True)).T, strict=True
        ):
            errors = [relative_error(observation, fit, seen) for seen in (fitted, held_out)]
            assert errors[0] is not None
            scores.append(
                ModelScore(
                    *(model, fit.channel, errors[0], errors[1], len(fit.space)),
                    *(float(aic), float(bic), size),
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
    """The winner and by how much, as one sentence.

    Args:
        scores: of every model in every channel.
        held_out: how many lights no fit has seen.

    Returns:
        The sentence.
    """
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
