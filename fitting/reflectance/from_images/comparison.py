"""Comparison of reflectance models by their predictions of held-out lights and by AIC and BIC.

The model with the smallest relative error on held-out lights is best. Because all models predict
the same lights, errors are compared light by light. The standard error of a difference is estimated
by the jackknife over lights. Models count as equal if, in every channel, the 95 % interval of the
difference by Student's t contains zero. A difference within the precision of the solvers counts as
zero. AIC and BIC assess the fit itself. Pixels of one image share their errors, so the log
likelihood log L and the number of samples N are divided by the design effect d of the best model.
With P parameters,

    AIC = -2 log L / d + 2 P,      BIC = -2 log L / d + P log(N / d).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ...inference.formatting import format_percent, format_with_error
from ...report.section import Section, Table, describing_nothing
from ..models import LABELS
from ..names import SHOWS, Model
from .fit import ChannelFit, lights_as_fitted, squared_errors
from .read import Photographs
from .samples import Selection, View, predict

LEVEL = 0.975  # quantile of Student's t within which a difference counts as none
SAME = 1e-6  # relative difference of errors below which it comes from the solvers' tolerance
DECISIVE = 10.0  # difference of BIC, summed over channels, that counts as very strong evidence


@dataclass(frozen=True)
class ModelScore:
    """How well one model fits and predicts one channel."""

    model: Model
    channel: str
    fitted_error: float  # relative RMS on the lights of the fit
    predicted_error: float | None  # on the held-out ones; None without any
    parameters: int  # number of parameters
    aic: float  # difference from the best model's AIC
    bic: float  # difference from the best model's BIC
    effective_size: float  # number of independent samples with the same information
    # sums of squared errors and of squared signals on the held-out lights; None without any
    by_light: Float[np.ndarray, "lights 2"] | None


@dataclass(frozen=True)
class Difference:
    """The difference of two models' errors on held-out lights."""

    value: float  # of the relative RMS
    error: float = float("inf")  # its standard error; infinite with fewer than two lights
    freedom: int = 0  # degrees of freedom of the error

    @property
    def half_width(self) -> float:
        """Return half the width of the 95 % interval."""
        return self.error * float(stdtrit(self.freedom, LEVEL)) if self.freedom else float("inf")

    @property
    def none(self) -> bool:
        """Return whether both predictions are equal."""
        return self.value == 0 and self.error == 0


def difference(one: ModelScore, other: ModelScore) -> Difference:
    """Return the difference of the relative RMS of two models, paired by light.

    The error of the difference is infinite without held-out lights. A difference below a millionth
    of the errors is 0 with an error of 0.
    """
    if one.by_light is None or other.by_light is None or len(one.by_light) < 2:
        return Difference((one.predicted_error or 0.0) - (other.predicted_error or 0.0))
    freedom = len(one.by_light) - 1
    sums = np.stack([one.by_light, other.by_light])
    total = sums.sum(axis=1)
    whole, without = (np.sqrt(x[..., 0] / x[..., 1]) for x in (total, total[:, None] - sums))
    if abs(whole[0] - whole[1]) <= SAME * whole.min():
        return Difference(0.0, 0.0, freedom)
    error = float(np.sqrt(freedom * np.var(without[0] - without[1])))
    return Difference(float(whole[0] - whole[1]), error, freedom)


def squares_by_light(
    observation: Photographs, fit: ChannelFit, selection: Selection
) -> Float[np.ndarray, "lights 2"] | None:
    """Return two sums over each light's unsaturated samples, (lights, 2): of squared (predicted -
    measured), and of squared signals above black. Return None if there are no samples.
    """
    if not len(selection.light):
        return None
    seen = View(lights_as_fitted(observation, fit), fit.view.channel, selection)
    samples = seen.samples(fit.form)
    return squared_errors(predict(fit.vector, samples).dn, samples, selection)


def relative_rms(by_light: Float[np.ndarray, "lights 2"] | None) -> float | None:
    """Return RMS error over RMS signal by `squares_by_light`; None without samples."""
    if by_light is None or not len(by_light):
        return None
    error, signal = by_light.sum(axis=0)
    return float(np.sqrt(error / signal))


