"""Arrays shared out among four devices give the results of one, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ON_FOUR = """
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec
import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, SamplingOptions, fit
from jaxvision.scene_files import read_scene

assert len(jax.devices()) == 4
mesh = jax.make_mesh((4,), ("data",), axis_types=(AxisType.Auto,))
shared = NamedSharding(mesh, PartitionSpec("data"))

file = read_scene("glass_and_mirror")
rows, columns = np.divmod(np.arange(64), 8)
method = jv.Paths(samples=1, depth=3)
traced = jax.jit(lambda r, c: jv.path_traced_pixels(
    jax.random.key(0), file.scene, file.view, 40 * r, 70 * c, method=method).radiance)
alone = traced(jnp.asarray(rows), jnp.asarray(columns))
found = traced(jax.device_put(rows, shared), jax.device_put(columns, shared))
assert len(found.sharding.device_set) == 4
np.testing.assert_array_equal(alone, found)

t = np.linspace(0, 1, 40_000)
y = 2 * np.exp(-3 * t) + 0.1 * np.random.default_rng(0).standard_normal(t.size)
y[7] = np.nan


def problem(place):
    return Problem(
        parameters={"a": Parameter(lower=0, upper=10), "k": Parameter(lower=0, upper=10)},
        predict=lambda a, k, inputs: a * jnp.exp(-k * inputs["t"]),
        inputs={"t": place(t)},
        likelihood=Gaussian(sd=0.1),
        data=place(y),
    )


many = problem(lambda x: jax.device_put(x, shared))
assert len(many.data.sharding.device_set) == len(many.present.sharding.device_set) == 4
options = {"posterior": "emcee", "sampling": SamplingOptions(steps=40, walkers=16, block=20)}
one, four = (fit(p, **options) for p in (problem(jnp.asarray), many))
# A search that sums in another order takes other steps to the same mode, to which it comes within
# 4e-4 standard errors; the ends lie a millionth of one apart.
for estimate, other in zip(four.estimates, one.estimates, strict=True):
    mode, error = one.values[estimate.name], other.standard_error
    np.testing.assert_allclose(four.values[estimate.name], mode, rtol=0, atol=1e-6 * error)
# The order of a sum differs, so a step may be taken here and refused there; not in so few steps.
np.testing.assert_allclose(four.posterior.samples, one.posterior.samples, rtol=1e-9)
print("equal")
"""


@pytest.mark.slow
def test_pixels_fits_and_chains_are_equal_on_four_devices():
    root = Path(__file__).parents[1]
    flags = "--xla_force_host_platform_device_count=4 --xla_backend_optimization_level=0"
    # Devices that stand for four on two cores wait for each other: each needs a thread.
    more = {"XLA_FLAGS": flags, "NPROC": "8", "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-c", ON_FOUR], env=os.environ | more, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith("equal")
