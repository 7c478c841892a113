"""Joint fit of one channel by Newton's method on the marginal posterior, started from a fit by
variable projection.

Images are reduced to cells about a reference model. After each fit the best model becomes the new
reference, until the reference no longer changes. If the cells scatter more than noise and the
stated errors explain, a misfit is added to the model.

The fit is linear in the error of a light's direction, although a highlight is not. Averaged over
directions that vary by a degree, a highlight is wider and weaker than each single highlight. The
fit is therefore repeated about the fitted directions (Gauss-Newton) until no light moves.

An error that all pixels of an image share does not average out over the pixels. Such an error is
therefore compared with the combined noise of all pixels, and dropped if it is negligible
(`inference.left_out`). The comparison uses the upper end of the prior on the error's scale, so that
it is valid for every fitted scale.
"""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxvision.errors import InputError

from ..inference.diagnostics import Identifiability, identifiability
from ..inference.left_out import LeftOut, distance, negligible
from ..inference.newton import NewtonSolution, minimise
from ..inference.parameters import (
    Parameter,
    ParameterSpace,
    log_prior,
    names,
    natural_numbers,
    to_natural,
    to_unconstrained,
)
from ..reflectance.from_images.lights import SETTLED, WIDEST, shift_lights
from ..reflectance.from_images.optimum import project
from ..reflectance.from_images.read import Photographs, turn_prior_of
from ..reflectance.from_images.samples import Selection, View, average, cells_of, select
from ..reflectance.from_images.signal import Form, Matrix, Values, Vector, decoded, parameter_space
from ..reflectance.models import is_searched, shape_of
from . import marginal
from .cells import Grid, cell_width, make_grid, reduce_images
from .model import (
    BY_IMAGE,
    SCATTERS,
    JointData,
    black_level,
    cost,
    error_columns,
    irradiance_turns,
    parameters,
    predicted_parts,
    scatter_scales,
    values_at,
)

FEWEST_CELLS = 50
EXCESS = 3.0  # standard deviations of chi-square above which the model does not explain the cells
MOST_ROUNDS = 24
FREE_ROUNDS = 2  # rounds after which dropped cells stay out, because some could alternate
AT_REST = 0.05  # largest distance of the reference from the best model, in standard deviations
MOST_TURNS = 8  # most updates of the light directions
MOST_AT_START = 100_000  # most samples for the start
LARGEST = 3.0  # standard deviations of the prior of an error's size
MISFIT = Parameter("misfit", symbol="ρ", unit="1", lower=0.0, upper=1.0)
MOST_AT_FIRST = 0.5  # first size of the misfit, at most


@dataclass(frozen=True)
class JointFit:
    """The result of fitting one channel."""

    channel: str
    data: JointData  # with cells reduced about the best model
    grid: Grid
    vector: Vector  # unconstrained
    information: Matrix  # of the posterior on that scale
    identifiability: Identifiability  # of the likelihood alone
    chi_square: float  # of the cells' means, per cell
    cells: int  # number of cells in all images
    # chi-square per cell before a misfit was allowed; None where none was needed
    unexplained: float | None
    converged: bool  # whether the optimum was reached
    left_out: tuple[LeftOut, ...] = ()  # stated errors that are negligible

    @property
    def space(self) -> ParameterSpace:
        return self.data.space

    @property
    def form(self) -> Form:
        return self.data.form

    @property
    def values(self) -> Values:
        """Return all numbers by name, in their own units."""
        return values_at(jnp.asarray(self.vector), self.data)


