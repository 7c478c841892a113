"""Measure the resolution from the picture of a straight edge: edge spread, MTF and point spread
function.

The edge may lie at any angle in a picture of linear numbers. Every pixel is used at its own
distance from the edge. Pixel values are not binned, interpolated or differentiated, and a colour
plane of a mosaic needs no demosaicing. Lengths are in pixels, and frequencies across the edge in
cycles per pixel.

First, a model of the edge is fitted to the whole picture. Its blur is the convolution of the
pixel's square aperture, a Gaussian or a uniform disc (defocus), and a known diffraction. Then the
MTF is measured without the model, by fitting the odd harmonics of a square wave with this edge to
the residuals. The amplitudes of the harmonics are linear in the pixel values. They are therefore
unbiased at low signal, unlike the modulus of a noisy Fourier transform.

Source:
    ISO 12233:2017, annex D (slanted edge); Goodman, Introduction to Fourier Optics, section 6.4.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize, stats

import jaxvision as jv
from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError

from ..fits.bands import Bands
from ..fits.result import Fit
from ..fits.solve import fit
from ..inference.estimates import Estimate
from ..inference.precision import double_precision
from .model import Blur, blur_transfer, edge_spread, edge_transfer, problem_of_edge
from .pixels import (
    BLOCK,
    LEAST_PIXELS,
    SIGNIFICANT,
    EdgePixels,
    distance_from_edge,
    first_line,
    select_band,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REACH = 16.0  # pixels on both sides of the edge from which the free MTF is measured
_LEAST_DIFFRACTION = 0.02  # pixels
_FINEST = 1.0  # cycles per pixel, the highest frequency of the free MTF
_NOT_TAKEN = "more starts", "other start", "Censored("  # advice of `fit` for its own arguments
_ONE_VALUE = 0.2  # share of pixels with one value on a side without noise
_CONDITION = 1e4  # largest condition number of the normal matrix
_CHANCE = 1e-3
_REPORTED_DIFFERENCE = 0.005  # smallest difference of the transfer that is reported
_OVERSHOOT, _SURE_OF_OVERSHOOT = 0.005, 6.0  # of the edge, and standard errors
_OVERSHOOT_REACH = 6.0  # pixels from the edge
_LARGEST_GAMMA = 3.0
_ROUNDED = 0.6  # rounding steps, standard deviation below which noise does not average rounding


@dataclass(frozen=True)
class Resolution:
    """The resolution measured on the picture of an edge.

    Attributes:
        fit: fit of the model to the picture: its estimates, chi-square and findings.
        frequency: (n,) frequencies across the edge, cycles per pixel.
        otf: (n,) real part of the transfer function at these frequencies, with the edge as origin,
            measured without the model. It is below 0 where contrast is reversed. Its modulus is the
            MTF.
        otf_covariance: (n, n) covariance of `otf`.
        distance: (m,) distances from the edge, pixels, positive on the bright side.
        spread: (m,) edge spread, 0 on the dark side and 1 on the bright one: means of the pixels in
            bins of a quarter of a pixel.
        spread_sd: (m,) standard errors of `spread`.
        blur: shape of the blur, and diffraction.
        findings: findings in sentences.

    Example:
        See `from_edge`.
    """

    fit: Fit
    frequency: Float[np.ndarray, " n"]
    otf: Float[np.ndarray, " n"]
    otf_covariance: Float[np.ndarray, "n n"]
    distance: Float[np.ndarray, " m"]
    spread: Float[np.ndarray, " m"]
    spread_sd: Float[np.ndarray, " m"]
    blur: Blur
    findings: tuple[str, ...]

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Return the direction of the normal toward the bright side, the edge's place, the levels
        of both sides, and the width of the blur.
        """
        return self.fit.estimates

    @property
    @double_precision
    def mtf50(self) -> Bands:
        """Return where the model's MTF is 1/2, in cycles per pixel, with intervals."""
        frequency = jnp.linspace(0, 2, 801)
        return self.fit.derived(
            lambda **at: _falls_to_half(frequency, edge_transfer(frequency, at, self.blur))
        )

    @property
    @double_precision
    def fwhm(self) -> Bands:
        """Return the full width at half maximum of the model's line spread, in pixels, with
        intervals.
        """
        most = 2 + 3 * float(self.fit.values["blur"]) + 2 * (self.blur.diffraction or 0)
        place = jnp.linspace(0, most, 801)

        def width(**at: Any) -> Array:
            across = partial(edge_spread, at=at, blur=self.blur, span=2 * most)
            _, line = jax.jvp(across, (place,), (jnp.ones_like(place),))
            return 2 * _falls_to_half(place, line / line[0])

        return self.fit.derived(width)

    @double_precision
    def mtf(self, frequency: Any) -> Bands:
        """Return the model's MTF at some frequencies, with intervals.

        Args:
            frequency: (...) cycles per pixel across the edge.

        Returns:
            Bands of the shape (...), no unit.
        """
        at_frequency = jnp.asarray(frequency, float)
        return self.fit.derived(lambda **at: jnp.abs(edge_transfer(at_frequency, at, self.blur)))

    @double_precision
    def psf(self, size: int) -> Float[np.ndarray, "size size"]:
        """Return the model's point spread function, including the pixel aperture: the fraction of
        light in each pixel.

        Args:
            size: side in pixels, odd.

        Returns:
            (size, size), of sum 1.

        Raises:
            InputError: for an even size.
        """
        if size < 1 or size % 2 == 0:
            raise InputError(f"psf: size is {size!r}; give an odd number of pixels.")
        step = 1 / (4 * size)
        frequency = (np.arange(-4, 4, step) + step / 2).astype(float)  # eight aliases of a pixel
        x, y = np.meshgrid(frequency, frequency)
        values = self.fit.values
        blur = blur_transfer(jnp.asarray(np.hypot(x, y)), values, self.blur)
        transfer = np.asarray(blur) * np.sinc(x) * np.sinc(y)
        wave = np.cos(2 * np.pi * np.outer(np.arange(size) - size // 2, frequency))
        spread = wave @ transfer @ wave.T
        return spread / spread.sum()

    @double_precision
    def figure(self) -> "Figure":
        """Draw the edge spread and the MTF, as measured and by the model."""
        import matplotlib.pyplot as plt

        figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
        values = self.fit.values
        fine = np.linspace(self.distance[0], self.distance[-1], 500)
        model = edge_spread(jnp.asarray(fine), values, self.blur, float(np.ptp(fine)))
        left.errorbar(
            self.distance, self.spread, 1.96 * self.spread_sd, fmt=".", ms=3, label="pixels"
        )
        left.plot(fine, np.asarray(model), label="model")
        left.set(xlabel="distance from the edge / pixels", ylabel="edge spread")
        left.legend()
        sd = np.sqrt(np.diag(self.otf_covariance))
        right.errorbar(
            self.frequency, self.otf, 1.96 * sd, fmt=".", ms=3, label="without the model"
        )
        along = np.linspace(0, max(1.0, self.frequency[-1]), 200)
        right.plot(
            along, np.asarray(edge_transfer(jnp.asarray(along), values, self.blur)), label="model"
        )
        right.axvline(0.5, color="0.6", lw=0.8, ls=":")
        right.set(xlabel="frequency / cycles per pixel", ylabel="transfer (MTF)")
        right.legend()
        return figure

    def __str__(self) -> str:
        rows = [
            f"{e.name}: {e.value:.4g} ± {e.standard_error:.2g} {e.unit}" for e in self.estimates
        ]
        for name, unit, band in (
            ("MTF50", "cycles per pixel", self.mtf50),
            ("FWHM of the line spread", "pixels", self.fwhm),
        ):
            low, high = np.asarray(band.interval_95, float)
            rows.append(f"{name}: {float(band.mean):.4g} {unit}, 95 % {low:.4g} to {high:.4g}")
        return "\n".join((*rows, *self.findings))


@double_precision
def from_edge(
    image: Any,
    *,
    sensor: jv.Sensor | None = None,
    band: int | None = None,
    shape: Literal["gaussian", "disc"] = "gaussian",
    diffraction: float | None = None,
    reach: float = REACH,
) -> Resolution:
    """Measure the resolution from the picture of one straight edge, at any angle.

    The noise is measured on both sides of the edge. Uneven light and a slight curvature of the edge
    are fitted if the picture shows them. If the edge spread is asymmetric beyond its noise, as
    after a gamma curve, a finding states this gamma. Otherwise a finding gives the change of the
    blur that an undetected gamma would cause, unless the numbers are raw numbers of a `sensor`. An
    edge along the rows or the columns (or at 45 degrees) samples few distances; rotate the chart by
    about 5 degrees.

    Args:
        image: (h, w) linear numbers of a region with one edge, or (h, w, bands) of a developed
            picture; NaN where a pixel does not count.
        sensor: its mosaic gives the sites of a band in raw numbers (h, w) or (h, w, 1), and its
            `taps` bring unequal amplifiers to one black level and gain, where the region must
            begin at the corner of a tile, and lie in one part if each part of the frame has an
            amplifier; its bits and black level give the range. None for a monochrome camera.
        band: number of the band, for a mosaic or a developed picture.
        shape: shape of the fitted blur: a "gaussian" (`blur` is its standard deviation), or the
            "disc" of an image out of focus (`blur` is its diameter).
        diffraction: known diffraction: wavelength times working f-number over the pixel pitch. None
            leaves diffraction out, and the fitted blur includes it.
        reach: distance in pixels on both sides of the edge within which the MTF is measured. The
            edge spread must have ended there.

    Returns:
        The fit, the MTF with its covariance, and findings.

    Raises:
        InputError: for a picture without an edge, one that is clipped, or too small a region.

    Example:
        >>> from scipy.stats import norm
        >>> from fitting import resolution
        >>> y, x = np.mgrid[:40, :40]
        >>> distance = np.cos(0.1) * (x - 19.3) + np.sin(0.1) * (y - 19.5)
        >>> edge = 100 + 900 * norm.cdf(distance / 0.75)  # pixels
        >>> noisy = edge + np.random.default_rng(0).normal(0, 5.0, edge.shape)
        >>> found = resolution.from_edge(noisy)
        >>> round(float(found.fwhm.mean), 1)  # pixels; 2.355 * 0.75 = 1.77
        1.8
    """
    picture = select_band(plain_array("from_edge: image", image), sensor, band)
    if diffraction is not None and not _LEAST_DIFFRACTION <= diffraction < np.inf:
        raise InputError(
            f"from_edge: diffraction is {diffraction!r}; give wavelength times f-number over the "
            f"pixel pitch, or leave it out where it is below {_LEAST_DIFFRACTION}."
        )
    if not reach >= LEAST_PIXELS:
        raise InputError(f"from_edge: reach is {reach!r} pixels; give at least {LEAST_PIXELS}.")
    if shape not in ("gaussian", "disc"):
        raise InputError(f'from_edge: shape is {shape!r}; give "gaussian" or "disc".')
    pixels = EdgePixels(picture, *first_line(picture))
    blur = Blur(shape, diffraction)
    problem, start = problem_of_edge(pixels, sensor, blur)
    found = fit(problem, start=start, misfit="inflate")
    result = _measure(found, pixels, blur, reach)
    raw = sensor is not None and np.shape(image)[2:] in ((), (1,))
    bent = _nonlinear(result, pixels, float(problem.inputs["black"]), raw)
    return replace(result, findings=(*result.findings, *bent))


def _falls_to_half(x: Float[Array, " n"], y: Float[Array, " n"]) -> Array:
    """Return the x at which y first falls to 1/2, interpolated between two samples."""
    after = jnp.argmax(y < 0.5)
    before = jnp.maximum(after - 1, 0)
    return x[before] + (y[before] - 0.5) / (y[before] - y[after]) * (x[after] - x[before])


def _measure(found: Fit, pixels: EdgePixels, blur: Blur, reach: float) -> Resolution:
    """Measure the edge spread and the transfer without the model."""
    best = {name: float(np.asarray(number)) for name, number in found.values.items()}
    distance = distance_from_edge(
        pixels.inputs, np.radians(best["angle"]), best["place"], best["curvature"]
    )
    share = np.asarray(edge_spread(jnp.asarray(distance), best, blur, pixels.span))
    contrast = best["high"] - best["low"]
    missed = np.asarray(found.residuals).ravel() * pixels.sd / contrast
    reach = min(reach, -distance.min(), distance.max())
    within = np.abs(distance) <= reach
    transfer, covariance = _free_transfer(
        distance[within], missed[within], pixels.sd[within] / contrast, reach,
        None if pixels.blocks is None else pixels.blocks[within],
    )  # fmt: skip
    frequency = transfer[0]
    otf = np.asarray(edge_transfer(jnp.asarray(frequency), best, blur)) + transfer[1]
    scale = float(np.std(found.draws["high"] - found.draws["low"])) / contrast
    bins = np.floor(4 * distance[within] + 0.5).astype(int)
    first = bins.min()
    count = np.bincount(bins - first)
    weight = np.maximum(count, 1)
    spread = np.bincount(bins - first, share[within] + missed[within]) / weight
    variance = np.bincount(bins - first, (pixels.sd[within] / contrast) ** 2) / weight**2
    seen = count > 0
    place = (np.arange(count.size) + first)[seen] / 4
    result = Resolution(
        found, frequency, otf, covariance + scale**2 * np.outer(otf, otf),
        place, spread[seen], np.sqrt(variance[seen]), blur, (),
    )  # fmt: skip
    return replace(result, findings=tuple(_findings(result, transfer[1], covariance, pixels)))


def _nonlinear(result: Resolution, pixels: EdgePixels, black: float, raw: bool) -> Iterator[str]:
    """Yield a finding if noise or shape of the edge show that the numbers have a gamma, or on how
    much a gamma that they do not exclude would change the blur.

    A symmetric blur has a symmetric edge spread, which a gamma makes asymmetric. The fit is not
    weighted, so that an error in the shape of a symmetric blur, which is odd about the edge, does
    not affect the exponent.
    """
    dark, bright = pixels.block_variances
    if min(pixels.side_sd) < _ROUNDED * pixels.step:
        if not raw:
            yield (
                "The numbers are taken as linear in the light. The picture has less noise than "
                "rounding, so its edge cannot reveal a gamma."
            )
        return
    if min(dark.size, bright.size) > 2:
        test: Any = stats.ttest_ind(
            np.log(dark), np.log(bright), equal_var=False, alternative="greater"
        )
        if test.pvalue < _CHANCE / 10:
            ratio = np.sqrt(bright.mean() / dark.mean())
            yield (
                f"The bright side has {ratio:.2g} of the noise of the dark side, but shot noise "
                "grows with the light: the numbers were smoothed, or they are not linear in the "
                "light, and width and MTF are wrong. Decode sRGB or another gamma first."
            )
    best = {name: float(np.asarray(number)) for name, number in result.fit.values.items()}
    low, high = best["low"] - black, best["high"] - black
    turn = np.radians(best["angle"])
    distance = distance_from_edge(pixels.inputs, turn, best["place"], best["curvature"])
    reach = max(LEAST_PIXELS, 3 * best["blur"])
    near = np.abs(distance) <= reach
    distance, x, y = distance[near], *(pixels.inputs[name][near] for name in ("x", "y"))
    along = np.cos(turn) * y - np.sin(turn) * x
    along /= np.abs(along).max()
    value = (pixels.value[near] - best["low"]) / (high - low)
    even = np.stack([np.ones(x.size), x / np.abs(x).max(), y / np.abs(y).max()], 1)
    grid = np.linspace(-reach - 3, reach + 3, 1001)
    span = 8 * float(np.ceil((reach + 3) / 8))
    spread = jax.jit(
        lambda width: edge_spread(jnp.asarray(grid), best | {"blur": width}, result.blur, span)
    )

    def missed(unknown: np.ndarray) -> np.ndarray:
        """Return residuals after both levels and uneven light, which are linear, are fitted."""
        place, tilt, bend, width, exponent = unknown
        start = (max(low, 0.0) / high) ** (1 / exponent)
        light = start + (1 - start) * np.clip(spread(width), 0, 1)
        moved = distance - place - tilt * along - bend * along**2
        lit = np.interp(moved, grid, light**exponent)
        columns = np.concatenate([even, lit[:, None] * even], 1)
        return value - columns @ np.linalg.lstsq(columns, value)[0]

    first = [0, 0, 0, max(best["blur"], 0.1), 1]
    bounds = [-1, -1, -1, 0, 1 / _LARGEST_GAMMA], [1, 1, 1, np.inf, _LARGEST_GAMMA]
    found = optimize.least_squares(missed, first, bounds=bounds, x_scale=0.1)
    inverse = np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)
    scores = found.jac * found.fun[:, None] * np.sqrt(x.size / (x.size - 11))
    if pixels.blocks is not None:
        sums = np.zeros((pixels.blocks.max() + 1, scores.shape[1]))
        np.add.at(sums, pixels.blocks[near], scores)
        scores = sums
    covariance = inverse @ (scores.T @ scores) @ inverse
    exponent, sd = found.x[-1], float(np.sqrt(covariance[-1, -1]))
    blur = next(e for e in result.estimates if e.name == "blur")
    if abs(exponent - 1) > stats.norm.isf(_CHANCE / 2) * sd:
        yield (
            f"The edge spread is not symmetric: it is bent as if the numbers were the light to the "
            f"power of {exponent:.3f} ± {sd:.2g}, a gamma of {1 / exponent:.3g}. If they are, "
            f"width and MTF are wrong (the blur is {found.x[3]:.4g} ± "
            f"{np.sqrt(covariance[3, 3]):.2g} pixels): decode sRGB or another gamma first. "
            "Another cause is coma; `otf` is the real part of the transfer."
        )
        return
    least = max(exponent - 1.96 * sd, 1 / _LARGEST_GAMMA)
    moved = covariance[3, 4] / covariance[4, 4] * (least - 1)
    if not raw and least < 1 and abs(moved) > blur.standard_error:
        yield (
            "The numbers are taken as linear in the light. By its shape alone this edge may have "
            f"a gamma of up to {1 / least:.2f}, with which the blur would be "
            f"{blur.value + moved:.4g} pixels. For raw numbers, give `sensor`: they are linear."
        )


def _free_transfer(
    distance: Float[np.ndarray, " pixels"],
    missed: Float[np.ndarray, " pixels"],
    sd: Float[np.ndarray, " pixels"],
    reach: float,
    blocks: np.ndarray | None,
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Fit the harmonics to the residuals. Return the frequencies with the correction of the
    transfer, and its covariance.
    """
    order = np.arange(1, 4 * reach * _FINEST, 2)
    while True:
        frequency = order / (4 * reach)
        phase = 2 * np.pi * np.outer(distance, frequency)
        height = 2 / (np.pi * order)
        design = np.concatenate(
            [height * np.sin(phase), height * np.cos(phase), np.ones((distance.size, 1))], 1
        )
        weighted = design / sd[:, None]
        normal = weighted.T @ weighted
        size = np.sqrt(np.diag(normal))
        if np.linalg.cond(normal / np.outer(size, size)) < _CONDITION or frequency[-1] <= 0.5:
            break
        order = order[: max(1, int(len(order) * 0.9))]  # too few distances for this one
    inverse = np.linalg.pinv(normal, hermitian=True)
    found = inverse @ (weighted.T @ (missed / sd))
    covariance = inverse
    if blocks is not None:
        left = (missed - design @ found) / sd
        sums = np.zeros((blocks.max() + 1, design.shape[1]))
        np.add.at(sums, blocks, weighted * left[:, None])
        covariance = inverse @ (sums.T @ sums) @ inverse
    n = len(order)
    return (frequency, found[:n]), covariance[:n, :n]


def _findings(
    result: Resolution,
    added: np.ndarray,
    covariance: np.ndarray,
    pixels: EdgePixels,
) -> Iterator[str]:  # fmt: skip
    for sentence in (*result.fit.failures, *result.fit.findings):
        if not any(advice in sentence for advice in _NOT_TAKEN):
            yield sentence
    if result.fit.failures:
        yield (
            "The fit may have missed the best edge. Causes are wrong pixels (mark them as NaN), a "
            "second edge in the region, sharpening, or light whose unevenness is no plane."
        )
    for value, name in ((pixels.value.max(), "highest"), (pixels.value.min(), "lowest")):
        share = np.mean(pixels.value == value)
        if share > _ONE_VALUE:
            yield (
                f"{share:.0%} of the pixels have the {name} value, {value:g}. If the range ends "
                "there, that side is clipped, and the MTF is too high."
            )
    if pixels.blocks is not None:
        yield (
            "The errors of neighbouring pixels are correlated, as in a developed or compressed "
            f"picture. Intervals are those of blocks of {BLOCK} x {BLOCK} pixels; raw numbers "
            "give narrower ones."
        )
    if result.frequency[-1] < _FINEST - 1 / 32:
        yield (
            f"The pixels sample few distances from an edge at {result.fit.values['angle']:.2f} "
            f"degrees, so that the MTF is measured up to {result.frequency[-1]:.2f} cycles per "
            "pixel only. Rotate the chart by about 5 degrees."
        )
    sd = np.sqrt(np.diag(covariance))
    if np.abs(added).max() > _REPORTED_DIFFERENCE and _p_value(added, covariance) < _CHANCE:
        worst = int(np.argmax(np.abs(added) / sd))
        yield (
            f"The measured MTF differs from the model's by up to {abs(added[worst]):.3f}, at "
            f"{result.frequency[worst]:.2f} cycles per pixel ({abs(added[worst]) / sd[worst]:.0f} "
            "standard errors). Use `otf`, which is measured without the model."
        )
    over = (result.otf - 1) / np.sqrt(np.diag(result.otf_covariance))
    if over.max() > SIGNIFICANT:
        yield (
            f"The MTF is {result.otf[np.argmax(over)]:.2f}, above 1, at "
            f"{result.frequency[np.argmax(over)]:.2f} cycles per pixel: the picture was sharpened."
        )
    beyond = np.maximum(result.spread - 1, -result.spread)
    place = int(np.argmax(beyond / result.spread_sd))
    near = abs(result.distance[place]) < _OVERSHOOT_REACH
    if near and beyond[place] > max(_OVERSHOOT, _SURE_OF_OVERSHOOT * result.spread_sd[place]):
        yield (
            f"The edge spread overshoots a level by {beyond[place]:.1%} of the edge, "
            f"{abs(result.distance[place]):.2g} pixels from it, which no blur of light does: the "
            "picture was sharpened, and width and MTF are those of the sharpened picture."
        )
    ends = np.array([result.spread[0], 1 - result.spread[-1]])
    error = np.array([result.spread_sd[0], result.spread_sd[-1]])
    if np.any((np.abs(ends) > SIGNIFICANT * error) & (np.abs(ends) > 0.01)):
        yield (
            f"The edge spread has not ended {max(-result.distance[0], result.distance[-1]):.0f} "
            "pixels from the edge; give a larger region and `reach`."
        )


def _p_value(values: np.ndarray, covariance: np.ndarray) -> float:
    """Return the probability that chance gives values at least this far from 0."""
    chi2 = values @ np.linalg.pinv(covariance, hermitian=True) @ values
    return float(stats.chi2.sf(chi2, values.size))
