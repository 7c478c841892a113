"""State a problem: the parameters, the prediction, the likelihood and the data.

u -> values -> prediction -> ln p(data | values) + ln p(u)

Here u is the vector of unconstrained parameters. The user writes the model once, as `predict`.
Residuals, cost and log density follow from it. `predict` is any JAX function, and the names of its
arguments select what it receives: `values` (natural values by name), `inputs`, a record (such as a
scene that contains the parameters), or the value of one parameter.
"""

import inspect
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import date
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxvision.core.plain_arrays import plain_array, widen_short, within_integers
from jaxvision.errors import InputError, nearest

from .candidates import Candidate
from .given import plain_numbers, require_kind
from .joint_prior import JointPrior, apply_joint_prior, log_dependence, restrict
from .likelihoods import Likelihood, check_data, for_data, names_within, substitute_values
from .on_host import to_host
from .parameters import Parameter, ParameterSpace, log_prior, scalars, to_natural
from .records import is_path, reach, read, replaced
from .streams import Stream, open_stream

Values = dict[str, Array]
Vector = Float[Array, " parameters"]


class Tied(eqx.Module):
    """A number that is computed from other parameters.

    Attributes:
        of: function of natural values and fixed numbers, by name, that returns the number.

    Example:
        >>> from fitting import Tied
        >>> tie = Tied(lambda values: 1 - values["diffuse"])
    """

    of: Callable[[Values], Any] = eqx.field(static=True)