def compare(
    observation: Photographs, fits: Mapping[Model, Sequence[ChannelFit]], held_out: Selection
) -> tuple[ModelScore, ...]:
    """Score every model in every channel, on the fitted and on the held-out samples."""
    scores = []
    for of_models in zip(*fits.values(), strict=True):
        best = max(of_models, key=lambda fit: fit.log_evidence(1.0))
        size = best.samples.dn.size / best.design_effect
        counts = np.array([len(fit.space) for fit in of_models])
        deviance = -2 * np.array([fit.log_evidence(best.design_effect) for fit in of_models])
        criteria = deviance + np.array([[2.0], [np.log(size)]]) * counts
        criteria -= criteria.min(axis=1, keepdims=True)
        for model, fit, (aic, bic) in zip(fits, of_models, criteria.T, strict=True):
            unseen = squares_by_light(observation, fit, held_out)
            error = relative_rms(fit.by_light)
            assert error is not None
            scores.append(
                ModelScore(
                    *(model, fit.channel, error, relative_rms(unseen), len(fit.space)),
                    *(float(aic), float(bic), size, unseen),
                )
            )
    return tuple(scores)


def comparison_table(scores: Sequence[ModelScore], held_out: int) -> Table:
    """Tabulate the scores."""
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
        caption=f"Relative RMS over unsaturated lit pixels; held out: {_lights(held_out)} that no "
        "fit has seen. ΔAIC and ΔBIC are differences from the channel's best, with the likelihood "
        "and the sample size divided by the design effect.",
    )


def _scores_by_model(scores: Sequence[ModelScore]) -> dict[Model, list[ModelScore]]:
    found: dict[Model, list[ModelScore]] = {}
    for score in scores:
        found.setdefault(score.model, []).append(score)
    return found


def _bic(by_model: Mapping[Model, Sequence[ModelScore]]) -> dict[Model, float]:
    """Return the BIC of each model, summed over channels."""
    return {m: float(sum(score.bic for score in own)) for m, own in by_model.items()}


def _differences(own: Sequence[ModelScore], other: Sequence[ModelScore]) -> list[Difference]:
    return [difference(a, b) for a, b in zip(own, other, strict=True)]


def equally_good(scores: Sequence[ModelScore]) -> tuple[Model, ...]:
    """Return the models whose predictions of held-out lights differ insignificantly from those of
    the best model in every channel. The best model comes first. If predictions are exactly equal,
    the model that was fitted first comes first. Without held-out lights, return the model with the
    smallest BIC.
    """
    by_model = _scores_by_model(scores)
    if any(score.predicted_error is None for score in scores):
        costs = _bic(by_model)
        return (_least(costs),)
    errors: dict[Model, float] = {
        m: sum(s.predicted_error or 0.0 for s in own) for m, own in by_model.items()
    }
    least = _least(errors)
    alike: list[Model] = [
        m for m in by_model if all(g.none for g in _differences(by_model[m], by_model[least]))
    ]
    best = alike[0] if alike else least
    others: list[Model] = [
        model
        for model, own in by_model.items()
        if model != best
        and all(g.freedom and g.value <= g.half_width for g in _differences(own, by_model[best]))
    ]
    return (best, *others)


def surpassed_by(scores: Sequence[ModelScore], model: Model) -> tuple[Model, str] | None:
    """Return a model that is better than the given model, with the difference in words; None if no
    model is better. The better model predicts held-out lights better or, if these do not decide,
    has a decisively smaller BIC.
    """
    by_model, equal = _scores_by_model(scores), equally_good(scores)
    tested = all(gap.freedom for gap in _differences(by_model[model], by_model[equal[0]]))
    if tested and model not in equal:
        more = _more(by_model[model], by_model[equal[0]])
        return equal[0], f"has {more} error on unseen lights than"
    costs = _bic({m: by_model[m] for m in (equal if tested else by_model)})
    cheapest = _least(costs)
    lead = costs[model] - costs[cheapest]
    return (cheapest, f"has a BIC larger by {lead:.0f} than") if lead > DECISIVE else None


