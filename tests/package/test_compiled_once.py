"""Tests that a second eager call of a public function with other numbers compiles nothing.

Programs are stored by function and shapes. A closure that is new at each call, a number inside a
program, or a setting without a hash would be compiled again every time."""

import ast
import contextlib
import doctest
import importlib
import inspect
import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from examples import ROOMS, examples_of
from public_names import functions

import fitting
import jaxvision
from jaxvision.scene import FastPoissonShotNoise, PoissonShotNoise, Sensor
from jaxvision.sensor import count, exposed, raw_image

QUICK = {"compositing"}
# One function for each loop that many functions of a slow module share.
QUICKLY = [
    ("measured", "brdf.rgl.sample"),
    ("optics", "optics.distortion.undistort"),
    ("sensor", "sensor.brighter_fatter.gathered"),
    ("sensor", "sensor.expectation.expected_of_count"),
    ("sensor", "sensor.nonlinearity.charge_of_signal"),
    ("sensor", "sensor.shutter.exposed"),
]
OTHER = 1 - 2.0**-12  # a factor for numbers: directions stay unit vectors
# Modules whose examples in docstrings are run; others take longer.
SAID = {*{name.split(".")[1] for name in functions(jaxvision)}} - {"cli", "accuracy", "files"}
SAID_QUICKLY = {"geometry", "point_ops", "spectra"}
COMPILED = "/jax/core/compile/backend_compile_duration"


@pytest.fixture
def programs():
    """Yield a growing list of the programs compiled so far."""
    found = []

    def listen(event, seconds, **_):
        if event == COMPILED:
            found.append(seconds)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield found
    jax.monitoring.unregister_event_duration_listener(listen)


def compiled_again(room: str, programs: list, chosen: str = "") -> dict[str, int]:
    """Return how many programs the second call of each function of a module compiles, with other
    numbers except where a sum or a matrix must be exact."""
    again = {}
    for name, (arguments, options) in examples_of(room).items():
        if not name.startswith(chosen):
            continue
        module, _, function = f"jaxvision.{name}".rpartition(".")
        call = getattr(importlib.import_module(module), function)
        jax.block_until_ready(call(*arguments, **options))
        moved = jax.tree.map(_moved, (arguments, options))
        before = len(programs)
        try:
            jax.block_until_ready(call(*moved[0], **moved[1]))
        except ValueError:
            before = len(programs)
            jax.block_until_ready(call(*arguments, **options))
        if len(programs) > before:
            again[name] = len(programs) - before
    return again


def _moved(leaf):
    floating = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating)
    if not floating or leaf.weak_type:
        return leaf
    return jnp.asarray(np.asarray(leaf) * leaf.dtype.type(OTHER))


class _Again(ast.NodeTransformer):
    """Rewrites an example so that its lambdas are made once, and its numbers differ in the second
    run."""

    def __init__(self, times, is_second):
        self.times, self.is_second, self.count = times, is_second, 0

    def visit_Lambda(self, node):
        self.count += 1
        made = [ast.Constant(self.count), self.generic_visit(node)]
        return ast.Call(ast.Name("once", ast.Load()), made, [])

    def visit_FunctionDef(self, node):
        return ast.Pass() if self.is_second else node

    def visit_Constant(self, node):
        changed = self.is_second and isinstance(node.value, float)
        return ast.Constant(node.value * self.times) if changed else node


def compiled_by_examples(found: dict, programs: list, *, times: float) -> dict[str, int]:
    """Return how many programs a second run of the examples of public functions compiles."""
    again = {}
    for name, function in found.items():
        if any(part.startswith("_") for part in name.split(".")):
            continue
        lines = doctest.DocTestParser().get_examples(inspect.getdoc(function) or "")
        kept, given = {}, {"jax": jax, "jnp": jnp, "np": np, "jv": jaxvision}
        given["once"] = kept.setdefault

        def execute(factor, is_second, *, name=name, lines=lines, given=given):
            tree = ast.parse("".join(line.source for line in lines))
            tree = ast.fix_missing_locations(_Again(factor, is_second).visit(tree))
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(tree, name, "exec"), given)

        execute(1.0, False)
        before = len(programs)
        try:
            execute(times, True)
        except (ValueError, OverflowError):
            before = len(programs)
            execute(1.0, True)
        if len(programs) > before:
            again[name] = len(programs) - before
    return again


@pytest.mark.parametrize(
    "room",
    [r if r in SAID_QUICKLY else pytest.param(r, marks=pytest.mark.slow) for r in sorted(SAID)],
)
def test_an_example_with_other_numbers_compiles_nothing(room, programs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = {n: f for n, f in functions(jaxvision).items() if n.split(".")[1] == room}
    assert not compiled_by_examples(found, programs, times=OTHER)


@pytest.mark.slow
def test_a_second_fit_compiles_nothing(programs, tmp_path, monkeypatch):
    """The numbers are the same, because those of a prior and of a start are part of a problem's
    program."""
    monkeypatch.chdir(tmp_path)
    assert not compiled_by_examples(functions(fitting), programs, times=1.0)


@pytest.mark.parametrize(
    "room", [r if r in QUICK else pytest.param(r, marks=pytest.mark.slow) for r in ROOMS]
)
def test_a_second_call_compiles_nothing(room, programs):
    assert not compiled_again(room, programs)


@pytest.mark.parametrize(("room", "function"), QUICKLY)
def test_a_shared_loop_is_compiled_once(room, function, programs):
    assert function in examples_of(room)
    assert not compiled_again(room, programs, function)


@pytest.mark.sweep
@pytest.mark.parametrize("law", [PoissonShotNoise(), FastPoissonShotNoise()])
def test_a_count_is_compiled_once(law, programs):
    """In the examples counts are Gaussian, which needs no loop."""
    key, mean = jax.random.key(0), jax.numpy.full((5, 1, 1), 50.0)
    sensor = Sensor(quantum_efficiency=1.0, gain=1.0, bits=12, shot_noise=law)

    def twice():
        return count(key, mean, law), raw_image(key, sensor, mean)

    jax.block_until_ready(twice())
    before = len(programs)
    jax.block_until_ready(twice())
    assert len(programs) == before


def test_a_loop_over_a_callers_function_is_not_stored():
    """A stored program would give the light of the first call."""
    light = jax.numpy.ones((2, 1, 1))

    def picture_at(time):
        return light + 0 * time

    first = exposed(None, jax.numpy.ones(()), picture_at, rows=2, slots=2)
    light = 3 * light
    second = exposed(None, jax.numpy.ones(()), picture_at, rows=2, slots=2)
    assert float(second.sum()) == 3 * float(first.sum())