class Problem(eqx.Module):
    """A problem to fit: parameters, prediction, likelihood and data.

    Attributes:
        free: the parameters, each with its name and shape.
        fixed: constants, by name.
        tied: numbers that are functions of others, by name.
        predict: function from the values to the prediction that the likelihood compares with the
            data: an array of their shape, or a record for a likelihood of your own.
        asks: names of the arguments of `predict`.
        likelihood: distribution of the data about the prediction.
        data: of any shape; 0 where missing.
        present: mask of the data that are not missing; None if all are present.
        stream: source of all data, of which `data` are a sample; None if `data` are all.
        records: records by name, into which the paths lead.
        inputs: further data that `predict` receives as its argument `inputs`.
        space: all free numbers in the order of every vector.
        prior: joint prior from an earlier fit, with its correlations; or None.
        candidates: terms that a fit may leave out.
        start: function from the data to natural values by name, from which a search begins; or
            None.
        left_out: what `called_for` has removed from the records, or None.

    Raises:
        InputError: for a path, an argument of `predict` or a shape that does not match.

    Example:
        >>> from fitting import Gaussian, Parameter, Problem, fit
        >>> problem = Problem(
        ...     {"slope": Parameter(start=1.0), "offset": 1.0},
        ...     predict=lambda slope, offset, inputs: offset + slope * inputs,
        ...     likelihood=Gaussian(sd=0.1),
        ...     data=np.array([1.0, 3.0, 5.0]),
        ...     inputs=np.array([0.0, 1.0, 2.0]),
        ... )
        >>> round(float(fit(problem).values["slope"]), 4)
        2.0
    """

    free: tuple[Parameter, ...]
    fixed: Values
    tied: dict[str, Tied]
    predict: Callable[..., Any] = eqx.field(static=True)
    asks: tuple[str, ...] = eqx.field(static=True)
    likelihood: Likelihood
    data: Array
    present: Bool[Array, "..."] | None
    stream: Stream | None = eqx.field(static=True)
    records: dict[str, Any]
    inputs: Any
    space: ParameterSpace
    prior: JointPrior | None
    candidates: tuple[Candidate, ...] = eqx.field(static=True)
    start: Callable[..., Any] | None = eqx.field(static=True)
    left_out: Any = eqx.field(static=True)

    def __init__(
        self,
        parameters: Mapping[str, Parameter | Candidate | Tied | Any],
        predict: Callable[..., Any],
        likelihood: Likelihood,
        data: Any,
        *,
        records: Mapping[str, Any] | None = None,
        inputs: Any = None,
        start: Callable[..., Any] | None = None,
        prior: JointPrior | None = None,
        chunk: int | None = None,
        left_out: Any = None,
    ) -> None:
        """State the problem.

        `data`: an array of the prediction's shape, with NaN for missing data.

        `start`: a JAX function that returns natural values by name, for some parameters or all,
        from which the first search begins. Its arguments are `data` (with NaN for missing data) and
        those of `predict` that are not parameters. `fit_map` calls it for each pixel. NaN means no
        value, and a value outside a bound is moved inside. If `start` is None, the first search
        begins at the starts of the parameters.

        `prior`: the posterior of an earlier fit, `earlier.as_prior("camera.*")`, or the draws of a
        camera file, `as_prior({"sensor": read_sensor("sensor.toml", draws=500)}, "sensor.*")`. It
        replaces the priors of the parameters that it names; other parameters keep theirs. Numbers
        of the prior that are not free in this problem are marginalised. A name that was given to
        `as_prior` without `*` must be a free parameter of this problem.

        `chunk`: number of rows of data to read at a time, which limits the memory needed; 50,000
        suits most problems. None reads all data at once. With `chunk`, the data are an array (it
        may be memory-mapped) or a function without arguments that yields arrays or pairs (data,
        inputs), the same at every call. Every array of the inputs or the likelihood that has one
        row per row of data is split in the same way. Other arrays are passed whole. `predict` must
        predict each row from its own inputs.
        """
        self.left_out = left_out
        self.records = dict(records or {})
        self.stream = None
        if chunk is not None:
            self.stream, data, inputs, likelihood = open_stream(data, inputs, likelihood, chunk)
        self.inputs = as_arrays(inputs)
        candidates = {name: c for name, c in parameters.items() if isinstance(c, Candidate)}
        parameters = dict(parameters) | {name: c.parameter for name, c in candidates.items()}
        self.free = tuple(
            placed(name, entry, self.records)
            for name, entry in parameters.items()
            if isinstance(entry, Parameter)
        )
        self.prior = None
        if prior is not None:
            require_kind("prior", prior, JointPrior, source="fit(...).as_prior(...)")
            self.free, self.prior = apply_joint_prior(self.free, prior)
        self.candidates = tuple(
            replace(candidates[parameter.name], parameter=parameter)
            for parameter in self.free
            if parameter.name in candidates
        )
        self.tied = {name: entry for name, entry in parameters.items() if isinstance(entry, Tied)}
        self.fixed = {
            name: jnp.asarray(plain_numbers(name, entry), jnp.result_type(float))
            for name, entry in parameters.items()
            if not isinstance(entry, (Parameter, Tied))
        }
        self.space = tuple(
            number for parameter in self.free for number in scalars(parameter, _shape(parameter))
        )
        self.likelihood = likelihood
        self.predict = predict
        self.asks = argument_names(predict)
        self.start = start
        check_names(self, parameters)
        known = to_host(plain_numbers("data", data), dtype=jnp.result_type(float))
        if infinite := int(np.isinf(known).sum()):
            raise InputError(f"{infinite} of the data are infinite: mark missing ones by NaN.")
        missing = np.isnan(known)
        self.data = placed_like(data, np.where(missing, 0, known))
        partly = missing.any() or self.stream is not None  # one structure for all chunks
        self.present = placed_like(data, ~missing) if partly else None
        check_data(likelihood, self.data)
        _check_shapes(self)

    def with_data(self, data: Any, *, inputs: Any = None) -> "Problem":
        """Return the same problem with other data. If the shapes are equal, its fit needs no
        compilation.

        Args:
            data: data of the prediction's shape; NaN where missing. For a problem in chunks, data
                in the same form as the problem's.
            inputs: new inputs; None keeps the present ones.

        Returns:
            The problem.
        """
        return self._replace(data=data, **({} if inputs is None else {"inputs": inputs}))

    def with_records(self, records: Mapping[str, Any], *, left_out: Any = None) -> "Problem":
        """Return the same problem with other records.

        Args:
            records: all records, by name.
            left_out: the certificate of `called_for` for what was removed from the records.

        Returns:
            The problem.
        """
        return self._replace(records=records, left_out=left_out)

    def without(self, name: str) -> "Problem":
        """Return the same problem without a candidate. The candidate's parameter is fixed at its
        `absent` value.

        Args:
            name: name of the candidate.

        Returns:
            The problem.

        Raises:
            InputError: for an unknown candidate, and for one that another candidate requires.
        """
        known = {candidate.name: candidate for candidate in self.candidates}
        if name not in known:
            raise InputError(f"without: no candidate {name!r}; {nearest(name, known)}.")
        for other in self.candidates:
            if name in other.requires:
                raise InputError(
                    f"without: {other.name} requires {name}; leave {other.name} out first."
                )
        one = known[name]
        return self._replace({name: np.full(_shape(one.parameter), one.absent)})

    def with_priors(self, change: Callable[[Any], Any]) -> "Problem":
        """Return the same problem with other priors.

        Args:
            change: function that takes a prior and returns its replacement.

        Returns:
            The problem.
        """

        def change_all(prior: Any) -> Any:
            return tuple(map(change_all, prior)) if isinstance(prior, tuple) else change(prior)

        free = {p.name: replace(p, prior=p.prior and change_all(p.prior)) for p in self.free}
        every: dict[str, Any] = free | {
            one.name: replace(one, parameter=free[one.name]) for one in self.candidates
        }
        joint = self.prior
        if joint is not None:
            joint = replace(joint, marginals=change_all(joint.marginals))
        return self._replace(every, prior=joint)

    def _replace(self, parameters: Mapping[str, Any] | None = None, **changes: Any) -> "Problem":
        present = True if self.present is None else to_host(self.present)
        given = {
            "data": np.where(present, to_host(self.data), np.nan),
            "records": self.records,
            "inputs": self.inputs,
            "start": self.start,
            "left_out": self.left_out,
        }
        likelihood = self.likelihood
        if (stream := self.stream) is not None:
            given |= {"data": stream.data, "inputs": stream.inputs, "chunk": stream.size}
            likelihood = stream.likelihood
        every: dict[str, Any] = {p.name: p for p in self.free} | self.fixed | self.tied
        every |= {candidate.name: candidate for candidate in self.candidates}
        every |= parameters or {}
        if self.prior is not None:
            kept = [name for name, one in every.items() if isinstance(one, Parameter | Candidate)]
            given["prior"] = restrict(self.prior, kept)
        return Problem(every, self.predict, likelihood, **(given | changes))


