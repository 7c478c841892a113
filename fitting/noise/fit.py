"""Fits of the photon transfer likelihood: its data, one model, and the figures that it gives."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxvision.errors import InputError

from ..inference.newton import NewtonSolution, minimise
from ..inference.parameters import ParameterSpace, names, to_unconstrained
from .emva1288 import Ranges, Sheet, derived_figures, linearity_errors
from .levels import PhotonTransfer
from .misfit import inflation, p_value
from .model import (
    CountedLevels,
    NoiseData,
    OffsetData,
    Residuals,
    compressed,
    cost,
    log_likelihood_terms,
    named,
    predicted_moments,
)
from .neighbours import are_known, neighbour_data
from .quantised import FINEST_READ_NOISE, Window
from .quantities import (
    DARK_CURRENT,
    OFFSET,
    OFFSET_SPREAD,
    READ_NOISE,
    RESPONSIVITY,
    SIGNAL_RATE,
    SYSTEM_GAIN,
)
from .shared import shared_noise

START_NOISES = 12  # read noises tried where a likelihood has several optima
START_SHIFTS = (-0.3, 0.0, 0.3)  # codes, of the black level tried with each
START_SPREADS = (0.8, 1.0, 1.3)  # times the observed spread of the offsets, likewise
FINEST_SPREAD = 1e-3  # DN
LOG_NONE = -25.0  # logarithm of a scatter that is none
SCATTER_STARTS = {"light_scatter": 3e-3, "variance_scatter": 5e-3}


@dataclass(frozen=True)
class LikelihoodFit:
    """One fitted model.

    Attributes:
        space: the P parameters.
        data: levels that were fitted.
        solution: vector, information and convergence.
        residuals: standardised.
        chi_square: of all residuals.
        degrees: of freedom.
        among: name of a larger model whose compiled program made this fit; empty for its own
            program.
    """

    space: ParameterSpace
    data: NoiseData
    solution: NewtonSolution
    residuals: Residuals
    chi_square: float
    degrees: int
    among: ParameterSpace = ()

    @property
    def p_value(self) -> float:
        return p_value(self.chi_square, self.degrees)

    @property
    def inflation(self) -> float:
        """Factor on the covariance."""
        return inflation(self.chi_square, self.degrees)

    @property
    def bic(self) -> float:
        price = float(np.log(observations(self.data)))
        return 2 * float(self.solution.cost) + len(self.space) * price

    @property
    def values(self) -> dict[str, Array]:
        return named(self.space, self.solution.vector)

    @property
    def covariance(self) -> np.ndarray:
        """Of the unconstrained vector, not inflated."""
        return np.linalg.inv(np.asarray(self.solution.information))

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors on the unconstrained scale, inflated."""
        variances = self.inflation * np.diagonal(self.covariance)
        return dict(zip(names(self.space), np.sqrt(variances).tolist(), strict=True))


def noise_data(
    measurement: PhotonTransfer,
    usable: Int[np.ndarray, " usable"],
    *,
    window: Window | None = None,
    offsets: OffsetData | None = None,
    counted: CountedLevels | None = None,
) -> NoiseData:
    """Bright levels and all darks in one row."""
    bright, dark = measurement.bright, measurement.dark
    index = jnp.asarray(usable)

    def row(name: str) -> Array:
        return jnp.concatenate([getattr(bright, name)[index], getattr(dark, name)])

    step, unsteady = measurement.light_step, bright.unsteady
    if unsteady is not None:
        unsteady = jnp.concatenate([unsteady[index], jnp.zeros_like(dark.mean)])
    dtype = bright.mean.dtype
    lit = jnp.concatenate([jnp.ones(index.size, dtype), jnp.zeros(dark.mean.size, dtype)])

    return NoiseData(
        light=row("light"),
        lit=lit,
        exposure=row("exposure"),
        mean=row("mean"),
        variance=row("variance"),
        frames=row("frames"),
        pixels=bright.pixels,
        top_signal=jnp.max(bright.mean[index]) - jnp.min(dark.mean),
        light_step=step,
        window=window,
        photons_known=measurement.photons_known,
        shared=shared_noise(dark.shared, dark.variance, dark.frames),
        neighbours=neighbour_data(measurement, usable),
        offsets=offsets,
        unsteady=unsteady,
        converter=measurement.converter,
        used=jnp.ones_like(lit),
        counted=counted,
    )


