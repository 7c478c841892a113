"""`fit_map`: fit one small problem at every pixel of an image, or for every label of an image."""

from collections.abc import Iterator, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import chdtrc, ndtri

from jaxvision.core.plain_arrays import plain_array, widen_short
from jaxvision.core.progress import progress_bar
from jaxvision.errors import InputError

from ..inference.estimates import QUANTILES
from ..inference.given import plain_numbers, require_kind, require_seed, require_whole
from ..inference.misfit import CHANCE
from ..inference.on_host import require_here
from ..inference.parameters import natural_numbers
from ..inference.pixelwise import Ends, fit_side_by_side
from ..inference.problem import Problem, prediction
from ..inference.search import prior_starts, spread_starts
from .data_checks import data_check_of_map
from .map import STATES, FitMap, map_findings
from .result import Fit
from .solve import fit

FEW_STEPS, MANY_STEPS = 20, 200  # steps of all searches, and of the searches that need more
MANY = 0.05  # share of misfit pixels from which the data are checked for a cause
OUTLINE = ("estimate", "sd", "low_95", "low_68", "high_68", "high_95")


def fit_map(
    problem: Problem,
    data: Any,
    *,
    inputs: Any = None,
    labels: Any = None,
    starts: int = 4,
    misfit: Literal["fail", "inflate"] = "fail",
    chunk: int = 4096,
    seed: int = 0,
) -> FitMap:
    """Fit a problem at every pixel separately, or once for all pixels of each label.

    One compiled program fits `chunk` pixels at a time, so memory is needed only for one chunk and
    the maps. Estimates, errors and the tests of the fit equal those of `fit` for the pixel's data,
    without the test of neighbouring residuals. Where a pixel cannot be fitted, because data are
    missing or not finite, the maps are NaN. The findings give the number of such pixels.

    Args:
        problem: the problem of one pixel, for example with one datum per image. Its data and inputs
            give the shapes.
        data: (..., *map) the data of every pixel: the axes of the problem's data, then those of the
            map, such as (images, height, width) for a problem with one datum per image. It may be a
            memory-mapped file. NaN marks missing, saturated or masked data.
        inputs: inputs of every pixel, in the structure of the problem's inputs. An array whose
            shape is the shape in the problem followed by that of the map differs between pixels;
            any other array is used for all pixels. None uses the problem's inputs for all pixels.
        labels: (*map) whole numbers. Pixels of one label (a material) share one set of parameters;
            pixels with a negative label are left out. None fits every pixel separately.
        starts: number of searches for each pixel, spread over bounds and priors.
        misfit: what to do where the data scatter more than the likelihood states, as in `fit`.
        chunk: number of pixels fitted at a time.
        seed: seed of the starts.

    Returns:
        Maps of estimates, errors, intervals and states.

    Raises:
        InputError: for data, inputs or labels of another shape.

    Example:
        >>> from fitting import Gaussian, Parameter, Problem, fit_map
        >>> time = np.linspace(1.0, 8.0, 8)  # s
        >>> pixel = Problem(
        ...     {"dark": Parameter(start=1.0), "offset": Parameter(start=0.0)},
        ...     predict=lambda dark, offset, inputs: offset + dark * inputs,
        ...     likelihood=Gaussian(sd=0.5),
        ...     data=np.zeros(8),
        ...     inputs=time,
        ... )
        >>> images = time[:, None, None] * np.array([[2.0, 3.0]]) + 10.0
        >>> images[:, 0, 1] = np.nan  # a masked pixel
        >>> found = fit_map(pixel, images)
        >>> found.estimate["dark"].round(6).tolist()
        [[2.0, nan]]
    """
    if misfit not in ("fail", "inflate"):
        raise InputError(f"misfit = {misfit!r}: use 'fail' or 'inflate'.")
    require_seed(seed)
    require_whole("chunk", chunk, of="pixels to be fitted at a time")
    for name, values in (("data", data), ("inputs", inputs), ("labels", labels)):
        require_here(name, values)
    require_kind("fit_map: problem", problem, Problem)
    data = plain_numbers("data", data)
    own_shape = problem.data.shape
    shape = tuple(data.shape[len(own_shape) :])
    if (
        problem.stream is not None
        or data.shape[: len(own_shape)] != own_shape
        or 0 in (shape or (0,))
    ):
        raise InputError(
            f"data of shape {tuple(data.shape)} do not fit: they need the shape of the "
            f"problem's data, {own_shape}, followed by the shape of the map."
        )
    leaves = _pixel_leaves(problem, inputs, shape)
    if problem.candidates:
        raise InputError(
            "fit_map has no candidates: state a Parameter, or a number for a term that is absent."
        )
    if labels is not None and problem.start is not None:
        raise InputError("labels: start(data) is for one pixel; give starts to the parameters.")
    if labels is not None:
        return _fit_labels(
            *(problem, data, leaves, labels, shape),
            starts=starts,
            misfit=misfit,
            chunk=chunk,
            seed=seed,
        )
    dtype = jnp.result_type(float)
    require_whole("starts", starts, of="searches")
    table, distances = prior_starts(problem, starts, seed=seed)
    begin = jnp.asarray(table, dtype), jnp.asarray(distances, dtype)
    if problem.start is None:
        spread_starts(problem, starts, seed=seed)  # refuses a parameter without a range to search
    pixels = int(np.prod(shape))
    chunk = min(chunk, pixels)
    flat = data.reshape(*own_shape, pixels)
    chance = jnp.asarray(np.random.default_rng(seed).uniform(size=own_shape), dtype)
    numbers = len(problem.space)
    table = {name: np.full((numbers, pixels), np.nan) for name in OUTLINE}
    chi_square, dof = np.full(pixels, np.nan), np.full(pixels, np.nan)
    state = np.zeros(pixels, np.uint8)

    def run(places: np.ndarray, steps: int) -> np.ndarray:
        """Fit some pixels; return which of them need more steps."""
        filled = np.resize(places, chunk)
        ends = fit_side_by_side(
            begin,
            problem,
            jnp.asarray(np.moveaxis(flat[..., filled], -1, 0), dtype),
            [
                None
                if x is None
                else jnp.asarray(widen_short(plain_array("inputs", np.asarray(x[filled]))))
                for x in leaves
            ],
            jnp.asarray(steps),
            chance,
        )
        ends = jax.tree.map(lambda x: np.asarray(x)[: len(places)], ends)
        columns, remarks = _outcome(problem, ends, inflate=misfit == "inflate")
        for name, values in columns.items():
            table[name][:, places] = values
        chi_square[places], dof[places], state[places] = remarks
        return places[~ends.stationary & ends.finite & (ends.count > 0)]

    with progress_bar("fitting pixels") as advance:
        slow = []
        for places in _parts(np.arange(pixels), chunk):
            slow.append(run(places, FEW_STEPS))
            advance(int(places[-1]) + 1, pixels)
        for places in _parts(np.concatenate(slow), chunk):
            run(places, MANY_STEPS)
    given = np.isfinite(flat).sum(axis=tuple(range(len(own_shape))))
    few = int(np.sum((given < numbers) & (state <= STATES.index("misfit"))))
    many = np.mean(state == STATES.index("misfit")) > MANY
    remarks = data_check_of_map(problem, flat, table["estimate"], leaves, faulty=many, seed=seed)
    if few:
        why = f"{few} of {pixels} pixels have fewer data than unknowns: bounds and priors decide."
        remarks = (why, *remarks)
    return _build_maps(problem, table, chi_square, dof, state, shape, remarks=remarks)


