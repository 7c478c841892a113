"""The expected electrons for a given irradiance: photons, filters, quantum efficiency, pixel
aperture.

Irradiance is in W m^-2, or in photons per second and pixel if the sensor has no
`photon_conversion`. Photons and electrons are counted per pixel and exposure. Smear and crosstalk
act on the expectation, before electrons are counted. Each electron moves independently, so the
electrons in each pixel remain Poisson-distributed.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from ..core._arguments import takes_numbers
from ..core._types import (
    Image,
    Scalars,
    Spectrum,
    as_float,
    check_kind,
    is_known,
    print_by_name,
)
from ..scene import ColourFilter, Sensor, ShutterOffset
from ._draws import check_image
from ._taps import factored
from .colour_filters import check_pattern, mosaic
from .dark import dark_rate
from .sampling import light_share

PLANCK = 6.62607015e-34  # J s, exact in the SI since 2019
SPEED_OF_LIGHT = 299792458.0  # m s^-1, exact in the SI

Light = Shaped[Array | np.ndarray, "... bands"]  # integer counts of photons are allowed
Counts = Float[Array, "... channels"]  # one channel under a colour filter, else one per band
print_by_name(globals(), "Light", "Counts")


@takes_numbers
def photon_rate(irradiance: Spectrum, wavelength: Scalars, pixel_area: Scalars) -> Spectrum:
    """Return the number of photons per second and pixel, lambda E A / (h c), for the irradiance E,
    the wavelength lambda and the pixel area A.

    The rate times the exposure time is mu_p of EMVA 1288.

    Args:
        irradiance: (..., bands) W m^-2.
        wavelength: () or (bands,) m.
        pixel_area: () m^2.

    Returns:
        (..., bands) photons s^-1 per pixel.

    Raises:
        ValueError: `wavelength` has neither one value nor one per band.

    Example:
        >>> E, wavelength, area = jnp.array([1e-3]), jnp.array(550e-9), jnp.array(25e-12)
        >>> round(float(jv.photon_rate(E, wavelength, area)[0]))
        69219
    """
    per_joule = wavelength / (PLANCK * SPEED_OF_LIGHT)
    return irradiance * _band_values("wavelength", pixel_area * per_joule, irradiance)


@takes_numbers
def set_iso(sensor: Sensor, iso: Scalars, *, base_iso: Scalars | float = 100.0) -> Sensor:
    """Return the sensor at another ISO setting, with a gain in proportion to the ISO speed.

    ISO 12232 defines the speed S = 78 / H by the exposure H in lx s at which the ADC's range is
    just full. Doubling the gain halves H. Noise before the amplifier keeps its value in electrons,
    and therefore grows in DN. The full well keeps its value in electrons.

    Args:
        sensor: as at `base_iso`.
        iso: () ISO speed, > 0.
        base_iso: () ISO speed of the given sensor.

    Returns:
        The sensor with another gain; a gain of None stands for 1 DN per electron.

    Example:
        >>> print(jv.sensor.set_iso(jv.Sensor(gain=0.25, bits=12), 400).gain)
        1.0
    """
    check_kind("set_iso: sensor", sensor, Sensor)
    gain = 1.0 if sensor.gain is None else sensor.gain
    return replace(sensor, gain=gain * (iso / base_iso))


@takes_numbers
def mean_photoelectrons(sensor: Sensor, irradiance: Light) -> Counts:
    """Return the expected photoelectrons of a pixel of mean sensitivity, eta mu_p, where eta is the
    quantum efficiency and mu_p the number of photons.

    Args:
        sensor: its fields from `photon_conversion` to `exposure_time` are used, the light offset
            included, and the efficiency of `taps`.
        irradiance: (..., bands) W m^-2, or photons s^-1 per pixel without a `photon_conversion`;
            (..., h, w, bands) under a colour filter. Integers become floating numbers of the same
            value. Traced NaN stays NaN up to the raw data.

    Returns:
        (..., bands) electrons per exposure; (..., h, w, 1), one number per pixel, under a colour
        filter.

    Raises:
        ValueError: `irradiance` is negative, NaN or infinite and not traced, or a spectral field of
            the sensor has another number of bands.

    Example:
        >>> sensor = jv.Sensor(quantum_efficiency=0.6, exposure_time=0.01)
        >>> float(jv.mean_photoelectrons(sensor, jnp.array([1e5]))[0])
        600.0
    """
    electrons = as_float(irradiance)
    _check_irradiance(electrons)
    if sensor.photon_conversion is not None:
        conversion = sensor.photon_conversion
        electrons = photon_rate(electrons, conversion.wavelength, conversion.pixel_area)
    offset = sensor.light_offset
    if isinstance(offset, ShutterOffset):
        assert sensor.exposure_time is not None  # asked for where the record is made
        longer = replace(sensor, exposure_time=jnp.maximum(sensor.exposure_time + offset.time, 0))
        return accumulate(longer, _free_dark(sensor, electrons))
    freed = accumulate(sensor, _free_dark(sensor, electrons))
    if offset is None:
        return freed
    beside = _band_values("Sensor.light_offset", offset, electrons)
    return freed + _free_dark(sensor, jnp.broadcast_to(beside, electrons.shape))


def _free_dark(sensor: Sensor, photons: Spectrum) -> Counts:
    """Return the photoelectrons that `photons` yield after all filters and the pixel's aperture."""
    electrons = photons
    if sensor.infrared_cut is not None:
        electrons = electrons * _band_values("Sensor.infrared_cut", sensor.infrared_cut, electrons)
    if sensor.quantum_efficiency is not None:
        efficiency = sensor.quantum_efficiency
        electrons = electrons * _band_values("Sensor.quantum_efficiency", efficiency, electrons)
    if sensor.colour_filter is not None:
        electrons = filtered(sensor.colour_filter, electrons)
    if sensor.pixel_aperture is not None:
        electrons = electrons * light_share(sensor.pixel_aperture)
    of = {"shape": electrons.shape, "dtype": electrons.dtype}
    return factored(electrons, sensor.taps, "quantum_efficiency", **of)


