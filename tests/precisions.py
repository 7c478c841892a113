"""The two precisions of a hard case: float32, whose digits run out first, in the default run;
float64 with the long sweeps, and in CI. And what all hard cases ask."""

import jax
import jax.numpy as jnp
import pytest

both_precisions = pytest.mark.parametrize(
    "dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)]
)


def eps(dtype):
    return float(jnp.finfo(dtype).eps)


def assert_finite(tree):
    for leaf in jax.tree.leaves(tree):
        if jnp.issubdtype(leaf.dtype, jnp.floating):
            assert jnp.isfinite(leaf).all(), tree
