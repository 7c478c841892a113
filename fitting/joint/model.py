"""Prediction of images from a reflectance, an encoding and a sensor together, and the likelihood of
the images.

Numbers that the rig states without an `_sd` are fixed, numbers with an `_sd` have a prior, and
numbers that the rig does not state are free. The stated scale of an error of lights or pixels is
itself uncertain by a factor of about `TRUST`.

`from_images.signal` defines the signal, encoding and noise of a pixel, or of a cell of pixels with
similar normals. The data of a cell are the number, the mean and the scatter of its pixels. The
likelihood of a cell is the likelihood of its pixels, so the scatter determines the gain K.

A stated error is common to a whole image, or to a pixel in all images. The signal X is linear in
such an error. The likelihood is marginalised over the error (`marginal`), so only the scale s of
the error is a parameter. The errors and their effects are:

    light_scatter      X (1 + s u)                      strength of the light, exposure
    direction_scatter  X + (s u_1 - t_1) dX/dt_1 + (s u_2 - t_2) dX/dt_2
                                                        direction of the light; X is taken at its
                                                        rotations t
    stray_scatter      X + s E u                        stray light
    prnu               X (1 + s g)                      gain of a pixel
    misfit             rho sqrt(W_0 D P / n) DN, independent for each cell in each image

Here u and g are standard normal numbers, and E is the irradiance. The misfit represents a surface
that the model does not describe. The misfit grows like photon noise, so that neither shadows nor
highlights dominate. The relative size of the misfit is rho. n is the number of pixels of a cell,
and P is the number of pixels of the widest cells. With the factor P / n, a part of the image has
the same weight whether or not its cells are divided. W_0 is a tenth of full scale. D is the digital
number above black by the cells' reference model. If D were predicted by the fitted model, the fit
could increase the misfit where the model fails.

Errors that the rig does not state are not part of the model.
"""

from dataclasses import field, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.linalg import block_diag

from jaxvision import Vec

from ..inference.parameters import Parameter, ParameterSpace, log_prior, names, to_natural
from ..inference.priors import LogNormal, Normal
from ..reflectance.from_images.lights import light_in_shadows
from ..reflectance.from_images.read import Photographs, UniformLevels
from ..reflectance.from_images.signal import (
    GAMMA,
    Form,
    Geometry,
    Values,
    signal,
    stored,
    surface_parameters,
)
from . import marginal

Table = Float[Array, "images cells"]
MISFIT_AT = 0.1  # of full scale: W_0 / W
BY_IMAGE = {"light_scatter": 1, "direction_scatter": 2, "stray_scatter": 1}  # errors of an image
TRUST = 1.6  # uncertainty factor (one standard deviation) of a stated error


GAIN = Parameter("system_gain", symbol="K", unit="DN/e-", transform="log")
READ_NOISE = Parameter("read_noise", symbol="σ", unit="e-", lower=0.0)
BLACK = Parameter("black_level", symbol="b", unit="DN")
SCATTERS = {
    "light_scatter": Parameter("light_scatter", symbol="s_l", unit="1", transform="log"),
    "direction_scatter": Parameter("direction_scatter", symbol="s_d", unit="rad", transform="log"),
    "stray_scatter": Parameter("stray_scatter", symbol="s_s", unit="1", transform="log"),
    "prnu": Parameter("prnu", symbol="s_p", unit="1", transform="log"),
}


def surface_mask(space: ParameterSpace) -> Bool[np.ndarray, " parameters"]:
    """Return a mask of the parameters of surface and encoding. Images are compared only by these
    parameters, because gain and read noise follow from the scatter of pixels within cells.
    """
    others = {GAIN.name, READ_NOISE.name, BLACK.name, *SCATTERS, "misfit"}
    return np.array([p.name not in others for p in space])


