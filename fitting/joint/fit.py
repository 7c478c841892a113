"""The fit of one channel: a start by variable projection, then Newton's method on the marginal
posterior, about a reference that is moved to the best model once. Where the cells scatter more than
noise and the errors that the rig names allow, a misfit is added, and said.
"""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.errors import InputError

from ..inference.diagnostics import Identifiability, identifiability
from ..inference.left_out import LeftOut
from ..inference.newton import NewtonSolution, minimise
from ..inference.parameters import Parameter, ParameterSpace, log_prior, names, to_unconstrained
from ..reflectance.from_images.read import Photographs, UniformLevels
from ..reflectance.from_images.signal import Form, Values
from ..reflectance.models import is_searched, shape_of
from . import marginal
from .cells import Grid, cell_width, make_grid, reduce_images
from .left_out import small, widest, without
from .model import (
    Cells,
    JointData,
    Levels,
    Prediction,
    cell_errors,
    cost,
    predicted,
    values_at,
    weights,
)
from .start import (
    SCATTERS,
    first_noise,
    first_reflectance,
    parameters,
    scatter_scales,
)

FEWEST_CELLS = 50
EXCESS = 3.0  # standard deviations of chi-square from which the model does not explain the cells
MOST_ROUNDS = 24
FREE_ROUNDS = 2  # after which no cell is taken in again: one at an end of the scale may come and go
AT_REST = 0.05  # standard deviations by which the reference may miss the best model
MISFIT = Parameter("misfit", symbol="ρ", unit="1", lower=0.0, upper=1.0)
MOST_AT_FIRST = 0.5


@dataclass(frozen=True)
class JointFit:
    """A fitted channel.

    Attributes:
        channel: name.
        data: with the cells about the best model.
        grid: of the cells.
        vector: (P,) unconstrained.
        information: (P, P) of the posterior on that scale.
        identifiability: of the likelihood alone.
        chi_square: of the cells' means, per cell.
        cells: how many there are, over all images.
        unexplained: chi-square per cell before a misfit was allowed; None where none was needed.
        converged: whether the optimum was reached.
        left_out: errors that the rig names and that are too small to matter.
    """

    channel: str
    data: JointData
    grid: Grid
    vector: Float[np.ndarray, " parameters"]
    information: Float[np.ndarray, "parameters parameters"]
    identifiability: Identifiability
    chi_square: float
    cells: int
    unexplained: float | None
    converged: bool
    left_out: tuple[LeftOut, ...] = ()

    @property
    def space(self) -> ParameterSpace:
        return self.data.space

    @property
    def values(self) -> Values:
        """All numbers by name, in their own units."""
        return values_at(jnp.asarray(self.vector), self.data)


def fit_channel(
    observation: Photographs,
    channel: int,
    form: Form,
    *,
    about: Float[np.ndarray, "2 images"] | None = None,
) -> JointFit:
    """Return the best fit of one channel, linear in the errors of light directions about `about`:
    (2, images) rad by which this observation's lights are rotated from the rig's, None for none.

    The form becomes Lambert's if no highlight is seen. Too few lit cells are an `InputError`.
    """
    grid, data, start = _prepared(observation, channel, form)
    if about is not None:
        grid = replace(grid, geometry=replace(grid.geometry, about=jnp.asarray(about)))
        data = eqx.tree_at(lambda d: d.cells.geometry, data, grid.geometry)
    gone = ()
    if not set(SCATTERS).isdisjoint(names(data.space)):
        gone = small(data, *_predicted(widest(start, data.space), data))
    data, start = without(data, start, gone)
    about_start = data
    data, solution = _rounds(observation, channel, grid, data, start)
    chi_square, cells = _chi_square(solution.vector, data)
    unexplained = None
    if chi_square - 1 > EXCESS * np.sqrt(2 / cells):
        unexplained = chi_square
        data, vector = _with_misfit(about_start, start)
        data, solution = _rounds(observation, channel, grid, data, vector)
        chi_square, cells = _chi_square(solution.vector, data)
    of_prior = _prior_information(solution.vector, data.space)
    by_data = np.asarray(solution.information - of_prior, np.float64)
    return JointFit(
        channel=observation.channels[channel],
        data=data,
        grid=grid,
        vector=np.asarray(solution.vector, np.float64),
        information=np.asarray(solution.information, np.float64),
        identifiability=identifiability(data.space, by_data, vector=solution.vector),
        chi_square=chi_square,
        cells=cells,
        unexplained=unexplained,
        converged=bool(solution.converged) and is_searched_shape(solution.vector, data),
        left_out=gone,
    )


def is_searched_shape(vector: Float[Array, " parameters"], data: JointData) -> bool:
    """Whether the shape of the lobe is within the searched range; an optimum outside it is
    rejected."""
    model = data.form.model
    if model == "lambert":
        return True
    return is_searched(model, float(values_at(vector, data)[shape_of(model).name]))


def _prepared(observation: Photographs, channel: int, form: Form) -> tuple[Grid, JointData, Array]:
    """The cells of one channel about a first model, and that model, unconstrained."""
    form, start = first_reflectance(observation, channel, form)
    space, known = parameters(observation, channel, form, start)
    start = start | first_noise(observation, channel, start.get("gamma"))
    shape = None if form.model == "lambert" else start[shape_of(form.model).name]
    scales = scatter_scales(observation)
    natural = {name: start[name] for name in names(space)} | known
    grid = make_grid(
        observation,
        channel,
        {name: jnp.asarray(value) for name, value in natural.items()},
        form,
        width=cell_width(form, shape),
        turns="direction_scatter" in scales,
        shared="prnu" in scales,
    )
    data = JointData(
        space=space,
        form=form,
        known={name: jnp.asarray(value) for name, value in known.items()},
        cells=_reduced(observation, channel, grid, natural, form),
        levels=_levels(observation, channel),
        white=jnp.asarray(observation.white),
        relative={
            name: jnp.asarray(size[grid.lights])
            for name, (_, size) in scales.items()
            if name != "prnu"
        },
    )
    _refuse_too_little(observation, data)
    vector = to_unconstrained(space, jnp.asarray([natural[name] for name in names(space)]))
    return grid, data, vector


