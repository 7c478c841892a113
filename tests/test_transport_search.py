"""A search as one step: the same under every transformation, and nothing to differentiate."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxvision.transport._search import searched


def first_above(levels, x, *, offset):
    """The first of the levels above x + offset, and whether there is one."""
    above = levels > x + offset
    return {"place": jnp.argmax(above), "any": above.any()}


LEVELS = jnp.asarray([0.5, 1.5, 2.5])


def found(levels, x, offset):
    return searched(first_above, levels, x, offset=offset)


def test_batched_along_any_axes_it_finds_what_a_loop_finds():
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


def test_gradients_pass_it_by():
    def loss(x, offset):
        return LEVELS[found(LEVELS, x, offset)["place"]] * x

    for run in (loss, jax.checkpoint(loss), jax.jit(loss)):
        slopes = jax.grad(run, argnums=(0, 1))(jnp.asarray(0.7), jnp.asarray(0.0))
        np.testing.assert_array_equal(slopes, (1.5, 0.0))


def test_a_loop_around_it_has_the_gradient_of_what_is_found():
    def loss(x):
        def step(x, _):
            return x * LEVELS[found(LEVELS, x, jnp.zeros_like(x))["place"]], None

        return jax.lax.scan(step, x, length=3)[0]

    x = jnp.asarray(0.7)
    np.testing.assert_allclose(jax.grad(loss)(x), loss(x) / x, rtol=1e-6)
