"""The images that a reflectance, a response and a sensor predict together, and their likelihood.

Signal, encoding and noise of a pixel, or of a cell of pixels of like normals, are those of
`from_images.signal`. Cells have a count, a mean and a scatter about it, and their likelihood is
that of their pixels, so that the gain K speaks through the scatter.

What the rig calls uncertain enters as a shared error of a whole image or of a pixel in all images,
linear in its size and integrated out (`marginal`); only its scale is a parameter:

    light_scatter      X (1 + s u)                      strength of the light, exposure
    direction_scatter  X + (s u_1 - t_1) dX/dt_1 + (s u_2 - t_2) dX/dt_2
                                                        direction of the light, about angles t
                                                        across it, at which X is taken (`turns`)
    stray_scatter      X + s E u                        light that comes another way
    prnu               X (1 + s g)                      gain of a pixel
    misfit             rho sqrt(W_0 D P / n) DN, of each cell in each image, of its own

The last stands for a surface that is not the model's. It grows as the noise of photons does, so
that neither shadows nor highlights carry all of the weight; n is the number of pixels of the cell
and P that of the widest cells, so that a patch says as much whole as divided; W_0 is a tenth of
full scale, and D the digital number above black that the reference model of the cells expects: a
model's own would let it predict what it likes where it calls itself uncertain.

A number that is known exactly is no parameter, and an error that the rig does not name is not
traced.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxvision import Vec

from ..inference.parameters import ParameterSpace, log_prior, names, to_natural
from ..reflectance.from_images.signal import Form, Geometry, Values, signal, stored
from . import marginal

Table = Float[Array, "images cells"]
MISFIT_AT = 0.1  # of full scale: W_0 / W
BY_IMAGE = ("light_scatter", "direction_scatter", "stray_scatter")


class Cells(eqx.Module):
    """Images of one channel, reduced to cells.

    Attributes:
        geometry: of the cells.
        count: (images, cells) pixels; 0 where a cell is left out.
        mean: (images, cells) DN.
        scatter: (images, cells) sum of squared deviations from the mean, less what the reference
            model varies by within the cell, DN^2.
        offset: (images, cells) DN by which the mean over the pixels of the reference model differs
            from its value at their mean geometry.
        level: (images, cells) D P / (n W), positive.
        products: (cells, images, images) as `scatter`, of two images; None where pixels are alike.
    """

    geometry: Geometry
    count: Table
    mean: Table
    scatter: Table
    offset: Table
    level: Table
    products: Float[Array, "cells images images"] | None = None


class Levels(eqx.Module):
    """Uniform frames: what their temporal variance adds about gain and read noise.

    Attributes:
        mean: (levels,) DN.
        variance: (levels,) DN^2.
        freedom: (levels,) its degrees of freedom.
    """

    mean: Float[Array, " levels"]
    variance: Float[Array, " levels"]
    freedom: Float[Array, " levels"]


class JointData(eqx.Module):
    """Everything that the log density of one channel needs.

    Attributes:
        space: the P parameters.
        form: of the fit.
        known: numbers that are exact, by name.
        cells: of the images.
        levels: flats and darks; None without any.
        white: W, DN.
        relative: by name of an error of images, its size in each image relative to its scale,
            (images,).
    """

    space: ParameterSpace = eqx.field(static=True)
    form: Form = eqx.field(static=True)
    known: Values
    cells: Cells
    levels: Levels | None
    white: Array
    relative: dict[str, Float[Array, " images"]]


Images = tuple[Cells, dict[str, Array], Array | None]


def values_at(vector: Float[Array, " parameters"], data: JointData) -> Values:
    """Natural values by name at an unconstrained vector, including the known ones."""
    natural = to_natural(data.space, vector)
    return data.known | {name: natural[i] for i, name in enumerate(names(data.space))}


class Prediction(eqx.Module):
    """The prediction of cells by a model.

    Attributes:
        mean: (images, cells) DN.
        variance: (images, cells) DN^2 of one pixel, shared errors apart.
        relative: (images, cells) DN by which a relative change of the signal changes it.
        image_errors: (images, errors, cells) DN for errors of one standard deviation; None if
            there are none.
        misfit: (images, cells) DN, standard deviation of what the model misses; None where nothing
            is.
    """

    mean: Table
    variance: Table
    relative: Table
    image_errors: Float[Array, "images errors cells"] | None
    misfit: Table | None


def predicted(values: Values, data: JointData, cells: Cells) -> Prediction:
    """Predict cells, or pixels as cells of one, from natural values. A cell that is left out is
    predicted at a signal of W."""
    geometry, form = cells.geometry, data.form
    seen = cells.count > 0

    def signal_of(wi: Vec) -> Array:
        return signal(values, form, replace(geometry, wi=wi))

    x = jnp.where(seen, signal_of(geometry.wi), data.white)
    mean, variance, slope = stored(values, x, data.white)
    errors = []

    def add(name: str, change: Array) -> None:
        scale = values[name] * data.relative[name][:, None]
        errors.append(jnp.where(seen, scale * slope * change, 0))

    if "light_scatter" in values:
        add("light_scatter", x)
    if "direction_scatter" in values:
        assert geometry.turned is not None
        for i, turn in enumerate(geometry.turned):
            change = jax.jvp(signal_of, (geometry.wi,), (turn,))[1]
            add("direction_scatter", change)
            if geometry.about is not None:
                mean = mean - jnp.where(seen, slope * geometry.about[i][:, None] * change, 0)
    if "stray_scatter" in values:
        add("stray_scatter", geometry.irradiance)
    misfit = None
    if "misfit" in values:
        misfit = values["misfit"] * data.white * jnp.sqrt(MISFIT_AT * cells.level)
    return Prediction(
        mean=mean + cells.offset,
        variance=variance,
        relative=slope * x,
        image_errors=jnp.stack(errors, axis=1) if errors else None,
        misfit=misfit,
    )


def weights(cells: Cells, model: Prediction) -> Table:
    """Inverse variance of each cell's mean without shared errors, (images, cells) DN^-2; 0 for a
    cell that is left out."""
    seen = cells.count > 0
    variance = model.variance / jnp.where(seen, cells.count, 1)
    if model.misfit is not None:
        variance = variance + model.misfit**2
    return jnp.where(seen, 1 / variance, 0)


def cell_errors(values: Values, cells: Cells, model: Prediction) -> Table | None:
    """G: error of a cell's mean by its pixels' gains, for gains of one standard deviation, (images,
    cells) DN; None if pixels are alike."""
    if "prnu" not in values:
        return None
    seen = cells.count > 0
    pixels = jnp.where(seen, cells.count, 1)
    return jnp.where(seen, values["prnu"] * model.relative / jnp.sqrt(pixels), 0)


def log_likelihood(vector: Float[Array, " parameters"], data: JointData) -> Array:
    """ln p(images, flats and darks | unconstrained vector) up to a constant, with the shared errors
    marginalised."""
    values = values_at(vector, data)
    total = _log_likelihood(values, predicted(values, data, data.cells), data)
    return total if data.levels is None else total + _of_levels(values, data)


def by_image(data: JointData) -> Images:
    """Return cells, error sizes and light rotations with a leading axis of images everywhere,
    without products of images."""
    about = data.cells.geometry.about
    geometry = replace(data.cells.geometry, about=None)
    cells = replace(data.cells, geometry=geometry, products=None)
    return cells, data.relative, None if about is None else about.T


def of_one_image(data: JointData, image: Images) -> JointData:
    """Return the data of one image of `by_image`, without uniform frames."""
    cells, relative, about = jax.tree.map(lambda x: x[None], image)
    if about is not None:
        cells = replace(cells, geometry=replace(cells.geometry, about=about.T))
    return replace(data, cells=cells, relative=relative, levels=None)


def log_likelihood_by_image(
    vectors: Float[Array, "images parameters"], data: JointData
) -> Float[Array, ""]:
    """Log likelihood of the images alone if each had its own row of (images, P) vectors. The scale
    of the pixels' gains takes the mean over images."""

    def of(vector: Array, image: Images) -> Prediction:
        own = of_one_image(data, image)
        alone = predicted(values_at(vector, own), own, own.cells)
        return jax.tree.map(lambda x: x[0], alone)

    shared = values_at(jnp.mean(vectors, axis=0), data)
    return _log_likelihood(shared, jax.vmap(of)(vectors, by_image(data)), data)


