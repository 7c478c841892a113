"""A calibrated camera as a sensor at any gain and temperature in its range."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxvision import ArrheniusDarkCurrent, PoissonShotNoise, Sensor
from jaxvision.errors import InputError
from jaxvision.files.cameras import write_sensor

from ...inference.precision import double_precision
from ...inference.problem import values_from
from ...rig import Camera
from ..levels import Levels, PhotonTransfer
from ..sensor import DRAWS, bits_of, codes_in_words
from ..settings import Setting
from ..sites import joined_sensors
from .calibration import CameraCalibration
from .statement import figures


@double_precision
def sensor_at(
    calibration: CameraCalibration,
    *,
    gain: float | None = None,
    temperature: float | None = None,
) -> tuple[Sensor, Sensor]:
    """The sensor of a camera at one gain and temperature.

    Between two measured gains, ln K is linear in the logarithm of the stated gain. So are the black
    level and the logarithm of a read noise without a law. Dark current follows its law of
    temperature (`ArrheniusDarkCurrent`) if there is one. Otherwise it is interpolated linearly
    between the temperatures. Fixed patterns and full well have the values of the best fit in every
    draw. The exposure is the median of the flats' exposures, so light is a rate in photons per
    pixel and second. If the numbers of the nearest measured gain are multiples of a step, as
    left-aligned ones are, the sensor gives the converter's own codes.

    Args:
        calibration: of the camera.
        gain: in the unit of the settings (an ISO speed, or dB); None where there is only one.
        temperature: K; None where there is only one.

    Returns:
        The best fit; and the same sensor with a leading axis of draws at every number.

    Raises:
        InputError: for a gain or a temperature outside the measured range, and for more electrons
            than photons.
    """
    if calibration.is_impossible:
        raise InputError("More electrons are counted than photons arrive; correct the photons.")
    stated = _within([s.gain for s in calibration.settings], gain, "gain")
    warmth = _within([s.temperature for s in calibration.settings], temperature, "temperature")
    unit = calibration.settings[0].gain_unit
    factor = Setting(stated, unit).gain_factor
    posterior = calibration.posterior
    rows = np.linspace(0, len(posterior.samples) - 1, min(DRAWS, len(posterior.samples)))
    drawn = np.concatenate([posterior.mode[None], posterior.samples[rows.astype(int)]])
    every = eqx.filter_jit(jax.vmap(partial(_sensor, calibration, factor, warmth)))(
        jnp.asarray(drawn)
    )
    return jax.tree.map(lambda x: x[0], every), jax.tree.map(lambda x: x[1:], every)


def write_sensor_at(calibration: CameraCalibration, gain: float | None, path: Path) -> None:
    """Write the sensor at a stated gain and the warmest temperature, with its draws in a second
    file."""
    warmest = calibration.fit.reference
    best, draws = sensor_at(calibration, gain=gain, temperature=warmest)
    unit = calibration.settings[0].gain_unit
    at = Setting(gain, unit, warmest).label
    about = f"Fitted by photon transfer over gains and temperatures, at {at}; light is photons per "
    codes = codes_in_words(_nearest(calibration, Setting(gain, unit).gain_factor).converter)
    write_sensor(best, path, draws=draws, about=f"{about}pixel and second.{codes}")


@double_precision
def write_sensor_of_sites_at(
    calibrations: Mapping[str, CameraCalibration], camera: Camera, gain: float | None, path: Path
) -> None:
    """As `write_sensor_at`, for a camera whose sites were calibrated separately."""
    warmest = next(iter(calibrations.values())).fit.reference
    each = [sensor_at(calibrations[s], gain=gain, temperature=warmest) for s in camera.sites]
    best, draws = joined_sensors(each, camera)
    about = (
        f"Fitted by photon transfer over gains and temperatures; taps are {', '.join(camera.sites)}"
    )
    write_sensor(best, path, draws=draws, about=f"{about}; light is photons per pixel and second.")


def _nearest(calibration: CameraCalibration, factor: float) -> PhotonTransfer:
    """The flats and darks of the measured gain nearest to a gain factor."""
    lit = [
        (abs(np.log(one.setting.gain_factor / factor)), one.frames)
        for one in calibration.frames
        if isinstance(one.frames, PhotonTransfer)
    ]
    return min(lit, key=lambda pair: pair[0])[1]


def _within(known: list[float | None], asked: float | None, word: str) -> float | None:
    stated = sorted({one for one in known if one is not None})
    if asked is None:
        if len(stated) > 1:
            raise InputError(f"Give the {word}, from {stated[0]:g} to {stated[-1]:g}.")
        return stated[0] if stated else None
    if not stated or not stated[0] <= asked <= stated[-1]:
        told = (
            f"it was measured from {stated[0]:g} to {stated[-1]:g}" if stated else "none was told"
        )
        raise InputError(f"{word} = {asked:g} is out of range: {told}.")
    return asked


def _sensor(
    calibration: CameraCalibration, factor: float, warmth: float | None, natural: Array
) -> Sensor:
    """The sensor for parameters in natural units, at a gain factor and a temperature in K."""
    problem = calibration.fit.fit.problem
    values = values_from(problem, natural)
    at = figures(values, problem.inputs)
    log_factor = np.log([s.gain_factor for s in calibration.settings])
    kelvin = np.array([s.temperature or 1.0 for s in calibration.settings])

    def between(values: Array) -> Array:
        """Interpolate linearly over temperature at each measured gain, then over the logarithm of
        the gain."""
        at_gains = []
        for one in np.unique(log_factor):
            own = np.flatnonzero(log_factor == one)
            own = own[np.argsort(kelvin[own])]
            at_gains.append(jnp.interp(warmth or 1.0, kelvin[own], values[own]))
        places = jnp.asarray(np.unique(log_factor))
        return jnp.interp(np.log(factor), places, jnp.stack(at_gains))

    gain = jnp.exp(between(at.log_gain))
    if "variance_before_gain" in values:
        variance = values["variance_before_gain"] + values["variance_behind_gain"] / gain**2
    else:
        variance = jnp.exp(between(jnp.log(at.read_variance)))
    frames = [one.frames for one in calibration.frames]
    darks = [one if isinstance(one, Levels) else one.dark for one in frames]
    lit = [one for one in frames if isinstance(one, PhotonTransfer)]
    scale, converter = lit[0].full_scale, _nearest(calibration, factor).converter
    step = converter.step or 1.0
    shortest = [jnp.argmin(one.exposure) for one in darks]
    black = jnp.stack([one.mean[i] for one, i in zip(darks, shortest, strict=True)])
    if at.dark_current is not None:
        times = jnp.stack([one.exposure[i] for one, i in zip(darks, shortest, strict=True)])
        black = black - jnp.exp(at.log_gain) * at.dark_current * times
    dark = None
    if "activation_energy" in values:
        dark = ArrheniusDarkCurrent(
            values["dark_current"], warmth, reference_temperature=calibration.fit.reference,
            activation_energy=jnp.maximum(values["activation_energy"], 0),
        )  # fmt: skip
    elif at.dark_current is not None:
        dark = jnp.maximum(between(at.dark_current), 0)
    well, dsnu, prnu = (
        None if one is None or not one.serves else one.value
        for one in (
            calibration.full_well,
            *(
                one if one and one.significant else None
                for one in (calibration.dsnu, calibration.prnu)
            ),
        )
    )
    efficiency, above = None, 1.0
    if at.log_efficiency is not None:  # no more than an electron for each photon
        efficiency = jnp.exp(between(at.log_efficiency))
        above = jnp.maximum(efficiency, 1.0)
        efficiency = efficiency / above
    return Sensor(
        shot_noise=PoissonShotNoise(),
        exposure_time=jnp.median(jnp.concatenate([one.bright.exposure for one in lit])),
        quantum_efficiency=efficiency,
        read_noise=jnp.sqrt(jnp.maximum(variance, 0)) / above,
        dark_current=dark,
        full_well=well,
        gain=gain * above / step,
        offset=(between(black) - converter.origin) / step,
        dsnu=None if dsnu is None else np.sqrt(dsnu),
        prnu=None if prnu is None else np.sqrt(prnu),
        bits=None if scale is None else bits_of(scale, converter),
    )
