"""Bound the change if a sensor effect on the counted charge is dropped: shot noise, full wells, and
charge transfer.

The argument of each function is the sensor without the effects that were dropped before. Each
function returns a bound, in DN, on the distance of distributions defined in `pixel`.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from ..scene import (
    ChargeTransfer,
    FastPoissonShotNoise,
    GaussianShotNoise,
    PoissonShotNoise,
    Sensor,
)
from .pixel import INF, Bound, Pixel, growth
from .stages import Ends, field_functions

# 2-Wasserstein distances from a Poisson law, e-. For a Gaussian with the same moments: the
# largest in a table over means, at 0.86 e-. At many electrons it is sqrt(1/12 + 1/18), from
# rounding to integers and from skewness.
WHOLE = 0.4185
# For draws by inversion instead of rejection: their distance in total variation (measured, see
# `sensor.count`), times one electron.
INVERSION = math.sqrt(1.4e-4)


def shot_noise(pixel: Pixel) -> Bound:
    """Bound the effect of shot noise by sqrt(V + m) - sqrt(V), where m is the largest mean charge
    of any pixel and V the variance of all other noise in the darkest pixel."""
    rest = pixel.quiet - pixel.counted_dark
    counted = pixel.light + pixel.dark + pixel.hot
    if not math.isfinite(counted):
        return Bound(INF, "the light is not bounded")
    moved = growth(rest, counted) + pixel.spilt.rms
    return Bound(pixel.read(moved), f"sqrt of {counted:.4g} e- rms")


def brighter_fatter(pixel: Pixel) -> Bound:
    """Bound the effect of repulsion between charges: the charge that moves over the borders of the
    brightest pixel, and the change of that pixel's noise.

    With c = 2 m (D_rows + D_columns), as in `Pixel.repulsion`, the charge q, in units of its mean
    m, grows at most as q' = 1 + c q during the exposure. The mean therefore changes by m ((e^c - 1)
    / c - 1). A covariance between two pixels grows at the rate c for each of the two pixels. So the
    variance of the count grows by m (e^c (e^(2 c) - 1) / (2 c) - 1), and the variance s^2 of a
    fixed pattern grows by s^2 (e^(2 c) - 1).
    """
    c, light = pixel.repulsion, pixel.light / pixel.push_factor
    if c == 0:
        return Bound(0.0, "no charge repels another")
    if not c < 100:
        return Bound(INF, "charges repel more electrons than the pixels receive")
    charge = light + pixel.dark + math.sqrt(2) * pixel.hot
    mean = charge * (math.expm1(c) / c - 1)
    noise = charge * (math.exp(c) * math.expm1(2 * c) / (2 * c) - 1) if pixel.counted else 0.0
    pattern = ((pixel.high("prnu") * light) ** 2 + pixel.hot**2) * math.expm1(2 * c)
    moved = math.hypot(mean, growth(pixel.quiet, noise + pattern)) + 2 * pixel.spilt.rms
    why = f"{c:.3g} of the charge of a pixel with {charge:.4g} e-"
    rank = "estimate" if pixel.hot or pixel.spilt.rms else "bound"
    return Bound(pixel.read(moved) / pixel.push_factor**3, why, rank=rank)


def full_well(pixel: Pixel) -> Bound:
    """Bound the full well by the rms excess of the brightest charge (module `overflow`)."""
    well = float(pixel.sensor.low["full_well"])
    why = f"at most {pixel.bright:.4g} e- expected in a well of {well:.4g}"
    return Bound(pixel.gain_of_charge * pixel.spilt.rms, why, rank=pixel.rank_of_counts)


def blooming(pixel: Pixel) -> Bound:
    """Bound blooming by the charge that a pixel receives from its column."""
    if pixel.received_charge == 0:
        return Bound(0.0, "no charge spills")
    why = f"{pixel.spilt.mean:.3g} e- above the well expected, at most"
    return Bound(pixel.gain_of_charge * pixel.received_charge, why, rank=pixel.rank_of_counts)


def charge_transfer(pixel: Pixel) -> Bound:
    """Bound the effect of charge transfer by the larger of two changes: the loss of a bright pixel
    and the gain of a dark one.

    The sensitivity pattern, of relative rms p, changes by at most p times the charge that moves.
    The variance of the counts changes by at most the change of the mean.
    """
    transfer = pixel.sensor.high["charge_transfer"]
    lost, gained = transfer_shares(transfer, pixel.shape)
    if not math.isfinite(pixel.bright):
        return Bound(INF, "the light is not bounded")
    mean = max(lost, gained) * pixel.bright
    pattern = pixel.high("prnu") * pixel.light * math.hypot(lost, gained)
    noise = growth(pixel.quiet, mean) if pixel.counted else 0.0
    moved = pixel.gain_of_charge * math.hypot(mean, noise + pattern)
    return Bound(moved, f"{max(lost, gained):.3g} of a packet stays behind")


def charge_effects(name: str, pixel: Pixel) -> Bound:
    """Bound the change of a pixel by mixing or by the nonlinearity (`Pixel.change_by`)."""
    ends = Ends(*(end[name] for end in pixel.sensor))
    moved = pixel.change_by(ends)
    why = type(ends.low).__name__
    if not math.isfinite(pixel.rms):
        why = "the light is not bounded"
    elif not math.isfinite(moved):
        why = f"no bound of {why} is known"
    return Bound(pixel.gain_without_repulsion * moved, why)


def transfer_shares(transfer: ChargeTransfer, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the largest share of a charge packet that is not read in the packet's pixel, and the
    largest sum, over the pixels, of the shares of other packets that are read in one pixel."""
    serial = transfer.serial_inefficiency
    rows = shares_along(float(transfer.inefficiency), shape[0], transfer.trail)
    columns = shares_along(0.0 if serial is None else float(serial), shape[1], transfer.trail)
    own = float(rows[0].min() * columns[0].min())
    return 1 - own, max(float(rows[1].max() * columns[1].max()) - own, 0.0)


def shares_along(inefficiency: float, size: int, trail: int) -> tuple[np.ndarray, np.ndarray]:
    """Return two numbers for each place i along a line of pixels: the share of charge packet i that
    is read at place i, and the sum of the shares of all packets that are read there.

    The packet of place i is transferred i + 1 times with inefficiency e. Each electron of the
    packet is read k places behind with the probability C(i + k, k) (1 - e)^(i + 1) e^k. Charge that
    falls `trail` or more places behind is read `trail` places behind.
    """
    row = np.arange(size)
    share = (1 - inefficiency) ** (row + 1)
    own, received, left = share, np.zeros(size), 1 - share
    for behind in range(1, min(trail, size - 1) + 1):
        share = share * inefficiency * (row + behind) / behind
        read = np.maximum(share, left) if behind == trail else share
        received[behind:] += read[: size - behind]
        left = left - share
    return own, own + received


BOUNDS: dict[str, Callable[[Pixel], Bound]] = {
    **field_functions(Sensor, globals()),
    **{name: partial(charge_effects, name) for name in ("mixing", "nonlinearity")},
}
# Replacements for a counting method: the name of the effect, the kinds that have it, its error in
# electrons and where that is from, and the kind without it.
COUNTING = (
    ("exact", (PoissonShotNoise,), INVERSION, "measured up to 2^31 e-", FastPoissonShotNoise),
    (
        "whole",
        (PoissonShotNoise, FastPoissonShotNoise),
        WHOLE,
        "tabulated over means",
        GaussianShotNoise,
    ),
)
