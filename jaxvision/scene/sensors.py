"""What turns light on a pixel into a number."""

import equinox as eqx

from .._types import Colour, Scalar, as_float, as_optional_float, check_shape


class PhotonConversion(eqx.Module):
    """What turns irradiance into photons: mu_p = lambda E A t / (h c), EMVA 1288.

    `wavelength`: () or (bands,) m. `pixel_area`: () m^2.
    """

    wavelength: Scalar | Colour = eqx.field(converter=as_float)
    pixel_area: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("PhotonConversion.wavelength", self.wavelength, (), ("bands",))
        check_shape("PhotonConversion.pixel_area", self.pixel_area, ())


class PoissonShotNoise(eqx.Module):
    """Electrons are counted: a Poisson draw replaces the mean."""


class GaussianShotNoise(eqx.Module):
    """A Gaussian of variance equal to the mean, many times faster to draw than a Poisson; good
    from about 20 electrons up, and below that it can go negative."""


ShotNoise = PoissonShotNoise | GaussianShotNoise


class Sensor(eqx.Module):
    """A linear image sensor after EMVA 1288. Every effect is optional; `None` leaves it out.

    `photon_conversion`: None takes the input as photons per pixel and second already.
    `exposure_time`: () s; None takes rates as counts per exposure.
    `quantum_efficiency`: () or (bands,) electrons per photon.
    `prnu`: () relative rms of the pixels' sensitivities.
    `dark_current`: () e- s^-1 per pixel; its electrons are counted with those of the light, so
    they have shot noise if any have.
    `shot_noise`: how counting is drawn.
    `full_well`: () e- a pixel holds.
    `dsnu`: () e- rms of the pixels' offsets.
    `read_noise`: () e- rms per read-out.
    `gain`: () DN per e-. `offset`: () DN added before conversion (the black level).
    `bits`: () of the ADC, up to 16: rounds to whole DN and clips to [0, 2^bits - 1].
    """

    photon_conversion: PhotonConversion | None = eqx.field(default=None, kw_only=True)
    exposure_time: Scalar | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    quantum_efficiency: Scalar | Colour | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    prnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    dark_current: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    shot_noise: ShotNoise | None = eqx.field(default=None, kw_only=True)
    full_well: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    dsnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    read_noise: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    gain: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    offset: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    bits: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("Sensor.quantum_efficiency", self.quantum_efficiency, (), ("bands",))
        for name in ("exposure_time", "prnu", "dark_current", "full_well", "dsnu", "read_noise"):
            check_shape(f"Sensor.{name}", getattr(self, name), ())
        for name in ("gain", "offset", "bits"):
            check_shape(f"Sensor.{name}", getattr(self, name), ())
