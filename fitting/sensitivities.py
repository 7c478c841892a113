"""Estimate the spectral sensitivities of a camera, its colour matrix and white balance, from
patches or narrow-band light of known spectra.

A reading y is linear in the sensitivity s of its channel: y = sum over bands of L s, with L the
spectrum of the light, plus noise. The prior of s >= 0 is a Gaussian process over wavelength (Matern
3/2) whose size and correlation length maximise the evidence, times the transmittance of a filter
before the sensor, the same for all channels, which may block ultraviolet and infrared light. Such a
filter cuts off more steeply than a smooth process can. The prior of its two edges covers their
wavelengths and steepness, and half of the prior probability is on no edge. The evidence of all
channels together gives the posterior of the edges. Fine structure, a second process of a tenth of
the size and a length of 10 nm, is added, because the smooth spectra of paints do not show whether
there is any. A posterior draw is the optimum of a randomised problem: the prior's mean and the
readings are drawn, and non-negative least squares finds s. This is exact for a Gaussian posterior.
Each draw also uses its own draw of filter, size, length and noise, so that the intervals include
their errors.

Source:
    Rasmussen & Williams, Gaussian Processes for Machine Learning, chapters 2 and 5; Bardsley &
    Fox, "An MCMC method for uncertainty quantification in nonnegativity constrained inverse
    problems", Inverse Problems in Science and Engineering 20 (2012).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import OptimizeResult, minimize, nnls
from scipy.special import expit

from jaxvision import ArrayLike, colour_spaces
from jaxvision.errors import InputError

from .fits.bands import Bands, bands
from .inference.diagnostics import listed
from .inference.formatting import format_percent
from .inference.given import plain_numbers, require_seed, require_whole
from .inference.precision import double_precision
from .report.figures import empty_panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FEWEST = 4  # fewest readings of a channel
_LENGTHS = 5e-9, 400e-9  # m, range of correlation lengths in the prior
_STARTS = 25e-9, 60e-9, 120e-9  # m
# m, half-transmittance of filters that block ultraviolet and infrared light, and their steepness: a
# transmittance rises from 10 to 90 % over 4.4 times the steepness
_BLUE_EDGES, _RED_EDGES = 1e-9 * np.arange(385, 440, 5), 1e-9 * np.arange(625, 770, 5)
_STEEPNESS = 2e-9, 4e-9, 8e-9
# structure that the spectra of paints do not show: its standard deviation relative to that of the
# smooth process, and its correlation length in m
_FINE, _FINE_LENGTH = 0.1, 10e-9
_MODEL_ERROR = 1e-4  # share of the largest reading: least error of any model of light and camera
# logarithm of a ratio of evidences from which a larger noise replaces the stated one
_LEAST_GAIN = 5.0
_MISFIT_RATIO = 1.3  # ratio of residuals to the stated noise from which a misfit is reported
_NEGATIVE = 2.0  # ratio of residuals to the fitted noise that sensitivities above 0 do not explain
_FEWEST_EQUAL = 2  # equal largest readings that count as clipped; one more of whole numbers
_COARSE = 0.05  # share of the largest reading: larger residuals are no noise of a photograph
_NARROW = 0.2  # of the range of wavelengths, width of a band of light
_SHIFTS = 1e-9 * np.arange(-25, 26)  # m, errors of the wavelengths of bands that are tried
_SURE_OF_OFFSET = 3.5  # standard errors
_SURE_OF_SHIFT = 4.0  # standard errors
_CAUSES = (
    "Causes are uneven light, a gamma, a black level, stray light, clipped patches, or spectra "
    "that are wrong or in another order."
)


@dataclass(frozen=True)
class Sensitivities:
    """The spectral sensitivities of a camera's channels, as draws of their posterior.

    Attributes:
        wavelengths: (bands,) wavelengths, m.
        channels: names of the channels.
        draws: (draws, bands, channels) draws of the sensitivities, in the unit of readings divided
            by the unit of the light, at least 0.
        length: (channels,) correlation length over wavelength, m.
        noise: (channels,) standard deviation of the readings, relative to the stated one; in the
            unit of the readings if none was stated.
        findings: findings in sentences.
    """

    wavelengths: Float[np.ndarray, " bands"]
    channels: tuple[str, ...]
    draws: Float[np.ndarray, "draws bands channels"]
    length: Float[np.ndarray, " channels"]
    noise: Float[np.ndarray, " channels"]
    findings: tuple[str, ...]

    @cached_property
    def curves(self) -> Bands:
        """Return the sensitivities (bands, channels) with intervals."""
        return bands(self.draws)

    def readings(self, light: ArrayLike) -> Bands:
        """Predict the camera's readings of light, with intervals from the errors of the
        sensitivities.

        Args:
            light: (..., bands) spectrum, in the unit of the light in `from_patches`.

        Returns:
            Bands of the shape (..., channels), in the unit of the readings.
        """
        return bands(np.einsum("...b,dbc->d...c", self._light("light", light), self.draws))

    def white_balance(self, illuminant: ArrayLike) -> Bands:
        """Return the factors on the channels that make all readings of white equal to the reading
        of the second channel.

        Args:
            illuminant: (bands,) spectrum of the light on a perfect white, relative.

        Returns:
            Bands of the shape (channels,), no unit.
        """
        white = self._light("illuminant", illuminant) @ self.draws
        return bands(white[:, 1 % len(self.channels)][:, None] / white)

    @double_precision
    def matrix(self, illuminant: ArrayLike, *, reflectances: ArrayLike | None = None) -> Bands:
        """Return the 3 x 3 matrix from readings to XYZ that has the least squared error for a set
        of reflectances and is exact for white.

        Args:
            illuminant: (bands,) spectrum of the light on a perfect white, relative.
            reflectances: (patches, bands); None for the 24 of a colour chart.

        Returns:
            Bands of the shape (3, channels); XYZ are relative to a white of Y = 1.
        """
        raw, xyz = self._scene(illuminant, reflectances)
        return bands(np.stack([_matrix(one, xyz) for one in raw]))

    @double_precision
    def delta_e(self, illuminant: ArrayLike, *, reflectances: ArrayLike | None = None) -> Bands:
        """Return the CIEDE2000 difference between each reflectance and its colour from the camera.

        The camera's colours are computed with the mean matrix. The spread of the result over draws
        is due to the errors of the sensitivities. The mean also includes the error that the best
        matrix has.

        Args:
            illuminant: (bands,) spectrum of the light on a perfect white, relative.
            reflectances: (patches, bands); None for the 24 of a colour chart.

        Returns:
            Bands of the shape (patches,).
        """
        raw, xyz = self._scene(illuminant, reflectances)
        mean = np.mean([_matrix(one, xyz) for one in raw], axis=0)
        shown = np.maximum(np.einsum("xc,dpc->dpx", mean, raw), 0)
        labs = [
            colour_spaces.xyz_to_lab(jnp.asarray(one[..., :-1, :]), jnp.asarray(xyz[-1]))
            for one in (shown, xyz)
        ]
        return bands(
            np.asarray(
                colour_spaces.delta_e_2000(labs[0], jnp.broadcast_to(labs[1], labs[0].shape))
            )
        )

    def _scene(
        self, illuminant: ArrayLike, reflectances: ArrayLike | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the camera's readings (draws, patches + 1, channels) and XYZ (patches + 1, 3) of
        reflectances under a light, with white last.
        """
        if len(self.channels) != 3:
            raise InputError(f"a matrix needs three channels, got {len(self.channels)}.")
        light, at = self._light("illuminant", illuminant), jnp.asarray(self.wavelengths)
        own = (
            np.asarray(colour_spaces.chart_reflectances(at), float)
            if reflectances is None
            else self._light("reflectances", reflectances)
        )
        shown = light * np.concatenate([own, np.ones((1, len(light)))])
        xyz = shown @ np.asarray(colour_spaces.observer(at), float)
        return shown @ self.draws, xyz / xyz[-1, 1]

    def _light(self, name: str, light: ArrayLike) -> np.ndarray:
        found = np.asarray(plain_numbers(name, light), float)
        if found.shape[-1:] != self.wavelengths.shape:
            raise InputError(
                f"{name} is {found.shape}; its last axis needs the {len(self.wavelengths)} bands "
                "of the sensitivities."
            )
        return found

    def __str__(self) -> str:
        peaks = self.wavelengths[np.argmax(self.curves.mean, axis=0)]
        rows = [
            f"{name}: peak {value:.4g} ± {sd:.2g} at {1e9 * peak:.0f} nm, smooth over "
            f"{1e9 * length:.0f} nm"
            for name, peak, length, value, sd in zip(
                self.channels,
                peaks,
                self.length,
                self.curves.mean.max(axis=0),
                np.take_along_axis(
                    self.curves.sd, np.argmax(self.curves.mean, axis=0)[None], axis=0
                )[0],
                strict=True,
            )
        ]
        return "\n".join((*rows, *self.findings))

    def figure(self) -> "Figure":
        """Draw the sensitivities with 68 % and 95 % bands.

        Returns:
            The figure, of matplotlib.
        """
        figure, axes = empty_panels((6, 3.6))
        colours = ("#c43b3b", "#2f8f4e", "#3b62c4") if len(self.channels) == 3 else ()
        at = 1e9 * self.wavelengths
        for i, name in enumerate(self.channels):
            colour = colours[i] if colours else f"C{i}"
            axes.plot(at, self.curves.mean[:, i], color=colour, label=name)
            for ends, alpha in ((self.curves.interval_95, 0.15), (self.curves.interval_68, 0.25)):
                axes.fill_between(at, *ends[..., i], color=colour, alpha=alpha, linewidth=0)
        axes.set(xlabel="wavelength, nm", ylabel="sensitivity", ylim=(0, None))
        axes.legend(frameon=False)
        return figure