@takes_numbers
def expected_charge(sensor: Sensor, irradiance: Light) -> Counts:
    """Return the expected photoelectrons in each pixel after smear and crosstalk.

    Args:
        sensor: the sensor.
        irradiance: as in `mean_photoelectrons`: (..., bands) W m^-2 or photons s^-1 per pixel.

    Returns:
        (..., bands) electrons per exposure for pixels of mean sensitivity.

    Example:
        >>> sensor = jv.Sensor(quantum_efficiency=0.5, exposure_time=0.01)
        >>> print(jv.sensor.expected_charge(sensor, [[[2e5]]]).ravel())  # 2e5 photons a second
        [1000.]
    """
    electrons = mean_photoelectrons(sensor, irradiance)
    if sensor.smear is not None:
        electrons = smeared(electrons, sensor.smear)
    if sensor.crosstalk is not None:
        electrons = drifted(electrons, sensor.crosstalk)
    return electrons


@takes_numbers
def filtered(colour_filter: ColourFilter, electrons: Image) -> Counts:
    """Return the electrons that each pixel of a mosaic sensor counts.

    Args:
        colour_filter: transmissions of the colours and their pattern.
        electrons: (..., h, w, bands) electrons without the filter.

    Returns:
        (..., h, w, 1) electrons.

    Raises:
        ValueError: the pattern does not tile the picture or does not use every colour of the
            filter, or the numbers of bands differ.

    Example:
        >>> colours = jv.ColourFilter(np.eye(3), pattern=jv.bayer("RGGB"))
        >>> light = np.full((2, 2, 3), [100.0, 200.0, 400.0])  # electrons
        >>> print(jv.sensor.filtered(colours, light)[..., 0])
        [[100. 200.]
         [200. 400.]]
    """
    transmission = colour_filter.transmission
    check_pattern(colour_filter.pattern, bands=transmission.shape[0], name="ColourFilter.pattern")
    if electrons.ndim < 3 or electrons.shape[-1] != transmission.shape[1]:
        raise ValueError(
            f"ColourFilter.transmission is over {transmission.shape[1]} bands, the irradiance has "
            f"shape {electrons.shape}.{_rgb_advice(electrons.shape, transmission.shape[1])}"
        )
    seen = jnp.einsum("...b,cb->...c", electrons, transmission)
    return mosaic(seen, colour_filter.pattern)[..., None]