def fit_channel(
    observation: Photographs,
    channel: int,
    form: Form,
    *,
    about: Float[np.ndarray, "2 images"] | None = None,
) -> JointFit:
    """Return the best fit of one channel. The fit is linear in errors of the light directions.
    `about` are the rotations (2, images), rad, from the rig's light directions to the light
    directions of this observation; None if the directions are equal.

    If no highlight is significant, Lambert's model is fitted. Too few lit cells raise `InputError`.
    """
    grid, data, start = _prepare(observation, channel, form)
    if about is not None:
        grid = replace(grid, geometry=replace(grid.geometry, about=jnp.asarray(about)))
        data = eqx.tree_at(lambda d: d.cells.geometry, data, grid.geometry)
    data, start, gone = drop_small_errors(data, start)
    about_start = data
    data, solution = _rounds(grid, data, start)
    chi_square, cells = _chi_square(solution.vector, data)
    unexplained = None
    if chi_square - 1 > EXCESS * np.sqrt(2 / cells):
        unexplained = chi_square
        data, solution = _rounds(grid, *add_misfit(about_start, start))
        chi_square, cells = _chi_square(solution.vector, data)
    of_prior = -eqx.filter_jit(jax.hessian(log_prior, argnums=1))(data.space, solution.vector)
    by_data = np.asarray(solution.information - of_prior, np.float64)
    found = bool(solution.converged) and is_searched_shape(solution.vector, data)
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
        converged=found and cells >= FEWEST_CELLS,
        left_out=gone,
    )


def is_searched_shape(vector: Float[Array, " parameters"], data: JointData) -> bool:
    """Return whether the lobe's shape is within the searched range."""
    model = data.form.model
    if model == "lambert":
        return True
    return is_searched(model, float(values_at(vector, data)[shape_of(model).name]))


# ---------------------------------------------------------------- start


def _prepare(observation: Photographs, channel: int, form: Form) -> tuple[Grid, JointData, Array]:
    """Return the cells of a channel about a first model, and that model's vector."""
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
    cells = reduce_images(grid, natural | known)
    seen = int(jnp.sum(cells.count > 0))
    if seen < FEWEST_CELLS:
        raise InputError(
            f"only {seen} patches of the object are lit and clear of black and of saturation "
            f"({observation.clip:g} DN); expose differently, or correct "
            "camera.black_level and camera.saturation."
        )
    levels = None if observation.levels is None else observation.levels[channel]
    relative = {n: jnp.asarray(size[grid.lights]) for n, (_, size) in scales.items() if n != "prnu"}
    white = jnp.asarray(observation.white)
    turns = _turns_precision(observation, grid.lights)
    data = JointData(space, form, known, cells, levels, white, relative, *turns)
    return grid, data, to_unconstrained(space, jnp.asarray(list(natural.values())))