def from_patches(
    readings: ArrayLike,
    light: ArrayLike,
    wavelengths: ArrayLike,
    *,
    sd: ArrayLike | None = None,
    channels: Sequence[str] = ("red", "green", "blue"),
    draws: int = 200,
    seed: int = 0,
) -> Sensitivities:
    """Estimate the sensitivities of a camera from its readings of known spectra.

    The spectra may be those of a chart's patches (illuminant times reflectance), of narrow bands of
    light, or both. Readings must be linear in the light and must come from one exposure, with the
    black level subtracted.

    Args:
        readings: (patches, channels) readings, NaN where saturated.
        light: (patches, bands) spectrum of each patch, the same unit for all. If the stated light
            is wrong by a factor that varies smoothly over wavelength, the curves are wrong by its
            inverse. Readings under one light do not show this, readings under two lights do.
        wavelengths: (bands,) m, increasing.
        sd: (patches, channels), (patches, 1) or () standard deviations of the readings. None
            estimates one for each channel from its residuals.
        channels: names of the channels.
        draws: number of posterior draws, at least 2.
        seed: seed of the draws.

    Returns:
        The sensitivities.

    Raises:
        InputError: for shapes that do not fit, fewer than 4 readings of a channel, light that is 0
            everywhere, wavelengths that are not in m or do not increase, and standard deviations
            that are not above 0.

    Example:
        >>> from fitting import sensitivities
        >>> nm = np.arange(400, 701, 10)
        >>> at = jnp.asarray(1e-9 * nm)
        >>> patches = jv.colour_spaces.chart_reflectances(at)
        >>> light = patches * jv.colour_spaces.illuminant("D65", at)[None] / 100
        >>> readings = light @ jv.colour_spaces.camera_sensitivities("Nikon 5100 (NPL)", at)
        >>> found = sensitivities.from_patches(readings, light, 1e-9 * nm, sd=0.01)
        >>> print(nm[found.curves.mean.argmax(axis=0)])  # true: 590, 530, 460
        [610 530 450]
    """
    y = np.asarray(plain_numbers("readings", readings), float)
    spectra = np.asarray(plain_numbers("light", light), float)
    at = np.asarray(plain_numbers("wavelengths", wavelengths), float)
    names = tuple(channels)
    if y.ndim != 2 or y.shape[1] != len(names) or spectra.shape != (len(y), at.size):
        raise InputError(
            f"readings are {y.shape}, light {spectra.shape} and wavelengths {at.shape}; give "
            f"(patches, {len(names)}), (patches, bands) and (bands,)."
        )
    if not np.isfinite(spectra).all() or spectra.min() < 0:
        raise InputError("light must be finite and at least 0.")
    if at.size < 2 or not (np.diff(at) > 0).all() or at[0] < 1e-7 or at[-1] > 1e-4:
        raise InputError("wavelengths must increase, in metres; 550 nm are 550e-9.")
    stated = None
    if sd is not None:
        stated = np.broadcast_to(np.asarray(plain_numbers("sd", sd), float), y.shape)
        if not (np.isfinite(stated) & (stated > 0)).all():
            raise InputError("sd must be above 0.")
    require_whole("draws", draws, least=2)
    require_seed(seed)
    rng = np.random.default_rng(seed)
    fits, sentences = [], []
    for i, name in enumerate(names):
        kept = np.isfinite(y[:, i])
        sentences += _clipped_in_words(name, y[kept, i])
        if kept.sum() < _FEWEST:
            raise InputError(f"{name}: {kept.sum()} readings are numbers; give at least {_FEWEST}.")
        if not spectra[kept].any():
            raise InputError(f"{name}: light is 0 in all bands of its patches; give the spectra.")
        own = None if stated is None else stated[kept, i]
        fits.append(_Channel(spectra[kept], y[kept, i], at, own))
    chosen = _fit_priors(fits, at, draws, rng)
    found, lengths, noises = [], [], []
    for i, (name, channel) in enumerate(zip(names, fits, strict=True)):
        kept, best = np.isfinite(y[:, i]), channel.best
        found.append(channel.draws(chosen, rng))
        left = y[kept, i] - spectra[kept] @ found[-1].mean(axis=0)
        noise, off = channel.unit * channel.noise(best), float(np.sqrt(np.mean(left**2)))
        lengths.append(np.exp(best[1]))
        noises.append(np.exp(best[2]) * (channel.unit if stated is None else 1.0))
        if np.sqrt(np.mean((left / noise) ** 2)) > _NEGATIVE:
            below = int(np.sum(y[kept, i] < -_NEGATIVE * noise))
            sentences.append(
                f"{name}: no sensitivity of at least 0 explains the readings, which differ from "
                f"the fit by {format_percent(off / channel.unit)} of the largest (rms)"
                + (f"; {below} of {kept.sum()} are below 0" if below else "")
                + f". Intervals do not allow for it. {_CAUSES}"
            )
        elif stated is not None and np.exp(best[2]) > _MISFIT_RATIO:
            sentences.append(
                f"{name}: readings differ from any smooth sensitivity by {np.exp(best[2]):.2g} "
                f"times their standard deviation; intervals allow for it. {_CAUSES}"
            )
        elif stated is None and off > _COARSE * channel.unit:
            sentences.append(
                f"{name}: readings differ from any smooth sensitivity by "
                f"{format_percent(off / channel.unit)} of the largest (rms), more than noise does; "
                f"intervals allow for it. {_CAUSES}"
            )
    drawn = np.stack(found, axis=-1)
    offsets = np.array([channel.offset() for channel in fits])
    pull = abs(np.sum(offsets[:, 0] / offsets[:, 1])) / np.sqrt(len(names))
    misfits = sum(_CAUSES in sentence for sentence in sentences)
    if pull > _SURE_OF_OFFSET and misfits < len(names):
        amounts = ", ".join(f"{100 * o:.2g} ± {100 * e:.1g}" for o, e in offsets)
        sentences.append(
            f"Without light the readings of {listed(list(names))} would be {amounts} % of the "
            "largest, not 0. Causes are a black level, stray light or a gamma; intervals do not "
            "allow for them."
        )
    peaks = dict(zip(names, at[np.argmax(drawn.mean(axis=0), axis=0)], strict=True))
    red, blue = peaks.get("red", np.inf), peaks.get("blue", 0.0)
    if red < blue:
        sentences.append(
            f"red is most sensitive at {1e9 * red:.0f} nm and blue at {1e9 * blue:.0f} nm: the "
            "readings are in the order blue, green, red, or channels names them wrongly."
        )
    narrow = _widths(spectra, at) < _NARROW * np.ptp(at)
    sentences += _shifted_in_words(fits, [narrow[np.isfinite(one)] for one in y.T], at, drawn)
    return Sensitivities(at, names, drawn, np.array(lengths), np.array(noises), tuple(sentences))


