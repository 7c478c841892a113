"""Prediction and likelihood of photon transfer: mean and temporal variance at each level.

    electrons  mu  = R / K (mu_p + delta) + D t
    signal     x   = K mu
    mean       y   = offset + h(x)
    variance   s^2 = h'(x)^2 K^2 V(mu) + K^2 sigma_d^2 + q^2 / 12
    neighbours T   = h'(x)^2 K^2 (mu - V(mu))       covariance of a pixel with all others, summed
    h(x)           = x (1 - c_1 x / X - c_2 (x / X)^2)
    V(mu)          = mu, or (1 - kappa) C_00(mu)

K is the gain in DN per electron and R the responsivity in DN per photon, both at zero signal. mu_p
is the light in photons per pixel, delta the light offset, D the dark current and t the exposure in
s. The means determine R a hundred times better than the variances determine K, so R and K are
hardly correlated, unlike K and the efficiency R / K.

The function h is a compression behind the gain, with the coefficients c_1 and c_2, and X is the
signal of the brightest level. Read noise sigma_d is added behind the compression. The converter has
the step q, so its rounding has the variance q^2 / 12. C_00 is the variance of a pixel whose charges
repel each other, with relative area changes a_ij per electron (Astier 2019,
`jaxvision.sensor.flat_covariances`). Here a_00 = -beta K / X, so that to first order beta is the
relative loss of variance at the brightest level. All other a_ij are proportional to the measured
covariances. The parameter kappa is the relative loss of a pixel's signal variance by linear mixing
with its neighbours. Repulsion and mixing do not change the noise of sums over many pixels.

The observed mean of L frames of n pixels is Normal with variance s^2 / (n L). Given the mean, the
observed variance has a Gamma distribution. The degrees of freedom of that distribution follow from
its sampling variance, (2 s^4 / (L - 1) + kappa_4 / L) / n, minus the part that the mean explains.
Because shot noise is skewed, mean and variance have the covariance kappa_3 / (n L). kappa_3 and
kappa_4 are the cumulants of a pixel's number. Two random effects per level are optional: an error
of the light with standard deviation tau_H mu_p, and an error of the black level with standard
deviation tau_0. A drift d of the light over the series is optional, too: the light of level i of n
changes by the factor 1 + d (i / (n - 1) - 1/2). If the files state times, the times replace i. A
drift bends the means over the light as a compression does, but does not change the variance at a
given signal.

The data of the `Problem` have a row for each level: mean, temporal variance, T, and (for darks) the
spatial variance, NaN where unknown. `predict` returns their sampling distribution as `Expected`,
and `LevelStatistics` is the likelihood.

Effects whose parameters are not fitted are not part of the compiled program. If black is clipped,
or read noise is too small to smooth the rounding (`window`), `quantised_moments` gives the exact
moments of the affected levels. If the pixels' offsets differ significantly at such levels, the
spread of the offsets is a parameter. The spatial variance of each dark level, which rounding also
changes, is then part of the data (`OffsetData`). At levels of few electrons, histograms of codes
may replace means and variances (`CountedLevels`).
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..codes import Converter
from .neighbours import NeighbourData, own_variance
from .quantised import Moments, Window, quantised_moments
from .quantities import RESPONSIVITY, SCATTERS, SIGNAL_RATE
from .shared import SharedNoise

UNKNOWN_LIGHT = 1e6  # relative variance of the light of an excluded level


class OffsetData(eqx.Module):
    """The spatial variances of the dark levels and their errors."""

    # variance of the pixels' means beyond temporal noise, DN^2; 0 at bright levels
    spatial: Float[Array, " levels"]
    # their sampling variance by temporal noise, DN^4; 0 at bright levels
    noise: Float[Array, " levels"]
    darks: Float[Array, ""]  # number of dark levels of the same pixels
    pixels: Float[Array, ""]  # effective number of independent pixels


class CountedLevels(eqx.Module):
    """The result of a fit to histograms of codes, a Gaussian that replaces the means and variances
    of dim levels."""

    levels: Int[Array, " m"]  # their indices
    # (2 + m,) logarithms of the gain (DN/e-), of the read noise (e-) and of the electrons of each
    # level
    logs: Float[Array, " logs"]
    covariance: Float[Array, "logs logs"]
    # 1 for a level that a fit leaves out, whose light is then unknown; 0 for others
    kept_out: Float[Array, " m"]


class NoiseData(eqx.Module):
    """The inputs of the `Problem`: light, exposure and number of frames of the bright levels, then
    of the dark levels, and known properties of the sensor."""

    light: Float[Array, " levels"]  # photons per pixel, or s where no photon count is known
    lit: Float[Array, " levels"]  # 1 for bright, 0 for dark
    exposure: Float[Array, " levels"]  # s
    frames: Float[Array, " levels"]
    pixels: Float[Array, ""]  # number of pixels
    top_signal: Float[Array, ""]  # X, DN
    # rounding step of the light; None where it was not rounded
    light_step: Float[Array, ""] | None = None
    # data for the exact moments of levels that need them; None where none does
    window: Window | None = None
    # whether light is counted in photons
    photons_known: bool = eqx.field(static=True, default=True)
    shared: SharedNoise | None = None  # noise of rows, columns or frames; None without
    neighbours: NeighbourData | None = None  # covariances of neighbouring pixels
    # spread of the pixels' offsets in the darks; None if rounding makes it irrelevant
    offsets: OffsetData | None = None
    # variance of a frame's mean because the light fluctuates, DN^2; None without
    unsteady: Float[Array, " levels"] | None = None
    converter: Converter = eqx.field(static=True, default=Converter())  # grid of the values
    # position in the series, from -1/2 at the dimmest level, or the first in time where times are
    # known, to 1/2 at the brightest or last; 0 in the dark; None where no light drifts
    series: Float[Array, " levels"] | None = None
    # levels whose histograms of codes replace their moments; None for none
    counted: CountedLevels | None = None
    # whether each scatter has Jeffreys' prior (`scatter_prior`)
    jeffreys: bool = eqx.field(static=True, default=False)


class Expected(eqx.Module):
    """The expectation and sampling variances of each level's statistics under the model."""

    mean: Float[Array, " levels"]  # DN
    variance: Float[Array, " levels"]  # temporal variance, DN^2
    neighbours: Float[Array, " levels"] | None  # T, DN^2; None where T is not known
    # variance of the pixels' means, DN^2; None without `OffsetData`
    spatial: Float[Array, " levels"] | None
    of_mean: Float[Array, " levels"]  # sampling variance of the mean
    of_variance: Float[Array, " levels"]  # sampling variance of the temporal variance
    of_both: Float[Array, " levels"]  # their covariance
    # sampling variance of T; None where T is not known
    of_neighbours: Float[Array, " levels"] | None
    # sampling variance of the spatial variance, and its covariances with mean and temporal
    # variance; None without `OffsetData`
    of_spatial: Float[Array, "3 levels"] | None
    # levels that tables of codes replace, and ln p of these; None for none
    tables: tuple[Int[Array, " m"], Float[Array, ""]] | None
    log_prior: Float[Array, ""] | None  # of the scatters; None without a prior


