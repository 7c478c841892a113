"""Named parameters with units, bounds and priors, and their transformation to an unconstrained
vector.

A solver or a sampler works on a vector u in R^P, whereas a user works with numbers x that have
units. The transformation of one number has two steps. The first is to the scale of the parameter, v
= x (`identity`) or v = ln x (`log`). The second relates v with bounds a < v < b to u:

    v = u                            no bound
    v = a + exp(u)                   lower bound alone
    v = b - exp(-u)                  upper bound alone
    v = a + (b - a) / (1 + exp(-u))  both

A prior is a density p(x) of x in its own unit. A parameter without one has a flat prior in v within
its bounds. `log_prior` is the corresponding log density of u, ln p(x) + ln |dx/du|, so that the
mode, the Gaussian approximation and a chain all refer to the same posterior. The mode of a fit is
the maximum of the density of u.

A parameter that a fit does not need is not part of the space and is never traced. Natural values x
and unconstrained values u are vectors (..., P) in the order of the space.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import expit

from jaxvision.errors import InputError

from .given import plain_numbers
from .priors import Prior, support

Vector = Float[Array, "... parameters"]
Transform = Literal["identity", "log"]
Bound = float | tuple[Any, ...]
LEAST_PRIOR = 1e-9  # probability within the bounds, below which prior and bounds contradict
FLAT_QUANTILES = (np.arange(400) + 0.5) / 400  # probabilities whose quantiles give the spread


def _nested_tuples(value: Any) -> Any:
    """Return numbers as nested tuples, which can be part of a compile key."""
    if value is None:
        return None
    value = plain_numbers("a number of a Parameter", value)
    if value.ndim == 0:
        return float(value)
    return tuple(_nested_tuples(part) for part in np.asarray(value))


class Parameter(eqx.Module):
    """One number, or one array of numbers, to be estimated.

    Bounds apply in every solver and sampler.

    Attributes:
        name: name of the parameter, a word; a `Problem` takes it from its dictionary.
        symbol: letter of the parameter, with a subscript after `_`; the last part of the name by
            default.
        unit: unit of the value; "1" for none.
        transform: scale of the search: `identity` or `log` (positive values). On this scale the
            density is flat without a prior, and errors are Gaussian.
        lower: lower bound, in the unit of the value. For an array, give one bound for all numbers,
            or a tuple with one for each.
        upper: upper bound, in the same form as `lower`.
        prior: density of each value in its own unit (`Normal`, `LogNormal`, ...). For an array,
            give one prior for all numbers, or a tuple with one for each. None for a flat prior.
        shape: shape of the value; None takes the shape of `start`, or () without a start.
        start: value where a search begins, in its unit; None derives it from the bounds or the
            prior.
        linear: whether the prediction is linear in the parameter, as in an amplitude or a
            background. The search then solves for it in closed form at each value of the other
            parameters. It needs neither start nor bounds and adds no dimension to the search. This
            needs a likelihood of least squares (a Gaussian of known width) or one that starts from
            one (Student's t of known scale, `SensorNoise`). The only allowed bound is `lower=0`.

    Raises:
        InputError: for bounds that are not ascending or leave no mass of the prior, for a start
            that is not finite or outside the bounds, and for a linear parameter on a logarithmic
            scale or with other bounds.

    Example:
        >>> from fitting import Normal, Parameter
        >>> height = Parameter(unit="m", lower=0.0, prior=Normal(mean=2.0, sd=0.1))
    """

    name: str = eqx.field(static=True, default="")
    symbol: str = eqx.field(static=True, kw_only=True, default="")
    unit: str = eqx.field(static=True, kw_only=True, default="1")
    transform: Transform = eqx.field(static=True, kw_only=True, default="identity")
    lower: Bound = eqx.field(static=True, kw_only=True, default=-np.inf, converter=_nested_tuples)
    upper: Bound = eqx.field(static=True, kw_only=True, default=np.inf, converter=_nested_tuples)
    prior: Any = eqx.field(static=True, kw_only=True, default=None)
    shape: tuple[int, ...] | None = eqx.field(static=True, kw_only=True, default=None)
    start: Any = eqx.field(static=True, kw_only=True, default=None, converter=_nested_tuples)
    linear: bool = eqx.field(static=True, kw_only=True, default=False)

    def __check_init__(self) -> None:
        if fault := _fault(self):
            raise InputError(f"{self.name or 'Parameter'}: {fault}.")


def _fault(parameter: Parameter) -> str | None:
    """Return a sentence on a mistake in a parameter; None if there is no mistake."""
    logarithm, start = parameter.transform == "log", parameter.start
    given = (parameter.lower, parameter.upper, parameter.lower if start is None else start)
    try:
        lower, upper, begin = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in given))
    except ValueError:
        return "its bounds and start have different shapes: give one for all, or one each"
    if not (lower < upper).all():
        return f"lower {parameter.lower} is not below upper {parameter.upper}"
    if logarithm and not (upper > 0).all():
        return f"a log parameter is positive, upper is {parameter.upper}"
    if logarithm and ((lower < 0) & np.isfinite(lower)).any():
        return f"a log parameter is positive, lower is {parameter.lower}: give 0 or more"
    if start is not None and not np.isfinite(begin).all():
        return f"start is {start}: give finite numbers, or leave it out"
    if start is not None and ((begin < lower) | (begin > upper) | (logarithm & (begin <= 0))).any():
        ends = f"{parameter.lower} to {parameter.upper}"
        return f"start {start} lies outside its range, {ends}{' and positive' * logarithm}"
    least, most = np.asarray(parameter.lower, float), np.asarray(parameter.upper, float)
    if parameter.linear and (
        logarithm or np.isfinite(most).any() or not ((least == 0) | (least == -np.inf)).all()
    ):
        return "a linear parameter is free or at least 0: give no transform, no bound but lower=0"
    for prior in _objects(parameter.prior).ravel():
        if not (prior is None or isinstance(prior, Prior)):
            return f"{prior!r} is no prior: use Normal(...) or another"
        if prior is None:
            continue
        low, high = (float(prior.quantile(np.array(p))) for p in (LEAST_PRIOR, 1 - LEAST_PRIOR))
        if not ((lower < high) & (upper > low)).all():
            return f"{prior} leaves nothing within the bounds"
    return None


ParameterSpace = tuple[Parameter, ...]


def _objects(priors: Any) -> np.ndarray:
    """Return a prior, or nested tuples of priors, as an array of objects."""
    if not isinstance(priors, tuple):
        one = np.empty((), object)
        one[()] = priors
        return one
    return np.stack([_objects(prior) for prior in priors])


def names(space: ParameterSpace) -> tuple[str, ...]:
    """Return the parameters' names, in order."""
    return tuple(parameter.name for parameter in space)


def scalars(parameter: Parameter, shape: tuple[int, ...]) -> ParameterSpace:
    """Return the scalar parameters that make up an array parameter, in row-major order."""
    short = parameter.symbol or parameter.name.rpartition(".")[2]
    start = np.nan if parameter.start is None else np.asarray(parameter.start)
    each = parameter.lower, parameter.upper, _objects(parameter.prior), start
    try:
        lower, upper, priors, _ = (np.broadcast_to(part, shape) for part in each)
    except ValueError as error:
        raise InputError(
            f"{parameter.name}: its bounds, priors and start do not fit a value of shape {shape}: "
            "give one for all, or one each."
        ) from error
    found = []
    for index in np.ndindex(shape):
        tail = f"[{','.join(map(str, index))}]" if index else ""
        found.append(
            replace(
                parameter,
                name=parameter.name + tail,
                symbol=short + tail,
                lower=float(lower[index]),
                upper=float(upper[index]),
                prior=priors[index],
                shape=(),
                start=None,
            )
        )
    return tuple(found)


def ends(parameter: Parameter) -> tuple[float, float]:
    """Return the bounds of a scalar parameter and of its prior, in its unit."""
    lower, upper = float(np.asarray(parameter.lower)), float(np.asarray(parameter.upper))
    if parameter.prior is not None:
        low, high = support(parameter.prior)
        lower, upper = max(lower, low), min(upper, high)
    return (max(lower, 0.0) if parameter.transform == "log" else lower), upper


def scaled_ends(parameter: Parameter) -> tuple[float, float]:
    """Return the bounds of a scalar parameter on the scale of its transform."""
    lower, upper = ends(parameter)
    if parameter.transform == "identity":
        return lower, upper
    return (math.log(lower) if lower > 0 else -np.inf), math.log(upper)


def _natural(parameter: Parameter, v: Array) -> Array:
    """Return the natural value x at the scaled value v."""
    return v if parameter.transform == "identity" else numpy_or_jax(v).exp(v)


def numpy_or_jax(values: Any) -> Any:
    """Return NumPy for a NumPy array, for which nothing is compiled, else `jax.numpy`."""
    return np if isinstance(values, np.ndarray) else jnp


def _into_bounds(u: Array, a: float, b: float) -> Array:
    """Return the scaled value v at the unconstrained value u, with a < v < b."""
    xp, sigmoid = (np, expit) if isinstance(u, np.ndarray) else (jnp, jax.nn.sigmoid)
    match bool(np.isfinite(a)), bool(np.isfinite(b)):
        case True, True:
            return a + (b - a) * sigmoid(u)
        case True, False:
            return a + xp.exp(u)
        case False, True:
            return b - xp.exp(-u)
    return u


def _unbound(v: Array, a: float, b: float) -> Array:
    """Return the unconstrained value u at the scaled value v, with a < v < b."""
    xp = numpy_or_jax(v)
    match bool(np.isfinite(a)), bool(np.isfinite(b)):
        case True, True:
            return xp.log(v - a) - xp.log(b - v)
        case True, False:
            return xp.log(v - a)
        case False, True:
            return -xp.log(b - v)
    return v


def _log_slope(u: Array, a: float, b: float) -> Array | None:
    """Return ln dv/du; None for a parameter without bounds, where v = u."""
    xp = numpy_or_jax(u)
    match bool(np.isfinite(a)), bool(np.isfinite(b)):
        case True, True:
            return math.log(b - a) - xp.logaddexp(0 * u, -u) - xp.logaddexp(0 * u, u)
        case True, False:
            return u
        case False, True:
            return -u
    return None


def _bend(u: Array, a: float, b: float) -> Array:
    """Return v'' / v' with derivatives with respect to u, which is the slope of ln v'."""
    xp = numpy_or_jax(u)
    match bool(np.isfinite(a)), bool(np.isfinite(b)):
        case True, True:
            return -xp.tanh(u / 2)
        case True, False:
            return xp.ones_like(u)
        case False, True:
            return -xp.ones_like(u)
    return xp.zeros_like(u)


def _to_natural(space: ParameterSpace, unconstrained: Any) -> Any:
    def columns(parameter: Parameter, u: Any) -> Any:
        return _natural(parameter, _into_bounds(u, *scaled_ends(parameter)))

    return _map_kinds(space, unconstrained, columns)


def _to_unconstrained(space: ParameterSpace, natural: Any) -> Any:
    def columns(parameter: Parameter, x: Any) -> Any:
        v = x if parameter.transform == "identity" else numpy_or_jax(x).log(x)
        return _unbound(v, *scaled_ends(parameter))

    return _map_kinds(space, natural, columns)


@partial(jax.jit, static_argnums=0)
def to_natural(space: ParameterSpace, unconstrained: Vector) -> Vector:
    """Convert unconstrained values to values in the parameters' units."""
    return _to_natural(space, unconstrained)


@partial(jax.jit, static_argnums=0)
def to_unconstrained(space: ParameterSpace, natural: Vector) -> Vector:
    """Convert values in the parameters' units to unconstrained values."""
    return _to_unconstrained(space, natural)


def natural_numbers(
    space: ParameterSpace, unconstrained: Float[np.ndarray, "... parameters"]
) -> Float[np.ndarray, "... parameters"]:
    """Convert unconstrained values to natural ones in NumPy, without a compilation."""
    with np.errstate(all="ignore"):
        return _to_natural(space, unconstrained)


def unconstrained_numbers(
    space: ParameterSpace, natural: Float[np.ndarray, "... parameters"]
) -> Float[np.ndarray, "... parameters"]:
    """Convert natural values to unconstrained ones in NumPy."""
    with np.errstate(all="ignore"):
        return _to_unconstrained(space, natural)


def natural_slopes(space: ParameterSpace, unconstrained: Any) -> tuple[Any, Any]:
    """Return x' and x'' / x', derivatives with respect to the unconstrained values, (..., P)."""

    def slope_and_bend(parameter: Parameter, u: Any) -> tuple[Any, Any]:
        xp, (a, b) = numpy_or_jax(u), scaled_ends(parameter)
        log_slope, bend = _log_slope(u, a, b), _bend(u, a, b)
        slope = xp.ones_like(u) if log_slope is None else xp.exp(log_slope)
        if parameter.transform == "log":
            return slope * xp.exp(_into_bounds(u, a, b)), bend + slope
        return slope, bend

    slopes, bends = (
        _map_kinds(space, unconstrained, lambda parameter, u, i=i: slope_and_bend(parameter, u)[i])
        for i in (0, 1)
    )
    return slopes, bends


def log_flat_slopes(
    space: ParameterSpace, unconstrained: Any
) -> tuple[Float[Array, "... parameters"], Float[Array, "... parameters"]]:
    """Return the first and second derivatives of `log_prior` for parameters without priors."""

    def second(parameter: Parameter, u: Any) -> Any:
        bend = _bend(u, *scaled_ends(parameter))
        return (bend**2 - 1) / 2 if np.isfinite(scaled_ends(parameter)).all() else 0 * u

    first = _map_kinds(space, unconstrained, lambda p, u: _bend(u, *scaled_ends(p)))
    return first, _map_kinds(space, unconstrained, second)


@partial(jax.jit, static_argnums=0)
def to_scaled(space: ParameterSpace, unconstrained: Vector) -> tuple[Vector, Float[Array, "..."]]:
    """Return values on the scale of each number, and ln of the Jacobian determinant."""
    slopes = jnp.zeros(unconstrained.shape[:-1], unconstrained.dtype)
    for parameter, index in _kinds(space):
        slope = _log_slope(unconstrained[..., np.array(index)], *scaled_ends(parameter))
        slopes = slopes if slope is None else slopes + jnp.sum(slope, axis=-1)

    def columns(parameter: Parameter, u: Array) -> Array:
        return _into_bounds(u, *scaled_ends(parameter))

    return _map_kinds(space, unconstrained, columns), slopes


@partial(jax.jit, static_argnums=0)
def from_scaled(space: ParameterSpace, scaled: Vector) -> Vector:
    """Return unconstrained values from those on the scale of each number; NaN outside bounds."""

    def columns(parameter: Parameter, v: Array) -> Array:
        return _unbound(v, *scaled_ends(parameter))

    return _map_kinds(space, scaled, columns)


def log_prior(space: ParameterSpace, unconstrained: Vector) -> Float[Array, "..."]:
    """Return the log prior density of unconstrained values, up to a constant."""
    xp = numpy_or_jax(unconstrained)
    total = xp.zeros(unconstrained.shape[:-1], unconstrained.dtype)
    for parameter, index in _kinds(space):
        u = unconstrained[..., np.array(index)]
        a, b = scaled_ends(parameter)
        terms = [] if (slope := _log_slope(u, a, b)) is None else [slope]
        if parameter.prior is not None:
            v = _into_bounds(u, a, b)
            terms.append(parameter.prior.log_density(_natural(parameter, v)))
            if parameter.transform == "log":
                terms.append(v)
        for term in terms:
            total = total + xp.sum(term, axis=-1)
    return total


def prior_gaussian(space: ParameterSpace) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean and the standard deviation of each number on the unconstrained scale, from
    its prior or its bounds. The standard deviation of a number with neither is infinite."""
    known = [prior_values(parameter) for parameter in space]
    nothing = np.full(len(FLAT_QUANTILES), np.nan)
    table = np.stack([nothing if x is None else x for x in known], axis=-1)
    u = unconstrained_numbers(space, table)
    limited = np.array([x is not None for x in known])
    return np.where(limited, u.mean(0), 0.0), np.where(limited, u.std(0), np.inf)


def prior_values(parameter: Parameter) -> Float[np.ndarray, " quantiles"] | None:
    """Return evenly spaced quantiles of a scalar parameter's prior within its bounds, in its unit.
    Without a prior, the density is flat between the bounds; without prior and bounds, the result is
    None."""
    if (prior := parameter.prior) is not None:
        low, high = (share_below(prior, end) for end in ends(parameter))
        return np.asarray(prior.quantile(low + (high - low) * FLAT_QUANTILES))
    a, b = scaled_ends(parameter)
    if not np.isfinite([a, b]).all():
        return None
    v = a + (b - a) * FLAT_QUANTILES
    return v if parameter.transform == "identity" else np.exp(v)


def share_below(prior: Prior, x: float) -> float:
    """Return the prior probability below x, found by bisection of the quantile function."""
    low, high = 0.0, 1.0
    while high - low > LEAST_PRIOR / 1e6:
        middle = (low + high) / 2
        low, high = (middle, high) if prior.quantile(np.array(middle)) < x else (low, middle)
    return low


Kind = tuple[Parameter, list[int]]


def _kinds(space: ParameterSpace) -> list[Kind]:
    """Group the indices of scalars with equal transformation and prior."""
    found: dict[Any, Kind] = {}
    for i, parameter in enumerate(space):
        key = (parameter.transform, *ends(parameter), parameter.prior)
        found.setdefault(key, (parameter, []))[1].append(i)
    return list(found.values())


def _map_kinds(
    space: ParameterSpace, values: Array, columns: Callable[[Parameter, Array], Array]
) -> Array:
    kinds = _kinds(space)
    parts = [columns(parameter, values[..., np.array(index)]) for parameter, index in kinds]
    order = np.argsort(np.concatenate([index for _, index in kinds]))
    return numpy_or_jax(values).concatenate(parts, axis=-1)[..., order]