def _with_misfit(data: JointData, vector: Array) -> tuple[JointData, Array]:
    """Return the data and start of a model with a misfit, whose size the cells' residuals give.

    The cells must be about the start. About the best model without a misfit, its gain and read
    noise have already taken up part of the misfit.
    """
    data = replace(data, space=(*data.space, MISFIT))

    def starting(size: float) -> Array:
        return jnp.concatenate([vector, to_unconstrained((MISFIT,), jnp.asarray([size]))])

    model, weight, _ = _predicted(starting(MOST_AT_FIRST), data)
    unit = np.asarray(model.misfit) / MOST_AT_FIRST
    seen = np.asarray(weight) > 0
    squares = np.asarray(data.cells.mean - model.mean)[seen] ** 2
    size = float(np.sqrt(squares.mean() / np.mean(unit[seen] ** 2)))
    return data, starting(min(size, MOST_AT_FIRST))


def _rounds(
    observation: Photographs, channel: int, grid: Grid, data: JointData, vector: Array
) -> tuple[JointData, NewtonSolution]:
    """The optimum, with cells about it: the reference follows until it has come to rest."""
    solution = minimise(cost, vector, data)
    for number in range(MOST_ROUNDS):
        reference = solution.vector
        natural = {k: float(v) for k, v in values_at(reference, data).items()}
        within = None if number < FREE_ROUNDS else np.asarray(data.cells.count)
        cells = _reduced(observation, channel, grid, natural, data.form, within=within)
        data = eqx.tree_at(lambda d: d.cells, data, cells)
        solution = minimise(cost, reference, data)
        if not solution.converged:
            break
        moved = np.asarray(solution.vector - reference)
        if moved @ np.asarray(solution.information) @ moved < AT_REST**2:
            return data, solution
    return data, replace(solution, converged=jnp.asarray(False))


def _reduced(
    observation: Photographs,
    channel: int,
    grid: Grid,
    natural: dict[str, float],
    form: Form,
    *,
    within: np.ndarray | None = None,
) -> Cells:
    reference = {name: jnp.asarray(value) for name, value in natural.items()}
    kept = {"products": "prnu" in natural, "within": within}
    return reduce_images(observation, channel, grid, reference, form, **kept)


def _levels(observation: Photographs, channel: int) -> Levels | None:
    if observation.levels is None:
        return None
    of: UniformLevels = observation.levels[channel]
    return Levels(*(jnp.asarray(a) for a in (of.mean, of.variance, of.freedom)))


def _refuse_too_little(observation: Photographs, data: JointData) -> None:
    cells = int(jnp.sum(data.cells.count > 0))
    if cells < FEWEST_CELLS:
        raise InputError(
            f"only {cells} patches of the object are lit and clear of black and of saturation "
            f"({observation.clip:g} DN); expose differently, or correct "
            "camera.black_level and camera.saturation."
        )


@eqx.filter_jit
def _predicted(vector: Array, data: JointData) -> tuple[Prediction, Array, Array | None]:
    values = values_at(vector, data)
    model = predicted(values, data, data.cells)
    return model, weights(data.cells, model), cell_errors(values, data.cells, model)


def _chi_square(vector: Array, data: JointData) -> tuple[float, int]:
    """Of the cells' means, per cell; and how many cells there are."""
    model, weight, of_cells = _predicted(vector, data)
    cells = int(jnp.sum(weight > 0))
    found = _quadratic(data.cells.mean - model.mean, weight, model.image_errors, of_cells)
    return float(found) / (cells - len(data.space)), cells


@eqx.filter_jit
def _quadratic(
    residual: Array, weight: Array, image_errors: Array | None, cells: Array | None
) -> Array:
    return marginal.chi_square(residual, weight, image_errors=image_errors, cell_errors=cells)


@eqx.filter_jit
def _prior_information(vector: Array, space: ParameterSpace) -> Array:
    return -jax.hessian(log_prior, argnums=1)(space, vector)


def image_errors(
    fit: JointFit,
) -> tuple[Float[np.ndarray, "images errors"], Float[np.ndarray, "images errors"]] | None:
    """The errors of each image that the fit sees, in units of their scale.

    Args:
        fit: of one channel.

    Returns:
        Means and standard deviations, (images, errors); None where the rig names none.
    """
    model, weight, of_cells = predicted_cells(fit)
    if model.image_errors is None:
        return None
    residual = fit.data.cells.mean - model.mean
    found = eqx.filter_jit(marginal.image_error_means)(
        residual, weight, model.image_errors, cell_errors=of_cells
    )
    mean, spread = (np.asarray(a) for a in found)
    return mean, spread


def predicted_cells(fit: JointFit) -> tuple[Prediction, Array, Array | None]:
    """Return the prediction of a fit's own cells, their weights in DN^-2, and their errors by pixel
    gains in DN, or None if pixels are alike."""
    return _predicted(jnp.asarray(fit.vector), fit.data)
