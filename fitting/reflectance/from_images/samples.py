"""Samples of photographs, their prediction by a surface and an encoding, and their likelihood.

A sample is a lit pixel under one light, or a cell. A cell is the mean of pixels with similar
geometry under one light, so that the time for a fit does not grow with the number of pixels. The
mean over a cell differs from the value at its centre, because the model is curved inside the cell.
The correction for this difference is computed at given parameters, so that cells and pixels agree
exactly at these parameters.

A pixel at or above the clip level has an unknown value of at least the clip level. Such a pixel is
censored (Tobin, Econometrica 26, 1958) and contributes log Phi((predicted - clip) / deviation) to
the log likelihood, with Phi the normal distribution function.

JAX computes only the lobe of a model and its derivatives (`signal`). For searches, all other
derivatives are computed in NumPy by the chain rule, so that a new number of pixels, channels or
terms needs no compilation. Let X be the signal, D = f(X) its digital number, and ln L the sum over
samples of l(D). With the indices i and j for derivatives with respect to parameters,

    d ln L / d_i = sum l' D_i,    d2 ln L / d_i d_j = sum l'' D_i D_j + l' D_ij,
    D_i = f' X_i,                 D_ij = f'' X_i X_j + f' X_ij.

All parameters are logarithms. For an amplitude a, X_aa = X_a. For a shape s, X_as = X_s if a is the
amplitude of the lobe with this shape, and 0 otherwise. Chains evaluate the same density in JAX.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.special import erfcx, log_ndtr

from ...inference import tails
from ...inference.parameters import names, to_natural
from ..models import has_lobe, shape_of
from .read import VIEW, WEIGHTS, Photographs
from .signal import (
    Form,
    Geometry,
    Matrix,
    OfSamples,
    Vector,
    directions_from_cosines,
    encoded,
    encoding_slope,
    lobe_with_slopes,
    parameter_space,
    signal,
)

COSINE_STEP = 0.05  # width of a cell in n.l
FEWEST_SATURATED = 64  # fewest saturated samples, with padding, of a compiled program
UNCERTAIN = 1e12  # DN, standard deviation of a sample without information
FINE_ANGLE, ANGLE_RATIO = 0.1, 1.1  # cells are 0.01 rad wide at the mirror direction, 0.11 at 1 rad


class Samples(eqx.Module):
    """Lit pixels of one channel, or cells of similar pixels: arrays of NumPy or of JAX."""

    form: Form = eqx.field(static=True)
    geometry: Geometry  # at the centres of pixels
    dn: Float[Any, " samples"]  # DN
    # DN, standard deviation; a cell of equal pixels is one sample with a smaller deviation
    deviation: Float[Any, " samples"]
    saturated: Bool[Any, " samples"] | None  # None where nothing clips
    black: Float[Any, ""]  # DN without light
    white: Float[Any, ""]  # DN of full scale above black
    clip: Float[Any, ""]  # DN from which a pixel is saturated
    gamma: Float[Any, ""] | None  # known encoding; None for linear files or where it is free
    # DN added to a prediction, at a vector of zeros, and its slopes: the mean over the area of a
    # pixel, or over the pixels of a cell, minus the value at the middle
    offset: Float[Any, "1+parameters samples"] | None = None
    # samples at `POINTS` of pixels, over which a prediction is averaged; empty for values at the
    # middle
    points: tuple[Geometry, ...] = ()


# ---------------------------------------------------------------- pixels


@dataclass(frozen=True)
class Selection:
    """The samples that a fit uses."""

    light: Int[np.ndarray, " samples"]  # indices, lights in order
    pixel: Int[np.ndarray, " samples"]  # indices


def select(
    observation: Photographs, *, held_out: bool, form: Form, minimum_cosine: float = 0.0
) -> Selection:
    """Select the samples of the held-out lights, or of the others, with n.l above a minimum.

    Attached shadows (n.l <= 0) are predicted to be black and contain no information about the
    surface, so they are used only for an ambient term.
    """
    seen = observation.cosine > minimum_cosine
    if form.ambient:
        seen = seen | (observation.cosine <= 0)
    return Selection(*np.nonzero(seen & (observation.held_out == held_out)[:, None]))


@dataclass(frozen=True, eq=False)
class View:
    """One channel of photographs, restricted to the samples of a fit."""

    observation: Photographs
    channel: int
    selection: Selection

    @property
    def lights(self) -> int:
        """Return the number of lights, including held-out ones."""
        return len(self.observation.files)

    def samples(self, form: Form) -> Samples:
        """Return the samples with a standard deviation of 1 DN."""
        gamma = None if form.free_gamma else self.observation.gamma
        return replace(self._samples, form=form, gamma=None if gamma is None else np.float64(gamma))

    @cached_property
    def _samples(self) -> Samples:
        """Return the samples that the fits of all forms share."""
        seen, light, pixel = self.observation, self.selection.light, self.selection.pixel
        dn = seen.dn[self.channel, light, pixel]

        def geometry_of(seen: Photographs) -> Geometry:
            normals, wi = seen.normals[pixel], seen.wi[light, pixel]
            irradiance = seen.intensity[self.channel, light] * seen.falloff[light, pixel]
            return directions_from_cosines(
                np.einsum("sc,sc->s", normals, wi), normals @ VIEW, wi @ VIEW, irradiance
            )

        # if one channel clips, all channels get a limit, so that they share programs
        clips = any((one[light, pixel] >= seen.clip).any() for one in seen.dn)
        return Samples(
            form=Form("lambert"),
            geometry=geometry_of(seen),
            points=() if seen.within is None else tuple(map(geometry_of, seen.points)),
            dn=dn,
            deviation=np.ones_like(dn),
            saturated=dn >= seen.clip if clips else None,
            black=np.float64(seen.black),
            white=np.float64(seen.white),
            clip=np.float64(seen.clip),
            gamma=None,
        )

    def every_nth_pixel(self, step: int) -> "View":
        """Return the data with only the samples of every `step`-th pixel."""
        kept = self.selection.pixel % step == 0
        some = Selection(self.selection.light[kept], self.selection.pixel[kept] // step)
        return View(self.observation.select_pixels(slice(None, None, step)), self.channel, some)


def image_view(observation: Photographs, channel: int, light: int) -> View:
    """Return the data of all pixels of the object under one light."""
    pixels = np.arange(observation.cosine.shape[1])
    return View(observation, channel, Selection(np.full_like(pixels, light), pixels))


# ---------------------------------------------------------------- prediction


@dataclass(frozen=True, eq=False)
class Prediction:
    """The predicted signals and digital numbers of samples at a vector of log parameters, with
    their derivatives."""

    vector: Vector
    signal: OfSamples  # X, DN above black
    dn: OfSamples  # D before clipping
    slope: OfSamples  # d D / d X, where X counts as 1 DN at least
    slopes: Float[np.ndarray, "parameters samples"]  # D_i, DN
    # `curvature` computes the sums over samples of weights times D_ij from these
    of_signal: Float[np.ndarray, "parameters samples"]  # X_i, DN
    bend: OfSamples | None  # X_ss, DN; None without a shape
    encoding: tuple[np.ndarray, ...] | None  # result of `_encoding`; None for linear files
    shape: tuple[int, int] | None  # indices of the lobe's amplitude and shape
    free_gamma: bool

    def curvature(self, weights: OfSamples) -> Matrix:
        """Return the (P, P) sum over samples of weights times D_ij."""
        of_x = weights if self.encoding is None else weights * self.encoding[1]
        first = self.of_signal @ of_x
        found = np.diag(first)
        if self.shape is not None:
            amplitude, shape = self.shape
            found[shape, shape] = self.bend @ of_x
            found[amplitude, shape] = found[shape, amplitude] = first[shape]
        if self.encoding is not None:
            _, _, second, _, mixed, twice = self.encoding
            found += (self.of_signal * (weights * second)) @ self.of_signal.T
            if self.free_gamma:
                found[-1] = found[:, -1] = self.of_signal @ (weights * mixed)
                found[-1, -1] = weights @ twice
        return found


@np.errstate(all="ignore")  # a search rejects non-finite values
def predict(vector: Vector, samples: Samples) -> Prediction:
    """Predict samples at an unconstrained vector."""
    vector = np.asarray(vector, np.float64)
    form, seen = samples.form, [(samples.geometry, 1.0)]
    if samples.points:
        seen = list(zip(samples.points, WEIGHTS, strict=True))
    known = names(parameter_space(form))
    natural = dict(zip(known, np.exp(vector), strict=True))
    of_signal, bend, shape = np.zeros((len(vector), samples.dn.size)), None, None
    if form.model == "lambert" or has_lobe(form.model):
        body = sum(weight * g.irradiance * np.maximum(g.wi.z, 0) for g, weight in seen)
        of_signal[0] = natural["diffuse"] * body
    if form.model != "lambert":
        shape = int(has_lobe(form.model)), known.index(shape_of(form.model).name)
        at = vector[shape[1]]
        lobe = sum(weight * g.irradiance * lobe_with_slopes(form, at, g) for g, weight in seen)
        of_signal[shape[0]], of_signal[shape[1]], bend = np.exp(vector[shape[0]]) * lobe
    if form.ambient:
        of_signal[known.index("ambient")] = natural["ambient"]
    amplitudes = [i for i, name in enumerate(known) if name in ("diffuse", "specular", "ambient")]
    signal = of_signal[amplitudes].sum(axis=0)
    gamma, white = natural["gamma"] if form.free_gamma else samples.gamma, float(samples.white)
    encoding, dn, slopes = None, signal, of_signal
    if gamma is not None:
        gamma = float(gamma)
        encoding = _encoding(signal, white, gamma)
        dn, slopes = encoding[0], of_signal * encoding[1]
        if form.free_gamma:
            slopes[-1] = encoding[3]
    dn = dn + samples.black
    if samples.offset is not None:
        dn = dn + samples.offset[0] + vector @ samples.offset[1:]
        slopes = slopes + samples.offset[1:]
    return Prediction(
        vector=vector,
        signal=signal,
        dn=dn,
        slope=encoding_slope(signal, white, gamma),
        slopes=slopes,
        of_signal=of_signal,
        bend=bend,
        encoding=encoding,
        shape=shape,
        free_gamma=form.free_gamma,
    )


def _encoding(x: OfSamples, white: float, gamma: float) -> tuple[np.ndarray, ...]:
    """Return f(X), f', f'', and the derivatives of f and f' with respect to g = ln gamma, df/dg,
    df'/dg and d2f/dg2; 0 without light.
    """
    lit = x > 0
    x, power = np.where(lit, x, white), 1 / gamma
    log = power * np.log(x / white)
    f = white * np.exp(log)
    first = power * f / x
    mixed = -power * (1 + log) * f / x
    each = f, first, (power - 1) * first / x, -log * f, mixed, log * (1 + log) * f
    return tuple(np.where(lit, values, 0) for values in each)


# ---------------------------------------------------------------- likelihood


def log_likelihood_of_dn(prediction: Prediction, samples: Samples) -> tuple[np.ndarray, ...]:
    """Return (samples,) l(D), its slope in DN^-1 and its curvature in DN^-2."""
    deviation = np.asarray(samples.deviation)
    z = (prediction.dn - samples.dn) / deviation
    value = -z * z / 2 - np.log(deviation) - np.log(2 * np.pi) / 2
    slope, curvature = -z / deviation, -(deviation**-2.0)
    if samples.saturated is not None:
        at = np.flatnonzero(samples.saturated)
        above = (prediction.dn[at] - samples.clip) / deviation[at]
        hazard = np.sqrt(2 / np.pi) / erfcx(-above / np.sqrt(2))  # phi / Phi
        value[at], slope[at] = log_ndtr(above), hazard / deviation[at]
        curvature[at] = -hazard * (above + hazard) / deviation[at] ** 2
    return value, slope, curvature


@np.errstate(all="ignore")
def cost_and_information(prediction: Prediction, samples: Samples) -> tuple[float, Vector, Matrix]:
    """Return the negative log likelihood, its gradient and the observed information."""
    value, slope, curvature = log_likelihood_of_dn(prediction, samples)
    slopes = prediction.slopes
    information = -(slopes * curvature) @ slopes.T - prediction.curvature(slope)
    return -float(value.sum()), -(slopes @ slope), information


def scores_and_slopes(prediction: Prediction, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient of each sample's log likelihood and of its prediction in standard
    deviations, (parameters, samples) each; slopes of saturated samples are 0."""
    _, slope, _ = log_likelihood_of_dn(prediction, samples)
    return prediction.slopes * slope, prediction.slopes * inverse_deviation(samples)


