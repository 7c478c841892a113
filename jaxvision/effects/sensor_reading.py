"""Bound the change if an effect of the read-out is dropped: fixed patterns, noise, amplifiers and
the ADC.

The argument of each function is the sensor without the effects that were dropped before. Each
function returns a bound, in DN, on the distance of distributions defined in `pixel`. Noise of
variance v in every pixel has its largest effect in the darkest pixel. With K the gain, q the column
PRNU, and V the variance of that pixel's other noise, the effect is

    K sqrt(1 + q^2) (sqrt(V + v) - sqrt(V)).
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from ..scene import HeavyTailedReadNoise, Sensor
from ..sensor import QUANTISATION_VARIANCE
from .electrons import read_out_variances
from .overflow import excess
from .pixel import INF, Bound, Pixel, growth, unbounded
from .stages import field_functions

# Standard deviations within which a Gaussian gain is assumed; the tails are bounded separately.
_TAIL = 9.0
_TAIL_ODDS = 2.3e-19  # P(|g| > 9)


def conversion_prnu(pixel: Pixel) -> Bound:
    """Bound the effect of a conversion PRNU c by sqrt(V + m + c^2 (m + m^2)) - sqrt(V + m), where m
    is the largest mean charge and V is the variance of the read-out noise."""
    rms, charge = pixel.high("conversion_prnu"), pixel.read_bright
    if not math.isfinite(charge):
        return Bound(INF, "the light is not bounded")
    counted = pixel.surely_counted
    variance = charge * pixel.largest_growth if pixel.counted else 0.0
    variance += (pixel.high("prnu") * pixel.light * pixel.largest_growth) ** 2
    grown = growth(pixel.added_variance() + counted, rms**2 * (variance + charge**2))
    return Bound(pixel.gain_after_conversion * grown, f"{rms:.3g} of {charge:.4g} e-")


def column_prnu(pixel: Pixel) -> Bound:
    """Bound the effect of a column PRNU q by sqrt(v + q^2 (v + m^2)) - sqrt(v), where m is the
    largest mean charge of a pixel and v is the variance of all noise of that pixel."""
    rms, charge = pixel.high("column_prnu"), pixel.read_bright
    if not math.isfinite(charge):
        return Bound(INF, "the light is not bounded")
    counted = pixel.surely_counted
    conversion = pixel.high("conversion_prnu") ** 2
    own = charge * pixel.largest_growth if pixel.counted else 0.0
    own += (pixel.high("prnu") * pixel.light * pixel.largest_growth) ** 2
    own = own * (1 + conversion) + conversion * charge**2 + sum(pixel.variances.high.values())
    own += _trap(pixel)
    grown = growth(pixel.added_variance() + counted, rms**2 * (own + charge**2))
    return Bound(pixel.gain * grown, f"{rms:.3g} of {charge:.4g} e-")


def every_pixel(name: str, pixel: Pixel) -> Bound:
    """Bound a noise or pattern of zero mean in all pixels, independent of all others."""
    variance = pixel.variances.high[name]
    conversion = pixel.low("conversion_prnu")
    rest = (1 + conversion**2) * pixel.counted_dark + pixel.added_variance(name)
    moved = pixel.gain_after_conversion * growth(rest, variance)
    return Bound(moved, f"{math.sqrt(variance):.3g} e- rms")


def telegraph_noise(pixel: Pixel) -> Bound:
    """Bound telegraph noise, +a or -a in half of the frames of a trap: variance a^2 / 2."""
    rare = float(pixel.sensor.high["telegraph_noise"].fraction) * math.prod(pixel.shape)
    trapped = _trap(pixel)
    rest = (1 + pixel.low("conversion_prnu") ** 2) * pixel.counted_dark + pixel.added_variance()
    moved = pixel.gain_after_conversion * growth(rest, trapped)
    why = f"{rare:.3g} pixels have a trap; the bound is for these"
    return Bound(moved, why, rare=rare)


gain = unbounded("says what a DN is: nothing can be left out")


def offset(pixel: Pixel) -> Bound:
    """Bound the effect of the offset by its value, because the offset is added to every reading."""
    ends = (pixel.sensor.low["offset"], pixel.sensor.high["offset"])
    return Bound(max(abs(float(x)) for x in ends), "moves all numbers alike")


def taps(pixel: Pixel) -> Bound:
    """Bound the effect of read-out taps. Offsets change the mean of a tap. Factors change the gain,
    read noise, fixed pattern and light of a tap. Each change is proportional to the difference of
    the factor from 1."""
    named = ("offset", "gain", "read_noise", "prnu", "quantum_efficiency")
    offset, gain, read, pattern, light = (pixel.tap_change(name) for name in named)
    plain = pixel.sensor.high["untapped"]
    share = (1.0 if plain["gain"] is None else float(plain["gain"])) / pixel.gain
    added = sum(pixel.variances.high.values()) + _trap(pixel)
    size = math.hypot(
        pixel.gain_of_charge * pixel.rms, pixel.gain_after_conversion * math.sqrt(added)
    )
    noise = math.sqrt(read_out_variances(plain).get("read_noise", 0.0))
    rms = 0.0 if plain["prnu"] is None else float(plain["prnu"])
    moved = gain * size + pixel.gain_after_conversion * read * noise
    moved += pixel.gain_of_charge * pattern * rms * pixel.light
    why = f"{offset:.3g} DN; gain, read noise, pattern by {gain:.3g}, {read:.3g}, {pattern:.3g}"
    of_light = 0.0
    if light:
        brightest = max(float(np.max(end["taps"].quantum_efficiency)) for end in pixel.sensor)
        of_light = pixel.distribution_change(
            light * pixel.light / min(brightest, 1.0), patterned=True
        )
        why += f", light by {light:.3g}"
    return Bound(offset + share * moved + of_light, why)


def bits(pixel: Pixel) -> Bound:
    """Bound the effect of the ADC: rounding changes a number by at most 1/2 DN, and clipping
    changes it by the part outside the range.

    With Gaussian noise of variance V in DN^2, at least 1/4, rounding changes the mean by at most
    exp(-2 pi^2 V) / pi, and adds a variance of at most 1/12 + (4 V + 1/pi^2) exp(-2 pi^2 V) (Widrow
    and Kollar, "Quantization Noise", 2008, chapter 5, first terms with their remainders doubled).
    """
    rounding = 0.5
    smooth = pixel.gain_low**2 * _gaussian(pixel)
    if smooth >= 0.25:
        ripple = math.exp(-2 * math.pi**2 * smooth)
        noise = growth(smooth, QUANTISATION_VARIANCE + 2 * (4 * smooth + math.pi**-2) * ripple)
        rounding = min(rounding, math.hypot(noise, 2 * ripple / math.pi))
    clipped = _clipped_rms(pixel)
    why = f"rounds by {rounding:.2g} DN, clips {clipped:.2g} DN"
    return Bound(rounding + clipped, why, rank=pixel.rank_of_counts)


def _trap(pixel: Pixel) -> float:
    """Return the variance of the telegraph noise of a pixel with a trap, in electrons^2."""
    trap = pixel.sensor.high["telegraph_noise"]
    return 0.0 if trap is None else float(trap.amplitude) ** 2 / 2


def _gaussian(pixel: Pixel) -> float:
    """Return the smallest variance of the Gaussian noise of every pixel, in electrons^2."""
    variances = dict(pixel.variances.low)
    variances.pop("banding", None)
    read = pixel.sensor.low["read_noise"]
    if isinstance(read, HeavyTailedReadNoise):
        variances["read_noise"] = min(float(read.rms), float(read.tail_rms)) ** 2
    return sum(variances.values())


def _widest(pixel: Pixel) -> float:
    """Return the variance of a Gaussian whose moment-generating function bounds the
    moment-generating function of all noise after the conversion, in electrons^2. A mixture counts
    with the variance of its wider part, and noise between -a and +a with a^2."""
    variances = dict(pixel.variances.high)
    read = pixel.sensor.high["read_noise"]
    if isinstance(read, HeavyTailedReadNoise):
        variances["read_noise"] = max(float(read.rms), float(read.tail_rms)) ** 2
    trap = pixel.sensor.high["telegraph_noise"]
    return sum(variances.values()) + (0.0 if trap is None else float(trap.amplitude) ** 2)


def _clipped_rms(pixel: Pixel) -> float:
    """Bound the root mean square of the part of a reading that the ADC clips, below 0 or above the
    largest number, in DN.

    The gains of columns and pixels are random. Gains within 9 standard deviations of the mean are
    replaced by the largest such gain. For larger gains, the clipped part is bounded by its second
    moment.
    """
    conversion, column = pixel.high("conversion_prnu"), pixel.high("column_prnu")
    if max(conversion, column) * _TAIL >= 1 or not math.isfinite(pixel.bright):
        return INF
    widest = (1 + _TAIL * conversion) * (1 + _TAIL * column) * pixel.largest_growth
    noise = pixel.gain * (1 + _TAIL * column) * math.sqrt(_widest(pixel))
    offsets = _offsets(pixel)
    top = 2 ** float(pixel.sensor.low["bits"]) - 1
    low = _gaussian_excess(noise, min(offsets))
    if pixel.charge.counting == "gaussian":
        low = _negative_rms(pixel, min(offsets))
    low += pixel.gain * (1 + _TAIL * conversion) * (1 + _TAIL * column) * _negative(pixel)
    spare = (top - max(offsets)) / (pixel.gain * widest)
    high = _excess_rms(pixel, spare, noise / (pixel.gain * widest)) * pixel.gain * widest
    second = (pixel.bright + pixel.bright**2) * pixel.largest_growth**2 + _widest(pixel)
    beyond = pixel.gain * math.sqrt(second * 2 * _TAIL_ODDS * 4 * _TAIL**2)
    return math.hypot(low, high) + (beyond if max(conversion, column) > 0 else 0.0)


def _offsets(pixel: Pixel) -> list[float]:
    """Return the smallest and the largest offset of any pixel, in DN."""
    found = []
    for end, extreme in zip(pixel.sensor, (np.min, np.max), strict=True):
        tap_map = getattr(end["taps"], "offset", None)
        own = 0.0 if end["offset"] is None else float(end["offset"])
        found.append(own + (0.0 if tap_map is None else float(extreme(tap_map))))
    return found


def _negative(pixel: Pixel) -> float:
    """Return the root mean square of charges below 0, in electrons. Charges below 0 come from a
    light offset that removes light from a dark pixel, and from negative entries of a mixing kernel.
    """
    mixing = [end["mixing"] for end in pixel.sensor]
    below = [float(-np.minimum(np.asarray(m.kernel), 0).sum()) for m in mixing if m is not None]
    return pixel.largest_growth * (pixel.deficit + max(below, default=0.0) * pixel.rms)


def _excess_rms(pixel: Pixel, level: float, noise: float) -> float:
    """Bound the root mean square of the sum of charge N and Gaussian noise G above a level w, in
    electrons.

    The excess (N + G - w)+ is at most (N - s w)+ + (G - (1 - s) w)+ for any s from 0 to 1. The
    smallest bound over several values of s is used. The first term is 0 if the full well is below s
    w.
    """
    if level <= 0:
        return INF
    well = pixel.sensor.high["full_well"]

    def rms_for_share(share: float) -> float:
        cut = well is not None and float(well) <= share * level
        counted = 0.0 if cut else excess(pixel.charge, share * level).rms
        return counted + _gaussian_excess(noise, (1 - share) * level)

    return (
        min(rms_for_share(share) for share in np.linspace(0.02, 0.99, 40))
        if noise > 0
        else rms_for_share(1.0)
    )


def _negative_rms(pixel: Pixel, offset: float) -> float:
    """Bound the root mean square of readings below 0 DN for Gaussian counts N, whose variance
    equals their mean M. With v the variance of the read-out noise G, and o the offset, in
    electrons,

        E (-(N + G) - o)+^2  <=  u / 2 exp(-(M + o)^2 / (2 u)),   u = v + a M,

    where a is the largest gain of a pixel. As M grows, the bound rises up to u = a^2 + sqrt(a^4 +
    (a o - v)^2) and then falls. If this u lies outside the range of u between M = 0 and the
    brightest M, the bound is largest at the nearer end of this range.
    """
    spare = (1 + _TAIL * pixel.high("conversion_prnu")) * pixel.largest_growth
    per_electron = pixel.gain * (1 + _TAIL * pixel.high("column_prnu"))
    noise, o = _widest(pixel), max(offset, 0.0) / per_electron
    worst = spare**2 + math.hypot(spare**2, spare * o - noise)

    def rms(brightest: float) -> float:
        u = min(max(worst, noise), noise + spare * brightest)
        mean = (u - noise) / spare
        return math.sqrt(u / 2 * math.exp(-((mean + o) ** 2) / (2 * u))) if u > 0 else 0.0

    sensitive = 1 + _TAIL * pixel.high("prnu")
    most = INF if pixel.hot > 0 else spare * (pixel.light * sensitive + pixel.dark)
    beyond = math.sqrt(_TAIL_ODDS) * rms(INF) if pixel.high("prnu") > 0 else 0.0
    return max(-offset, 0.0) + per_electron * math.hypot(rms(most), beyond)


def _gaussian_excess(rms: float, level: float) -> float:
    """Return an upper bound on the root mean square of the excess max(x - level, 0) of a Gaussian x
    with mean 0 and standard deviation `rms`. The exact value is rms sqrt((1 + z^2) Q(z) - z
    phi(z)), where z = level / rms, and Q and phi are the tail probability and the density of a
    standard Gaussian. For z >= 0 the bound is rms sqrt(exp(-z^2 / 2) / 2)."""
    if rms == 0:
        return max(-level, 0.0)
    z = level / rms
    if z < 0:
        return math.hypot(rms, level)
    return rms * math.sqrt(math.exp(-z * z / 2) / 2)


EVERY_PIXEL = (
    "dsnu",
    "column_dsnu",
    "row_dsnu",
    "reset_noise",
    "read_noise",
    "row_noise",
    "column_noise",
    "frame_noise",
    "banding",
)
BOUNDS: dict[str, Callable[[Pixel], Bound]] = {
    **{name: partial(every_pixel, name) for name in EVERY_PIXEL},
    **field_functions(Sensor, globals()),
}
