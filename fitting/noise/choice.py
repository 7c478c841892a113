"""The choice of the effects that a camera needs.

The first model is a linear camera with pixel noise and the detected noise of rows, columns or
frames of the darks. Further effects are tried if it misses the measurement (p < 0.1 %), or if
nearest neighbours covary, which means and variances need not show. The effects that the darks alone
show (a drifting black level, or excess scatter of the variances) are added. The candidates are
random errors of the light, a compression of one or two terms, an offset of the light, and a drift
of the black level from level to level. A candidate is kept if its squared Wald ratio exceeds the
logarithm of the number of observations (Schwarz' criterion, BIC) and if such a ratio occurs by
chance in fewer than one of a hundred cameras.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from scipy.special import chdtri, stdtrit

from ..inference.parameters import Parameter, ParameterSpace, names
from .drifting import Drifting
from .emva1288 import Ranges, Sheet
from .fit import LikelihoodFit, base_space, fitted, gain_drop, observations
from .levels import PhotonTransfer
from .misfit import MISFIT, p_value
from .model import NoiseData
from .neighbours import are_known
from .quantities import (
    BLACK_SCATTER,
    BRIGHTER_FATTER,
    COMPRESSION,
    COMPRESSION_2,
    LIGHT_OFFSET,
    LIGHT_SCATTER,
    PIXEL_MIXING,
    SHUTTER_OFFSET,
    VARIANCE_SCATTER,
)
from .regressions import line_misfit
from .sampling import sampling_errors
from .shared import drift, shared_noise

SPURIOUS = 0.01  # chance of a term that a camera does not have
SPURIOUS_SHARING = 0.001  # the same of neighbours that share charges, which leads the gain astray
SPURIOUS_BESIDE = 0.05  # the same where nearest neighbours covary significantly
SHARING = (BRIGHTER_FATTER, PIXEL_MIXING)
CURVE = (COMPRESSION, COMPRESSION_2, LIGHT_OFFSET, SHUTTER_OFFSET)


def dark_scatter(measurement: PhotonTransfer) -> ParameterSpace:
    """The random effects in the darks about their own lines over exposure, beyond noise of pixels,
    rows, columns and frames.
    """
    dark = measurement.dark
    errors = sampling_errors(
        dark,
        jnp.zeros_like(dark.mean),
        jnp.ones_like(dark.pixels),
        shared=shared_noise(dark.shared, dark.variance, dark.frames),
    )
    found = []
    for effect, values, variances in (
        (BLACK_SCATTER, dark.mean, errors.mean),
        (VARIANCE_SCATTER, dark.variance, errors.variance),
    ):
        chi_square, degrees = line_misfit(dark.exposure, values, variances)
        if p_value(float(chi_square), float(degrees)) < MISFIT:
            found.append(effect)
    return tuple(found)


def choose_model(
    measurement: PhotonTransfer,
    within: Ranges,
    data: NoiseData,
    standard: Sheet,
    *,
    trend: Drifting | None = None,
    sharing: bool = False,
) -> tuple[LikelihoodFit, LikelihoodFit]:
    """Choose the model for a camera."""
    linear = fitted(base_space(measurement, within, offsets=data.offsets), data, standard)
    if linear.p_value >= MISFIT and not sharing:
        return linear, linear
    bright_levels = int(jnp.sum(data.lit))
    offset = LIGHT_OFFSET if measurement.photons_known else SHUTTER_OFFSET
    candidates = (LIGHT_SCATTER, COMPRESSION, offset, COMPRESSION_2)[: bright_levels - 3]
    candidates += (BRIGHTER_FATTER,)
    candidates += (PIXEL_MIXING,) if are_known(data.neighbours) else ()
    of_darks = dark_scatter(measurement)
    if BLACK_SCATTER not in of_darks and _drifts(measurement):
        candidates += (BLACK_SCATTER,)
    always = linear.space + of_darks
    whole = always + candidates
    reduced = partial(_reduced, whole=whole, standard=standard, sharing=sharing)
    chosen = reduced(fitted(whole, data, standard, among=whole), candidates=candidates)
    drifts = _may_be_drift(chosen, trend)
    if drifts or (chosen.p_value < MISFIT and any(p in chosen.space for p in CURVE)):
        # Light that drifts from level to level looks like a curve, to which a search can lead
        # although the variances contradict it.
        straight = tuple(p for p in candidates if p not in CURVE)
        other = fitted(always + straight, data, standard, among=whole)
        other = reduced(other, candidates=straight)
        described = drifts and other.p_value >= MISFIT
        chosen = other if described else min(chosen, other, key=lambda fit: fit.bic)
    shares = any(p in chosen.space for p in SHARING)
    return (linear, chosen) if shares or chosen.bic < linear.bic else (linear, linear)


def _reduced(
    fit: LikelihoodFit,
    candidates: tuple[Parameter, ...],
    *,
    whole: ParameterSpace,
    standard: Sheet,
    sharing: bool,
) -> LikelihoodFit:
    """The fit without the candidates that fail the criterion, with the weakest dropped first."""
    while unearned := _unearned(fit, candidates, sharing):
        space = tuple(p for p in fit.space if p is not unearned)
        fit = fitted(space, fit.data, standard, among=whole, near=fit)
    return fit


def _may_be_drift(fit: LikelihoodFit, trend: Drifting | None) -> bool:
    """Whether drift of the light between flats, at the rate seen within levels, could explain the
    curvature."""
    if trend is None or not any(p in fit.space for p in CURVE):
        return False
    # Means depart by half of what the slope does, and darks in between take as long again.
    return bool(abs(float(gain_drop(fit.values, fit.data))) <= 4 * abs(trend.total))


def _drifts(measurement: PhotonTransfer) -> bool:
    dark = measurement.dark
    if dark.shared is None:
        return False
    return drift(dark.shared, np.asarray(dark.variance), np.asarray(dark.frames)).believed


def _unearned(
    fit: LikelihoodFit, candidates: tuple[Parameter, ...], sharing: bool
) -> Parameter | None:
    """The weakest candidate that fails the criterion; the second term of the compression before the
    first."""
    ratios = {}
    labels = names(fit.space)
    vector, information = np.asarray(fit.solution.vector), np.asarray(fit.solution.information)
    for parameter in candidates:
        if parameter not in fit.space or (parameter is COMPRESSION and COMPRESSION_2 in fit.space):
            continue
        i = labels.index(parameter.name)
        own = np.delete(np.delete(information, i, 0), i, 1)
        across = np.delete(information[i], i)
        precision = information[i, i] - across @ np.linalg.lstsq(own, across, rcond=None)[0]
        # The ratio of a positive scale to its error is one over the error of its logarithm.
        size = float(vector[i]) if parameter.transform == "identity" else 1.0
        if parameter is BRIGHTER_FATTER:  # charges repel each other
            size = max(size, 0.0)
        ratios[parameter] = size**2 * max(precision, 0.0) / _price(fit, parameter, sharing)
    weakest = min(ratios, key=ratios.__getitem__, default=None)
    return weakest if weakest is not None and ratios[weakest] < 1 else None


def _price(fit: LikelihoodFit, parameter: Parameter, sharing: bool) -> float:
    """The squared Wald ratio that a parameter needs: Schwarz' value, or more if chance exceeds that
    once in a hundred cameras, because errors do not include the choice. Mixing or repulsion of
    neighbours changes the gain by as many standard errors. It needs the ratio of one in a thousand
    cameras, or one in twenty if nearest neighbours significantly covary and one of the two forms is
    present. The scatter of m lights about a curve of q terms is underestimated by (m - q) / m and
    uncertain, so a term of the curve must then pass Fisher's F test."""
    price = float(np.log(observations(fit.data)))
    if parameter.transform == "log":
        return price
    if parameter in SHARING:
        chance = SPURIOUS_BESIDE if sharing else SPURIOUS_SHARING
        return float(chdtri(1, chance)) if sharing else max(price, float(chdtri(1, chance)))
    if LIGHT_SCATTER not in fit.space or parameter not in CURVE:
        return max(price, float(chdtri(1, SPURIOUS)))
    lights = int(jnp.sum(fit.data.lit))
    terms = 1 + sum(p in fit.space for p in CURVE)
    free = max(lights - terms, 1)
    return max(price, float(stdtrit(free, SPURIOUS / 2) ** 2) * lights / free)
