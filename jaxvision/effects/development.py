"""Bound the factor by which each step of a development can magnify a change of the raw data.

Tolerances in DN refer to the raw data. A step of the development is dropped only if it changes
nothing. The product of the factors converts a bound on the raw data to a bound on the developed
picture. The factor of a step is its Lipschitz constant in the maximum norm over pixels: if every
input number changes by at most d, every output number changes by at most the factor times d. For
random images, d is the root mean square change in some coupling of the two images. A step without a
finite factor gives the reason.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..scene import (
    SRGB,
    Bilateral,
    Development,
    Filmic,
    Gamma,
    NonLocalMeans,
    Reinhard,
    ToneCurve,
    WhiteBalance,
)
from .boxes import refuse_tracers, setting
from .certificate import DN
from .pixel import INF
from .stages import Ends, Row, field_functions

FILMIC_SLOPE = 1.8012  # the largest slope of the ACES curve, at 0.12
SRGB_SLOPE = 12.92


class Factor(NamedTuple):
    """The largest factor by which a development step magnifies a change of its input."""

    value: float  # the factor, in the unit of the output per unit of the input; inf: there is none
    why: str  # reason for the factor, or for its absence
    identity: bool = False  # whether the step is the identity


def black_level(development: Development) -> Factor:
    """Return the factor of black-level subtraction, which is 1 because it is a shift."""
    return Factor(1.0, "a shift", float(_require(development.black_level)) == 0)


def white_level(development: Development) -> Factor:
    """Return the factor of scaling to the white level, 1 / (white - black)."""
    black = 0.0 if development.black_level is None else float(development.black_level)
    span = float(_require(development.white_level)) - black
    return Factor(1 / span, "over the span from black to white", span == 1)


def demosaicing(development: Development) -> Factor:
    """Return the factor of demosaicing. Bilinear and normalised interpolation are means, with
    factor 1. In Malvar's filters, absolute weights sum to at most 20 / 8. Menon's method selects
    directions, so that a small change may select another direction: there is no bound.
    """
    how = development.demosaicing
    assert how is not None
    match how.method:
        case "malvar":
            return Factor(2.5, "absolute sums of Malvar's filters")
        case "menon":
            return Factor(INF, "Menon's choice of a direction is discontinuous")
        case _:
            return Factor(1.0, "means of neighbours")


def white_balance(development: Development) -> Factor:
    """Return the largest white-balance gain. There is no bound for gains that are computed from the
    picture, because such gains are ratios of means, which may be 0."""
    match development.white_balance:
        case WhiteBalance(gains=gains):
            gains = np.asarray(gains, float)
            identity = bool(np.all(gains == 1)) and development.saturation is None
            return Factor(float(gains.max()), "the largest gain", identity)
        case _:
            return Factor(INF, "gains are ratios of means of the picture, which may vanish")


def saturation(development: Development) -> Factor:
    """Return the factor of clipping, 1. The clipping level follows from the white-balance gains."""
    return Factor(1.0, "clipping")


def denoising(development: Development) -> Factor:
    """Return the factor of denoising. There is no bound, because the weights depend on the picture.
    In a neighbourhood of a single pixel, the filters change nothing."""
    how = development.denoising
    assert isinstance(how, Bilateral | NonLocalMeans)
    alone = how.radius == 0
    if alone:
        return Factor(1.0, "a neighbourhood of one pixel", True)
    return Factor(INF, "weights depend on the picture: not bounded")


def colour_matrix(development: Development) -> Factor:
    """Return the factor of a colour matrix: the largest sum of the absolute values in a row."""
    matrix = np.asarray(_require(development.colour_matrix), float)
    identity = np.array_equal(matrix, np.eye(3))
    return Factor(float(np.abs(matrix).sum(1).max()), "row sums of the matrix", identity)


def tone_map(development: Development) -> Factor:
    """Return the largest slope of the tone curve. The slope of Reinhard's curve goes
    monotonically from 1 to 1 / white^2. A monotone spline is nowhere steeper than three times
    its steepest chord (Fritsch and Carlson, "Monotone Piecewise Cubic Interpolation", SIAM J.
    Numer. Anal. 17 (1980))."""
    match development.tone_map:
        case Reinhard(white=None):
            return Factor(1.0, "largest slope, at 0")
        case Reinhard(white=white):
            return Factor(max(1.0, float(_require(white)) ** -2), "largest slope, at 0 or infinity")
        case Filmic():
            return Factor(FILMIC_SLOPE, "largest slope, at 0.12")
        case ToneCurve(inputs=inputs, outputs=outputs):
            chords = np.diff(np.asarray(outputs, float)) / np.diff(np.asarray(inputs, float))
            return Factor(3 * float(np.abs(chords).max()), "three times the steepest chord")
        case other:
            raise AssertionError(other)


def tone(development: Development) -> Factor:
    """Return the largest slope of an encoding curve. The slope of the sRGB curve is largest at 0.
    The rounded constants of sRGB cause a step of 3e-8 at 0.0031308, which is ignored. A power
    function has an infinite slope at 0 if its exponent is below 1, and a growing slope at large
    values if it is above 1."""
    match development.tone:
        case SRGB():
            return Factor(SRGB_SLOPE, "slope of sRGB at 0")
        case Gamma(gamma=gamma) if float(gamma) == 1:
            return Factor(1.0, "clipping at 0")
        case Gamma(gamma=gamma) if float(gamma) > 1:
            return Factor(INF, "the slope of a gamma curve is infinite at 0")
        case _:
            return Factor(INF, "the slope of a power above 1 grows without end")


def sharpening(development: Development) -> Factor:
    """Return the factor 1 + 2 |a| for a picture f + a (f - g * f), with a blur g of sum 1."""
    how = development.sharpening
    assert how is not None
    amount = abs(float(how.amount))
    return Factor(1 + 2 * amount, "absolute sum of the kernel", amount == 0)


def compression(development: Development) -> Factor:
    """Return no factor: the rounding of JPEG's coefficients is discontinuous."""
    return Factor(INF, "JPEG rounds its coefficients, which is discontinuous")


