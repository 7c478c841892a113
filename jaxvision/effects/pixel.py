"""Describe the distribution of a pixel's value by its mean and rms, in electrons, and bound its
change.

The squared distance of two distributions with means m and rms s is

    D^2 = (m_1 - m_2)^2 + (s_1 - s_2)^2.

For Gaussian distributions, D is the 2-Wasserstein distance. For other distributions, D is a lower
bound on that distance (Gelbrich, "On a formula for the L2 Wasserstein metric", Mathematische
Nachrichten 147 (1990)). D is the distance of two points (m, s) in a plane, so the bounds of
successive changes add. The rms of a sum of independent parts is the length of the vector of their
rms values. So if the parts change, the rms of their sum changes by at most the length of the
difference between the old and the new vector (triangle inequality).

If the number of counted electrons changes in the presence of Gaussian noise of 1 e- rms, the
Wasserstein distance is at most 1.03 times the bound. With less noise the ratio is larger, 1.3 for
0.5 e- and 2 for 0.2 e-, because counts are integers: an expected change of a small part of an
electron changes a few counts by a whole electron.

The signal of a pixel is computed in these steps:

- The charge is light r + dark, with shot noise. The sensitivity r of a pixel varies around 1 with
  the PRNU as rms.
- The effects on charge change it: mixing, the nonlinearity and user-defined effects.
- The conversion multiplies the charge by a gain that varies around 1 with rms c.
- The read-out adds offsets and noise, and multiplies the sum by a column gain that varies around 1
  with rms q.
- The reading in DN is K times the result plus an offset, with the gain K.

If the charge changes by D, the reading changes by at most K sqrt((1 + c^2)(1 + q^2)) D in DN. A
given change of the variance changes the rms least where there is most noise. Every pixel has at
least the noise of a dark pixel.

All quantities are NumPy float64, in electrons unless stated otherwise. If a bound decreases with a
parameter, the parameter has its smallest value.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..scene import GaussianShotNoise, HeavyTailedReadNoise, Sensor, ShutterOffset
from ..sensor import stage_of
from .boxes import corners
from .certificate import Rank
from .electrons import (
    dark_rate,
    exposure,
    freed,
    kernel_slopes,
    light_offset_electrons,
    read_out_variances,
)
from .overflow import Charge, Excess, excess
from .stages import Ends, Gone

INF = math.inf
CHARGES = 1025  # points at which a curve is evaluated
ASSUMED = (
    "Distances in DN are those of mean and rms: 2-Wasserstein where laws are Gaussian, a lower "
    "bound of it otherwise."
)


class Flood(NamedTuple):
    """The shares of the overflow of all other pixels that reach one pixel: `all` is the sum of the
    shares, and `independent` the root of the sum of their squares; no unit."""

    all: float
    independent: float


class Bound(NamedTuple):
    """A bound on the change of a pixel's distribution if one effect is dropped."""

    # DN, the distance defined at the top of this module; 0: it changes nothing; inf: no bound
    dn: float
    why: str  # reason for the bound, or for its absence
    rank: Rank = "bound"  # "bound", or "estimate" if it was tabulated instead of proved
    rare: float = 0.0  # expected number of pixels that it changes; 0: all pixels


def unbounded(why: str) -> Callable[[Any], Bound]:
    """Return a function that gives no bound, for an effect that defines a scale."""
    return lambda _: Bound(INF, why)


def clean(x: Any) -> float:
    """Make a number a valid bound: at least 0, and inf for NaN."""
    number = float(x)
    return INF if math.isnan(number) else max(number, 0.0)


def growth(before: float, by: float) -> float:
    """Return sqrt(before + by) - sqrt(before), computed without cancellation."""
    if by == 0:
        return 0.0
    return by / (math.sqrt(before + by) + math.sqrt(before))


