"""Bound the change by each effect of a sensor, and the change of a reading, in DN, for a change of
light.

The bounds are in the modules `sensor_light`, `sensor_charge` and `sensor_reading`. Each bound is
for the sensor without the effects that were dropped before, because with less noise, dropping a
further effect changes the distribution more. The bounds of successive drops add.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..scene import Sensor, SensorEffect, ShotNoise, ShutterOffset
from ..sensor import QUANTISATION_VARIANCE, mean_photoelectrons
from . import sensor_charge, sensor_light, sensor_reading
from .boxes import setting, value_at
from .certificate import DN
from .electrons import share_of_light
from .pixel import Bound, Pixel, clean, pixel_of
from .stages import Draft, Drop, Ends, Gone, Response, Row

BoundOf = Callable[[Pixel], Bound]
BOUNDS: dict[str, BoundOf] = {
    **sensor_light.BOUNDS,
    **sensor_charge.BOUNDS,
    **sensor_reading.BOUNDS,
}
# Fields that define the meaning of the numbers, which cannot be dropped.
SCALES = {"photon_conversion", "colour_filter", "exposure_time", "gain"}

# Shares of a picture's computation that an effect takes, for 256 x 256 pixels under direct light.
_SAVES = {
    "charge_transfer": 0.2,
    "shot_noise": 0.3,
    "brighter_fatter": 0.6,
    "blooming": 0.05,
    "read_noise": 0.08,
    "reset_noise": 0.08,
    "telegraph_noise": 0.1,
    "dsnu": 0.08,
    "prnu": 0.08,
    "conversion_prnu": 0.08,
    "dead_pixels": 0.08,
    "hot_pixels": 0.1,
}
_TAPPED = ("read_noise", "prnu", "quantum_efficiency")  # nothing to multiply without the field
_ASSUMES = {
    "full_well": "Numbers of electrons in different pixels are independent.",
    "blooming": "Numbers of electrons in different pixels are independent.",
}


def sensor_stage(
    sensor: Ends[Sensor], irradiance: np.ndarray, *, shape: tuple[int, int]
) -> tuple[tuple[Row, ...], Response]:
    """Return a `Row` for each effect of a sensor, and its `Response` to a change of light."""
    light = np.asarray(irradiance, float)
    arriving = jax.ShapeDtypeStruct((*shape, *light.shape), jnp.result_type(float))
    jax.eval_shape(lambda seen: mean_photoelectrons(sensor.high, seen), arriving)

    @cache
    def pixel(gone: Gone) -> Pixel:
        return pixel_of(sensor, light, shape, frozenset(n for n in gone if n.startswith("sensor.")))

    rows = [
        _field(name, bound, sensor, pixel)
        for name, bound in BOUNDS.items()
        if getattr(sensor.high, name) is not None
    ]
    rows += [
        _faster(name, electrons, why, kind, pixel)
        for name, kinds, electrons, why, kind in sensor_charge.COUNTING
        if isinstance(sensor.high.shot_noise, kinds)
    ]
    rows += [_user_effect(i, ends, pixel) for i, ends in enumerate(pixel(frozenset()).user_effects)]

    def response(change: np.ndarray, gone: Gone = frozenset()) -> float:
        return _response(pixel(gone), np.asarray(change, float))

    return tuple(rows), Response(response, dark_noise(pixel(frozenset({"sensor.brighter_fatter"}))))


def dark_noise(pixel: Pixel) -> float:
    """Return the smallest noise, in DN rms, of a pixel in the dark: temporal, fixed-pattern and
    rounding.

    Pixels with defects or traps are not considered, because they are noisier.
    """
    conversion, column = pixel.low("conversion_prnu"), pixel.low("column_prnu")
    dark = pixel.counted_dark
    read = (1 + conversion**2) * dark + (conversion * dark) ** 2 + pixel.added_variance()
    variance = pixel.gain_low**2 * (1 + column**2) * read
    rounding = 0.0 if pixel.sensor.high["bits"] is None else QUANTISATION_VARIANCE
    return math.sqrt(variance + rounding)


def _response(pixel: Pixel, change: np.ndarray) -> float:
    """Return the change of any pixel, DN, for a change of irradiance, (bands,) W m^-2."""
    if not np.any(change):
        return 0.0
    ends = (
        end if isinstance(end["light_offset"], ShutterOffset) else dict(end, light_offset=None)
        for end in pixel.sensor
    )  # an offset of the light does not change
    moved = replace(pixel, sensor=Ends(*ends), irradiance=np.abs(change)).light
    return clean(pixel.distribution_change(moved, patterned=True))


def _row(
    name: str, bound: BoundOf, pixel: Callable[[Gone], Pixel], drop: Drop | None, **more: Any
) -> Row:
    """Return the `Row` of an effect, bounded for the sensor without those dropped before."""

    def bound_without(gone: Gone) -> float:
        return clean(bound(pixel(gone - {name})).dn)

    first = bound(pixel(frozenset()))
    dn = np.asarray(clean(first.dn))
    more |= {"estimated": first.rank == "estimate" and dn > 0, "rare": first.rare}
    return Row(name, dn, first.why, drop, unit=DN, after=bound_without, **more)


def _field(name: str, bound: BoundOf, sensor: Ends[Sensor], pixel: Callable[[Gone], Pixel]) -> Row:
    """Return the `Row` of one field, which is dropped together with the taps' factors on this
    field.
    """
    identity = _is_identity(name, sensor)

    def drop(draft: Draft) -> Draft:
        draft, taps = setting(f"camera.sensor.{name}")(draft), f"camera.sensor.taps.{name}"
        tapped = name in _TAPPED and value_at(draft, taps) is not None
        return setting(taps)(draft) if tapped else draft

    blooms = name == "full_well" and sensor.high.blooming is not None
    return _row(
        f"sensor.{name}",
        (lambda _: Bound(0.0, "it is 1: nothing changes")) if identity else bound,
        pixel,
        None if name in SCALES and not identity else drop,
        assumes=_ASSUMES.get(name, ""),
        saves=_SAVES.get(name, 0.02),
        needs=frozenset({"sensor.blooming"} if blooms else ()),
    )


def _user_effect(i: int, ends: Ends[SensorEffect], pixel: Callable[[Gone], Pixel]) -> Row:
    """Return the `Row` of a user-defined effect, with the bound registered for that effect."""

    def bound(pixel: Pixel) -> Bound:
        dn, kind = (
            clean(pixel.gain_without_repulsion * pixel.change_by(ends)),
            type(ends.low).__name__,
        )
        return Bound(dn, kind if math.isfinite(dn) else f"no bound of {kind} is known")

    def drop(draft: Draft) -> Draft:
        kept = tuple(own for own in draft.camera.sensor.own or () if own is not ends.low)
        return setting("camera.sensor.own", to=kept)(draft)

    return _row(f"sensor.own[{i}]", bound, pixel, drop)


def _faster(
    name: str, electrons: float, why: str, kind: type[ShotNoise], pixel: Callable[[Gone], Pixel]
) -> Row:
    """Return the `Row` for replacing the shot noise by a faster counting method."""

    def bound(pixel: Pixel) -> Bound:
        return Bound(pixel.read(electrons), why, rank="estimate")

    field, drop = f"sensor.shot_noise.{name}", setting("camera.sensor.shot_noise", to=kind())
    others = {"sensor.shot_noise", "sensor.shot_noise.exact", "sensor.shot_noise.whole"} - {field}
    return _row(field, bound, pixel, drop, saves=0.25, instead_of=frozenset(others))


def _is_identity(name: str, sensor: Ends[Sensor]) -> bool:
    """Return whether a factor is 1, so that dropping it changes nothing."""
    if name in ("gain", "infrared_cut", "quantum_efficiency"):
        return all(bool(np.all(np.asarray(getattr(end, name), float) == 1)) for end in sensor)
    if name == "pixel_aperture":
        apertures = [end.pixel_aperture for end in sensor if end.pixel_aperture is not None]
        return all(a.oversampling == 1 and share_of_light(a) == 1 for a in apertures)
    return False
