"""A second eager call of a public function compiles nothing.

Programs are kept by function and shapes: a closure that is new at each call, or a setting that has
no hash, is compiled again every time.
"""

import importlib

import jax
import pytest
from examples import ROOMS, examples_of

from jaxvision.scene import FastPoissonShotNoise, PoissonShotNoise, Sensor
from jaxvision.sensor import count, exposed, raw_image

QUICK = {"compositing", "matting", "point_ops"}
# One for each loop that many functions of a slow room share.
QUICKLY = [
    ("measured", "brdf.rgl.sample"),
    ("optics", "optics.distortion.undistort"),
    ("sensor", "sensor.brighter_fatter.gathered"),
    ("sensor", "sensor.expectation.expected_of_count"),
    ("sensor", "sensor.shutter.exposed"),
]
COMPILED = "/jax/core/compile/backend_compile_duration"


@pytest.fixture
def programs():
    """The programs compiled so far, as a list that grows."""
    found = []

    def listen(event, seconds, **_):
        if event == COMPILED:
            found.append(seconds)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield found
    jax.monitoring.unregister_event_duration_listener(listen)


def compiled_again(room: str, programs: list, chosen: str = "") -> dict[str, int]:
    """How many programs the second call of each function of a room compiles."""
    again = {}
    for name, (arguments, options) in examples_of(room).items():
        if not name.startswith(chosen):
            continue
        module, _, function = f"jaxvision.{name}".rpartition(".")
        call = getattr(importlib.import_module(module), function)
        jax.block_until_ready(call(*arguments, **options))
        before = len(programs)
        jax.block_until_ready(call(*arguments, **options))
        if len(programs) > before:
            again[name] = len(programs) - before
    return again


@pytest.mark.parametrize(
    "room", [r if r in QUICK else pytest.param(r, marks=pytest.mark.slow) for r in ROOMS]
)
def test_a_second_call_compiles_nothing(room, programs):
    assert not compiled_again(room, programs)


@pytest.mark.parametrize(("room", "function"), QUICKLY)
def test_a_shared_loop_is_compiled_once(room, function, programs):
    assert function in examples_of(room)
    assert not compiled_again(room, programs, function)


@pytest.mark.parametrize("law", [PoissonShotNoise(), FastPoissonShotNoise()])
def test_a_count_is_compiled_once(law, programs):
    """In the examples' rooms the counts are Gaussian, without a loop."""
    key, mean = jax.random.key(0), jax.numpy.full((5, 1, 1), 50.0)
    sensor = Sensor(quantum_efficiency=1.0, gain=1.0, bits=12, shot_noise=law)

    def twice():
        return count(key, mean, law), raw_image(key, sensor, mean)

    jax.block_until_ready(twice())
    before = len(programs)
    jax.block_until_ready(twice())
    assert len(programs) == before


def test_a_loop_over_a_function_of_the_caller_follows_it():
    """A program kept of it would show the light of the first call."""
    light = jax.numpy.ones((2, 1, 1))

    def picture_at(time):
        return light + 0 * time

    first = exposed(None, jax.numpy.ones(()), picture_at, rows=2, slots=2)
    light = 3 * light
    second = exposed(None, jax.numpy.ones(()), picture_at, rows=2, slots=2)
    assert float(second.sum()) == 3 * float(first.sum())
