"""The pixels of a picture with one straight edge: their noise, and first estimates of the edge."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import ndimage

import jaxvision as jv
from jaxvision.errors import InputError

from ..rig import COLOURS

LEAST_PIXELS = 8  # on both sides of the edge
BLOCK = 8  # side of the blocks of shared errors where neighbouring residuals correlate
SIGNIFICANT = 4.0  # standard errors
_MOSAIC = 0.05  # largest difference of mosaic sites, relative to a side's level
_CLIPPED_SHARE = 0.01  # share of pixels at an end of the range that means clipping


class EdgePixels:
    """The valid pixels of a picture, their noise, and first estimates of the edge."""

    def __init__(self, picture: Float[np.ndarray, "h w"], angle: float, place: float) -> None:
        self.row, self.column = np.nonzero(np.isfinite(picture))
        self.value = picture[self.row, self.column]
        middle = (np.array(picture.shape) - 1) / 2
        self.inputs = {"x": self.column - middle[1], "y": self.row - middle[0]}
        self.angle, self.place = angle, place
        distance = distance_from_edge(self.inputs, np.radians(angle), place, 0.0)
        self.span = float(np.abs(distance).max())
        noise = np.full(picture.shape, np.nan)
        self.level, sd, self.block_variances = [], [], []
        across = picture.shape[1] // BLOCK + 1
        blocks = self.row // BLOCK * across + self.column // BLOCK
        for side in (-1, 1):
            far = side * distance
            if far.max() < LEAST_PIXELS:
                raise InputError(
                    f"from_edge: there are {max(far.max(), 0):.0f} pixels beside the edge; give a "
                    f"region with at least {LEAST_PIXELS} on both sides."
                )
            flat = far > max(LEAST_PIXELS / 2, far.max() / 2)
            plane = np.stack([np.ones(flat.sum()), *(x[flat] for x in self.inputs.values())], 1)
            missed = self.value[flat] - plane @ np.linalg.lstsq(plane, self.value[flat])[0]
            _refuse_mosaic(self.row[flat], self.column[flat], missed, self.value[flat])
            self.level.append(float(self.value[flat].mean()))
            sd.append(float(np.sqrt(np.sum(missed**2) / max(flat.sum() - 3, 1))))
            count = np.bincount(blocks[flat])
            full = count >= BLOCK**2 / 2
            square = np.bincount(blocks[flat], missed**2)
            self.block_variances.append(square[full] / count[full])
            noise[self.row[flat], self.column[flat]] = missed / max(sd[-1], 1e-30)
        low, high = self.level
        if not high - low > SIGNIFICANT * max(sd) / np.sqrt(LEAST_PIXELS):
            raise InputError(
                "from_edge: the levels on both sides are equal within the noise; give a region "
                "with one edge."
            )
        self.side_sd = sd
        self.step = np.diff(np.unique(self.value)).min()  # rounding step of whole numbers
        least = max(
            self.step / np.sqrt(12), 1e-6 * (high - low), np.finfo(np.float32).eps * abs(high)
        )
        bins = np.round(distance).astype(int)
        bins -= bins.min()
        mean = np.bincount(bins, self.value) / np.maximum(np.bincount(bins), 1)
        share = np.clip((mean[bins] - low) / (high - low), 0, 1)
        variance = sd[0] ** 2 + (sd[1] ** 2 - sd[0] ** 2) * share
        self.sd = np.sqrt(np.maximum(variance, least**2))
        self.blocks = np.unique(blocks, return_inverse=True)[1] if _are_correlated(noise) else None


def distance_from_edge(
    inputs: Mapping[str, Any], turn: Any, place: Any, curvature: Any, *, xp: Any = np
) -> Any:
    """Return the distances of pixels from the edge, positive on the bright side."""
    cosine, sine = xp.cos(turn), xp.sin(turn)
    along = cosine * inputs["y"] - sine * inputs["x"]
    return cosine * inputs["x"] + sine * inputs["y"] - place + curvature * along**2


def _refuse_mosaic(
    row: np.ndarray, column: np.ndarray, missed: np.ndarray, value: np.ndarray
) -> None:
    """Refuse an edge if the pixels of a uniform side differ by their site in a 2 x 2 mosaic."""
    site = 2 * (row % 2) + column % 2
    count = np.bincount(site, minlength=4)
    if count.min() < LEAST_PIXELS:  # one band of a mosaic
        return
    mean = np.bincount(site, missed, minlength=4) / count
    noise = np.sqrt(np.bincount(site, (missed - mean[site]) ** 2, minlength=4)) / count
    apart, size = np.ptp(mean), abs(float(value.mean()))
    if apart > _MOSAIC * size and apart > 2 * SIGNIFICANT * noise.max():
        raise InputError(
            f"from_edge: on one side of the edge the sites of a 2 x 2 mosaic differ by "
            f"{apart / size:.0%}; give one band of raw colour numbers by sensor= and band=, the "
            "taps of unequal amplifiers by sensor=, or a developed picture."
        )


def _are_correlated(noise: Float[np.ndarray, "h w"]) -> bool:
    """Return whether noise of neighbouring pixels, of unit variance, is correlated."""
    for lag in (1, 2):  # lag 2 for a band measured at every second pixel
        products = [
            (noise[lag:] * noise[:-lag]).ravel(),
            (noise[:, lag:] * noise[:, :-lag]).ravel(),
        ]
        product = np.concatenate([one[np.isfinite(one)] for one in products])
        if product.size > 100:
            mean = abs(product.mean())
            return bool(mean > SIGNIFICANT / np.sqrt(product.size) and mean > 0.03)
    return False


def select_band(image: Any, sensor: jv.Sensor | None, band: int | None) -> Float[np.ndarray, "h w"]:
    """Return the numbers of one band, as of equal taps, NaN at pixels that do not measure it."""
    picture = np.array(image, float)
    if sensor is not None and picture.ndim == 3 and picture.shape[2] == 1:
        picture = picture[..., 0]
    if picture.ndim not in (2, 3) or min(picture.shape[:2]) < LEAST_PIXELS:
        raise InputError(
            f"from_edge: image has the shape {picture.shape}; give (h, w) or (h, w, bands), of at "
            f"least {LEAST_PIXELS} x {LEAST_PIXELS} pixels."
        )
    tile = np.zeros((1, 1), int)
    taps = None if sensor is None or picture.ndim == 3 else sensor.taps
    if picture.ndim == 2 and sensor is not None and sensor.colour_filter is not None:
        tile = np.asarray(sensor.colour_filter.pattern)
    elif taps is not None and taps.names and taps.names[0].split()[0] in COLOURS:
        colours = np.array([COLOURS.index(name.split()[0]) for name in taps.names])
        tile = colours[np.asarray(taps.pattern)]
        tile = tile[: taps.cell[0], : taps.cell[1]] if taps.stretched else tile
    bands = picture.shape[2] if picture.ndim == 3 else int(tile.max()) + 1
    band = 0 if band is None and bands == 1 else band
    if band not in range(bands):
        raise InputError(f"from_edge: band is {band!r}; give 0 to {bands - 1}.")
    if picture.ndim == 3:
        picture = picture[..., band]
    else:
        row, column = np.indices(picture.shape)
        at = tile[row % tile.shape[0], column % tile.shape[1]]
        picture = np.where(at == band, picture, np.nan)
    _refuse_clipped(picture, sensor)
    if taps is None or taps.stretched:
        return picture
    level = 0.0 if sensor is None or sensor.offset is None else float(np.mean(sensor.offset))
    plain, field = jv.Sensor(offset=level, taps=taps), jnp.zeros((*picture.shape, 1))
    black, lit = (np.asarray(jv.expected_signal(plain, field + x))[..., 0] for x in (0.0, 1.0))
    responses, own = lit - black, np.isfinite(picture)
    return (picture - black) * responses[own].mean() / responses + level


def _refuse_clipped(picture: Float[np.ndarray, "h w"], sensor: jv.Sensor | None) -> None:
    """Refuse a picture many of whose numbers lie at an end of their range."""
    known = picture[np.isfinite(picture)]
    if known.size == 0:
        raise InputError("from_edge: no pixel of the image is a finite number.")
    codes, counts = np.unique(known, return_counts=True)
    top = np.inf if sensor is None or sensor.bits is None else 2.0 ** float(sensor.bits) - 1
    for end, inner, name in ((-1, -2, "highest"), (0, 1, "lowest")):
        share = counts[end] / known.size
        at_an_end = codes[end] >= top if name == "highest" else codes[end] == 0 and top < np.inf
        # Noise puts fewer pixels at an extreme value than next to it.
        noisy = codes.size > 2 and counts[inner] > _CLIPPED_SHARE * known.size
        piled = noisy and counts[end] > counts[inner]
        if share > _CLIPPED_SHARE and (at_an_end or piled):
            raise InputError(
                f"from_edge: {share:.0%} of the pixels have the {name} value, {codes[end]:g}, so "
                "that one side is clipped; expose so that both sides lie within the range."
            )


def first_line(picture: Float[np.ndarray, "h w"]) -> tuple[float, float]:
    """Estimate the edge's normal toward the bright side, degrees, and place, pixels."""
    known = np.isfinite(picture)
    weight = ndimage.gaussian_filter(known.astype(float), 1.5)
    smooth = ndimage.gaussian_filter(np.where(known, picture, 0.0), 1.5) / np.maximum(weight, 1e-9)
    slope_y, slope_x = np.gradient(smooth)
    sure = ndimage.minimum_filter(weight, 3) > 0.1
    strength = np.where(sure, np.hypot(slope_x, slope_y), 0.0)
    angle = np.arctan2(np.sum(strength**2 * slope_y), np.sum(strength**2 * slope_x))
    y, x = np.indices(picture.shape) - (np.array(picture.shape)[:, None, None] - 1) / 2
    along = np.maximum(np.cos(angle) * slope_x + np.sin(angle) * slope_y, 0) * sure
    distance = np.cos(angle) * x + np.sin(angle) * y
    peak = along >= np.quantile(along[sure], 0.9)
    return float(np.degrees(angle)), float(np.median(distance[peak & (along > 0)]))
