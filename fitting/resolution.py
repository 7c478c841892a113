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

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, Float
from scipy import ndimage, optimize, stats

import jaxvision as jv
from jaxvision import ArrayLike
from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError

from .fits.bands import Bands
from .fits.result import Fit
from .fits.solve import fit
from .inference.estimates import Estimate
from .inference.likelihoods import Clustered, Gaussian
from .inference.parameters import Parameter
from .inference.precision import double_precision
from .inference.problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REACH = 16.0  # pixels on both sides of the edge from which the free MTF is measured
_LEAST = 8  # least pixels on both sides
_BLOCK = 8  # side of the blocks of shared errors where neighbouring residuals correlate
_SIGNIFICANT = 4.0  # standard errors
_FINEST = 1.0  # cycles per pixel, the highest frequency of the free MTF
_NARROWEST = 1e-3  # pixels, smallest width in a denominator
_LEAST_DIFFRACTION = 0.02  # pixels
_MOSAIC = 0.05  # largest difference of mosaic sites, relative to a side's level
_NOT_TAKEN = "more starts", "other start", "Censored("  # advice of `fit` for its own arguments
_CLIPPED_SHARE = 0.01  # share of pixels at an end of the range that means clipping
_ONE_VALUE = 0.2  # share of pixels with one value on a side without noise
_CONDITION = 1e4  # largest condition number of the normal matrix
_CHANCE = 1e-3
_REPORTED_DIFFERENCE = 0.005  # smallest difference of the transfer that is reported
_OVERSHOOT, _SURE_OF_OVERSHOOT = 0.005, 6.0  # of the edge, and standard errors
_OVERSHOOT_REACH = 6.0  # pixels from the edge
_OF_EDGE = "angle", "place", "low", "high", "curvature", "shade_x", "shade_y"
_FINE = 8  # samples of an edge spread per pixel
_PUPIL, _TO_CUTOFF = 20, 32  # nodes along and across the pupil, and in frequency up to the cut-off
_LEAST_PART = 0.03  # of the differences of a wavefront, by terms that edges determine
_TINY = 1e-30
_LARGEST_GAMMA = 3.0
_ROUNDED = 0.6  # rounding steps, standard deviation below which noise does not average rounding
_NODES = 32
_ANGLES = np.pi * np.arange(1, _NODES + 1) / (_NODES + 1)
# A uniform disc of diameter 2 across a line: Gauss and Chebyshev's rule of the second kind.
_DISC = np.cos(_ANGLES), 2 / (_NODES + 1) * np.sin(_ANGLES) ** 2


class Blur(NamedTuple):
    """The blur of the edge in addition to the pixel's aperture.

    Attributes:
        shape: shape of the fitted blur, "gaussian" or "disc".
        diffraction: wavelength times f-number over the pixel pitch; None without diffraction.
    """

    shape: Literal["gaussian", "disc"]
    diffraction: float | None


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
            lambda **at: _falls_to_half(frequency, _transfer(frequency, at, self.blur))
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
            across = partial(_edge, at=at, blur=self.blur, span=2 * most)
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
        return self.fit.derived(lambda **at: jnp.abs(_transfer(at_frequency, at, self.blur)))

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
        blur = _blur_transfer(jnp.asarray(np.hypot(x, y)), values, self.blur)
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
        model = _edge(jnp.asarray(fine), values, self.blur, float(np.ptp(fine)))
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
            along, np.asarray(_transfer(jnp.asarray(along), values, self.blur)), label="model"
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
        sensor: its mosaic gives the sites of a band in raw numbers (h, w), where the region must
            begin at the corner of a tile; its bits and black level give the range. None for a
            monochrome camera.
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
    picture = _select_band(plain_array("from_edge: image", image), sensor, band)
    if diffraction is not None and not _LEAST_DIFFRACTION <= diffraction < np.inf:
        raise InputError(
            f"from_edge: diffraction is {diffraction!r}; give wavelength times f-number over the "
            f"pixel pitch, or leave it out where it is below {_LEAST_DIFFRACTION}."
        )
    if not reach >= _LEAST:
        raise InputError(f"from_edge: reach is {reach!r} pixels; give at least {_LEAST}.")
    if shape not in ("gaussian", "disc"):
        raise InputError(f'from_edge: shape is {shape!r}; give "gaussian" or "disc".')
    _refuse_clipped(picture, sensor)
    pixels = _Pixels(picture, *_first_line(picture))
    blur = Blur(shape, diffraction)
    problem, start = _problem(pixels, sensor, blur)
    found = fit(problem, start=start, misfit="inflate")
    result = _measure(found, pixels, blur, reach)
    raw = sensor is not None and np.ndim(image) == 2
    bent = _nonlinear(result, pixels, float(problem.inputs["black"]), raw)
    return replace(result, findings=(*result.findings, *bent))