@dataclass(frozen=True)
class Pixel:
    """A sensor without the dropped effects, with bounds on its pixels under the largest light."""

    # the fields of the sensor at both ends, by name; None for dropped ones
    sensor: Ends[Mapping[str, Any]]
    irradiance: np.ndarray  # (bands,) W m^-2, the supremum over all pixels
    shape: tuple[int, int]  # (rows, columns) of the sensor

    def high(self, name: str, absent: float = 0.0) -> float:
        """Return the largest value of a parameter over its range; `absent` if it is None."""
        value = self.sensor.high[name]
        return absent if value is None else float(value)

    def low(self, name: str, absent: float = 0.0) -> float:
        """Return the smallest value of a parameter over its range; `absent` if it is None."""
        value = self.sensor.low[name]
        return absent if value is None else float(value)

    @cached_property
    def gain(self) -> float:
        """The largest gain K, in DN per electron."""
        return self.high("gain", 1.0)

    @cached_property
    def gain_low(self) -> float:
        """The smallest gain K, in DN per electron."""
        return self.low("gain", 1.0)

    @cached_property
    def light(self) -> float:
        """The largest number of photoelectrons in any pixel. Smear s increases the photoelectrons m
        of the irradiance to m (1 + s (rows - 1)), and repulsion increases them by the factor
        `push_factor`."""
        return self._electrons * self.push_factor

    @cached_property
    def _electrons(self) -> float:
        light = freed(self.sensor.high, self.irradiance) + self.offset_charge
        return clean(light) * self.smear_factor

    @cached_property
    def offset_charge(self) -> float:
        """The largest number of electrons that a light offset adds or removes."""
        return max(light_offset_electrons(end, self.irradiance) for end in self.sensor)

    @cached_property
    def deficit(self) -> float:
        """The number of electrons that a light offset removes from a pixel without light."""
        offset = self.sensor.low["light_offset"]
        below = offset is not None and not isinstance(offset, ShutterOffset) and np.min(offset) < 0
        return self.offset_charge if below else 0.0

    @cached_property
    def repulsion(self) -> float:
        """The largest relative change of a pixel's charge by the brighter-fatter effect, c = 2 m
        (D_rows + D_columns) for a charge m. For each direction, D is half of the sum of |K_l - K_(l
        + neighbour)| over the offsets l of the kernel K. So D m bounds the difference of the
        potentials of two neighbours."""
        effect = self.sensor.high["brighter_fatter"]
        if effect is None:
            return 0.0
        slopes = sum(kernel_slopes(end["brighter_fatter"].kernel) for end in self.sensor)
        return clean(2 * slopes * (self._electrons + self.dark + math.sqrt(2) * self.hot))

    @cached_property
    def push_factor(self) -> float:
        """The largest factor, e^c with c the `repulsion`, by which the brighter-fatter effect
        multiplies a charge q or a change d of the charge. During the exposure, t from 0 to 1, they
        grow at most as q' = 1 + c q and d' = e^(c t) + c d."""
        return math.exp(self.repulsion) if self.repulsion < 700 else INF

    @cached_property
    def smear_factor(self) -> float:
        """The factor of smear on the brightest pixel in a column that is equally bright."""
        return 1 + self.high("smear") * (self.shape[0] - 1)

    @cached_property
    def dark(self) -> float:
        """The largest number of dark-current electrons."""
        return max(self._darks)

    @cached_property
    def _darks(self) -> list[float]:
        """The dark electrons at each corner of the free parameters, in which each law is
        monotone."""
        dark = Ends(self.sensor.low["dark_current"], self.sensor.high["dark_current"])
        if dark.low is None:
            return [0.0]
        times = {exposure(self.sensor.low), exposure(self.sensor.high)}
        return [dark_rate(law) * time for law in corners(dark) for time in times]

    @cached_property
    def hot(self) -> float:
        """The mean excess of a hot pixel, in electrons; 0 without hot pixels."""
        hot = self.sensor.high["hot_pixels"]
        return 0.0 if hot is None else float(hot.rate) * exposure(self.sensor.high)

    @cached_property
    def bright(self) -> float:
        """The mean electrons of the brightest pixel, plus the rms excess of a hot pixel."""
        return self.light + self.dark + math.sqrt(2) * self.hot

    @property
    def counted(self) -> bool:
        """Whether electrons are counted (shot noise), so that their variance equals their mean."""
        return self.sensor.high["shot_noise"] is not None

    @cached_property
    def variances(self) -> Ends[dict[str, float]]:
        """The variances of the read-out noise at both ends of the free parameters."""
        return Ends(read_out_variances(self.sensor.low), read_out_variances(self.sensor.high))

    def added_variance(self, name: str = "") -> float:
        """Return a lower bound on the variance added after the conversion, the sum over all noise
        sources except `name`."""
        return sum(v for key, v in self.variances.low.items() if key != name)

    @property
    def surely_counted(self) -> float:
        """A lower bound on the variance of the brightest charge. The bound is 0 if a full well may
        limit the charge or if charges repel each other, because a full well and repulsion reduce
        the variance."""
        sure = (
            self.counted
            and self.spilt.rms < 1e-6
            and self.repulsion == 0
            and not self.charge_effects
        )
        return self.light + self.dark if sure else 0.0

    @property
    def rank_of_counts(self) -> Rank:
        """The rank of bounds that assume Poisson counts. With the brighter-fatter effect counts are
        not Poisson, so these bounds are estimates."""
        return "bound" if self.repulsion == 0 else "estimate"

    @cached_property
    def counted_dark(self) -> float:
        """The smallest variance of any charge: the number of counted dark electrons, less the
        electrons that charge transfer loses. A full well that clips a charge reduces its rms by at
        most the excess."""
        if (
            not self.counted
            or self.charge_effects
            or self.sensor.high["brighter_fatter"] is not None
        ):
            return 0.0
        dark = max(min(self._darks) - self.deficit, 0.0)
        return max(math.sqrt(dark * self.read_share) - self.spilt.rms, 0.0) ** 2

    @cached_property
    def read_share(self) -> float:
        """The smallest share of its charge that is read from a pixel of an evenly lit sensor."""
        transfer = self.sensor.high["charge_transfer"]
        if transfer is None:
            return 1.0
        serial = transfer.serial_inefficiency
        lost = 1 - float(transfer.inefficiency)
        return lost if serial is None else lost * (1 - float(serial))

    @cached_property
    def quiet(self) -> float:
        """The smallest variance of any pixel, as a variance of the charge."""
        larger = (1 + self.high("conversion_prnu") ** 2) * self.largest_growth**2
        return self.counted_dark + self.added_variance() / larger

    @cached_property
    def gain_after_conversion(self) -> float:
        """The change in DN for one electron after the conversion: K sqrt(1 + q^2)."""
        return self.gain * math.hypot(1, self.high("column_prnu"))

    @cached_property
    def gain_of_charge(self) -> float:
        """The change in DN for one electron of arriving charge: K sqrt((1 + c^2)(1 + q^2)), with
        the largest factors of all effects on charge, conversion PRNU c and column PRNU q. The
        brighter-fatter effect of `repulsion` b multiplies the change by at most e^(3 b): a variance
        grows by up to e^(2 b), and the rms by which it is divided shrinks by up to e^-b."""
        return self.gain_without_repulsion * self.push_factor**3

    @cached_property
    def gain_without_repulsion(self) -> float:
        """The factor `gain_of_charge` without the brighter-fatter effect."""
        return self.gain_of_conversion * self.largest_growth

    @cached_property
    def largest_growth(self) -> float:
        """The largest factor by which the effects on charge multiply a charge or a change of it."""
        return math.prod(own_bound(effect, self.rms)[1] for effect in self.charge_effects)

    @cached_property
    def user_effects(self) -> tuple[Ends[Any], ...]:
        """The user-defined effects on charge, which were registered."""
        both = (end["own"] or () for end in self.sensor)
        return tuple(Ends(low, high) for low, high in zip(*both, strict=True))

    @cached_property
    def charge_effects(self) -> tuple[Ends[Any], ...]:
        """All effects on charge: user-defined effects, mixing, and the nonlinearity."""
        last = (Ends(*(end[name] for end in self.sensor)) for name in ("mixing", "nonlinearity"))
        return (*self.user_effects, *(ends for ends in last if ends.low is not None))

    def change_by(self, effect: Ends[Any]) -> float:
        """Return the largest root mean square change, in electrons, of any pixel by an effect on
        charge. A curve g changes charges of mean m and rms s by at most |g(m) - m| + L s, where L
        is the largest deviation of the slope of g from 1."""
        curve, electrons = stage_of(effect.low).curve, self.rms * self.largest_growth
        leaning = own_bound(effect, 1.0)[0]
        known = effect.low is effect.high and math.isfinite(electrons * leaning)
        if curve is None or not known:
            return own_bound(effect, electrons)[0]
        mean = (self.light + self.dark) * self.largest_growth
        noise = math.sqrt(self.bright) if self.counted else 0.0
        noise = math.hypot(noise, self.high("prnu") * self.light, math.sqrt(2) * self.hot)
        charges = np.linspace(0, mean, CHARGES)
        found = np.asarray(curve(effect.low, jnp.asarray(charges, jnp.result_type(float))), float)
        departure = float(np.max(np.abs(found - charges))) + leaning * mean / (2 * (CHARGES - 1))
        rounding = 4 * float(jnp.finfo(jnp.result_type(float)).eps) * mean
        return departure + rounding + leaning * noise * self.largest_growth

    @cached_property
    def read_bright(self) -> float:
        """The electrons of the brightest pixel after the effects on charge."""
        return self.bright * self.largest_growth

    @cached_property
    def rms(self) -> float:
        """The root mean square of the electrons of the brightest pixel."""
        noise = self.bright if self.counted else 0.0
        return math.hypot(self.bright, math.sqrt(noise), self.high("prnu") * self.light)

    @cached_property
    def gain_of_conversion(self) -> float:
        """The change in DN for one electron of charge: K sqrt((1 + c^2)(1 + q^2))."""
        return self.gain_after_conversion * math.hypot(1, self.high("conversion_prnu"))

    @cached_property
    def charge(self) -> Charge:
        """The random charge of the brightest pixel, a hot one if there are any, before a full
        well."""
        gaussian = isinstance(self.sensor.high["shot_noise"], GaussianShotNoise)
        return Charge(
            self.light,
            self.dark,
            self.high("prnu"),
            self.hot,
            ("gaussian" if gaussian else "poisson") if self.counted else "none",
        )

    @cached_property
    def spilt(self) -> Excess:
        """Bounds on the excess of the brightest charge over the full well, 0 without one."""
        well = self.sensor.low["full_well"]
        return Excess(0.0, 0.0) if well is None else excess(self.charge, float(well))

    @cached_property
    def flood(self) -> Flood:
        """The shares of the overflow of all other pixels of a column that reach one pixel. From a
        distance of d rows the share b^d / 2 arrives, because each full well on the way passes on a
        share b. The sum is largest for a pixel in the middle of a column."""
        blooming, others = self.high("blooming"), self.shape[0] - 1
        distances = np.concatenate([np.arange(others // 2), np.arange(others - others // 2)]) + 1
        shares = blooming**distances / 2
        return Flood(float(shares.sum()), math.sqrt((shares**2).sum()))

    @cached_property
    def received_charge(self) -> float:
        """A bound on the root mean square of the charge R that overflows into a pixel, in
        electrons:

            R = sum s_i X_i,   E R^2 <= (E X sum s)^2 + E X^2 sum s^2,   R <= w

        Here s_i is the share that arrives from pixel i, w is the full well, and the excesses X_i of
        different pixels are independent.
        """
        mean, rms = self.spilt
        if self.flood.all == 0 or rms == 0:
            return 0.0
        well = float(self.sensor.high["full_well"])
        if not math.isfinite(rms):
            return well
        spilt = math.hypot(self.flood.all * mean, self.flood.independent * rms)
        return min(spilt, math.sqrt(well * self.flood.all * mean), well)

    def read(self, by: float) -> float:
        """Return the largest change of a reading, in DN, if every charge before the full wells
        changes by at most `by` electrons. Overflow adds up along a column. Half of the change of
        another pixel arrives if its charge overflows, and all of the change if a well on the way
        becomes full. The change of the reading is also at most the sum of the charges received
        before and after the change."""
        if self.received_charge == 0:
            return self.gain_of_charge * by
        return self.gain_of_charge * min(
            by * (1 + 2 * self.flood.all), by + 2 * self.received_charge
        )

    @cached_property
    def reach(self) -> float:
        """The number of pixels whose values may depend on one pixel's charge: the pixel, the trail
        of charge transfer, and the column into which the charge may overflow. Under the
        brighter-fatter effect, this is every pixel."""
        pixels = math.prod(self.shape)
        mixing = self.sensor.high["mixing"]
        shared = 1 if mixing is None else mixing.kernel.size
        if self.repulsion > 0:
            return pixels
        rows = self.shape[0] if self.received_charge > 0 else 1
        transfer = self.sensor.high["charge_transfer"]
        trail = 1 if transfer is None else transfer.trail + 1
        columns = 1 if transfer is None or transfer.serial_inefficiency is None else trail
        return min(rows * trail * columns * shared, pixels)

    def tap_change(self, name: str) -> float:
        """Return the largest departure of a tap parameter from 0 DN (offset) or 1 (factors)."""
        none = 0.0 if name == "offset" else 1.0
        values = [getattr(end["taps"], name, None) for end in self.sensor]
        changes = (np.abs(np.asarray(v, float) - none) for v in values if v is not None)
        return max((float(np.max(change)) for change in changes), default=0.0)

    def distribution_change(self, by: float, *, patterned: bool) -> float:
        """Return the change of a pixel's distribution, in DN, if its charge changes by `by`
        electrons, called d.

        The mean changes by d, and the variance of the counts by d. If the charge is `patterned`,
        the sensitivity pattern changes by p d, with the PRNU p. The rms changes most in the darkest
        pixel, of variance V: by sqrt(V + d) - sqrt(V).
        """
        if not math.isfinite(by):
            return INF
        most_quiet, cut = self.clip_at_well(by)
        noise = growth(min(self.quiet, most_quiet), by) if self.counted else 0.0
        mean = by * math.hypot(1, self.high("prnu")) if patterned else by
        return self.read(math.hypot(mean, noise) + cut)

    def clip_at_well(self, by: float) -> tuple[float, float]:
        """Return how a full well affects the distance between two charges that differ by d = `by`
        electrons.

        The result is the largest variance, in electrons^2, that a bound may assume for other noise,
        and the number of electrons by which the well increases the distance. If charges rarely
        reach the full well, the well changes each charge by at most the rms excess. Otherwise the
        well reduces the distance, and a bound may only assume the shot noise, of a variance of at
        least a quarter of the well.
        """
        if self.spilt.rms <= 1e-3 * by:
            return INF, 2 * self.spilt.rms
        return float(self.sensor.low["full_well"]) / 4, 0.0


def own_bound(effect: Ends[Any], electrons: float) -> tuple[float, float]:
    """Return upper bounds on the change of a pixel by an effect on charge, in electrons rms, and on
    the factor by which the effect multiplies a change of charge. For an effect without a bound,
    both upper bounds are inf."""
    bound = stage_of(effect.low).bound
    if bound is None or not math.isfinite(electrons):
        return INF, 1.0 if bound is not None else INF
    return bound(effect, electrons)


def pixel_of(
    sensor: Ends[Sensor], irradiance: np.ndarray, shape: tuple[int, int], gone: Gone
) -> Pixel:
    """Return the `Pixel` that bounds the value of any pixel of a sensor with (rows, columns)
    pixels. `gone` names the dropped effects, such as "sensor.read_noise". The irradiance of each
    pixel is at most `irradiance`, (bands,) W m^-2."""

    def remaining_fields(of: Sensor, extreme: Callable[[Any], Any]) -> Mapping[str, Any]:
        fields = vars(of).items()
        kept = {name: None if f"sensor.{name}" in gone else value for name, value in fields}
        own = enumerate(kept["own"] or ())
        kept = kept | {"own": tuple(e for i, e in own if f"sensor.own[{i}]" not in gone)}
        return kept | _extreme_tap(kept, extreme)

    return Pixel(
        Ends(remaining_fields(sensor.low, np.min), remaining_fields(sensor.high, np.max)),
        irradiance,
        shape,
    )


def _extreme_tap(kept: Mapping[str, Any], extreme: Callable[[Any], Any]) -> dict[str, Any]:
    """Return the parameters times the smallest or the largest factor of any tap."""
    taps = kept["taps"]
    found: dict[str, Any] = {"untapped": kept}
    for name in ("gain", "read_noise", "prnu", "quantum_efficiency"):
        factors, own = getattr(taps, name, None), kept[name]
        if factors is None or (own is None and name in ("read_noise", "prnu")):
            continue
        factor = float(extreme(factors))
        if name == "quantum_efficiency":
            found[name] = factor * (1.0 if own is None else np.asarray(own, float))
        elif isinstance(own, HeavyTailedReadNoise):
            found[name] = replace(own, rms=own.rms * factor, tail_rms=own.tail_rms * factor)
        else:
            found[name] = (1.0 if own is None else float(own)) * factor
    return found
