"""Reduction of images of an object to cells of pixels with similar normals.

A cell is described by the number of its pixels, their mean and their scatter. These three numbers
determine the likelihood if the pixels of a cell have equal signals. Signals within a cell differ a
little, so a reference model near the best model is subtracted first, averaged over the area of each
pixel. The prediction of a cell is corrected: the mean of the reference model over the pixels is
added, and its value at the mean geometry of the pixels is subtracted. The scatter is computed about
the reference model. At the parameters of the reference, cells and pixels have the same likelihood.
At other parameters, the two likelihoods differ by the curvature of the model within a cell. Cells
are therefore wide where an image is smooth, and are divided at its highlight and near black or
saturation.

A cell is used in an image if all of its pixels are lit and away from both ends of the scale. The
selection is by the numbers that the reference model predicts, because a selection by measured
numbers would depend on their noise. Pixels whose measured numbers are far from both ends are used
as well, because a wrong reference model would otherwise exclude such pixels.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxvision import Vec

from ..inference.parameters import names
from ..reflectance.from_images.read import WEIGHTS, Photographs
from ..reflectance.from_images.signal import (
    Form,
    Geometry,
    Values,
    local_geometry,
    signal,
    stored,
    surface_parameters,
    unit_lobe,
)
from ..reflectance.models import has_lobe, shape_of
from .model import Cells

WIDEST, NARROWEST = 0.05, 0.00625  # rad of the normal: widths of a cell
FINE = 0.5  # width of the finest cells over that of the lobe, as a function of the normal
FLAT = 0.05  # largest variation of the lobe within an undivided cell, relative to its peak
SIZES = 8  # sizes of the cell table per factor of two: few, so that channels share programs
CLEAR = 5.0  # standard deviations from either end of the scale
DARKEST = 1e-6  # smallest `level`, relative to full scale
SMALLEST_COSINE = 0.02  # cosine of incidence below which pixels of the outline are only partly lit


@dataclass(frozen=True)
class Grid:
    """The assignment of a channel's pixels to cells, and the geometry of light at each cell."""

    observation: Photographs
    channel: int
    form: Form
    cell: Int[np.ndarray, "images pixels"]  # cell index for each
    count: Float[np.ndarray, "images cells"]  # pixels; 0 for padding
    lights: Int[np.ndarray, " images"]  # indices of the images in the fit
    geometry: Geometry
    patch: float  # pixels of the widest cells
    turns: bool  # whether the directions of the lights are uncertain


def cell_width(form: Form, shape: float | None) -> float:
    """Return the width of the finest cells, rad, which resolve the lobe of this `shape`."""
    if shape is None or not has_lobe(form.model):
        return WIDEST
    angle = np.linspace(0, 1.2, 1201)
    wi = Vec(*(jnp.asarray(x) for x in (np.sin(angle), np.zeros(1201), np.cos(angle))))
    wo = Vec(jnp.zeros(1201), jnp.zeros(1201), jnp.ones(1201))
    lobe = np.asarray(unit_lobe(form, jnp.asarray(shape), Geometry(wi, wo, jnp.ones(1201))))
    below = lobe < np.exp(-0.5) * lobe[0]
    width = angle[int(np.argmax(below))] / 2 if below.any() else angle[-1]
    return float(np.clip(FINE * width, NARROWEST, WIDEST))


