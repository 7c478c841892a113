"""Sources of a sensor's noise: dark current and its laws of temperature, counting, and read-out.

Ranges are checked when a record is made, for numbers that are known then: `ValueError` names the
field, the value and the allowed range. Traced values pass unchecked and have a defined result.
"""

import equinox as eqx

from .._shown import Shown
from .._types import FRACTION, NOT_NEGATIVE, POSITIVE, Scalar, as_float, check_fields

_OF_TEMPERATURE = {
    "rate": NOT_NEGATIVE,
    "temperature": POSITIVE,
    "reference_temperature": POSITIVE,
}


class DoublingDarkCurrent(Shown):
    """Dark current that doubles at equal steps of temperature: I = rate 2^((T - T_ref) / doubling).

    Attributes:
        rate: () e- s^-1 per pixel at the reference temperature, >= 0.
        temperature: () K, T > 0.
        reference_temperature: () K, T_ref > 0.
        doubling: () K, > 0.

    Source:
        EMVA 1288.
    """

    rate: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)
    reference_temperature: Scalar = eqx.field(converter=as_float)
    doubling: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, **_OF_TEMPERATURE, doubling=POSITIVE)


class ArrheniusDarkCurrent(Shown):
    """Dark current of thermal generation: I = rate exp(-(E / k) (1 / T - 1 / T_ref)).

    Attributes:
        rate: () e- s^-1 per pixel at the reference temperature, >= 0.
        temperature: () K, T > 0.
        reference_temperature: () K, T_ref > 0.
        activation_energy: () eV, E >= 0: in silicon from half the band gap (0.56, generation in the
            depletion region) to all of it (1.12, diffusion).
    """

    rate: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)
    reference_temperature: Scalar = eqx.field(converter=as_float)
    activation_energy: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, **_OF_TEMPERATURE, activation_energy=NOT_NEGATIVE)


DarkCurrent = DoublingDarkCurrent | ArrheniusDarkCurrent


class HotPixels(Shown):
    """Pixels with excess dark current, which is distributed exponentially.

    Attributes:
        fraction: () of the pixels, in [0, 1], no unit.
        rate: () e- s^-1, mean of the excess, >= 0.
    """

    fraction: Scalar = eqx.field(converter=as_float)
    rate: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, fraction=FRACTION, rate=NOT_NEGATIVE)


class PoissonShotNoise(Shown):
    """Electrons are counted exactly: a Poisson draw replaces the mean.

    Example:
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), gain=2.0)
        >>> float(jv.signal_variance(sensor, jnp.array([100.0]))[0])  # 2^2 x 100 electrons
        400.0
    """


class FastPoissonShotNoise(Shown):
    """Electrons are counted by inverting the Poisson distribution.

    Draws whole numbers, many times faster than `PoissonShotNoise`, with gradients along the draw.
    Within 1.4e-4 of the Poisson distribution in total variation at every mean up to 1e5;
    `sensor.count` gives the details.
    """


class GaussianShotNoise(Shown):
    """A Gaussian draw of variance equal to the mean.

    Accurate from about 20 electrons up; below, draws can be negative.
    """


ShotNoise = PoissonShotNoise | FastPoissonShotNoise | GaussianShotNoise


class ResetNoise(Shown):
    """The kT/C noise of a sense node reset before each read-out without correlated sampling.

    Attributes:
        capacitance: () F, >= 0.
        temperature: () K, >= 0.
    """

    capacitance: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, capacitance=NOT_NEGATIVE, temperature=NOT_NEGATIVE)


class HeavyTailedReadNoise(Shown):
    """Read noise with a longer tail than a Gaussian: a mixture of two Gaussians.

    Attributes:
        rms: () e- of most read-outs, >= 0.
        tail_rms: () e- of the others, >= 0.
        tail_fraction: () share of the others, in [0, 1], no unit.
    """

    rms: Scalar = eqx.field(converter=as_float)
    tail_rms: Scalar = eqx.field(converter=as_float)
    tail_fraction: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, rms=NOT_NEGATIVE, tail_rms=NOT_NEGATIVE, tail_fraction=FRACTION)


class TelegraphNoise(Shown):
    """Pixels with a trap that is occupied half of the time.

    Under correlated double sampling such a pixel is off by -amplitude, 0 or +amplitude in 1, 2 and
    1 of 4 frames.

    Attributes:
        fraction: () of the pixels, in [0, 1], no unit.
        amplitude: () e-, >= 0.
    """

    fraction: Scalar = eqx.field(converter=as_float)
    amplitude: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, fraction=FRACTION, amplitude=NOT_NEGATIVE)


class Banding(Shown):
    """A sinusoidal offset over the rows, with a random phase in each frame.

    Attributes:
        amplitude: () e-, >= 0.
        period: () rows, > 0.
    """

    amplitude: Scalar = eqx.field(converter=as_float)
    period: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, amplitude=NOT_NEGATIVE, period=POSITIVE)
