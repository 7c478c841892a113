"""The two precisions of a hard case, and checks shared by all hard cases. The default run uses
float32, the harder precision. Slow tests and CI use float64."""

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
