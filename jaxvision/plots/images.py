"""Plot an image, several images side by side, or a map of any quantity."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from . import _views as views
from .legible_axes import new_axes
from .summary import band_names, checked, white_level

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_NUMBER = "magenta"  # where a map is NaN


def picture(image: np.ndarray, *, white: float | None = None, axes: "Axes | None" = None) -> "Axes":
    """Show an image as a picture. Integer codes, and values up to `white`, are shown unchanged.
    Radiance is encoded in sRGB.

    Args:
        image: (h, w) or (h, w, bands), DN or relative; for more than 4 bands their mean is shown.
        white: value that is shown as white, as for `summarise`. Floating images that exceed it,
            such as radiance, are scaled to their 99th percentile and encoded instead, as the title
            states.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes; NaN is magenta.

    Raises:
        InputError: for an array that is no image.

    Example:
        >>> axes = jv.plots.picture(np.linspace(0, 3, 12).reshape(3, 4))
        >>> print(axes.get_title())
        sRGB of value / 2.97, brightest cut
    """
    pixels = checked(image)
    shown, how = views.as_picture(pixels, white_level(pixels, white))
    axes = new_axes(axes)
    axes.imshow(shown, interpolation="nearest" if max(shown.shape) < 200 else "antialiased")
    axes.set_title(how, fontsize=9)
    axes.set_axis_off()
    return axes


def pictures(
    images: Mapping[str, np.ndarray],
    *,
    columns: int | None = None,
    limits: tuple[float, float] | None = (0.0, 1.0),
    colours: str = "gray",
    unit: str = "",
    inches: float = 2.6,
) -> "Figure":
    """Show images side by side with their titles, on one scale for comparison.

    Args:
        images: (h, w), (h, w, 1), or (h, w, 3) encoded for display, by title.
        columns: number of columns of the figure; None for a single row.
        limits: values of black and white; None for 0 and each image's own largest value.
        colours: matplotlib colour map for images of one band.
        unit: unit of the values; images of one band have a colour bar if it is given, or if
            `limits` is None.
        inches: width of each image, inches.

    Returns:
        The figure; values beyond the limits have the colour of the nearest limit.

    Raises:
        InputError: without images, for a number of columns below 1, and for images with other than
            1 or 3 bands.

    Example:
        >>> figure = jv.plots.pictures({"dark": np.zeros((2, 3)), "light": np.ones((2, 3))})
        >>> print([axes.get_title() for axes in figure.axes])
        ['dark', 'light']
    """
    from matplotlib.figure import Figure

    pixels = {title: checked(image) for title, image in images.items()}
    across = len(pixels) if columns is None else min(columns, len(pixels))
    if across < 1 or any(shown.shape[2] not in (1, 3) for shown in pixels.values()):
        raise InputError("pictures takes one column or more of images of one band or of three.")
    down = -(-len(pixels) // across)
    tallest = max(shown.shape[0] / shown.shape[1] for shown in pixels.values())
    figure = Figure(
        figsize=(inches * across, (inches * tallest + 0.3) * down), layout="constrained"
    )
    for i, (title, shown) in enumerate(pixels.items()):
        axes = figure.add_subplot(down, across, i + 1)
        brightest = float(np.max(shown, initial=0, where=np.isfinite(shown)))
        low, high = limits or (0.0, brightest or 1.0)
        if shown.shape[2] == 3:
            axes.imshow(np.clip((shown - low) / (high - low), 0, 1))
        else:
            image = axes.imshow(shown[..., 0], cmap=colours, vmin=low, vmax=high)
            if unit or limits is None:
                figure.colorbar(image, ax=axes, shrink=0.8, pad=0.02).set_label(unit, fontsize=8)
        axes.set_title(title, fontsize=9)
        axes.set_axis_off()
    return figure


def false_colour(
    values: np.ndarray,
    *,
    unit: str = "",
    label: str = "",
    logarithmic: bool = False,
    limits: tuple[float, float] | None = None,
    axes: "Axes | None" = None,
) -> "Axes":
    """Plot a map of one quantity in a perceptually uniform colour scale from dark to light.

    Args:
        values: (h, w) or (h, w, 1), any unit.
        unit: unit of the values.
        label: name of the quantity, such as "irradiance".
        logarithmic: whether the colour scale is logarithmic; values <= 0 then have the colour of
            the lowest.
        limits: smallest and largest value of the scale; None for the range of all finite values.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes; NaN is magenta, and values beyond the limits have the colour of the nearest limit.

    Raises:
        InputError: for several bands, no finite value, and limits that define no scale.

    Example:
        >>> axes = jv.plots.false_colour(np.eye(3), unit="W m$^{-2}$", label="irradiance")
        >>> print(axes.images[0].get_clim(), axes.images[0].colorbar.ax.get_ylabel())
        (0.0, 1.0) irradiance [W m$^{-2}$]
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm, Normalize

    pixels = checked(values).astype(float)
    if pixels.shape[2] != 1:
        raise InputError(f"a map is (h, w), one quantity, got {pixels.shape[2]} bands; choose one.")
    plane = pixels[..., 0]
    known = plane[np.isfinite(plane) & ((plane > 0) if logarithmic else True)]
    if limits is None and not known.size:
        raise InputError("a map needs a finite value, above 0 on a logarithmic scale.")
    low, high = (known.min(), known.max()) if limits is None else limits
    if not low <= high or (logarithmic and low <= 0):
        raise InputError(f"limits {low:g} and {high:g} make no scale; give the lower one first.")
    scale = (LogNorm if logarithmic else Normalize)(low, high)
    if logarithmic:
        plane = np.where(plane < low, low, plane)
    axes = new_axes(axes)
    colours = colormaps["viridis"].with_extremes(bad=NO_NUMBER)
    image = axes.imshow(plane, norm=scale, cmap=colours, interpolation="nearest")
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.85)
    bar.set_label(f"{label} [{unit}]" if label and unit else label or unit)
    axes.set(xlabel="column", ylabel="row")
    return axes


def histogram(
    image: np.ndarray, *, white: float | None = None, axes: "Axes | None" = None
) -> "Axes":
    """Plot the number of pixels of each channel in bins of equal width. If the values span more
    than three decades, the bins are of log10 of the values. Values at or below 0 have no logarithm;
    the axis label states their number.

    Args:
        image: (h, w) or (h, w, bands), DN or relative.
        white: the largest value of an integer image, as for `summarise`.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes.

    Raises:
        InputError: for an array that is no image.

    Example:
        >>> axes = jv.plots.histogram(np.arange(256, dtype=np.uint8).reshape(16, 16))
        >>> print(axes.get_xlabel(), axes.get_ylabel())
        value (DN) pixels per bin of 1
    """
    pixels = checked(image)
    axes = new_axes(axes)
    names = band_names(pixels.shape[-1])
    views.draw_histogram(axes, pixels, white_level(pixels, white), names)
    axes.set_title("")
    if 1 < pixels.shape[2] <= views.MOST_NOTES and not axes.texts:  # these also name the bands
        axes.legend(fontsize=8)
    return axes
