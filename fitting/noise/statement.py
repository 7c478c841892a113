"""Photon transfer at one setting as a `Problem`, and the choice of the effects that a camera's
model needs.

The first model is a linear camera with pixel noise, and with noise of rows, columns or frames if
the darks show it. Further effects are tried if this model fails (p < 0.1 %), or if nearest
neighbours covary, which the chi-square of means and variances may not reveal. In both cases,
effects that are evident in the darks alone (a drifting black level, or excess scatter of the
variances) are always included. The candidates are random errors of the light, a compression of one
or two terms, a light offset, the brighter-fatter effect, linear mixing, and a black level that
drifts from level to level. A candidate is kept if its squared Wald ratio exceeds the logarithm of
the number of observations (Schwarz' criterion, BIC) and if such a ratio occurs by chance in fewer
than one of a hundred cameras (`inference.candidates`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxvision.core.parallel_loops import map_
from jaxvision.errors import InputError

from ..inference.candidates import Candidate, price, squared_ratios, weakest
from ..inference.compiled import compiled_briefly
from ..inference.parameters import ParameterSpace, names, to_natural, to_unconstrained
from ..inference.problem import Problem, least_squares_residuals
from ..inference.search import Optimum, negative_log_density, present_numbers, search
from .doubts import Drifting
from .emva1288 import Ranges, Sheet, derived_figures, linearity_errors
from .levels import PhotonTransfer
from .model import (
    CountedLevels,
    LevelStatistics,
    NoiseData,
    OffsetData,
    compressed,
    predict,
    predicted_moments,
)
from .neighbours import are_known, neighbour_data
from .quantised import FINEST_READ_NOISE, Window
from .quantities import (
    BLACK_SCATTER,
    BRIGHTER_FATTER,
    COMPRESSION,
    COMPRESSION_2,
    DARK_CURRENT,
    LIGHT_DRIFT,
    LIGHT_OFFSET,
    LIGHT_SCATTER,
    OFFSET,
    OFFSET_SPREAD,
    PIXEL_MIXING,
    READ_NOISE,
    RESPONSIVITY,
    SCATTERS,
    SHUTTER_OFFSET,
    SIGNAL_RATE,
    SYSTEM_GAIN,
    VARIANCE_SCATTER,
)
from .regressions import MISFIT, inflation, line_misfit, p_value, sampling_errors
from .shared import drift, shared_noise

START_NOISES = 12  # read noises tried if a likelihood has several optima
START_SHIFTS = (-0.3, 0.0, 0.3)  # shifts of the black level, in codes, tried with each read noise
START_SPREADS = (0.8, 1.0, 1.3)  # factors on the observed spread of the offsets, tried too
FINEST_SPREAD = 1e-3  # DN
SCATTER_STARTS = {"light_scatter": 3e-3, "variance_scatter": 5e-3}
SPURIOUS = 0.01  # probability of keeping a term that a camera does not have
SPURIOUS_SHARING = 0.001  # the same for sharing between neighbours, which biases the gain
SPURIOUS_BESIDE = 0.05  # the same if nearest neighbours covary significantly
SHARING = (BRIGHTER_FATTER, PIXEL_MIXING)
FEWEST_DRIFTING = 6  # levels of light that distinguish a drift of the lamp from its scatter
DECIDED = 10.0  # difference of the BIC from which one model is much better (Kass & Raftery, 1995)
CURVE = (COMPRESSION, COMPRESSION_2, LIGHT_OFFSET, SHUTTER_OFFSET)

Rows = Float[Array, "levels 4"]  # mean, temporal variance, T, spatial variance; NaN where unknown


def noise_data(
    measurement: PhotonTransfer,
    usable: Int[np.ndarray, " usable"],
    *,
    window: Window | None = None,
    offsets: OffsetData | None = None,
    counted: CountedLevels | None = None,
) -> tuple[NoiseData, Rows]:
    """Return inputs and data of a problem: usable bright levels, then all darks."""
    bright, dark = measurement.bright, measurement.dark
    index = jnp.asarray(usable)

    def row(name: str) -> Array:
        return jnp.concatenate([getattr(bright, name)[index], getattr(dark, name)])

    unsteady = bright.unsteady
    if unsteady is not None:
        unsteady = jnp.concatenate([unsteady[index], jnp.zeros_like(dark.mean)])
    dtype, around = bright.mean.dtype, neighbour_data(measurement, usable)
    lit = jnp.concatenate([jnp.ones(index.size, dtype), jnp.zeros(dark.mean.size, dtype)])
    rows = [row("mean"), row("variance"), *2 * [jnp.full_like(lit, jnp.nan)]]
    if around.total is not None:
        rows[2] = jnp.where(lit > 0, around.total, jnp.nan)
    if offsets is not None:
        rows[3] = jnp.where(lit > 0, jnp.nan, offsets.spatial)
    order = jnp.linspace(-0.5, 0.5, index.size, dtype=dtype)
    if bright.taken is not None:
        since = bright.taken[index] - jnp.min(bright.taken[index])
        order = jnp.where(jnp.max(since) > 0, since / jnp.max(since) - 0.5, order)
    inputs = NoiseData(
        series=jnp.concatenate([order, jnp.zeros(dark.mean.size, dtype)]),
        light=row("light"),
        lit=lit,
        exposure=row("exposure"),
        frames=row("frames"),
        pixels=bright.pixels,
        top_signal=jnp.max(bright.mean[index]) - jnp.min(dark.mean),
        light_step=measurement.light_step,
        window=window,
        photons_known=measurement.photons_known,
        shared=shared_noise(dark),
        neighbours=around,
        offsets=offsets,
        unsteady=unsteady,
        converter=measurement.converter,
        counted=counted,
    )
    return inputs, jnp.stack(rows, axis=1)


def make_problem(
    space: ParameterSpace, inputs: NoiseData, rows: Rows, *, candidates: Sequence[Candidate] = ()
) -> Problem:
    """Make the problem of a camera with these parameters and candidate effects."""
    free = {one.name: one for one in space} | {one.name: one for one in candidates}
    return Problem(free, predict, LevelStatistics(), rows, inputs=inputs)


def replace_parameters(
    problem: Problem, space: ParameterSpace, *, candidates: Sequence[Candidate] = ()
) -> Problem:
    """Make a problem with the same data and other parameters."""
    assert problem.present is not None  # darks have no T
    rows = jnp.where(problem.present, problem.data, jnp.nan)
    return make_problem(space, problem.inputs, rows, candidates=candidates)


def base_space(
    measurement: PhotonTransfer, within: Ranges, *, offsets: OffsetData | None = None
) -> ParameterSpace:
    """Return the parameters of a linear camera."""
    responsivity = RESPONSIVITY if measurement.photons_known else SIGNAL_RATE
    space = (SYSTEM_GAIN, responsivity, OFFSET, READ_NOISE)
    if offsets is not None:
        space = (*space, OFFSET_SPREAD)
    return (*space, DARK_CURRENT) if within.dark_exposures > 2 else space


def natural_values(space: ParameterSpace, vector: Float[Array, " p"]) -> dict[str, Array]:
    """Convert an unconstrained vector to parameters in natural units, by name."""
    return dict(zip(names(space), to_natural(space, vector), strict=True))


@dataclass(frozen=True)
class LikelihoodFit:
    """The fit of one model."""

    problem: Problem  # of its parameters, and of candidates that may be absent
    without: tuple[str, ...]  # names of the absent candidates
    optimum: Optimum  # of the P other parameters
    chi_square: float  # of all residuals

    @property
    def space(self) -> ParameterSpace:
        """The P fitted parameters."""
        return tuple(one for one in self.problem.space if one.name not in self.without)

    @property
    def data(self) -> NoiseData:
        """The inputs of the problem: light, exposure and frames of the levels, and more."""
        return self.problem.inputs

    @property
    def degrees(self) -> int:
        return observations(self.problem) - len(self.space)

    @property
    def p_value(self) -> float:
        return p_value(self.chi_square, self.degrees)

    @property
    def inflation(self) -> float:
        """Factor on the covariance for a significant misfit."""
        return inflation(self.chi_square, self.degrees)

    @property
    def bic(self) -> float:
        price = float(np.log(observations(self.problem)))
        return 2 * self.optimum.cost + len(self.space) * price

    @property
    def values(self) -> dict[str, Array]:
        return natural_values(self.space, jnp.asarray(self.optimum.vector))

    @property
    def covariance(self) -> np.ndarray:
        """(P, P) covariance of the parameters on the unconstrained scale, not inflated by a
        misfit."""
        return np.linalg.inv(self.optimum.information)

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors on the unconstrained scale, inflated by a significant misfit."""
        variances = self.inflation * np.diagonal(self.covariance)
        return dict(zip(names(self.space), np.sqrt(variances).tolist(), strict=True))