@double_precision
def wavefront_from_edges(
    images: Sequence[Any],
    *,
    wavelength: ArrayLike,
    f_number: float,
    pixel_pitch: float,
    terms: Sequence[int] = (4, 5, 6, 7, 8, 9, 10, 11),
    defocus: ArrayLike | None = None,
    aperture: jv.scene.Aperture | None = None,
    sensor: jv.Sensor | None = None,
    band: int | None = None,
    seed: int = 0,
) -> Fit:
    """Estimate the aberrations of a lens from pictures of straight edges at several angles.

    An edge shows the transfer function in one direction only, so several edges are fitted together.
    Geometry and levels of each edge are free. Even aberrations (defocus, astigmatism, spherical)
    with all signs reversed give the same pictures, so that pictures at two known settings of the
    focus are needed.

    Args:
        images: pictures of one edge each, as `from_edge` takes them, or regions of one picture in
            which the aberrations are equal.
        wavelength: () or (lines,) m; several lines of equal strength for light of a wide band.
        f_number: working f-number.
        pixel_pitch: m. The pixel is assumed to collect light on its whole square.
        terms: numbers of the Zernike terms to estimate, 4 and higher (`jv.optics.zernike`). A tilt
            (2 or 3) only moves the edges.
        defocus: (images,) known coefficient of term 4 that the setting of the focus adds to each
            picture, m; None for 0.
        aperture: shape of the pupil, convex; None for a disc.
        sensor: as in `from_edge`.
        band: as in `from_edge`.
        seed: seed of the searches.

    Returns:
        The fit. Its parameters "z4", "z5", ... are coefficients in nm; x of the pupil is to the
        right in the picture and y down. The model is valid for errors up to a quarter of a wave
        (rms). "edge" has seven numbers for each picture: the changes of angle, place, levels,
        curvature and shading, in standard errors of its own fit.

    Raises:
        InputError: for pictures that `from_edge` refuses, for terms that directions and focus of
            the edges do not determine, and for wrong terms or numbers.

    Example:
        See the page "Measure the aberrations of a lens".
    """
    lines = np.atleast_1d(np.asarray(plain_array("wavelength", wavelength), float))
    added = np.zeros(len(images))
    if defocus is not None:
        added = np.asarray(plain_array("defocus", defocus), float)
    terms = tuple(terms)
    if not terms or min(terms) < 4 or len(set(terms)) < len(terms):
        raise InputError(f"wavefront_from_edges: terms are {terms}; give different ones from 4 on.")
    if added.shape != (len(images),):
        raise InputError(
            f"wavefront_from_edges: defocus has the shape {added.shape}; give one number for each "
            f"of {len(images)} images."
        )
    if not (lines > 0).all() or lines.ndim != 1 or not f_number > 0 or not pixel_pitch > 0:
        raise InputError(
            "wavefront_from_edges: give wavelengths, f_number and pixel_pitch above 0."
        )
    black = 0.0 if sensor is None or sensor.offset is None else float(np.mean(sensor.offset))
    edges, starts = [], []
    for image in images:
        picture = _select_band(plain_array("wavefront_from_edges: image", image), sensor, band)
        _refuse_clipped(picture, sensor)
        pixels = _Pixels(picture, *_first_line(picture))
        problem, start = _problem(pixels, sensor, Blur("gaussian", None))
        found = fit(problem, start=start, misfit="inflate")
        edges.append(pixels)
        starts.append({e.name: (e.value, e.standard_error) for e in found.estimates})
    own = np.array([[at[name] for name in _OF_EDGE] for at in starts])
    _refuse_undetermined(terms, own[:, 0, 0], len(set(added)) == 1)
    longest = max(len(one.value) for one in edges)

    def padded(rows: Sequence[np.ndarray], fill: float) -> np.ndarray:
        return np.stack(
            [np.pad(row, (0, longest - len(row)), constant_values=fill) for row in rows]
        )

    inputs = {"wave": lines, "f_number": f_number, "pitch": pixel_pitch, "black": black}
    inputs |= {"own": own, "defocus": added, "aperture": aperture}
    inputs |= {name: padded([one.inputs[name] for one in edges], 0.0) for name in ("x", "y")}
    likelihood: Any = Gaussian(sd=padded([one.sd for one in edges], 1.0))
    if any(one.blocks is not None for one in edges):
        labels, first = [], 0
        for one in edges:
            block = np.arange(len(one.value)) if one.blocks is None else one.blocks
            labels.append(first + block)
            first += int(block.max()) + 1
        likelihood = Clustered(likelihood, labels=padded(labels, 0))
    span = 16 * float(np.ceil(max(one.span for one in edges) / 16 + 0.125))
    cutoff = pixel_pitch / (float(lines.min()) * f_number)
    problem = Problem(
        {f"z{term}": Parameter(start=0.0, unit="nm") for term in terms}
        | {"edge": Parameter(shape=own.shape[:2], start=np.zeros(own.shape[:2]))},
        _aberrated_edges(terms, span, cutoff),
        likelihood,
        padded([one.value for one in edges], np.nan),
        inputs=jax.tree.map(np.float64, inputs),
    )
    return fit(problem, starts=2, misfit="inflate", seed=seed)  # about 0, with different signs