def base_space(
    measurement: PhotonTransfer, within: Ranges, *, offsets: OffsetData | None = None
) -> ParameterSpace:
    """The parameters of a linear camera."""
    responsivity = RESPONSIVITY if measurement.photons_known else SIGNAL_RATE
    space = (SYSTEM_GAIN, responsivity, OFFSET, READ_NOISE)
    if offsets is not None:
        space = (*space, OFFSET_SPREAD)
    return (*space, DARK_CURRENT) if within.dark_exposures > 2 else space


def start_vector(space: ParameterSpace, standard: Sheet, data: NoiseData) -> Float[Array, " p"]:
    """Where a fit starts: the standard's figures, no compression, slight scatter."""
    dark = data.lit == 0
    gain = standard["system_gain"]
    responsivity = data.top_signal / jnp.max(data.light)
    starts = {
        "system_gain": gain,
        "responsivity": responsivity,
        "signal_rate": responsivity,
        "black_level": jnp.min(jnp.where(dark, data.mean, jnp.inf)),
        "read_noise": standard["read_noise"],
        "dark_current": jnp.asarray(0.0, gain.dtype),
        "black_scatter": jnp.std(data.mean, where=dark),
    }
    if data.offsets is not None:
        spatial = jnp.mean(data.offsets.spatial, where=dark)
        starts["offset_spread"] = jnp.sqrt(jnp.maximum(spatial, FINEST_SPREAD**2))
    natural = [
        starts.get(p.name, jnp.asarray(SCATTER_STARTS.get(p.name, 0.0), gain.dtype)) for p in space
    ]
    return to_unconstrained(space, jnp.stack(natural))


def _fit_among(
    whole: ParameterSpace,
    space: ParameterSpace,
    data: NoiseData,
    standard: Sheet,
    near: LikelihoodFit | None,
) -> tuple[NewtonSolution, Array]:
    """The most likely vector of a model that lacks some effects of a larger one. The program of the
    larger model finds it with the sizes of these effects fixed at none, so that all candidate
    models share one compilation. It also returns the vector of the larger model."""
    lacking = jnp.asarray([parameter not in space for parameter in whole])
    start = start_vector(whole, standard, data)
    none = jnp.asarray([0.0 if p.transform == "identity" else LOG_NONE for p in whole])
    none = none.astype(start.dtype)
    if near is not None:
        held = np.array([parameter in near.space for parameter in whole])
        start = none.at[np.flatnonzero(held)].set(near.solution.vector)
    start = jnp.where(lacking, none, start)
    if data.window is not None and near is None:
        start = jnp.where(lacking, none, _best_start(whole, data, start))
    found = minimise(_cost_without, start, (whole, data, lacking, none))
    # By NumPy: JAX would compile, and keep, programs for each number of effects.
    present = np.flatnonzero(~np.asarray(lacking))
    vector, information = np.asarray(found.vector), np.asarray(found.information)
    own = eqx.tree_at(
        lambda solution: (solution.vector, solution.information),
        found,
        (jnp.asarray(vector[present]), jnp.asarray(information[np.ix_(present, present)])),
    )
    return own, found.vector


def _cost_without(
    vector: Float[Array, " p"], args: tuple[ParameterSpace, NoiseData, Array, Array]
) -> Array:
    """`cost` with some effects fixed at none. Each contributes half the square of its own vector,
    so that the Hessian stays regular."""
    space, data, lacking, none = args
    held = jnp.where(lacking, none, vector)
    return cost(held, (space, data)) + jnp.sum(jnp.where(lacking, (vector - none) ** 2, 0)) / 2


def fit_space(space: ParameterSpace, data: NoiseData, standard: Sheet) -> NewtonSolution:
    """The most likely vector of one model; pure, so cameras of equal structure can be vmapped."""
    start = start_vector(space, standard, data)
    if data.window is not None:
        start = _best_start(space, data, start)
    return minimise(cost, start, (space, data))