def _parts(places: np.ndarray, size: int) -> Iterator[np.ndarray]:
    for begin in range(0, len(places), size):
        yield places[begin : begin + size]


def _pixel_leaves(problem: Problem, inputs: Any, shape: tuple[int, ...]) -> list[Any]:
    """Return the arrays of the inputs with the pixel axis first; None for an array that all pixels
    share.
    """
    own, form = jax.tree.flatten(problem.inputs)
    if inputs is None:
        return [None] * len(own)
    given, other = jax.tree.flatten(inputs)
    if form != other:
        raise InputError("inputs: give them in the structure of the problem's own.")
    found = []
    for whole, leaf in zip(own, given, strict=True):
        leaf = plain_array("inputs", leaf)
        inner = np.shape(whole)
        if np.shape(leaf) == (*inner, *shape):
            flat = np.asarray(leaf).reshape(*inner, int(np.prod(shape)))
            found.append(np.moveaxis(flat, -1, 0))
        elif np.shape(leaf) == inner and np.array_equal(leaf, whole, equal_nan=True):
            found.append(None)
        else:
            raise InputError(
                f"inputs: an array of shape {np.shape(leaf)} is neither the problem's own nor of "
                f"shape {(*inner, *shape)}, with a value for every pixel."
            )
    return found


