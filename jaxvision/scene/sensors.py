"""The records of an image sensor, which converts the light on each pixel to a number.

The range of each number is checked when a record is made. `ValueError` names the field, the value
and the allowed range. Values that JAX traces are not checked, and give a defined result.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._shown import Shown
from ..core._types import (
    FINITE,
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    Colour,
    Range,
    Scalar,
    as_float,
    as_optional_float,
    as_tile,
    check_count,
    check_fields,
    check_kind,
    check_range,
    check_tile,
    is_known,
    require_metres,
)
from .noises import (
    Banding,
    DarkCurrent,
    HeavyTailedReadNoise,
    HotPixels,
    ResetNoise,
    ShotNoise,
    TelegraphNoise,
)
from .sensor_effects import Mixing, Nonlinearity, SensorEffect

MOST_UNEVEN = 0.5  # relative RMS of gains; larger numbers are probably per cent
LARGEST_PIXEL = 0.1  # m^2; larger numbers are probably in um^2


class PhotonConversion(Shown):
    """Conversion of irradiance E to the mean number of photons, mu_p = lambda E A t / (h c) (EMVA
    1288), where lambda is the wavelength, A the pixel area and t the exposure time.

    Attributes:
        wavelength: () or (bands,) m, > 0, at most 1 cm.
        pixel_area: () m^2 of the whole pixel, > 0, at most 0.1 m^2.

    Example:
        1 uW cm^-2 at 1 um, for 1 ms on 1 um^2, gives the constant 50.34 of EMVA 1288.

        >>> photons = jv.PhotonConversion(wavelength=1e-6, pixel_area=1e-12)
        >>> sensor = jv.Sensor(photon_conversion=photons, exposure_time=1e-3)
        >>> round(float(jv.mean_photoelectrons(sensor, jnp.array([1e-2]))[0]), 2)
        50.34
    """

    wavelength: Scalar | Colour = eqx.field(converter=as_float)
    pixel_area: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, wavelength=POSITIVE, pixel_area=POSITIVE)
        if is_known(self.wavelength):
            require_metres("PhotonConversion.wavelength", np.asarray(self.wavelength))
        if is_known(self.pixel_area) and float(self.pixel_area) > LARGEST_PIXEL:
            raise ValueError(
                f"PhotonConversion.pixel_area is in m^2, got {float(self.pixel_area):g}; a "
                "pixel of 5 um has 25e-12."
            )


class PixelAperture(Shown):
    """The light-sensitive area of a pixel, a square in its middle.

    Attributes:
        fill_factor: () share of the pixel's area, in (0, 1], no unit.
        microlens: () share of the remaining light that a microlens collects, in [0, 1], no unit;
            None for no microlens.
        oversampling: samples of irradiance along each side of a pixel, >= 1; static. With 1 the
            irradiance is uniform over the pixel.

    Example:
        >>> half = jv.PixelAperture(0.5, microlens=0.8)
        >>> round(float(jv.sensor.light_share(half)), 4)  # 0.5 + 0.8 x 0.5
        0.9
    """

    fill_factor: Scalar = eqx.field(converter=as_float)
    microlens: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    oversampling: int = eqx.field(static=True, default=1, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, fill_factor=Range(0, 1, above=True), microlens=FRACTION)
        check_count("PixelAperture.oversampling", self.oversampling, 1)


class ColourFilter(Shown):
    """A colour filter over each pixel, with which the pixel measures one number: a weighted sum of
    the bands.

    Attributes:
        transmission: (colours, bands) >= 0, relative; electrons per photon if the quantum
            efficiency is None.
        pattern: rows of colour indices, repeated from the first pixel on, or the phase of a Bayer
            mosaic, such as "RGGB"; ((0,),) with one colour is a monochrome sensor. Static.

    Example:
        >>> sensor = jv.Sensor(colour_filter=jv.ColourFilter(np.eye(3), pattern="RGGB"))
        >>> light = jnp.broadcast_to(jnp.array([1.0, 2.0, 3.0]), (2, 2, 3))
        >>> jv.raw_image(None, sensor, light)[..., 0].tolist()
        [[1.0, 2.0], [2.0, 3.0]]
    """

    transmission: Float[Array, "colours bands"] = eqx.field(converter=as_float)
    pattern: tuple[tuple[int, ...], ...] = eqx.field(static=True, kw_only=True, converter=as_tile)

    def __check_init__(self) -> None:
        check_fields(self, transmission=NOT_NEGATIVE)
        check_tile(
            "ColourFilter.pattern",
            self.pattern,
            bands=self.transmission.shape[0],
            holder="ColourFilter.transmission",
        )


class BrighterFatter(Shown):
    """The brighter-fatter effect: collected charge repels later charge into neighbouring pixels, so
    bright spots grow with light.

    The collected charge Q moves the borders of pixels. The current (I_p + I_q) (phi_p - phi_q) / 2
    therefore flows across the border between the pixels p and q. Here I is the rate at which charge
    arrives, K the kernel, and phi the convolution of K with Q. No electron is lost. In uniform
    light this model is that of Antilogus et al. (JINST 9 C03048, 2014) and Astier et al. (A&A 629
    A36, 2019). The relative change of a pixel's area per electron, a, is the discrete Laplacian of
    K (`jaxvision.sensor.area_changes`). K is the kernel of Coulton et al. (AJ 155 258, 2018).

    Attributes:
        kernel: (rows, columns) per electron, K at offsets of 0, 1, ... rows and columns, even in
            both; 0 beyond. About 1e-6 / 4 at offset 0 for a CCD of 100 um thickness.
        steps: number of parts of the exposure, >= 2; static. Electrons that arrive in the same part
            do not repel each other; to compensate, the kernel is scaled by steps / (steps - 1). The
            variance is then exact to first order in K. Its second-order term, which is (2/3) (a_00
            mu)^2 of the variance, has a relative error of about 1 / (5 steps).

    Example:
        No electron is lost.

        >>> sensor = jv.Sensor(brighter_fatter=jv.BrighterFatter([[1e-6]]))
        >>> spot = jnp.array([0.0, 1e4, 0.0]).reshape(1, 3, 1)
        >>> [round(float(x)) for x in jv.raw_image(None, sensor, spot).ravel()]
        [25, 9950, 25]
    """

    kernel: Float[Array, "rows columns"] = eqx.field(converter=as_float)
    steps: int = eqx.field(static=True, default=8, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, kernel=FINITE)
        check_count("BrighterFatter.steps", self.steps, 2)


class ChargeTransfer(Shown):
    """Charge transfer inefficiency of a CCD: each transfer toward the read-out leaves some charge
    behind.

    The read-out is next to the first row and column.

    Attributes:
        inefficiency: () share of a charge packet that is lost per row transfer, in [0, 1/2], no
            unit.
        serial_inefficiency: () share that is lost per transfer along the serial register, in [0,
            1/2], no unit, or None.
        trail: number of pixels behind a packet in which its lost charge is computed, >= 1; static.
            Charge that lags farther is read in the last of these pixels.

    Example:
        >>> sensor = jv.Sensor(charge_transfer=jv.ChargeTransfer(inefficiency=0.01))
        >>> packet = jnp.array([100.0, 0.0, 0.0]).reshape(3, 1, 1)
        >>> [round(float(x), 2) for x in jv.raw_image(None, sensor, packet).ravel()]
        [99.0, 0.99, 0.01]
    """

    inefficiency: Scalar = eqx.field(converter=as_float)
    serial_inefficiency: Scalar | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    trail: int = eqx.field(static=True, default=8, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, inefficiency=Range(0, 0.5), serial_inefficiency=Range(0, 0.5))
        check_count("ChargeTransfer.trail", self.trail, 1)


class RollingShutter(Shown):
    """A rolling shutter, with which each row begins and ends its exposure later than the row above.

    Attributes:
        line_time: () s from row to row, >= 0.

    Example:
        >>> shutter = jv.RollingShutter(line_time=1e-5)
        >>> starts = jv.sensor.row_starts(shutter, jnp.array(0.01), rows=3)
        >>> [round(float(t) * 1e6, 3) for t in starts]  # us
        [0.0, 10.0, 20.0]
    """

    line_time: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, line_time=NOT_NEGATIVE)


class ShutterOffset(Shown):
    """The difference between the actual and the nominal exposure time.

    Attributes:
        time: () s, added to the exposure time of light, but not of dark current; may be negative.

    Example:
        >>> late = jv.Sensor(exposure_time=1e-3, light_offset=jv.ShutterOffset(2e-5))
        >>> round(float(jv.mean_photoelectrons(late, jnp.array([1e6]))[0]))
        1020
    """

    time: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, time=FINITE)


class Taps(Shown):
    """Several read-out amplifiers, or sites of a mosaic: the tap of each pixel, and the parameters
    of each tap.

    Attributes:
        pattern: rows of tap indices 0, 1, ..., repeated from the first pixel on, or the phase of a
            Bayer mosaic, such as "RGGB"; ((0, 1),) are odd and even columns. Static.
        offset: (taps,) DN, added to `Sensor.offset`, or None.
        gain: (taps,) factors on `Sensor.gain`, > 0, no unit, or None.
        read_noise: (taps,) factors on `Sensor.read_noise`, >= 0, no unit, or None.
        prnu: (taps,) factors on `Sensor.prnu`, >= 0, no unit, or None.
        quantum_efficiency: (taps,) factors on `Sensor.quantum_efficiency`, >= 0, no unit, or None.
            For the sites of a mosaic, the factors are valid only for the light of the camera's
            calibration.
        stretched: whether the pattern covers the frame once instead of being repeated: ((0, 1), (2,
            3)) are then its quadrants. Static.
        cell: rows and columns of the mosaic in each part of a stretched pattern. The pattern lists
            the mosaic of one part after the other: ((0, 1, 2, 3),) with the cell (1, 2) are the odd
            and even columns of the left half and those of the right half. The mosaic begins at the
            first pixel of the frame. Static.
        names: of the taps, such as ("red", "green 1", "green 2", "blue"), which match frames of
            another mosaic phase; or None. Static.

    Example:
        >>> halves = jv.Taps(((0, 1),), offset=[0.0, 3.0], gain=[1.0, 2.0], stretched=True)
        >>> print(jv.raw_image(None, jv.Sensor(taps=halves), jnp.full((1, 4, 1), 10.0)).ravel())
        [10. 10. 23. 23.]
    """

    pattern: tuple[tuple[int, ...], ...] = eqx.field(static=True, converter=as_tile)
    offset: Float[Array, " taps"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    gain: Float[Array, " taps"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    read_noise: Float[Array, " taps"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    prnu: Float[Array, " taps"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    quantum_efficiency: Float[Array, " taps"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    stretched: bool = eqx.field(static=True, default=False, kw_only=True)
    cell: tuple[int, int] = eqx.field(static=True, default=(1, 1), kw_only=True)
    names: tuple[str, ...] | None = eqx.field(static=True, default=None, kw_only=True)

    def __check_init__(self) -> None:
        factors = dict.fromkeys(("read_noise", "prnu", "quantum_efficiency"), NOT_NEGATIVE)
        check_fields(self, offset=FINITE, gain=POSITIVE, **factors)
        for name in ("offset", "gain", *factors):
            values = getattr(self, name)
            if values is not None:
                holder = f"Taps.{name}"
                check_tile("Taps.pattern", self.pattern, bands=values.shape[0], holder=holder)
        if self.names is not None:
            check_tile("Taps.pattern", self.pattern, bands=len(self.names), holder="Taps.names")
        whole = min(self.cell) > 0 and not np.any(np.remainder(np.shape(self.pattern), self.cell))
        if not whole or (self.cell != (1, 1) and not self.stretched):
            raise ValueError(
                f"Taps.cell {self.cell} must divide the rows and columns of a stretched pattern, "
                f"{np.shape(self.pattern)}."
            )


def _as_effects(effects: Any) -> Any:
    return None if effects is None else tuple(effects) or None


def _number_or_record(x: Any) -> Any:
    return x if isinstance(x, eqx.Module) else as_optional_float(x)


class Sensor(Shown):
    """An image sensor, CCD or CMOS, modelled after EMVA 1288. Every effect is optional; an effect
    that is `None` is omitted.

    The fields are in the order in which the effects act: on light before it is counted, on charge
    in the pixel (from `shot_noise` on), and during read-out (from `charge_transfer` on).

    Attributes:
        photon_conversion: conversion of irradiance to photons; None for input in photons per pixel
            and second, or per pixel and exposure without an `exposure_time`.
        light_offset: () or (bands,) photons per pixel that reach the sensor in each exposure, in
            addition to the input; may be negative. The offset also describes an exposure that is
            longer than stated. For a frame with a closed shutter, set it to None.
        infrared_cut: (bands,) transmission of a filter in front of the sensor, in [0, 1], no unit.
        quantum_efficiency: () or (bands,) electrons per photon, in [0, 1].
        colour_filter: filter over each pixel; None if every pixel measures every band.
        pixel_aperture: light-sensitive area of a pixel; None for the whole pixel.
        shutter: rolling shutter; None for a global shutter.
        exposure_time: () s, >= 0; None for input in counts per exposure.
        crosstalk: () share of a pixel's electrons that drift to each of its four neighbours, in [0,
            1/4], no unit.
        smear: () >= 0, no unit: the time that a CCD's charge spends under each other row while the
            frame is shifted, divided by the exposure time.
        prnu: () relative rms of the pixels' sensitivities, in [0, 0.5], no unit (1 % is 0.01).
        dead_pixels: () fraction of the pixels that do not respond to light, in [0, 1], no unit.
        dark_current: () e- s^-1 per pixel, >= 0, or its temperature law. Dark electrons are counted
            together with photoelectrons and have the same shot noise.
        hot_pixels: pixels with excess dark current.
        shot_noise: distribution of the electron count; None for the expectation.
        brighter_fatter: repulsion of later charge by the charge in a pixel.
        full_well: () e-, capacity of a pixel, >= 0; inf is allowed.
        blooming: () share of the excess over the full well that the anti-blooming gate does not
            drain and that spills along the column, in [0, 1], no unit; needs a `full_well`.
        charge_transfer: inefficiency of a CCD.
        own: user-defined effects on the charge, in their order.
        mixing: exchange of counted electrons between neighbours.
        nonlinearity: curve from charge to signal.
        conversion_prnu: () relative rms of the pixels' conversion gains, in [0, 0.5], no unit: of
            the amplifier (source follower) in each pixel of a CMOS sensor. Unlike `prnu` it scales
            the counted electrons.
        dsnu: () e- rms of the offsets of pixels, >= 0.
        column_dsnu: () e- rms of the offsets of columns, >= 0.
        row_dsnu: () e- rms of the offsets of rows, >= 0.
        reset_noise: kTC noise of the sense node; None if correlated double sampling removes it.
        read_noise: () e- rms per read-out, Gaussian, >= 0, or a distribution with a longer tail.
        telegraph_noise: pixels that switch between two levels.
        row_noise: () e- rms of an offset that each row draws anew in each frame, >= 0.
        column_noise: () e- rms of an offset that each column draws anew in each frame, >= 0.
        frame_noise: () e- rms of an offset that each frame draws anew, >= 0, such as black level
            drift.
        banding: an offset that oscillates over the rows.
        column_prnu: () relative rms of the gains of the column amplifiers, in [0, 0.5], no unit.
        gain: () DN per e-, > 0. The gain is proportional to a camera's ISO setting (by saturation,
            ISO 12232 defines the speed as 78 divided by the lx s that just fill the ADC's range).
        offset: () DN added before conversion (the black level).
        taps: parameters that differ between read-out amplifiers or sites of a mosaic.
        bits: () of the ADC, a whole number from 1 to the largest that the dtype represents exactly
            (11, 24 and 53 for float16, float32 and float64). The output is rounded to whole DN and
            clipped to [0, 2^bits - 1].

    Example:
        >>> camera = jv.Sensor(quantum_efficiency=0.6, read_noise=4.0, gain=0.5, bits=12)
        >>> camera.full_well is None  # an absent effect
        True
    """

    photon_conversion: PhotonConversion | None = eqx.field(default=None, kw_only=True)
    light_offset: Scalar | Colour | ShutterOffset | None = eqx.field(
        converter=_number_or_record, default=None, kw_only=True
    )
    infrared_cut: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    quantum_efficiency: Scalar | Colour | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    colour_filter: ColourFilter | None = eqx.field(default=None, kw_only=True)
    pixel_aperture: PixelAperture | None = eqx.field(default=None, kw_only=True)
    shutter: RollingShutter | None = eqx.field(default=None, kw_only=True)
    exposure_time: Scalar | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    crosstalk: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    smear: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    prnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    dead_pixels: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    dark_current: Scalar | DarkCurrent | None = eqx.field(
        converter=_number_or_record, default=None, kw_only=True
    )
    hot_pixels: HotPixels | None = eqx.field(default=None, kw_only=True)
    shot_noise: ShotNoise | None = eqx.field(default=None, kw_only=True)
    brighter_fatter: BrighterFatter | None = eqx.field(default=None, kw_only=True)
    full_well: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    blooming: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    charge_transfer: ChargeTransfer | None = eqx.field(default=None, kw_only=True)
    own: tuple[SensorEffect, ...] | None = eqx.field(
        converter=_as_effects, default=None, kw_only=True
    )
    mixing: Mixing | None = eqx.field(default=None, kw_only=True)
    nonlinearity: Nonlinearity | None = eqx.field(default=None, kw_only=True)
    conversion_prnu: Scalar | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    dsnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    column_dsnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    row_dsnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    reset_noise: ResetNoise | None = eqx.field(default=None, kw_only=True)
    read_noise: Scalar | HeavyTailedReadNoise | None = eqx.field(
        converter=_number_or_record, default=None, kw_only=True
    )
    telegraph_noise: TelegraphNoise | None = eqx.field(default=None, kw_only=True)
    row_noise: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    column_noise: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    frame_noise: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    banding: Banding | None = eqx.field(default=None, kw_only=True)
    column_prnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    gain: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    offset: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    taps: Taps | None = eqx.field(default=None, kw_only=True)
    bits: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, **_RANGES)
        for name in ("prnu", "conversion_prnu", "column_prnu"):
            spread = getattr(self, name)
            if spread is not None and is_known(spread) and float(spread) > MOST_UNEVEN:
                raise ValueError(
                    f"Sensor.{name} is a share of at most {MOST_UNEVEN:g}, 1 % being 0.01, got "
                    f"{float(spread):g}."
                )
        if self.bits is not None:
            check_range("Sensor.bits", self.bits, 1, jnp.finfo(self.bits.dtype).nmant + 1)
            if is_known(self.bits) and not float(self.bits).is_integer():
                raise ValueError(f"Sensor.bits must be a whole number, got {self.bits}.")
        for i, effect in enumerate(self.own or ()):
            check_kind(f"Sensor.own[{i}]", effect, SensorEffect)
        if self.blooming is not None and self.full_well is None:
            raise ValueError("Sensor.full_well must be given with blooming, got None.")
        if isinstance(self.light_offset, ShutterOffset) and self.exposure_time is None:
            raise ValueError("Sensor.exposure_time must be given with a ShutterOffset, got None.")
        for name in ("read_noise", "prnu"):
            if getattr(self.taps, name, None) is not None and getattr(self, name) is None:
                raise ValueError(f"Sensor.{name} must be given with Taps.{name}, got None.")


_RANGES = {
    "infrared_cut": FRACTION,
    "quantum_efficiency": FRACTION,
    "exposure_time": NOT_NEGATIVE,
    "crosstalk": Range(0, 0.25),
    "smear": NOT_NEGATIVE,
    "prnu": NOT_NEGATIVE,
    "dead_pixels": FRACTION,
    "dark_current": NOT_NEGATIVE,
    "full_well": Range(0, finite=False),
    "blooming": FRACTION,
    "conversion_prnu": NOT_NEGATIVE,
    "dsnu": NOT_NEGATIVE,
    "column_dsnu": NOT_NEGATIVE,
    "row_dsnu": NOT_NEGATIVE,
    "read_noise": NOT_NEGATIVE,
    "row_noise": NOT_NEGATIVE,
    "column_noise": NOT_NEGATIVE,
    "frame_noise": NOT_NEGATIVE,
    "light_offset": FINITE,
    "column_prnu": NOT_NEGATIVE,
    "gain": POSITIVE,
    "offset": FINITE,
}