def scatter_scales(
    observation: Photographs,
) -> dict[str, tuple[float, Float[np.ndarray, " lights"]]]:
    """Return, by name of each error that the rig states, its typical size, and the size for each
    light relative to the typical size. The strength of a light and the exposure of its image have
    the same effect, so they count as one error."""
    known = observation.uncertain
    stated = {
        "light_scatter": np.hypot(irradiance_turns(observation)[0], known["exposure_sd"]),
        "direction_scatter": known["direction_sd"],
        "stray_scatter": known["stray_sd"],
    }
    found = {}
    for name, sizes in stated.items():
        if sizes.any():
            typical = float(np.sqrt(np.mean(sizes[sizes > 0] ** 2)))
            found[name] = (typical, sizes / typical)
    if observation.camera.prnu_sd:
        found["prnu"] = (observation.camera.prnu_sd, np.ones(0))
    return found


def irradiance_turns(
    observation: Photographs,
) -> tuple[Float[np.ndarray, " lights"], Float[np.ndarray, "turns turns"] | None]:
    """Return the relative standard deviation of each light's irradiance, and the joint covariance
    of two rotations and the irradiance of each light, in units of their standard deviations; None
    for independent lights and exact intensities. The object counts as small compared with the
    distance of a near light, which changes the irradiance of all pixels alike.
    """
    own, prior = observation.uncertain["intensity_sd"], observation.turn_prior
    lights = len(observation.files)
    kept = 0 if prior is None else len(prior) // lights
    if prior is None or kept < 4:
        return own, prior
    along = np.zeros((lights, 3, 4))
    along[:, 0, 0], along[:, 1, 1], along[:, 2, 2] = 1, 1, own
    along[:, 2, 3] = -2 * observation.uncertain["distance_sd"]
    whole = block_diag(*along)
    covariance = whole @ prior @ whole.T
    scale = np.sqrt(np.maximum(covariance.diagonal(), 1e-24))
    scale.reshape(lights, 3)[:, :2] = 1  # already in units of their own
    return scale[2::3], covariance / np.outer(scale, scale)


def parameters(
    observation: Photographs, channel: int, form: Form, start: dict[str, float]
) -> tuple[ParameterSpace, dict[str, float]]:
    """Return the parameters with their priors, and the numbers that the rig states exactly, by
    name. `start` contains the values at which the search begins, without a gamma for linear files.
    """
    camera, known = observation.camera, {}
    space = [*surface_parameters(form)]

    def add(parameter: Parameter, value: float | None, sd: float | None) -> None:
        if value is None:
            space.append(parameter)
        elif sd is None:
            known[parameter.name] = value
        else:
            space.append(replace(parameter, prior=Normal(value, sd)))

    if "gamma" in start:
        add(GAMMA, None if form.free_gamma else camera.gamma, camera.gamma_sd)
    add(GAIN, camera.gain, camera.gain_sd)
    add(READ_NOISE, camera.read_noise, camera.read_noise_sd)
    add(BLACK, *black_level(observation, channel))
    for name, (size, _) in scatter_scales(observation).items():
        space.append(replace(SCATTERS[name], prior=LogNormal(size, float(np.log(TRUST)))))
    return tuple(space), known


def black_level(observation: Photographs, channel: int) -> tuple[float, float | None]:
    """Return the black level and its standard deviation, from the rig, from the darks, or from
    both, weighted by their precisions. The standard deviation includes the light in attached
    shadows.
    """
    black, sd = given_black_level(observation, channel)
    glow = light_in_shadows(replace(observation, black=black), channel)
    return black, float(np.hypot(sd or 0.0, glow)) if glow else sd


def given_black_level(observation: Photographs, channel: int) -> tuple[float, float | None]:
    """Return black and its deviation by rig and darks, without light in shadows."""
    black, sd = observation.black, observation.camera.black_sd
    stated = observation.camera.black_level is not None
    levels = None if observation.levels is None else observation.levels[channel]
    if levels is None or not levels.dark.any() or (stated and sd is None):
        return black, sd
    means, errors = [levels.mean[levels.dark]], [levels.mean_error[levels.dark]]
    if stated and sd is not None:
        means, errors = [*means, [black]], [*errors, [sd]]
    weight = np.concatenate(errors) ** -2.0
    mean = float(weight @ np.concatenate(means) / weight.sum())
    return mean, float(weight.sum() ** -0.5)