def compressed(values: dict[str, Array], x: Array, top: Array) -> Array:
    """Return h(x), the signal after the compression behind the gain, DN."""
    if "compression" not in values:
        return x
    loss = values["compression"] * x / top
    if "compression_2" in values:
        loss = loss + values["compression_2"] * (x / top) ** 2
    return x * (1 - loss)


def drifted(values: dict[str, Array], data: NoiseData) -> NoiseData:
    """Return the data, with each level's light multiplied by the drift of the lamp."""
    if "light_drift" not in values or data.series is None:
        return data
    return replace(data, light=data.light * (1 + values["light_drift"] * data.series))


def level_moments(values: dict[str, Array], data: NoiseData, light: Array) -> Moments:
    """Return the moments of each level, without clipping at the ends of the scale."""
    gain, read = values["system_gain"], values["read_noise"]
    electrons = expected_electrons(values, data, light, data.lit, data.exposure)
    x = gain * electrons
    h, slope = jax.jvp(lambda s: compressed(values, s, data.top_signal), (x,), (jnp.ones_like(x),))
    step = slope * gain
    return Moments(
        mean=values["black_level"] + h,
        variance=step**2 * own_variance(values, data.neighbours, electrons, data.top_signal)
        + (gain * read) ** 2
        + data.converter.rounding,
        third=step**3 * electrons,
        fourth=step**4 * electrons,
    )


