"""A calibrated camera as a sensor that predicts: the best fit, and draws of it."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import PoissonShotNoise, Sensor
from jaxvision.files.cameras import write_sensor

from ..inference.parameters import names
from .brighter_fatter import fitted_effect, fitted_kernel
from .calibration import NoiseCalibration

DRAWS = 1000  # kept at most


def fitted_sensor(calibration: NoiseCalibration) -> tuple[Sensor, Sensor]:
    """The sensor of a calibration.

    Gain and efficiency are those at zero signal: a compression of the chosen model has no place in
    a `Sensor`, and so has a mixing of pixels. Patterns and the shape of the kernel by which charges
    repel each other are the best fit's in every draw. Exposure is the median of the flats', so
    that light is a rate, photons per pixel and second. Where the numbers of the frames are
    multiples of a step, as left-aligned ones are, the sensor gives the converter's own codes.

    Args:
        calibration: of the camera, with an efficiency of at most 1.

    Returns:
        The best fit; and the same with a leading axis of draws at every number.
    """
    posterior = calibration.posterior
    rows = np.linspace(0, len(posterior.samples) - 1, min(DRAWS, len(posterior.samples)))
    drawn = jnp.asarray(posterior.samples[rows.astype(int)])
    kernel = fitted_kernel(calibration.measurement, calibration.usable)
    best = _sensor(calibration, kernel, jnp.asarray(posterior.mode))
    return best, eqx.filter_vmap(lambda values: _sensor(calibration, kernel, values))(drawn)


def write_fitted_sensor(calibration: NoiseCalibration, path: Path) -> None:
    """Writes the sensor of a calibration, its draws beside it.

    Args:
        calibration: of the camera.
        path: ending in .toml.
    """
    best, draws = fitted_sensor(calibration)
    about = "Fitted by photon transfer; light is photons per pixel and second."
    converter = calibration.measurement.converter
    if converter.step not in (0.0, 1.0):
        about += f" Its codes are the file's numbers divided by {converter.step:.5g}."
    write_sensor(best, path, draws=draws, about=about)


def _sensor(
    calibration: NoiseCalibration,
    kernel: Float[np.ndarray, "rows columns"],
    natural: Float[Array, " parameters"],
) -> Sensor:
    space = calibration.posterior.space
    values = dict(zip(names(space), natural, strict=True))
    gain, measurement = values["system_gain"], calibration.measurement
    photons, scale = measurement.photons_known, measurement.full_scale
    step, origin = measurement.converter.step or 1.0, measurement.converter.origin
    if not measurement.converter.step:
        scale = None
    dark_noise, response = _patterns(calibration)
    doubted = {name for doubt in measurement.doubts for name in doubt.of}
    current = None if "dark_current" in doubted else values.get("dark_current")
    return Sensor(
        shot_noise=PoissonShotNoise(),
        brighter_fatter=fitted_effect(kernel, values, calibration.chosen.data.top_signal),
        exposure_time=jnp.median(measurement.bright.exposure),
        quantum_efficiency=values["responsivity"] / gain if photons else None,
        read_noise=values["read_noise"],
        dark_current=None if current is None else jnp.maximum(current, 0),
        gain=gain / step,
        offset=(values["black_level"] - origin) / step,
        dsnu=dark_noise,
        prnu=response,
        bits=None if scale is None else float(np.log2((scale - origin) / step + 1)),
    )


def _patterns(calibration: NoiseCalibration) -> tuple[float | None, float | None]:
    """DSNU, e-, and PRNU of the fit to all levels; None where temporal noise hides them."""
    if calibration.patterns is None:
        return None, None
    found = calibration.patterns[1]
    gain = float(calibration.chosen.values["system_gain"])
    dark = np.sqrt(found.dark.variance) / gain if found.dark.seen else None
    return dark, float(np.sqrt(found.response.variance)) if found.response.seen else None
