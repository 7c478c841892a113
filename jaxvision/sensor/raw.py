"""Simulate raw data from irradiance, stage by stage. A stage whose parameter is None is not traced.

The functions act elementwise on arrays (..., bands) of any shape, so that XLA computes an image in
one loop over its pixels. Effects between pixels, rows or columns need an image (..., h, w, bands).
Further leading axes are treated as more pixels of the same exposure: each pixel has its own random
numbers, but those of rows and columns are the same along these axes. For several frames of one die,
use `vmap` over keys.
"""

import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ..core._types import Key, Scalar
from ..scene import Sensor
from ._draws import Frame, needed
from ._registry import affected, charge_effects
from .adc import digitise
from .brighter_fatter import gathered
from .ccd import bloomed, transfer_noise, transferred
from .exposure import Counts, Light, accumulate, expected_charge, mean_dark
from .fixed_pattern import conversion_gains, hot_rates, offsets, sensitivity
from .read_out import read_out_noise
from .shot_noise import MOST_ELECTRONS, count


@takes_numbers
def collect(
    key: Key | None, sensor: Sensor, irradiance: Light, *, die_key: Key | None = None
) -> Counts:
    """Draw the electrons read from each pixel in one exposure.

    At each charge transfer, electrons are left behind at random. A Poisson packet that is thinned
    in this way remains Poisson, so transfers are applied to the expectation, before electrons are
    counted. If a full well clips the packets, or the brighter-fatter effect correlates them,
    transfers are applied to the counted charge, and the noise of the random selection is added.

    Gradients are those of the reparameterised draw (see `count`). For means and mean squares they
    are unbiased, except if a full well of w electrons clips Poisson counts N of mean m. Charge
    beyond the well has the derivative 0, and the derivative of the mean is too small by (1 - m / w)
    P(N = w - 1) / 4, at most 0.0007 for w = 100.

    Args:
        key: random key of the frame, for everything that changes from frame to frame; may be None
            if the sensor does not need it.
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel, >=
            0. Negative traced values are set to 0 where electrons are counted.
        die_key: random key of the individual sensor, for everything that stays the same; may be
            None if the sensor does not need it.

    Returns:
        (..., bands) electrons, or (..., h, w, 1) under a colour filter.

    Raises:
        ValueError: if a needed key is None, `irradiance` does not match the sensor, or the expected
            electrons exceed the limit of `count`. In a full well without blooming the excess is not
            drawn.

    Example:
        >>> sensor = jv.Sensor(quantum_efficiency=0.5, full_well=100.0)
        >>> jv.collect(None, sensor, jnp.array([50.0, 500.0])).tolist()
        [25.0, 100.0]
    """
    electrons = expected_charge(sensor, irradiance)
    shape, dtype = electrons.shape, electrons.dtype
    response = sensitivity(die_key, sensor, shape=shape, dtype=dtype)
    if response is not None:
        electrons = electrons * response
    if sensor.dark_current is not None:
        electrons = electrons + mean_dark(sensor, electrons)
    if sensor.hot_pixels is not None:
        rates = hot_rates(die_key, sensor.hot_pixels, shape=shape, dtype=dtype)
        electrons = electrons + accumulate(sensor, rates)
    transfer = sensor.charge_transfer
    poisson = sensor.full_well is None and sensor.brighter_fatter is None
    if transfer is not None and poisson:
        electrons = transferred(electrons, transfer)
    if sensor.brighter_fatter is not None:
        electrons = gathered(
            key,
            electrons,
            sensor.brighter_fatter,
            shot_noise=sensor.shot_noise,
            full_well=sensor.full_well,
        )
    elif sensor.shot_noise is not None:
        if sensor.full_well is not None and sensor.blooming is None:
            electrons = _surely_full(electrons, sensor.full_well)
        electrons = count(needed(key, Frame.SHOT), electrons, sensor.shot_noise)
    if sensor.full_well is not None and sensor.blooming is not None:
        electrons = bloomed(electrons, sensor.full_well, sensor.blooming)
    elif sensor.full_well is not None:
        electrons = jnp.minimum(electrons, sensor.full_well)
    if transfer is not None and not poisson:
        packets, electrons = electrons, transferred(electrons, transfer)
        if sensor.shot_noise is not None:
            electrons = electrons + transfer_noise(key, packets, transfer)
    effects = charge_effects(sensor)
    if effects:
        electrons = affected(key, effects, electrons)
    if sensor.conversion_prnu is not None:
        electrons = electrons * conversion_gains(
            die_key, sensor.conversion_prnu, shape=shape, dtype=dtype
        )
    for added in (
        offsets(die_key, sensor, shape=shape, dtype=dtype),
        read_out_noise(key, die_key, sensor, shape=shape, dtype=dtype),
    ):
        if added is not None:
            electrons = electrons + added
    return electrons


def _surely_full(mean: Counts, full_well: Scalar) -> Counts:
    """Clip the mean to the largest mean that `count` accepts, if this is at least twice the full
    well. The well is full with either mean."""
    return jnp.where(full_well <= MOST_ELECTRONS / 2, jnp.minimum(mean, MOST_ELECTRONS), mean)


@takes_numbers
def raw_image(
    key: Key | None, sensor: Sensor, irradiance: Light, *, die_key: Key | None = None
) -> Counts:
    """Draw the raw data of one exposure: `digitise` applied to `collect`.

    Args:
        key: random key of the frame; may be None if the sensor does not need it.
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel, >=
            0.
        die_key: random key of the individual sensor; may be None if the sensor does not need it.

    Returns:
        (..., bands) DN, in floating point; (..., h, w, 1) under a colour filter.

    Raises:
        ValueError: if a needed key is None, or `irradiance` does not match the sensor.

    Example:
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), gain=0.5, offset=64.0, bits=12)
        >>> raw = jv.raw_image(jax.random.key(0), sensor, jnp.full((400, 400, 1), 100.0))
        >>> round(float(raw.mean())), round(float(raw.var() / (0.25 * 100 + 1 / 12)), 1)
        (114, 1.0)
    """
    electrons = collect(key, sensor, irradiance, die_key=die_key)
    return digitise(sensor, electrons, die_key=die_key)
