"""Images of an object as cells of pixels of like normals, the same cells in every image.

A cell of n pixels is its count, its mean and the scatter about it: all that the likelihood of its
pixels needs if their signals were equal. They are not quite, so a reference model, near the best
one, is taken off first: the mean of its pixels less its value at their mean geometry is added to
what a model predicts of the cell, and the scatter is that of the pixels about it. At the reference
cells and pixels agree; away from it they differ by how the model curves within a cell.

A cell counts in an image where all of its pixels are lit, and by the reference clear of both ends
of the scale: by the reference and not by the measured numbers, whose noise would choose.
"""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxvision import Vec, as_array, as_vec
from jaxvision.hemisphere import local_frame, to_local

from ..reflectance.from_images.read import VIEW, ReflectanceObservation
from ..reflectance.models import has_lobe, unit_shading
from .model import Cells, Form, Geometry, Values, signal, stored

WIDEST, NARROWEST = 0.05, 0.00625  # rad of the normal: widths of a cell
FINE = 0.5  # width of a cell over that of the lobe, as the normal turns
CLEAR = 5.0  # deviations from either end of the scale
SMALLEST_COSINE = 0.02  # of incidence: below, the outline's half-lit pixels


@dataclass(frozen=True)
class Grid:
    """Which pixels share a cell, and how light falls on it.

    Attributes:
        cell: (pixels,) its index for each.
        count: (cells,) pixels.
        lights: indices of the images in the fit.
        geometry: of the cells.
        turns: whether the directions of the lights are uncertain.
    """

    cell: Int[np.ndarray, " pixels"]
    count: Float[np.ndarray, " cells"]
    lights: Int[np.ndarray, " images"]
    geometry: Geometry
    turns: bool


def cell_width(form: Form, shape: float | None) -> float:
    """The widest cell that resolves a lobe.

    Args:
        form: of the fit.
        shape: of the lobe, natural; None for Lambert.

    Returns:
        rad.
    """
    if shape is None or not has_lobe(form.model):
        return WIDEST
    angle = np.linspace(0, 1.2, 1201)
    wi = Vec(*(jnp.asarray(x) for x in (np.sin(angle), np.zeros(1201), np.cos(angle))))
    wo = Vec(jnp.zeros(1201), jnp.zeros(1201), jnp.ones(1201))
    lobe = np.asarray(_lobe(form, jnp.asarray(shape), wi, wo))
    below = lobe < np.exp(-0.5) * lobe[0]
    width = angle[int(np.argmax(below))] / 2 if below.any() else angle[-1]
    return float(np.clip(FINE * width, NARROWEST, WIDEST))


@eqx.filter_jit
def _lobe(form: Form, shape: Array, wi: Vec, wo: Vec) -> Array:
    return unit_shading(form.model, shape, wi, wo, form.index)


def make_grid(
    observation: ReflectanceObservation, channel: int, *, width: float, turns: bool
) -> Grid:
    """Groups the pixels of an object by their normals, for the lights that are not held out.

    Args:
        observation: of the object.
        channel: index.
        width: of a cell, rad of the normal.
        turns: whether to tell how cells change as lights turn.

    Returns:
        The grid.
    """
    x, y, z = observation.normals.T
    plane = np.sqrt(2 / (1 + z))  # Lambert's: equal areas for equal solid angles
    row, column = (np.floor(c * plane / width).astype(np.int64) for c in (x, y))
    row, column = row - row.min(), column - column.min()
    _, cell = np.unique(row * (column.max() + 1) + column, return_inverse=True)
    count = np.bincount(cell).astype(float)
    lights = np.flatnonzero(~observation.held_out)
    normals = _unit(_means(observation.normals, cell, count))
    wi = np.stack([_unit(_means(observation.wi[j], cell, count)) for j in lights])
    irradiance = np.stack([_means(observation.falloff[j], cell, count) for j in lights])
    irradiance = irradiance * observation.intensity[channel, lights][:, None]
    return Grid(cell, count, lights, local_geometry(normals, wi, irradiance, turns=turns), turns)


def local_geometry(
    normals: Float[np.ndarray, "cells 3"],
    wi: Float[np.ndarray, "images cells 3"],
    irradiance: Float[np.ndarray, "images cells"],
    *,
    turns: bool,
) -> Geometry:
    """Directions in the frames of normals.

    Args:
        normals: (cells, 3) unit.
        wi: (images, cells, 3) unit, toward the light.
        irradiance: (images, cells) E on a facing surface.
        turns: whether to tell how `wi` changes as the light turns.

    Returns:
        The geometry.
    """
    return _local_geometry(jnp.asarray(normals), jnp.asarray(wi), jnp.asarray(irradiance), turns)


