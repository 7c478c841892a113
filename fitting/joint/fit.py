"""The fit of one channel by Newton's method on the marginal posterior, from a start by variable
projection.

The cells are reduced about a reference model, which is updated to the best model until it no longer
changes. If the cells scatter more than noise and the stated errors allow, a misfit is added.

The error of a light's direction enters linearly. A highlight is not linear in its light's
direction: the mean over lights with errors of a degree is wider and weaker than each highlight, in
all images. The fit is therefore repeated about the fitted directions (Gauss-Newton) until no light
moves.
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
from ..inference.parameters import ParameterSpace, log_prior, names, to_unconstrained
from ..reflectance.from_images.read import Photographs, turn_prior_of
from ..reflectance.from_images.signal import Form, Values
from ..reflectance.from_images.turns import SETTLED, WIDEST, turned
from ..reflectance.models import is_searched, shape_of
from . import marginal
from .candidates import with_misfit, without_small_errors
from .cells import Grid, cell_width, make_grid, reduce_images
from .model import (
    JointData,
    Levels,
    cost,
    error_precision,
    parameters,
    predicted_parts,
    scatter_scales,
    values_at,
)
from .start import first_noise, first_reflectance

FEWEST_CELLS = 50
EXCESS = 3.0  # standard deviations of chi-square from which the model does not explain the cells
MOST_ROUNDS = 24
FREE_ROUNDS = 2  # after which no cell is taken in again: one at an end of the scale may come and go
AT_REST = 0.05  # standard deviations by which the reference may miss the best model
MOST_TURNS = 8  # of the lights


@dataclass(frozen=True)
class JointFit:
    """A fitted channel."""

    channel: str
    data: JointData  # with the cells about the best model
    grid: Grid
    vector: Float[np.ndarray, " parameters"]  # unconstrained
    information: Float[np.ndarray, "parameters parameters"]  # of the posterior on that scale
    identifiability: Identifiability  # of the likelihood alone
    chi_square: float  # of the cells' means, per cell
    cells: int  # how many there are, over all images
    # chi-square per cell before a misfit was allowed; None where none was needed
    unexplained: float | None
    converged: bool  # whether the optimum was reached
    left_out: tuple[LeftOut, ...] = ()  # errors that the rig names and that are too small to matter

    @property
    def space(self) -> ParameterSpace:
        return self.data.space

    @property
    def form(self) -> Form:
        return self.data.form

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
    """Return the best fit of one channel. It is linear in the errors of light directions about
    `about`, the (2, images) rotations in rad of this observation's lights from the rig's; None for
    none.

    The form becomes Lambert's if no highlight is significant. Too few lit cells raise `InputError`.
    """
    grid, data, start = _prepared(observation, channel, form)
    if about is not None:
        grid = replace(grid, geometry=replace(grid.geometry, about=jnp.asarray(about)))
        data = eqx.tree_at(lambda d: d.cells.geometry, data, grid.geometry)
    data, start, gone = without_small_errors(data, start)
    about_start = data
    data, solution = _rounds(observation, channel, grid, data, start)
    chi_square, cells = _chi_square(solution.vector, data)
    unexplained = None
    if chi_square - 1 > EXCESS * np.sqrt(2 / cells):
        unexplained = chi_square
        data, vector = with_misfit(about_start, start)
        data, solution = _rounds(observation, channel, grid, data, vector)
        chi_square, cells = _chi_square(solution.vector, data)
    of_prior = -eqx.filter_jit(jax.hessian(log_prior, argnums=1))(data.space, solution.vector)
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
        converged=bool(solution.converged)
        and cells >= FEWEST_CELLS
        and is_searched_shape(solution.vector, data),
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
    natural = {name: jnp.asarray(start[name], float) for name in names(space)}
    known = {name: jnp.asarray(value, float) for name, value in known.items()}
    grid = make_grid(
        observation,
        channel,
        natural | known,
        form,
        width=cell_width(form, shape),
        turns="direction_scatter" in scales,
        shared="prnu" in scales,
    )
    cells = reduce_images(observation, channel, grid, natural | known, form)
    seen = int(jnp.sum(cells.count > 0))
    if seen < FEWEST_CELLS:
        raise InputError(
            f"only {seen} patches of the object are lit and clear of black and of saturation "
            f"({observation.clip:g} DN); expose differently, or correct "
            "camera.black_level and camera.saturation."
        )
    levels = None
    if observation.levels is not None:
        own = observation.levels[channel]
        levels = Levels(*(jnp.asarray(a) for a in (own.mean, own.variance, own.freedom)))
    relative = {n: jnp.asarray(size[grid.lights]) for n, (_, size) in scales.items() if n != "prnu"}
    white = jnp.asarray(observation.white)
    data = JointData(space, form, known, cells, levels, white, relative)
    if (prior := turn_prior_of(observation, grid.lights)) is not None:
        data = replace(data, turn_precision=jnp.asarray(np.linalg.inv(prior)))
    return grid, data, to_unconstrained(space, jnp.asarray(list(natural.values())))


def _rounds(
    observation: Photographs, channel: int, grid: Grid, data: JointData, vector: Array
) -> tuple[JointData, NewtonSolution]:
    """The optimum with cells about it: the reference is updated until it no longer changes."""
    solution = minimise(cost, vector, data)
    for number in range(MOST_ROUNDS):
        reference = solution.vector
        within = None if number < FREE_ROUNDS else np.asarray(data.cells.count)
        of = observation, channel, grid, values_at(reference, data), data.form
        data = eqx.tree_at(lambda d: d.cells, data, reduce_images(*of, within=within))
        solution = minimise(cost, reference, data)
        if not solution.converged:
            break
        moved = np.asarray(solution.vector - reference)
        if moved @ np.asarray(solution.information) @ moved < AT_REST**2:
            return data, solution
    return data, replace(solution, converged=jnp.asarray(False))


def _chi_square(vector: Array, data: JointData) -> tuple[float, int]:
    """Chi-square of the cells' means, per degree of freedom, and the number of cells."""
    model, weight, of_cells = predicted_parts(vector, data)
    cells = int(jnp.sum(weight > 0))
    left = data.cells.mean - model.mean
    shared = {
        "image_errors": model.image_errors,
        "cell_errors": of_cells,
        "precision": error_precision(data),
    }
    found = eqx.filter_jit(marginal.chi_square)(left, weight, **shared)
    return float(found) / max(cells - len(data.space), 1), cells


