"""Irradiance to expected electrons: photons, filters, quantum efficiency, the pixel's aperture.

Irradiance in W m^-2, or photons per second and pixel without a `photon_conversion`; photons and
electrons are counted per pixel and exposure. What drifts or smears does so here, before electrons
are counted: each electron goes its way alone, so what arrives from elsewhere is Poisson too and the
expectation is all that changes.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from .._types import Image, Scalars, Spectrum, as_float, is_known
from ..colour_filters import check_pattern, mosaic
from ..scene import ColourFilter, Sensor
from ._draws import check_image
from .dark import dark_rate
from .sampling import light_share

PLANCK = 6.62607015e-34  # J s, exact in the SI since 2019
SPEED_OF_LIGHT = 299792458.0  # m s^-1, exact in the SI

Light = Shaped[Array | np.ndarray, "... bands"]  # whole numbers of photons are light too
Counts = Float[Array, "... channels"]  # one channel under a colour filter, else a band each


def photon_rate(irradiance: Spectrum, wavelength: Scalars, pixel_area: Scalars) -> Spectrum:
    """lambda E A / (h c) in photons per second and pixel (EMVA 1288; times t it is mu_p).

    `irradiance`: (..., bands) W m^-2. `wavelength`: () or (bands,) m. `pixel_area`: () m^2.
    """
    per_joule = wavelength / (PLANCK * SPEED_OF_LIGHT)
    return irradiance * _over_bands("wavelength", pixel_area * per_joule, irradiance)


def mean_photoelectrons(sensor: Sensor, irradiance: Light) -> Counts:
    """eta mu_p: expected electrons (..., bands) that light frees in a pixel of mean sensitivity.

    `irradiance`: W m^-2, or photons per second and pixel without a `photon_conversion`; (..., h, w,
    bands) under a colour filter, and then one number a pixel comes out, (..., h, w, 1). Integers
    become floating numbers of the same value. `ValueError` for irradiance that is negative, NaN or
    infinite and not traced; what is traced stays NaN, up to the raw data.
    """
    electrons = as_float(irradiance)
    _check_irradiance(electrons)
    if sensor.photon_conversion is not None:
        conversion = sensor.photon_conversion
        electrons = photon_rate(electrons, conversion.wavelength, conversion.pixel_area)
    if sensor.infrared_cut is not None:
        electrons = electrons * _over_bands("Sensor.infrared_cut", sensor.infrared_cut, electrons)
    if sensor.quantum_efficiency is not None:
        efficiency = sensor.quantum_efficiency
        electrons = electrons * _over_bands("Sensor.quantum_efficiency", efficiency, electrons)
    if sensor.colour_filter is not None:
        electrons = filtered(sensor.colour_filter, electrons)
    if sensor.pixel_aperture is not None:
        electrons = electrons * light_share(sensor.pixel_aperture)
    return over_exposure(sensor, electrons)


def expected_charge(sensor: Sensor, irradiance: Light) -> Counts:
    """Electrons that light is expected to leave in each pixel of mean sensitivity, (..., bands):
    `mean_photoelectrons` after smear and crosstalk."""
    electrons = mean_photoelectrons(sensor, irradiance)
    if sensor.smear is not None:
        electrons = smeared(electrons, sensor.smear)
    if sensor.crosstalk is not None:
        electrons = drifted(electrons, sensor.crosstalk)
    return electrons


def filtered(colour_filter: ColourFilter, electrons: Image) -> Counts:
    """What each pixel of a mosaic counts: (..., h, w, bands) in electrons to (..., h, w, 1).

    `ValueError` unless the pattern tiles the picture and uses each of the filter's colours.
    """
    transmission = colour_filter.transmission
    check_pattern(colour_filter.pattern, bands=transmission.shape[0], name="ColourFilter.pattern")
    if electrons.shape[-1] != transmission.shape[1]:
        raise ValueError(
            f"ColourFilter.transmission is over {transmission.shape[1]} bands, the irradiance has "
            f"shape {electrons.shape}."
        )
    seen = jnp.einsum("...b,cb->...c", electrons, transmission)
    return mosaic(seen, colour_filter.pattern)[..., None]


def drifted(electrons: Counts, crosstalk: Scalars) -> Counts:
    """(..., h, w, bands) electrons of which each pixel gives the share `crosstalk` to each of its
    four neighbours. Over the border as much comes back as leaves: none are lost."""
    check_image("Sensor.crosstalk", electrons.shape)

    def neighbours(axis: int) -> Scalars:
        size = electrons.shape[axis]
        own = jnp.arange(size)
        before, after = jnp.maximum(own - 1, 0), jnp.minimum(own + 1, size - 1)
        return jnp.take(electrons, before, axis) + jnp.take(electrons, after, axis)

    return electrons * (1 - 4 * crosstalk) + crosstalk * (neighbours(-3) + neighbours(-2))


def smeared(electrons: Counts, smear: Scalars) -> Counts:
    """(..., h, w, bands) electrons after the frame was shifted through the light along its columns:
    each row gathers `smear` of all the others of its column."""
    check_image("Sensor.smear", electrons.shape)
    column = electrons.sum(axis=-3, keepdims=True)
    return electrons + smear * (column - electrons)


def mean_dark(sensor: Sensor, like: Spectrum) -> Scalars:
    """mu_d: electrons () that a pixel frees in an exposure without light."""
    if sensor.dark_current is None:
        return jnp.zeros((), like.dtype)
    return over_exposure(sensor, dark_rate(sensor.dark_current))


def over_exposure(sensor: Sensor, rate: Scalars) -> Scalars:
    """Electrons of a rate in e- s^-1; of counts per exposure where there is no exposure time."""
    return rate if sensor.exposure_time is None else rate * sensor.exposure_time


def _check_irradiance(irradiance: Spectrum) -> None:
    if not is_known(irradiance) or irradiance.size == 0:
        return
    with jax.ensure_compile_time_eval():  # what is known may stand within what is traced
        least, most = float(irradiance.min()), float(irradiance.max())
    if not (least >= 0 and most < jnp.inf):
        wrong = most if least >= 0 else least
        raise ValueError(f"irradiance must be finite and at least 0 everywhere, got {wrong}.")


def _over_bands(name: str, x: Scalars, like: Spectrum) -> Scalars:
    """A scalar as it is, one value per band broadcast over the pixels."""
    if x.ndim == 0:
        return x
    if x.shape != like.shape[-1:]:
        raise ValueError(
            f"{name} must be () or ({like.shape[-1]},), one a band of the irradiance, got shape "
            f"{x.shape}."
        )
    return jnp.broadcast_to(x, like.shape)