@eqx.filter_jit
def _best_start(space: ParameterSpace, data: NoiseData, start: Array) -> Array:
    """The most likely of several starting read noises and black levels. Clipped or hardly dithered
    darks have several optima: a large noise about the middle of a code, and a small one near its
    edge."""
    labels = names(space)
    noise, black = labels.index(READ_NOISE.name), labels.index(OFFSET.name)
    largest = 2 * jnp.sqrt(jnp.max(jnp.where(data.lit == 0, data.variance, 0)))
    shares = jnp.linspace(0, 1, START_NOISES, dtype=start.dtype)
    step = data.converter.step
    finest = jnp.log(FINEST_READ_NOISE * step)
    log_noise = finest * (1 - shares) + jnp.log(largest + step) * shares
    log_gain = start[labels.index(SYSTEM_GAIN.name)]
    starts = start[None].at[:, noise].set(-log_gain)

    def moved(starts: Array, place: int, by: Array) -> Array:
        return jax.vmap(lambda x: starts.at[:, place].add(x))(by).reshape(-1, start.size)

    starts = moved(starts, noise, log_noise)
    starts = moved(starts, black, step * jnp.asarray(START_SHIFTS, start.dtype))
    if OFFSET_SPREAD.name in labels:
        factors = jnp.log(jnp.asarray(START_SPREADS, start.dtype))
        starts = moved(starts, labels.index(OFFSET_SPREAD.name), factors)
    costs = jax.lax.map(lambda vector: cost(vector, (space, data)), starts)
    return starts[jnp.nanargmin(costs)]


def fitted(
    space: ParameterSpace,
    data: NoiseData,
    standard: Sheet,
    *,
    among: ParameterSpace = (),
    near: LikelihoodFit | None = None,
) -> LikelihoodFit:
    """Fit one model and test it."""
    if among:
        solution, vector = _fit_among(among, space, data, standard, near)
        if near is not None and not bool(jnp.isfinite(solution.cost)):
            # The larger model's end is out of bounds for this one.
            solution, vector = _fit_among(among, space, data, standard, None)
    else:
        solution = fit_space(space, data, standard)
        vector = solution.vector
    if not bool(jnp.isfinite(solution.cost)):
        raise InputError(
            "the likelihood of the levels is nowhere finite; look for levels whose frames are all "
            "alike, as clipped or hardly dithered ones are, or whose light flickers within a "
            "frame, and leave them out."
        )
    residuals = _residuals(vector, (among or space, data))
    chi_square = float(sum(jnp.sum(x**2) for x in jax.tree.leaves(residuals)))
    degrees = observations(data) - len(space)
    return LikelihoodFit(space, data, solution, residuals, chi_square, degrees, among)


def fitted_without(
    fit: LikelihoodFit, left_out: Bool[np.ndarray, " levels"], standard: Sheet
) -> NewtonSolution:
    """The same model fitted by the same compiled program without some levels."""
    kept = jnp.asarray(~left_out, fit.data.mean.dtype)
    data = eqx.tree_at(lambda data: data.used, fit.data, kept)
    if fit.among:
        return _fit_among(fit.among, fit.space, data, standard, fit)[0]
    return minimise(cost, fit.solution.vector, (fit.space, data))


def observations(data: NoiseData) -> int:
    """The number of observations."""
    of_neighbours = int(jnp.sum(data.lit)) if are_known(data.neighbours) else 0
    of_offsets = int(jnp.sum(data.lit == 0)) if data.offsets is not None else 0
    return 2 * data.mean.size + of_neighbours + of_offsets


@eqx.filter_jit
def _residuals(vector: Array, args: tuple[ParameterSpace, NoiseData]) -> Residuals:
    space, data = args
    return log_likelihood_terms(named(space, vector), data)[1]


def likelihood_sheet(
    vector: Float[Array, " p"],
    saturation: Float[Array, ""] | None,
    args: tuple[ParameterSpace, NoiseData, Bool[Array, " levels"]],
) -> Sheet:
    """The standard's figures from the likelihood's parameters, with gain and responsivity at zero
    signal.
    """
    space, data, linearity = args
    values = named(space, vector)
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
    ):  # what the darks show, not what reads into a well-dithered converter
        shown = predicted_moments(values, data, data.light).variance[jnp.argmin(data.lit)]
        figures["temporal_dark_noise"] = jnp.sqrt(shown)
    if "compression" in values:
        curve = compressed(values, responsivity * data.light, data.top_signal)
        low, high = linearity_errors(data.light, curve, linearity)
        figures |= {"linearity_error_min": low, "linearity_error_max": high}
    return figures


def gain_drop(values: dict[str, Array], data: NoiseData) -> Array:
    """1 - h'(X): the relative decrease of the gain from zero signal to the brightest level."""
    top = data.top_signal
    return 1 - jax.grad(lambda x: compressed(values, x, top))(top)
