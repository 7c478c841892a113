"""Linear mixing of pixels after the counting, for a calibrated camera. The likelihood gives the
share of the variance, and the covariances give its distribution among the neighbours."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import Mixing

from .levels import REACH, PhotonTransfer
from .neighbours import PERIOD, Lags, above_dark, shares_of, tell_of_neighbours


def mixed_shares(measurement: PhotonTransfer, usable: np.ndarray) -> Lags:
    """The distribution of the variance that mixing takes from a pixel over the covariances."""
    bright, dark = measurement.bright, measurement.dark
    if not tell_of_neighbours(measurement):
        return shares_of(np.zeros(0), np.zeros((0,) * 3), np.zeros((0,) * 3))
    found, variances = above_dark(bright, dark)
    signal = np.asarray(bright.mean - dark.mean[measurement.dark_of])
    return shares_of(signal[usable], found[usable], variances[usable])


def fitted_mixing(
    shares: Lags | Float[Array, "lags lags"] | None, values: dict[str, Array]
) -> Mixing | None:
    """The mixing of a sensor: the kernel, even in both axes, whose autocorrelation gives the
    covariances of neighbours.
    """
    if shares is None or "pixel_mixing" not in values:
        return None
    lags = np.arange(-REACH, REACH + 1)
    places, sizes = np.ix_(lags % PERIOD, lags % PERIOD), np.ix_(abs(lags), abs(lags))
    around = jnp.zeros((PERIOD, PERIOD)).at[places].set(shares[sizes])
    share = jnp.maximum(values["pixel_mixing"], 0)
    power = 1 - share + share * jnp.fft.fft2(around).real
    kernel = jnp.fft.ifft2(jnp.sqrt(jnp.maximum(power, 0))).real
    kernel = kernel[places]
    return Mixing(kernel.at[REACH, REACH].add(1 - jnp.sum(kernel)))