class Cells(eqx.Module):
    """The images of one channel, reduced to cells."""

    geometry: Geometry
    count: Table  # pixels; 0 for an unused cell
    mean: Table  # DN
    # sum of squared deviations from the mean, without the variation of the reference model within
    # the cell, DN^2
    scatter: Table
    # DN, the mean of the model over the pixels minus its value at their mean geometry, extrapolated
    # linearly from the reference to natural values of 0; `slopes` are its derivatives
    offset: Table
    level: Table  # D P / (n W), positive
    # like `scatter`, for products of two images; None if pixels are equal
    products: Float[Array, "cells images images"] | None = None
    slopes: dict[str, Table] = field(default_factory=dict)  # DN, by the parameter's name


class JointData(eqx.Module):
    """Everything that the log density of one channel needs."""

    space: ParameterSpace = eqx.field(static=True)
    form: Form = eqx.field(static=True)
    known: Values  # exactly known numbers, by name
    cells: Cells
    # flats and darks, whose temporal variance adds information on gain and read noise; None if
    # absent
    levels: UniformLevels | None
    white: Array  # W, DN
    # by name of an error of images, its size in each image relative to its scale, (images,)
    relative: dict[str, Float[Array, " images"]]
    # joint inverse covariance of the `coupled` errors of all lights, in units of their scale; None
    # if lights are independent
    turn_precision: Float[Array, "turns turns"] | None = None
    coupled: tuple[str, ...] = eqx.field(static=True, default=())


def error_columns(data: JointData) -> dict[str, slice]:
    """Return the columns of `image_errors` that each error of images has."""
    present = [name for name in BY_IMAGE if name in data.relative]
    ends = np.cumsum([0, *(BY_IMAGE[name] for name in present)])
    return {name: slice(*ends[i : i + 2]) for i, name in enumerate(present)}


def values_at(vector: Float[Array, " parameters"], data: JointData) -> Values:
    """Return natural values by name at an unconstrained vector, with the known numbers."""
    natural = to_natural(data.space, vector)
    return data.known | {name: natural[i] for i, name in enumerate(names(data.space))}


class Prediction(eqx.Module):
    """A model's prediction for cells."""

    mean: Table  # DN
    variance: Table  # DN^2 of one pixel, without shared errors
    relative: Table  # DN, derivative of the mean by a relative change of the signal
    # DN for errors of one standard deviation; None if there are none
    image_errors: Float[Array, "images errors cells"] | None
    misfit: Table | None  # DN, standard deviation of the misfit; None without misfit
    gains: Table | None = None  # DN for pixel gains of one standard deviation; None for equal ones

    @property
    def pixel_variance(self) -> Table:
        """Return the variance of one pixel without errors of its image, DN^2."""
        own = (one for one in (self.gains, self.misfit) if one is not None)
        return self.variance + sum(one**2 for one in own)


def predicted(values: Values, data: JointData, cells: Cells) -> Prediction:
    """Predict cells, or single pixels, from natural values; at white without data."""
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
        mean=mean + cells.offset + sum(values[name] * own for name, own in cells.slopes.items()),
        variance=variance,
        relative=slope * x,
        image_errors=jnp.stack(errors, axis=1) if errors else None,
        misfit=misfit,
        gains=values["prnu"] * slope * x if "prnu" in values else None,
    )


def weights(cells: Cells, model: Prediction) -> Table:
    """Return inverse variances of cells without shared errors, DN^-2; 0 without data."""
    seen = cells.count > 0
    variance = model.variance / jnp.where(seen, cells.count, 1)
    if model.misfit is not None:
        variance = variance + model.misfit**2
    return jnp.where(seen, 1 / variance, 0)