def electrons_and_steps(values: dict[str, Array], data: NoiseData) -> tuple[Array, Array]:
    """Return mu, the expected electrons of each level, and the DN per additional electron there."""
    mu = expected_electrons(values, data, data.light, data.lit, data.exposure)
    x = values["system_gain"] * mu
    _, slope = jax.jvp(lambda s: compressed(values, s, data.top_signal), (x,), (jnp.ones_like(x),))
    return mu, values["system_gain"] * slope


def expected_electrons(
    values: dict[str, Array], data: NoiseData, light: Array, lit: Array, exposure: Array
) -> Array:
    """Return mu, the expected electrons of a pixel, at each level."""
    responsivity = values[RESPONSIVITY.name if data.photons_known else SIGNAL_RATE.name]
    if "light_offset" in values:
        light = light + lit * values["light_offset"]
    electrons = responsivity / values["system_gain"] * light
    if "dark_current" in values:
        electrons = electrons + values["dark_current"] * exposure
    return electrons


def predicted_moments(values: dict[str, Array], data: NoiseData, light: Array) -> Moments:
    """Return the moments at all levels. Call it in a compiled program: outside one, JAX caches
    every `vmap` of a new function, which takes 3 kB each."""
    moments = level_moments(values, data, light)
    window = data.window
    if window is None:
        return moments
    index = window.levels
    at = light[index], data.lit[index], data.exposure[index]
    electrons = expected_electrons(values, data, *at)
    step, lowest = data.converter.step, data.converter.lowest
    gain, black = values["system_gain"] / step, (values["black_level"] - lowest) / step
    spread = values["offset_spread"] / step if "offset_spread" in values else None
    exact = jax.vmap(
        lambda mu, own: quantised_moments(mu, gain, values["read_noise"], black, own, spread=spread)
    )(electrons, window)
    low = Moments(*(step**power * one for power, one in enumerate(exact[:4], start=1)))
    low = low._replace(mean=low.mean + lowest)
    if exact.spatial is not None and exact.uneven is not None and exact.die is not None:
        scale = step ** jnp.asarray([1.0, 2.0, 2.0], exact.die.dtype)
        of_pixels = step**2 * exact.spatial, step**4 * exact.uneven
        low = Moments(*low[:4], *of_pixels, exact.die * jnp.outer(scale, scale)[None])
        none = jnp.zeros_like(moments.mean)
        die = jnp.zeros((none.size, 3, 3), none.dtype)
        moments = Moments(*moments[:4], none, none, die)
    return jax.tree.map(lambda all_levels, own: all_levels.at[index].set(own), moments, low)


def predict(values: dict[str, Array], inputs: NoiseData) -> Expected:
    """Return the sampling distribution of the statistics of all levels."""
    data, n, frames = drifted(values, inputs), inputs.pixels, inputs.frames
    light_variance = None
    if "light_scatter" in values:
        light_variance = (values["light_scatter"] * data.light) ** 2
    if data.light_step is not None:
        rounded = data.lit * data.light_step**2 / 12
        light_variance = rounded if light_variance is None else light_variance + rounded

    if light_variance is None:
        model = predicted_moments(values, data, data.light)
        light_mean = light_both = light_spread = 0.0
    else:
        model, rate = jax.jvp(
            lambda light: predicted_moments(values, data, light),
            (data.light,),
            (jnp.ones_like(data.light),),
        )
        light_mean = rate.mean**2 * light_variance
        light_both = rate.mean * rate.variance * light_variance
        light_spread = rate.variance**2 * light_variance

    mean_variance = model.variance / (n * frames) + light_mean
    if data.shared is not None:
        mean_variance = mean_variance + data.shared.of_mean / frames
    if data.unsteady is not None:
        mean_variance = mean_variance + data.unsteady / frames
    if "black_scatter" in values:
        mean_variance = mean_variance + values["black_scatter"] ** 2
    covariance = model.third / (n * frames) + light_both
    spread = (2 * model.variance**2 / (frames - 1) + model.fourth / frames) / n + light_spread
    if data.shared is not None:
        spread = spread + data.shared.of_variance / (frames - 1)
    of_spatial = None
    if data.offsets is not None and model.die is not None and model.uneven is not None:
        # An error that all darks of the die share counts as independent in each, with a variance
        # larger by the number of darks.
        shown = jnp.where(data.lit > 0, 1.0, data.offsets.darks) / data.offsets.pixels
        die = shown[:, None, None] * model.die
        mean_variance = mean_variance + die[:, 0, 0]
        covariance = covariance + die[:, 0, 1]
        spread = spread + die[:, 1, 1] + 2 * model.uneven / (frames - 1) / n
        passing = 2 / (frames * (frames - 1) * n)  # temporal noise left in the spatial variance
        own = data.offsets.noise + die[:, 2, 2] + passing * model.uneven
        of_spatial = jnp.stack([own, die[:, 0, 2], die[:, 1, 2] - passing * model.variance**2])
        of_spatial = jnp.where(data.lit > 0, jnp.asarray([[1.0], [0.0], [0.0]]), of_spatial)
    if "variance_scatter" in values:
        spread = spread + (values["variance_scatter"] * model.variance) ** 2
    around, neighbours, of_neighbours = data.neighbours, None, None
    if around is not None and around.spread is not None:
        mu, step = electrons_and_steps(values, data)
        neighbours = step**2 * (mu - own_variance(values, around, mu, data.top_signal))
        of_neighbours = around.spread * (model.variance + neighbours) ** 2
    counted = data.counted
    return Expected(
        *(model.mean, model.variance, neighbours),
        None if of_spatial is None else model.spatial,
        *(mean_variance, spread, covariance, of_neighbours, of_spatial),
        tables=counted and (counted.levels, _log_density_of_tables(values, data, counted)),
        log_prior=scatter_prior(values, data) if data.jeffreys else None,
    )