def observations(problem: Problem) -> int:
    """Return the number of known data, over all levels and quantities."""
    assert problem.present is not None
    return int(np.sum(problem.present))


def start_vector(problem: Problem, standard: Sheet) -> Float[Array, " p"]:
    """Return the start: the standard's figures, no compression, slight scatter."""
    data, (mean, variance, _, spatial) = problem.inputs, problem.data.T
    dark, gain = data.lit == 0, standard["system_gain"]
    responsivity = data.top_signal / jnp.max(data.light)
    black, rate = jnp.min(jnp.where(dark, mean, jnp.inf)), jnp.asarray(0.0, gain.dtype)
    if "dark_current" in names(problem.space):  # a line through the darks
        weights = jnp.where(dark & (variance > 0), 1 / variance, 0)
        middle, level = (jnp.average(x, weights=weights) for x in (data.exposure, mean))
        late = data.exposure - middle
        rate = jnp.sum(weights * late * mean) / jnp.sum(weights * late**2)
        black = level - rate * middle
    starts = {
        "system_gain": gain,
        "responsivity": responsivity,
        "signal_rate": responsivity,
        "black_level": black,
        "read_noise": standard["read_noise"],
        "dark_current": rate / gain,
        "black_scatter": jnp.std(mean, where=dark),
        "offset_spread": jnp.sqrt(jnp.maximum(jnp.mean(spatial, where=dark), FINEST_SPREAD**2)),
    }
    natural = [
        starts.get(p.name, jnp.asarray(SCATTER_STARTS.get(p.name, 0.0), gain.dtype))
        for p in problem.space
    ]
    start = to_unconstrained(problem.space, jnp.stack(natural))
    return start if data.window is None else _best_start(problem, start)


