"""Where a sensor's noise comes from: dark current and its laws of temperature, how electrons are
counted, and what reading them out adds.

Ranges are checked where a record is made, of numbers that are known then: `ValueError` names the
field, the value and what is allowed. What is traced passes, and has a defined result.
"""

import equinox as eqx

from .._types import Scalar, as_float, check_range, check_shape


class DoublingDarkCurrent(eqx.Module):
    """I = rate 2^((T - T_ref) / doubling), EMVA 1288: `rate`, () e- s^-1 per pixel at
    `reference_temperature`, doubles with each interval `doubling`; () K each. `temperature`: () K.
    """

    rate: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)
    reference_temperature: Scalar = eqx.field(converter=as_float)
    doubling: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        _check_temperatures(self)
        check_shape("DoublingDarkCurrent.doubling", self.doubling, ())
        check_range("DoublingDarkCurrent.doubling", self.doubling, 0, above=True)


class ArrheniusDarkCurrent(eqx.Module):
    """I = rate exp(-(E / k) (1 / T - 1 / T_ref)): thermal generation over `activation_energy`,
    () eV, in silicon from half the band gap (0.56, in the depletion region) to all of it (1.12,
    by diffusion). `rate`: () e- s^-1 per pixel at `reference_temperature`, () K. `temperature`:
    () K.
    """

    rate: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)
    reference_temperature: Scalar = eqx.field(converter=as_float)
    activation_energy: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        _check_temperatures(self)
        check_shape("ArrheniusDarkCurrent.activation_energy", self.activation_energy, ())
        check_range("ArrheniusDarkCurrent.activation_energy", self.activation_energy, 0)


DarkCurrent = DoublingDarkCurrent | ArrheniusDarkCurrent


class HotPixels(eqx.Module):
    """Pixels with more dark current. `fraction`: () of the pixels, in [0, 1]. `rate`: () e- s^-1,
    the mean of their excess, which is distributed exponentially."""

    fraction: Scalar = eqx.field(converter=as_float)
    rate: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("HotPixels.fraction", self.fraction, ())
        check_shape("HotPixels.rate", self.rate, ())
        check_range("HotPixels.fraction", self.fraction, 0, 1)
        check_range("HotPixels.rate", self.rate, 0)


class PoissonShotNoise(eqx.Module):
    """Electrons are counted: a Poisson draw replaces the mean."""


class FastPoissonShotNoise(eqx.Module):
    """Electrons are counted by inverting the Poisson distribution: whole numbers, many times faster
    to draw than `PoissonShotNoise`, and with gradients along the draw. Its distribution is within
    1.4e-4 of Poisson's in total variation at every mean up to 1e5 (`count` says how)."""


class GaussianShotNoise(eqx.Module):
    """A Gaussian of variance equal to the mean; good from about 20 electrons up, and below that
    it can go negative."""


ShotNoise = PoissonShotNoise | FastPoissonShotNoise | GaussianShotNoise


class ResetNoise(eqx.Module):
    """The kT/C noise of a sense node that is reset before each read-out and not sampled then.
    `capacitance`: () F. `temperature`: () K."""

    capacitance: Scalar = eqx.field(converter=as_float)
    temperature: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        for name in ("capacitance", "temperature"):
            check_shape(f"ResetNoise.{name}", getattr(self, name), ())
            check_range(f"ResetNoise.{name}", getattr(self, name), 0)


class HeavyTailedReadNoise(eqx.Module):
    """Read noise whose tail is longer than a Gaussian's: a mixture of two Gaussians.

    `rms`: () e- of most read-outs. `tail_rms`: () e- of the others. `tail_fraction`: () how many
    are others, in [0, 1].
    """

    rms: Scalar = eqx.field(converter=as_float)
    tail_rms: Scalar = eqx.field(converter=as_float)
    tail_fraction: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        for name in ("rms", "tail_rms", "tail_fraction"):
            check_shape(f"HeavyTailedReadNoise.{name}", getattr(self, name), ())
        check_range("HeavyTailedReadNoise.rms", self.rms, 0)
        check_range("HeavyTailedReadNoise.tail_rms", self.tail_rms, 0)
        check_range("HeavyTailedReadNoise.tail_fraction", self.tail_fraction, 0, 1)


class TelegraphNoise(eqx.Module):
    """Pixels with a trap that is full half of the time. Read twice and subtracted (correlated
    double sampling), such a pixel is off by -amplitude, 0 or +amplitude in 1, 2 and 1 of 4 frames.

    `fraction`: () of the pixels, in [0, 1]. `amplitude`: () e-.
    """

    fraction: Scalar = eqx.field(converter=as_float)
    amplitude: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("TelegraphNoise.fraction", self.fraction, ())
        check_shape("TelegraphNoise.amplitude", self.amplitude, ())
        check_range("TelegraphNoise.fraction", self.fraction, 0, 1)
        check_range("TelegraphNoise.amplitude", self.amplitude, 0)


class Banding(eqx.Module):
    """A hum over the rows of each frame, of random phase. `amplitude`: () e-. `period`: () rows."""

    amplitude: Scalar = eqx.field(converter=as_float)
    period: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Banding.amplitude", self.amplitude, ())
        check_shape("Banding.period", self.period, ())
        check_range("Banding.amplitude", self.amplitude, 0)
        check_range("Banding.period", self.period, 0, above=True)


def _check_temperatures(law: DarkCurrent) -> None:
    name = type(law).__name__
    for field in ("rate", "temperature", "reference_temperature"):
        check_shape(f"{name}.{field}", getattr(law, field), ())
    check_range(f"{name}.rate", law.rate, 0)
    check_range(f"{name}.temperature", law.temperature, 0, above=True)
    check_range(f"{name}.reference_temperature", law.reference_temperature, 0, above=True)