def _shape(parameter: Parameter) -> tuple[int, ...]:
    return parameter.shape or ()


def _check_shapes(problem: Problem) -> None:
    """Check the shapes of prediction and log density in one trace, which may take long."""

    def terms(vector: Vector, problem: Problem) -> Array:
        values = values_at(problem, vector)
        seen = prediction(problem, values)
        if hasattr(seen, "shape") and seen.shape != problem.data.shape:
            raise InputError(
                f"predict gives an array of shape {seen.shape}, the data have "
                f"{problem.data.shape}: they must be equal."
            )
        if jnp.issubdtype(getattr(seen, "dtype", float), jnp.complexfloating):
            raise InputError(
                "predict gives complex numbers, and the data are real: give their modulus, or real "
                "and imaginary parts along an axis of two, as in the data."
            )
        unfit = InputError(
            "The likelihood's numbers do not fit data of shape "
            f"{problem.data.shape}: give each as one number or in the data's shape."
        )
        if seen is None or isinstance(seen, tuple | list):
            unfit = InputError(
                f"predict gives a {type(seen).__name__} and no array: give one array of shape "
                f"{problem.data.shape}, as the data have."
            )
        try:
            found = datum_terms(problem, values, seen)
        except InputError:
            raise
        except (
            TypeError,
            ValueError,
        ) as error:  # JAX's own words on shapes that do not go together
            raise unfit from error
        if found.shape != problem.data.shape:
            raise unfit
        return found

    eqx.filter_eval_shape(terms, jnp.zeros(len(problem.space)), problem)
    if problem.start is not None:
        eqx.filter_eval_shape(start_of_data, problem)


