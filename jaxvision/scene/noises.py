"""The records of a sensor's noise: dark current and its dependence on temperature, shot noise, and
read-out noise.

The range of each number is checked when a record is made. `ValueError` names the field, the value
and the allowed range. Values that JAX traces are not checked.
"""

import equinox as eqx

from ..core._shown import Shown
from ..core._types import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    Scalar,
    as_float,
    check_fields,
    print_by_name,
)

_OF_TEMPERATURE = {
    "rate": NOT_NEGATIVE,
    "temperature": POSITIVE,
    "reference_temperature": POSITIVE,
}


class DoublingDarkCurrent(Shown):
    """Dark current that doubles at equal steps of the temperature T: I = rate 2^((T - T_ref) /
    doubling).

    Attributes:
        rate: () e- s^-1 per pixel at the reference temperature, >= 0.
        temperature: () K, T > 0.
        reference_temperature: () K, T_ref > 0.
        doubling: () K, > 0.

    Source:
        EMVA 1288.

    Example:
        >>> hot = jv.DoublingDarkCurrent(10.0, 324.0, reference_temperature=300.0, doubling=8.0)
        >>> round(float(jv.sensor.dark_rate(hot)), 4)  # doubled three times
        80.0
    """

    rate: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)
    reference_temperature: Scalar = eqx.field(converter=as_float)
    doubling: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, **_OF_TEMPERATURE, doubling=POSITIVE)


class ArrheniusDarkCurrent(Shown):
    """Dark current from thermal generation at the temperature T: I = rate exp(-(E / k) (1 / T - 1 /
    T_ref)), where E is the activation energy and k the Boltzmann constant.

    Attributes:
        rate: () e- s^-1 per pixel at the reference temperature, >= 0.
        temperature: () K, T > 0.
        reference_temperature: () K, T_ref > 0.
        activation_energy: () eV, E >= 0: in silicon between half the band gap (0.56, generation in
            the depletion region) and the whole gap (1.12, diffusion).

    Example:
        >>> law = dict(temperature=308.0, reference_temperature=300.0, activation_energy=0.56)
        >>> rate = jv.sensor.dark_rate(jv.ArrheniusDarkCurrent(10.0, **law))
        >>> round(float(rate), 2)  # 10 exp(0.56 / 8.617e-5 (1 / 300 - 1 / 308))
        17.55
    """

    rate: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)
    reference_temperature: Scalar = eqx.field(converter=as_float)
    activation_energy: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, **_OF_TEMPERATURE, activation_energy=NOT_NEGATIVE)


DarkCurrent = DoublingDarkCurrent | ArrheniusDarkCurrent


class HotPixels(Shown):
    """Pixels with additional dark current, whose rate is exponentially distributed.

    Attributes:
        fraction: () fraction of the pixels that are hot, in [0, 1], no unit.
        rate: () e- s^-1, mean of the excess, >= 0.

    Example:
        >>> hot = jv.HotPixels(fraction=0.01, rate=500.0)
        >>> sensor = jv.Sensor(hot_pixels=hot, exposure_time=2.0)
        >>> round(float(jv.expected_signal(sensor, jnp.zeros(1))[0]), 4)  # 0.01 x 500 x 2
        10.0
    """

    fraction: Scalar = eqx.field(converter=as_float)
    rate: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, fraction=FRACTION, rate=NOT_NEGATIVE)


class PoissonShotNoise(Shown):
    """Shot noise with an exact Poisson distribution of the electron count.

    The mean must be at most 2^31 electrons. Larger means raise an error, or give NaN under
    `jax.jit`.

    Example:
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), gain=2.0)
        >>> float(jv.signal_variance(sensor, jnp.array([100.0]))[0])  # 2^2 x 100 electrons
        400.0
    """


