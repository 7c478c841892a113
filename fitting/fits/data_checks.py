"""Check data against their likelihood: are they clipped, are they rounded, and do the stated
standard deviations follow each datum's own noise?

These checks reveal faults of the data that can make a fit fail although its model is right.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..codes import converter_of
from ..inference.likelihoods import Clustered
from ..inference.misfit import Misfit
from ..inference.on_host import to_host
from ..inference.parameters import unconstrained_numbers
from ..inference.problem import Problem, likelihood_at, prediction, values_at
from .widening import predicted_at

FEWEST = 10  # data
PIXELS = 1000  # pixels of a map whose data are checked
PILED, STEEP = 5, 3.0  # fewest data at an end, and ratio to those at each neighbouring value
BESIDE = 8  # values next to an end
CONSTANT = 0.5  # share of simulated data that differ from data that are all equal
# Number and share of repeated values from which copies are reported: two rounded numbers may be
# equal by chance.
FEWEST_COPIED, COPIED = 3, 0.1
SINGLE = 100_000  # number of data from which rounding to float32 makes many equal
BEYOND = 3  # fewest data that the fit must predict beyond an end to call the others clipped
COARSE = 1.0  # step of the data, in standard deviations of the noise, that is not negligible
CROSSED = 0.1  # share of neighbours, ordered by prediction, whose standard deviations decrease
FELT, WRONG = 0.5, 2.0  # standard errors between totals of fit and data: finding, failure


@dataclass(frozen=True)
class DataCheck:
    """Findings about the data of a fit; those in `failures` explain a misfit."""

    failures: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    overrated: bool = False  # whether the standard deviations do not measure the noise


def data_check(
    problem: Problem, vector: np.ndarray, checks: Misfit, *, explained: bool, seed: int
) -> DataCheck:
    """Check the data of a problem against its best fit."""
    data = to_host(problem.data, dtype=np.float64)
    there = np.ones(data.shape, bool) if problem.present is None else to_host(problem.present)
    known = data[there]
    if known.size < FEWEST:
        return DataCheck()
    seen = _FitOfPresent(problem, vector, there)
    faulty = bool(checks.faults)
    biased = None if faulty else _errors_of_data(seen, known)
    if biased is not None:
        return biased
    found = _find_repeats(seen, known, faulty=faulty, overrated=bool(checks.remarks), seed=seed)
    if faulty and not explained:
        return DataCheck(failures=found)
    return DataCheck(findings=found)


def data_check_of_map(
    problem: Problem,
    data: np.ndarray,
    natural: np.ndarray,
    inputs: Sequence[Any],
    *,
    faulty: bool,
    seed: int,
) -> tuple[str, ...]:
    """Check the data (..., pixels) of a map, all pixels together, against the pixels' best fits
    (parameters, pixels), and return the findings. `faulty` says whether many pixels are misfits.
    """
    good = np.flatnonzero(np.isfinite(natural).all(axis=0))
    good = good[np.unique(np.linspace(0, len(good) - 1, min(len(good), PIXELS)).astype(int))]
    data = np.moveaxis(np.asarray(data[..., good], np.float64), -1, 0)
    there = np.isfinite(data)
    if there.sum() < FEWEST:
        return ()
    vectors = unconstrained_numbers(problem.space, natural[:, good].T)
    own = [None if leaf is None else jnp.asarray(leaf[good]) for leaf in inputs]
    keys = jax.random.split(jax.random.key(seed), len(good))
    dtype = jnp.result_type(float)
    predicted, drawn = _pixel_predictions(jnp.asarray(vectors, dtype), own, keys, problem)
    seen = _FitOfPresent(problem, vectors[0], there)
    seen.known = to_host(predicted, dtype=np.float64)[there]
    seen.simulated = to_host(drawn, dtype=np.float64)[there]
    known = data[there]
    biased = None if faulty else _errors_of_data(seen, known)
    if biased is not None:
        return (*biased.failures, *biased.findings)
    return _find_repeats(seen, known, faulty=faulty, overrated=False, seed=seed)


@eqx.filter_jit
def _pixel_predictions(
    vectors: Array, inputs: list[Array | None], keys: Array, problem: Problem
) -> tuple[Array, Array]:
    """Return the predictions at the best fits and data simulated from them, each (pixels, ...)."""
    whole, form = jax.tree.flatten(problem.inputs)

    def predict_pixel(vector: Array, own: list[Array | None], key: Array) -> tuple[Array, Array]:
        values = values_at(problem, vector)
        every = [a if b is None else b for a, b in zip(whole, own, strict=True)]
        predicted = prediction(problem, values, inputs=jax.tree.unflatten(form, every))
        return predicted, likelihood_at(problem, values).draw(key, predicted)

    return jax.vmap(predict_pixel)(vectors, inputs, keys)


def _find_repeats(
    seen: "_FitOfPresent", known: np.ndarray, *, faulty: bool, overrated: bool, seed: int
) -> tuple[str, ...]:
    """Return findings about values that occur more than once in the data, or have few digits."""
    values, counts = np.unique(known, return_counts=True)
    if len(values) == len(known):
        return tuple(_find_rounding(seen, known, seed)) if faulty else ()
    if len(values) == 1:
        return _constant(seen, known, seed)
    found = _find_copies(known, counts) + _find_clipping(
        seen, values, counts, seed, overrated=overrated
    )
    if faulty:
        found += _find_rounding(seen, known, seed)
    return tuple(found)


class _FitOfPresent:
    """The predictions, simulated data and standard deviations for the data that are not missing,
    each computed at its first use.
    """

    def __init__(self, problem: Problem, vector: np.ndarray, there: np.ndarray) -> None:
        self.likelihood: Any = problem.likelihood
        if isinstance(self.likelihood, Clustered):
            self.likelihood = self.likelihood.likelihood
        self._at = problem, jnp.asarray(vector, problem.data.dtype)
        self._there = there
        self.known: np.ndarray | None = None
        self.simulated: np.ndarray | None = None

    def predicted(self) -> np.ndarray:
        """Return the predictions for the data that are not missing."""
        if self.known is None:
            problem, vector = self._at
            predicted = predicted_at(vector, problem)[0]
            self.known = to_host(predicted, dtype=np.float64)[self._there]
        return self.known

    def drawn(self, seed: int) -> np.ndarray:
        """Return simulated data in place of the data that are not missing."""
        if self.simulated is None:
            problem, vector = self._at
            predicted, likelihood = predicted_at(vector, problem)
            drawn = likelihood.draw(jax.random.key(seed), predicted)
            self.simulated = to_host(drawn, dtype=np.float64)[self._there]
        return self.simulated

    def widths(self) -> np.ndarray | None:
        """Return the standard deviations of the data that are not missing; None if all data have
        the same one.
        """
        width = getattr(self.likelihood, "sd", getattr(self.likelihood, "scale", None))
        if width is None or isinstance(width, str) or not np.ndim(width):
            return None
        own = self._there.ndim - np.ndim(width)  # a pixel axis of a map comes first
        if np.shape(width) != self._there.shape[own:]:
            return None
        return np.broadcast_to(to_host(width, dtype=np.float64), self._there.shape)[self._there]


def _errors_of_data(seen: _FitOfPresent, data: np.ndarray) -> DataCheck | None:
    """Check whether the stated standard deviations follow each datum instead of its prediction. If
    so, find by how much this biases the sum of all predictions.
    """
    widths = seen.widths()
    if widths is None or len(np.unique(widths)) < 3:
        return None
    order = np.lexsort((widths, data))
    same = np.diff(data[order]) == 0
    steps = np.diff(widths[order])
    if (steps < 0).any() or (steps[same] > 0).any():
        return None
    predicted = seen.predicted()
    if np.mean(np.diff(widths[np.argsort(predicted, kind="stable")]) < 0) < CROSSED:
        return None
    missed, error = data.sum() - predicted.sum(), float(np.sqrt(np.sum(widths**2)))
    if abs(missed) < FELT * error:
        return None
    side, other = ("low", "less") if missed > 0 else ("high", "more")
    words = (
        "The standard deviations of the data follow the data themselves: a datum that is low by "
        f"chance gets a small one and counts for more, so that the fit comes out too {side}. Its "
        f"predictions add up to {predicted.sum():.4g}, {other} than the {data.sum():.4g} ± "
        f"{error:.2g} of the data. Counts follow Poisson's law: give SensorCounts, or SensorNoise "
        "of a sensor with shot noise, or standard deviations from a first fit."
    )
    if abs(missed) > WRONG * error:
        return DataCheck(failures=(words,), overrated=True)
    return DataCheck(findings=(words,), overrated=True)


def _constant(seen: _FitOfPresent, known: np.ndarray, seed: int) -> tuple[str, ...]:
    """Return a finding if all data are equal, although the likelihood predicts that they differ."""
    if np.mean(seen.drawn(seed) != known[0]) < CONSTANT:
        return ()
    return (
        f"All {known.size} data are equal to {known[0]:.6g}, where the likelihood predicts "
        "different values: they are clipped, rounded, or copies of one, and show no noise. The fit "
        "says nothing of their error.",
    )


def _find_copies(known: np.ndarray, counts: np.ndarray) -> list[str]:
    """Return a finding if many data are equal to others, although they are neither rounded to a
    grid nor limited by float32.
    """
    rounded = known.size > SINGLE and (known == known.astype(np.float32)).all()
    few = np.sum(counts > 1) < FEWEST_COPIED or np.mean(counts > 1) < COPIED
    if few or rounded or converter_of([known]).step:
        return []
    return [
        f"Only {len(counts)} of {known.size} data are different numbers, although they are not "
        "rounded: the others are copies, as of resized pictures or repeated rows. They count as "
        "independent data, so intervals are too narrow, by a factor of "
        f"{np.sqrt(known.size / len(counts)):.2g}. Leave the copies out."
    ]


def _find_clipping(
    seen: _FitOfPresent, values: np.ndarray, counts: np.ndarray, seed: int, *, overrated: bool
) -> list[str]:
    """Return a finding for each end of the range at which data are clipped: many data are equal to
    the end value, and the fit predicts many data beyond it.
    """
    found, total = [], int(counts.sum())
    for name, side in (("largest", 1), ("smallest", -1)):
        own, many = values[::-side], counts[::-side]
        if many[0] < max(PILED, STEEP * float(many[1 : 1 + BESIDE].max(initial=0))):
            continue
        step = converter_of([values]).step
        if step and overrated:  # rounded, under noise that is overrated
            continue
        if side < 0 and step == 1 and own[0] == 0:  # counts
            continue
        beyond = int(np.sum(side * (seen.drawn(seed) - own[0]) > step))
        if beyond < BEYOND:
            continue
        end = "high" if side > 0 else "low"
        found.append(
            f"{many[0]} of {total} data are equal to the {name}, {own[0]:.6g}, and the fit "
            f"predicts {beyond} beyond it: the data are clipped there. Give the likelihood that "
            f"end, as in Censored(sd, {end}={own[0]:.6g}), or mark these data as missing (NaN)."
        )
    return found


def _find_rounding(seen: _FitOfPresent, data: np.ndarray, seed: int) -> list[str]:
    """Return a finding if the data are rounded to a step coarser than their noise and the
    likelihood ignores this.
    """
    step = converter_of([data]).step
    with np.errstate(over="ignore"):
        half = data.astype(np.float16)
    short = not step and (half == data).all()
    if not step and not short:
        return []
    drawn = seen.drawn(seed)
    if step and converter_of([drawn]).step == step:
        return []
    noise = float(np.sqrt(np.mean((drawn - seen.predicted()) ** 2)))
    if short:
        step = float(np.median(np.spacing(np.abs(half))))
    if step < COARSE * noise:
        return []
    if short:
        return [
            f"All data have the 3 digits of float16, so that half of them are rounded to {step:.4g}"
            f" or more, {step / noise:.2g} times the noise of the likelihood, {noise:.2g}. Give "
            "the data before that conversion."
        ]
    return [
        f"All data lie {step:.4g} apart or a multiple of it, which is {step / noise:.2g} times the "
        f"noise of the likelihood, {noise:.2g}: they were rounded, with an error of "
        f"{step / np.sqrt(12):.2g} rms that neighbours share. Give the data without rounding."
    ]