def _widths(spectra: np.ndarray, at: np.ndarray) -> Float[np.ndarray, " patches"]:
    """Return the width, m, of the box that has the same integral and squared integral."""
    apart = np.gradient(at)
    squares = np.maximum(spectra**2 @ apart, 1e-300)
    return (spectra @ apart) ** 2 / squares


def _shifted_in_words(
    fits: Sequence["_Channel"], narrow: Sequence[np.ndarray], at: np.ndarray, draws: np.ndarray
) -> list[str]:
    """Return a sentence on the error of the wavelengths of narrow bands, which readings of broad
    spectra reveal, or on how exact they must be."""
    if not all(bands.sum() >= _FEWEST for bands in narrow):
        return []
    slopes = np.gradient(draws.mean(axis=0), at, axis=0)
    errors = np.sqrt(np.mean(draws.var(axis=0), axis=0))
    least = float(np.min(errors / np.sqrt(np.mean(slopes**2, axis=0))))
    shift, sd = 0.0, np.inf
    if not all(bands.all() for bands in narrow):
        evidence = np.sum(
            [
                [one.evidence_of_shift(bands, at, step) for step in _SHIFTS]
                for one, bands in zip(fits, narrow, strict=True)
            ],
            axis=0,
        )
        weights = np.exp(evidence - evidence.max())
        shift = float(np.average(_SHIFTS, weights=weights))
        sd = float(np.sqrt(np.average((_SHIFTS - shift) ** 2, weights=weights)))
        sd = float(np.hypot(sd, np.ptp(_SHIFTS[:2]) / np.sqrt(12)))
        if max(weights[0], weights[-1]) > weights.max() / 2:
            return [
                f"Readings of narrow bands and of broad spectra agree best if the bands lie "
                f"{1e9 * abs(_SHIFTS[0]):.0f} nm or more "
                f"{'below' if shift < 0 else 'above'} the stated wavelengths. Correct the "
                "wavelengths, or check that the readings belong to them."
            ]
    if abs(shift) > _SURE_OF_SHIFT * sd:
        return [
            f"Readings of narrow bands and of broad spectra agree best if the bands lie "
            f"{1e9 * shift:+.1f} ± {1e9 * sd:.1g} nm from the stated wavelengths, as with a "
            f"monochromator out of adjustment. From {1e9 * least:.2g} nm on such an error exceeds "
            "the intervals. Correct the wavelengths."
        ]
    if sd > max(least, abs(_SHIFTS[0]) / 10):
        return [
            "The wavelengths of narrow bands are taken as exact. The readings do not show an error "
            "that is common to all, which moves the curves by as much; from "
            f"{1e9 * least:.2g} nm on it exceeds the intervals. Check them with a spectral line, "
            "or add readings of a chart."
        ]
    return []