def _refuse_undetermined(terms: tuple[int, ...], angles: np.ndarray, one_focus: bool) -> None:
    """Refuse terms that edges with these normals, in degrees, do not determine. The transfer
    depends on differences of the wavefront error along the normal only."""
    even = [term for term in terms if (int(np.sqrt(8 * term - 7)) - 1) // 2 % 2 == 0]
    if even and one_focus:
        raise InputError(
            f"wavefront_from_edges: pictures at one setting of the focus do not determine the sign "
            f"of the terms {even}; give pictures at two known settings, with defocus."
        )
    x, y = (z[None] for z in jnp.meshgrid(*[jnp.linspace(-0.6, 0.6, 9)] * 2))
    right, down = (0.3 * f(np.radians(angles))[:, None, None] for f in (np.cos, np.sin))
    ends = [jv.optics.zernike(x + s * right, y + s * down, count=max(terms)) for s in (-1, 1)]
    change = np.asarray(ends[1] - ends[0]).reshape(-1, max(terms))[:, np.array(terms) - 1]
    _, size, ways = np.linalg.svd(change / np.sqrt(np.mean(change**2)), full_matrices=False)
    lost = [term for term, share in zip(terms, ways[-1], strict=True) if abs(share) > 0.1]
    if size[-1] < _LEAST_PART * size[0]:
        raise InputError(
            f"wavefront_from_edges: the directions of the edges do not determine the terms {lost} "
            "separately; give edges in more directions, or fewer terms."
        )


@cache
def _aberrated_edges(terms: tuple[int, ...], span: float, cutoff: float) -> Callable[..., Array]:
    """Return the prediction of all edges as a function of coefficients and geometry, the same
    function for equal settings."""
    frequency = np.arange(1, 8 * span * cutoff, 2) / (8 * span)  # cycles per pixel
    places = np.arange(-span, span + 0.5 / _FINE, 1 / _FINE)
    phase = 2 * np.pi * np.outer(places, frequency)
    nodes, degree = np.polynomial.chebyshev.chebpts1(_TO_CUTOFF), _TO_CUTOFF - 1
    smooth, at_nodes = (
        np.polynomial.chebyshev.chebvander(x, degree) for x in (2 * frequency / cutoff - 1, nodes)
    )
    between = smooth @ np.linalg.inv(at_nodes)  # the transfer is smooth up to the cut-off

    def spread(
        nm: Array, inputs: Mapping[str, Any], defocus: Array, turn: Array
    ) -> tuple[Array, Array]:
        """Return the edge spread of a picture with its slope at distances from -span to span,
        twice."""
        error = jnp.zeros(max(terms)).at[np.array(terms) - 1].set(1e-9 * nm).at[3].add(defocus)
        across = jnp.stack([jnp.cos(turn), jnp.sin(turn)]) / inputs["pitch"]

        def otf(wave: Array) -> Array:
            at = jnp.multiply.outer((nodes + 1) * cutoff / 2, across)
            lens = error, wave, inputs["f_number"]
            return jv.optics.wavefront_otf(at, *lens, aperture=inputs["aperture"], samples=_PUPIL)

        wide, narrow = _aperture({"angle": jnp.degrees(turn)})
        pixel = jnp.sinc(frequency * wide) * jnp.sinc(frequency * narrow)
        real, imaginary = (between @ jax.vmap(otf)(inputs["wave"]).mean(axis=0)).T
        height = pixel / (4 * np.pi * span * frequency)
        odd, even = real * height, imaginary * height
        cycle = 2 * np.pi * frequency
        slope = np.cos(phase) @ (cycle * odd) - np.sin(phase) @ (cycle * even)
        share = 0.5 + np.sin(phase) @ odd + np.cos(phase) @ even
        table = jnp.stack([share, slope / _FINE], axis=-1)
        return table, table

    def predict(inputs: Mapping[str, Any], edge: Array, **coefficients: Array) -> Array:
        nm = jnp.stack([coefficients[f"z{term}"] for term in terms])
        here = jax.lax.stop_gradient(nm)

        def light(own: Array, changes: Array, defocus: Array, x: Array, y: Array) -> Array:
            at = dict(zip(_OF_EDGE, own[:, 0] + own[:, 1] * changes, strict=True))
            turn = jnp.radians(at["angle"])
            distance = _distance({"x": x, "y": y}, turn, at["place"], at["curvature"], jnp)
            # The pupil's direction is that of the first fit: its error has no effect on the blur.
            # Slopes by the coefficients are computed once, not for every parameter of an edge.
            fixed = inputs, defocus, jnp.radians(own[0, 0])
            slope, table = jax.jacfwd(spread, has_aux=True)(here, *fixed)
            table = table + slope @ (nm - here)
            place = jnp.clip((distance + span) * _FINE, 0, len(places) - 1.001)
            floor = jnp.floor(place)
            first = floor.astype(int)
            share = _cubic(place - floor, table[first], table[first + 1])
            level = at["low"] - inputs["black"] + (at["high"] - at["low"]) * share
            return inputs["black"] + level * (1 + at["shade_x"] * x + at["shade_y"] * y)

        each = inputs["own"], edge, inputs["defocus"], inputs["x"], inputs["y"]
        return jax.vmap(light)(*each)

    kind, named = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    asked = [inspect.Parameter(name, kind) for name in ("inputs", "edge")]
    asked += [inspect.Parameter(f"z{term}", named) for term in terms]
    predict.__signature__ = inspect.Signature(asked)
    return predict


def _cubic(x: Array, begin: Array, end: Array) -> Array:
    """Return the cubic on [0, 1] with these values and slopes, (..., 2), at both ends."""
    rise = end[..., 0] - begin[..., 0]
    bend = (1 - x) * (begin[..., 1] - rise) - x * (end[..., 1] - rise)
    return begin[..., 0] + x * (rise + (1 - x) * bend)


class _Pixels:
    """The valid pixels of a picture, their noise, and first estimates of the edge."""

    def __init__(self, picture: Float[np.ndarray, "h w"], angle: float, place: float) -> None:
        self.row, self.column = np.nonzero(np.isfinite(picture))
        self.value = picture[self.row, self.column]
        middle = (np.array(picture.shape) - 1) / 2
        self.inputs = {"x": self.column - middle[1], "y": self.row - middle[0]}
        self.angle, self.place = angle, place
        distance = _distance(self.inputs, np.radians(angle), place, 0.0)
        self.span = float(np.abs(distance).max())
        noise = np.full(picture.shape, np.nan)
        self.level, sd, self.block_variances = [], [], []
        across = picture.shape[1] // _BLOCK + 1
        blocks = self.row // _BLOCK * across + self.column // _BLOCK
        for side in (-1, 1):
            far = side * distance
            if far.max() < _LEAST:
                raise InputError(
                    f"from_edge: there are {max(far.max(), 0):.0f} pixels beside the edge; give a "
                    f"region with at least {_LEAST} on both sides."
                )
            flat = far > max(_LEAST / 2, far.max() / 2)
            plane = np.stack([np.ones(flat.sum()), *(x[flat] for x in self.inputs.values())], 1)
            missed = self.value[flat] - plane @ np.linalg.lstsq(plane, self.value[flat])[0]
            _refuse_mosaic(self.row[flat], self.column[flat], missed, self.value[flat])
            self.level.append(float(self.value[flat].mean()))
            sd.append(float(np.sqrt(np.sum(missed**2) / max(flat.sum() - 3, 1))))
            count = np.bincount(blocks[flat])
            full = count >= _BLOCK**2 / 2
            square = np.bincount(blocks[flat], missed**2)
            self.block_variances.append(square[full] / count[full])
            noise[self.row[flat], self.column[flat]] = missed / max(sd[-1], 1e-30)
        low, high = self.level
        if not high - low > _SIGNIFICANT * max(sd) / np.sqrt(_LEAST):
            raise InputError(
                "from_edge: the levels on both sides are equal within the noise; give a region "
                "with one edge."
            )
        self.side_sd = sd
        self.step = np.diff(np.unique(self.value)).min()  # rounding step of whole numbers
        least = max(
            self.step / np.sqrt(12), 1e-6 * (high - low), np.finfo(np.float32).eps * abs(high)
        )
        bins = np.round(distance).astype(int)
        bins -= bins.min()
        mean = np.bincount(bins, self.value) / np.maximum(np.bincount(bins), 1)
        share = np.clip((mean[bins] - low) / (high - low), 0, 1)
        variance = sd[0] ** 2 + (sd[1] ** 2 - sd[0] ** 2) * share
        self.sd = np.sqrt(np.maximum(variance, least**2))
        self.blocks = np.unique(blocks, return_inverse=True)[1] if _are_correlated(noise) else None


def _refuse_mosaic(
    row: np.ndarray, column: np.ndarray, missed: np.ndarray, value: np.ndarray
) -> None:
    """Refuse an edge if the pixels of a uniform side differ by their site in a 2 x 2 mosaic."""
    site = 2 * (row % 2) + column % 2
    count = np.bincount(site, minlength=4)
    if count.min() < _LEAST:  # one band of a mosaic
        return
    mean = np.bincount(site, missed, minlength=4) / count
    noise = np.sqrt(np.bincount(site, (missed - mean[site]) ** 2, minlength=4)) / count
    apart, size = np.ptp(mean), abs(float(value.mean()))
    if apart > _MOSAIC * size and apart > 2 * _SIGNIFICANT * noise.max():
        raise InputError(
            f"from_edge: on one side of the edge the sites of a 2 x 2 mosaic differ by "
            f"{apart / size:.0%}; give one band of raw colour numbers by sensor= and band=, or a "
            "developed picture."
        )


def _are_correlated(noise: Float[np.ndarray, "h w"]) -> bool:
    """Return whether noise of neighbouring pixels, of unit variance, is correlated."""
    for lag in (1, 2):  # lag 2 for a band measured at every second pixel
        products = [
            (noise[lag:] * noise[:-lag]).ravel(),
            (noise[:, lag:] * noise[:, :-lag]).ravel(),
        ]
        product = np.concatenate([one[np.isfinite(one)] for one in products])
        if product.size > 100:
            mean = abs(product.mean())
            return bool(mean > _SIGNIFICANT / np.sqrt(product.size) and mean > 0.03)
    return False


def _select_band(
    image: Any, sensor: jv.Sensor | None, band: int | None
) -> Float[np.ndarray, "h w"]:
    """Return the numbers of one band, NaN at pixels that do not measure it."""
    picture = np.array(image, float)
    if picture.ndim not in (2, 3) or min(picture.shape[:2]) < _LEAST:
        raise InputError(
            f"from_edge: image has the shape {picture.shape}; give (h, w) or (h, w, bands), of at "
            f"least {_LEAST} x {_LEAST} pixels."
        )
    tile = np.zeros((1, 1), int)
    if picture.ndim == 2 and sensor is not None and sensor.colour_filter is not None:
        tile = np.asarray(sensor.colour_filter.pattern)
    bands = picture.shape[2] if picture.ndim == 3 else int(tile.max()) + 1
    band = 0 if band is None and bands == 1 else band
    if band not in range(bands):
        raise InputError(f"from_edge: band is {band!r}; give 0 to {bands - 1}.")
    if picture.ndim == 3:
        return picture[..., band]
    row, column = np.indices(picture.shape)
    at = tile[row % tile.shape[0], column % tile.shape[1]]
    return np.where(at == band, picture, np.nan)


def _refuse_clipped(picture: Float[np.ndarray, "h w"], sensor: jv.Sensor | None) -> None:
    """Refuse a picture many of whose numbers lie at an end of their range."""
    known = picture[np.isfinite(picture)]
    if known.size == 0:
        raise InputError("from_edge: no pixel of the image is a finite number.")
    codes, counts = np.unique(known, return_counts=True)
    top = np.inf if sensor is None or sensor.bits is None else 2.0 ** float(sensor.bits) - 1
    for end, inner, name in ((-1, -2, "highest"), (0, 1, "lowest")):
        share = counts[end] / known.size
        at_an_end = codes[end] >= top if name == "highest" else codes[end] == 0 and top < np.inf
        # Noise puts fewer pixels at an extreme value than next to it.
        noisy = codes.size > 2 and counts[inner] > _CLIPPED_SHARE * known.size
        piled = noisy and counts[end] > counts[inner]
        if share > _CLIPPED_SHARE and (at_an_end or piled):
            raise InputError(
                f"from_edge: {share:.0%} of the pixels have the {name} value, {codes[end]:g}, so "
                "that one side is clipped; expose so that both sides lie within the range."
            )


def _first_line(picture: Float[np.ndarray, "h w"]) -> tuple[float, float]:
    """Estimate the edge's normal toward the bright side, degrees, and place, pixels."""
    known = np.isfinite(picture)
    weight = ndimage.gaussian_filter(known.astype(float), 1.5)
    smooth = ndimage.gaussian_filter(np.where(known, picture, 0.0), 1.5) / np.maximum(weight, 1e-9)
    slope_y, slope_x = np.gradient(smooth)
    sure = ndimage.minimum_filter(weight, 3) > 0.1
    strength = np.where(sure, np.hypot(slope_x, slope_y), 0.0)
    angle = np.arctan2(np.sum(strength**2 * slope_y), np.sum(strength**2 * slope_x))
    y, x = np.indices(picture.shape) - (np.array(picture.shape)[:, None, None] - 1) / 2
    along = np.maximum(np.cos(angle) * slope_x + np.sin(angle) * slope_y, 0) * sure
    distance = np.cos(angle) * x + np.sin(angle) * y
    peak = along >= np.quantile(along[sure], 0.9)
    return float(np.degrees(angle)), float(np.median(distance[peak & (along > 0)]))


def _problem(
    pixels: _Pixels, sensor: jv.Sensor | None, blur: Blur
) -> tuple[Problem, dict[str, float]]:
    """Return the problem of fitting the model, and the start of its search."""
    low, high = pixels.level
    span = pixels.span
    black = 0.0 if sensor is None or sensor.offset is None else float(np.mean(sensor.offset))
    start = {"angle": pixels.angle, "place": pixels.place, "low": low, "high": high}
    start |= {"blur": 0.6, "curvature": 0.0, "shade_x": 0.0, "shade_y": 0.0}
    parameters = {  # the same for all pictures, so that a second fit compiles nothing
        "angle": Parameter(unit="degrees", start=0.0),
        "place": Parameter(unit="pixels", start=0.0),
        "low": Parameter(unit="DN", start=0.0),
        "high": Parameter(unit="DN", start=1.0),
        "blur": Parameter(unit="pixels", lower=0, upper=100),
        "curvature": Parameter(unit="1/pixels", lower=-0.02, upper=0.02),
        "shade_x": Parameter(unit="1/pixels", lower=-0.05, upper=0.05),
        "shade_y": Parameter(unit="1/pixels", lower=-0.05, upper=0.05),
    }

    likelihood: Any = Gaussian(sd=pixels.sd)
    if pixels.blocks is not None:
        likelihood = Clustered(likelihood, labels=pixels.blocks)
    predict = _model(blur, 8 * float(np.ceil(span / 8)))
    inputs = pixels.inputs | {"black": np.float64(black)}
    return Problem(parameters, predict, likelihood, pixels.value, inputs=inputs), start


@cache
def _model(kind: Blur, span: float) -> Callable[..., Array]:
    """Return the prediction of the edge, the same function for equal settings."""

    def predict(
        inputs: Mapping[str, Array],
        angle: Array,
        place: Array,
        low: Array,
        high: Array,
        blur: Array,
        curvature: Array,
        shade_x: Array,
        shade_y: Array,
    ) -> Array:
        distance = _distance(inputs, jnp.radians(angle), place, curvature, jnp)
        at = {"angle": angle, "blur": blur}
        light = low - inputs["black"] + (high - low) * _edge(distance, at, kind, span)
        shade = 1 + shade_x * inputs["x"] + shade_y * inputs["y"]
        return inputs["black"] + light * shade

    return predict


def _distance(
    inputs: Mapping[str, Any], turn: Any, place: Any, curvature: Any, xp: Any = np
) -> Any:
    """Return the distances of pixels from the edge, positive on the bright side."""
    cosine, sine = xp.cos(turn), xp.sin(turn)
    along = cosine * inputs["y"] - sine * inputs["x"]
    return cosine * inputs["x"] + sine * inputs["y"] - place + curvature * along**2


def _edge(
    distance: Float[Array, "..."], at: Mapping[str, Any], blur: Blur, span: float
) -> Float[Array, "..."]:
    """Return the edge spread at a distance in pixels, from 0 (dark) to 1 (bright)."""
    if blur.diffraction is not None:  # odd harmonics of a square wave up to the cut-off frequency
        frequency = np.arange(1, 8 * span / blur.diffraction, 2) / (8 * span)
        height = _transfer(jnp.asarray(frequency), at, blur) / (4 * np.pi * span * frequency)
        return 0.5 + jnp.sin(2 * jnp.pi * jnp.multiply.outer(distance, frequency)) @ height
    wide, narrow = _aperture(at)
    far, near = (wide + narrow) / 2, (wide - narrow) / 2
    width = jnp.sqrt(jnp.asarray(at["blur"]) ** 2 + _NARROWEST**2)

    def ramp(x: Array) -> Array:
        """Return the double integral of the blur's edge spread."""
        if blur.shape == "gaussian":
            z = x / width
            return width**2 / 2 * ((z**2 + 1) * norm.cdf(z) + z * norm.pdf(z))
        radius = width / 2
        u = jnp.clip(x / radius, -1, 1)
        root, angle = jnp.sqrt(jnp.maximum(1 - u**2, _TINY)), jnp.arcsin(u)
        inside = (u**2 / 2 + 1 / 8) * angle + u * root * (13 / 24 + u**2 / 12)
        beyond = jnp.maximum(x - radius, 0)
        return radius**2 * (u**2 / 4 + 1 / 16 + inside / jnp.pi) + beyond * (radius + beyond / 2)

    rise = ramp(distance + far) - ramp(distance + near)
    return (rise - ramp(distance - near) + ramp(distance - far)) / (wide * narrow)


def _aperture(at: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return the two widths, in pixels, of the trapezoid that is the line spread of a square
    pixel."""
    turn = jnp.radians(jnp.asarray(at["angle"]))
    cosine, sine = jnp.abs(jnp.cos(turn)), jnp.abs(jnp.sin(turn))
    return jnp.maximum(cosine, _NARROWEST), jnp.maximum(sine, _NARROWEST)


def _transfer(
    frequency: Float[Array, "..."], at: Mapping[str, Any], blur: Blur
) -> Float[Array, "..."]:
    """Return the OTF of pixel, blur and diffraction across the edge."""
    wide, narrow = _aperture(at)
    aperture = jnp.sinc(frequency * wide) * jnp.sinc(frequency * narrow)
    return aperture * _blur_transfer(frequency, at, blur)


def _blur_transfer(
    frequency: Float[Array, "..."], at: Mapping[str, Any], blur: Blur
) -> Float[Array, "..."]:
    """Return the OTF without the pixel's aperture, which is the same in all directions."""
    phase = jnp.pi * at["blur"] * frequency
    if blur.shape == "gaussian":
        found = jnp.exp(-2 * phase**2)
    else:
        nodes, weights = _DISC
        found = jnp.cos(jnp.multiply.outer(phase, nodes)) @ weights
    if blur.diffraction is None:
        return found
    wave, f_number = jnp.array(1e-6), jnp.array(1e6 * blur.diffraction)
    return found * jv.optics.diffraction_mtf(frequency, wave, f_number)


def _falls_to_half(x: Float[Array, " n"], y: Float[Array, " n"]) -> Array:
    """Return the x at which y first falls to 1/2, interpolated between two samples."""
    after = jnp.argmax(y < 0.5)
    before = jnp.maximum(after - 1, 0)
    return x[before] + (y[before] - 0.5) / (y[before] - y[after]) * (x[after] - x[before])


def _measure(found: Fit, pixels: _Pixels, blur: Blur, reach: float) -> Resolution:
    """Measure the edge spread and the transfer without the model."""
    best = {name: float(np.asarray(number)) for name, number in found.values.items()}
    distance = _distance(pixels.inputs, np.radians(best["angle"]), best["place"], best["curvature"])
    share = np.asarray(_edge(jnp.asarray(distance), best, blur, pixels.span))
    contrast = best["high"] - best["low"]
    missed = np.asarray(found.residuals).ravel() * pixels.sd / contrast
    reach = min(reach, -distance.min(), distance.max())
    within = np.abs(distance) <= reach
    transfer, covariance = _free_transfer(
        distance[within], missed[within], pixels.sd[within] / contrast, reach,
        None if pixels.blocks is None else pixels.blocks[within],
    )  # fmt: skip
    frequency = transfer[0]
    otf = np.asarray(_transfer(jnp.asarray(frequency), best, blur)) + transfer[1]
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


def _nonlinear(result: Resolution, pixels: _Pixels, black: float, raw: bool) -> Iterator[str]:
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
                "rounding, and no gamma can be told from its edge."
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
    distance = _distance(pixels.inputs, turn, best["place"], best["curvature"])
    reach = max(_LEAST, 3 * best["blur"])
    near = np.abs(distance) <= reach
    distance, x, y = distance[near], *(pixels.inputs[name][near] for name in ("x", "y"))
    along = np.cos(turn) * y - np.sin(turn) * x
    along /= np.abs(along).max()
    value = (pixels.value[near] - best["low"]) / (high - low)
    even = np.stack([np.ones(x.size), x / np.abs(x).max(), y / np.abs(y).max()], 1)
    grid = np.linspace(-reach - 3, reach + 3, 1001)
    span = 8 * float(np.ceil((reach + 3) / 8))
    spread = jax.jit(
        lambda width: _edge(jnp.asarray(grid), best | {"blur": width}, result.blur, span)
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
            f"{blur.value + moved:.4g} pixels. For raw numbers, `sensor` says that they are linear."
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
    pixels: _Pixels,
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
            f"picture. Intervals are those of blocks of {_BLOCK} x {_BLOCK} pixels; raw numbers "
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
    if over.max() > _SIGNIFICANT:
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
    if np.any((np.abs(ends) > _SIGNIFICANT * error) & (np.abs(ends) > 0.01)):
        yield (
            f"The edge spread has not ended {max(-result.distance[0], result.distance[-1]):.0f} "
            "pixels from the edge; give a larger region and `reach`."
        )


def _p_value(values: np.ndarray, covariance: np.ndarray) -> float:
    """Return the probability that chance gives values at least this far from 0."""
    chi2 = values @ np.linalg.pinv(covariance, hermitian=True) @ values
    return float(stats.chi2.sf(chi2, values.size))
