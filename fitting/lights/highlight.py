"""Find the highlight of a light on a mirror ball, and the direction from which the ball reflects
it.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import label

from jaxvision.errors import InputError

from ..inference.formatting import format_percent
from .outline import ROUNDING, Lens, Outline, surface

SEEN = 10.0  # standard deviations of the ball's pixels above their median
BRIGHT = 0.2  # least peak of a highlight, as a share of full scale above black
LEVELS = (0.5, 0.25)  # of the highlight's height; its middle is taken above the last
STEPS = 3  # from the centroid to the pixel that shows the mean direction
SECOND = 0.3  # flux of a second highlight, relative to the first, that is refused
WIDEST = 0.1  # largest share of the ball's pixels that may be bright or saturated
FINEST = 0.05  # smallest assumed error of a centroid, pixels
UNEVEN = 0.01  # assumed relative variation of the mirror's reflectance


@dataclass(frozen=True)
class Highlight:
    """The position and flux of a highlight."""

    place: Float[np.ndarray, "2"]  # column and row of the highlight, pixels
    sd: float  # standard deviation of each, pixels
    flux: float  # sum over all pixels of the highlight, DN; NaN where some are clipped
    flux_sd: float  # relative standard deviation of the flux
    level: float  # median of the ball's pixels, DN above black
    peak: float  # largest signal, DN above black


def highlight_of(
    signal: Float[np.ndarray, "h w"],
    ball: Bool[np.ndarray, "h w"],
    clip: float,
    outline: Outline,
    *,
    name: str,
) -> Highlight:
    """Find the only highlight in a picture of a ball, in DN above black.

    Its middle is the mean of the directions that the ball reflects to the camera, each weighted by
    the signal above a level. A mean of pixel positions would be too near the rim, because there the
    reflected direction changes faster with the pixel.
    """
    seen = signal[ball]
    level, peak = float(np.median(seen)), float(seen.max())
    if (share := float(np.mean(seen >= clip))) > WIDEST:
        raise InputError(f"{name}: {format_percent(share)} of the ball are saturated; expose less.")
    noise = max(1.4826 * float(np.median(np.abs(seen - level))), 0.5)
    if peak - level < max(SEEN * noise, BRIGHT * (clip - level)):
        raise InputError(
            f"{name}: no highlight on the ball; its brightest pixel is {peak - level:.3g} DN above "
            f"the median of {level:.3g} DN; expose longer, or leave the image out. A matte ball "
            'has none: give kind = "matte" (--kind matte).'
        )
    places = []
    rows = columns = np.zeros(0, int)
    weight = np.zeros(0)
    for part in LEVELS:
        above = ball & (signal > level + part * (peak - level))
        if (share := above.sum() / ball.sum()) > WIDEST:
            raise InputError(
                f"{name}: {format_percent(share)} of the ball are bright, as on a matte or a "
                "saturated ball; expose less, or choose the kind matte."
            )
        pieces, count = cast("tuple[np.ndarray, int]", label(above, np.ones((3, 3))))
        fluxes = np.bincount(pieces[above], (signal - level)[above], count + 1)
        first = int(np.argmax(fluxes))
        others = np.delete(fluxes, first)
        if others.max(initial=0) > SECOND * fluxes[first]:
            raise InputError(
                f"{name}: the ball has two highlights; the second has "
                f"{format_percent(others.max() / fluxes[first])} of the light of the first; switch "
                "other lamps off and cover windows, or mask the second (in the mask of the ball, "
                "or in all images, if it is a hot pixel)."
            )
        rows, columns = np.nonzero(pieces == first)
        weight = signal[rows, columns] - level
        above_part = np.minimum(weight, clip - level) - part * (peak - level)
        places.append(_middle(np.stack([columns, rows], axis=1), above_part, outline))
    clipped = bool((signal[rows, columns] >= clip).any())
    spread = np.sqrt(np.average((columns - places[-1][0]) ** 2, weights=weight))
    sd = np.sqrt(
        (noise * spread) ** 2 * len(weight) / weight.sum() ** 2
        + np.sum((places[0] - places[1]) ** 2) / 2
        + (ROUNDING**2 / len(weight) if clipped else FINEST**2)
    )
    row, column = np.indices(signal.shape)
    around = np.hypot(column - places[-1][0], row - places[-1][1]) < 3 * spread + 2
    flux = float((signal - level)[around & ball].sum())
    relative = float(np.hypot(noise * np.sqrt(around.sum()) / flux, UNEVEN))
    return Highlight(places[-1], float(sd), np.nan if clipped else flux, relative, level, peak)


def _middle(
    pixels: Int[np.ndarray, "some 2"], weight: Float[np.ndarray, " some"], outline: Outline
) -> Float[np.ndarray, "2"]:
    """Return the position that shows the weighted mean of the directions of some pixels."""
    mean = np.average(reflected(outline.values, pixels, outline.lens)[0], axis=0, weights=weight)
    place = np.average(pixels, axis=0, weights=weight)
    for _ in range(STEPS):
        normal, view = surface(outline.values, place, outline.lens)
        wanted = mean / np.linalg.norm(mean) + view
        change = wanted / np.linalg.norm(wanted) - normal
        place = place + outline.values[2] * np.array([change[0], -change[1]])
    return place


def reflected(
    values: Float[np.ndarray, "*of 3"], pixels: Float[np.ndarray, "*of 2"], lens: Lens
) -> tuple[Float[np.ndarray, "*of 3"], Float[np.ndarray, "*of 3"]]:
    """Return the unit directions whose light a mirror ball reflects to the camera at some pixels,
    and the ball's normals there.
    """
    normal, view = surface(values, pixels, lens)
    return 2 * np.sum(normal * view, axis=-1, keepdims=True) * normal - view, normal
