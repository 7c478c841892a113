"""Calls for the sensor, stage by stage."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from oracles.sensors import EVERY_EFFECT

from jaxvision import scene as s
from jaxvision.sensor import Moments
from jaxvision.sensor.colour_filters import bayer

RNG = np.random.default_rng(4)
KEY, DIE = jax.random.split(jax.random.key(1))
X = jnp.asarray(RNG.uniform(0.1, 0.9, size=(4, 4, 2)))
ELECTRONS = 1000 * X
ONE, TWO = jnp.asarray(0.7), jnp.asarray(2.3)
SMALL = jnp.asarray(0.01)
APERTURE = s.PixelAperture(0.5, microlens=0.3, oversampling=2)
FILTER = s.ColourFilter([[0.4, 0.1], [0.2, 0.3], [0.1, 0.2]], pattern=bayer("GRBG"))
HOT = s.HotPixels(0.5, 300.0)
TRANSFER = s.ChargeTransfer(1e-3, serial_inefficiency=2e-3, trail=3)
REPELLING = s.BrighterFatter([[3e-6, 1e-6], [8e-7, 2e-7]], steps=3)
MIXING = s.Mixing([[0.0, 0.03, 0.0], [0.01, 0.9, 0.02], [0.0, 0.03, 0.01]])
CURVE = s.Compression(0.08, 0.02, electrons=1000.0)
DARK = s.DoublingDarkCurrent(100.0, 300.0, 293.0, 8.0)
RESET = s.ResetNoise(1e-15, 300.0)
SHUTTER = s.RollingShutter(0.004)
SENSOR = replace(
    EVERY_EFFECT,
    photon_conversion=s.PhotonConversion([5e-7, 6e-7], 1e-11),
    infrared_cut=[0.9, 0.8],
    quantum_efficiency=[0.5, 0.6],
    colour_filter=None,
    pixel_aperture=APERTURE,
    dead_pixels=0.1,
    shot_noise=s.GaussianShotNoise(),
    full_well=2e9,
    charge_transfer=TRANSFER,
    bits=None,
)
CORRECTED = s.Sensor(
    mixing=MIXING,
    nonlinearity=CURVE,
    dark_current=DARK,
    exposure_time=0.5,
    shot_noise=s.GaussianShotNoise(),
    read_noise=5.0,
    prnu=0.01,
    gain=0.8,
    offset=10.0,
)
MOMENTS_OF = s.Sensor(
    exposure_time=0.5,
    dark_current=DARK,
    shot_noise=s.GaussianShotNoise(),
    full_well=900.0,
    read_noise=5.0,
    gain=0.3,
    offset=10.0,
    bits=8,
)


def whole_turns(number):
    return jnp.cos(2 * np.pi * number)


def one(number):
    return 1 + 0 * number


def moving(time):
    return X * (1 + time)


EXAMPLES = {
    "sensor.adc.digitise": ((SENSOR, ELECTRONS), {"die_key": DIE}),
    "sensor.adc.amplified": ((SENSOR, ELECTRONS), {}),
    "sensor.adc.largest_number": ((TWO,), {}),
    "sensor.brighter_fatter.area_changes": ((REPELLING.kernel,), {}),
    "sensor.brighter_fatter.flat_covariances": ((X[..., 0] * 1e-6, ELECTRONS), {}),
    "sensor.brighter_fatter.flat_variance": ((REPELLING, ELECTRONS), {}),
    "sensor.brighter_fatter.gathered": (
        (KEY, ELECTRONS, REPELLING),
        {"shot_noise": s.GaussianShotNoise()},
    ),
    "sensor.brighter_fatter.smoothed_pattern": ((REPELLING, ELECTRONS), {}),
    "sensor.ccd.bloomed": ((ELECTRONS, jnp.asarray(500.0), ONE), {}),
    "sensor.ccd.transferred": ((ELECTRONS, TRANSFER), {}),
    "sensor.ccd.transferred_variance": ((ELECTRONS, TRANSFER), {}),
    "sensor.ccd.counted_variance": ((ELECTRONS, ELECTRONS, TRANSFER), {}),
    "sensor.ccd.transfer_noise": ((KEY, ELECTRONS, TRANSFER), {}),
    "sensor.correction.correct": ((ELECTRONS, CORRECTED), {}),
    "sensor.dark.dark_rate": ((DARK,), {}),
    "sensor.exposure.set_iso": ((SENSOR, 400 * ONE), {}),
    "sensor.exposure.photon_rate": ((X, 1e-6 * X[0, 0], ONE), {}),
    "sensor.exposure.mean_photoelectrons": ((SENSOR, X), {}),
    "sensor.exposure.expected_charge": ((SENSOR, X), {}),
    "sensor.exposure.filtered": ((FILTER, ELECTRONS), {}),
    "sensor.exposure.drifted": ((ELECTRONS, SMALL), {}),
    "sensor.exposure.smeared": ((ELECTRONS, SMALL), {}),
    "sensor.exposure.mean_dark": ((SENSOR, X), {}),
    "sensor.exposure.accumulate": ((SENSOR, X), {}),
    "sensor.fixed_pattern.sensitivity": ((DIE, SENSOR), {"shape": X.shape, "dtype": X.dtype}),
    "sensor.fixed_pattern.hot_rates": ((DIE, HOT), {"shape": X.shape, "dtype": X.dtype}),
    "sensor.fixed_pattern.offsets": ((DIE, SENSOR), {"shape": X.shape, "dtype": X.dtype}),
    "sensor.fixed_pattern.column_gains": ((DIE, SMALL), {"shape": X.shape, "dtype": X.dtype}),
    "sensor.fixed_pattern.conversion_gains": ((DIE, SMALL), {"shape": X.shape, "dtype": X.dtype}),
    "sensor.moments.censored": ((Moments(ELECTRONS, 3 * ELECTRONS),), {"high": jnp.asarray(700.0)}),
    "sensor.moments.clipped_moments": ((MOMENTS_OF, ELECTRONS), {}),
    "sensor.moments.expected_signal": ((SENSOR, X), {}),
    "sensor.mixing.even_mixing": ((SMALL,), {}),
    "sensor.mixing.mixed": ((ELECTRONS, MIXING), {}),
    "sensor.moments.neighbour_covariances": ((SENSOR, X), {}),
    "sensor.nonlinearity.charge_of_signal": ((CURVE, ELECTRONS), {}),
    "sensor.nonlinearity.signal_of_charge": ((CURVE, ELECTRONS), {}),
    "sensor.moments.signal_to_noise": ((SENSOR, X), {}),
    "sensor.moments.signal_variance": ((SENSOR, X), {}),
    # the step of a finite difference would be a large share of the kernel of the brighter-fatter
    # effect
    "sensor.moments.pattern_variance": ((replace(SENSOR, brighter_fatter=None), X), {}),
    "sensor.raw.collect": ((KEY, SENSOR, X), {"die_key": DIE}),
    "sensor.raw.raw_image": ((KEY, SENSOR, X), {"die_key": DIE}),
    "sensor.read_out.read_out_noise": ((KEY, DIE, SENSOR), {"shape": X.shape, "dtype": X.dtype}),
    "sensor.read_out.read_out_variance": ((SENSOR,), {"dtype": X.dtype}),
    "sensor.read_out.reset_noise_rms": ((RESET,), {}),
    "sensor.sampling.aperture_mtf": ((APERTURE, X), {}),
    "sensor.sampling.light_share": ((APERTURE,), {}),
    "sensor.sampling.pixel_means": ((X, APERTURE), {}),
    # whatever is drawn the value is 1, so a finite difference gives the right slope
    "sensor.expectation.expected_of_count": ((KEY, X), {"function": whole_turns}),
    "sensor.expectation.expected_of_defect": ((KEY, X), {"function": one}),
    "sensor.expectation.expected_of_reading": ((KEY, X, ONE), {"function": one}),
    "sensor.shot_noise.count": ((KEY, ELECTRONS, s.GaussianShotNoise()), {}),
    "sensor.shot_noise.poisson_deviance": ((ELECTRONS, 0.5 * ELECTRONS, 0.5 * ELECTRONS), {}),
    "sensor.shot_noise.stirling_remainder": ((ELECTRONS,), {}),
    "sensor.shutter.exposed": (
        (SHUTTER, ONE),
        {"picture_at": moving, "rows": 4, "slots": 5},
    ),
    "sensor.shutter.exposure_slots": ((SHUTTER, ONE), {"rows": 4, "slots": 5}),
    "sensor.shutter.row_starts": ((SHUTTER, ONE), {"rows": 4}),
}
