"""Named parameters with units, bounds and priors, and their map to an unconstrained vector.

A solver or a sampler moves freely in R^P; a reader wants numbers with units. `Parameter` says how
one number goes across: `identity` (any real), `log` (positive), `logit` (between its bounds).
A parameter that a fit does not need is left out of the space: it is then never traced.
Natural and unconstrained values are vectors (..., P) in the order of the space.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Vector = Float[Array, "... parameters"]
Transform = Literal["identity", "log", "logit"]


class Parameter(eqx.Module):
    """One scalar to be estimated.

    Without a prior it is flat on the unconstrained scale.

    Attributes:
        name: a word.
        symbol: its letter, with a subscript behind `_`.
        unit: of the natural value; "1" for none.
        transform: how the natural value becomes unconstrained: `identity` (any real), `log`
            (positive) or `logit` (between its bounds, which are then finite).
        lower: bound of the natural value; bounded searches use it for every transform.
        upper: the other bound.
        prior_mean: of a Gaussian prior on the unconstrained scale (a `log` parameter has a
            log-normal one).
        prior_sd: its standard deviation; None for no prior.

    Raises:
        ValueError: for bounds that are not ascending, and a prior_sd that is not positive.
    """

    name: str = eqx.field(static=True)
    symbol: str = eqx.field(static=True, kw_only=True)
    unit: str = eqx.field(static=True, kw_only=True)
    transform: Transform = eqx.field(static=True, kw_only=True, default="identity")
    lower: float = eqx.field(static=True, kw_only=True, default=-np.inf)
    upper: float = eqx.field(static=True, kw_only=True, default=np.inf)
    prior_mean: float = eqx.field(static=True, kw_only=True, default=0.0)
    prior_sd: float | None = eqx.field(static=True, kw_only=True, default=None)

    def __check_init__(self) -> None:
        if not self.lower < self.upper:
            raise ValueError(f"{self.name}: lower {self.lower} is not below upper {self.upper}.")
        if self.transform == "logit" and not np.isfinite([self.lower, self.upper]).all():
            raise ValueError(f"{self.name}: a logit parameter needs two finite bounds.")
        if self.prior_sd is not None and not self.prior_sd > 0:
            raise ValueError(f"{self.name}: prior_sd must be positive, got {self.prior_sd}.")


ParameterSpace = tuple[Parameter, ...]


def names(space: ParameterSpace) -> tuple[str, ...]:
    """The parameters' names, in order."""
    return tuple(parameter.name for parameter in space)


def _to_natural(parameter: Parameter, x: Array) -> Array:
    match parameter.transform:
        case "identity":
            return x
        case "log":
            return jnp.exp(x)
        case "logit":
            return parameter.lower + (parameter.upper - parameter.lower) * jax.nn.sigmoid(x)


def _to_unconstrained(parameter: Parameter, value: Array) -> Array:
    match parameter.transform:
        case "identity":
            return value
        case "log":
            return jnp.log(value)
        case "logit":
            below, above = value - parameter.lower, parameter.upper - value
            return jnp.log(below) - jnp.log(above)


def to_natural(space: ParameterSpace, unconstrained: Vector) -> Vector:
    """Unconstrained values to values in the parameters' own units.

    Args:
        space: the P parameters.
        unconstrained: (..., P).

    Returns:
        (..., P).

    Example:
        >>> from fitting.inference.parameters import Parameter, to_natural
        >>> space = (Parameter("gain", symbol="K", unit="DN/e-", transform="log"),)
        >>> round(float(to_natural(space, jnp.array([0.0]))[0]), 3)
        1.0
    """
    columns = [_to_natural(p, unconstrained[..., i]) for i, p in enumerate(space)]
    return jnp.stack(columns, axis=-1)


def to_unconstrained(space: ParameterSpace, natural: Vector) -> Vector:
    """Inverse of `to_natural`.

    Args:
        space: the P parameters.
        natural: (..., P); a `log` value must be positive, a `logit` one inside its bounds.

    Returns:
        (..., P).
    """
    columns = [_to_unconstrained(p, natural[..., i]) for i, p in enumerate(space)]
    return jnp.stack(columns, axis=-1)


def log_prior(space: ParameterSpace, unconstrained: Vector) -> Float[Array, "..."]:
    """Log prior density on the unconstrained scale, up to a constant.

    Args:
        space: the P parameters; those without a prior add nothing and are not traced.
        unconstrained: (..., P).

    Returns:
        (...).
    """
    total = jnp.zeros(unconstrained.shape[:-1], unconstrained.dtype)
    for i, parameter in enumerate(space):
        if parameter.prior_sd is not None:
            z = (unconstrained[..., i] - parameter.prior_mean) / parameter.prior_sd
            total = total - z * z / 2
    return total
