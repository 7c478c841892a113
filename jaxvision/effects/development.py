"""The stage of development: the factor by which each step can magnify a change of the raw data.

Bounds are for the raw data, and only steps that are the identity are dropped from a development.
The factor of each step translates a bound to the picture. It is the step's Lipschitz constant in
the maximum norm over pixels: if every number of the input moves by at most d (in mean square, under
one coupling), every number of the output moves by at most the factor times d. Some steps have no
finite factor, and say why.
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
from .stages import Ends, Row, by_field

FILMIC_SLOPE = 1.8012  # the largest slope of the ACES curve, at 0.12
SRGB_SLOPE = 12.92


class Factor(NamedTuple):
    """The factor by which a step magnifies a change."""

    value: float  # the factor, in the unit of the output per unit of the input; inf: there is none
    why: str  # reason for the factor, or for its absence
    identity: bool = False  # whether the step is the identity


def black_level(development: Development) -> Factor:
    """Black level: a shift, with factor 1."""
    return Factor(1.0, "a shift", float(_known(development.black_level)) == 0)


def white_level(development: Development) -> Factor:
    """White level: the factor is 1 / (white - black)."""
    black = 0.0 if development.black_level is None else float(development.black_level)
    span = float(_known(development.white_level)) - black
    return Factor(1 / span, "over the span from black to white", span == 1)


def demosaicing(development: Development) -> Factor:
    """Bilinear and normalised interpolation are means, with factor 1. Malvar's filters have
    absolute sums of at most 20 / 8. Menon's method selects directions, so a small change may select
    another one, and there is no bound.
    """
    how = development.demosaicing
    assert how is not None
    match how.method:
        case "malvar":
            return Factor(2.5, "absolute sums of Malvar's filters")
        case "menon":
            return Factor(INF, "Menon's choice of a direction jumps")
        case _:
            return Factor(1.0, "means of neighbours")


def white_balance(development: Development) -> Factor:
    """The largest gain. If the picture determines the gains, they are ratios of means, whose
    denominators may vanish."""
    match development.white_balance:
        case WhiteBalance(gains=gains):
            gains = np.asarray(gains, float)
            identity = bool(np.all(gains == 1)) and development.saturation is None
            return Factor(float(gains.max()), "the largest gain", identity)
        case _:
            return Factor(INF, "gains are ratios of means of the picture, which may vanish")


def saturation(development: Development) -> Factor:
    """Clipping at a level that the gains determine, with factor 1."""
    return Factor(1.0, "clipping")


def denoising(development: Development) -> Factor:
    """Weights that depend on the picture give a factor that grows with the neighbourhood, so there
    is no bound. Over a neighbourhood of one pixel the filters are the identity."""
    how = development.denoising
    assert isinstance(how, Bilateral | NonLocalMeans)
    alone = how.radius == 0
    if alone:
        return Factor(1.0, "a neighbourhood of one pixel", True)
    return Factor(INF, "weights depend on the picture: not bounded")


def colour_matrix(development: Development) -> Factor:
    """The factor is the largest sum of absolute values of a row."""
    matrix = np.asarray(_known(development.colour_matrix), float)
    identity = np.array_equal(matrix, np.eye(3))
    return Factor(float(np.abs(matrix).sum(1).max()), "row sums of the matrix", identity)


def tone_map(development: Development) -> Factor:
    """The largest slope. Reinhard's goes monotonically from 1 to 1 / white^2. A monotone spline is
    nowhere steeper than three times its steepest chord (Fritsch and Carlson, "Monotone Piecewise
    Cubic Interpolation", SIAM J. Numer. Anal. 17 (1980))."""
    match development.tone_map:
        case Reinhard(white=None):
            return Factor(1.0, "largest slope, at 0")
        case Reinhard(white=white):
            return Factor(max(1.0, float(_known(white)) ** -2), "largest slope, at 0 or infinity")
        case Filmic():
            return Factor(FILMIC_SLOPE, "largest slope, at 0.12")
        case ToneCurve(inputs=inputs, outputs=outputs):
            chords = np.diff(np.asarray(outputs, float)) / np.diff(np.asarray(inputs, float))
            return Factor(3 * float(np.abs(chords).max()), "three times the steepest chord")
        case other:
            raise AssertionError(other)


def tone(development: Development) -> Factor:
    """The factor of sRGB: its slope at 0. Its rounded constants cause a step of 3e-8 at
    0.0031308, which is ignored. A power below 1 has an infinite slope at 0, and one above 1 at
    large values."""
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
    """The factor of f + a (f - g * f), where g has sum 1, is 1 + 2 |a|."""
    how = development.sharpening
    assert how is not None
    amount = abs(float(how.amount))
    return Factor(1 + 2 * amount, "absolute sum of the kernel", amount == 0)


def compression(development: Development) -> Factor:
    """JPEG: rounding of coefficients is discontinuous, so there is no bound."""
    return Factor(INF, "JPEG rounds its coefficients: they jump")


BOUNDS: dict[str, Callable[[Development], Factor]] = by_field(Development, globals())


def lipschitz(development: Development | None) -> Factor:
    """Return an upper bound on the factor by which a development magnifies a change of the raw
    data.

    Args:
        development: the steps; None for no step.

    Returns:
        The product of the Lipschitz constants of its steps, picture per DN; or inf with the names
        of the steps that have none.

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
    """A row for each step of a development, with bounds in DN of the raw data. Only steps that are
    the identity can be dropped."""
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


def _known(value: Any) -> Any:
    assert value is not None
    return value
