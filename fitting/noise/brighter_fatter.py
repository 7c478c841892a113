"""Estimates of a camera's brighter-fatter effect and of the linear mixing of neighbouring pixels.

Each electron in a pixel changes the area of the pixel i rows and j columns away by the fraction
a_ij (Astier et al. 2019). Variances and covariances together determine a_00. The covariances
determine the a_ij of the neighbours. The kernel of a sensor is fitted to all a_ij. For linear
mixing after charge collection, the likelihood determines the share of the variance that a pixel
loses to its neighbours. The covariances determine how that share is distributed over the
neighbours.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision import BrighterFatter, Mixing
from jaxvision.sensor import area_changes, flat_covariances

from .levels import PhotonTransfer
from .live_pixels import LARGEST_LAG
from .model import electrons_and_steps
from .neighbours import COPIES, PERIOD, Lags, above_dark, area_shape
from .statement import LikelihoodFit

STEPS = 6  # Gauss-Newton steps; the model is nearly linear


@dataclass(frozen=True)
class AreaChanges:
    """The relative changes a_ij of pixel areas per electron, with standard errors."""

    values: Lags  # (lags, lags) a_ij per electron, at offsets of 0, 1, ... rows and columns
    errors: Lags  # standard errors; a_00 has its error from the likelihood


def own_area_change(fit: LikelihoodFit) -> tuple[float, float]:
    """Return a_00 and its standard error, per electron."""
    labels = [parameter.name for parameter in fit.space]
    beta, gain = (float(fit.values[name]) for name in ("brighter_fatter", "system_gain"))
    scale = gain / float(fit.data.top_signal)
    slope = np.zeros(len(labels))  # the vector holds beta and ln K
    slope[labels.index("brighter_fatter")] = scale
    slope[labels.index("system_gain")] = beta * scale
    return -beta * scale, float(np.sqrt(fit.inflation * slope @ fit.covariance @ slope))


def fitted_area_changes(
    measurement: PhotonTransfer, usable: np.ndarray, fit: LikelihoodFit
) -> AreaChanges | None:
    """Fit the form of Astier et al. (2019) to the covariances; None if these are unknown."""
    above = above_dark(measurement)
    if above is None:
        return None
    found, variances, _ = above
    bright = slice(0, len(usable))
    mu, step = electrons_and_steps(fit.values, fit.data)
    scale = np.asarray(step)[bright, None, None] ** 2
    own, own_error = own_area_change(fit)
    mixing = "pixel_mixing" in fit.values
    args = mu[bright], jnp.asarray(found[usable] / scale), jnp.asarray(variances[usable] / scale**2)
    values, errors = (
        np.array(x) for x in _fit_area_changes(jnp.asarray(own), *args, mixing=mixing)
    )
    errors[0, 0] = own_error
    return AreaChanges(values, errors)


@eqx.filter_jit
def _fit_area_changes(
    own: Array, mu: Array, found: Array, variances: Array, *, mixing: bool
) -> tuple[Array, Array]:
    """Fit the a_ij at fixed a_00, with `mixing` also terms in mu; return a_ij and errors."""
    size = (LARGEST_LAG + 1) ** 2 - 1
    weight = 1 / jnp.sqrt(variances)

    def residuals(vector: Array) -> Array:
        a = jnp.concatenate([own[None], vector[:size]]).reshape(LARGEST_LAG + 1, LARGEST_LAG + 1)
        expected = flat_covariances(a, mu)
        if mixing:
            share = jnp.concatenate([jnp.zeros(1), vector[size:]]).reshape(1, *a.shape)
            expected = expected + share * mu[:, None, None]
        return (weight * (found - expected)).reshape(len(mu), -1)[:, 1:].ravel()

    # mu^2 a_ij and shares of mu, so that all unknowns have a similar scale
    unit = jnp.concatenate([jnp.full(size, 1 / jnp.max(mu)), jnp.ones(size if mixing else 0)])
    vector = jnp.zeros(unit.size)
    slopes = jnp.zeros((1, 1))
    for _ in range(STEPS):
        slopes = jax.jacfwd(lambda v: residuals(v * unit))(vector / unit)
        vector = vector - unit * jnp.linalg.lstsq(slopes, residuals(vector))[0]
    errors = unit * jnp.sqrt(jnp.diagonal(jnp.linalg.inv(slopes.T @ slopes)))
    values = jnp.concatenate([own[None], vector[:size]]).reshape(LARGEST_LAG + 1, LARGEST_LAG + 1)
    return values, jnp.concatenate([jnp.zeros(1), errors[:size]]).reshape(values.shape)


def fitted_kernel(
    measurement: PhotonTransfer, usable: np.ndarray
) -> Float[np.ndarray, "rows columns"]:
    """Return the kernel, scaled to a_00 = -1, whose area changes fit the measured ones best."""
    weight = np.sqrt(np.maximum(COPIES, 1))
    of_kernel = np.asarray(jax.jacfwd(area_changes)(jnp.zeros((LARGEST_LAG, LARGEST_LAG))))
    design = (weight[:, :, None, None] * of_kernel).reshape(weight.size, -1)
    wanted = -(weight * area_shape(measurement, usable)).ravel()
    kernel = np.linalg.lstsq(design, wanted, rcond=None)[0].reshape(LARGEST_LAG, LARGEST_LAG)
    return kernel / -np.asarray(area_changes(jnp.asarray(kernel)))[0, 0]


def fitted_effect(
    kernel: Float[Array | np.ndarray, "rows columns"] | None,
    values: dict[str, Array],
    top: Array | np.ndarray,
) -> BrighterFatter | None:
    """Return the fitted brighter-fatter effect of a `Sensor`; None if it was not fitted."""
    if kernel is None or "brighter_fatter" not in values:
        return None
    change = jnp.maximum(values["brighter_fatter"], 0) * values["system_gain"] / top
    return BrighterFatter(jnp.asarray(kernel) * change)


def fitted_mixing(
    shares: Lags | Float[Array, "lags lags"] | None, values: dict[str, Array]
) -> Mixing | None:
    """Return the fitted linear mixing of neighbouring pixels as a field of a `Sensor`; None if
    mixing was not fitted. The kernel of the mixing is even in rows and in columns. The
    autocorrelation of the kernel reproduces the fitted covariances of neighbouring pixels.
    """
    if shares is None or "pixel_mixing" not in values:
        return None
    lags = np.arange(-LARGEST_LAG, LARGEST_LAG + 1)
    places, sizes = np.ix_(lags % PERIOD, lags % PERIOD), np.ix_(abs(lags), abs(lags))
    around = jnp.zeros((PERIOD, PERIOD)).at[places].set(shares[sizes])
    share = jnp.maximum(values["pixel_mixing"], 0)
    power = 1 - share + share * jnp.fft.fft2(around).real
    kernel = jnp.fft.ifft2(jnp.sqrt(jnp.maximum(power, 0))).real
    kernel = kernel[places]
    return Mixing(kernel.at[LARGEST_LAG, LARGEST_LAG].add(1 - jnp.sum(kernel)))
