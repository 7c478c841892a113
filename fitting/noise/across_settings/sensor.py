"""Conversion of a calibrated camera to a sensor at any gain and temperature in the measured range.

The shared parameters (gain, efficiency, read noise, dark current, fixed pattern) come from the
joint fit to all settings. All other effects come from the separate fit of the nearest setting with
flats, conditioned on the shared parameters. Let (s, r) be a draw of that separate fit, with s the
shared parameters, r the other parameters and C the covariance of both. If s* is a draw of the
shared parameters from the joint fit, r is replaced by r + C_rs C_ss^-1 (s* - s).

Source:
    Journel & Huijbregts, "Mining Geostatistics", 1978, section VII.A (Matheron's conditioning).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxvision import ArrheniusDarkCurrent, Sensor
from jaxvision.errors import InputError
from jaxvision.files.cameras import write_sensor

from ...inference.parameters import to_natural, to_unconstrained
from ...inference.precision import double_precision
from ...inference.problem import values_from
from ...rig import Camera
from ..levels import Levels, PhotonTransfer
from ..sensor import (
    DRAWS,
    Numbers,
    best_and_draws,
    codes_in_words,
    drawn_numbers,
    full_well,
    mode_without,
    sensors_of,
)
from ..settings import Setting
from ..sites import joined_sensors
from .calibration import CameraCalibration
from .statement import Figures, figures


@double_precision
def sensor_at(
    calibration: CameraCalibration,
    *,
    gain: float | None = None,
    temperature: float | None = None,
) -> tuple[Sensor, Sensor]:
    """Return the sensor of a calibrated camera at one gain and temperature.

    Between two measured gains, the logarithm of the conversion gain K is linear in the logarithm of
    the stated gain. The black level is interpolated in the same way, and so is the logarithm of the
    read noise if the read noise has no fitted law. Dark current follows a law of temperature
    (`ArrheniusDarkCurrent`) if one was fitted. Otherwise dark current is interpolated linearly
    between the temperatures. Compression, light offset, mixing, the brighter-fatter effect and
    noise of rows, columns and frames are those of the nearest setting with flats, in electrons. The
    full well comes from settings at which the well fills before the converter's range ends. In
    every draw, DSNU and PRNU have the values of the best fit. The sensor's exposure time is the
    median of the flats' exposures, and its light is in photons per pixel and second. If all numbers
    in the frames of the nearest setting are multiples of a step, as left-aligned numbers are, the
    sensor's output is the number divided by that step.

    Args:
        calibration: the calibration of the camera at several settings.
        gain: stated gain in the unit of the settings (an ISO speed, or dB); None if there is only
            one gain.
        temperature: K; None if there is only one temperature.

    Returns:
        Two sensors: the best fit, and one whose numbers have a leading axis of posterior draws.

    Raises:
        InputError: for a gain or a temperature outside the measured range, and for more electrons
            than photons.
    """
    return sensor_without(calibration, {}, gain=gain, temperature=temperature)


def sensor_without(
    calibration: CameraCalibration,
    left_out: Mapping[Setting, Bool[np.ndarray, " levels"] | None],
    *,
    gain: float | None,
    temperature: float | None,
) -> tuple[Sensor, Sensor]:
    """Return the sensors of `sensor_at`, from fits without the levels in `left_out`."""
    if calibration.is_impossible:
        raise InputError("More electrons are counted than photons arrive; correct the photons.")
    settings, posterior = calibration.settings, calibration.posterior
    stated = _check_range([s.gain for s in settings], gain, "gain")
    warmth = _check_range([s.temperature for s in settings], temperature, "temperature")
    factor = Setting(stated, settings[0].gain_unit).gain_factor
    weights = _weights(settings, factor, warmth)
    rows = np.linspace(0, len(posterior.samples) - 1, min(DRAWS, len(posterior.samples)))
    drawn = np.concatenate([posterior.mode[None], posterior.samples[rows.astype(int)]])
    problem = calibration.fit.fit.problem
    values = jax.vmap(partial(values_from, problem))(jnp.asarray(drawn))
    at = jax.vmap(lambda own: figures(own, problem.inputs))(values)
    at = jax.tree.map(np.asarray, at)
    calibrations = {i: one for i, one in enumerate(calibration.calibrations) if one is not None}
    nearest = min(calibrations, key=lambda i: _distance(settings[i], factor, warmth))
    numbers = {
        i: _condition_on_shared(calibration, i, at, left_out.get(settings[i]))
        for i in calibrations
        if i == nearest or weights[i]
    }
    black = sum(
        weights[i] * _black_level(calibration, i, at, numbers.get(i))
        for i in np.flatnonzero(weights).tolist()
    )
    if "variance_before_gain" in values:
        behind = values["variance_behind_gain"] * np.exp(-2 * at.log_gain @ weights)
        read = values["variance_before_gain"] + behind
    else:
        read = np.exp(np.log(at.read_variance) @ weights)
    here = numbers[nearest]
    fitted = {"black_level": black, "read_noise": np.sqrt(np.maximum(read, 0))}
    if at.log_efficiency is not None:
        fitted["responsivity"] = here.parameter("system_gain") * np.exp(at.log_efficiency @ weights)
    every = sensors_of(here.replace_parameters(fitted))
    same = np.ones_like(black)
    lit = [one.frames for one in calibration.frames if isinstance(one.frames, PhotonTransfer)]
    exposures = np.concatenate([np.asarray(one.bright.exposure) for one in lit])
    shared = {"exposure_time": np.median(exposures)} | _pattern(calibration)
    if "full_well" not in here.beside:  # the converter's range ends before the well is full
        wells = {i: full_well(one) for i, one in calibrations.items()}
        filled = [w[0] / np.exp(at.log_gain[0, i]) for i, w in wells.items() if w is not None]
        if filled:
            shared["full_well"] = np.median(filled)
    shared = {name: value * same for name, value in shared.items()}
    shared["gain"] = every.gain * np.exp(at.log_gain @ weights) / here.parameter("system_gain")
    law = None
    if "activation_energy" in values:
        energy = jnp.maximum(values["activation_energy"], 0)
        law = values["dark_current"], warmth * same, calibration.fit.reference * same, energy
    elif at.dark_current is not None:
        shared["dark_current"] = np.maximum(at.dark_current @ weights, 0)
    return best_and_draws(eqx.filter_vmap(_sensor)(every, shared, law))


def _sensor(own: Sensor, shared: dict[str, Array], law: tuple[Array, ...] | None) -> Sensor:
    """Return the sensor of a setting's own fit with the fields that settings share replaced."""
    if law is not None:
        current, warmth, reference, energy = law
        current = ArrheniusDarkCurrent(
            current, warmth, reference_temperature=reference, activation_energy=energy
        )
        return replace(own, **shared, dark_current=current)
    return replace(own, **{"dark_current": None} | shared)


