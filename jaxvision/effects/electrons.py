"""Derive quantities from a sensor's parameters: photoelectrons, dark rates, and variances of
read-out noise.

Values are NumPy float64, in electrons unless stated otherwise.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..scene import (
    ArrheniusDarkCurrent,
    DoublingDarkCurrent,
    HeavyTailedReadNoise,
    PixelAperture,
    ShutterOffset,
)
from ..sensor.dark import BOLTZMANN, ELEMENTARY_CHARGE
from ..sensor.exposure import PLANCK, SPEED_OF_LIGHT


def freed(sensor: Mapping[str, Any], irradiance: np.ndarray) -> float:
    """Return the number of photoelectrons per exposure in the most sensitive pixel. `irradiance`,
    (bands,), is in W m^-2, or in photons s^-1 per pixel. `sensor` holds the fields of a sensor by
    name, with None for dropped effects.
    """
    photons = np.asarray(irradiance, float)
    conversion = sensor["photon_conversion"]
    if conversion is not None:
        per_joule = np.asarray(conversion.wavelength, float) / (PLANCK * SPEED_OF_LIGHT)
        photons = photons * float(conversion.pixel_area) * per_joule
    return detected(sensor, photons) * exposure(sensor)


def detected(sensor: Mapping[str, Any], photons: np.ndarray) -> float:
    """Return the number of photoelectrons in the pixel with the most light behind its filters."""
    electrons = photons
    with np.errstate(invalid="ignore"):  # 0 times inf: no bound is known
        for factor in (sensor["infrared_cut"], sensor["quantum_efficiency"]):
            electrons = electrons if factor is None else electrons * np.asarray(factor, float)
        if sensor["colour_filter"] is not None:
            electrons = np.asarray(sensor["colour_filter"].transmission, float) @ electrons
    if sensor["pixel_aperture"] is not None:
        electrons = electrons * share_of_light(sensor["pixel_aperture"])
    return float(np.max(electrons))


def light_offset_electrons(sensor: Mapping[str, Any], irradiance: np.ndarray) -> float:
    """Return the largest number of electrons that the light offset adds or removes."""
    match sensor["light_offset"]:
        case None:
            return 0.0
        case ShutterOffset(time=time):
            return freed(dict(sensor, exposure_time=np.abs(time)), irradiance)
        case photons:
            beside = np.broadcast_to(np.abs(np.asarray(photons, float)), np.shape(irradiance))
            return detected(sensor, beside)


def share_of_light(aperture: PixelAperture) -> float:
    """Return the share of the light on a pixel that its aperture collects."""
    fill = float(aperture.fill_factor)
    return fill if aperture.microlens is None else fill + float(aperture.microlens) * (1 - fill)


def exposure(sensor: Mapping[str, Any]) -> float:
    """Return the exposure time, in s, or 1 for a sensor without exposure time, whose rates are
    counts per exposure."""
    return 1.0 if sensor["exposure_time"] is None else float(sensor["exposure_time"])


def read_out_variances(sensor: Mapping[str, Any]) -> dict[str, float]:
    """Return the variance, in electrons^2, of each noise or fixed pattern that is added after the
    charge is converted to a voltage, by the name of its field. `sensor` holds the fields of a
    sensor by name, with None for dropped effects."""
    found = {}
    for name in ("dsnu", "column_dsnu", "row_dsnu", "row_noise", "column_noise", "frame_noise"):
        if sensor[name] is not None:
            found[name] = float(sensor[name]) ** 2
    if sensor["reset_noise"] is not None:
        reset = sensor["reset_noise"]
        thermal = BOLTZMANN * float(reset.temperature) * float(reset.capacitance)
        found["reset_noise"] = thermal / ELEMENTARY_CHARGE**2
    match sensor["read_noise"]:
        case None:
            pass
        case HeavyTailedReadNoise(rms=rms, tail_rms=tail, tail_fraction=fraction):
            share = float(fraction)
            found["read_noise"] = (1 - share) * float(rms) ** 2 + share * float(tail) ** 2
        case rms:
            found["read_noise"] = float(rms) ** 2
    if sensor["banding"] is not None:
        found["banding"] = float(sensor["banding"].amplitude) ** 2 / 2
    return found


def kernel_slopes(kernel: Any) -> float:
    """Return half of the sum of |K_l - K_(l + neighbour)| over offsets l, per electron."""
    rows, columns = (np.abs(np.arange(1 - n, n)) for n in np.shape(kernel))
    whole = np.pad(np.asarray(kernel, float)[np.ix_(rows, columns)], 1)
    return float(sum(np.abs(np.diff(whole, axis=axis)).sum() for axis in (0, 1))) / 2


def dark_rate(law: Any) -> float:
    """Return the rate, in e- s^-1, of a dark current that is given as a number or as a law of
    temperature."""
    match law:
        case DoublingDarkCurrent():
            warmer = float(law.temperature) - float(law.reference_temperature)
            return float(law.rate) * 2 ** (warmer / float(law.doubling))
        case ArrheniusDarkCurrent():
            colder = 1 / float(law.reference_temperature) - 1 / float(law.temperature)
            kelvin = float(law.activation_energy) * ELEMENTARY_CHARGE / BOLTZMANN
            return float(law.rate) * math.exp(kelvin * colder)
        case _:
            return float(law)
