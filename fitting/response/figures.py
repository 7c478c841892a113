"""Figures of a response calibration: curves, deviations from gamma, exposure offsets, the merged
radiance map and its coverage."""

from dataclasses import replace
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxvision.point_ops import srgb_encode

from ..inference.formatting import format_value
from ..report.figures import colour_of, empty_panels
from .calibration import ChannelResponse, ResponseCalibration, crop_alike, radiance_images
from .findings import DRAWN
from .shape import shapes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_GROUPS = 9
MOST_MAPS = 4  # groups whose maps are drawn
MIDDLE_GREY = 0.18  # of white
DOTS = 1500  # pixels drawn per channel
LEGEND = 0.2  # share of the height of an axis for its legend


def curve_figure(calibration: ResponseCalibration) -> "Figure":
    """Draw log exposure against code with data, 95 % band and best gamma, for each group."""
    figure, panels = _panels(calibration, height=3.4)
    for axis, channels in panels:
        for i, channel in enumerate(channels):
            # The widest line is drawn first, so that curves that agree are all visible.
            _draw_curve(axis, channel, width=1.5 + 2.0 * (len(channels) - 1 - i))
        axis.set(xscale="log", yscale="log")
        axis.set_xlabel("code above black (DN)")
        axis.set_ylabel("exposure (mid-scale = 1)")
        axis.legend(fontsize=9, loc="upper left")
        axis.grid(alpha=0.3)
    return figure