def _log_likelihood(values: Values, model: Prediction, data: JointData) -> Array:
    """Of the images; of the values only the scale of the pixels' gains counts."""
    cells = data.cells
    total = marginal.log_density(
        cells.mean - model.mean,
        weights(cells, model),
        image_errors=model.image_errors,
        cell_errors=cell_errors(values, cells, model),
    )
    return total + marginal.scatter_log_density(
        cells.scatter,
        cells.count,
        model.variance,
        pixel_errors=values["prnu"] * model.relative if "prnu" in values else None,
        products=cells.products,
    )


def _of_levels(values: Values, data: JointData) -> Array:
    """ln p of the temporal variances of uniform frames, Gamma distributed about the model's at
    their mean."""
    assert data.levels is not None
    levels = data.levels
    above = levels.mean - values["black_level"]
    if "gamma" in values:
        above = data.white * (above / data.white) ** values["gamma"]
    _, variance, _ = stored(values, above, data.white)
    return -jnp.sum(levels.freedom * (jnp.log(variance) + levels.variance / variance)) / 2


def log_posterior(vector: Float[Array, " parameters"], data: JointData) -> Array:
    """Log posterior density of an unconstrained vector, up to a constant."""
    return log_likelihood(vector, data) + log_prior(data.space, vector)


def cost(vector: Float[Array, " parameters"], data: JointData) -> Array:
    """Negative log posterior density, which a fit minimises."""
    return -log_posterior(vector, data)
