"""Fits of the photon transfer likelihood, and the choice of what a camera calls for.

A linear camera with pixel noise only comes first. Where it misses the measurement (p < 0.1 %),
what the darks alone show, a wandering black level or variances that scatter more than pixel noise
can, joins; random errors of the light, a compression of one or two terms and an offset of the light
are fitted with it, and each stays only if it earns its parameter by Schwarz' criterion (BIC): a
squared Wald ratio above the logarithm of the number of observations.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.stats import chi2

from jaxvision.sensor import QUANTISATION_VARIANCE

from ..inference.newton import NewtonSolution, minimise
from ..inference.parameters import Parameter, ParameterSpace, names, to_unconstrained
from .emva1288 import Ranges, Sheet, derived_figures, linearity_errors
from .levels import PhotonTransfer
from .model import (
    BLACK_SCATTER,
    COMPRESSION,
    COMPRESSION_2,
    DARK_CURRENT,
    LIGHT_OFFSET,
    LIGHT_SCATTER,
    OFFSET,
    READ_NOISE,
    RESPONSIVITY,
    SHUTTER_OFFSET,
    SIGNAL_RATE,
    SYSTEM_GAIN,
    VARIANCE_SCATTER,
    NoiseData,
    Residuals,
    compressed,
    cost,
    log_likelihood_terms,
    named,
)
from .quantised import FINEST_READ_NOISE, Window, window_for
from .regressions import line_misfit

MISFIT = 1e-3  # p-value below which a model is not believed
FINE_READ_NOISE = 0.4  # DN; below, the variance of rounding is not 1/12
NEAR_BLACK = 4.5  # standard deviations above 0 DN within which clipping changes the moments
AFFECTED_DEVIATION = 1.0  # DN; levels noisier than this see rounding as 1/12 in any case
START_NOISES = 12  # read noises tried where a likelihood has several optima
START_SHIFTS = (-0.3, 0.0, 0.3)  # DN, of the black level tried with each
SCATTER_STARTS = {"light_scatter": 3e-3, "variance_scatter": 5e-3}


@dataclass(frozen=True)
class LikelihoodFit:
    """One fitted model.

    Attributes:
        space: the P parameters.
        data: levels it was fitted to.
        solution: vector, information and convergence.
        residuals: standardised.
        chi_square: of all residuals.
        degrees: of freedom.
    """

    space: ParameterSpace
    data: NoiseData
    solution: NewtonSolution
    residuals: Residuals
    chi_square: float
    degrees: int

    @property
    def p_value(self) -> float:
        return float(chi2.sf(self.chi_square, max(self.degrees, 1)))

    @property
    def inflation(self) -> float:
        """Factor on the covariance: chi-square per degree of freedom where it is beyond chance
        (Birge), else 1."""
        return self.chi_square / self.degrees if self.p_value < MISFIT else 1.0

    @property
    def bic(self) -> float:
        observations = 2 * self.data.mean.size
        return 2 * float(self.solution.cost) + len(self.space) * float(np.log(observations))

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
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"], *, window: Window | None = None
) -> NoiseData:
    """Bright levels and all darks in one row.

    Args:
        measurement: bright and dark levels.
        usable: indices of the bright levels to use.
        window: of the levels that need exact moments.

    Returns:
        The data of a fit.
    """
    bright, dark = measurement.bright, measurement.dark
    index = jnp.asarray(usable)

    def row(name: str) -> Array:
        return jnp.concatenate([getattr(bright, name)[index], getattr(dark, name)])

    step = measurement.light_step
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
    )


def needed_window(measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]) -> Window | None:
    """The exact moments that clipped black or fine read noise call for.

    Args:
        measurement: bright and dark levels.
        usable: indices of the bright levels to use.

    Returns:
        The window; None where the usual moments do.
    """
    data = noise_data(measurement, usable)
    mean, variance, lit = (np.asarray(x) for x in (data.mean, data.variance, data.lit))
    deviation, dark = np.sqrt(variance), lit == 0
    near_black = mean < NEAR_BLACK * deviation
    clipped = bool(near_black[dark].any())
    fine = bool(variance[dark].min() < FINE_READ_NOISE**2 + QUANTISATION_VARIANCE)
    if not fine and not clipped:
        return None
    affected = near_black | (deviation < AFFECTED_DEVIATION) | dark
    # Clipping hides up to half of a deviation.
    widest = (2 if clipped else 1.2) * float(deviation[affected].max())
    read_noise = float(np.sqrt(max(variance[dark].max() - QUANTISATION_VARIANCE, 0)))
    levels = tuple(int(i) for i in np.flatnonzero(affected))
    return window_for(levels, mean[affected], deviation=widest, read_noise=read_noise)


def base_space(measurement: PhotonTransfer, within: Ranges) -> ParameterSpace:
    """The parameters of a linear camera.

    Args:
        measurement: whose light is counted in photons or in seconds.
        within: whose number of dark exposures decides on a dark current.

    Returns:
        The space.
    """
    responsivity = RESPONSIVITY if measurement.photons_known else SIGNAL_RATE
    space = (SYSTEM_GAIN, responsivity, OFFSET, READ_NOISE)
    return (*space, DARK_CURRENT) if within.dark_exposures > 2 else space


def start_vector(space: ParameterSpace, standard: Sheet, data: NoiseData) -> Float[Array, " p"]:
    """Where a fit starts: the standard's figures, no compression, slight scatter.

    Args:
        space: the P parameters.
        standard: the standard's sheet.
        data: of the fit.

    Returns:
        (P,) unconstrained.
    """
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
    natural = [
        starts.get(p.name, jnp.asarray(SCATTER_STARTS.get(p.name, 0.0), gain.dtype)) for p in space
    ]
    return to_unconstrained(space, jnp.stack(natural))


def fit_space(space: ParameterSpace, data: NoiseData, standard: Sheet) -> NewtonSolution:
    """The most likely vector of one model; pure, so cameras of equal structure can be vmapped.

    Args:
        space: the P parameters.
        data: of the fit.
        standard: the standard's sheet, from which the fit starts.

    Returns:
        Where the fit ended.
    """
    start = start_vector(space, standard, data)
    if data.window is not None:
        start = _best_start(space, data, start)
    return minimise(cost, start, (space, data))


def _best_start(space: ParameterSpace, data: NoiseData, start: Array) -> Array:
    """The most likely of a few read noises and black levels. Clipped or hardly dithered darks have
    several optima: a wide noise about the middle of a code, a fine one near its edge."""
    labels = names(space)
    noise, black = labels.index(READ_NOISE.name), labels.index(OFFSET.name)
    largest = 2 * jnp.sqrt(jnp.max(jnp.where(data.lit == 0, data.variance, 0)))
    shares = jnp.linspace(0, 1, START_NOISES, dtype=start.dtype)
    log_noise = jnp.log(FINEST_READ_NOISE) * (1 - shares) + jnp.log(largest + 1) * shares
    log_gain = start[labels.index(SYSTEM_GAIN.name)]
    shifts = jnp.asarray(START_SHIFTS, start.dtype)

    def moved(log_read_noise: Array, shift: Array) -> Array:
        return start.at[noise].set(log_read_noise - log_gain).at[black].add(shift)

    starts = jax.vmap(lambda x: jax.vmap(lambda shift: moved(x, shift))(shifts))(log_noise)
    starts = starts.reshape(-1, start.size)
    costs = jax.lax.map(lambda vector: cost(vector, (space, data)), starts)
    return starts[jnp.nanargmin(costs)]


def fitted(space: ParameterSpace, data: NoiseData, standard: Sheet) -> LikelihoodFit:
    """One model fitted and judged.

    Args:
        space: the P parameters.
        data: of the fit.
        standard: the standard's sheet, from which the fit starts.

    Returns:
        The fit.
    """
    solution = fit_space(space, data, standard)
    residuals = _residuals(solution.vector, (space, data))
    chi_square = float(jnp.sum(residuals.mean**2) + jnp.sum(residuals.variance**2))
    return LikelihoodFit(
        space, data, solution, residuals, chi_square, 2 * data.mean.size - len(space)
    )


@eqx.filter_jit
def _residuals(vector: Array, args: tuple[ParameterSpace, NoiseData]) -> Residuals:
    space, data = args
    return log_likelihood_terms(named(space, vector), data)[1]


def dark_scatter(measurement: PhotonTransfer, within: Ranges) -> ParameterSpace:
    """The random effects that the darks show about their own lines over exposure.

    Args:
        measurement: bright and dark levels.
        within: whose number of dark exposures must be three at least.

    Returns:
        Their parameters.
    """
    dark = measurement.dark
    if within.dark_exposures <= 2:
        return ()
    n, frames = dark.pixels, dark.frames
    of_mean, of_variance = dark.variance / (n * frames), 2 * dark.variance**2 / ((frames - 1) * n)
    found = []
    for effect, values, variances in (
        (BLACK_SCATTER, dark.mean, of_mean),
        (VARIANCE_SCATTER, dark.variance, of_variance),
    ):
        chi_square, degrees = line_misfit(dark.exposure, values, variances)
        if chi2.sf(float(chi_square), float(degrees)) < MISFIT:
            found.append(effect)
    return tuple(found)


def choose_model(
    measurement: PhotonTransfer, within: Ranges, data: NoiseData, standard: Sheet
) -> tuple[LikelihoodFit, LikelihoodFit]:
    """The model that a camera calls for.

    Args:
        measurement: bright and dark levels.
        within: the standard's ranges.
        data: of the fit.
        standard: the standard's sheet, from which fits start.

    Returns:
        (linear camera, chosen model); the same fit twice where the linear camera does.
    """
    linear = fitted(base_space(measurement, within), data, standard)
    if linear.p_value >= MISFIT:
        return linear, linear
    bright_levels = int(jnp.sum(data.lit))
    offset = LIGHT_OFFSET if measurement.photons_known else SHUTTER_OFFSET
    candidates = (LIGHT_SCATTER, COMPRESSION, offset, COMPRESSION_2)[: bright_levels - 3]
    space = linear.space + dark_scatter(measurement, within) + candidates
    chosen = fitted(space, data, standard)
    while unearned := _unearned(chosen, candidates):
        space = tuple(p for p in chosen.space if p is not unearned)
        chosen = fitted(space, data, standard)
    return (linear, chosen) if chosen.bic < linear.bic else (linear, linear)


def _unearned(fit: LikelihoodFit, candidates: tuple[Parameter, ...]) -> Parameter | None:
    """The weakest candidate in the model that does not pay for itself; the second term of the
    compression before the first."""
    price = float(np.log(2 * fit.data.mean.size))
    ratios = {}
    labels = names(fit.space)
    information = np.asarray(fit.solution.information)
    for parameter in candidates:
        if parameter not in fit.space or (parameter is COMPRESSION and COMPRESSION_2 in fit.space):
            continue
        i = labels.index(parameter.name)
        own = np.delete(np.delete(information, i, 0), i, 1)
        across = np.delete(information[i], i)
        precision = information[i, i] - across @ np.linalg.lstsq(own, across, rcond=None)[0]
        # The ratio of a positive scale to its error is one over the error of its logarithm.
        size = float(fit.solution.vector[i]) if parameter.transform == "identity" else 1.0
        ratios[parameter] = size**2 * max(precision, 0.0)
    weakest = min(ratios, key=ratios.__getitem__, default=None)
    return weakest if weakest is not None and ratios[weakest] < price else None


def likelihood_sheet(
    vector: Float[Array, " p"],
    saturation: Float[Array, ""] | None,
    args: tuple[ParameterSpace, NoiseData, Bool[Array, " levels"]],
) -> Sheet:
    """The standard's figures from the likelihood's parameters, gain and responsivity at zero
    signal.

    Args:
        vector: (P,) unconstrained.
        saturation: light at saturation; None without.
        args: (space, data, levels of the linearity range).

    Returns:
        Figures by name. The linearity errors are those of the fitted curve, left out where it is
        straight.
    """
    space, data, linearity = args
    values = named(space, vector)
    gain = values["system_gain"]
    responsivity = values["responsivity" if data.photons_known else "signal_rate"]
    dark_variance = (gain * values["read_noise"]) ** 2 + QUANTISATION_VARIANCE
    figures = derived_figures(
        gain, responsivity, dark_variance, saturation, photons_known=data.photons_known
    )
    if "compression" in values:
        curve = compressed(values, responsivity * data.light, data.top_signal)
        low, high = linearity_errors(data.light, curve, linearity)
        figures |= {"linearity_error_min": low, "linearity_error_max": high}
    return figures


def gain_drop(values: dict[str, Array], data: NoiseData) -> Array:
    """1 - h'(X): by what fraction the gain falls from zero signal to the brightest level.

    Args:
        values: natural parameters by name.
        data: for X.

    Returns:
        The fraction.
    """
    top = data.top_signal
    return 1 - jax.grad(lambda x: compressed(values, x, top))(top)
