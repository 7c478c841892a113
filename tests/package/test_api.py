"""Tests the whole public API, which is discovered and not listed: eager equals jit, vmap equals a
loop, and gradients are finite and equal directional finite differences.

A new public function of numbers needs one entry in `examples/`, without which a test fails."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from examples import ROOMS, examples_of
from public_names import LONG, traced


def every_example():
    return {name: call for room in ROOMS for name, call in examples_of(room).items()}


def test_every_public_function_has_an_example():
    assert every_example().keys() == traced().keys() >= LONG


def is_float(leaf):
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)


def direction(x):
    """Return a fixed direction of change, proportional to each number."""
    x = np.asarray(x)
    return x * np.cos(np.arange(x.size, dtype=x.dtype)).reshape(x.shape)


def shifted(tree, step):
    """Return a tree with every number moved by `step` along `direction`."""
    return jax.tree.map(lambda x: np.asarray(x) + step * direction(x) if is_float(x) else x, tree)


def stacked(*leaves):
    """Stack leaves in NumPy, which compiles nothing, except random keys."""
    return (jnp if jnp.issubdtype(leaves[0].dtype, jax.dtypes.prng_key) else np).stack(leaves)


def total(tree):
    """Return the sum of all numbers in a result."""
    return sum((x.sum() for x in jax.tree.leaves(tree) if is_float(x)), jnp.zeros(()))


def close(a, b, rtol):
    def compare(x, y):
        np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol * (1e-30 + np.abs(y).max(initial=0)))

    jax.tree.map(compare, a, b)


STEP = 1e-6


def points(arguments):
    """Return a call's arguments, stacked with the same at another point, a step ahead and a step
    behind."""
    moved = (shifted(arguments, step) for step in (0, 1e-3, STEP, -STEP))
    return jax.tree.map(stacked, *moved)


def measured(function, batch):
    """Return (value, gradient) of `function` at each of the points, in one program."""
    leaves, structure = jax.tree.flatten(batch)
    numbers = [i for i, x in enumerate(leaves) if is_float(x)]

    def summed(values, whole):
        whole = list(whole)
        for i, value in zip(numbers, values, strict=True):
            whole[i] = value
        result = function(*jax.tree.unflatten(structure, whole))
        return total(result), result

    def one(whole):
        gradient, value = jax.grad(summed, has_aux=True)([whole[i] for i in numbers], whole)
        return value, gradient

    return jax.vmap(one)(leaves)


def lane(tree, i):
    return jax.tree.map(lambda x: np.asarray(x[i]), tree)


def compare(function, batch, lanes):
    """Check one function: two lanes of its program equal plain calls without compilation, and the
    gradient of the first equals the difference of the two others."""
    structure = jax.tree.structure(batch)
    for i in (0, 1):
        alone = jax.tree.unflatten(structure, [jnp.asarray(x[i]) for x in jax.tree.leaves(batch)])
        close(lane(lanes[0], i), function(*alone), 1e-12)
        assert all(np.isfinite(g).all() for g in lane(lanes[1], i)), "a gradient is not finite"

    above, below = float(total(lane(lanes[0], 2))), float(total(lane(lanes[0], 3)))
    numbers = [x[0] for x in jax.tree.leaves(batch) if is_float(x)]
    pairs = zip(lane(lanes[1], 0), numbers, strict=True)
    slope = sum(float(np.vdot(g, direction(x))) for g, x in pairs)
    difference = (above - below) / (2 * STEP)
    # central difference: truncation error h^2, and rounding error eps / h of the value
    tolerance = 1e-6 * abs(slope) + 1e-8 * abs(above) + 1e-12
    assert abs(difference - slope) <= tolerance, f"finite difference {difference}, slope {slope}"


def faults(calls):
    """Return the faults of each function by name."""
    known, wrong = traced(), {}
    for name, (arguments, options) in calls.items():
        function = partial(known[name], **options)
        try:
            batch = points(arguments)
            compare(function, batch, jax.jit(partial(measured, function))(batch))
        except Exception as error:
            wrong[name] = error
    return wrong


def report(wrong):
    return "\n".join(f"{name}: {type(e).__name__}: {e}" for name, e in wrong.items())


STRIDE = 20  # the default run tests one in twenty functions of a module


def swept(room, *, stride=1):
    calls = {n: call for n, call in examples_of(room).items() if n not in LONG}
    return {n: calls[n] for n in sorted(calls)[::stride]}


@pytest.mark.sweep
@pytest.mark.parametrize("room", ROOMS)
def test_eager_jit_vmap_loop_and_gradient(room):
    wrong = faults(swept(room, stride=STRIDE))
    assert not wrong, report(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("room", ROOMS)
def test_eager_jit_vmap_loop_and_gradient_of_all(room):
    wrong = faults(swept(room))
    assert not wrong, report(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LONG))
def test_eager_jit_vmap_loop_and_gradient_of_compositions(name):
    wrong = faults({name: every_example()[name]})
    assert not wrong, report(wrong)
