"""Interreflection in a hollow: a finding of its size, and its removal."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...inference.formatting import format_percent
from .findings import SMALL
from .interreflection import exchange_of, side_of_facets
from .lights import Images, Rows, predicted, solved
from .result import Stereo

SAME = 1e-3  # rad between lights of the same direction
NOTICED = 0.5  # standard deviations by which interreflection rotates normals
STILL = 0.1  # standard deviations of the last change of normals without interreflection
MOST_ESTIMATES, MOST_ROUNDS = 4, 20  # with interreflection removed; rounds of each


@dataclass(frozen=True)
class Hollow:
    """Images of a surface whose parts light each other; normals in `axes` have x right, y up and z
    to the camera."""

    stack: Images
    rows: Rows
    between: Bool[np.ndarray, "lights h w"]
    axes: Float[np.ndarray, "3"]

    def added(self, g: np.ndarray, white: float, scale: int = 1) -> np.ndarray | None:
        """Return the readings that interreflection adds on a surface of this g; None without a
        hollow."""
        albedo = np.linalg.norm(g, axis=-1)
        exchange = exchange_of(g / albedo[..., None] * self.axes, scale=scale)
        if exchange is None:
            return None
        share = np.clip(np.nan_to_num(albedo / white), 0, 1)
        return share * exchange.irradiance(np.nan_to_num(self.stack))

    def change(self, g: np.ndarray, added: Images) -> np.ndarray:
        """Return the least-squares change of g from lit readings if `added` is part of the
        readings."""
        flat = g.reshape(-1, 3)
        lit = self.between.reshape(len(self.stack), -1)
        lit = lit & (np.nan_to_num(predicted(self.rows, flat)) > 0)
        readings = added.reshape(len(added), -1)
        return solved(self.rows, readings, lit.astype(float))[0].reshape(g.shape)

    def share(self, added: Images) -> str:
        lit = self.between & (self.stack > added)
        return format_percent(np.median(added[lit] / self.stack[lit]) if lit.any() else 0.0)


def interreflection_finding(found: Stereo, scene: Hollow) -> tuple[str, ...]:
    """Return a sentence on the light that parts of a hollow send each other, if it matters."""
    g = found.normals * found.albedo[..., None]
    known = found.albedo[np.isfinite(found.albedo)]
    added = scene.added(g, float(np.percentile(known, 99))) if known.size else None
    if added is None:
        return ()
    turned = _rotation(g, g - scene.change(g, added))
    errors = _middle(turned / np.nan_to_num(found.normal_sd, nan=SAME))
    if not errors > NOTICED:
        return ()
    known_sd = np.isfinite(found.normal_sd).any()
    size = f"{errors:.1f} standard deviations, " if known_sd else ""
    return (
        "The normals form a hollow, whose parts light each other. If its brightest pixels reflect "
        f"all light, this adds {scene.share(added)} to the readings (median) and rotates normals "
        f"by {np.degrees(_middle(turned)):.2g} degrees, {size}which the standard deviations do not "
        "include; if they reflect half of it, about half as much. Give white, the albedo of a "
        "surface that reflects all light, to remove this light.",
    )


def without_interreflection(
    first: Stereo,
    estimate: Callable[[Images], Stereo],
    scene: Hollow,
    white: float,
    white_sd: float,
) -> tuple[Stereo, tuple[str, ...]]:
    """Remove the light that parts of the surface send each other. The shape gives the
    interreflected light, which is subtracted before the next estimate of the shape. In an inner
    loop the shape changes by least squares; an outer loop repeats the whole estimate. The standard
    deviations include the error of `white`, the last change, and the difference from facets of
    twice the size."""
    found, change = first, np.inf
    last = g = found.normals * found.albedo[..., None]
    added = before = np.zeros(scene.stack.shape)
    for estimates in range(1, MOST_ESTIMATES + 1):
        start, noise = g, np.nan_to_num(found.normal_sd, nan=SAME)
        for _ in range(MOST_ROUNDS):
            received = scene.added(g, white)
            if received is None:
                return found, ()
            added = received
            last, g = g, start - scene.change(start, added - before)
            if not _middle(_rotation(last, g) / noise) >= STILL / 10:
                break
        found = estimate(np.where(scene.between, scene.stack - added, scene.stack))
        last, g, before = g, found.normals * found.albedo[..., None], added
        change = _middle(_rotation(last, g) / np.nan_to_num(found.normal_sd, nan=SAME))
        if estimates > 1 and not change > STILL:
            break
    coarse = scene.added(g, white, scale=2)
    by_grid = scene.change(g, added - (0 if coarse is None else coarse))
    errors = np.stack([g - last, by_grid, scene.change(g, added) * (white_sd / white)])
    along = (errors * found.normals).sum(axis=-1)
    aside = np.square(errors).sum(axis=-1) - along**2
    width = 2 * side_of_facets(found.albedo.shape) + 1  # grids differ somewhere near a fold
    aside[1] = ndimage.maximum_filter(np.nan_to_num(aside[1]), width)
    turned = _rotation(first.normals, found.normals)
    said = (
        f"The surface is a hollow, whose parts add {scene.share(added)} to the readings (median). "
        "Without this light, normals are rotated by "
        f"{np.degrees(_middle(turned)):.2g} degrees (median).",
    )
    if change > STILL:
        said += (
            f"The last round changed normals by {change:.1f} standard deviations, so the rounds "
            "did not converge; the standard deviations include this change.",
        )
    if (above := float(np.mean(found.albedo > white))) > SMALL:
        said += (
            f"white = {white:.4g} is below the albedo of {format_percent(above)} of the pixels, "
            "which would reflect more light than they receive; check white, and the intensities of "
            "the lights.",
        )
    normal_sd = np.sqrt(found.normal_sd**2 + aside.sum(axis=0) / 2 / found.albedo**2)
    albedo_sd = np.sqrt(found.albedo_sd**2 + (along**2).sum(axis=0))
    return replace(found, normal_sd=normal_sd, albedo_sd=albedo_sd), said


def _middle(values: np.ndarray) -> float:
    """Return the median of the finite values; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def _rotation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles between vectors, rad."""
    size = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    sine = np.linalg.norm(np.cross(first, second), axis=-1) / size
    return np.arctan2(sine, (first * second).sum(axis=-1) / size)