def make_grid(
    observation: Photographs,
    channel: int,
    reference: Values,
    form: Form,
    *,
    width: float,
    turns: bool,
    shared: bool,
) -> Grid:
    """Group the pixels of an object by their normals, for the lights that are not held out.

    The cells are as fine as `width`, rad, where the model with the `reference` values varies.
    `turns` adds the derivatives of the cells' geometry with respect to light directions. With
    `shared`, all images have the same cells, which is needed if a pixel's error is the same in all
    images.
    """
    lights = np.flatnonzero(~observation.held_out)
    levels, ones = _levels(observation.normals, width), np.ones(len(observation.normals))
    split = np.zeros((len(lights), len(levels) - 1, len(observation.normals)), bool)
    for i, light in enumerate(lights if len(levels) > 1 else ()):
        _, usable = pixels_at(observation, channel, int(light), reference, form)
        at = local_geometry(observation.normals, observation.wi[light], ones)
        shading = np.asarray(unit_lobe(form, reference[shape_of(form.model).name], at))
        split[i] = [_uneven_pixels(level, usable, shading) for level in levels[:-1]]
    if shared:
        split[:] = split.any(axis=0)
    cell = np.stack([_divide(levels, of_image) for of_image in split])
    most = int(cell.max()) + 1
    step = 2 ** max(0, most.bit_length() - SIZES.bit_length())
    most = -(-most // step) * step
    count = np.stack([np.bincount(of_image, minlength=most) for of_image in cell]).astype(float)
    normals, wi, irradiance = [], [], []
    for of_image, pixels, light in zip(cell, count, lights, strict=True):
        normals.append(_unit(_means(observation.normals, of_image, pixels)))
        wi.append(_unit(_means(observation.wi[light], of_image, pixels)))
        falloff = _means(observation.falloff[light], of_image, pixels)
        irradiance.append(observation.intensity[channel, light] * falloff)
    geometry = local_geometry(*(np.stack(a) for a in (normals, wi, irradiance)), turns=turns)
    patch = float(np.median(np.bincount(levels[0])))
    return Grid(observation, channel, form, cell, count, lights, geometry, patch, turns)


def _levels(normals: np.ndarray, width: float) -> list[np.ndarray]:
    """Return each pixel's cell for each width from the widest to `width`; one holds four."""
    x, y, z = normals.T
    plane = np.sqrt(2 / (1 + z))  # Lambert's: equal areas for equal solid angles
    row, column = (np.floor(c * plane / width).astype(np.int64) for c in (x, y))
    found = []
    for level in range(1 + max(0, int(np.log2(1.001 * WIDEST / width)))):
        r, c = row >> level, column >> level
        index = (r - r.min()) * (np.ptp(c) + 1) + c - c.min()
        found.insert(0, np.unique(index, return_inverse=True)[1])
    return found


def _uneven_pixels(cell: np.ndarray, usable: np.ndarray, shading: np.ndarray) -> np.ndarray:
    """Return a mask of the pixels whose cell is only partly used or is crossed by a highlight."""
    count = np.bincount(cell)
    part = np.bincount(cell, usable)
    low, high = np.full(len(count), np.inf), np.full(len(count), -np.inf)
    np.minimum.at(low, cell, shading)
    np.maximum.at(high, cell, shading)
    return ((part > 0) & ((part < count) | (high - low > FLAT * shading.max())))[cell]


def _divide(levels: list[np.ndarray], split: np.ndarray) -> np.ndarray:
    """Return for each pixel of an image the widest cell that needs no division."""
    level = np.cumprod(split, axis=0).sum(axis=0)
    own = np.choose(level, levels)
    _, cell = np.unique(own * len(levels) + level, return_inverse=True)
    return cell.astype(np.int32)


def reduce_images(
    grid: Grid, reference: Values, *, within: Float[np.ndarray, "images cells"] | None = None
) -> Cells:
    """Reduce images to the cells of a grid, about a reference model. The natural values `reference`
    of that model must include gain and read noise. If the values include unequal pixel gains, the
    cells also contain products of the deviations in two images. `within`, (images, cells), is the
    number of pixels of each cell that may be used, and 0 for each cell that may not; None allows
    all cells."""
    observation, channel, form = grid.observation, grid.channel, grid.form
    count, mean, scatter, offset = (np.zeros(grid.count.shape) for _ in range(4))
    surface = tuple(names(surface_parameters(form)))
    left = np.zeros(grid.cell.shape)
    white = jnp.asarray(observation.white)
    middle = jax.tree.map(lambda of_cells: of_cells[None], grid.geometry)
    at_cells = np.asarray(_pixel_moments(reference, form, middle, white, np.ones(1))[4])
    at_middle = _slopes(surface, reference, form, middle, white, np.ones(1))
    slopes = {name: np.zeros(grid.count.shape) for name in surface}
    for i, (light, cell, pixels) in enumerate(zip(grid.lights, grid.cell, grid.count, strict=True)):
        expected, usable = pixels_at(observation, channel, int(light), reference, form)
        allowed = pixels if within is None else within[i]
        whole = (np.bincount(cell, usable, len(pixels)) == pixels) & (allowed > 0)
        count[i] = np.where(whole, pixels, 0)
        deviation = np.where(whole[cell], observation.dn[channel, light] - expected, 0)
        of_cell = _means(deviation, cell, pixels)
        left[i] = np.where(whole[cell], deviation - of_cell[cell], 0)
        of_model = _means(np.where(whole[cell], expected, 0), cell, pixels)
        mean[i] = of_cell + of_model
        offset[i] = np.where(whole, of_model - at_cells[i], 0)
        seen, weights = _points(observation, channel, int(light))
        for name, own in _slopes(surface, reference, form, seen, white, weights).items():
            more = _means(np.asarray(own)[0], cell, pixels) - np.asarray(at_middle[name])[i]
            slopes[name][i] = np.where(whole, more, 0)
        scatter[i] = np.bincount(cell, left[i] ** 2, len(pixels))
    above = (at_cells + offset - float(reference["black_level"])) / observation.white
    level = np.maximum(above, DARKEST) * grid.patch / np.maximum(grid.count, 1)
    products = None
    if "prnu" in reference:  # sums over the pixels of each cell
        products = np.zeros((grid.count.shape[1], len(left), len(left)))
        for i in range(len(left)):
            for j in range(i + 1):
                of_cells = np.bincount(grid.cell[0], left[i] * left[j], grid.count.shape[1])
                products[:, i, j] = products[:, j, i] = of_cells
        products = jnp.asarray(products)
    offset = offset - sum(float(reference[name]) * own for name, own in slopes.items())
    arrays = (jnp.asarray(a) for a in (count, mean, scatter, offset, level))
    slopes = jax.tree.map(jnp.asarray, slopes)
    return Cells(grid.geometry, *arrays, products=products, slopes=slopes)


def image_geometry(
    observation: Photographs, channel: int, light: int, *, turns: bool = False
) -> Geometry:
    """Return the illumination geometry of the pixels under one light, (1, pixels)."""
    irradiance = observation.intensity[channel, light] * observation.falloff[light]
    seen = observation.normals[None], observation.wi[light][None], irradiance[None]
    return local_geometry(*seen, turns=turns)


def pixels_at(
    observation: Photographs, channel: int, light: int, values: Values, form: Form
) -> tuple[Float[np.ndarray, " pixels"], Bool[np.ndarray, " pixels"]]:
    """Return the expected DN of the pixels in one image, and a mask of usable pixels, (pixels,)
    each. Usable pixels are away from both ends of the scale and from the partly lit outline. A
    pixel is away from both ends if its expected number has the required distance from them, or if
    its measured number has twice that distance.
    """
    white, (geometry, weights) = observation.white, _points(observation, channel, light)
    found = _pixel_moments(values, form, geometry, jnp.asarray(white), weights)
    expected, x, variance, noise, _ = (np.asarray(a)[0] for a in found)
    foot = x if "gamma" in values else x + float(values["black_level"])
    below = expected + CLEAR * np.sqrt(variance) < observation.clip
    clear = (foot > CLEAR * noise) & below
    gain, read_noise = float(values["system_gain"]), float(values["read_noise"])
    gamma, dn = float(values.get("gamma", 1.0)), observation.dn[channel, light]
    seen = white * (np.maximum(dn - float(values["black_level"]), 0) / white) ** gamma
    noise, at_white = (np.sqrt(gain * level + (gain * read_noise) ** 2) for level in (seen, white))
    below = dn + 2 * CLEAR * at_white / gamma < observation.clip
    clear |= (seen > 2 * CLEAR * noise) & below
    return expected, clear & (observation.cosine[light] > SMALLEST_COSINE)


def _points(observation: Photographs, channel: int, light: int) -> tuple[Geometry, np.ndarray]:
    """Return the geometry at points within each pixel of an image, and their weights."""
    parts = [image_geometry(one, channel, light) for one in observation.points]
    weights = np.ones(1) if observation.within is None else WEIGHTS
    return jax.tree.map(lambda *own: jnp.stack(own), *parts), weights


@eqx.filter_jit
def _slopes(surface: tuple[str, ...], values: Values, *of: Any) -> Values:
    """Return the derivatives of a pixel's expected number by the natural surface values."""

    def mean_of(own: Values) -> Array:
        return _pixel_moments(values | own, *of)[4]

    return jax.jacfwd(mean_of)({name: values[name] for name in surface})


@eqx.filter_jit
def _pixel_moments(
    values: Values, form: Form, geometry: Geometry, white: Array, weights: np.ndarray
) -> tuple[Array, ...]:
    """Return five arrays for X, the signal averaged over the points of a pixel, which are the first
    axis of the geometry. The arrays are: the expected digital number for X or for its noise,
    whichever is larger; X; the variance of the digital number; the standard deviation of X; and the
    expected digital number for X."""
    x = jnp.tensordot(weights, signal(values, form, geometry), 1)
    gain = values["system_gain"]
    noise = jnp.sqrt(gain * x + (gain * values["read_noise"]) ** 2)
    mean, variance, _ = stored(values, jnp.maximum(x, noise) if "gamma" in values else x, white)
    return mean, x, variance, noise, stored(values, jnp.where(x > 0, x, white), white)[0]


def _means(values: np.ndarray, cell: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the mean of values for each cell in one image; that of the first if empty."""
    columns = values.reshape(len(values), -1).T
    sums = np.stack([np.bincount(cell, column, len(count)) for column in columns], axis=1)
    means = sums / np.maximum(count, 1)[:, None]
    means[count == 0] = means[0]
    return means.reshape(len(count), *values.shape[1:])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
