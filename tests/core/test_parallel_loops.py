import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.core import parallel_loops as parallel

X = jnp.asarray([[0.5, -0.0, jnp.nan], [1.0, jnp.inf, 2.0]])


def decay(carry, x):
    return 0.5 * carry + x, carry * x


def _map(loops):
    return loops.map_ if loops is parallel else loops.map


PAIRS = {
    "scan": lambda loops, x: loops.scan(decay, x[0], x),
    "scan from the end": lambda loops, x: loops.scan(decay, x[0], x, reverse=True),
    "scan of a length": lambda loops, x: loops.scan(lambda c, _: (c + 1, 2 * c), x, None, length=3),
    "map": lambda loops, x: _map(loops)(lambda row: row / 3, x),
    "map in batches": lambda loops, x: _map(loops)(lambda row: row / 3, x, batch_size=2),
    "counted": lambda loops, x: loops.fori_loop(0, 4, lambda k, c: c * k - x, x),
    "while": lambda loops, x: loops.while_loop(
        lambda c: c[0] < 5, lambda c: (c[0] + 1, -c[1]), (0, x)
    ),
}


@pytest.mark.parametrize("name", PAIRS)
def test_values_are_those_of_jax(monkeypatch, name):
    monkeypatch.setattr(parallel, "_is_needed", lambda: True)
    found, right = PAIRS[name](parallel, X), PAIRS[name](jax.lax, X)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(right), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(np.signbit(a), np.signbit(b))


@pytest.mark.parametrize("name", ["scan", "map", "counted"])
def test_gradients_are_those_of_jax(monkeypatch, name):
    monkeypatch.setattr(parallel, "_is_needed", lambda: True)

    def total(loops):
        return lambda x: sum(leaf.sum() for leaf in jax.tree.leaves(PAIRS[name](loops, x)))

    x = jnp.asarray([[0.5, -1.0], [1.0, 3.0]])
    np.testing.assert_array_equal(jax.grad(total(parallel))(x), jax.grad(total(jax.lax))(x))


@pytest.mark.parametrize("name", ["scan", "map", "map in batches", "counted", "while"])
def test_a_loop_over_large_arrays_is_not_compiled_for_one_core(name):
    if jax.default_backend() != "cpu":
        pytest.skip("XLA marks such loops on CPUs only")
    compiled = jax.jit(lambda x: PAIRS[name](parallel, x)).lower(jnp.ones((4, 200_000))).compile()
    assert "while" in compiled.as_text()
    assert 'xla_cpu_small_call="true"' not in compiled.as_text()