@eqx.filter_jit
def _best_start(problem: Problem, start: Array) -> Array:
    """Return the most likely of several starting points, which differ in read noise and black
    level. If darks are clipped, or have less noise than a code, two explanations fit them: a large
    read noise with the black level in the middle of a code, and a small read noise with the black
    level near the edge of a code."""
    labels, data = names(problem.space), problem.inputs
    largest = 2 * jnp.sqrt(jnp.max(jnp.where(data.lit == 0, problem.data[:, 1], 0)))
    shares = jnp.linspace(0, 1, START_NOISES, dtype=start.dtype)
    step = data.converter.step
    log_noise = jnp.log(FINEST_READ_NOISE * step) * (1 - shares) + jnp.log(largest + step) * shares
    log_gain = start[labels.index(SYSTEM_GAIN.name)]
    tried = {  # read noise in place of the start's, steps of the others from it
        READ_NOISE.name: log_noise - log_gain - start[labels.index(READ_NOISE.name)],
        OFFSET.name: step * jnp.asarray(START_SHIFTS, start.dtype),
    }
    if OFFSET_SPREAD.name in labels:
        tried[OFFSET_SPREAD.name] = jnp.log(jnp.asarray(START_SPREADS, start.dtype))
    steps = jnp.stack([x.ravel() for x in jnp.meshgrid(*tried.values())], axis=1)
    places = jnp.asarray([labels.index(name) for name in tried])
    starts = jnp.tile(start, (len(steps), 1)).at[:, places].add(steps)
    costs = map_(lambda vector: negative_log_density(vector, problem), starts)
    return starts[jnp.nanargmin(costs)]