class FastPoissonShotNoise(Shown):
    """Shot noise by inversion of an approximate Poisson distribution.

    Samples are whole numbers, have gradients by reparameterisation, and are drawn ten times faster
    than by `PoissonShotNoise`. The total variation distance from the Poisson distribution is at
    most 1.4e-4 at every mean up to 2^31 electrons. Larger means raise an error, or give NaN under
    `jax.jit`. `sensor.count` gives the details.

    Example:
        >>> sensor = jv.Sensor(shot_noise=jv.FastPoissonShotNoise())
        >>> raw = jv.raw_image(jax.random.key(0), sensor, jnp.full((400, 400, 1), 100.0))
        >>> round(float(raw.mean())), round(float(raw.var()) / 100, 1), bool((raw % 1 == 0).all())
        (100, 1.0, True)
    """


class GaussianShotNoise(Shown):
    """Shot noise with a Gaussian distribution whose variance equals the mean.

    The approximation is accurate above about 20 electrons. At smaller means, samples can be
    negative.

    Example:
        >>> sensor = jv.Sensor(shot_noise=jv.GaussianShotNoise())
        >>> raw = jv.raw_image(jax.random.key(0), sensor, jnp.full((400, 400, 1), 100.0))
        >>> round(float(raw.mean())), round(float(raw.var()) / 100, 1)
        (100, 1.0)
    """


ShotNoise = PoissonShotNoise | FastPoissonShotNoise | GaussianShotNoise
print_by_name(globals(), "ShotNoise")


class ResetNoise(Shown):
    """The kTC noise of a sense node that is reset before each read-out, without correlated double
    sampling.

    Attributes:
        capacitance: () F, >= 0.
        temperature: () K, >= 0.

    Example:
        >>> node = jv.Sensor(reset_noise=jv.ResetNoise(capacitance=1.6e-15, temperature=300.0))
        >>> round(float(jv.signal_variance(node, jnp.zeros(1))[0]))  # k T C / e^2, electrons^2
        258
    """

    capacitance: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, capacitance=NOT_NEGATIVE, temperature=NOT_NEGATIVE)


class HeavyTailedReadNoise(Shown):
    """Read noise with a longer tail than a Gaussian: a mixture of two Gaussians.

    Attributes:
        rms: () e- of most readings, >= 0.
        tail_rms: () e- of the other readings, >= 0.
        tail_fraction: () share of the other readings, in [0, 1], no unit.

    Example:
        >>> sensor = jv.Sensor(read_noise=jv.HeavyTailedReadNoise(2.0, 10.0, tail_fraction=0.1))
        >>> round(float(jv.signal_variance(sensor, jnp.zeros(1))[0]), 4)  # 0.9 x 2^2 + 0.1 x 10^2
        13.6
    """

    rms: Scalar = eqx.field(converter=as_float)
    tail_rms: Scalar = eqx.field(converter=as_float)
    tail_fraction: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, rms=NOT_NEGATIVE, tail_rms=NOT_NEGATIVE, tail_fraction=FRACTION)


class TelegraphNoise(Shown):
    """Random telegraph noise: pixels with a trap that is occupied half of the time.

    Under correlated double sampling the error of such a pixel is -amplitude with probability 1/4, 0
    with probability 1/2, and +amplitude with probability 1/4.

    Attributes:
        fraction: () fraction of the pixels that have a trap, in [0, 1], no unit.
        amplitude: () e-, >= 0.

    Example:
        >>> sensor = jv.Sensor(telegraph_noise=jv.TelegraphNoise(fraction=0.1, amplitude=10.0))
        >>> round(float(jv.signal_variance(sensor, jnp.zeros(1))[0]), 4)  # 0.1 x 10^2 / 2
        5.0
    """

    fraction: Scalar = eqx.field(converter=as_float)
    amplitude: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, fraction=FRACTION, amplitude=NOT_NEGATIVE)


class Banding(Shown):
    """Banding: an offset that is a sinusoid of the row, with a random phase in each frame.

    Attributes:
        amplitude: () e-, >= 0.
        period: () rows, > 0.

    Example:
        >>> sensor = jv.Sensor(banding=jv.Banding(amplitude=4.0, period=10.0))
        >>> round(float(jv.signal_variance(sensor, jnp.zeros(1))[0]), 4)  # 4^2 / 2
        8.0
    """

    amplitude: Scalar = eqx.field(converter=as_float)
    period: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, amplitude=NOT_NEGATIVE, period=POSITIVE)
