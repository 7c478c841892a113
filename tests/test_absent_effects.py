"""What is None leaves nothing behind: the primitives of a traced program, counted, effect by
effect, of the sensor and of the lens."""

from collections import Counter
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sensors import EVERY_EFFECT

from jaxvision import optics
from jaxvision import scene as s
from jaxvision.sensor import raw_image

KEY, DIE = jax.random.split(jax.random.key(8))
LIGHT = jnp.full((6, 8, 3), 1e-3, float)
# Where the program of an effect holds what no other effect's does.
SIGNATURES = {
    "smear": "reduce_sum",
    "blooming": "scan",
    "charge_transfer": "log1p",
    "banding": "sin",
    "bits": "round",
}
DRAWN = {
    "prnu",
    "dead_pixels",
    "hot_pixels",
    "shot_noise",
    "conversion_prnu",
    "dsnu",
    "column_dsnu",
    "row_dsnu",
    "reset_noise",
    "read_noise",
    "telegraph_noise",
    "row_noise",
    "banding",
    "column_prnu",
}
LENS = s.ThinLens(
    [0, 0, 0],
    np.eye(3),
    0.05,
    1e-5,
    resolution=(6, 8),
    f_number=4.0,
    focus_distance=2.0,
    rim=s.Rim(0.03, 0.02),
    distortion=s.Distortion([-0.1], [0.01, 0.02]),
    diffraction=s.Diffraction([6e-7, 5e-7, 4e-7], size=5),
)


def primitives(function, *arguments):
    """How often each primitive stands in the program, inner programs included."""

    def count(jaxpr):
        total = Counter(equation.primitive.name for equation in jaxpr.eqns)
        for equation in jaxpr.eqns:
            inner = jax.tree.leaves(
                list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
            )
            total += sum((count(x) for x in inner if hasattr(x, "eqns")), Counter())
        return total

    return count(jax.make_jaxpr(function)(*arguments).jaxpr)


def shot(sensor):
    return primitives(
        lambda sensor, light: raw_image(KEY, sensor, light, die_key=DIE), sensor, LIGHT
    )


def test_a_sensor_without_effects_is_no_program_at_all():
    assert shot(s.Sensor()) == Counter()


@pytest.fixture(scope="module")
def with_all():
    return shot(EVERY_EFFECT)


EFFECTS = [name for name, value in vars(EVERY_EFFECT).items() if value is not None]


@pytest.mark.sweep
@pytest.mark.parametrize("effect", [name for name in EFFECTS if name != "full_well"])
def test_a_source_that_is_none_takes_its_primitives_with_it(effect, with_all):
    """Of all effects at once: without one there is nothing new, and less of something; alone it
    is the only one with random bits, if it draws."""
    without = shot(replace(EVERY_EFFECT, **{effect: None}))
    cut = Counter(["min"]) if effect == "blooming" else Counter()  # a well that only ends
    assert without - cut <= with_all
    assert without != with_all
    if effect in SIGNATURES:
        assert with_all[SIGNATURES[effect]] > without[SIGNATURES[effect]] == 0
    needed = {"full_well": EVERY_EFFECT.full_well} if effect == "blooming" else {}
    alone = shot(s.Sensor(**{effect: getattr(EVERY_EFFECT, effect)}, **needed))
    assert alone
    assert (alone["shift_left"] > 0) == (effect in DRAWN)  # the rotations of the hash


@pytest.mark.slow
def test_parts_of_a_lens_that_are_none_are_not_traced():
    def light(view):
        return primitives(optics.sensor_irradiance, view, jnp.ones((6, 8, 3)))

    whole = light(LENS)
    bare = light(replace(LENS, rim=None, distortion=None, diffraction=None))
    for part in ("rim", "distortion", "diffraction"):
        without = light(replace(LENS, **{part: None}))
        assert without <= whole
        assert without != whole
        alone = light(
            replace(LENS, **{p: None for p in ("rim", "distortion", "diffraction") if p != part})
        )
        assert bare <= alone
        assert bare != alone
    # nothing but the law: no iteration, no transform, no convolution
    assert not set(bare) & {"while", "scan", "fft", "conv_general_dilated", "cos", "sin"}