def fit_model(
    problem: Problem,
    standard: Sheet,
    *,
    without: Sequence[str] = (),
    near: LikelihoodFit | None = None,
) -> LikelihoodFit:
    """Fit one model, without some candidates, from the optimum of a fit `near` if given."""
    start = np.array(start_vector(problem, standard))
    if near is not None:
        start[np.isin(names(problem.space), names(near.space))] = near.optimum.vector
    try:
        optimum = search(problem, start[None], without=without)
    except InputError as error:
        if near is not None:  # the other model's optimum is out of bounds for this model
            return fit_model(problem, standard, without=without)
        raise InputError(
            "the likelihood of the levels is nowhere finite; look for levels whose frames are all "
            "alike, as clipped or hardly dithered ones are, or whose light flickers within a "
            "frame, and leave them out."
        ) from error
    _, whole = present_numbers(problem, without)
    chi_square = _chi_square(jnp.asarray(whole(optimum.vector[None])[0]), problem)
    return LikelihoodFit(problem, tuple(without), optimum, float(chi_square))


@compiled_briefly
def _chi_square(vector: Array, problem: Problem) -> Array:
    return jnp.sum(least_squares_residuals(vector, problem) ** 2)


def fit_without_levels(fit: LikelihoodFit, left_out: Bool[np.ndarray, " levels"]) -> Optimum:
    """Fit the same model, with the same compiled program, without some levels (not the first)."""
    gone, problem = jnp.asarray(left_out)[:, None], fit.problem
    assert problem.present is not None
    problem = eqx.tree_at(
        lambda p: (p.data, p.present),
        problem,
        (jnp.where(gone, 0, problem.data), problem.present & ~gone),
    )
    counted = problem.inputs.counted
    if counted is not None:
        kept_out = jnp.asarray(left_out, float)[counted.levels]
        problem = eqx.tree_at(lambda p: p.inputs.counted.kept_out, problem, kept_out)
    _, whole = present_numbers(problem, fit.without)
    return search(problem, whole(fit.optimum.vector[None]), without=fit.without)


def posterior_problem(fit: LikelihoodFit) -> Problem:
    """Return the problem of fitted parameters, with wider errors and scatter priors."""
    problem = replace_parameters(fit.problem, fit.space) if fit.without else fit.problem
    scattered = any(name in SCATTERS for name in names(fit.space))
    return eqx.tree_at(
        lambda p: (p.likelihood, p.inputs),
        problem,
        (LevelStatistics(1 / fit.inflation), replace(problem.inputs, jeffreys=scattered)),
    )


def likelihood_sheet(
    vector: Float[Array, " p"],
    saturation: Float[Array, ""] | None,
    args: tuple[ParameterSpace, NoiseData, Bool[Array, " levels"]],
) -> Sheet:
    """Compute the standard's figures from the likelihood's, at zero signal."""
    space, data, linearity = args
    values = natural_values(space, vector)
    gain = values["system_gain"]
    responsivity = values["responsivity" if data.photons_known else "signal_rate"]
    dark_variance = (gain * values["read_noise"]) ** 2 + data.converter.rounding
    figures = derived_figures(
        *(gain, responsivity, dark_variance, saturation),
        photons_known=data.photons_known,
        converter=data.converter,
    )
    if (
        data.window is not None
    ):  # the dark noise in the darks, not the read noise before the converter
        shown = predicted_moments(values, data, data.light).variance[jnp.argmin(data.lit)]
        figures["temporal_dark_noise"] = jnp.sqrt(shown)
    if "compression" in values:
        curve = compressed(values, responsivity * data.light, data.top_signal)
        low, high = linearity_errors(data.light, curve, linearity)
        figures |= {"linearity_error_min": low, "linearity_error_max": high}
    return figures