def _weights(
    settings: Sequence[Setting], factor: float, warmth: float | None
) -> Float[np.ndarray, " settings"]:
    """Return the weights of the settings in an interpolation over temperature, then log gain."""
    log_factor = np.log([s.gain_factor for s in settings])
    kelvin = np.array([s.temperature or 1.0 for s in settings])
    every, gains = np.eye(len(settings)), np.unique(log_factor)

    def interpolate(x: float, places: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return np.array([np.interp(x, places, column) for column in rows.T])

    at_gains = []
    for one in gains:
        own = np.flatnonzero(log_factor == one)
        own = own[np.argsort(kelvin[own])]
        at_gains.append(interpolate(warmth or 1.0, kelvin[own], every[own]))
    return interpolate(np.log(factor), gains, np.array(at_gains))


def _distance(setting: Setting, factor: float, warmth: float | None) -> tuple[float, float]:
    """Return the distance of a setting in log gain and in temperature, K."""
    by_gain = abs(float(np.log(setting.gain_factor / factor)))
    return by_gain, abs((setting.temperature or 0.0) - (warmth or 0.0))


def _condition_on_shared(
    calibration: CameraCalibration,
    i: int,
    at: Figures,
    left_out: Bool[np.ndarray, " levels"] | None,
) -> Numbers:
    """Return draws of setting `i` from its own fit, conditioned on the joint fit."""
    own, known = calibration.calibrations[i], calibration.fit.by_setting[i].names
    assert own is not None
    numbers, covariance = drawn_numbers(own, left_out=left_out), own.posterior.covariance
    if left_out is not None:
        covariance = mode_without(own, left_out)[1]
    gain, dark = at.log_gain[:, i], at.dark_current
    shared = {
        "system_gain": gain,
        "responsivity": gain if at.log_efficiency is None else gain + at.log_efficiency[:, i],
        "read_noise": np.log(np.maximum(at.read_variance[:, i], np.finfo(float).tiny)) / 2,
        "dark_current": gain if dark is None else dark[:, i],
    }
    space, count = own.posterior.space, len(gain) - 1
    place = [numbers.about.labels.index(name) for name in known]
    drawn = 1 + np.linspace(0, len(numbers.natural) - 2, count).astype(int)
    numbers = numbers.select_draws(np.concatenate([[0], drawn]))
    vectors = np.asarray(to_unconstrained(space, jnp.asarray(numbers.natural)))
    missed = np.stack([shared[name] for name in known], axis=1) - vectors[:, place]
    slope = np.linalg.solve(covariance[np.ix_(place, place)], covariance[place])
    natural = np.asarray(to_natural(space, jnp.asarray(vectors + missed @ slope)))
    return replace(numbers, natural=natural)


def _black_level(
    calibration: CameraCalibration, i: int, at: Figures, numbers: Numbers | None
) -> Float[np.ndarray, " draws"]:
    """Return the black level of a setting without dark current, DN."""
    frames = calibration.frames[i].frames
    darks = frames if isinstance(frames, Levels) else frames.dark
    weight = np.asarray(darks.frames) / np.asarray(darks.variance)
    mean, exposure = (
        float(np.average(np.asarray(one), weights=weight)) for one in (darks.mean, darks.exposure)
    )
    black = np.full(len(at.log_gain), mean)
    if numbers is not None:
        black = numbers.parameter("black_level")
        exposure *= "dark_current" not in numbers.about.labels
    if at.dark_current is None:
        return black
    return black - np.exp(at.log_gain[:, i]) * at.dark_current[:, i] * exposure


def _pattern(calibration: CameraCalibration) -> dict[str, float]:
    """Return DSNU and PRNU, averaged over the settings, as fields of a sensor."""
    found = {}
    for name in ("dsnu", "prnu"):
        pooled = getattr(calibration, name)
        if pooled is None or not (pooled.serves and pooled.significant):
            continue
        own, rows, columns = (*(part.variance for part in pooled.parts), 0.0, 0.0, 0.0)[:3]
        if name == "prnu":  # a sensor has no field for the gains of rows
            own, rows = own + rows, 0.0
        total = own + rows + columns
        for field, part in ((name, own), (f"row_{name}", rows), (f"column_{name}", columns)):
            if part > 0:
                found[field] = float(np.sqrt(pooled.value * part / total))
    return found


def write_sensor_at(calibration: CameraCalibration, gain: float | None, path: Path) -> None:
    """Write the sensor at a stated gain and the warmest temperature, and its draws."""
    warmest = calibration.fit.reference
    best, draws = sensor_at(calibration, gain=gain, temperature=warmest)
    at = Setting(gain, calibration.settings[0].gain_unit, warmest)
    about = (
        f"Fitted by photon transfer over gains and temperatures, at {at.label}; light is photons "
    )
    lit = [one for one in calibration.frames if isinstance(one.frames, PhotonTransfer)]
    nearest = min(lit, key=lambda one: _distance(one.setting, at.gain_factor, warmest))
    codes = codes_in_words(nearest.frames.converter)
    write_sensor(best, path, draws=draws, about=f"{about}per pixel and second.{codes}")


@double_precision
def write_sensor_of_sites_at(
    calibrations: Mapping[str, CameraCalibration], camera: Camera, gain: float | None, path: Path
) -> None:
    """Write sensor and draws as `write_sensor_at` does, for a camera whose mosaic sites were
    calibrated separately."""
    warmest = next(iter(calibrations.values())).fit.reference
    each = [sensor_at(calibrations[s], gain=gain, temperature=warmest) for s in camera.sites]
    best, draws = joined_sensors(each, camera)
    about = (
        f"Fitted by photon transfer over gains and temperatures; taps are {', '.join(camera.sites)}"
    )
    write_sensor(best, path, draws=draws, about=f"{about}; light is photons per pixel and second.")


def _check_range(known: list[float | None], asked: float | None, word: str) -> float | None:
    stated = sorted({one for one in known if one is not None})
    if asked is None:
        if len(stated) > 1:
            raise InputError(f"Give the {word}, from {stated[0]:g} to {stated[-1]:g}.")
        return stated[0] if stated else None
    if not stated or not stated[0] <= asked <= stated[-1]:
        sentence = (
            f"it was measured from {stated[0]:g} to {stated[-1]:g}" if stated else "none was stated"
        )
        raise InputError(f"{word} = {asked:g} is out of range: {sentence}.")
    return asked
