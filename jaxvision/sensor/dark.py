"""The dark current of a pixel, in electrons per second, as a function of temperature in K."""

import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ..core._types import Scalar
from ..scene import ArrheniusDarkCurrent, DarkCurrent, DoublingDarkCurrent

BOLTZMANN = 1.380649e-23  # J K^-1, exact in the SI since 2019
ELEMENTARY_CHARGE = 1.602176634e-19  # C, exact in the SI since 2019


@takes_numbers
def dark_rate(dark_current: Scalar | DarkCurrent) -> Scalar:
    """Return the dark current at the temperature given in its law.

    Args:
        dark_current: () e- s^-1 per pixel, returned unchanged, or a temperature law.

    Returns:
        () e- s^-1 per pixel.

    Example:
        >>> law = jv.DoublingDarkCurrent(10.0, 308.0, reference_temperature=300.0, doubling=8.0)
        >>> round(float(jv.sensor.dark_rate(law)), 6)
        20.0
    """
    match dark_current:
        case DoublingDarkCurrent(temperature=temperature, reference_temperature=reference):
            return dark_current.rate * jnp.exp2((temperature - reference) / dark_current.doubling)
        case ArrheniusDarkCurrent(temperature=temperature, reference_temperature=reference):
            per_kelvin = dark_current.activation_energy * (ELEMENTARY_CHARGE / BOLTZMANN)
            colder = (temperature - reference) / (temperature * reference)  # 1 / T_ref - 1 / T
            return dark_current.rate * jnp.exp(per_kelvin * colder)
        case _:
            return dark_current