@eqx.filter_jit
def _local_geometry(normals: Array, wi: Array, irradiance: Array, turns: bool) -> Geometry:
    frame = local_frame(as_vec(normals))

    def seen(directions: Array) -> Vec:
        return jax.vmap(lambda w: as_vec(to_local(frame, as_vec(w))))(directions)

    turned = None
    if turns:
        middle = jnp.mean(wi, axis=1)
        across = local_frame(as_vec(middle / jnp.linalg.norm(middle, axis=1, keepdims=True)))

        def along(t: Array) -> Vec:
            return seen(t[:, None] - jnp.sum(t[:, None] * wi, axis=2, keepdims=True) * wi)

        turned = along(as_array(across.tangent)), along(as_array(across.bitangent))
    view = jnp.broadcast_to(jnp.array(VIEW, normals.dtype), normals.shape)
    wo = as_vec(to_local(frame, as_vec(view)))
    return Geometry(wi=seen(wi), wo=wo, irradiance=irradiance, turned=turned)


def reduce_images(
    observation: ReflectanceObservation,
    channel: int,
    grid: Grid,
    reference: Values,
    form: Form,
    *,
    products: bool,
) -> Cells:
    """The cells of one channel about a reference model.

    Args:
        observation: of the object.
        channel: index.
        grid: of the cells.
        reference: natural values by name, gain and read noise among them.
        form: of the fit.
        products: whether to keep how the images of a cell scatter together.

    Returns:
        The cells.
    """
    shape = (len(grid.lights), len(grid.count))
    count, mean, scatter, offset = np.zeros((4, *shape))
    left = np.zeros((len(grid.lights), len(grid.cell)))
    at_cells = np.asarray(_mean_dn(reference, form, grid.geometry, jnp.asarray(observation.white)))
    for i, light in enumerate(grid.lights):
        expected, usable = pixels_at(observation, channel, int(light), reference, form)
        usable = usable & (observation.cosine[light] > SMALLEST_COSINE)
        whole = np.bincount(grid.cell, usable) == grid.count
        count[i] = np.where(whole, grid.count, 0)
        deviation = np.where(whole[grid.cell], observation.dn[channel, light] - expected, 0)
        of_cell = _means(deviation, grid.cell, grid.count)
        left[i] = np.where(whole[grid.cell], deviation - of_cell[grid.cell], 0)
        of_model = _means(np.where(whole[grid.cell], expected, 0), grid.cell, grid.count)
        mean[i] = of_cell + of_model
        offset[i] = np.where(whole, of_model - at_cells[i], 0)
        scatter[i] = np.bincount(grid.cell, left[i] ** 2)
    arrays = (jnp.asarray(a) for a in (count, mean, scatter, offset))
    cells = Cells(grid.geometry, *arrays)
    return replace(cells, products=_products(left, grid)) if products else cells


def pixels_at(
    observation: ReflectanceObservation, channel: int, light: int, values: Values, form: Form
) -> tuple[Float[np.ndarray, " pixels"], Bool[np.ndarray, " pixels"]]:
    """What a model says of the pixels of one image.

    Args:
        observation: of the object.
        channel: index.
        light: index.
        values: natural, by name.
        form: of the fit.

    Returns:
        (pixels,) expected DN, and which lie clear of both ends of the scale.
    """
    irradiance = observation.intensity[channel, light] * observation.falloff[light]
    wi = observation.wi[light]
    geometry = local_geometry(observation.normals, wi[None], irradiance[None], turns=False)
    expected, x, variance, noise = (
        np.asarray(a)[0]
        for a in _pixel_moments(values, form, geometry, jnp.asarray(observation.white))
    )
    foot = x if "gamma" in values else x + float(values["black_level"])
    below = expected + CLEAR * np.sqrt(variance) < observation.clip
    return expected, (foot > CLEAR * noise) & below


@eqx.filter_jit
def _pixel_moments(
    values: Values, form: Form, geometry: Geometry, white: Array
) -> tuple[Array, ...]:
    """E[DN], X, Var[DN], and the deviation of the linear signal."""
    x = signal(values, form, geometry.wi, geometry.wo, geometry.irradiance)
    gain = values["system_gain"]
    noise = jnp.sqrt(gain * x + (gain * values["read_noise"]) ** 2)
    mean, variance, _ = stored(values, jnp.maximum(x, noise) if "gamma" in values else x, white)
    return mean, x, variance, noise


@eqx.filter_jit
def _mean_dn(values: Values, form: Form, geometry: Geometry, white: Array) -> Array:
    x = signal(values, form, geometry.wi, geometry.wo, geometry.irradiance)
    return stored(values, jnp.where(x > 0, x, white), white)[0]


def _products(left: np.ndarray, grid: Grid) -> Array:
    """(cells, images, images) sums of left_i left_j over the pixels of each cell."""
    images = len(left)
    sums = np.zeros((len(grid.count), images, images))
    for i in range(images):
        for j in range(i + 1):
            sums[:, i, j] = sums[:, j, i] = np.bincount(grid.cell, left[i] * left[j])
    return jnp.asarray(sums)


def _means(values: np.ndarray, cell: np.ndarray, count: np.ndarray) -> np.ndarray:
    if values.ndim == 1:
        return np.bincount(cell, values) / count
    return np.stack([np.bincount(cell, column) / count for column in values.T], axis=1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
