"""Dark current in electrons per second and pixel over temperature in K."""

import jax.numpy as jnp

from .._types import Scalar
from ..scene import ArrheniusDarkCurrent, DarkCurrent, DoublingDarkCurrent

BOLTZMANN = 1.380649e-23  # J K^-1, exact in the SI since 2019
ELEMENTARY_CHARGE = 1.602176634e-19  # C, exact in the SI since 2019


def dark_rate(dark_current: Scalar | DarkCurrent) -> Scalar:
    """Electrons per second that a pixel frees in the dark at the law's temperature, () e- s^-1."""
    match dark_current:
        case DoublingDarkCurrent(temperature=temperature, reference_temperature=reference):
            return dark_current.rate * jnp.exp2((temperature - reference) / dark_current.doubling)
        case ArrheniusDarkCurrent(temperature=temperature, reference_temperature=reference):
            per_kelvin = dark_current.activation_energy * (ELEMENTARY_CHARGE / BOLTZMANN)
            colder = (temperature - reference) / (temperature * reference)  # 1 / T_ref - 1 / T
            return dark_current.rate * jnp.exp(per_kelvin * colder)
        case _:
            return dark_current