class LevelStatistics(eqx.Module):
    """The likelihood of the measured mean, temporal variance, T and spatial variance of each
    level."""

    # factor on the log likelihood, as if errors were larger by 1 / sqrt(weight)
    weight: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=1.0)
    least_squares = False
    surrogate = None

    def log_density(self, prediction: Expected, data: Float[Array, "levels 4"]) -> Array:
        """Return the log likelihood of every datum, up to a constant."""
        terms, _ = self._terms_and_residuals(prediction, data)
        if prediction.tables is not None:
            levels, log_density = prediction.tables
            terms = terms.at[levels].set(0).at[0, 0].add(log_density)
        terms = self.weight * terms
        if prediction.log_prior is not None:
            terms = terms.at[0, 0].add(prediction.log_prior)
        return terms

    def residuals(self, prediction: Expected, data: Array, chance: Any) -> Array:
        """Return residuals that are standard normal under the model; 0 for unknown data."""
        del chance
        return self._terms_and_residuals(prediction, jnp.asarray(data))[1]

    def draw(self, key: Array, prediction: Expected) -> Array:
        """Return simulated data with Gaussian errors; NaN where nothing is predicted."""
        of, nothing = prediction, jnp.full_like(prediction.mean, jnp.nan)
        columns = ((of.mean, of.of_mean), (of.variance, of.of_variance))
        columns += ((of.neighbours, of.of_neighbours),)
        columns += ((of.spatial, None if of.of_spatial is None else of.of_spatial[0]),)
        middle, spread = (
            jnp.stack([nothing if x is None else x for x in each], axis=1)
            for each in zip(*columns, strict=True)
        )
        return middle + jnp.sqrt(spread) * jax.random.normal(key, middle.shape, middle.dtype)

    def _terms_and_residuals(self, at: Expected, data: Array) -> tuple[Array, Array]:
        mean, variance, neighbours, spatial = data.T
        deviation = mean - at.mean
        slope = at.of_both / at.of_mean
        expected = at.variance + slope * deviation
        rest = at.of_variance - slope * at.of_both  # of the variance, given the mean
        shape = expected**2 / rest  # half the degrees of freedom
        varies = variance > 0
        excess = jnp.where(varies, variance, expected) / expected - 1
        deviance = excess - jnp.log1p(excess)
        # Stirling's series normalises the Gamma density; its next term is below 2e-7 for 50 pixels.
        log_gamma = -shape * deviance + jnp.log(shape) / 2 - 1 / (12 * shape)
        log_normal = -(deviation**2 / at.of_mean + jnp.log(at.of_mean)) / 2
        missed = [deviation / jnp.sqrt(at.of_mean)]
        missed += [jnp.sign(excess) * jnp.sqrt(2 * shape * jnp.maximum(deviance, 0))]
        terms = [log_normal, jnp.where(varies, log_gamma, -jnp.inf)]
        nothing = jnp.zeros_like(mean)
        for value, there, expectation, of in (
            (neighbours, at.of_neighbours, at.neighbours, at.of_neighbours),
            (spatial, at.of_spatial, *self._spatial(at, deviation, variance - expected, rest)),
        ):
            if there is None or of is None:
                missed, terms = [*missed, nothing], [*terms, nothing]
                continue
            missed.append((value - expectation) / jnp.sqrt(of))
            terms.append(-(missed[-1] ** 2 + jnp.log(of)) / 2)
        return jnp.stack(terms, axis=1), jnp.stack(missed, axis=1)

    @staticmethod
    def _spatial(
        at: Expected, deviation: Array, rest: Array, of_rest: Array
    ) -> tuple[Array | None, Array | None]:
        """Return expectation and variance of the spatial variance, given mean and variance."""
        if at.of_spatial is None or at.spatial is None:
            return None, None
        own, with_mean, with_variance = at.of_spatial
        with_mean = with_mean / at.of_mean
        with_rest = (with_variance - with_mean * at.of_both) / of_rest
        expected = at.spatial + with_mean * deviation + with_rest * rest
        return expected, own - with_mean**2 * at.of_mean - with_rest**2 * of_rest