def inverse_deviation(samples: Samples) -> OfSamples:
    """Return 1 / deviation in DN^-1; 0 for saturated samples, whose residuals have no linear
    model.
    """
    weight = 1 / np.asarray(samples.deviation, np.float64)
    return weight if samples.saturated is None else np.where(samples.saturated, 0, weight)


def log_likelihoods(vector: Float[Array, " parameters"], samples: Samples) -> Array:
    """Return the log density of each measured value at an unconstrained vector; for a saturated
    value, the log probability.

    Source:
        Tobin, Econometrica 26, 1958.
    """
    space = parameter_space(samples.form)
    values = dict(zip(names(space), to_natural(space, vector), strict=True))
    gamma = values["gamma"] if samples.form.free_gamma else samples.gamma
    x = signal(values, samples.form, samples.geometry)
    predicted = samples.black + encoded(x, samples.white, gamma)
    if samples.offset is not None:
        predicted = predicted + samples.offset[0] + vector @ samples.offset[1:]
    z = (predicted - samples.dn) / samples.deviation
    gaussian = -z * z / 2 - jnp.log(samples.deviation) - float(np.log(2 * np.pi)) / 2
    if samples.saturated is None:
        return gaussian
    above = jnp.where(samples.saturated, (predicted - samples.clip) / samples.deviation, 0)
    return jnp.where(samples.saturated, tails.log_ndtr(above), gaussian)


