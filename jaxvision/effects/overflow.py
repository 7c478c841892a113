"""Bound how far a random charge exceeds a level, by its moment-generating function.

Let N be the random charge, w the level, and (N - w)+ the excess, which is 0 below the level. For
every theta > 0, x <= exp(theta x) / (e theta) and x^2 <= (2 / (e theta))^2 exp(theta x) for all x
>= 0. With x = (N - w)+, the expectations satisfy Chernoff's bounds

    E (N - w)+    <=  E exp(theta (N - w)) / (e theta),
    E (N - w)+^2  <=  E exp(theta (N - w)) (2 / (e theta))^2,

and the smallest value over a grid of theta is used. A charge of mean m has E exp(theta N) = exp(m
u), where u depends on how the electrons are counted:

    u = theta                 no shot noise
    u = exp(theta) - 1        Poisson shot noise
    u = theta + theta^2 / 2   Gaussian shot noise

The mean m varies between pixels: m = light max(1 + p g, 0) + dark + hot, where light and dark are
the expected electrons, p is the PRNU, g is standard normal, and hot, the additional electrons of a
hot pixel, is exponentially distributed.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

_SLOPES = np.geomspace(1e-7, 30.0, 600)  # per electron


class Excess(NamedTuple):
    """Bounds on the mean and the root mean square, in electrons, of the charge above a level."""

    mean: float
    rms: float


@dataclass(frozen=True)
class Charge:
    """The parameters of a random charge, in electrons."""

    light: float  # expected electrons of light
    dark: float  # other expected electrons
    prnu: float  # relative rms of the pixels' sensitivities
    hot: float  # electrons that a hot pixel has more on average; 0: no pixel is hot
    counting: Literal["none", "poisson", "gaussian"]  # "none": a charge is its expectation


def excess(charge: Charge, level: float) -> Excess:
    """Bound the mean and the root mean square of (N - w)+, where N is a random charge and w the
    `level`, in electrons.

    Besides Chernoff's bounds, the variance gives E (N - w)+^2 <= var + (mean - w)+^2. An infinite
    level is never exceeded.
    """
    if math.isinf(level):
        return Excess(0.0, 0.0)
    mean = charge.light + charge.dark + charge.hot
    if not math.isfinite(mean):
        return Excess(math.inf, math.inf)
    variance = (charge.prnu * charge.light) ** 2 + charge.hot**2
    variance += mean if charge.counting != "none" else 0.0
    above = max(mean - level, 0.0)
    if variance == 0:
        return Excess(above, above)
    log_tail = _log_tail(charge, level)
    with np.errstate(over="ignore"):
        first = np.exp(np.min(log_tail - 1 - np.log(_SLOPES)))
        second = np.exp(np.min(log_tail / 2 + np.log(2 / (math.e * _SLOPES))))
    clipped_bias = charge.light * sensitivity_bias(charge.prnu)
    rms = min(math.hypot(math.sqrt(variance), above + clipped_bias), float(second))
    return Excess(min(rms, float(first)), rms)


def _log_tail(charge: Charge, level: float) -> np.ndarray:
    """Compute ln E exp(theta (N - w)) for a charge N and a level w, at each theta of the grid; inf
    where the expectation is not finite."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        match charge.counting:
            case "none":
                u = _SLOPES
            case "poisson":
                u = np.expm1(_SLOPES)
            case "gaussian":
                u = _SLOPES + _SLOPES**2 / 2
        log = u * (charge.light + charge.dark) + (u * charge.light * charge.prnu) ** 2 / 2
        if charge.prnu > 0:  # a sensitivity below 0 is taken as 0
            log = np.logaddexp(
                log, u * charge.dark + math.log(_negative_probability(charge.prnu) + 1e-300)
            )
        if charge.hot > 0:
            room = 1 - u * charge.hot
            log = log - np.log(np.where(room > 0, room, 0))
        tail = log - _SLOPES * level
    return np.where(np.isnan(tail), np.inf, tail)


def _negative_probability(rms: float) -> float:
    """Return the probability P(1 + rms g < 0) for a standard normal g."""
    return math.erfc(1 / rms / math.sqrt(2)) / 2


def sensitivity_bias(prnu: float) -> float:
    """Return E max(1 + p g, 0) - 1 for a PRNU p and a standard normal g: the increase of the mean
    sensitivity of pixels by clipping at 0."""
    if prnu == 0:
        return 0.0
    z = 1 / prnu
    return max(
        prnu * math.exp(-z * z / 2) / math.sqrt(2 * math.pi) - _negative_probability(prnu), 0.0
    )
