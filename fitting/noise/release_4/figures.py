"""Figures of release 4: spatial variances, signal-to-noise ratio, histograms, spectrograms and
profiles."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...report.figures import BLUE, GREEN, GREY, ORANGE, RED, empty_panels
from ...report.section import Picture
from ..levels import signal_of
from .average_frames import histogram, spectrogram
from .nonuniformity import Split, can_filter, high_pass
from .sheet import PARTS, Release4
from .stacks import Averages

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE = (5.4, 4.6)
PURPLE = "tab:purple"
COLOURS = {"total": "k", "row": BLUE, "col": ORANGE, "pixel": GREEN}
WIDE = 10  # ratio of amplitudes from which their axis is logarithmic
NAMES = {"total": "all pixels", "row": "rows", "col": "columns", "pixel": "pixels"}


def signal_to_noise(sheet: Release4) -> Picture:
    """Return the figure of the *General* sheet, drawn when asked."""
    return Picture(
        "signal_to_noise",
        "Signal to noise ratio without a model",
        "Output: signal above dark over temporal noise. Input: light over that noise divided by "
        "the slope of the response. Total: with the spatial variance, as in a single frame. Grey: "
        "the limit of a sensor that loses no photon.",
        partial(signal_to_noise_figure, sheet),
    )


def pictures_of_images(sheet: Release4) -> tuple[Picture, ...]:
    """Return the figures of the *Linear* sheet, drawn when asked; () without images."""
    averages = sheet.stacks.averages
    if averages is None:
        return ()
    filtered = can_filter(averages.lit.image.shape)
    how = "after the high-pass" if filtered else "without the high-pass"
    return (
        Picture(
            "spatial_variances",
            "Nonuniformity and noise at all levels",
            "Standard deviations of the contributions of rows, columns and pixels, "
            f"{how}, against the signal, with the temporal noise of a pixel. A part that noise "
            "makes negative is not drawn; circles on the left are the dark.",
            partial(spatial_variances_figure, sheet),
        ),
        Picture(
            "histograms",
            "Logarithmic histograms",
            f"Deviations of the pixels from the mean, {how}; dashed, a Gaussian of the same "
            "standard deviation. Pixels off the curve are defects.",
            partial(histograms_figure, averages, accumulated=False),
        ),
        Picture(
            "accumulated_histograms",
            "Accumulated histograms",
            f"Share of the pixels that deviate from the mean by at least as much, {how}.",
            partial(histograms_figure, averages, accumulated=True),
        ),
        Picture(
            "spectrograms",
            "Spectrograms",
            "Amplitude of each frequency in the average frames, along the rows (horizontal) and "
            "along the columns (vertical). Independent pixels lie in the grey band (95 % at each "
            "frequency); lines above it are periodic patterns, a rise on the left is uneven light.",
            partial(spectrograms_figure, averages),
        ),
        Picture(
            "profiles",
            "Profiles",
            "The middle line of the average frames, and the mean, least and most of all lines; "
            "above the bright level less its dark, below the dark.",
            partial(profiles_figure, averages),
        ),
    )


def spatial_variances_figure(sheet: Release4) -> "Figure":
    """Draw standard deviations of rows, columns and pixels over the signal, on logarithmic axes."""
    stacks = sheet.stacks
    bright = stacks.measurement.bright
    matched = np.asarray(stacks.measurement.dark_of)
    signal = signal_of(stacks.measurement)
    shown = signal > 0
    if sheet.within.saturation is not None:
        shown &= np.asarray(bright.light) <= float(sheet.within.saturation)
    figure, axis = empty_panels(SIZE)
    temporal = np.sqrt(np.maximum(np.asarray(bright.variance), 0))
    drawable = shown & (temporal > 0)
    axis.loglog(
        signal[drawable], temporal[drawable], "x", color=PURPLE, ms=4, label="temporal noise"
    )
    left = 0.6 * float(signal[shown].min())
    for part in PARTS:
        deviation = _deviations(stacks.bright, part)
        axis.loglog(
            signal[shown],
            deviation[shown],
            ".-",
            color=COLOURS[part],
            ms=5,
            lw=0.8,
            label=f"s of {NAMES[part]}",
        )
        unlit = _deviations(stacks.dark, part)[np.unique(matched)]
        axis.plot(
            np.full(unlit.shape, left), unlit, "o", mfc="none", color=COLOURS[part], ms=4, mew=0.8
        )
    axis.plot([], [], "o", mfc="none", color=GREY, ms=4, label="dark")
    axis.set_xlabel("mean signal above dark [DN]")
    axis.set_ylabel("standard deviation [DN]")
    figure.legend(fontsize=8, loc="outside upper center", ncols=3)
    return figure


def _deviations(splits: tuple[Split, ...], part: str) -> np.ndarray:
    variances = np.array([getattr(one, part) for one in splits])
    return np.sqrt(np.where(variances > 0, variances, np.nan))


def signal_to_noise_figure(sheet: Release4) -> "Figure":
    """Draw the signal-to-noise ratios over light, on logarithmic axes."""
    general, measurement = sheet.general, sheet.stacks.measurement
    figure, axis = empty_panels((SIZE[0], 3.8))
    light = general.light
    axis.loglog(light, general.output, "o", color=ORANGE, mfc="none", ms=7, mew=0.8, label="output")
    axis.errorbar(
        light, general.input, 2 * general.input_errors, fmt=".", color=BLUE, ms=5, lw=0.8,
        label="input (± 2 standard errors)",
    )  # fmt: skip
    if general.total is not None:
        axis.loglog(light, general.total, ".-", color=GREEN, ms=4, lw=0.8, label="total, input")
    if measurement.photons_known:
        axis.loglog(light, np.sqrt(light), color=GREY, lw=0.8, label="ideal sensor")
        axis.set_xlabel("light [photons per pixel and exposure]")
    else:
        axis.set_xlabel("light, as exposure [s]")
    axis.set_ylabel("signal to noise ratio")
    axis.legend(fontsize=9, loc="upper left")
    return figure


def defect_images(averages: Averages) -> tuple[tuple[str, str, np.ndarray, float], ...]:
    """Return (name, unit, deviations of the pixels, steps of the average per unit) for DSNU and for
    PRNU. For DSNU, the deviations are those of the dark, DN. For PRNU, they are those of the bright
    level minus its dark, in per cent of the signal. The high-pass filter is applied to images that
    are large enough for it."""
    lit, unlit = averages.lit, averages.unlit
    response = lit.image - unlit.image
    signal = float(response.mean())
    images = [unlit.image, 100 * response / signal]
    if can_filter(response.shape):
        images = [high_pass(image) for image in images]
    else:
        images = [image - image.mean() for image in images]
    return (
        ("DSNU", "DN", images[0], unlit.frames),
        ("PRNU", "%", images[1], lit.frames * signal / 100),
    )


def histograms_figure(averages: Averages, *, accumulated: bool) -> "Figure":
    """Draw the histograms, or the accumulated histograms, of deviations for DSNU and PRNU."""
    figure, axes = empty_panels(SIZE, rows=2)
    for axis, (name, unit, image, steps) in zip(axes, defect_images(averages), strict=True):
        found = histogram(image, steps)
        if accumulated:
            axis.semilogy(found.deviations, found.share, color=BLUE, lw=1.2, label=name)
            axis.set(ylim=(50 / image.size, 150), ylabel="share of pixels [%]")
            axis.set_xlabel(f"least deviation from the mean [{unit}]")
        else:
            counts = np.where(found.counts > 0, found.counts, np.nan)
            axis.semilogy(found.centres, counts, ".-", color=BLUE, ms=3, lw=0.8, label=name)
            axis.semilogy(found.centres, found.gaussian, "--", color=ORANGE, lw=1, label="Gaussian")
            axis.set(ylim=(0.5, 2 * found.counts.max()), ylabel="pixels")
            axis.set_xlabel(f"deviation from the mean [{unit}]")
        axis.legend(fontsize=9, loc="upper right")
    return figure


def spectrograms_figure(averages: Averages) -> "Figure":
    """Draw amplitudes over frequency, DSNU above PRNU, the horizontal beside the vertical ones."""
    lit, unlit = averages.lit, averages.unlit
    response = lit.image - unlit.image
    figure, axes = empty_panels((7.2, SIZE[1]), rows=2, columns=2, sharex=True, sharey="row")
    of_both = (("DSNU", "DN", unlit.image), ("PRNU", "%", 100 * response / response.mean()))
    for row, (name, unit, image) in zip(axes, of_both, strict=True):
        for axis, (along, direction) in zip(row, ((1, "horizontal"), (0, "vertical")), strict=True):
            found = spectrogram(image, along)
            low, high = np.sqrt(found.band)
            axis.axhspan(low, high, color=GREY, alpha=0.25, lw=0)
            amplitude = np.sqrt(found.power[1:])
            axis.plot(found.cycles[1:], amplitude, color=BLUE, lw=0.8)
            if amplitude.max() > WIDE * amplitude.min():
                axis.set_yscale("log")
            axis.set_title(f"{name}, {direction}", fontsize=9)
        row[0].set_ylabel(f"amplitude [{unit}]")
    for axis in axes[1]:
        axis.set_xlabel("cycles per pixel")
    return figure


def profiles_figure(averages: Averages) -> "Figure":
    """Draw the profiles of clause 8.7, DN, horizontal beside vertical."""
    lit, unlit = averages.lit, averages.unlit
    figure, axes = empty_panels((7.2, SIZE[1]), rows=2, columns=2, sharex="col", sharey="row")
    for row, (name, image) in zip(
        axes, (("bright", lit.image - unlit.image), ("dark", unlit.image)), strict=True
    ):
        for axis, lines, direction in zip(
            row, (image, image.T), ("horizontal", "vertical"), strict=True
        ):
            for label, y, colour in (
                ("least", lines.min(axis=0), GREY),
                ("most", lines.max(axis=0), RED),
                ("middle line", lines[len(lines) // 2], ORANGE),
                ("mean", lines.mean(axis=0), BLUE),
            ):
                axis.plot(y, color=colour, lw=0.8, label=label)
            axis.set_title(f"{name}, {direction}", fontsize=9)
        row[0].set_ylabel("average frame [DN]")
    axes[1, 0].set_xlabel("column")
    axes[1, 1].set_xlabel("row")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4,
                  fontsize=9)  # fmt: skip
    return figure