def total_log_likelihood(
    vector: Float[Array, " parameters"], data: tuple[Samples, Samples | None]
) -> Array:
    """Return the log likelihood of cells, plus that of the saturated samples, which belong to no
    cell.
    """
    each = [jnp.sum(log_likelihoods(vector, own)) for own in data if own is not None]
    return jnp.sum(jnp.stack(each))


# ---------------------------------------------------------------- cells


@dataclass(frozen=True)
class Grouping:
    """The assignment of samples to cells."""

    cell: Int[np.ndarray, " samples"]  # cell index for each
    count: int  # number of cells


def group(
    light: Int[np.ndarray, " samples"],
    cosine: OfSamples,
    mirror_angle: OfSamples,
    *,
    width: float = 1.0,
) -> Grouping:
    """Group samples by light, n.l and mirror angle (rad), most finely near the mirror direction.
    The widths of the cells are multiplied by the factor `width`."""
    row = np.floor(cosine / (width * COSINE_STEP)).astype(np.int64)
    angle = np.log1p(mirror_angle / FINE_ANGLE) / (width * np.log(ANGLE_RATIO))
    column = np.floor(angle).astype(np.int64)
    row, column = row - row.min(), column - column.min()
    key = (light * (row.max() + 1) + row) * (column.max() + 1) + column
    _, cell = np.unique(key, return_inverse=True)
    return Grouping(cell, int(cell.max()) + 1)