def residuals(model: Prediction, data: JointData) -> marginal.Residuals:
    """Return the residuals of cells with the errors that cells share. Unequal pixel gains shift the
    mean of n pixels by the standard deviation of the gains over the square root of n.
    """
    cells, of_cells, precision = data.cells, None, None
    if model.gains is not None:
        seen = cells.count > 0
        of_cells = jnp.where(seen, model.gains / jnp.sqrt(jnp.where(seen, cells.count, 1)), 0)
    if data.turn_precision is not None:
        assert model.image_errors is not None
        images, errors, _ = model.image_errors.shape
        columns, named = np.arange(images * errors).reshape(images, errors), error_columns(data)
        places = np.concatenate([columns[:, named[n]] for n in data.coupled], axis=1).ravel()
        precision = jnp.eye(images * errors).at[np.ix_(places, places)].set(data.turn_precision)
    left = cells.mean - model.mean
    errors = model.image_errors, of_cells, precision
    return marginal.Residuals(left, weights(cells, model), *errors)


@eqx.filter_jit
def predicted_parts(vector: Array, data: JointData) -> tuple[Prediction, marginal.Residuals]:
    """Return the prediction of cells, and their residuals."""
    model = predicted(values_at(vector, data), data, data.cells)
    return model, residuals(model, data)


def log_likelihood(vector: Float[Array, " parameters"], data: JointData) -> Array:
    """Return ln p(images, flats and darks | vector), with shared errors marginalised."""
    values = values_at(vector, data)
    total = _log_likelihood(predicted(values, data, data.cells), data)
    return total if data.levels is None else total + _uniform_frames_log_density(values, data)


def log_likelihood_by_image(
    vectors: Float[Array, "images parameters"], data: JointData
) -> Float[Array, ""]:
    """Return the images' log likelihood, with parameters `vectors` for each image."""
    about = data.cells.geometry.about
    cells = replace(data.cells, geometry=replace(data.cells.geometry, about=None), products=None)

    def predict_image(
        vector: Array, image: tuple[Cells, dict[str, Array], Array | None]
    ) -> Prediction:
        own, relative, turns = jax.tree.map(lambda x: x[None], image)
        if turns is not None:
            own = replace(own, geometry=replace(own.geometry, about=turns.T))
        alone = replace(data, cells=own, relative=relative)
        return jax.tree.map(lambda x: x[0], predicted(values_at(vector, alone), alone, own))

    images = cells, data.relative, None if about is None else about.T
    return _log_likelihood(jax.vmap(predict_image)(vectors, images), data)


def _log_likelihood(model: Prediction, data: JointData) -> Array:
    """Return the log likelihood of the images alone."""
    cells = data.cells
    own = cells.scatter, cells.count, model.variance
    shared = {"pixel_errors": model.gains, "products": cells.products}
    of_scatter = marginal.scatter_log_density(*own, **shared)
    return marginal.log_density(residuals(model, data)) + of_scatter


def _uniform_frames_log_density(values: Values, data: JointData) -> Array:
    """Return ln p of the variances of flats and darks by their Gamma distributions."""
    assert data.levels is not None
    levels = data.levels
    above = levels.mean - values["black_level"]
    if "gamma" in values:
        above = data.white * (above / data.white) ** values["gamma"]
    _, variance, _ = stored(values, above, data.white)
    return -jnp.sum(levels.freedom * (jnp.log(variance) + levels.variance / variance)) / 2


def log_posterior(vector: Float[Array, " parameters"], data: JointData) -> Array:
    """Return the log posterior density of an unconstrained vector, up to a constant."""
    return log_likelihood(vector, data) + log_prior(data.space, vector)


def cost(vector: Float[Array, " parameters"], data: JointData) -> Array:
    """Return the negative log posterior density, which a fit minimises."""
    return -log_posterior(vector, data)
