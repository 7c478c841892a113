"""Make odd arguments for public functions: calls of `examples/` in which one argument, or one field
of a record, has another value, form or size."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

# values in place of a number, in all of an array or in one element
NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 255.0, 1e-45, 1e-30, 1e-8, 1e8)
NUMBERS += (1e19, 1e30, -1e30, 3e38, 1e-38, 1 + 1e-7, 1e300, 1e-300)


def _number(x, rng):
    return np.full_like(x, NUMBERS[rng.integers(len(NUMBERS))])


def _one_number(x, rng):
    x = x.copy()
    if x.size:
        x.reshape(-1)[rng.integers(x.size)] = NUMBERS[rng.integers(len(NUMBERS))]
    return x


def _scaled(x, rng):
    return x * 10.0 ** rng.uniform(-30, 30)


def _repeated(x, rng):
    return np.stack([x] * rng.integers(1, 4), axis=rng.integers(-1, 1))


def _shorter(x, rng):
    return x[: rng.integers(len(x) + 1)] if x.ndim else x


def _first(x, rng):
    return x.reshape(-1)[0] if x.size else x


def _transposed(x, rng):
    return x.T


def _empty(x, rng):
    return x[:0] if x.ndim else x[None][:0]


VALUES = (_number, _one_number, _one_number, _scaled)
SHAPES = (_repeated, _shorter, _first, _transposed, _empty)
FORMS: tuple[Callable[[np.ndarray], Any], ...] = (
    lambda x: x.tolist(),
    lambda x: x,
    lambda x: np.round(x).astype(int),
    lambda x: np.round(x).astype(int).tolist(),
    lambda x: x.astype(np.float32),
    lambda x: jnp.asarray(x, jnp.float32),
    lambda x: jnp.asarray(x, jnp.float16),
    lambda x: x > 0,
    lambda x: "one",
    lambda x: None,
    lambda x: {"x": x},
    lambda x: [x, [x]],
)


def is_number(x):
    return isinstance(x, jax.Array | np.ndarray) and jnp.issubdtype(x.dtype, jnp.floating)


def places(tree):
    """Return the paths of all floating-point arrays of a call."""
    return [path for path, leaf in jax.tree.leaves_with_path(tree) if is_number(leaf)]


def at(tree, path):
    for step in path:
        tree = _step(tree, step)
    return tree


def _step(tree, step):
    match step:
        case jax.tree_util.GetAttrKey(name):
            return getattr(tree, name)
        case jax.tree_util.SequenceKey(index):
            return tree[index]
        case jax.tree_util.DictKey(key):
            return tree[key]
    raise TypeError(step)


def with_at(tree, path, value):
    """Return a tree with one leaf replaced. Records are constructed again, so that they check
    it."""
    if not path:
        return value
    step, rest = path[0], path[1:]
    inner = with_at(_step(tree, step), rest, value)
    match step:
        case jax.tree_util.GetAttrKey(name):
            if isinstance(tree, eqx.Module) or dataclasses.is_dataclass(tree):
                return dataclasses.replace(tree, **{name: inner})
            return tree._replace(**{name: inner})
        case jax.tree_util.SequenceKey(index):
            changed = [inner if i == index else part for i, part in enumerate(tree)]
            return type(tree)(*changed) if hasattr(tree, "_fields") else type(tree)(changed)
        case jax.tree_util.DictKey(key):
            return {**tree, key: inner}
    raise TypeError(step)


def odd_call(arguments, number, seed):
    """Return (arguments, path, new value) of a call with one of its arrays changed."""
    rng = np.random.default_rng([seed, number])
    known = places(arguments)
    path = known[rng.integers(len(known))]
    value = np.asarray(at(arguments, path), np.float64)
    holder = at(arguments, path[:-1])
    checks = len(path) == 1 or hasattr(holder, "__check_init__")
    with np.errstate(all="ignore"):
        if rng.uniform() < 0.6 or not checks:
            value = VALUES[rng.integers(len(VALUES))](value, rng)
            form = jnp.asarray
        else:
            if rng.uniform() < 0.6:
                value = SHAPES[rng.integers(len(SHAPES))](value, rng)
            form = FORMS[rng.integers(len(FORMS))] if rng.uniform() < 0.6 else jnp.asarray
        value = form(value)
    return path, value
