"""Tests that how values are stored and ordered changes no value and no derivative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.core._loops.fusion import fuse, run_search

X, Y = jnp.linspace(0.1, 1.3, 6), jnp.linspace(2.0, -1.0, 6)


def plain(x, y):
    """Return four values that depend on both numbers, including integers and flags."""
    return {
        "product": x * y,
        "above": x > y,
        "count": jnp.floor(8 * x).astype(jnp.int32),
        "alone": jnp.cos(y),
    }


def staged(x, y):
    return fuse(plain(x, y))


def total(function):
    """Return a scalar that uses three of the four values, so that one cotangent is zero by
    structure."""

    def sums(x, y):
        values = function(x, y)
        return jnp.sum(values["product"] ** 2 + values["alone"] * values["count"].astype(float))

    return sums


def assert_same(got, expected):
    assert jax.tree.structure(got) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        if one.dtype == jax.dtypes.float0:
            continue
        # compiled code may fuse a multiplication and an addition, and do nothing else
        rounding = 4 * float(jnp.finfo(one.dtype).eps) if one.dtype.kind == "f" else 0
        np.testing.assert_allclose(one, other, rtol=rounding, atol=rounding)


TRANSFORMED = {
    "called": lambda f: f(X, Y),
    "vmap": lambda f: jax.vmap(f)(X, Y),
    "vmap of one operand": lambda f: jax.vmap(f, (0, None))(X, Y[1]),
    "vmap over the last axis": lambda f: jax.vmap(f, (1, None), 1)(jnp.stack([X, 2 * X]), Y[:2]),
    "vmap twice": lambda f: jax.vmap(jax.vmap(f, (None, 0)), (0, None))(X, Y),
    "jvp": lambda f: jax.jvp(f, (X, Y), (Y, X)),
    "jvp along one": lambda f: jax.jvp(lambda x: f(x, Y), (X,), (Y,)),
    "grad": lambda f: jax.grad(total(f), (0, 1))(X, Y),
    "grad of each": lambda f: jax.vmap(jax.grad(total(f), (0, 1)))(X, Y),
    "grad with one known": lambda f: jax.vmap(jax.grad(total(f)), (None, 0))(X[2], Y),
    "second derivative": lambda f: jax.jvp(jax.grad(total(f)), (X, Y), (Y, X)),
    "grad of a grad": lambda f: jax.grad(
        lambda x: jnp.sum(jax.grad(total(f))(x, Y) ** 2),
    )(X),
    "recomputed": lambda f: jax.grad(jax.checkpoint(total(f)))(X, Y),
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", TRANSFORMED)
def test_together_is_the_plain_evaluation(name):
    transformed = TRANSFORMED[name]
    expected = transformed(plain)
    assert_same(transformed(staged), expected)
    assert_same(jax.jit(lambda: transformed(staged))(), expected)


def test_together_keeps_two_precisions_apart():
    values = X, Y.astype(jnp.float32)
    assert_same(jax.jit(fuse)(values), values)


def an_operand_alone(join):
    """Return a function whose second value has no batch axis when only the first has one."""
    return lambda x: join((x * x, jnp.full((), 3.0)))


def test_an_operand_without_a_batch_axis():
    expected = jax.vmap(an_operand_alone(lambda values: values))(X)
    for run in (lambda f: f, jax.jit):
        assert_same(run(jax.vmap(an_operand_alone(fuse)))(X), expected)
        slope = run(jax.vmap(jax.grad(lambda x: sum(an_operand_alone(fuse)(x)))))(X)
        np.testing.assert_allclose(slope, 2 * X, rtol=1e-15)


@pytest.mark.parametrize("tree", [(), (jnp.ones(3),), {"a": {"b": jnp.zeros((2, 0))}}])
def test_together_keeps_trees_of_none_and_of_one(tree):
    assert_same(jax.jit(fuse)(tree), tree)


def first_above(levels, x, *, offset):
    """Return the first of the levels above x + offset, and whether there is one."""
    above = levels > x + offset
    return {"place": jnp.argmax(above), "any": above.any()}


LEVELS = jnp.asarray([0.5, 1.5, 2.5])


def found(levels, x, offset):
    return run_search(first_above, levels, x, offset=offset)


@pytest.mark.slow
def test_a_search_batched_along_any_axes_finds_what_a_loop_finds():
    x, offset = jnp.linspace(0, 3, 4), jnp.asarray([0.0, 1.0])
    levels = jnp.stack([LEVELS, LEVELS + 0.25], axis=1)  # (3, 2): batched along its last axis
    inner = jax.vmap(found, in_axes=(None, 0, None))
    both = jax.vmap(inner, in_axes=(1, None, 0))
    expected = [[found(levels[:, i], a, offset[i]) for a in x] for i in range(2)]
    for run in (both, jax.jit(both)):
        got = run(levels, x, offset)
        for name in ("place", "any"):
            np.testing.assert_array_equal(
                got[name], [[one[name] for one in row] for row in expected]
            )


@pytest.mark.slow
def test_a_search_passes_no_gradient():
    def loss(x, offset):
        return LEVELS[found(LEVELS, x, offset)["place"]] * x

    for run in (loss, jax.checkpoint(loss), jax.jit(loss)):
        slopes = jax.grad(run, argnums=(0, 1))(jnp.asarray(0.7), jnp.asarray(0.0))
        np.testing.assert_array_equal(slopes, (1.5, 0.0))


def test_a_loop_around_a_search_has_the_gradient_of_what_is_found():
    def loss(x):
        def step(x, _):
            return x * LEVELS[found(LEVELS, x, jnp.zeros_like(x))["place"]], None

        return jax.lax.scan(step, x, length=3)[0]

    x = jnp.asarray(0.7)
    np.testing.assert_allclose(jax.grad(loss)(x), loss(x) / x, rtol=1e-6)