def values_at(problem: Problem, vector: Vector) -> Values:
    """Return the natural values of every parameter by name, including fixed and tied numbers."""
    return values_from(problem, to_natural(problem.space, vector))


def values_from(problem: Problem, natural: Vector) -> Values:
    """Return what `values_at` returns, from natural values (P,)."""
    values, begin = {}, 0
    for parameter in problem.free:
        size = int(np.prod(_shape(parameter)))
        values[parameter.name] = natural[begin : begin + size].reshape(_shape(parameter))
        begin += size
    values |= problem.fixed
    for name, tie in problem.tied.items():
        try:
            values[name] = jnp.asarray(tie.of(values))
        except KeyError as error:
            word = str(error.args[0])
            raise InputError(
                f"The tie of {name} asks for {word!r}: no such parameter; {nearest(word, values)}."
            ) from error
    return values


def give(problem: Problem, function: Callable[..., Any], values: Values, inputs: Any) -> Any:
    """Call a function with those values, inputs and records that its arguments name."""
    known = {"values": values, "inputs": inputs, **values, **records_at(problem, values)}
    who = "predict" if function is problem.predict else "The function"
    return _call(function, known, who)


def _call(function: Callable[..., Any], known: Mapping[str, Any], who: str) -> Any:
    """Call a function with its named arguments; say why if JAX cannot trace it."""
    asked, rest = named_and_rest(function)
    for unknown in {argument.name for argument in asked} - known.keys():
        raise InputError(f"A function asks for {unknown!r}; {nearest(unknown, known)}.")
    named = {a.name: known[a.name] for a in asked if a.kind is a.KEYWORD_ONLY}
    if rest:
        named |= {name: known[name] for name in known.keys() - {*GIVEN, *(a.name for a in asked)}}
    try:
        return function(*(known[a.name] for a in asked if a.kind is not a.KEYWORD_ONLY), **named)
    except jax.errors.TracerArrayConversionError as error:
        raise InputError(
            f"{who} passes a fitted number to NumPy, which JAX cannot trace; use "
            "jax.numpy in place of numpy."
        ) from error
    except jax.errors.ConcretizationTypeError as error:
        raise InputError(
            f"{who} converts a fitted number to a Python number (by float, math or if), which "
            "JAX cannot trace; use jax.numpy, and jax.numpy.where for a choice."
        ) from error


def start_of_data(problem: Problem) -> Values:
    """Return the start values that the problem's `start` computes from its data."""
    assert problem.start is not None
    data = problem.data
    if problem.present is not None:
        data = jnp.where(problem.present, data, jnp.nan)
    known = {"inputs": problem.inputs, **problem.records, "data": data}
    found = _call(problem.start, known, "start")
    if not isinstance(found, Mapping):
        raise InputError(
            f"start gives a {type(found).__name__}: return natural values by name, such as "
            '{"height": data.max()}.'
        )
    free = [parameter.name for parameter in problem.free]
    for name in found:
        if name not in free:
            raise InputError(f"start names {name!r}, no free parameter; {nearest(name, free)}.")
    return {name: jnp.asarray(value, jnp.result_type(float)) for name, value in found.items()}


def prediction(problem: Problem, values: Values, *, inputs: Any = None) -> Array:
    """Return the prediction that the likelihood compares with the data."""
    return give(problem, problem.predict, values, problem.inputs if inputs is None else inputs)


def records_at(problem: Problem, values: Values) -> dict[str, Any]:
    """Return the records with the given natural values at their paths."""
    return replaced(
        problem.records, {name: value for name, value in values.items() if is_path(name)}
    )


def likelihood_at(problem: Problem, values: Values) -> Likelihood:
    """Return the likelihood with values in place of the names of parameters and records."""

    def value_of(name: str) -> Any:
        return values[name] if name in values else reach(records_at(problem, values), name)

    return for_data(substitute_values(problem.likelihood, value_of), problem.data)


def log_likelihood_terms(vector: Vector, problem: Problem) -> Float[Array, "..."]:
    """Return ln p of every datum, 0 where it is missing."""
    values = values_at(problem, vector)
    return datum_terms(problem, values, prediction(problem, values))


