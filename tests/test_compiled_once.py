"""A second eager call of a public function compiles nothing.

Programs are kept by function and shapes: a closure that is new at each call, or a setting that has
no hash, is compiled again every time.
"""

import importlib

import jax
import pytest
from examples import ROOMS, examples_of

QUICK = {"compositing", "matting", "point_ops"}
# Functions of one ray, point or frame, made for a user's own `vmap` or `jit`, whose searches and
# loops are new functions at each eager call.
AGAIN = {
    "lights.adaptive.adaptive_irradiance",
    "optics.distortion.undistort",
    "optics.irradiance.pixel_irradiance",
    "optics.irradiance.sensor_irradiance",
    "optics.resampling.distort_image",
    "optics.vignetting.clear_fraction",
    "optics.views.camera_ray",
    "optics.views.chief_slope",
    "optics.views.cos_to_axis",
    "optics.views.lens_ray",
    "optics.views.view_ray",
    "rendering.light_field.render_light_field",
    "sensor.brighter_fatter.gathered",
    "sensor.expectation.expected_of_count",
    "sensor.moments.expected_signal",
    "sensor.moments.signal_to_noise",
    "sensor.moments.signal_variance",
    "sensor.raw.collect",
    "sensor.raw.raw_image",
    "sensor.shutter.exposed",
    "transport.light_paths.light_traced",
    "transport.paths.path_radiance",
    "transport.paths.path_sample",
    "transport.paths.path_traced_pixels",
    "transport.radiosity.exchange.exchanged",
    "transport.radiosity.exchange.form_factor_table",
    "transport.radiosity.gather.radiosity_along",
    "transport.radiosity.gather.radiosity_image",
    "transport.radiosity.patches.patches_at",
    "transport.radiosity.patches.patches_of",
    "transport.radiosity.solution.direct_irradiance",
    "transport.radiosity.solve.bounce",
    "transport.ray_tree.ray_tree_radiance",
    "transport.ray_tree.ray_tree_radiances",
}
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
    assert compiled_again(room, programs).keys() <= AGAIN