def scatter_prior(values: dict[str, Array], data: NoiseData) -> Array:
    """Return the log of Jeffreys' prior, separate for each random scatter of levels, as a density
    in the scatter's logarithm.

    As a scatter approaches 0 the likelihood becomes constant, so a prior that is flat in the
    scatter's logarithm would make the posterior improper. A prior that is flat in the scatter
    itself would make intervals from few levels too wide. A scatter tau adds tau^2 a to the variance
    v of each level, with a known factor a. Therefore the Fisher information on ln tau is
    proportional to the sum of (tau^2 a / (v + tau^2 a))^2 over the levels, and the prior is the
    square root of this information. The prior is flat in ln tau if the scatter dominates, and falls
    as tau^2 if the noise dominates.

    Source:
        Box & Tiao, "Bayesian Inference in Statistical Analysis", 1973, section 5.2.
    """
    n, frames = data.pixels, data.frames
    light, one = data.light, jnp.ones_like(data.light)
    model, rate = jax.jvp(lambda x: predicted_moments(values, data, x), (light,), (one,))
    of_mean = model.variance / (n * frames)
    of_variance = (2 * model.variance**2 / (frames - 1) + model.fourth / frames) / n
    added = {
        "light_scatter": ((rate.mean * light) ** 2, of_mean),
        "black_scatter": (one, of_mean),
        "variance_scatter": (model.variance**2, of_variance),
    }
    total = jnp.zeros((), of_mean.dtype)
    for name in SCATTERS:
        if name in values:
            (a, v), square = added[name], values[name] ** 2
            total = total + jnp.log(square) + jnp.log(jnp.sum((a / (v + square * a)) ** 2)) / 2
    return total


def _log_density_of_tables(
    values: dict[str, Array], data: NoiseData, counted: CountedLevels
) -> Array:
    """Return the log density of the parameters under the Gaussian result from the histograms."""
    at = counted.levels
    light = data.light[at]
    electrons = expected_electrons(values, data, light, data.lit[at], data.exposure[at])
    found = jnp.stack([values["system_gain"], values["read_noise"]])
    missed = counted.logs - jnp.log(jnp.concatenate([found, electrons]))
    of_light = jnp.zeros_like(light)
    if "light_scatter" in values:
        of_light = of_light + values["light_scatter"] ** 2
    if data.light_step is not None:
        of_light = of_light + data.light_step**2 / 12 / light**2
    of_light = of_light + UNKNOWN_LIGHT * counted.kept_out
    covariance = counted.covariance + jnp.diag(jnp.pad(of_light, (2, 0)))
    root = jnp.linalg.cholesky(covariance)
    deviates = jax.scipy.linalg.solve_triangular(root, missed, lower=True)
    return -jnp.sum(deviates**2) / 2 - jnp.sum(jnp.log(jnp.diagonal(root)))
