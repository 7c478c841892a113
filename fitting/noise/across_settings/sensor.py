"""A calibrated camera as a sensor at any gain and temperature in its range."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import ArrheniusDarkCurrent, PoissonShotNoise, Sensor
from jaxvision.camera_files import write_sensor
from jaxvision.errors import InputError

from ...inference.parameters import to_unconstrained
from ...inference.precision import in_double
from ..levels import PhotonTransfer
from ..sensor import DRAWS
from ..settings import Setting
from .calibration import CameraCalibration
from .model import figures, no_deviations, parts
from .pooled import Pooled


@in_double
def sensor_at(
    calibration: CameraCalibration,
    *,
    gain: float | None = None,
    temperature: float | None = None,
) -> tuple[Sensor, Sensor]:
    """The sensor of a camera at one gain and temperature.

    At a gain between two that were measured, ln K is linear in the logarithm of the stated gain,
    and so is the logarithm of a read noise without law; the black level is linear in it. Dark
    current is a law of temperature (`ArrheniusDarkCurrent`) where one was found, and else linear
    between the temperatures. Fixed patterns and full well are the best fit's in every draw.
    Exposure is the median of the flats', so that light is photons per pixel and second.

    Args:
        calibration: of the camera.
        gain: as the settings state it (an ISO speed, or dB); None where there is one alone.
        temperature: K; None where there is one alone.

    Returns:
        The best fit; and the same with a leading axis of draws at every number.

    Raises:
        InputError: for a gain or a temperature out of the range that was measured, and for more
            electrons than photons.
    """
    if is_impossible(calibration):
        raise InputError("More electrons are counted than photons arrive; correct the photons.")
    stated = _within([s.gain for s in calibration.settings], gain, "gain")
    warmth = _within([s.temperature for s in calibration.settings], temperature, "temperature")
    unit = calibration.settings[0].gain_unit
    factor = Setting(stated, unit).gain_factor
    space, samples = calibration.posterior.space, calibration.posterior.samples
    rows = np.linspace(0, len(samples) - 1, min(DRAWS, len(samples))).astype(int)
    drawn = to_unconstrained(space, jnp.asarray(samples[rows]))
    vectors = jnp.concatenate([calibration.fit.solution.vector[None], drawn])

    @jax.jit
    def sensors(vectors: Float[Array, "draws parameters"]) -> Sensor:
        return eqx.filter_vmap(lambda one: _sensor(calibration, one, factor, warmth))(vectors)

    every = sensors(vectors)
    return jax.tree.map(lambda x: x[0], every), jax.tree.map(lambda x: x[1:], every)


def write_sensor_at(calibration: CameraCalibration, gain: float | None, path: Path) -> None:
    """Writes the sensor at a gain and the warmest temperature, its draws beside it.

    Args:
        calibration: of the camera.
        gain: as the settings state it; None where there is one alone.
        path: ending in .toml.
    """
    warmest = calibration.fit.reference
    best, draws = sensor_at(calibration, gain=gain, temperature=warmest)
    at = Setting(gain, calibration.settings[0].gain_unit, warmest).label
    about = f"Fitted by photon transfer over gains and temperatures, at {at}; light is photons per "
    write_sensor(best, path, draws=draws, about=about + "pixel and second.")


def is_impossible(calibration: CameraCalibration) -> bool:
    """Whether more electrons are counted than photons arrive at some setting.

    Args:
        calibration: of a camera.
    """
    at = calibration.figures
    return at.log_efficiency is not None and bool(jnp.max(at.log_efficiency) > 0)


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
    calibration: CameraCalibration, vector: Array, factor: float, warmth: float | None
) -> Sensor:
    fit = calibration.fit
    at = figures(fit.model, vector, no_deviations(len(fit.settings)))
    log_factor = np.log([s.gain_factor for s in fit.settings])
    kelvin = np.array([s.temperature or 1.0 for s in fit.settings])

    def between(values: Array) -> Array:
        return _interpolated(values, log_factor, float(np.log(factor)), kelvin, warmth or 1.0)

    gain = jnp.exp(between(at.log_gain))
    if fit.model.read_noise_law:
        before, behind = parts(fit.model, vector)[2]
        variance = before + behind / gain**2
    else:
        variance = jnp.exp(between(jnp.log(at.read_variance)))
    lit = [one.frames for one in calibration.frames if isinstance(one.frames, PhotonTransfer)]
    scale = lit[0].full_scale
    black = jnp.asarray([_black(one.frames) for one in calibration.frames])
    efficiency = None if at.log_efficiency is None else jnp.exp(between(at.log_efficiency))
    dark = None
    if at.dark_current is not None:
        dark = jnp.maximum(between(at.dark_current), 0)
        if fit.model.dark_current_law:
            log_rate, energy = parts(fit.model, vector)[3]
            dark = ArrheniusDarkCurrent(
                jnp.exp(log_rate), warmth, reference_temperature=fit.reference,
                activation_energy=jnp.maximum(energy, 0),
            )  # fmt: skip
    return Sensor(
        shot_noise=PoissonShotNoise(),
        exposure_time=jnp.median(jnp.concatenate([one.bright.exposure for one in lit])),
        quantum_efficiency=efficiency,
        read_noise=jnp.sqrt(jnp.maximum(variance, 0)),
        dark_current=dark,
        full_well=_value(calibration.full_well),
        gain=gain,
        offset=between(black),
        dsnu=_deviation(calibration.dsnu),
        prnu=_deviation(calibration.prnu),
        bits=None if scale is None else float(np.log2(scale + 1)),
    )


def _black(frames: object) -> Array:
    """DN, of the shortest dark."""
    dark = frames.dark if isinstance(frames, PhotonTransfer) else frames
    return dark.mean[jnp.argmin(dark.exposure)]  # pyright: ignore


def _interpolated(
    values: Float[Array, " settings"],
    log_factor: Float[np.ndarray, " settings"],
    at_factor: float,
    kelvin: Float[np.ndarray, " settings"],
    at_kelvin: float,
) -> Array:
    """Linear over temperature at each measured gain, then linear over the logarithm of gain."""
    factors = np.unique(log_factor)
    at_gains = []
    for one in factors:
        own = np.flatnonzero(log_factor == one)
        own = own[np.argsort(kelvin[own])]
        at_gains.append(jnp.interp(at_kelvin, kelvin[own], values[own]))
    return jnp.interp(at_factor, jnp.asarray(factors), jnp.stack(at_gains))


def _value(pooled: Pooled | None) -> float | None:
    return None if pooled is None or not pooled.serves else pooled.value


def _deviation(pooled: Pooled | None) -> float | None:
    """Square root of a pattern's variance, where it is seen and shared."""
    if pooled is None or not pooled.serves or not pooled.seen:
        return None
    return float(np.sqrt(pooled.value))
