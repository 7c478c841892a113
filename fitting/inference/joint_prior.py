"""Use the posterior of one fit as the prior of another: the density of each number, and their
correlations.

On the unconstrained scale u of the first fit, the posterior density of each number is Gaussian or
Student's t, with scale s about m. It becomes the prior of one parameter of the other fit. Let F be
the distribution function of (u - m) / s, Phi that of N(0, 1), and R the matrix of correlations.
Then z = Phi^-1(F((u - m) / s)) is N(0, R), and the joint density is the product of the marginal
densities times

    exp(-z^T (R^-1 - I) z / 2).

With infinite degrees of freedom the joint density is the Gaussian N(m, s R s). The density refers
to each parameter in its own unit, so that the other fit may search on another scale.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import betainc
from jax.scipy.special import ndtri as gaussian_quantile
from jaxtyping import Array, Float
from scipy.special import ndtri, stdtrit

from jaxvision.errors import InputError, nearest

from .diagnostics import listed
from .parameters import (
    Parameter,
    ParameterSpace,
    ends,
    log_prior,
    natural_numbers,
    to_natural,
    to_unconstrained,
    unconstrained_numbers,
)
from .posterior import Posterior
from .priors import HALF_LOG_2PI

SIGMAS = 1.96  # standard deviations at which draws are compared with a Gaussian
END_TOLERANCE = 0.2  # standard deviations by which the draws' ends may differ from a Gaussian's
SIGMA_ERROR = 2.67  # times 1 / sqrt(draws): the standard error of the quantile at SIGMAS
ERROR_FACTOR = 2.0  # multiple of that error by which draws of a true Gaussian may differ
FAR_FROM_0 = 3.0  # standard deviations from 0 of a positive number treated on a log scale
CONSTANT = 1e-12  # relative spread of draws below which a number counts as constant


@dataclass(frozen=True)
class Marginal:
    """The prior density of one number, taken from an earlier fit's estimate.

    Attributes:
        centre: centre on the unconstrained scale.
        sd: scale of the density on the unconstrained scale.
        freedom: degrees of freedom of Student's t; infinite for a Gaussian.
        number: the number's transform and bounds, which define the unconstrained scale.
    """

    centre: float
    sd: float
    freedom: float
    number: Parameter

    def log_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return ln p(x), -inf outside the bounds."""
        lower, upper = ends(self.number)
        there = (x > lower) & (x < upper)
        inside = float(natural_numbers((self.number,), np.array([self.centre]))[0])
        u = to_unconstrained((self.number,), jnp.where(there, x, inside)[..., None])
        t = (u[..., 0] - self.centre) / self.sd
        if math.isinf(self.freedom):
            shape = -(t**2) / 2 - HALF_LOG_2PI
        else:
            half = self.freedom / 2
            norm = math.lgamma(half + 0.5) - math.lgamma(half) - math.log(math.pi * 2 * half) / 2
            shape = norm - (half + 0.5) * jnp.log1p(t**2 / self.freedom)
        slope = log_prior((self.number,), u)
        if self.number.transform == "log":
            slope = slope + jnp.log(jnp.where(there, x, inside))
        return jnp.where(there, shape - math.log(self.sd) - slope, -jnp.inf)

    def quantile(self, p: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the values with the cumulative probabilities p."""
        steps = ndtri(p)
        if not math.isinf(self.freedom):  # at the ends `stdtrit` has no sign
            steps = np.where(np.isinf(steps), steps, stdtrit(self.freedom, p))
        u = self.centre + self.sd * np.asarray(steps)
        return natural_numbers((self.number,), u[..., None])[..., 0]

    def score(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return x transformed to the scale on which the prior is N(0, 1)."""
        u = to_unconstrained((self.number,), jnp.asarray(x)[..., None])[..., 0]
        t = (u - self.centre) / self.sd
        return t if math.isinf(self.freedom) else _gaussian_score(self.freedom, t)


@jax.custom_jvp
def _gaussian_score(freedom: Any, t: Array) -> Array:
    """Return Phi^-1(F(t)), with F the distribution function of Student's t."""
    size = jnp.finfo(t.dtype)
    beyond = betainc(freedom / 2, jnp.asarray(0.5, t.dtype), freedom / (freedom + t**2)) / 2
    return -jnp.sign(t) * gaussian_quantile(jnp.maximum(beyond, size.tiny))


@_gaussian_score.defjvp
def _(primals: tuple[Any, Array], tangents: tuple[Any, Array]) -> tuple[Array, Array]:
    """Return the score and its tangent. The derivative is the ratio of the two densities, because
    `betainc` has no derivative at 0.
    """
    freedom, t = primals
    half, z = freedom / 2, _gaussian_score(freedom, t)
    norm = math.lgamma(half + 0.5) - math.lgamma(half) - math.log(math.pi * freedom) / 2
    log_slope = norm - (half + 0.5) * jnp.log1p(t**2 / freedom) + z**2 / 2 + HALF_LOG_2PI
    return z, jnp.exp(log_slope) * tangents[1]


class JointPrior(eqx.Module):
    """A joint prior for several parameters, with their correlations, from an earlier fit or from
    draws.

    `Fit.as_prior` and `as_prior` make one; `Problem(..., prior=...)` takes it.

    Attributes:
        names: names of the parameters.
        shapes: shape of each parameter; () for a number.
        marginals: marginal prior of each number of each parameter, arrays in row-major order.
        correlation: (numbers, numbers) correlations after each number is transformed to N(0, 1).
        coupling: (numbers, numbers) identity minus the inverse correlation; None until a problem
            uses the prior.
        required: names that must be free parameters of the problem.
        words: sentences for the findings of the new fit.

    Example:
        >>> from fitting import as_prior
        >>> first, other = np.random.default_rng(0).standard_normal((2, 500))
        >>> prior = as_prior({"x": first, "y": first + other}, ["x", "y"])
        >>> round(float(prior.correlation[0, 1]), 1)  # 1 / sqrt(2)
        0.7
    """

    names: tuple[str, ...] = eqx.field(static=True)
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    marginals: tuple[Marginal, ...] = eqx.field(static=True)
    correlation: Float[np.ndarray, "numbers numbers"]
    coupling: Float[Array, "numbers numbers"] | None = None
    required: tuple[str, ...] = eqx.field(static=True, default=())
    words: tuple[str, ...] = eqx.field(static=True, default=())


Selection = str | Sequence[str] | Mapping[str, str]


def select_names(
    selection: Selection, known: Sequence[str]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the new name of each selected name, and the new names that were given without `*`."""
    if isinstance(selection, str):
        selection = (selection,)
    pairs = (
        selection.items() if isinstance(selection, Mapping) else ((one, one) for one in selection)
    )
    found: dict[str, str] = {}
    required = []
    for old, new in pairs:
        if not (isinstance(old, str) and isinstance(new, str)):
            raise InputError(f"as_prior: {old!r} is no name of a parameter; give text.")
        if old in known:
            found[old] = new
            required.append(new)
            continue
        matching = [name for name in known if fnmatchcase(name, old.replace("[", "[[]"))]
        if not matching:
            raise InputError(
                f"as_prior: no parameter {old!r} was estimated; {nearest(old, known)}."
            )
        if old != new and not (old.count("*") == new.count("*") == 1):
            raise InputError(
                f"as_prior: {old!r} cannot be renamed to {new!r}; give one * in both, or names."
            )
        head, _, tail = old.partition("*")
        begin, _, end = new.partition("*")
        for name in matching:
            found[name] = begin + name[len(head) : len(name) - len(tail)] + end
    if len({*found.values()}) < len(found):
        raise InputError("as_prior: two parameters get the same name; give each its own.")
    return found, tuple(required)


def posterior_prior(
    posterior: Posterior,
    shapes: Mapping[str, tuple[int, ...]],
    selection: Selection,
    *,
    words: tuple[str, ...] = (),
) -> JointPrior:
    """Return a posterior as a prior for another problem."""
    renamed, required = select_names(selection, list(shapes))
    sizes = [int(np.prod(shape)) for shape in shapes.values()]
    parts = np.split(np.arange(len(posterior.space)), np.cumsum(sizes)[:-1])
    places = dict(zip(shapes, parts, strict=True))
    index = np.concatenate([places[name] for name in renamed])
    space = tuple(posterior.space[i] for i in index)
    freedom = None if posterior.freedom is None else posterior.freedom[index]
    if posterior.method == "Laplace":
        if name := posterior.missed or posterior.endless:
            raise InputError(
                f"as_prior: the posterior of {name} is far from a Gaussian, which a prior of "
                "another fit must be; fit the data of both in one problem, or take more data."
            )
        centre, spread = posterior.unconstrained_mode[index], posterior.covariance
        spread = spread[np.ix_(index, index)]
    else:
        vectors = unconstrained_numbers(space, posterior.samples[:, index])
        count = posterior.effective
        if posterior.tau is not None:
            count = len(vectors) / float(np.max(posterior.tau))
        _refuse_odd_draws(space, vectors, count if np.isfinite(count) else len(vectors))
        centre, spread = vectors.mean(axis=0), np.cov(vectors.T).reshape(len(index), -1)
    kept = tuple(shapes[name] for name in renamed)
    named = tuple(renamed.values())
    return _prior(named, kept, space, (centre, spread, freedom), required, words)


def as_prior(draws: Mapping[str, Any], names: Selection) -> JointPrior:
    """Make a prior from draws of numbers, such as those of a calibrated camera.

    If the draws of a number are all positive and far from 0, the prior is Gaussian in its
    logarithm, otherwise in the number itself. Numbers that do not vary are left out.

    Args:
        draws: draws by name, of an array or of a record such as a `Sensor`, each number with a
            leading axis of draws, as `jaxvision.read_sensor("sensor.toml", draws=500)` returns it.
            The numbers of a record are named by their paths, "sensor.gain".
        names: a name, a pattern such as "sensor.*", several of them, or new names by old ones.

    Returns:
        The prior, for `Problem(..., prior=...)`.

    Raises:
        InputError: for a name that matches no varying number, for at least as many numbers as
            draws, and for draws that are not Gaussian.

    Example:
        >>> from fitting import Gaussian, Parameter, Problem, as_prior, fit
        >>> m = np.random.default_rng(0).normal(2.0, 0.1, 500)
        >>> like, free = Gaussian(sd=0.1), {"m": Parameter()}
        >>> prior = as_prior({"m": m}, "m")
        >>> found = fit(Problem(free, lambda m: m * jnp.ones(1), like, [2.2], prior=prior))
        >>> round(float(found.values["m"]), 2)
        2.1
    """
    every: dict[str, np.ndarray] = {}
    for name, tree in draws.items():
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
            values = np.asarray(leaf, np.float64)
            if values.ndim and np.all(np.ptp(values, axis=0) > CONSTANT * np.abs(values[0])):
                every[name + jax.tree_util.keystr(path)] = values
    if not every:
        raise InputError("as_prior: none of the numbers varies from draw to draw; give draws.")
    renamed, required = select_names(names, list(every))
    space, columns = [], []
    for name in renamed:
        for column in every[name].reshape(len(every[name]), -1).T:
            positive = column.min() > 0 and column.mean() > FAR_FROM_0 * column.std()
            space.append(Parameter(name, transform="log" if positive else "identity"))
            columns.append(np.log(column) if positive else column)
    if len({len(column) for column in columns}) > 1:
        raise InputError("as_prior: some numbers have more draws than others; give as many of all.")
    vectors = np.stack(columns, axis=-1)
    centre, spread = vectors.mean(axis=0), np.cov(vectors.T).reshape(len(space), -1)
    _refuse_dependent(tuple(renamed.values()), spread)
    _refuse_odd_draws(tuple(space), vectors, len(vectors))
    shapes = tuple(every[name].shape[1:] for name in renamed)
    return _prior(
        *(tuple(renamed.values()), shapes, tuple(space), (centre, spread, None)), required, ()
    )


def _refuse_dependent(named: tuple[str, ...], spread: np.ndarray) -> None:
    """Refuse numbers whose correlation matrix is singular to rounding."""
    deviation = np.sqrt(np.diagonal(spread))
    correlation = spread / np.outer(deviation, deviation)
    if not np.linalg.eigvalsh(correlation)[0] > 1e-12:
        raise InputError(
            f"as_prior: {listed(list(named))} determine each other, so that their joint density "
            "has no width; name fewer of them, or give more draws."
        )


def _prior(
    named: tuple[str, ...],
    shapes: tuple[tuple[int, ...], ...],
    space: ParameterSpace,
    density: tuple[np.ndarray, np.ndarray, np.ndarray | None],
    required: tuple[str, ...],
    words: tuple[str, ...],
) -> JointPrior:
    centre, spread, freedom = density
    _refuse_dependent(named, spread)
    freedom = np.full(len(space), np.inf) if freedom is None else freedom
    deviation = np.sqrt(np.diagonal(spread))
    marginals = []
    for parameter, m, sd, nu in zip(space, centre, deviation, freedom, strict=True):
        lower, upper = ends(parameter)
        scale = Parameter(transform=parameter.transform, lower=lower, upper=upper)
        marginals.append(Marginal(float(m), float(sd), float(nu), scale))
    correlation = spread / np.outer(deviation, deviation)
    own = tuple(marginals)
    return JointPrior(named, shapes, own, correlation, required=required, words=words)


def _refuse_odd_draws(space: ParameterSpace, vectors: np.ndarray, count: float) -> None:
    """Refuse draws that are not Gaussian. The ends of their central 95 % are compared with a
    Gaussian's, for each number and along each principal axis.
    """
    z = (vectors - vectors.mean(axis=0)) / vectors.std(axis=0)
    _, axes = np.linalg.eigh(np.corrcoef(z.T).reshape(len(space), -1))
    along = z @ axes
    every = np.concatenate([z, along / along.std(axis=0)], axis=-1)
    found = np.quantile(every, (0.025, 0.975), axis=0)
    off = np.max(np.abs(found - np.array([[-SIGMAS], [SIGMAS]])), axis=0)
    worst = int(np.argmax(off))
    if off[worst] <= END_TOLERANCE + ERROR_FACTOR * SIGMA_ERROR / math.sqrt(count):
        return
    name = space[worst % len(space)].name
    if worst >= len(space):
        weights = axes[:, worst - len(space)] ** 2
        name = listed([space[i].name for i in np.flatnonzero(weights > 0.5 / len(space))])
    low, high = found[:, worst]
    raise InputError(
        f"as_prior: the posterior of {name} is not Gaussian: 95 % of its draws lie from "
        f"{low:.2f} to {high:.2f} standard deviations about their mean, a Gaussian's from "
        f"{-SIGMAS} to {SIGMAS}; fit the data of both in one problem, or take more data."
    )


def apply_joint_prior(
    free: tuple[Parameter, ...], prior: JointPrior
) -> tuple[tuple[Parameter, ...], JointPrior]:
    """Return the free parameters with the marginals of a joint prior as their priors, and the joint
    prior restricted to these parameters."""
    by_name = {parameter.name: parameter for parameter in free}
    for name in prior.required:
        if name not in by_name:
            raise InputError(
                f"prior: {name!r} is no free parameter of this problem; {nearest(name, by_name)}."
            )
    own = restrict(prior, by_name)
    if own is None:
        raise InputError(
            f"prior: none of {', '.join(prior.names)} is a free parameter of this problem; rename "
            f"them, as_prior({{'old': 'new'}}), to some of {', '.join(by_name)}."
        )
    begin = 0
    for name, shape in zip(own.names, own.shapes, strict=True):
        if by_name[name].shape != shape:
            raise InputError(
                f"prior: {name} has the shape {shape} there and {by_name[name].shape} in this "
                "problem; give both the same."
            )
        size = math.prod(shape)
        each = _nested_tuples(own.marginals[begin : begin + size], shape)
        by_name[name] = replace(by_name[name], prior=each)
        begin += size
    return tuple(by_name.values()), own


def restrict(prior: JointPrior, kept: Collection[str]) -> JointPrior | None:
    """Keep the numbers of the given names and marginalise a prior over all others; None if none
    remains."""
    sizes = [math.prod(shape) for shape in prior.shapes]
    chosen = np.flatnonzero(np.repeat([name in kept for name in prior.names], sizes))
    if not chosen.size:
        return None
    pairs = [pair for pair in zip(prior.names, prior.shapes, strict=True) if pair[0] in kept]
    correlation = prior.correlation[np.ix_(chosen, chosen)]
    return JointPrior(
        names=tuple(name for name, _ in pairs),
        shapes=tuple(shape for _, shape in pairs),
        marginals=tuple(prior.marginals[i] for i in chosen),
        correlation=correlation,
        coupling=jnp.asarray(np.eye(len(chosen)) - np.linalg.inv(correlation)),
        words=prior.words,
    )


def _nested_tuples(flat: tuple[Marginal, ...], shape: tuple[int, ...]) -> Any:
    """Return an array's elements as nested tuples, which can be part of a compile key."""
    if not shape:
        return flat[0]
    size = math.prod(shape[1:])
    parts = (flat[i * size : (i + 1) * size] for i in range(shape[0]))
    return tuple(_nested_tuples(part, shape[1:]) for part in parts)


def places_of(prior: JointPrior, space: ParameterSpace) -> np.ndarray:
    """Return the indices of a prior's numbers in a parameter space."""
    order = {parameter.name: i for i, parameter in enumerate(space)}
    found = []
    for name, shape in zip(prior.names, prior.shapes, strict=True):
        for index in np.ndindex(shape):
            found.append(order[name + (f"[{','.join(map(str, index))}]" if index else "")])
    return np.array(found)


def scores(prior: JointPrior, space: ParameterSpace, vectors: Array) -> Float[Array, "... numbers"]:
    """Transform a prior's numbers in vectors to the scale on which each is N(0, 1)."""
    natural = to_natural(space, vectors)[..., places_of(prior, space)]
    places = [one.score(natural[..., i]) for i, one in enumerate(prior.marginals)]
    return jnp.stack(places, axis=-1)


def log_dependence(prior: JointPrior, space: ParameterSpace, vectors: Array) -> Float[Array, "..."]:
    """Return the contribution of the correlations to the log prior density, up to a constant."""
    assert prior.coupling is not None
    z = scores(prior, space, vectors)
    return jnp.sum((z @ prior.coupling.astype(z.dtype)) * z, axis=-1) / 2
