"""The two precisions of a hard case: float32, whose digits run out first, in the default run;
float64 with the long sweeps, and in CI."""

import jax.numpy as jnp
import pytest

both_precisions = pytest.mark.parametrize(
    "dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)]
)