def datum_terms(problem: Problem, values: Values, seen: Array) -> Array:
    """Return ln p of every datum about a prediction, 0 where it is missing."""
    terms = likelihood_at(problem, values).log_density(seen, problem.data)
    return terms if problem.present is None else jnp.where(problem.present, terms, 0)


def log_likelihood(vector: Vector, problem: Problem) -> Float[Array, ""]:
    """Return ln p(data | values), the sum over all data."""
    return jnp.sum(log_likelihood_terms(vector, problem))


def log_density(vector: Vector, problem: Problem) -> Float[Array, ""]:
    """Return the log posterior density of the unconstrained vector, up to a constant."""
    return log_likelihood(vector, problem) + log_prior_at(problem, vector)


def log_prior_at(problem: Problem, vectors: Float[Array, "... parameters"]) -> Float[Array, "..."]:
    """Return the log prior density of unconstrained vectors, up to a constant."""
    found = log_prior(problem.space, vectors)
    if problem.prior is None:
        return found
    return found + log_dependence(problem.prior, problem.space, vectors)


def least_squares_residuals(vector: Vector, problem: Problem) -> Float[Array, " data"]:
    """Return the standardised residuals, 0 where a datum is missing. The residual of a clipped
    datum is that of the end at which it was clipped.
    """
    return residuals_from(to_natural(problem.space, vector), problem)


def residuals_from(natural: Vector, problem: Problem) -> Float[Array, " data"]:
    """Return what `least_squares_residuals` returns, from natural values (P,)."""
    values = values_from(problem, natural)
    likelihood = likelihood_at(problem, values)
    found = likelihood.residuals(prediction(problem, values), problem.data, np.zeros(()))
    found = jnp.asarray(found)
    if problem.present is not None:
        found = jnp.where(problem.present, found, 0)
    return found.ravel()


GIVEN = ("values", "inputs")
PARTS = ("least_squares", "surrogate", "log_density", "residuals", "draw")  # of a likelihood


def as_arrays(tree: Any) -> Any:
    """Return a tree with its floating-point leaves as arrays, which are data and no part of a
    compile key. Numbers of 8 and 16 bits become wider, so that squares and products do not
    overflow.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        listed = bool(path) and isinstance(path[-1], jax.tree_util.SequenceKey)
        if listed and isinstance(leaf, str | bytes | date):
            raise InputError(f"inputs holds {leaf!r:.40}, which is no number; give numbers.")

    def plain_one(x: Any) -> Any:
        plain = plain_array("inputs", np.asarray(x) if isinstance(x, np.memmap) else x)
        return within_integers(widen_short(plain))

    plain = jax.tree.map(plain_one, tree)
    return jax.tree.map(lambda x: jnp.asarray(x) if eqx.is_inexact_array_like(x) else x, plain)


def missing_in_words(problem: Problem, *, first: int = 0) -> str:
    """Name the first NaN among the arguments of `predict`, in words; empty if there is none.
    `first` is the index of the first row among all data.
    """
    given = {"inputs": problem.inputs} | problem.fixed | problem.records
    for path, leaf in jax.tree_util.tree_leaves_with_path(given):
        if not eqx.is_inexact_array(leaf) or not (missing := np.isnan(to_host(leaf))).any():
            continue
        at = np.argwhere(missing)[0]
        by_row = bool(at.size and problem.data.ndim) and len(missing) == len(problem.data)
        place = "".join(f"[{i + first * (by_row and not axis)}]" for axis, i in enumerate(at))
        name = f"{path[0].key}{jax.tree_util.keystr(path[1:])}"
        remedy = "leave that row out, of the data too" if by_row else "give a number"
        return f"{name}{place} is NaN; {remedy}."
    return ""


def placed(name: str, parameter: Parameter, records: Mapping[str, Any]) -> Parameter:
    """Return a parameter with its name, and shape and start of the number that it replaces."""
    known = None
    if is_path(name):
        known = np.asarray(read(records, name))
        if parameter.shape is not None and parameter.shape != known.shape:
            raise InputError(
                f"{name}: shape {parameter.shape} does not fit, the record's is {known.shape}."
            )
    parameter = replace(parameter, name=name)
    if known is not None:
        start = parameter.start
        usable = known > 0 if parameter.transform == "log" else np.isfinite(known)
        if start is None and (usable & np.isfinite(known)).all():
            with suppress(ValueError):  # bounds of another shape, which are refused elsewhere
                start = np.clip(known, parameter.lower, parameter.upper)
        return replace(parameter, shape=known.shape, start=start)
    start = parameter.start
    shape = parameter.shape
    if shape is None:
        shape = np.shape(start) if start is not None else np.shape(parameter.lower)
    return replace(parameter, shape=tuple(shape))


def arguments(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Return the arguments of a function by name."""
    if not callable(function):
        raise InputError(
            f"{function!r} is no function; give one whose arguments are named after what they are "
            "given."
        )
    return inspect.signature(function).parameters


