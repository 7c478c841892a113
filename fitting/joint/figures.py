"""Draw the pictures of a joint calibration."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from ..reflectance.from_images.figures import draw_lights
from ..report.figures import OF_CHANNEL, empty_panels
from .calibration import JointCalibration
from .fit import image_errors
from .model import predicted_parts
from .prediction import predict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BINS = 16
LARGEST = 4.0  # largest difference on the colour scale, standard deviations


def images_figure(calibration: JointCalibration) -> "Figure":
    """Draw measured, predicted, and their difference in deviations; columns are lights."""
    observation = calibration.observation
    fit = calibration.fits[len(calibration.fits) // 2]
    channel = observation.channels.index(fit.channel)
    covariance = calibration.posteriors[fit.channel].covariance

    def images_of(light: int) -> tuple[np.ndarray, ...]:
        made = predict(observation, fit, covariance, light)
        dn = np.where(made.usable, observation.dn[channel, light], np.nan)
        white = np.nanquantile(dn, 0.999) - observation.black
        seen = (np.stack([dn, made.mean])[:, None] - observation.black) / white
        return *seen, (dn - made.mean) / made.deviation

    return draw_lights(observation, images_of, "standard deviations", largest=LARGEST)


def noise_figure(calibration: JointCalibration) -> "Figure":
    """Draw the mean squared residual of a pixel and the model's variance as functions of the
    pixel's mean. Fitted errors of whole images are subtracted from the residual.
    """
    figure, axis = empty_panels((6.8, 4.2))
    for fit in calibration.fits:
        cells = fit.data.cells
        model, left = predicted_parts(jnp.asarray(fit.vector), fit.data)
        residual = left.residual
        found = image_errors(fit)
        if found is not None:
            assert model.image_errors is not None
            residual = residual - np.einsum("jk,jkc->jc", found[0], model.image_errors)
        squares = cells.scatter + cells.count * residual**2
        count, squares, mean, variance = (
            np.asarray(a).ravel() for a in (cells.count, squares, cells.mean, model.pixel_variance)
        )
        seen = count > 0
        edges = np.quantile(mean[seen], np.linspace(0, 1, BINS + 1))
        place = np.clip(np.searchsorted(edges, mean[seen], side="right") - 1, 0, BINS - 1)
        pixels = np.bincount(place, count[seen], BINS)
        measured = np.bincount(place, squares[seen], BINS) / pixels
        expected = np.bincount(place, (count * variance)[seen], BINS) / pixels
        level = np.bincount(place, (count * mean)[seen], BINS) / pixels
        colour, error = OF_CHANNEL[fit.channel], measured * np.sqrt(2 / pixels)
        axis.errorbar(level, measured, error, fmt="o", color=colour, label=fit.channel, ms=4)
        axis.plot(level, expected, color=colour)
    axis.set(xlabel="digital number [DN]", ylabel="variance of a pixel [DN²]", ylim=(0, None))
    axis.legend(fontsize=9)
    return figure


def lights_figure(calibration: JointCalibration) -> "Figure":
    """Draw the fitted strength of each light."""
    figure, axis = empty_panels((6.8, 3.6))
    width = 0.8 / len(calibration.fits)
    for i, fit in enumerate(calibration.fits):
        found = image_errors(fit)
        assert found is not None
        scale = 100 * float(fit.values["light_scatter"])
        size = scale * np.asarray(fit.data.relative["light_scatter"])
        mean, spread = (size * x[:, 0] for x in found)
        places = np.arange(len(mean)) + (i - (len(calibration.fits) - 1) / 2) * width
        axis.errorbar(places, mean, spread, fmt="o", ms=4, color=OF_CHANNEL[fit.channel])
    axis.axhline(0, color="0.7", lw=0.8)
    files = np.array(calibration.observation.files)[calibration.fits[0].grid.lights]
    axis.set_xticks(np.arange(len(files)), files, rotation=90, fontsize=8)
    axis.set_ylabel("light, relative to the rig [%]")
    return figure
