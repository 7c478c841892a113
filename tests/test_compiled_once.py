"""A second eager call of a public function compiles nothing.

Programs are kept by function and shapes: a closure that is new at each call, or a setting that has
no hash, is compiled again every time.
"""

import importlib

import jax
import pytest
from examples import ROOMS, examples_of

QUICK = {"compositing", "matting", "point_ops"}
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


def compiled_again(room: str, programs: list) -> dict[str, int]:
    """How many programs the second call of each function of a room compiles."""
    again = {}
    for name, (arguments, options) in examples_of(room).items():
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
