"""Pictures of a joint calibration."""

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from ..report.colours import OF_CHANNEL
from .calibration import JointCalibration
from .fit import image_errors
from .model import predicted_parts
from .prediction import predict

BINS = 16
SHOWN_LIGHTS = 4


def images_figure(calibration: JointCalibration) -> Figure:
    """Rows: measured, predicted, difference in standard deviations; columns: lights."""
    observation = calibration.observation
    fit = calibration.fits[len(calibration.fits) // 2]
    channel = observation.channels.index(fit.channel)
    covariance = calibration.posteriors[fit.channel].covariance
    unseen, seen = (np.flatnonzero(observation.held_out == kept) for kept in (True, False))
    lights = [*seen[: SHOWN_LIGHTS // 2], *unseen[: SHOWN_LIGHTS // 2]]
    figure = Figure(figsize=(1.2 + 2.2 * len(lights), 6.6), layout="constrained")
    axes = figure.subplots(3, len(lights), squeeze=False)
    for column, light in enumerate(lights):
        made = predict(calibration.observation, fit, covariance, int(light))
        dn = np.where(made.usable, observation.dn[channel, light], np.nan)
        top = np.nanquantile(dn, 0.999)
        left = (dn - made.mean) / made.deviation
        for row, values in enumerate((dn, made.mean, left)):
            plane = np.full(observation.shape, np.nan)
            plane[observation.rows, observation.columns] = values
            low, high, colours = (observation.black, top, "gray") if row < 2 else (-4, 4, "RdBu_r")
            axes[row, column].imshow(plane, vmin=low, vmax=high, cmap=colours)
            axes[row, column].set(xticks=[], yticks=[])
        kind = "held out" if observation.held_out[light] else "fitted"
        axes[0, column].set_title(f"{observation.files[light]}\n({kind})", fontsize=9)
    for row, label in enumerate(("measured", "predicted", "difference")):
        axes[row, 0].set_ylabel(label)
    scale = axes[2, 0].images[0]
    figure.colorbar(scale, ax=axes[2].tolist(), label="standard deviations", shrink=0.8)
    return figure


def noise_figure(calibration: JointCalibration) -> Figure:
    """Mean squared residual of a pixel, without the fitted errors of its image, against the model's
    variance, over the mean."""
    figure = Figure(figsize=(6.8, 4.2), layout="constrained")
    axis = figure.subplots()
    for fit in calibration.fits:
        cells, values = fit.data.cells, fit.values
        model, _, _ = predicted_parts(jnp.asarray(fit.vector), fit.data)
        residual = cells.mean - model.mean
        found = image_errors(fit)
        if found is not None:
            assert model.image_errors is not None
            residual = residual - np.einsum("jk,jkc->jc", found[0], model.image_errors)
        variance = model.variance
        if "prnu" in values:
            variance = variance + (values["prnu"] * model.relative) ** 2
        if model.misfit is not None:
            variance = variance + model.misfit**2
        squares = cells.scatter + cells.count * residual**2
        count, squares, mean, variance = (
            np.asarray(a).ravel() for a in (cells.count, squares, cells.mean, variance)
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


def lights_figure(calibration: JointCalibration) -> Figure:
    """The fitted strength of each light."""
    figure = Figure(figsize=(6.8, 3.6), layout="constrained")
    axis = figure.subplots()
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
    axis.set_ylabel("light, less what the rig says [%]")
    return figure