def _turns_precision(
    observation: Photographs, lights: Int[np.ndarray, " lights"]
) -> tuple[Array | None, tuple[str, ...]]:
    """Return the inverse covariance of errors of lights that are measured together, and the names
    of these errors. The exposures' own errors add to those of the intensities.
    """
    known = observation.uncertain
    sizes, prior = irradiance_turns(observation)
    if prior is None or not known["direction_sd"][lights].any():
        return None, ()
    prior = turn_prior_of(replace(observation, turn_prior=prior), lights)
    assert prior is not None
    if len(prior) > 2 * len(lights):
        share = np.ones((len(lights), 3))
        share[:, 2] = (sizes / np.maximum(np.hypot(sizes, known["exposure_sd"]), 1e-12))[lights]
        prior = prior * np.outer(share, share) + np.diag(1 - share.ravel() ** 2)
    coupled = ("direction_scatter", "light_scatter")[: len(prior) // len(lights) - 1]
    return jnp.asarray(np.linalg.inv(prior)), coupled


def first_reflectance(
    observation: Photographs, channel: int, form: Form
) -> tuple[Form, dict[str, float]]:
    """Return the model to fit, Lambert's without a highlight, and least-squares values."""
    chosen = select(observation, held_out=False, form=form)
    every = -(-len(chosen.light) // MOST_AT_START)
    chosen = Selection(chosen.light[::every], chosen.pixel[::every])
    samples = View(replace(observation, within=None), channel, chosen).samples(form)
    found, vector = project(average(samples, cells_of(observation, chosen)))
    space = parameter_space(found.form)
    start = dict(zip(names(space), natural_numbers(space, vector).tolist(), strict=True))
    if not form.free_gamma and observation.gamma is not None:
        start["gamma"] = observation.gamma
    return replace(form, model=found.form.model), start


def first_noise(observation: Photographs, channel: int, gamma: float | None) -> dict[str, float]:
    """Return start values of gain, read noise, black level and sizes of errors, in natural units.
    The encoding exponent `gamma` is None for linear files."""
    camera = observation.camera
    found = {name: size for name, (size, _) in scatter_scales(observation).items()}
    gain = camera.gain
    if gain is None:
        gain = _gain_of_neighbours(observation, channel, gamma)
    typical = np.median(observation.dn[channel][observation.cosine > 0]) - observation.black
    read_noise = camera.read_noise or float(np.sqrt(0.1 * max(float(typical), 1.0) / gain))
    black = black_level(observation, channel)[0]
    return found | {"black_level": black, "system_gain": gain, "read_noise": read_noise}


def _gain_of_neighbours(observation: Photographs, channel: int, gamma: float | None) -> float:
    """Estimate K from differences of neighbours in a row, whose light is nearly equal."""
    dn = np.clip(observation.dn[channel], observation.black + 1, None)
    linear = decoded(dn, observation.black, observation.white, gamma)
    beside = (np.diff(observation.columns) == 1) & (np.diff(observation.rows) == 0)
    lit = (observation.cosine[:, 1:] > 0.2) & (dn[:, 1:] < observation.clip) & beside
    squares = np.diff(linear, axis=1)[lit] ** 2 / 2
    if not squares.size:
        return 1.0
    mean = (linear[:, 1:] + linear[:, :-1])[lit] / 2
    return max(float(np.median(squares / mean)) / 0.455, 1e-3)  # of chi-square, one degree


# ---------------------------------------------------------------- search


def _rounds(grid: Grid, data: JointData, vector: Array) -> tuple[JointData, NewtonSolution]:
    """Return the optimum, with cells reduced about it. After each search the optimum becomes the
    new reference model, until it no longer changes.
    """
    solution = minimise(cost, vector, data)
    for number in range(MOST_ROUNDS):
        reference = solution.vector
        within = None if number < FREE_ROUNDS else np.asarray(data.cells.count)
        cells = reduce_images(grid, values_at(reference, data), within=within)
        data = eqx.tree_at(lambda d: d.cells, data, cells)
        solution = minimise(cost, reference, data)
        if not solution.converged:
            break
        moved = np.asarray(solution.vector - reference)
        if moved @ np.asarray(solution.information) @ moved < AT_REST**2:
            return data, solution
    return data, replace(solution, converged=jnp.asarray(False))


def _chi_square(vector: Array, data: JointData) -> tuple[float, int]:
    """Return the chi-square of the cells' means per degree of freedom, and the number of cells."""
    _, left = predicted_parts(vector, data)
    cells = int(jnp.sum(left.weight > 0))
    found = float(eqx.filter_jit(marginal.chi_square)(left))
    return found / max(cells - len(data.space), 1), cells


def drop_small_errors(
    data: JointData, vector: Array
) -> tuple[JointData, Array, tuple[LeftOut, ...]]:
    """Return the data and the unconstrained vector without those stated errors that are negligible
    in total. Also return the dropped errors, in standard deviations of the noise of all data.
    Programs compiled later do not contain dropped errors.
    """
    scatters = [parameter for parameter in data.space if parameter.name in SCATTERS]
    if not scatters:
        return data, vector, ()
    natural = to_natural(data.space, vector)
    for parameter in scatters:
        most = parameter.prior.median * np.exp(LARGEST * parameter.prior.log_sd)
        natural = natural.at[data.space.index(parameter)].set(most)
    _, shared = predicted_parts(to_unconstrained(data.space, natural), data)
    weight, found, columns = np.asarray(shared.weight), [], error_columns(data)
    for parameter in scatters:
        name = parameter.name
        if name == "prnu":
            squares = (weight * np.asarray(shared.cell_errors) ** 2).sum(0)
            count = np.asarray(data.cells.count).max(0)  # pixels of each cell
        else:
            errors = np.asarray(shared.image_errors)[:, columns[name]]
            squares, count = (weight[:, None] * errors**2).sum((1, 2)), 1.0
        found.append(LeftOut(name, parameter.prior.median, distance(squares, parts=count)))
    gone = negligible(found)
    named = {own.name for own in gone}
    left = [i for i, parameter in enumerate(data.space) if parameter.name not in named]
    precision, coupled = data.turn_precision, tuple(n for n in data.coupled if n not in named)
    if precision is not None and coupled != data.coupled:
        sizes = [BY_IMAGE[name] for name in data.coupled]
        kept = np.repeat([name in coupled for name in data.coupled], sizes)
        kept = np.flatnonzero(np.tile(kept, len(precision) // sum(sizes)))
        covariance = np.linalg.inv(np.asarray(precision))[np.ix_(kept, kept)]
        precision = jnp.asarray(np.linalg.inv(covariance)) if kept.size else None
    data = replace(
        data,
        turn_precision=precision,
        coupled=coupled,
        space=tuple(data.space[i] for i in left),
        cells=replace(data.cells, products=None) if "prnu" in named else data.cells,
        relative={name: size for name, size in data.relative.items() if name not in named},
    )
    return data, vector[np.array(left)], gone


def add_misfit(data: JointData, vector: Array) -> tuple[JointData, Array]:
    """Return the data and the start of a model with a misfit, whose size is estimated from the
    cells' residuals.

    The cells must be reduced about the start of the search, because the gain and read noise of the
    best model without a misfit have already absorbed part of the misfit."""
    data = replace(data, space=(*data.space, MISFIT))

    def starting(size: float) -> Array:
        return jnp.concatenate([vector, to_unconstrained((MISFIT,), jnp.asarray([size]))])

    model, left = predicted_parts(starting(MOST_AT_FIRST), data)
    unit = np.asarray(model.misfit) / MOST_AT_FIRST
    seen = np.asarray(left.weight) > 0
    squares = np.asarray(left.residual)[seen] ** 2
    size = float(np.sqrt(squares.mean() / np.mean(unit[seen] ** 2)))
    return data, starting(min(size, MOST_AT_FIRST))


# ---------------------------------------------------------------- lights


def fit_turned(observation: Photographs, channel: int, form: Form) -> JointFit:
    """Fit one channel about light directions estimated from its images. If the estimates differ
    from the rig's directions by far more than the stated uncertainty, the fit is about the rig's
    directions.
    """
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
        fit = fit_channel(shift_lights(observation, across), channel, form, about=turns)
    return fit


def likeliest_turns(
    fit: JointFit,
) -> tuple[Float[np.ndarray, "2 images"], Float[np.ndarray, " images"]] | None:
    """Return the most likely rotations (2, images), rad, of the lights from the rig's directions,
    and the standard deviations (images,) that the rig states. Return None if directions are exact
    or the fit is not an optimum."""
    found = image_errors(fit)
    if "direction_scatter" not in fit.data.relative or not fit.converged or found is None:
        return None
    size = np.asarray(fit.data.relative["direction_scatter"] * fit.values["direction_scatter"])
    return found[0][:, error_columns(fit.data)["direction_scatter"]].T * size, size


def image_errors(
    fit: JointFit,
) -> tuple[Float[np.ndarray, "images errors"], Float[np.ndarray, "images errors"]] | None:
    """Return the fitted errors of each image, in units of their scale.

    Args:
        fit: fit of one channel.

    Returns:
        Means and standard deviations, (images, errors); None where the rig states no errors of
        images.
    """
    _, left = predicted_parts(jnp.asarray(fit.vector), fit.data)
    if left.image_errors is None:
        return None
    mean, spread = eqx.filter_jit(marginal.image_error_means)(left)
    return np.asarray(mean), np.asarray(spread)