def cells_of(observation: Photographs, selection: Selection, *, width: float = 1.0) -> Grouping:
    """Group a selection's samples to cells, whose widths are multiplied by the factor `width`."""
    at = selection.light, selection.pixel
    return group(at[0], observation.cosine[at], observation.mirror_angle[at], width=width)


def average(samples: Samples, grouping: Grouping, *, exact_at: Prediction | None = None) -> Samples:
    """Average the unsaturated samples of each cell, weighted by their inverse variances.

    If `exact_at`, the prediction of the samples at a vector, is given, the cells predict the mean
    of their pixels exactly at that vector. An empty cell has an enormous standard deviation, so
    that all channels have the same number of cells.
    """
    weight = inverse_deviation(samples) ** 2
    total = np.bincount(grouping.cell, weight, grouping.count)
    filled = total > 0
    whole = np.where(filled, total, 1)

    def mean(values: Any) -> Float[np.ndarray, " cells"]:
        return np.bincount(grouping.cell, weight * values, grouping.count) / whole

    seen = samples.geometry
    wi, wo = seen.wi, seen.wo
    between = wi.x * wo.x + wi.y * wo.y + wi.z * wo.z
    cells = replace(
        samples,
        geometry=directions_from_cosines(*map(mean, (wi.z, wo.z, between, seen.irradiance))),
        dn=mean(samples.dn),
        deviation=np.where(filled, 1 / np.sqrt(whole), UNCERTAIN),
        saturated=None,
        offset=None,
        points=(),
    )
    if exact_at is None:
        return cells
    means = replace(exact_at, dn=mean(exact_at.dn), slopes=np.stack([*map(mean, exact_at.slopes)]))
    return add_offset(cells, means)


def add_offset(samples: Samples, exact: Prediction) -> Samples:
    """Return samples whose prediction is the value at the centre of the pixel plus a correction.
    With this correction, the prediction equals `exact` at the parameter vector of `exact`, and to
    first order near it.
    """
    samples = replace(samples, points=(), offset=None)
    middle = predict(exact.vector, samples)
    slopes = exact.slopes - middle.slopes
    at_zero = exact.dn - middle.dn - exact.vector @ slopes
    return replace(samples, offset=np.vstack([at_zero, slopes]))


def saturated_only(samples: Samples) -> Samples | None:
    """Return the saturated samples alone; None if there are none.

    The number of samples is padded to a power of two, so that channels share a compiled program.
    Padding samples count as unsaturated, with an enormous standard deviation.
    """
    if samples.saturated is None or not bool(np.any(samples.saturated)):
        return None
    chosen = np.flatnonzero(samples.saturated)
    count = max(FEWEST_SATURATED, 1 << (len(chosen) - 1).bit_length())
    real = np.arange(count) < len(chosen)
    at = np.resize(chosen, count)
    return replace(
        samples,
        geometry=jax.tree.map(lambda x: x[at], samples.geometry),
        offset=None if samples.offset is None else samples.offset[:, at],
        dn=samples.dn[at],
        deviation=np.where(real, samples.deviation[at], UNCERTAIN),
        saturated=real,
    )