def gain_drop(values: dict[str, Array], data: NoiseData) -> Array:
    """Return 1 - h'(X), the relative loss of gain at the brightest level X."""
    top = data.top_signal
    return 1 - jax.grad(lambda x: compressed(values, x, top))(top)


def dark_scatter(measurement: PhotonTransfer) -> ParameterSpace:
    """Return the effects of darks that scatter about their line beyond known noise."""
    dark = measurement.dark
    errors = sampling_errors(dark, shared=shared_noise(dark))
    found = []
    for effect, values, variances in (
        (BLACK_SCATTER, dark.mean, errors.mean),
        (VARIANCE_SCATTER, dark.variance, errors.variance),
    ):
        chi_square, degrees = line_misfit(dark.exposure, values, variances)
        if p_value(float(chi_square), float(degrees)) < MISFIT:
            found.append(effect)
    return tuple(found)


def candidates_for(
    measurement: PhotonTransfer, inputs: NoiseData, always: ParameterSpace, *, sharing: bool
) -> tuple[Candidate, ...]:
    """Return the candidates: effects that a camera may need in addition to its basic parameters."""
    offset = LIGHT_OFFSET if measurement.photons_known else SHUTTER_OFFSET
    by_chance = SPURIOUS_BESIDE if sharing else SPURIOUS_SHARING
    found = [
        Candidate(LIGHT_SCATTER, chance=1),
        *(Candidate(one, chance=SPURIOUS) for one in (COMPRESSION, offset)),
        Candidate(COMPRESSION_2, chance=SPURIOUS, requires=COMPRESSION.name),
    ][: int(jnp.sum(inputs.lit)) - 3]
    found.append(Candidate(BRIGHTER_FATTER, chance=by_chance, side="above"))  # charges repel
    if are_known(inputs.neighbours):
        found.append(Candidate(PIXEL_MIXING, chance=by_chance))
    if BLACK_SCATTER not in always and drift(measurement.dark).is_significant:
        found.append(Candidate(BLACK_SCATTER, chance=1))
    return tuple(found)


def choose_model(
    measurement: PhotonTransfer,
    problem: Problem,
    standard: Sheet,
    *,
    trend: Drifting | None = None,
    sharing: bool = False,
) -> tuple[LikelihoodFit, LikelihoodFit]:
    """Return the fit of a linear camera, and the fit of the model that describes this camera.

    `sharing`: whether nearest neighbours covary significantly."""
    linear = fit_model(problem, standard)
    if linear.p_value >= MISFIT and not sharing:
        return linear, linear
    always = linear.space + dark_scatter(measurement)
    candidates = candidates_for(measurement, problem.inputs, always, sharing=sharing)
    whole = replace_parameters(problem, always, candidates=candidates)
    chosen = _drop_candidates(fit_model(whole, standard), standard, sharing)
    drifts = False
    if trend is not None and any(p in chosen.space for p in CURVE):
        # Means deviate by half as much as the slope does, and darks in between double the time.
        bend = abs(float(gain_drop(chosen.values, chosen.data)))
        drifts = bend <= 4 * abs(trend.total)
    if drifts or (chosen.p_value < MISFIT and any(p in chosen.space for p in CURVE)):
        # A drift of the light from level to level resembles a curved response, which a search may
        # find although the variances contradict it.
        bent = [one.name for one in candidates if one.parameter in CURVE]
        other = _drop_candidates(fit_model(whole, standard, without=bent), standard, sharing)
        described = drifts and other.p_value >= MISFIT
        chosen = other if described else min(chosen, other, key=lambda fit: fit.bic)
    chosen = _drifting_lamp(chosen, whole, candidates, standard, sharing)
    shares = any(p in chosen.space for p in SHARING)
    return (linear, chosen) if shares or chosen.bic < linear.bic else (linear, linear)