def _outcome(
    problem: Problem, ends: Ends, *, inflate: bool
) -> tuple[dict[str, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return arrays (P, problems) of estimates, errors and intervals, and arrays (problems,) of
    chi-square, degrees of freedom and state.
    """
    data, prior = (
        np.asarray(part, np.float64) for part in (ends.data_information, ends.prior_information)
    )
    good = np.asarray(ends.determined & ends.finite & ends.stationary & (ends.count > 0))
    square = np.eye(len(problem.space))

    def inverse(information: np.ndarray) -> np.ndarray:
        return np.linalg.inv(np.where(good[:, None, None], information, square))

    covariance = inverse(data + prior)
    chi_square = np.asarray(ends.chi_square, np.float64)
    dof = np.asarray(ends.count) - np.einsum("kij,kji->k", data, covariance)
    dof = np.where(good, dof, np.nan)
    tested = good & (dof > 1e-6)
    wrong = tested & ~(chdtrc(np.where(tested, dof, 1), np.maximum(chi_square, 0)) > CHANCE)
    if inflate:
        factor = np.where(tested, np.maximum(chi_square / np.where(tested, dof, 1), 1), 1)
        covariance = inverse(data / factor[:, None, None] + prior)
        wrong = wrong & (np.asarray(ends.agreeing) < 2)
    spread = np.sqrt(np.einsum("kii->ki", covariance))
    vector = np.asarray(ends.vector, np.float64)
    steps = ndtri(np.asarray(QUANTILES))[:, None, None] * spread
    natural = natural_numbers(problem.space, vector + steps)
    low95, low68, middle, high68, high95 = np.where(good[:, None], natural, np.nan)
    sd = np.where(good[:, None], np.abs(ends.slope) * spread, np.nan)
    columns = dict(zip(OUTLINE, (middle, sd, low95, low68, high68, high95), strict=True))
    state = np.select(
        [ends.count == 0, ~ends.finite, ~ends.determined, ~ends.stationary, wrong],
        [STATES.index(x) for x in ("no data", "not finite", "undetermined", "stopped", "misfit")],
        STATES.index("converged"),
    )
    chi_square = np.where(good, chi_square, np.nan)
    return {name: x.T for name, x in columns.items()}, (chi_square, dof, state)


def _build_maps(
    problem: Problem,
    table: dict[str, np.ndarray],
    chi_square: np.ndarray,
    dof: np.ndarray,
    state: np.ndarray,
    shape: tuple[int, ...],
    fits: dict[int, Fit] | None = None,
    remarks: Sequence[str] = (),
) -> FitMap:
    named: dict[str, dict[str, np.ndarray]] = {column: {} for column in OUTLINE}
    begin = 0
    for parameter in problem.free:
        inner = parameter.shape or ()
        size = int(np.prod(inner))
        for column in OUTLINE:
            part = table[column][begin : begin + size]
            named[column][parameter.name] = part.reshape(*inner, *shape)
        begin += size

    def interval(level: str) -> dict[str, np.ndarray]:
        low, high = named[f"low_{level}"], named[f"high_{level}"]
        return {name: np.stack([low[name], high[name]]) for name in low}

    return FitMap(
        estimate=named["estimate"],
        sd=named["sd"],
        interval_68=interval("68"),
        interval_95=interval("95"),
        chi_square=chi_square.reshape(shape),
        dof=dof.reshape(shape),
        state=state.reshape(shape),
        units={parameter.name: parameter.unit for parameter in problem.free},
        findings=(*map_findings(state, by_label=fits is not None), *remarks),
        fits=fits or {},
    )


def _fit_labels(
    problem: Problem,
    data: Any,
    leaves: list[Any],
    labels: Any,
    shape: tuple[int, ...],
    *,
    starts: int,
    misfit: Literal["fail", "inflate"],
    chunk: int,
    seed: int,
) -> FitMap:
    """Fit the problem once for each label. The pixels of a label are the rows of one problem that
    is read in chunks.
    """
    labels = np.asarray(labels)
    if labels.shape != shape or not np.issubdtype(labels.dtype, np.integer):
        raise InputError(
            f"labels: whole numbers of shape {shape} are needed, got {labels.dtype} of shape "
            f"{labels.shape}."
        )
    flat, of = data.reshape(*problem.data.shape, -1), labels.ravel()
    numbers = len(problem.space)
    table = {name: np.full((numbers, of.size), np.nan) for name in OUTLINE}
    chi_square, dof = np.full(of.size, np.nan), np.full(of.size, np.nan)
    state = np.full(of.size, STATES.index("no data"), np.uint8)
    whole, form = jax.tree.flatten(problem.inputs)

    def rows(values: Any, inputs: Any) -> Any:
        def predict_pixel(place: Any, own: list[Any]) -> Any:
            del place
            every = [a if b is None else b for a, b in zip(whole, own, strict=True)]
            return prediction(problem, values, inputs=jax.tree.unflatten(form, every))

        return jax.vmap(predict_pixel)(inputs["place"], inputs["own"])

    # Arrays of the likelihood have the shape of one pixel's data, without an axis of pixels.
    likelihood = jax.tree.map(
        lambda x: x[None] if hasattr(x, "ndim") and x.ndim else x, problem.likelihood
    )
    known = {p.name: p for p in problem.free} | problem.fixed | problem.tied
    fits: dict[int, Fit] = {}
    sentences = []
    for label in np.unique(of[of >= 0]):
        places = np.flatnonzero(of == label)
        mine = np.moveaxis(np.asarray(flat[..., places], np.float64), -1, 0)
        if np.isnan(mine).all():
            continue
        own = [None if leaf is None else leaf[places] for leaf in leaves]
        try:
            found = fit(
                Problem(
                    *(known, rows, likelihood, mine),
                    records=problem.records,
                    inputs={"place": np.arange(float(len(places))), "own": own},
                    chunk=chunk,
                ),
                starts=starts,
                misfit=misfit,
                seed=seed,
            )
        except InputError as error:  # concerns only the pixels of this label
            state[places] = STATES.index("undetermined")
            sentences.append(f"Label {label}: {error}")
            continue
        fits[int(label)] = found
        for i, one in enumerate(found.estimates):
            assert one.interval_68 is not None
            assert one.interval_95 is not None
            row = (one.value, one.standard_error, one.interval_95[0])
            row = (*row, one.interval_68[0], one.interval_68[1], one.interval_95[1])
            for name, value in zip(OUTLINE, row, strict=True):
                table[name][i, places] = value
        chi_square[places], dof[places] = found.misfit.chi_square, found.misfit.dof
        good = found.converged
        state[places] = STATES.index("converged" if good else "misfit")
        if not found.optimum.stationary:
            state[places] = STATES.index("stopped")
    return _build_maps(problem, table, chi_square, dof, state, shape, fits, sentences)