BOUNDS: dict[str, Callable[[Development], Factor]] = field_functions(Development, globals())


def lipschitz(development: Development | None) -> Factor:
    """Return an upper bound on the factor by which a development magnifies a change of the raw
    data.

    Args:
        development: the steps; None for no step.

    Returns:
        The product of the Lipschitz constants of the steps, picture per DN; or inf, with the names
            of the steps that have no finite constant.

    Raises:
        ValueError: for a development with traced numbers.

    Example:
        >>> import jaxvision as jv
        >>> from jaxvision.effects import lipschitz
        >>> steps = jv.Development(white_level=255.0, tone=jv.SRGB())
        >>> round(lipschitz(steps).value * 255, 4)
        12.92
    """
    refuse_tracers(development)
    if development is None:
        return Factor(1.0, "no development", True)
    factors = {
        name: bound(development)
        for name, bound in BOUNDS.items()
        if getattr(development, name) is not None
    }
    unbounded = [factor.why for factor in factors.values() if math.isinf(factor.value)]
    if unbounded:
        return Factor(INF, "; ".join(unbounded))
    value = math.prod(factor.value for factor in factors.values())
    return Factor(value, "product over its steps", all(f.identity for f in factors.values()))


def development_stage(development: Ends[Development | None]) -> tuple[Row, ...]:
    """Return a `Row` for each step, in DN; only steps that change nothing can be dropped."""
    low, high = development
    if low is None or high is None:
        return ()
    return tuple(
        _row(name, bound(low), bound(high))
        for name, bound in BOUNDS.items()
        if getattr(high, name) is not None
    )


def _row(name: str, low: Factor, high: Factor) -> Row:
    factor = low if low.value > high.value else high
    name, nothing = f"development.{name}", np.zeros(())
    if low.identity and high.identity:
        return Row(name, nothing, "changes no number", setting(f"camera.{name}"), unit=DN)
    magnifies = f"magnifies changes {factor.value:.4g} times: {factor.why}"
    why = factor.why if factor.value == INF else magnifies
    return Row(name, nothing + INF, why, None, unit=DN)


def _require(value: Any) -> Any:
    assert value is not None
    return value