def named_and_rest(
    function: Callable[..., Any],
) -> tuple[tuple[inspect.Parameter, ...], bool]:
    """Return the named arguments of a function, and whether it takes others as `**given`."""
    found = arguments(function).values()
    for argument in found:
        if argument.kind is argument.VAR_POSITIONAL:
            raise InputError(
                f"A function takes *{argument.name}: name each argument after what it is given, or "
                "take all by name, as **given."
            )
    several = any(argument.kind is argument.VAR_KEYWORD for argument in found)
    return tuple(a for a in found if a.kind is not a.VAR_KEYWORD), several


def argument_names(predict: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of the arguments of `predict`."""
    found = arguments(predict)
    for name, argument in found.items():
        if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            raise InputError(f"predict takes *{name}: name each argument after what it is given.")
    return tuple(found)


def placed_like(given: Any, values: np.ndarray) -> Array:
    """Put an array on the devices of another one, so that distributed data stay distributed."""
    if not isinstance(given, jax.Array):
        return jnp.asarray(values)
    # Not `device_put`, which compares the values of all processes.
    return jax.make_array_from_callback(values.shape, given.sharding, lambda part: values[part])


def check_names(problem: "Problem", parameters: Mapping[str, Any]) -> None:
    """Refuse names that conflict, and names of arguments and in likelihoods that do not exist."""
    if not problem.free:
        raise InputError("Nothing to fit: give at least one Parameter.")
    for name in (*problem.fixed, *problem.tied):
        if is_path(name):
            read(problem.records, name)
    paths = [name for name in parameters if is_path(name)]
    for outer in paths:
        for inner in paths:
            if inner.startswith((f"{outer}.", f"{outer}[")):
                raise InputError(f"{inner} is part of {outer}, a parameter too: name one of them.")
    clash = {*GIVEN} & {*parameters, *problem.records} or problem.records.keys() & parameters.keys()
    if clash:
        raise InputError(f"{sorted(clash)[0]!r} is taken: choose another name.")
    known = {*GIVEN, *problem.records, *(name for name in parameters if not is_path(name))}
    for argument in problem.asks:
        if argument not in known:
            raise InputError(
                f"predict asks for {argument!r}: its arguments are named after what they are "
                f"given, {', '.join(sorted(known))}."
            )
    free = {parameter.name for parameter in problem.free}
    terms = {candidate.name for candidate in problem.candidates}
    for candidate in problem.candidates:
        for name in candidate.requires:
            if name not in terms:
                why = "stays anyhow" if name in free else "is no candidate"
                raise InputError(f"{candidate.name}: requires {name!r}, which {why}.")
    if free == terms:
        raise InputError("Nothing but candidates: give at least one Parameter that stays.")
    lacking = [part for part in PARTS if not hasattr(problem.likelihood, part)]
    if lacking:
        raise InputError(
            f"{type(problem.likelihood).__name__} is no likelihood: it lacks {', '.join(lacking)}."
        )
    for name in names_within(problem.likelihood) - parameters.keys():
        if is_path(name) or name in problem.records:
            reach(problem.records, name)
            continue
        raise InputError(
            f"The likelihood names {name!r}: no such parameter; {nearest(name, parameters)}."
        )