@takes_numbers
def drifted(electrons: Counts, crosstalk: Scalars) -> Counts:
    """Return the electrons after crosstalk: each pixel gives a share to each of its four
    neighbours.

    At the border of the image, as many electrons return as leave, so no electrons are lost.

    Args:
        electrons: (..., h, w, bands) electrons.
        crosstalk: () share that drifts to each neighbour, in [0, 1/4], no unit.

    Returns:
        (..., h, w, bands) electrons.

    Raises:
        ValueError: `electrons` is not an image.

    Example:
        >>> print(jv.sensor.drifted([[[0.0], [100.0], [0.0]]], 0.1).ravel())  # borders give back
        [10. 80. 10.]
    """
    check_image("Sensor.crosstalk", electrons.shape)

    def neighbours(axis: int) -> Scalars:
        size = electrons.shape[axis]
        own = jnp.arange(size)
        before, after = jnp.maximum(own - 1, 0), jnp.minimum(own + 1, size - 1)
        return jnp.take(electrons, before, axis) + jnp.take(electrons, after, axis)

    return electrons * (1 - 4 * crosstalk) + crosstalk * (neighbours(-3) + neighbours(-2))


@takes_numbers
def smeared(electrons: Counts, smear: Scalars) -> Counts:
    """Return the electrons with the smear that a CCD collects while its frame is shifted along the
    columns under light.

    Args:
        electrons: (..., h, w, bands) electrons.
        smear: () share of each other row of the column that a row collects, no unit.

    Returns:
        (..., h, w, bands) electrons.

    Raises:
        ValueError: `electrons` is not an image.

    Example:
        >>> column = [[[0.0]], [[1000.0]], [[0.0]]]  # a lamp in the middle row
        >>> print(jv.sensor.smeared(column, 0.01).ravel())
        [  10. 1000.   10.]
    """
    check_image("Sensor.smear", electrons.shape)
    column = electrons.sum(axis=-3, keepdims=True)
    return electrons + smear * (column - electrons)


@takes_numbers
def mean_dark(sensor: Sensor, like: Spectrum) -> Scalars:
    """Return mu_d, the expected number of dark electrons of a pixel in one exposure, () in the
    dtype of `like`; 0 without a dark current."""
    if sensor.dark_current is None:
        return jnp.zeros((), like.dtype)
    return accumulate(sensor, dark_rate(sensor.dark_current))


@takes_numbers
def accumulate(sensor: Sensor, rate: Scalars) -> Scalars:
    """Return the electrons that accumulate in one exposure at a given rate, e- s^-1. Without an
    `exposure_time` the result is the rate itself."""
    return rate if sensor.exposure_time is None else rate * sensor.exposure_time


def _check_irradiance(irradiance: Spectrum) -> None:
    if not is_known(irradiance) or irradiance.size == 0:
        return
    with jax.ensure_compile_time_eval():  # known values may occur inside a trace
        least, most = float(irradiance.min()), float(irradiance.max())
    if not (least >= 0 and most < jnp.inf):
        wrong = most if least >= 0 else least
        raise ValueError(f"irradiance must be finite and at least 0 everywhere, got {wrong}.")


def _band_values(name: str, x: Scalars, like: Spectrum) -> Scalars:
    """Return a scalar unchanged, or broadcast an array with one value per band over the pixels."""
    if x.ndim == 0:
        return x
    if x.shape != like.shape[-1:]:
        raise ValueError(
            f"{name} must be () or ({like.shape[-1]},), one per band of the irradiance, got shape "
            f"{x.shape}.{_rgb_advice(like.shape, x.size)}"
        )
    return jnp.broadcast_to(x, like.shape)


def _rgb_advice(shape: tuple[int, ...], bands: int) -> str:
    """Return advice for the error message if an RGB picture is given to a sensor with another
    number of bands."""
    if shape[-1:] != (3,) or bands == 3:
        return ""
    return (
        f" A picture of red, green and blue holds no spectrum: render with the sensor's {bands} "
        "bands, or take a sensor of three, such as "
        'Sensor(colour_filter=ColourFilter(np.eye(3), pattern="RGGB")).'
    )