def _clipped_in_words(name: str, readings: np.ndarray) -> list[str]:
    """Return a sentence if several readings equal the largest one, as clipped readings do. Whole
    numbers may be equal by chance, so one more must be equal. Readings of NaN are ignored."""
    count = int(np.sum(readings == readings.max(initial=-np.inf)))
    whole = np.array_equal(readings, np.round(readings))
    if count < _FEWEST_EQUAL + whole or not readings.max() > 0:
        return []
    return [
        f"{name}: {count} readings are equal to the largest, {readings.max():.4g}: if they are "
        "clipped, the curve is too low; give NaN for clipped readings."
    ]


def _matrix(raw: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Return the least-squares matrix (3, channels) to XYZ, exact for white, the last row."""
    inverse = np.linalg.inv(raw[:-1].T @ raw[:-1])
    free = (inverse @ raw[:-1].T @ xyz[:-1]).T
    white = inverse @ raw[-1]
    return free + np.outer(xyz[-1] - free @ raw[-1], white) / (raw[-1] @ white)


def _edges(at: np.ndarray, places: np.ndarray) -> Float[np.ndarray, "edges bands"]:
    """Return functions of wavelength that fall from 1 to 0, one for each position and steepness."""
    return np.array([expit((place - at) / wide) for wide in _STEEPNESS for place in places])


def _fit_priors(
    channels: Sequence["_Channel"], at: np.ndarray, draws: int, rng: np.random.Generator
) -> Float[np.ndarray, "draws bands"]:
    """Fit the prior of each channel behind the most probable filter, and return posterior draws of
    the filter's transmittance, no unit."""
    starts = [np.array([0.0, np.log(length)]) for length in _STARTS]
    none = np.ones((1, at.size))
    sides = [
        np.concatenate([none, edges])
        for edges in (_edges(at, _RED_EDGES), 1 - _edges(at, _BLUE_EDGES))
    ]
    best, drawn = [none[0], none[0]], [none, none]
    for _ in range(2):  # lengths without a filter are too short, which changes its evidence little
        for one in channels:
            one.fit(best[0] * best[1], starts)
        for i, filters in enumerate(sides):
            evidence = sum(one.evidence(filters * best[1 - i]) for one in channels)
            weights = np.exp(evidence - np.max(evidence))
            weights[0] *= len(weights) - 1  # half of the prior is on no edge
            best[i] = filters[np.argmax(weights)]
            drawn[i] = filters[rng.choice(len(weights), draws, p=weights / weights.sum())]
    for one in channels:
        one.fit(best[0] * best[1], starts)
    return drawn[0] * drawn[1]


def _matern(distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Matern's 3/2 correlation at a distance relative to the correlation length, and its
    derivative with respect to the logarithm of this length."""
    r = np.sqrt(3) * distance
    return (1 + r) * np.exp(-r), r * r * np.exp(-r)


class _Channel:
    """The readings of a channel, of largest value 1, with its evidence and draws."""

    # (3,) logarithms of the prior's size and length and of the noise that maximise the evidence
    best: np.ndarray
    passed: np.ndarray  # (bands,) transmittance of the filter for which it does, no unit

    def __init__(
        self, light: np.ndarray, y: np.ndarray, at: np.ndarray, sd: np.ndarray | None
    ) -> None:
        self.unit = float(np.abs(y).max()) or 1.0
        self.scale = self.unit / max(float(light.sum(axis=1).max()), 1e-300)  # flat curve
        self.light, self.y = light * (self.scale / self.unit), y / self.unit
        self.sd = np.ones(len(y)) if sd is None else sd / self.unit
        self.bounds = [
            (np.log(0.05), np.log(100.0)),
            tuple(np.log(_LENGTHS)),
            (np.log(_MODEL_ERROR), 0.0)
            if sd is None
            else (0.0, np.log(max(100.0, 1 / self.sd.min()))),
        ]
        self.apart = np.abs(at[:, None] - at)
        self.fine = _FINE**2 * _matern(self.apart / _FINE_LENGTH)[0] + 1e-8 * np.eye(at.size)

    def noise(self, at: np.ndarray) -> np.ndarray:
        return np.hypot(np.exp(at[2]) * self.sd, _MODEL_ERROR)

    def cost(self, at: np.ndarray, passed: np.ndarray) -> tuple[float, np.ndarray]:
        """Return minus the logarithm of the evidence for sensitivities behind a filter, with broad
        priors about an amplitude of 1 and a correlation length of 60 nm, and its gradient."""
        smooth, slope = _matern(self.apart / np.exp(at[1]))
        size, seen = np.exp(2 * at[0]), self.light * passed
        of_prior = size * (seen @ smooth @ seen.T + self.light @ self.fine @ self.light.T)
        root = np.linalg.cholesky(of_prior + np.diag(self.noise(at) ** 2))
        inverse = cho_solve((root, True), np.eye(len(root)))
        left = inverse @ self.y
        prior = (at[0] / 2) ** 2 + np.log(np.exp(at[1]) / 60e-9) ** 2
        cost = self.y @ left / 2 + np.log(np.diag(root)).sum() + prior / 2
        inner = (inverse - np.outer(left, left)) / 2
        gradient = [
            2 * np.sum(inner * of_prior) + at[0] / 4,
            size * np.sum(inner * (seen @ slope @ seen.T)) + np.log(np.exp(at[1]) / 60e-9),
            2 * np.diag(inner) @ (np.exp(at[2]) * self.sd) ** 2,
        ]
        return float(cost), np.array(gradient)

    def fit(self, passed: np.ndarray, starts: Sequence[np.ndarray]) -> None:
        """Maximise the evidence behind a filter, from logarithms of size and length."""
        self.passed = passed
        low, high = self.bounds[2]
        loud = float(np.clip(np.log(0.02 / np.median(self.sd)), low, high))
        best = self._fit_from(starts, loud)
        if low == 0 and loud > 0:  # the stated noise, unless the readings refute it
            stated = self._fit_from(starts, 0.0)
            best = best if best.fun < stated.fun - _LEAST_GAIN else stated
        self.best = best.x

    def _fit_from(self, starts: Sequence[np.ndarray], noise: float) -> OptimizeResult:
        """Return the best optimum of searches from a logarithm of the noise."""
        tries = [
            minimize(
                self.cost,
                np.append(start, noise),
                args=(self.passed,),
                jac=True,
                bounds=self.bounds,
                method="L-BFGS-B",
            )
            for start in starts
        ]
        return min(tries, key=lambda one: one.fun)

    def evidence(
        self, filters: Float[np.ndarray, "filters bands"]
    ) -> Float[np.ndarray, " filters"]:
        """Return the logarithm of the evidence of each filter, up to an additive constant."""
        return self._log_density(self._covariance(filters))

    def _covariance(self, filters: Float[np.ndarray, "filters bands"]) -> np.ndarray:
        """Return the covariance of the readings behind each filter."""
        seen = self.light * filters[:, None, :]
        smooth = _matern(self.apart / np.exp(self.best[1]))[0]
        of_prior = seen @ smooth @ np.swapaxes(seen, 1, 2) + self.light @ self.fine @ self.light.T
        noise = np.diag(self.noise(self.best) ** 2)
        return np.exp(2 * self.best[0]) * of_prior + noise

    def offset(self) -> tuple[float, float]:
        """Return what the readings would be without light, relative to the largest, and its
        standard error, by generalised least squares."""
        covariance = self._covariance(self.passed[None])[0]
        ones = np.linalg.solve(covariance, np.ones(len(self.y)))
        return float(ones @ self.y / ones.sum()), float(1 / np.sqrt(ones.sum()))

    def _log_density(self, covariance: np.ndarray) -> np.ndarray:
        """Return the logarithm of the Gaussian density of the readings, up to a constant."""
        left = np.linalg.solve(covariance, self.y[:, None])[..., 0]
        return -(left @ self.y + np.linalg.slogdet(covariance)[1]) / 2

    def evidence_of_shift(self, bands: np.ndarray, at: np.ndarray, shift: float) -> float:
        """Return the logarithm of the evidence if some readings, of narrow bands, are those of
        wavelengths that differ by a shift in m from the stated ones."""
        places = np.concatenate([at, at + shift])
        light = np.concatenate([self.light * ~bands[:, None], self.light * bands[:, None]], axis=1)
        seen = light * np.concatenate([self.passed, np.interp(places[at.size :], at, self.passed)])
        apart = np.abs(places[:, None] - places)
        of_prior = np.exp(2 * self.best[0]) * _matern(apart / np.exp(self.best[1]))[0]
        fine = _FINE**2 * _matern(apart / _FINE_LENGTH)[0]
        noise = np.diag(self.noise(self.best) ** 2)
        return float(self._log_density(seen @ of_prior @ seen.T + light @ fine @ light.T + noise))

    def _spread(self) -> np.ndarray:
        """Return the covariance of the errors of `best`."""
        step = 0.05
        slopes = [
            (
                self.cost(self.best + move, self.passed)[1]
                - self.cost(self.best - move, self.passed)[1]
            )
            / (2 * step)
            for move in step * np.eye(3)
        ]
        sizes, ways = np.linalg.eigh((np.array(slopes) + np.array(slopes).T) / 2)
        return ways @ np.diag(1 / np.maximum(sizes, 1.0)) @ ways.T  # at most a factor of e

    def draws(
        self, filters: Float[np.ndarray, "draws bands"], rng: np.random.Generator
    ) -> Float[np.ndarray, "draws bands"]:
        """Return non-negative posterior draws, each behind its filter."""
        low, high = np.array(self.bounds).T
        ats = rng.multivariate_normal(self.best, self._spread(), len(filters))
        found = []
        for at, passed in zip(np.clip(ats, low, high), filters, strict=True):
            smooth = _matern(self.apart / np.exp(at[1]))[0]
            prior = np.exp(2 * at[0]) * (passed[:, None] * smooth * passed + self.fine)
            root, noise = np.linalg.cholesky(prior), self.noise(at)
            whiten = solve_triangular(root, np.eye(len(root)), lower=True)
            stacked = np.concatenate([self.light / noise[:, None], whiten])
            right = np.concatenate([self.y / noise, np.zeros(len(root))])
            found.append(nnls(stacked, right + rng.normal(size=right.size))[0])
        return np.array(found) * self.scale