def verdict(scores: Sequence[ModelScore], held_out: int) -> str:
    """Name the best model and its lead over the others, in one or two sentences."""
    channels, by_model = tuple(dict.fromkeys(s.channel for s in scores)), _scores_by_model(scores)
    costs = _bic(by_model)
    cheapest = _least(costs)
    if not held_out:
        return (
            f"{LABELS[cheapest]} has the smallest BIC; without held-out lights its prediction is "
            "untested."
        )
    errors: dict[Model, np.ndarray] = {
        m: np.array([s.predicted_error for s in own], float) for m, own in by_model.items()
    }
    equal = equally_good(scores)
    best = equal[0]
    sentence = ""
    if errors[best].max() > SHOWS:
        sentence = (
            "No model here describes the images: the error of the best is "
            f"{_percentages(errors[best])} of the signal, above the limit of "
            f"{format_percent(SHOWS)}. Causes are a surface unlike all models or of varying albedo "
            "(texture), or a rig that does not state files, lights, shape or camera correctly "
            "(gamma, black level, near lamps, the sphere's centre, perspective, rows of two "
            "exposures). "
        )
    sentence += (
        f"On {_lights(held_out, 'held-out ')} {LABELS[best]} predicts best: relative RMS "
        f"{_percentages(errors[best])} ({', '.join(channels)})"
    )
    if "lambert" not in equal:
        fall = 1 - errors[best] / errors["lambert"]
        sentence += (
            f", {_percentages(fall, digits=0)} below the {_percentages(errors['lambert'])} of "
            "Lambert"
        )
    sentence += "."
    if len(equal) > 1:
        others = ", ".join(f"{LABELS[m]} ({_more(by_model[m], by_model[best])})" for m in equal[1:])
        # few lights determine their scatter poorly
        freedom = min(gap.freedom for gap in _differences(by_model[equal[1]], by_model[best]))
        sentence += (
            f" Not distinguishable from it by these lights: {others}. With {_lights(freedom + 1)} a"
            f" difference counts from {stdtrit(freedom, LEVEL):.1f} standard errors on, by"
            f" Student's t with {freedom} degree{'' if freedom == 1 else 's'} of freedom at 95 %."
        )
        lead = min(costs[m] - costs[cheapest] for m in costs if m != cheapest)
        if lead > DECISIVE:
            sentence += (
                f" The fitted lights do distinguish them: BIC prefers {LABELS[cheapest]} by "
                f"{lead:.0f}."
            )
    elif held_out < 2:
        sentence += " One light does not show how much of a difference is chance."
    elif len(by_model) > 1:
        rest: dict[Model, float] = {m: float(e.sum()) for m, e in errors.items() if m != best}
        runner = _least(rest)
        more = _more(by_model[runner], by_model[best])
        sentence += f" The next, {LABELS[runner]}, has {more} error."
    return sentence


def only_if_described(section: Section, label: str, errors: Mapping[str, float]) -> Section:
    """Return a section without the numbers of those channels in which the relative error of the
    model's prediction exceeds the limit. `label` names the model.
    """
    missed = {channel: error for channel, error in errors.items() if error > SHOWS}
    if not missed:
        return section
    sizes = ", ".join(f"{format_percent(error)} ({name})" for name, error in missed.items())
    return describing_nothing(
        section,
        f"{label} does not describe the images: its error is {sizes} of the signal, above the "
        f"limit of {format_percent(SHOWS)}; its parameters are not properties of the surface, and "
        "no material is written.",
        missed,
    )


def _least(values: dict[Model, float]) -> Model:
    return min(values.items(), key=lambda item: item[1])[0]


def _lights(count: int, kind: str = "") -> str:
    return f"{count} {kind}light{'' if count == 1 else 's'}"


def _more(own: Sequence[ModelScore], best: Sequence[ModelScore]) -> str:
    """Return the differences by channel in words, in percentage points with errors."""
    gaps = _differences(own, best)
    if all(gap.none for gap in gaps):
        return "the same"
    shown = ("0" if g.none else format_with_error(100 * g.value, 100 * g.error) for g in gaps)
    return f"{' / '.join(shown)} percentage points more"


def _percentages(values: np.ndarray, *, digits: int = 1) -> str:
    return " / ".join(f"{100 * value:.{digits}f}" for value in values) + " %"
