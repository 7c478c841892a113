"""Photographs as a fit predicts them, and their likelihood, with derivatives by its parameters.

A model is a program only in its lobe, whose values and slopes JAX computes (`signal`). All else
follows by the chain rule in NumPy. Neither pixels nor channels nor terms then have programs of
their own. With X the signal, D its digital number and ln L = sum l(D),

    d ln L / d_i = sum l' D_i,    d2 ln L / d_i d_j = sum l'' D_i D_j + l' D_ij,
    D_i = f' X_i,                 D_ij = f'' X_i X_j + f' X_ij.

All parameters are logarithms. For an amplitude a and a shape s, X_aa = X_a and X_as = X_s if the
lobe is a's, 0 otherwise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import erfcx, log_ndtr

from ...inference.parameters import names
from ..models import has_lobe, shape_of
from .model import Samples, parameter_space
from .signal import encoding_slope, lobe_with_slopes

Vector = Float[np.ndarray, " parameters"]
Derivatives = tuple[float, Vector, Float[np.ndarray, "parameters parameters"]]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Samples as predicted at an unconstrained vector."""

    vector: Vector
    signal: Float[np.ndarray, " samples"]  # X, DN above black
    dn: Float[np.ndarray, " samples"]  # D before clipping
    slope: Float[np.ndarray, " samples"]  # d D / d X, where X counts as 1 DN at least
    slopes: Float[np.ndarray, "parameters samples"]  # D_i, DN
    # the sums over samples of weights times D_ij follow from these
    of_signal: Float[np.ndarray, "parameters samples"]  # X_i, DN
    bend: Float[np.ndarray, " samples"] | None  # X_ss, DN; None without a shape
    encoding: tuple[np.ndarray, ...] | None  # of `_encoding`; None for linear files
    shape: tuple[int, int] | None  # places of the lobe's amplitude and of its shape
    free_gamma: bool

    def curvature(self, weights: Float[np.ndarray, " samples"]) -> np.ndarray:
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


@np.errstate(all="ignore")  # a search refuses what is not finite
def predict(vector: Vector, samples: Samples) -> Prediction:
    """Predict samples at an unconstrained vector."""
    vector = np.asarray(vector, np.float64)
    form, geometry = samples.form, samples.geometry
    known = names(parameter_space(form))
    natural = dict(zip(known, np.exp(vector), strict=True))
    light, cosine = np.asarray(geometry.irradiance), np.asarray(geometry.wi.z)
    of_signal, bend, shape = np.zeros((len(vector), cosine.size)), None, None
    if form.model == "lambert" or has_lobe(form.model):
        of_signal[0] = natural["diffuse"] * light * np.maximum(cosine, 0)
    if form.model != "lambert":
        shape = int(has_lobe(form.model)), known.index(shape_of(form.model).name)
        unit = lobe_with_slopes(form, vector[shape[1]], geometry)
        of_signal[shape[0]], of_signal[shape[1]], bend = np.exp(vector[shape[0]]) * light * unit
    if form.ambient:
        of_signal[known.index("ambient")] = natural["ambient"]
    amplitudes = [i for i, name in enumerate(known) if name in ("diffuse", "specular", "ambient")]
    signal = of_signal[amplitudes].sum(axis=0)
    gamma = natural["gamma"] if form.free_gamma else samples.gamma
    encoding, dn, slopes = None, signal, of_signal
    if gamma is not None:
        encoding = _encoding(signal, float(samples.white), float(gamma))
        dn, slopes = encoding[0], of_signal * encoding[1]
        if form.free_gamma:
            slopes[-1] = encoding[3]
    dn = dn + samples.black
    return Prediction(
        vector=vector,
        signal=signal,
        dn=dn if samples.offset is None else dn + samples.offset,
        slope=encoding_slope(signal, float(samples.white), None if gamma is None else float(gamma)),
        slopes=slopes,
        of_signal=of_signal,
        bend=bend,
        encoding=encoding,
        shape=shape,
        free_gamma=form.free_gamma,
    )


def _encoding(x: np.ndarray, white: float, gamma: float) -> tuple[np.ndarray, ...]:
    """f(X), f', f'', and by g = ln gamma df/dg, df'/dg and d2f/dg2; 0 without light."""
    lit = x > 0
    x, power = np.where(lit, x, white), 1 / gamma
    log = power * np.log(x / white)
    f = white * np.exp(log)
    first = power * f / x
    mixed = -power * (1 + log) * f / x
    each = f, first, (power - 1) * first / x, -log * f, mixed, log * (1 + log) * f
    return tuple(np.where(lit, values, 0) for values in each)


def log_likelihood_of_dn(
    prediction: Prediction, samples: Samples
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
def cost_and_information(prediction: Prediction, samples: Samples) -> Derivatives:
    """Return the negative log likelihood, its gradient and the observed information."""
    value, slope, curvature = log_likelihood_of_dn(prediction, samples)
    slopes = prediction.slopes
    information = -(slopes * curvature) @ slopes.T - prediction.curvature(slope)
    return -float(value.sum()), -(slopes @ slope), information


def scores_and_slopes(
    prediction: Prediction, samples: Samples
) -> tuple[Float[np.ndarray, "parameters samples"], Float[np.ndarray, "parameters samples"]]:
    """Return the gradient of each sample's log likelihood and of its prediction in standard
    deviations, (parameters, samples) each; slopes of saturated samples are 0."""
    _, slope, _ = log_likelihood_of_dn(prediction, samples)
    weight = 1 / np.asarray(samples.deviation)
    if samples.saturated is not None:
        weight = np.where(samples.saturated, 0, weight)
    return prediction.slopes * slope, prediction.slopes * weight


def residuals(prediction: Prediction, samples: Samples) -> Float[np.ndarray, " samples"]:
    """Return (predicted - measured) / deviation of each sample, 0 for saturated pixels."""
    z = (prediction.dn - samples.dn) / np.asarray(samples.deviation)
    return z if samples.saturated is None else np.where(samples.saturated, 0, z)
