"""Average frames of all pixels, dead ones included, at the levels of a photon transfer, and their
spatial variances.

The standard defines the following statistics. With y the frames of a level and d_f the mean of
frame f,

    mu_y    = mean of y                                                     (16)
    sigma^2 = mean over the pixels of the variance over the frames - variance of d_f    (18)
    sigma^2_stack = mean over the pixels of the variance over the frames    (65)

For two frames, (18) is the standard's formula. For more frames, (18) is the average of the
standard's formula over all pairs of frames.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxvision.errors import InputError
from jaxvision.files.images import read_image

from ...inference.precision import double_precision
from ...observation import Load
from ...rig import Rig, load_rig
from ..levels import PhotonTransfer
from ..pattern import standard_pattern
from ..read import read_photon_transfer, reduced_rig
from ..usable import check
from .nonuniformity import Split, can_filter, high_pass, split
from .saturation import Numbers, ranges


@dataclass(frozen=True)
class Stack:
    """The average of a level's frames, with their temporal variance and drift."""

    image: Float[np.ndarray, "h w"]  # average, DN
    noise: float  # sigma^2, the temporal variance, DN^2
    drift: float  # variance of the frames' means, DN^2
    frames: int  # L, the number of frames
    at_top: float  # share of the values at the end of the scale; 0 where that end is unknown

    @property
    def rest(self) -> float:
        """Temporal variance that remains in the average, sigma^2_stack / L, DN^2."""
        return (self.noise + self.drift) / self.frames


@dataclass(frozen=True)
class Averages:
    """The average frames of a bright level and of its dark."""

    level: int  # index of the bright level, about half of saturation
    lit: Stack  # frames of this level
    unlit: Stack  # frames of the dark of this level


@dataclass(frozen=True)
class Stacks:
    """A photon transfer measurement with its average images, or a table of sums without images.

    Attributes:
        measurement: means and temporal variances of all pixels, as the standard defines them.
        numbers: share of clipped values and standard deviation at each bright level; None without
            images.
        bright: spatial variances of each bright level, high-passed where the frame is large enough
            for the filter.
        dark: spatial variances of each dark, high-passed like `bright`.
        averages: average frames from which the nonuniformities are computed; None without images.
    """

    measurement: PhotonTransfer
    numbers: Numbers | None = None
    bright: tuple[Split, ...] = ()
    dark: tuple[Split, ...] = ()
    averages: Averages | None = None


@double_precision
def read_stacks(
    path: str | os.PathLike[str], *, bits: int | None = None, channel: str = ""
) -> Stacks:
    """Compute average frames and spatial variances of a rig's `[[flat]]` and `[[dark]]` frames, as
    the input of `release_4_sheet`.

    Args:
        path: a rig folder or file, or a table of sums (without images) with the suffix `.csv`.
        bits: ADC bits of a table's camera; None for those of the rig.
        channel: site of a rig's Bayer mosaic, or amplifier tap; empty for the first green site, or
            the first tap.

    Returns:
        Statistics in DN over all pixels, dead ones included, because the standard's histograms show
        them.

    Raises:
        InputError: for files that cannot be used.
    """
    file = Path(path)
    if file.suffix.lower() == ".csv":
        return Stacks(read_photon_transfer(file, bits=bits, channel=channel))
    if bits is not None:
        raise InputError(f"{file}: camera.bits of the rig counts; leave out the bits, {bits}.")
    return reduce_stacks(load_rig(file), channel=channel)


def reduce_stacks(rig: Rig, *, channel: str = "", load: Load = read_image) -> Stacks:
    """Compute the average frames and statistics of a rig, with one frame in memory at a time."""
    reduced = reduced_rig(rig, channel=channel, load=load)
    check(rig.folder, reduced.measurement)
    top = reduced.measurement.full_scale

    def stack(names: Sequence[str]) -> Stack:
        return _average(reduced.plane, names, top)

    levels, of_levels = [], []
    for one, files in (
        (reduced.measurement.bright, reduced.flats),
        (reduced.measurement.dark, reduced.darks),
    ):
        means, noises, at_top, spreads, splits, size = [], [], [], [], [], 0
        for average in map(stack, files):
            image = average.image
            filtered = high_pass(image) if can_filter(image.shape) else image
            size = image.size
            means.append(image.mean())
            noises.append(average.noise)
            at_top.append(average.at_top)
            about = average.noise + average.drift - average.rest  # of all numbers about the average
            spreads.append(np.sqrt(image.var() + about))
            splits.append(split(filtered, average.rest))
        mean, variance, pixels = map(jnp.asarray, (means, noises, float(size)))
        levels.append(replace(one, mean=mean, variance=variance, pixels=pixels))
        of_levels.append((Numbers(np.array(at_top), np.array(spreads)), tuple(splits)))
    measurement = replace(reduced.measurement, bright=levels[0], dark=levels[1])
    (numbers, of_flats), (_, of_darks) = of_levels
    half = standard_pattern(measurement, ranges(measurement, numbers)[0]).level
    assert half is not None
    own_dark = int(measurement.dark_of[half])
    averages = Averages(half, stack(reduced.flats[half]), stack(reduced.darks[own_dark]))
    return Stacks(measurement, numbers, of_flats, of_darks, averages)


def _average(plane: Callable[[str], np.ndarray], names: Sequence[str], top: float | None) -> Stack:
    """Average frames; the sums are of deviations from the first one, which are small."""
    first = np.asarray(plane(names[0]), float)
    total, squares = np.zeros_like(first), 0.0
    means, at_top = [], 0.0
    for name in names:
        frame = np.asarray(plane(name), float)
        deviation = frame - first
        total += deviation
        squares += float(np.mean(deviation**2))
        means.append(float(deviation.mean()))
        at_top += 0.0 if top is None else float(np.mean(frame >= top))
    count = len(names)
    variance = (squares - float(np.mean(total**2)) / count) / (count - 1)
    drift = float(np.var(means, ddof=1))
    return Stack(first + total / count, variance - drift, drift, count, at_top / count)