def _draw_curve(axis: "Axes", channel: ChannelResponse, *, width: float) -> None:
    curve, colour = channel.curve, colour_of(channel.plane.channel)
    z = curve.codes - curve.bins.black
    g, seen = curve.log_exposure, curve.seen
    rng = np.random.default_rng(0)
    flat = channel.plane.codes.reshape(len(channel.plane.exposures), -1)
    pick = rng.choice(flat.shape[1], min(DOTS // 4, flat.shape[1]), replace=False)
    covered = channel.radiance.coverage.ravel()[pick] > 1
    x = flat[:, pick[covered]].astype(float)
    y = channel.radiance.radiance.ravel()[pick[covered]] * channel.plane.exposures[:, None]
    usable = (curve.bins.lookup[x.astype(int)] >= 0) & (y > np.exp(g[0]))
    axis.plot(
        x[usable] - curve.bins.black,
        y[usable],
        ".",
        ms=2,
        alpha=0.15,
        color=colour,
        zorder=1,
        rasterized=True,
    )
    band = curve.half_width
    axis.fill_between(
        z[seen], np.exp((g - band)[seen]), np.exp((g + band)[seen]), color=colour, alpha=0.25
    )
    gamma, (shape,) = channel.gamma.gamma.value or np.nan, shapes([channel])
    exponent = f"γ = {format_value(channel.gamma.gamma)}" if shape.pure else f"best γ {gamma:.3g}"
    label = f"{channel.plane.channel}, {exponent}"
    axis.plot(z, np.exp(np.where(seen, g, np.nan)), color=colour, lw=width, label=label)
    axis.plot(z, np.exp(g), color=colour, lw=0.8, ls=":")
    pure = gamma * np.log(z) + np.nanmedian(g[seen] - gamma * np.log(z[seen]))
    axis.plot(z, np.exp(pure), color=colour, lw=0.8, ls="--")


def departure_figure(calibration: ResponseCalibration) -> "Figure":
    """Draw the deviation of the measured curve from the best gamma (left) and from sRGB (right)."""
    shown = calibration.channels[: 4 * MOST_GROUPS]
    figure, (left, right) = empty_panels((9, 3.6), columns=2)
    for channel in shown:
        curve, colour = channel.curve, colour_of(channel.plane.channel)
        band = np.where(curve.seen, curve.half_width, np.nan)
        judged = curve.standard_error < DRAWN
        for axis, gap in ((left, channel.gamma.departure), (right, channel.gamma.srgb_departure)):
            gap = np.where(judged, gap, np.nan)
            axis.plot(curve.codes, 100 * gap, color=colour, lw=1.2, label=channel.plane.label)
            axis.fill_between(
                curve.codes, 100 * (gap - band), 100 * (gap + band), color=colour, alpha=0.2, lw=0
            )
    for axis, name in ((left, "the best gamma"), (right, "sRGB")):
        axis.axhline(0, color="0.4", lw=0.8)
        axis.set(xlabel="code (DN)", title=f"against {name}")
        axis.grid(alpha=0.3)
    left.set_ylabel("departure in ln exposure (%)")
    if len(shown) <= 4 and any(channel.plane.label for channel in shown):
        left.legend(fontsize=9)
    return figure


def offsets_figure(calibration: ResponseCalibration) -> "Figure":
    """Draw the offset of each image's exposure from its nominal time, for each group."""
    figure, panels = _panels(calibration, height=2.8)
    for axis, channels in panels:
        for i, channel in enumerate(channels):
            curve = channel.curve
            nudge = 1 + 0.04 * (i - (len(channels) - 1) / 2)
            axis.errorbar(
                curve.exposures * nudge,
                100 * curve.shutter_offsets,
                yerr=196 * curve.shutter_offset_errors,
                fmt="o",
                ms=4,
                lw=1,
                color=colour_of(channel.plane.channel),
                label=channel.plane.channel,
            )
        axis.axhline(0, color="0.4", lw=0.8)
        axis.set_xscale("log")
        axis.set(xlabel="nominal exposure time (s)", ylabel="offset in ln t (%)")
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + LEGEND * (high - low))
        axis.legend(fontsize=9, ncols=len(channels), loc="upper center")
        axis.grid(alpha=0.3)
    return figure


def radiance_figure(
    calibration: ResponseCalibration, images: dict[str, Float[np.ndarray, "h w *rgb"]]
) -> "Figure":
    """Draw each map beside its middle exposure alone, at white and brightened."""
    shown = list(images.items())[:MOST_MAPS]
    tall = shown[0][1].shape[0] / shown[0][1].shape[1]
    figure, axes = empty_panels(
        (5.2, 2 * len(shown) * (2.6 * tall + 0.3)), rows=2 * len(shown), columns=2, squeeze=False
    )
    for i, (group, image) in enumerate(shown):
        single, seconds = _middle_exposure(calibration, group)
        white = float(np.nanquantile(image, 0.999))
        dark = max(float(np.nanquantile(image, 0.2)), 1e-4 * white)
        shadows = int(2 ** max(2, round(np.log2(MIDDLE_GREY * white / dark))))
        for row, gain in zip(axes[2 * i : 2 * i + 2], (1, shadows), strict=True):
            brighter = f", {gain} times brighter" if gain > 1 else ""
            for axis, light, name in zip(
                row, (image, single), (f"{group} merged", f"{seconds:.4g} s alone"), strict=True
            ):
                axis.imshow(encoded(light, white / gain), cmap="gray", vmin=0, vmax=1)
                axis.set_title(f"{name}{brighter}".strip(), fontsize=9)
                axis.set_axis_off()
    return figure


def coverage_figure(calibration: ResponseCalibration) -> "Figure":
    """Draw the number of exposures used for each pixel, in the channel with the fewest."""
    figure, panels = _panels(calibration, height=4.0)
    drawn = None
    most = max(len(channels[0].plane.exposures) for _, channels in panels)
    for axis, channels in panels:
        worst = np.min(crop_alike([channel.radiance.coverage for channel in channels]), axis=0)
        drawn = axis.imshow(worst, vmin=0, vmax=most, cmap="viridis", interpolation="nearest")
        axis.set_axis_off()
    assert drawn is not None
    figure.colorbar(drawn, ax=figure.axes, label="exposures used", shrink=0.8)
    return figure


def encoded(radiance: Float[np.ndarray, "h w *rgb"], white: float) -> np.ndarray:
    """Encode radiance as sRGB in 0..1, clipped at `white`; NaN becomes black."""
    return np.nan_to_num(np.asarray(srgb_encode(jnp.asarray(np.clip(radiance / white, 0, 1)))))


def _middle_exposure(
    calibration: ResponseCalibration, group: str
) -> tuple[Float[np.ndarray, "h w *rgb"], float]:
    """Return the radiance from the middle exposure alone, and its time in s."""
    found, seconds = [], np.nan
    for channel in calibration.channels:
        plane, curve = channel.plane, channel.curve
        if plane.group == group:
            middle = len(plane.exposures) // 2
            seconds = float(plane.exposures[middle])
            log_exposure = np.interp(plane.codes[middle], curve.codes, curve.log_exposure)
            alone = replace(channel.radiance, radiance=np.exp(log_exposure) / seconds)
            found.append(replace(channel, radiance=alone))
    return radiance_images(replace(calibration, channels=tuple(found)))[group], seconds


def _panels(
    calibration: ResponseCalibration, *, height: float
) -> "tuple[Figure, list[tuple[Axes, list[ChannelResponse]]]]":
    """Return a figure, and for each group of images an axis with the group's channels."""
    of_group: dict[str, list[ChannelResponse]] = {}
    for channel in calibration.channels:
        of_group.setdefault(channel.plane.group, []).append(channel)
    groups = list(of_group.items())[:MOST_GROUPS]
    columns = min(3, len(groups))
    rows = -(-len(groups) // columns)
    width = 5.4 if columns == 1 else 4.4 * columns
    figure, panels = empty_panels(
        (width, height * rows + 0.4), rows=rows, columns=columns, squeeze=False
    )
    axes = panels.ravel()
    for axis in axes[len(groups) :]:
        axis.set_axis_off()
    for axis, (group, _) in zip(axes, groups, strict=False):
        axis.set_title(group, fontsize=10)
    return figure, [(axis, own) for axis, (_, own) in zip(axes, groups, strict=False)]