def _drifting_lamp(
    chosen: LikelihoodFit,
    whole: Problem,
    candidates: Sequence[Candidate],
    standard: Sheet,
    sharing: bool,
) -> LikelihoodFit:
    """Return the better of two models: the given model, and a model in which the light drifts over
    the series instead of a curved response. Both effects bend the means over the light, but only a
    curved response changes the variance at a given signal. If the data do not favour one model,
    both effects are fitted, so that the errors include the uncertainty of the choice."""
    bends = COMPRESSION in chosen.space
    if int(jnp.sum(chosen.data.lit)) < FEWEST_DRIFTING or not (
        bends or LIGHT_OFFSET in chosen.space or LIGHT_SCATTER in chosen.space
    ):
        return chosen
    straight = [one for one in candidates if one.parameter not in (COMPRESSION, COMPRESSION_2)]
    drift = Candidate(LIGHT_DRIFT, chance=SPURIOUS)
    always = tuple(p for p in whole.space if p.name not in {one.name for one in candidates})
    problem = replace_parameters(whole, always, candidates=[*straight, drift])
    lamp = _drop_candidates(fit_model(problem, standard), standard, sharing)
    if LIGHT_DRIFT not in lamp.space or lamp.bic > chosen.bic + DECIDED:
        return chosen
    if not bends or lamp.bic < chosen.bic - DECIDED:
        return min(chosen, lamp, key=lambda fit: fit.bic)
    both = fit_model(replace_parameters(whole, (*chosen.space, LIGHT_DRIFT)), standard, near=chosen)
    bend, change = (
        (float(both.values[p.name]) / both.errors[p.name]) ** 2 for p in (COMPRESSION, LIGHT_DRIFT)
    )
    return chosen if bend > DECIDED > change else both


def _drop_candidates(fit: LikelihoodFit, standard: Sheet, sharing: bool) -> LikelihoodFit:
    """Drop candidates that fail the criterion, the weakest first, and fit again each time. If
    nearest neighbours covary significantly (`sharing`), the stronger of mixing and brighter-fatter
    effect stays in the model, however uncertain its size. Without either effect, the gain would be
    wrong by more than its error."""
    while True:
        there = [one for one in fit.problem.candidates if one.name not in fit.without]
        forms = [one for one in there if one.parameter in SHARING]
        if sharing and len(forms) == 1:
            there.remove(forms[0])
        optimum = fit.optimum
        ratios = squared_ratios(fit.space, optimum.vector, optimum.information, there)
        prices = {one.name: _price(fit, one, sharing) for one in there}
        unearned = weakest(dict(zip(prices, ratios, strict=True)), prices, there)
        if unearned is None:
            return fit
        fit = fit_model(fit.problem, standard, without=(*fit.without, unearned), near=fit)


def _price(fit: LikelihoodFit, candidate: Candidate, sharing: bool) -> float:
    """Return the squared Wald ratio that a candidate must exceed. Mixing or repulsion of neighbours
    shifts the gain by as many standard errors as its own Wald ratio, so the threshold for these two
    effects is high. Chance exceeds this threshold in one of a thousand cameras, or in one of twenty
    if nearest neighbours covary significantly. If the light of m levels scatters about a curve of q
    terms, the fitted variance of the scatter is uncertain, and too small by the factor (m - q) / m.
    Therefore a term of the curve must pass Fisher's F test."""
    count, scatter = float(observations(fit.problem)), None
    if sharing and candidate.parameter in SHARING:
        count = 1.0
    if LIGHT_SCATTER in fit.space and candidate.parameter in CURVE:
        scatter = int(jnp.sum(fit.data.lit)), 1 + sum(p in fit.space for p in CURVE)
    return price(count, chance=candidate.chance, scatter=scatter)
