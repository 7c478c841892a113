"""Tests that arrays divided among four devices, of one process or two, give the results of one
device."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ON_FOUR = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
if len(sys.argv) > 1:
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.distributed.initialize(sys.argv[1], num_processes=2, process_id=int(sys.argv[2]))
import jax.numpy as jnp
import numpy as np
from jax.experimental.multihost_utils import process_allgather
from jax.sharding import AxisType, NamedSharding, PartitionSpec
import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, Emcee, fit, fit_map
from fitting.inference import search
from jaxvision.errors import InputError
from jaxvision.files.scenes import read_scene
from jaxvision.transport import radiosity

assert len(jax.devices()) == 4
mesh = jax.make_mesh((4,), ("data",), axis_types=(AxisType.Auto,))
shared = NamedSharding(mesh, PartitionSpec("data"))


def shared_out(x):
    return jax.make_array_from_callback(x.shape, shared, lambda part: x[part])


file = read_scene("glass_and_mirror")
rows, columns = np.divmod(np.arange(64), 8)
method = jv.Paths(samples=1, depth=3)
traced = jax.jit(lambda r, c: jv.path_traced_pixels(
    jax.random.key(0), file.scene, file.view, 40 * r, 70 * c, method=method).radiance)
alone = traced(jnp.asarray(rows), jnp.asarray(columns))
found = traced(shared_out(rows), shared_out(columns))
assert len(found.sharding.device_set) == 4
np.testing.assert_array_equal(alone, process_allgather(found, tiled=True))

scene = read_scene("cornell_box").scene
plan = radiosity.plan_patches(scene, size=0.1, split=1)
count = len(radiosity.patches_of(scene, plan).area)
by_rows = jax.shard_map(
    lambda scene, part: radiosity.form_factor_table(scene, plan, elements=part),
    mesh=mesh, in_specs=(PartitionSpec(), PartitionSpec("data")), out_specs=PartitionSpec("data"))
table = jax.jit(lambda scene: radiosity.form_factor_table(scene, plan))(scene)
rows = jax.jit(by_rows)(scene, shared_out(np.arange(count)))
assert {part.data.shape for part in rows.addressable_shards} == {(count // 4, count)}
np.testing.assert_array_equal(table, process_allgather(rows, tiled=True))
solve = jax.jit(
    lambda scene, table: radiosity.radiosity(scene, plan, table=table, method="iterative"))
one, many = solve(scene, table), solve(scene, rows)
for name in ("radiosity", "irradiance", "sent"):
    found = getattr(many, name)
    assert not found.sharding.is_fully_replicated  # no device holds it all
    found, wanted = process_allgather(found, tiled=True), getattr(one, name)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6 * float(wanted.max()))

numbers = shared_out(np.arange(count))
product = jax.shard_map(
    lambda scene, sent, part: radiosity.exchange.exchanged(scene, plan, sent, elements=part),
    mesh=mesh, in_specs=(PartitionSpec(), PartitionSpec(), PartitionSpec("data")),
    out_specs=PartitionSpec("data"))
without = jax.jit(lambda scene, part: radiosity.radiosity(
    scene, plan, table=lambda sent: product(scene, sent, part), method="iterative"))
found = process_allgather(without(scene, numbers).radiosity, tiled=True)
np.testing.assert_allclose(found, one.radiosity, rtol=0, atol=1e-6 * float(one.radiosity.max()))

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


many = problem(shared_out)
assert len(many.data.sharding.device_set) == len(many.present.sharding.device_set) == 4
# No device gathers the Jacobian of all, which each would then decompose for itself.
begin = jnp.asarray(search.spread_starts(many, 8, seed=0))
lowered = search._searched.lower(begin, many, jnp.zeros(2), jnp.ones(2), True)
squares = lowered.compile().compiled.as_text()
assert "all-reduce" in squares and "all-gather" not in squares
options = {"posterior": Emcee(steps=40, walkers=16, block=20)}
one, four = (fit(p, **options) for p in (problem(jnp.asarray), many))
# A search that sums in another order takes other steps to the same mode, to which it comes within
# 4e-4 standard errors; the ends lie a millionth of one apart.
for estimate, other in zip(four.estimates, one.estimates, strict=True):
    mode, error = one.values[estimate.name], other.standard_error
    np.testing.assert_allclose(four.values[estimate.name], mode, rtol=0, atol=1e-6 * error)
# The order of a sum differs, so a step may be taken here and refused there; not in so few steps.
np.testing.assert_allclose(four.posterior.samples, one.posterior.samples, rtol=1e-9)

if len(sys.argv) > 1:  # what is read in parts lies on one host
    curve = lambda a, k, inputs: a * jnp.exp(-k * inputs["t"])
    free, noise = {"a": Parameter(lower=0, upper=10), "k": 1.0}, Gaussian(sd=0.1)
    refused = [
        ("data", lambda: Problem(
            free, curve, noise, inputs={"t": t}, data=shared_out(y), chunk=1000)),
        ("inputs", lambda: Problem(
            free, curve, noise, inputs={"t": shared_out(t)}, data=y, chunk=1000)),
        ("data", lambda: fit_map(
            Problem(free, curve, noise, inputs={"t": t[:4]}, data=y[:4]),
            shared_out(np.ones((4, 8))))),
    ]
    for name, call in refused:
        try:
            call()
        except InputError as error:
            assert str(error).startswith(f"{name}: an array lies on several hosts"), error
        else:
            raise AssertionError(name)
print("equal")
"""


def environment(devices):
    """Return the environment of a process whose CPU stands for several devices, each with a
    thread."""
    flags = f"--xla_force_host_platform_device_count={devices} --xla_backend_optimization_level=0"
    root = Path(__file__).parents[2]
    return os.environ | {"XLA_FLAGS": flags, "NPROC": f"{2 * devices}", "PYTHONPATH": str(root)}


@pytest.mark.slow
def test_pixels_patches_fits_and_chains_are_equal_on_four_devices():
    done = subprocess.run(
        [sys.executable, "-c", ON_FOUR], env=environment(4), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith("equal")


@pytest.mark.slow
def test_they_are_equal_on_two_hosts_of_two_devices():
    """The two processes communicate by the loopback interface only."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        address = f"localhost:{free.getsockname()[1]}"
    started = [
        subprocess.Popen(
            [sys.executable, "-c", ON_FOUR, address, str(number)],
            env=environment(2),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for number in range(2)
    ]
    try:
        for process in started:
            said, error = process.communicate(timeout=600)
            assert process.returncode == 0, error
            assert said.strip().endswith("equal")
    finally:
        for process in started:
            process.kill()