def fit_turned(observation: Photographs, channel: int, form: Form) -> JointFit:
    """Fit one channel about the light directions that its images show, or about the rig's if these
    would be off by far more than stated."""
    sizes = observation.uncertain["direction_sd"][~observation.held_out]
    if not sizes.any():
        return fit_channel(observation, channel, form)
    turns = np.zeros((2, len(sizes)))
    nominal = fit = fit_channel(observation, channel, form, about=turns)
    for _ in range(MOST_TURNS):
        found = likeliest_turns(fit)
        if found is None or found[1].max() > WIDEST * sizes.max():
            return nominal
        if np.all(np.abs(found[0] - turns) <= SETTLED * found[1]):
            break
        turns = found[0]
        across = np.zeros((len(observation.held_out), 2))
        across[fit.grid.lights] = turns.T
        fit = fit_channel(turned(observation, across), channel, form, about=turns)
    return fit


def likeliest_turns(
    fit: JointFit,
) -> tuple[Float[np.ndarray, "2 images"], Float[np.ndarray, " images"]] | None:
    """Return the most likely (2, images) rotations, in rad, of the lights from the rig's
    directions, and the (images,) standard deviations that the rig states. It is None if directions
    are exact or the fit is not an optimum."""
    found = image_errors(fit)
    if "direction_scatter" not in fit.data.relative or not fit.converged or found is None:
        return None
    first = 1 if "light_scatter" in fit.data.relative else 0
    size = np.asarray(fit.data.relative["direction_scatter"] * fit.values["direction_scatter"])
    return found[0][:, first : first + 2].T * size, size


def image_errors(
    fit: JointFit,
) -> tuple[Float[np.ndarray, "images errors"], Float[np.ndarray, "images errors"]] | None:
    """The fitted errors of each image, in units of their scale.

    Args:
        fit: of one channel.

    Returns:
        Means and standard deviations, (images, errors); None where the rig names none.
    """
    model, weight, of_cells = predicted_parts(jnp.asarray(fit.vector), fit.data)
    if model.image_errors is None:
        return None
    left = fit.data.cells.mean - model.mean
    by_image = eqx.filter_jit(marginal.image_error_means)
    shared = {"cell_errors": of_cells, "precision": error_precision(fit.data)}
    mean, spread = by_image(left, weight, model.image_errors, **shared)
    return np.asarray(mean), np.asarray(spread)
